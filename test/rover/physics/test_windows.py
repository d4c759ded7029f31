"""Windows of a site: the same motion, bit for bit, in whichever of them the rover walks."""

from collections.abc import Mapping
import dataclasses

import mujoco
import numpy as np
from physics_scene import everything, make_world, rough_heights, ROVER, same, simulate, soft, trot
import pytest
from tip_penetration import TipPenetration
from windows_scene import CutSite, window

from lunar_rover_sim.base.errors import ConfigError, GroundLeftError, PhysicsError
from lunar_rover_sim.ground.regolith.overlay import GroundChanges
from lunar_rover_sim.ground.world.grid import height_step_m, HeightGrid, on_lattice
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.rover.physics.config import GroundConfig, StartPose
from lunar_rover_sim.rover.physics.simulation import Simulation

# Three windows meet, and four tiles: the walk begins beside the corner that they share.
AT = (-0.25, 12.75)
HERE, EAST, NORTH = ((0.0, 12.8), (12.8, 12.8), (0.0, 25.6))
GROUNDS = (GroundConfig(), soft(variation=1.0))


def part(middle_m: tuple[float, float]) -> World:
    return window(middle_m, 25.6, AT)


def touches_rock(simulation: Simulation) -> bool:
    geoms = simulation.data.contact.geom
    return bool((simulation.model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_MESH).any())


def walk(world: World, ground: GroundConfig, changes: Mapping[int, World],
         duration_s: float = 3.0, site: CutSite | None = None) -> tuple[
             np.ndarray, GroundChanges | None, bool]:
    """Return all states of a walk, the ground that it leaves, and whether it touches a rock.

    changes: Number of states → window that is entered after it
    """
    start = StartPose(x_m=AT[0], y_m=AT[1], yaw_deg=20.0, settle_s=0.3)
    states, rock = [], False
    with simulate(world, ground=ground, start=start, site=site) as simulation:
        def observe(_: object) -> None:
            nonlocal rock
            states.append(everything(simulation))
            rock = rock or touches_rock(simulation)
            if len(states) in changes:
                simulation.enter(changes[len(states)])

        trot(simulation, duration_s, observe=observe)
        overlay = simulation.overlay
        return np.array(states), overlay.snapshot() if overlay is not None else None, rock


@pytest.mark.parametrize('ground', GROUNDS, ids=lambda ground: ground.model)
def test_a_walk_over_four_changes_of_windows_is_that_in_one_large_window(ground):
    """There and back over the corner of four tiles, among rocks and loose rims."""
    changes = {140: part(EAST), 260: part(HERE), 301: part(NORTH), 433: part(HERE)}
    once, tracks, rock = walk(window((6.4, 19.2), 38.4, AT), ground, {})
    found, found_tracks, _ = walk(part(HERE), ground, changes)
    assert rock and once[0, 1] < 0.0 < once[-1, 1] and once[0, 2] < 12.8 < once[-1, 2]
    np.testing.assert_array_equal(found, once)
    assert tracks is None or (len(tracks) > 500 and same(tracks, found_tracks))


@pytest.mark.parametrize('ground', GROUNDS, ids=lambda ground: ground.model)
def test_the_window_follows_the_rover_by_itself(ground):
    """Windows that are a hand apart change all the time; the walk does not."""
    site = CutSite(AT, step_m=0.1, half_m=14.4)     # whole tiles around the rover
    once, tracks, rock = walk(window((6.4, 19.2), 38.4, AT), ground, {})
    found, found_tracks, _ = walk(window((-0.3, 12.8), 14.4, AT), ground, {}, site=site)
    assert rock and len(set(site.entered_m)) >= 3
    np.testing.assert_array_equal(found, once)
    assert tracks is None or (len(tracks) > 500 and same(tracks, found_tracks))


def test_it_starts_anywhere_on_a_site_and_ends_with_it():
    site = CutSite((128.3, -64.0), step_m=12.8, half_m=6.4, reach_m=128.0)
    world = window((0.0, 0.0), 6.4, (128.3, -64.0))
    with simulate(world, start=StartPose(x_m=128.3, y_m=-64.0), site=site) as simulation:
        assert simulation.world.ground.middle_m == (128.0, -64.0)
        z = simulation.state.position_m[2]
        simulation.move([0.5, 0.2, z + 1.0])
        assert simulation.world.ground.middle_m == (0.0, 0.0)
        for wrong in ([140.0, 0.0, 5.0], [60.0, -40.0, -9.0]):
            before = simulation.state
            with pytest.raises(PhysicsError, match=r'^position: '):
                simulation.move(wrong)
            assert simulation.world.ground.middle_m == (0.0, 0.0) and simulation.state is before
        simulation.reset()
        assert simulation.world.ground.middle_m == (128.0, -64.0)
        simulation.move([134.0, -64.0, z + 2.0], linear_mps=[3.0, 0.0, 0.0])
        with pytest.raises(GroundLeftError, match=r'x = 134\.\d+ m, y = -64\.\d+ m; the site ends '
                                                  'at x = -134.4 and 134.4 m, y = -134.4 and 134'):
            simulation.advance(200)
    with pytest.raises(ConfigError, match='start.x_m: 134.0 is not valid; valid is -133.4 to 133'):
        simulate(world, start=StartPose(x_m=134.0), site=site)


