"""A sensor of your own, in Python: an inclinometer with noise, read while the rover walks.

As a sensor of the simulator, with a topic of its own: CONTRIBUTING.md, "A sensor".
"""

import numpy as np

from lunar_rover_sim import Scenario
from lunar_rover_sim.base.frames import rpy_from_wxyz


class Inclinometer:
    """Noisy roll and pitch of base_link at a rate of its own."""

    def __init__(self, rng: np.random.Generator, rate_hz: int = 10, noise_deg: float = 0.1):
        self._rng, self._noise_deg, self._period_ns = rng, noise_deg, 1_000_000_000 // rate_hz
        self._due_ns = self._period_ns

    def read(self, state) -> np.ndarray | None:
        """Return roll and pitch [deg]; None while no reading is due."""
        if state.stamp_ns < self._due_ns:
            return None
        self._due_ns += self._period_ns
        roll_pitch = np.degrees(rpy_from_wxyz(state.orientation_wxyz)[:2])
        return roll_pitch + self._noise_deg * self._rng.standard_normal(2)


def main(duration_s: float = 3.0) -> np.ndarray:
    """Walk, and return the readings (n, 2) [deg]."""
    scenario = Scenario.load('baseline')
    sensor = Inclinometer(np.random.default_rng(scenario.shared.seed))
    gait = scenario.gait_controller()
    gait.set_velocity(0.12, 0.0)
    readings = []
    with scenario.simulation(scenario.load_world()) as simulation:
        state = simulation.state
        while state.stamp_ns < duration_s * 1e9:
            legs = gait.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(5)
            reading = sensor.read(state)
            if reading is not None:
                readings.append(reading)
    found = np.array(readings)
    print(f'{len(found)} readings; roll, pitch: mean {found.mean(axis=0).round(2)} deg, standard '
          f'deviation {found.std(axis=0).round(2)} deg')
    return found


if __name__ == '__main__':
    main()
