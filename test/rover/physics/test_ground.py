"""What MuJoCo collides with is the world's own surface."""

import dataclasses

import mujoco
import numpy as np
from physics_scene import GRAVITY, make_world, rough_heights, simulate
import pytest
from windows_scene import octahedron

from lunar_rover_sim.base.errors import ConfigError, PhysicsError
from lunar_rover_sim.base.frames import matrix_from_wxyz, wxyz_from_rpy
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape
from lunar_rover_sim.rover.physics.config import GroundConfig, StartPose
from lunar_rover_sim.run.scenario import Scenario


def ray_heights(simulation, xy: np.ndarray) -> np.ndarray:
    """Return the heights [m] where rays straight down from (n, 2) positions hit the world."""
    model, data = simulation.model, simulation.data
    # Group 0 is the world; the rover's geoms are in group 1.
    groups = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
    geom, down = np.zeros(1, dtype=np.int32), np.array([0.0, 0.0, -1.0])
    return np.array([50.0 - mujoco.mj_ray(model, data, np.array([x, y, 50.0]), down, groups, 1, -1,
                                          geom) for x, y in xy])


def test_a_simulation_of_a_scenario_may_be_on_another_world(monkeypatch):
    own, other = make_world(), make_world(np.full((401, 401), 2.0))
    monkeypatch.setattr(Scenario, 'load_world', lambda self: own)
    scenario = Scenario.load('flat')
    for world, height_m in ((None, 0.0), (other, 2.0)):
        with scenario.simulation(world) as simulation:
            assert 0.0 < simulation.state.position_m[2] - height_m < 0.2


@pytest.mark.parametrize('lift_m', [0.0, 12.0])
def test_rays_hit_the_height_of_the_world(lift_m):
    world = make_world(rough_heights(rms_m=0.3) + lift_m)
    limit = world.ground.half_extent_m - 0.01
    xy = np.random.default_rng(5).uniform(-limit, limit, (10_000, 2))
    with simulate(world, start=StartPose(settle_s=0.0)) as simulation:
        np.testing.assert_allclose(ray_heights(simulation, xy), world.height_at(xy), atol=1e-3)


def test_a_barely_uneven_ground_keeps_its_heights():
    heights = np.zeros((401, 401))
    heights[200, 210] = 0.003
    world = make_world(heights)
    with simulate(world) as simulation:
        height = ray_heights(simulation, np.array([[0.25, 0.0]]))[0]
        assert height == pytest.approx(0.003, abs=2e-6)


def test_feet_stand_where_the_drawn_surface_is():
    world = make_world(rough_heights())
    with simulate(world) as simulation:
        data = simulation.data
        for touch in data.contact:
            # The contact point lies halfway between the surface and the sunken tip.
            assert touch.pos[2] == pytest.approx(world.height_at(touch.pos[:2]), abs=1.5e-3)


def rocks_at(positions: list[list[float]], quat: list[float] | None = None) -> Rocks:
    n = len(positions)
    size = np.arange(n, dtype=np.int32) % 2
    return Rocks(np.zeros(n, np.int32), size, np.array(positions, float),
                 np.tile(quat or [1.0, 0.0, 0.0, 0.0], (n, 1)), np.ones(n, np.float32),
                 np.array([0.2, 0.6]))


def test_rocks_are_where_the_world_says():
    rocks = rocks_at([[2.0, 1.0, 0.05], [-2.0, 1.0, 0.1], [2.0, -2.0, 0.0]])
    world = make_world(rocks=rocks, shapes=(octahedron(),))
    with simulate(world) as simulation:
        # Beside the tips of the octahedra: |x| + |y| + |z| is half the diameter on a face.
        heights = ray_heights(simulation, np.array([[2.01, 1.02], [-2.03, 1.01], [2.01, -2.02],
                                                    [-2.01, 1.15], [3.0, 3.0]]))
        # Meshes are shared by rocks of one shape and size.
        assert simulation.model.nmesh == 2
    np.testing.assert_allclose(heights, [0.12, 0.36, 0.07, 0.24, 0.0], atol=1e-5)


