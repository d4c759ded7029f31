"""A frame as each scenario draws it, pixel by pixel: no further from its reference than chance.

As pictures of Mitsuba are tested: z-tests of each pixel with its variance, corrected for their
number. What is random is where a pixel lies, within half a pixel, so that edges which move with
the last digits of a processor or with Mesa are within the variance. References hold the mean and
the variance of 32 such pictures, the test draws eight others. The ground is a fixed one without
rocks: what changes a world or the shapes of rocks changes no picture here.

    python -m pytest test/image/rendering/test_pictures.py --force-regen

writes the references anew, after a change that is meant.
"""

import dataclasses
from pathlib import Path

import camera_scene as scene
import cv2
import numpy as np
import pytest
from scipy import stats

from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

# The others have the sun, the ground and the details of `baseline`.
SCENARIOS = ('baseline', 'feature_sparse', 'low_albedo', 'mare_apollo', 'permanent_shadow',
             'rough')
CAMERA = CameraConfig(width=64, height=48)
BLOCK = 8
STORED, DRAWN = 32, 8       # pictures
CHANCE = 0.001              # that a right renderer fails, over all pixels of a frame
FOLDER = Path(__file__).with_suffix('')


def pictures(name, count, seed, **groups):
    """Return (count, h, w) radiance [W m-2 sr-1] at random places within half a pixel."""
    scenario = Scenario.load(name)
    config = dataclasses.replace(scenario.render_node, camera=CAMERA, **groups)
    # Away from the sun, past the shadow of the rover, over hills and a crater.
    state = RoverPose(scene.pose(-0.8, 0.3, 0.2, config.sun.azimuth_deg + 150.0))
    rng = np.random.default_rng(seed)
    with Renderer(scene.plane(heights=scene.hills()), scenario.rover, config, 1) as renderer:
        T, drawn = renderer.rig.T_base_left, []
        for right, down in rng.uniform(-0.5, 0.5, (count, 2)) / renderer.rig.focal_px:
            turn = np.eye(4)
            turn[:3, :3] = cv2.Rodrigues(np.array([down, right, 0.0]))[0]
            moved = dataclasses.replace(
                state, T_world_base=state.T_world_base @ T @ turn @ np.linalg.inv(T))
            drawn.append(renderer.render(moved, 0, ('radiance',)).radiance.astype(float))
    return np.array(drawn)


def blocks(drawn):
    """Return the means of blocks of pixels, (n, h, w)."""
    n, h, w = drawn.shape
    return drawn.reshape(n, h // BLOCK, BLOCK, w // BLOCK, BLOCK).mean(axis=(2, 4))


def moments(drawn):
    """Return mean and variance of pixels and of blocks."""
    return [part for kind in (drawn, blocks(drawn))
            for part in (kind.mean(axis=0), kind.var(axis=0, ddof=1))]


def differing(drawn, reference):
    """Return how many pixels, and how many blocks of them, differ beyond chance.

    The variance of a pixel is the largest of it and its neighbours: few places may all miss an
    edge that others meet.
    """
    found = []
    for kind, (mean, variance) in ((drawn, reference[:2]), (blocks(drawn), reference[2:])):
        own = kind.var(axis=0, ddof=1)
        pooled = ((DRAWN - 1) * own + (STORED - 1) * variance) / (DRAWN + STORED - 2)
        pooled = cv2.dilate(pooled, np.ones((3, 3)))
        floor = (1e-5 * mean.mean())**2     # even ground: the last digits of a processor
        t = np.abs(kind.mean(axis=0) - mean) / np.sqrt(
            pooled * (1.0 / DRAWN + 1.0 / STORED) + floor)
        # Sidak, Journal of the American Statistical Association 62, 1967.
        least = stats.t.isf(0.5 * (1.0 - (1.0 - CHANCE)**(1.0 / t.size)), DRAWN + STORED - 2)
        found.append(int((t > least).sum()))
    return found


def reference_of(name):
    """Return what `moments` returned of the stored pictures."""
    with np.load(FOLDER / f'{name}.npz') as stored:
        return [stored[key].astype(float) for key in ('mean', 'variance', 'blocks', 'of_blocks')]


@pytest.mark.parametrize('name', SCENARIOS)
def test_a_frame_is_its_reference(name, request):
    if request.config.getoption('--force-regen'):
        FOLDER.mkdir(exist_ok=True)
        values = [part.astype(np.float32) for part in moments(pictures(name, STORED, 1))]
        np.savez_compressed(FOLDER / f'{name}.npz', **dict(zip(
            ('mean', 'variance', 'blocks', 'of_blocks'), values)))
    assert differing(pictures(name, DRAWN, 2), reference_of(name)) == [0, 0]


def test_faults_are_found():
    """A pixel's shift, a band that is a tenth too bright, a speck, another height of the sun."""
    drawn, reference = pictures('baseline', DRAWN, 3), reference_of('baseline')
    assert differing(drawn, reference) == [0, 0]
    assert differing(np.roll(drawn, 1, axis=2), reference)[0] > 10
    band, speck = drawn.copy(), drawn.copy()
    band[:, 32:40] *= 1.1
    assert differing(band, reference)[1] > 0
    speck[:, 40, 30] += 2.0 * speck[:, 36:44].max()
    assert differing(speck, reference)[0] > 0
    sun = dataclasses.replace(Scenario.load('baseline').render_node.sun, elevation_deg=6.5)
    assert differing(pictures('baseline', DRAWN, 3, sun=sun), reference)[1] > 0
