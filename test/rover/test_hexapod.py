"""The six-legged rover: what has a value per leg follows from the list in its file."""

import dataclasses
from pathlib import Path
from xml.etree import ElementTree

import camera_scene as scene
import mujoco
import numpy as np
import pytest

from lunar_rover_sim.base import topics
from lunar_rover_sim.image.camera.chase import ChaseCameraConfig, ChaseConfig, ChaseMount
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.labels import (class_names, LABEL_ROVER, link_label,
                                                    rover_links)
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.judge.studies.walking import flat_world, STATE_PERIOD_S, Walk, walk
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.mjcf import rover_spec
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.rover.urdf import urdf
from lunar_rover_sim.rover.visual import link_poses, visual_parts
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.sensors.wheel_odometry import (Rolling, RollingFeet, WheelOdometry,
                                                    WheelOdometryConfig)

ROVER = load_rover('hexapod')
LEGS = ROVER.legs.names


def test_six_legs_of_two_and_a_half_kilograms():
    """The mass of Lunar Zebro, on a sheet of A4 (0.297 m x 0.210 m)."""
    assert len(LEGS) == 6 and ROVER.total_mass_kg == pytest.approx(2.5)
    axles = np.array(ROVER.legs.axle_positions_m())
    assert np.ptp(axles[:, 0]) < 0.297 and np.ptp(axles[:, 1]) <= 0.21


def test_its_gait_is_the_alternating_tripod():
    """Front and rear of a side step with the middle leg of the other side."""
    phase = dict(zip(LEGS, GaitConfig().offsets(ROVER.legs)))
    first = {leg for leg in LEGS if phase[leg] == 0.0}
    assert first == {'front_left', 'middle_right', 'rear_left'}
    assert all(phase[leg] == 0.5 for leg in set(LEGS) - first)
    assert GaitConfig(gait='trot').offsets(ROVER.legs) == tuple(phase.values())


def test_the_crawl_lifts_one_leg_after_the_other():
    offsets = sorted(GaitConfig(gait='crawl').offsets(ROVER.legs))
    np.testing.assert_allclose(offsets, np.arange(6) / 6.0, atol=1e-12)


def test_models_have_its_masses_joints_and_motors():
    model = rover_spec(ROVER).compile()
    assert model.nu == 6 and model.body_mass.sum() == pytest.approx(ROVER.total_mass_kg)
    assert [model.joint(i + 1).name for i in range(6)] == list(ROVER.legs.joint_names)
    robot = ElementTree.fromstring(urdf(ROVER).encode())
    masses = [float(mass.attrib['value']) for mass in robot.iter('mass')]
    assert sum(masses) == pytest.approx(ROVER.total_mass_kg)
    assert [joint.attrib['name'] for joint in robot.findall('joint')][:6] == \
        list(ROVER.legs.joint_names)
    data = mujoco.MjData(model)
    data.qpos[3] = 1.0
    mujoco.mj_kinematics(model, data)
    for leg, pose in link_poses(ROVER).items():
        np.testing.assert_allclose(data.body(leg).xpos, pose[:3, 3], atol=1e-12)


def test_every_leg_is_drawn():
    assert {part.link for part in visual_parts(ROVER)} == {'base_link', *LEGS}


def test_each_leg_has_its_topics():
    names = {topic.name for topic in topics.of_legs(topics.CONTRACT, LEGS)}
    assert {f'contacts/{leg}' for leg in LEGS} | {f'power/{leg}' for leg in LEGS} <= names
    assert topics.legs_of(f'/rover/{name}' for name in names) == tuple(sorted(LEGS))
    assert not any(topics.LEG in name for name in names)


def test_its_odometry_stands_on_the_tripods():
    """Straight on, the way is that of the legs; legs of the other tripod do not count."""
    swing, aside = np.linspace(-0.3, 0.3, 400), np.linspace(0.9, 1.0, 400)
    first = np.array([offset == 0.0 for offset in GaitConfig().offsets(ROVER.legs)])

    def way(angles: np.ndarray) -> tuple[float, float]:
        feet = RollingFeet(ROVER, 2048)
        rolled = [feet.add(row) for row in angles]
        return sum(one.forward_m for one in rolled), sum(one.yaw_rad for one in rolled)

    straight = way(np.repeat(swing[:, None], 6, axis=1))
    assert straight[0] > 0.0 and straight[1] == pytest.approx(0.0, abs=1e-9)
    carried = way(np.where(first, swing[:, None], aside[:, None]))
    assert carried == pytest.approx(straight, rel=1e-9, abs=1e-9)
    left = np.array(ROVER.legs.on_left)
    assert way(np.where(left, -swing[:, None], swing[:, None]))[1] > 0.1