def top_of_triangles(xy: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the greatest height of (t, 3, 3) triangles over (n, 2) positions; NaN beside them."""
    a, b, c = (triangles[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    result = np.full(len(xy), -np.inf)
    for i, point in enumerate(xy):
        inside = np.ones(len(triangles), bool)
        for p, q in ((a, b), (b, c), (c, a)):
            side = (q[:, 0] - p[:, 0]) * (point[1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (
                point[0] - p[:, 0])
            inside &= side * np.sign(normal[:, 2]) >= 0.0
        for t in np.flatnonzero(inside):
            drop = normal[t, :2] @ (point - a[t, :2]) / normal[t, 2]
            result[i] = max(result[i], a[t, 2] - drop)
    return np.where(np.isfinite(result), result, np.nan)


def test_lopsided_turned_rocks_are_where_the_world_says():
    """MuJoCo moves meshes into their principal axes; that must not show."""
    vertices = np.array([[0.6, 0.0, -0.2], [-0.4, 0.3, -0.2], [-0.4, -0.3, -0.15],
                         [0.05, 0.1, 0.5]], dtype=np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype=np.int32)
    quat = np.array([0.8, 0.3, -0.4, 0.33])
    quat /= np.linalg.norm(quat)
    rocks = rocks_at([[2.0, 1.0, 0.3], [-2.0, 1.0, 0.4]], list(quat))
    shape = RockShape('lopsided', vertices, faces)
    with simulate(make_world(rocks=rocks, shapes=(shape,))) as simulation:
        for position, diameter in zip(rocks.position_m, rocks.diameter_m):
            corners = position + diameter * vertices @ matrix_from_wxyz(quat).T
            xy = position[:2] + diameter * np.random.default_rng(2).uniform(-0.4, 0.4, (200, 2))
            expected = top_of_triangles(xy, corners[faces])
            assert np.isfinite(expected).sum() > 20
            np.testing.assert_allclose(ray_heights(simulation, xy), np.nan_to_num(expected),
                                       atol=1e-5)


def test_a_rock_in_the_way_lifts_a_leg_and_is_not_walked_through():
    rocks = rocks_at([[0.0, 0.105, 0.0]])
    world = make_world(rocks=rocks, shapes=(octahedron(),))
    start = StartPose(x_m=-0.115, settle_s=3.0)
    with simulate(world, start=start) as simulation:
        state = simulation.state
        assert all(touch.dist > -0.01 for touch in simulation.data.contact)
    # The front left leg stands on the rock's top, so the rover leans back and to the right.
    assert state.position_m[2] > 0.1


@pytest.mark.parametrize('name', ['x_m', 'y_m'])
def test_a_start_off_the_ground_is_refused(name):
    with pytest.raises(ConfigError, match=rf'start.{name}: 7.0 is not valid; valid is -4 to 4'):
        simulate(start=StartPose(**{name: 7.0}))


def test_a_start_where_the_rover_cannot_stand_is_refused():
    rocks = rocks_at([[9.0, 9.0, 0.0], [0.0, 0.3, 0.0]])
    big = dataclasses.replace(rocks, size_classes_m=np.array([0.2, 1.4]))
    world = make_world(rocks=big, shapes=(octahedron(),))
    with pytest.raises(ConfigError, match=r'start: the rover does not stand at x_m = 0, y_m = 0'):
        simulate(world, start=StartPose(settle_s=3.0))


def test_leaving_the_ground_ends_the_run_with_a_place():
    with simulate() as simulation:
        simulation.data.qpos[:3] = 4.99, 0.0, 0.2
        simulation.data.qvel[0] = 3.0
        with pytest.raises(PhysicsError, match=r'base_link left the ground at x = 5.0\d m'):
            simulation.advance(10)


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_commands_must_be_finite(value):
    with simulate() as simulation:
        with pytest.raises(PhysicsError, match='valid is 4 finite velocities'):
            simulation.command([0.0, value, 0.0, 0.0])
        with pytest.raises(PhysicsError, match='valid is 4 finite velocities'):
            simulation.command([0.0, 1.0])
        with pytest.raises(PhysicsError, match="command: 'fast' is not valid"):
            simulation.command('fast')


@pytest.mark.parametrize('steps', [0, -1, 2.5, 'five'])
def test_the_number_of_steps_is_a_whole_one(steps):
    with simulate() as simulation:
        with pytest.raises(PhysicsError, match=f'advance: {steps!r} is not valid; valid is a w'):
            simulation.advance(steps)
        assert simulation.advance(np.int64(1)).stamp_ns == simulation.config.step_ns


@pytest.mark.parametrize('model, told', [
    ('rigid', r'diverged at 0.05\d s in body \w+'),
    ('regolith', r'at 0.05\d s tip \d of leg \w+ has diverged: \S+ m deep, \S+ N')])
@pytest.mark.parametrize('value', [np.nan, 1e9])
def test_divergence_names_time_and_body(value, model, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with simulate(ground=GroundConfig(model=model)) as simulation:
        simulation.advance(50)
        simulation.data.qvel[7] = value
        with pytest.raises(PhysicsError, match=told):
            simulation.advance(5)
        # After a reset it runs again, and nothing was left in the working directory.
        assert np.isfinite(simulation.reset().position_m).all()
        simulation.advance(5)
    assert list(tmp_path.iterdir()) == []


def test_a_closed_simulation_says_so():
    simulation = simulate()
    simulation.close()
    with pytest.raises(PhysicsError, match='the simulation is closed'):
        simulation.advance(1)
    with pytest.raises(PhysicsError, match='the simulation is closed'):
        simulation.command(np.zeros(4))


YAW_90 = wxyz_from_rpy(0.0, 0.0, np.pi / 2)


def test_the_rover_stands_where_it_was_put() -> None:
    """It rests there at its height; the IMU reads gravity alone, also across the jump."""
    with simulate() as simulation:
        height_m = simulation.state.position_m[2]
        state = simulation.move([1.5, -2.0, height_m], 1.0009 * np.array(YAW_90))
        np.testing.assert_allclose(state.orientation_wxyz, YAW_90, atol=1e-9)
        assert np.allclose(state.position_m, [1.5, -2.0, height_m])
        after = simulation.advance(5)
        assert np.linalg.norm(after.specific_force_mps2) == pytest.approx(GRAVITY, abs=0.2)
        assert np.abs(after.imu_rate_radps).max() < 0.1
        for _ in range(100):
            after = simulation.advance(5)
        assert np.allclose(after.position_m, [1.5, -2.0, height_m], atol=2e-3)
        assert abs(after.orientation_wxyz @ YAW_90) == pytest.approx(1.0, abs=1e-4)


def test_velocities_are_in_world_axes() -> None:
    """A rover in flight that looks to the left and moves east moves to its own right."""
    with simulate() as simulation:
        state = simulation.move([0.0, 0.0, 5.0], YAW_90, [1.0, 0.0, 0.0], [0.0, 0.0, 0.5])
        assert np.allclose(state.linear_velocity_mps, [0.0, -1.0, 0.0], atol=1e-12)
        flown = simulation.advance(500)
        assert flown.position_m[0] == pytest.approx(0.5, abs=0.02)
        assert flown.position_m[2] == pytest.approx(5.0 - 0.5 * GRAVITY * 0.25, abs=0.02)
        assert flown.angular_velocity_radps[2] == pytest.approx(0.5, abs=0.05)


def test_the_imu_feels_weight_at_rest_and_nothing_in_flight() -> None:
    """Whatever the interval; but the circle on which it turns about the centre of mass."""
    with simulate(make_world(np.zeros((121, 121)))) as simulation:
        for steps in (1, 5, 20):
            state = simulation.advance(steps)
            np.testing.assert_allclose(state.specific_force_mps2, [0.0, 0.0, GRAVITY], atol=0.03)
            np.testing.assert_allclose(state.imu_rate_radps, 0.0, atol=0.01)
        state = simulation.move([0.0, 0.0, 1.0], YAW_90, [0.3, 0.0, 0.0], [0.1, -0.2, 0.5])
        np.testing.assert_allclose(state.angular_velocity_radps, [-0.2, -0.1, 0.5])
        np.testing.assert_allclose(state.linear_velocity_mps, [0.0, -0.3, 0.0], atol=1e-12)
        for steps in (1, 5, 20):
            state = simulation.advance(steps)
            assert np.abs(state.specific_force_mps2).max() < 0.1
            np.testing.assert_allclose(state.imu_rate_radps, [-0.2, -0.1, 0.5], atol=0.02)


@pytest.mark.parametrize(('given', 'said'), [
    *(({name: [0.0] * wrong}, f'valid is {count} finite numbers')
      for name, count in (('position_m', 3), ('orientation_wxyz', 4), ('linear_mps', 3),
                          ('angular_radps', 3)) for wrong in (count - 1, count + 1)),
    ({'position_m': [0.0, 0.0, -1.0]}, 'in the ground or in a rock; raise it'),
    ({'position_m': [0.0, 0.0, 0.03]}, 'in the ground or in a rock; raise it'),
    ({'position_m': [99.0, 0.0, 1.0]}, 'is not on the ground; the ground ends at'),
    ({'position_m': [np.nan, 0.0, 1.0]}, 'valid is 3 finite numbers'),
    ({'orientation_wxyz': [0.0] * 4}, 'valid is a unit quaternion'),
    ({'linear_mps': [1e3, 0.0, 0.0]}, 'valid is less than'),
])
def test_nonsense_is_refused_and_changes_nothing(given: dict[str, list[float]],
                                                 said: str) -> None:
    """The next states are those of an untouched simulation."""
    with simulate() as simulation, simulate() as untouched:
        with pytest.raises(PhysicsError, match=said):
            simulation.move(**given)
        assert np.array_equal(simulation.advance(20).position_m,
                              untouched.advance(20).position_m)


def test_soft_ground_is_refused() -> None:
    """It remembers where each leg stood."""
    with simulate(ground=GroundConfig(model='regolith')) as simulation:
        with pytest.raises(PhysicsError, match='valid is rigid ground'):
            simulation.move([0.0, 0.0, 1.0])
