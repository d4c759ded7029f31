"""Parts of the nodes go on from their states as if nothing had happened, bit for bit."""

from collections.abc import Callable
import enum
from pathlib import Path
from typing import Any

import numpy as np
from physics_scene import simulate, trot
import pytest

from lunar_rover_sim.autonomy.navigation.config import MapConfig, NavigatorConfig
from lunar_rover_sim.autonomy.navigation.elevation_map import ElevationMap
from lunar_rover_sim.autonomy.navigation.navigator import Navigator
from lunar_rover_sim.autonomy.navigation.traversability import Traversability
from lunar_rover_sim.autonomy.path_following.config import DriveConfig
from lunar_rover_sim.autonomy.path_following.driver import Driver
from lunar_rover_sim.base.files.state_file import load_state, save_state
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.rover.gait.controller import GaitController
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise
from lunar_rover_sim.sensors.registry import mounted, SensorsConfig
from lunar_rover_sim.sensors.sensor import Platform

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def numbers(value: Any) -> Any:
    """Return a result as something that compares bit for bit, also where it is NaN."""
    if hasattr(value, '__dict__') and not isinstance(value, enum.Enum):
        return {key: numbers(item) for key, item in vars(value).items()}
    if isinstance(value, dict):
        return {key: numbers(item) for key, item in value.items()}
    return (value.dtype.str, value.tobytes()) if isinstance(value, np.ndarray) else repr(value)


def goes_on(make: Callable[[], Any], use: Callable[[Any, int], object], file: Path) -> None:
    """Check that steps 30 to 59 of a thing are those of another one with its state at 30."""
    one, other = make(), make()
    use(other, 7)       # what it has done before does not matter
    for step in range(30):
        use(one, step)
    save_state(file, one.state())
    other.resume(load_state(file))
    for step in range(30, 60):
        assert numbers(use(one, step)) == numbers(use(other, step))


def test_the_gait_goes_on(tmp_path: Path) -> None:
    angles = np.random.default_rng(1).normal(0.0, 0.05, (60, 2, 4))

    def use(gait: GaitController, step: int) -> object:
        if step in (3, 20, 40):
            gait.set_velocity(0.002 * step, 0.1, step * 5_000_000)
        return gait.update(step * 5_000_000, angles[step, 0] + 0.01 * step, angles[step, 1])

    goes_on(GaitController, use, tmp_path / 'state.npz')


def test_the_noise_of_an_imu_goes_on(tmp_path: Path) -> None:
    goes_on(lambda: ImuNoise(ImuConfig(), 200.0, np.random.default_rng(1)),
            lambda imu, step: imu.measure([0.0, 0.1, 1.62], [0.01 * step, 0.0, 0.0]),
            tmp_path / 'state.npz')


@pytest.mark.parametrize('config', [
    DriveConfig(), DriveConfig(mode='waypoints', waypoints_x_m=(0.05, 0.2),
                               waypoints_y_m=(0.0, 0.3))], ids=lambda config: config.mode)
def test_a_drive_goes_on(config: DriveConfig, tmp_path: Path) -> None:
    goes_on(lambda: Driver(config), lambda driver, step: driver.update(
        step * 50_000_000, [0.005 * step, 0.0, 0.0], LEVEL), tmp_path / 'state.npz')


def test_a_map_goes_on(tmp_path: Path) -> None:
    depth = np.random.default_rng(2).uniform(0.6, 2.0, (60, 24, 32)).astype(np.float32)
    K = np.array([[30.0, 0.0, 16.0], [0.0, 30.0, 12.0], [0.0, 0.0, 1.0]])

    def use(elevation_map: ElevationMap, step: int) -> object:
        T = np.array([[0.0, 0.0, 1.0, 0.05 * step], [-1.0, 0.0, 0.0, 0.0],
                      [0.0, -1.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]])
        elevation_map.add_depth(step * 200_000_000, depth[step], K, 0.1, T, T[:3, 3])
        return elevation_map.elevation()

    goes_on(lambda: ElevationMap(MapConfig()), use, tmp_path / 'state.npz')


def test_a_navigator_goes_on(tmp_path: Path) -> None:
    """Around a wall, with a plan, a trail and the memory of what it has seen."""
    cost = np.zeros((120, 120), np.int8)
    cost[50:70, 75] = 100
    config = NavigatorConfig(has_goal=True, goal_x_m=4.0, start_delay_s=0.0)

    def use(navigator: Navigator, step: int) -> object:
        x = 0.03 * step
        corner = np.array([np.round(x / 0.05) * 0.05 - 3.0, -3.0])
        grid = Traversability(1 + step * 200_000_000, corner, 0.05,
                              np.roll(cost, -int(np.round(x / 0.05)), axis=1))
        command = navigator.update(1 + step * 200_000_000, 1 + step * 200_000_000,
                                   [x, 0.0, 0.0], LEVEL, grid)
        return {'command': command, 'plan': navigator.plan, 'left': navigator.left_m([x, 0.0])}

    goes_on(lambda: Navigator(config, 0.2), use, tmp_path / 'state.npz')


def test_the_sensors_of_a_rover_go_on(tmp_path: Path) -> None:
    sun = SunConfig(azimuth_deg=30.0, elevation_deg=40.0)
    with simulate() as simulation:
        def carried() -> dict[str, Any]:
            platform = Platform(simulation, sun, 1, 0.005)
            return {sensor.name: sensor for sensor in mounted(SensorsConfig(), platform)}

        def measured(sensors: dict[str, Any]) -> dict[str, Any]:
            state = simulation.state
            return {name: sensor.measure(state, state.stamp_ns)
                    for name, sensor in sensors.items() if name != 'sinkage'}

        one, other = carried(), carried()
        trot(simulation, 0.3, observe=lambda _: measured(one))
        save_state(tmp_path / 'state.npz', {name: s.state() for name, s in one.items()})
        for name, state in load_state(tmp_path / 'state.npz').items():
            other[name].resume(state)
        seen = []
        trot(simulation, 0.3, observe=lambda _: seen.append(
            numbers(measured(one)) == numbers(measured(other))))
        assert all(seen) and len(seen) == 60