def test_it_stands_walks_at_the_commanded_speed_and_turns():
    """With its own table, on flat rigid ground."""
    scenario = Scenario.load('flat', rover='hexapod')
    controller = scenario.gait_controller()
    assert controller.calibration.conditions['legs'] == 6
    with Simulation(flat_world(4.0), ROVER, scenario.physics_node) as simulation:
        still = walk(simulation, controller, 1.0, lambda *_: None)
        assert still.position_m[-1, 2] == pytest.approx(ROVER.standing_height_m, abs=0.003)
        ahead = walk(simulation, controller, 9.0, lambda gait, stamp_ns: gait.set_velocity(
            0.1, 0.0, stamp_ns))
        forward, yaw_rate = ahead.mean_velocity(3.0, 9.0)
        assert forward == pytest.approx(0.1, abs=0.012) and abs(yaw_rate) < 0.0225
        assert np.abs(np.degrees(ahead.rpy_rad[:, :2])).max() < 10.0
        turned = walk(simulation, controller, 9.0, lambda gait, stamp_ns: gait.set_velocity(
            0.0, 0.15, stamp_ns))
        assert turned.mean_velocity(3.0, 9.0)[1] == pytest.approx(0.15, abs=0.0225)
    # Its own scales are means over random drives on rough ground. A turn on the spot gives more
    # than they say; those of the quad would tell half of it.
    ways = np.linalg.norm(ahead.position_m[-1, :2] - ahead.position_m[0, :2])
    turns = np.unwrap(turned.rpy_rad[:, 2])[-1] - turned.rpy_rad[0, 2]
    told = [counted(drive, ROVER.name) for drive in (ahead, turned)]
    assert told[0][0] == pytest.approx(ways, rel=0.05)
    assert counted(turned, 'quad')[2] < 0.6 * turns < told[1][2] < turns


def test_it_turns_as_commanded_on_soil():
    """With its own table of `highland`; that of rigid ground gives half of this yaw rate."""
    scenario = Scenario.load('flat', ['physics_node.ground.model=regolith',
                                      'physics_node.ground.preset=highland'], rover='hexapod')
    controller = scenario.gait_controller()
    assert controller.calibration.conditions['ground'] == 'highland'
    with scenario.simulation(flat_world(4.0)) as simulation:
        curve = walk(simulation, controller, 9.0, lambda gait, stamp_ns: gait.set_velocity(
            0.12, 0.1, stamp_ns))
    forward, yaw_rate = curve.mean_velocity(3.0, 9.0)
    assert forward == pytest.approx(0.12, abs=0.015) and yaw_rate == pytest.approx(0.1, abs=0.025)


def counted(drive: Walk, rover: str) -> np.ndarray:
    """Return x, y [m] and yaw [rad] that the encoders tell, with the scales of a rover."""
    config = WheelOdometryConfig()
    odometry = WheelOdometry(ROVER, config.counts_per_turn, Rolling.of(config, 'rigid', rover))
    for angles in drive.joint_angle_rad:
        odometry.add(angles, STATE_PERIOD_S)
    return odometry.pose


def test_a_camera_beside_it_sees_each_leg() -> None:
    """From both sides together; labels name the legs one by one."""
    config = RenderConfig(camera=CameraConfig(width=64, height=48), detail=scene.SMOOTH,
                          sun=SunConfig(azimuth_deg=-60.0, elevation_deg=30.0))
    chase = ChaseConfig(camera=ChaseCameraConfig(width=320, height=180), distance_m=0.9,
                        azimuth_deg=0.0, elevation_deg=25.0)
    state = RoverPose(scene.pose(0.0, 0.0, 0.12, 10.0), np.linspace(0.0, 1.5, 6))
    seen = set[int]()
    with Renderer(scene.plane(), ROVER, config) as renderer:
        for azimuth_deg in (70.0, -70.0):
            mount = ChaseMount(dataclasses.replace(chase, azimuth_deg=azimuth_deg), -60.0,
                               renderer.world)
            mount.follow(state)
            frame = renderer.add_camera(chase, mount).render(state, 0, ('label', 'depth'))
            label = frame.label
            assert label is not None and frame.depth_m is not None
            seen |= set(np.unique(label).tolist())
            assert 0.3 < frame.depth_m[rover_links(label)].min() < 0.9
    assert {LABEL_ROVER, *(link_label(1 + k) for k in range(6))} <= seen
    names = class_names(0, LEGS)
    assert names[link_label(3)] == f'rover {LEGS[2]} leg'.replace('_', ' ')


def test_its_stage_has_six_motors(tmp_path: Path) -> None:
    """A USD of it weighs what MuJoCo weighs, and each axle is where MuJoCo has it."""
    pytest.importorskip('pxr')
    from pxr import Usd, UsdPhysics

    from lunar_rover_sim.products.usd.rover_stage import write_rover
    stage = Usd.Stage.Open(str(write_rover(ROVER, tmp_path / 'hexapod.usda')))
    model = rover_spec(ROVER).compile()
    masses = [UsdPhysics.MassAPI(stage.GetPrimAtPath(f'/Rover/{name}')).GetMassAttr().Get()
              for name in ('base_link', *LEGS)]
    assert sum(masses) == pytest.approx(ROVER.total_mass_kg)
    for leg in LEGS:
        joint = UsdPhysics.RevoluteJoint.Get(stage, f'/Rover/joints/{leg}_joint')
        assert np.allclose(joint.GetLocalPos0Attr().Get(), model.body(leg).pos, atol=1e-7)
        assert UsdPhysics.DriveAPI(joint.GetPrim(), 'angular').GetMaxForceAttr().Get() == \
            pytest.approx(ROVER.motor.leg_stall_torque_nm)
