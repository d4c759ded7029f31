"""Walks on soft ground: their length, slip and tracks, and that they repeat."""

import numpy as np
from physics_scene import make_world, rough_heights, simulate, soft, trot
import pytest

from lunar_rover_sim.rover.physics.config import StartPose


def test_the_distance_walked_hardly_depends_on_the_step():
    """From 1 ms to 0.25 ms. Means of eight starts differ by 2 to 3 %, single walks scatter by 1 %.

    `validate terramechanics` walks longer, on all soils, and holds it to 3 %.
    """
    distances = []
    for step_s in (0.001, 0.00025):
        with simulate(ground=soft(), step_s=step_s) as simulation:
            before = simulation.state.position_m
            after = trot(simulation, 5.0).position_m
            distances.append(np.linalg.norm((after - before)[:2]))
    assert distances[0] > 0.5
    assert distances[0] == pytest.approx(distances[1], rel=0.05)


def test_softer_soil_lets_feet_sink_deeper_and_slip_more():
    sinkage, slip = [], []
    for preset in ('highland_dense', 'highland', 'highland_loose'):
        with simulate(ground=soft(preset)) as simulation:
            seen = []
            trot(simulation, 2.5, observe=lambda _: seen.append(simulation.ground_contact))
            sinkage.append(np.mean([c.sinkage_m.max() for c in seen]))
            slip.append(np.mean([c.slip_mps.mean() for c in seen]))
    assert sinkage == sorted(sinkage) and slip == sorted(slip)
    assert 0.005 < sinkage[0] and sinkage[2] < 0.06


def test_a_walk_leaves_tracks_that_account_for_their_volume():
    with simulate(make_world(rough_heights()), ground=soft()) as simulation:
        trot(simulation, 4.0)
        overlay = simulation.overlay
        height, compaction = overlay.sums_m()
        snapshot = overlay.snapshot()
        # The feet of the rover at rest are spread over 0.23 m already.
        lane_m = simulation.state.position_m[0] + 0.23
    assert compaction > 0.5
    assert abs(height + compaction + overlay.residue_m) < 1e-12
    # Prints are half a centimetre to a few centimetres deep, rims some millimetres high.
    assert -0.06 < snapshot.height_m.min() < -0.008
    assert 0.0005 < snapshot.height_m.max() < 0.02
    # Both lanes: an hour at 0.12 m/s is 432 m.
    assert overlay.memory_bytes / lane_m * 432.0 < 100 * 2 ** 20


def test_a_walk_north_goes_as_far_as_one_east_and_as_straight():
    """Feet step into older prints. Walks scatter by 1 % ahead, 2 % aside, from start to start."""
    ways, depths = [], []
    for yaw_deg in (0.0, 90.0):
        with simulate(ground=soft(), start=StartPose(yaw_deg=yaw_deg)) as simulation:
            before = simulation.state.position_m
            way = trot(simulation, 3.0).position_m - before
            depths.append(np.percentile(simulation.overlay.snapshot().height_m, 2.0))
        turn = np.radians(yaw_deg)
        ways.append(way[:2] @ [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    (east, aside_east), (north, aside_north) = ways
    assert east == pytest.approx(north, rel=0.03) and east > 0.3
    assert max(abs(aside_east), abs(aside_north)) < 0.06 * east
    assert depths[0] == pytest.approx(depths[1], rel=0.25)


def test_the_same_commands_give_the_same_ground():
    def record(simulation):
        states = []
        trot(simulation, 1.5, observe=lambda s: states.append(s.position_m))
        return np.array(states), simulation.overlay.snapshot()

    world = make_world(rough_heights())
    with simulate(world, ground=soft()) as simulation:
        start = simulation.overlay.snapshot()
        first = record(simulation)
        simulation.reset()
        assert np.array_equal(simulation.overlay.snapshot().height_m, start.height_m)
        again = record(simulation)
    with simulate(world, ground=soft()) as simulation:
        other = record(simulation)
    for states, snapshot in (again, other):
        assert np.array_equal(states, first[0])
        assert np.array_equal(snapshot.index, first[1].index)
        assert snapshot.height_m.tobytes() == first[1].height_m.tobytes()


MOVED_M = 1e-12


@pytest.mark.parametrize('preset', ['highland', 'highland_loose'])
def test_a_walk_on_untouched_soil_does_not_amplify_rounding(preset):
    """Over hills: 1e-8 m after 5 s is asked; two runs of 3 s are 1e-9 m apart at most here.

    A law that switches between forces is 3 mm off after a quarter of a second.
    """
    world, ends = make_world(rough_heights(3)), []
    for moved in (0.0, MOVED_M):
        with simulate(world, ground=soft(preset), start=StartPose(x_m=0.3, y_m=-0.2)) as walk:
            walk.data.qpos[0] += moved
            ends.append(trot(walk, 3.0).position_m)
    assert np.linalg.norm(ends[0][:2] - [0.3, -0.2]) > 0.2
    assert np.linalg.norm(ends[1] - ends[0]) < 1e-8