def test_many_steps_at_once_are_many_times_one():
    """A call of a minute enters the windows on the way."""
    site = CutSite(AT, step_m=0.4, half_m=14.4)
    start = StartPose(x_m=0.0, y_m=0.0, settle_s=0.3)
    found = []
    for chunk in (10, 1500):
        with simulate(window((0.0, 0.0), 14.4, AT), start=start, site=site) as simulation:
            simulation.command(4 * [3.0])
            for _ in range(3000 // chunk):
                state = simulation.advance(chunk)
            found.append((*state.position_m, *simulation.world.ground.middle_m))
    assert found[0][3:] != (0.0, 0.0)
    assert found[0] == found[1]


@pytest.mark.parametrize('ground', GROUNDS, ids=lambda ground: ground.model)
def test_a_reset_goes_back_to_the_start_in_the_window_of_the_start(ground):
    """What follows is bit for bit what followed the start."""
    start = StartPose(x_m=AT[0], y_m=AT[1], settle_s=0.3)
    with simulate(part(HERE), ground=ground, start=start) as simulation:
        def leg() -> np.ndarray:
            states = [everything(simulation)]
            trot(simulation, 0.6, observe=lambda _: states.append(everything(simulation)))
            return np.array(states)

        once = leg()
        simulation.enter(part(EAST))
        trot(simulation, 0.2)
        simulation.reset()
        assert simulation.world is part(HERE) and simulation.state.stamp_ns == 0
        np.testing.assert_array_equal(leg(), once)


def test_only_a_window_that_holds_the_rover_on_the_same_ground_is_entered():
    ground = part(HERE).ground
    lifted = dataclasses.replace(ground, heights_m=ground.heights_m + np.float32(0.5))
    with simulate(part(HERE), start=StartPose(x_m=AT[0], y_m=AT[1])) as simulation:
        simulation.enter(window(HERE, 6.4, AT))
        before = simulation.state
        for wrong, said in ((make_world(rough_heights()), 'at nan m'),
                            (part((51.2, 12.8)), 'at nan m'),
                            (dataclasses.replace(part(HERE), levels=(lifted,)), 'at 0.48')):
            with pytest.raises(PhysicsError, match=rf'^enter: the window .*, is {said}.* site '):
                simulation.enter(wrong)
        assert simulation.state is before and simulation.world is window(HERE, 6.4, AT)


def test_the_borders_of_a_window_far_from_the_middle_of_the_site_hold():
    """Start, move and walk are bounded around the middle of the window."""
    middle, at = (793.6, -1203.2), (793.7, -1202.5)
    world = window(middle, 6.4, at)
    with simulate(world, start=StartPose(x_m=at[0], y_m=at[1])) as simulation:
        height = simulation.state.position_m[2]
        assert np.hypot(*(simulation.state.position_m[:2] - at)) < 0.05
        assert height == pytest.approx(world.ground.height_at_point(*at), abs=0.15)
        with pytest.raises(PhysicsError, match='ends at 6.40 m around x = 793.6 m, y = -1203'):
            simulation.move([0.0, 0.0, 5.0])
        simulation.move([799.9, -1203.0, height + 2.0], linear_mps=[3.0, 0.0, 0.0])
        with pytest.raises(GroundLeftError, match=r'x = 800\.\d+ m.* 6.40 m around x = 793.6 m'):
            simulation.advance(100)
    with pytest.raises(Exception, match=r'start.x_m: 1.0 is not valid; valid is 788.2 to 799 '):
        simulate(world, start=StartPose(x_m=1.0))


def test_contact_on_a_seam_is_that_within_a_tile():
    """The same ground, shifted so that seams lie elsewhere: force and depth agree."""
    heights = on_lattice(rough_heights(n=1025, rms_m=0.01), height_step_m(0.025))
    found = []
    for middle in ((0.0, 0.0), (3.2, 6.4)):
        ground = HeightGrid(heights.astype(np.float32), 0.025, middle)
        world = dataclasses.replace(make_world(), levels=(ground,))
        rng, forces = np.random.default_rng(1), []
        start = StartPose(x_m=middle[0], y_m=middle[1] + 2.0, settle_s=0.0)
        with simulate(world, start=start) as simulation:
            tips, legs = TipPenetration(simulation), ROVER.legs
            reach = legs.spoke_length_m
            for k in range(40):
                # A leg stands within a cell of the seam, or of the corner of four tiles.
                axle = legs.axle_positions_m()[k % 4]
                at = rng.normal(0.0, 0.01, 2) * (1.0, k % 2) + (0.0, 5.0 * (1 - k % 2))
                x, y = at - axle[:2] + middle
                z = float(ground.height_at([x, y])) + reach - rng.uniform(0.0, 0.004) - axle[2]
                data = simulation.data
                data.qpos[:3], data.qpos[3:7], data.qvel[:] = (x, y, z), (1.0, 0, 0, 0), 0.0
                data.qpos[7:11] = rng.uniform(-0.2, 0.2, 4)
                mujoco.mj_forward(simulation.model, data)
                forces.append([data.ncon, tips.deepest_m(), *data.qfrc_constraint])
        found.append(np.array(forces))
    assert (found[0][:, 0] > 0).sum() > 20
    np.testing.assert_array_equal(found[0][:, 0], found[1][:, 0])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-4, atol=1e-4)
