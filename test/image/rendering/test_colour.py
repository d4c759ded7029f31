"""Colour in the picture: of soil, rocks, rover and lamp, anchored in the world."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.image.camera.chase import ChaseConfig, ChaseMount
from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig
from lunar_rover_sim.image.camera.hazard import HazardConfig, HazardMount
from lunar_rover_sim.image.camera.mosaic import interpolated
from lunar_rover_sim.image.illumination import colours
from lunar_rover_sim.image.illumination.config import LampConfig, ReflectanceConfig, SunConfig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

RAW = dataclasses.replace(scene.IDEAL, encoding='bayer_rggb16', bits=16, target_level=0.2)
CAMERA = CameraConfig(width=320, height=240)
EVEN = ReflectanceConfig(colour_spread=0.0, colour_of_fresh=0.0)
PERFECT = LensConfig(scatter_share=0.0, veil_share=0.0)


def drawn(world, config, **pose):
    """Return the left image of a state."""
    with Renderer(world, scene.ROVER, config) as renderer:
        return renderer.render(RoverPose(scene.pose(**pose)), 0, ('left', 'label', 'depth'))


def ratios(mosaic, where=slice(None)):
    """Return the median red and blue over green of the cells of a mosaic that are lit."""
    cells = mosaic.astype(float).reshape(mosaic.shape[0] // 2, 2, -1, 2)
    red, blue = cells[:, 0, :, 0], cells[:, 1, :, 1]
    green = 0.5 * (cells[:, 0, :, 1] + cells[:, 1, :, 0])
    lit = (green > 0.02 * 65535) & (np.maximum(np.maximum(red, green), blue) < 65535)
    lit = lit & where[::2, ::2] if isinstance(where, np.ndarray) else lit
    return float(np.median(red[lit] / green[lit])), float(np.median(blue[lit] / green[lit]))


def expected(kind, phase_deg):
    """Return the colour of even soil."""
    s = np.sin(np.radians(0.5 * phase_deg)) - np.sin(np.radians(15.0))
    return np.array(colours.ground_colour(kind)) * np.exp(np.array(colours.PHASE_SLOPE) * s)


@pytest.mark.parametrize('kind', ['mare', 'highland'])
def test_flat_ground_has_the_published_colour_and_reddens_with_phase(kind):
    found = []
    for yaw in (0.0, 180.0):
        config = scene.config(30.0, 0.0, camera=CAMERA, sensor=RAW, lens=PERFECT,
                              reflectance=dataclasses.replace(EVEN, ground=kind))
        frame = drawn(scene.plane(), config, yaw_deg=yaw, pitch_deg=30.0)
        found.append(ratios(frame.left, frame.label == 1))
    # The camera looks down by 30 deg, the sun stands 30 deg high, ahead and then behind.
    assert found[0] == pytest.approx(expected(kind, 120.0), rel=0.01)
    assert found[1] == pytest.approx(expected(kind, 20.0), rel=0.015)
    assert found[0][0] > found[1][0] and found[0][1] < found[1][1]


def test_patches_stay_in_their_places_and_differ_between_worlds():
    """The same point from two poses has one colour; RMS as configured."""
    config = scene.config(30.0, 90.0, camera=CAMERA, sensor=RAW, lens=PERFECT,
                          reflectance=ReflectanceConfig(colour_spread=0.1, colour_of_fresh=0.0))
    world = scene.plane(n=129, cell_m=2.0, far=False)
    logs = []
    with Renderer(world, scene.ROVER, config) as renderer:
        def seen(x, y):
            # High above, straight down: phase and place change little over the middle.
            image = renderer.render(RoverPose(scene.pose(x, y, z=0.7, pitch_deg=80.0)), 0,
                                    ('left',)).left
            return np.log(ratios(image)[0])
        places = np.random.default_rng(0).uniform(-80, 80, (60, 2))
        logs = np.array([seen(*place) for place in places])
        assert seen(*places[3]) == pytest.approx(logs[3], abs=1e-3)
    assert logs.std() == pytest.approx(0.1, rel=0.3)
    other = dataclasses.replace(world, config=dataclasses.replace(world.config, seed=7))
    with Renderer(other, scene.ROVER, config) as renderer:
        elsewhere = np.array([np.log(ratios(renderer.render(RoverPose(scene.pose(
            *place, z=0.7, pitch_deg=80.0)), 0, ('left',)).left)[0]) for place in places])
    assert abs(np.corrcoef(logs, elsewhere)[0, 1]) < 0.4


def test_fresh_ground_is_brighter_and_bluer():
    bright = dataclasses.replace(scene.plane(), albedo=np.full((513, 513), 1.5, np.float32))
    config = scene.config(30.0, 90.0, camera=CAMERA, sensor=RAW, lens=PERFECT,
                          reflectance=ReflectanceConfig(colour_spread=0.0))
    usual, fresh = (ratios(drawn(world, config, pitch_deg=30.0).left)
                    for world in (scene.plane(), bright))
    assert fresh[0] / usual[0] == pytest.approx(1.5**-0.15, rel=0.01)
    assert fresh[1] / usual[1] == pytest.approx(1.5**0.15, rel=0.01)


def test_rocks_are_less_red_than_the_ground_and_the_sky_is_black():
    world = scene.plane(stones=scene.rocks([(1.5, 0.0, 0.3)]))
    config = scene.config(30.0, 200.0, camera=CAMERA, sensor=RAW, lens=PERFECT, reflectance=EVEN)
    frame = drawn(world, config)
    rock, ground = (ratios(frame.left, where) for where in (frame.label >= 16, frame.label == 1))
    assert rock[0] < ground[0] and rock[1] > ground[1]
    assert frame.left[frame.label == 0].max() == 0


def test_the_lamp_is_as_yellow_as_its_light():
    lamp = LampConfig(power_w=20.0, temperature_k=3000.0)
    config = scene.config(30.0, camera=CAMERA, lens=PERFECT, reflectance=EVEN, lamp=lamp,
                          sun=SunConfig(irradiance=0.0), sensor=RAW)
    found = np.array(ratios(drawn(scene.plane(), config, pitch_deg=10.0).left))
    light = colours.Bands().colour_of_light(3000.0)
    np.testing.assert_allclose(found / light, expected('highland', 10.0), rtol=0.03)


def test_foil_is_golden_and_cells_are_blue_in_the_chase_picture():
    chase = ChaseConfig.from_mapping({'azimuth_deg': -120.0, 'elevation_deg': 50.0,
                                      'distance_m': 0.8})
    world = scene.plane()
    with Renderer(world, scene.ROVER, scene.config(40.0, camera=CAMERA)) as renderer:
        mount = ChaseMount(chase, 90.0, world)
        camera = renderer.add_camera(chase, mount)
        state = RoverPose(scene.pose())
        mount.follow(state)
        image = camera.render(state, 0, ('left', 'label'))
    assert image.encoding == 'rgb8' and image.left.shape == (540, 960, 3)
    body = image.left[image.label == 2].astype(float)
    assert np.percentile(body[:, 0] - body[:, 2], 90) > 60      # foil: red over blue
    assert np.percentile(body[:, 2] - body[:, 0], 95) > 5       # cells: blue over red


def test_every_camera_has_colours():
    """Distorted, supersampled, fisheye; rgb8 is the mosaic, interpolated."""
    world, state = scene.plane(), RoverPose(scene.pose(pitch_deg=20.0))
    eight = dataclasses.replace(RAW, encoding='bayer_rggb8', bits=12)

    def config(**groups):
        return scene.config(30.0, 200.0, lens=PERFECT, reflectance=EVEN,
                            **{'camera': CAMERA, 'sensor': RAW, **groups})
    plain = ratios(drawn(world, config(), pitch_deg=20.0).left)
    for other in (config(camera=dataclasses.replace(CAMERA, distortion=(-0.1, 0, 0, 0, 0))),
                  config(detail=dataclasses.replace(scene.SMOOTH, supersampling=2))):
        assert ratios(drawn(world, other, pitch_deg=20.0).left) == pytest.approx(plain, rel=5e-3)
    with Renderer(world, scene.ROVER, config(sensor=eight)) as renderer:
        mosaic = renderer.render(state, 0, ('left', 'right'))
        hazard = HazardConfig.from_mapping({'sensor': {'encoding': 'rgb8'}})
        fisheye = renderer.add_camera(hazard, HazardMount(hazard)).render(state).left
    with Renderer(world, scene.ROVER, config(
            sensor=dataclasses.replace(eight, encoding='rgb8'))) as renderer:
        image = renderer.render(state, 0, ('left', 'right'))
    for side in ('left', 'right'):
        np.testing.assert_array_equal(interpolated(mosaic.layer(side)), image.layer(side))
        np.testing.assert_array_equal(mosaic.picture(side), image.layer(side))
    assert fisheye.shape == (240, 320, 3)
    lit = fisheye[(fisheye.min(axis=-1) > 40) & (fisheye.max(axis=-1) < 250)].astype(float)
    assert np.median(lit[:, 0]) > np.median(lit[:, 1]) > np.median(lit[:, 2])
