"""An estimator of your own, judged: dead reckoning from the commanded velocity.

It believes that the rover does as it is told. What slip and turns leave of that is the error.
"""

import numpy as np

from lunar_rover_sim import evaluate, Scenario, Trajectory
from lunar_rover_sim.base.frames import wxyz_from_rpy

FORWARD_MPS, YAW_RATE_RADPS = 0.12, 0.1


def dead_reckoning(stamps_ns: np.ndarray) -> Trajectory:
    """Return the arc that the command describes, from the stamps (n,) [ns] on."""
    t = (stamps_ns - stamps_ns[0]) * 1e-9
    yaw = YAW_RATE_RADPS * t
    radius_m = FORWARD_MPS / YAW_RATE_RADPS
    positions = np.stack([radius_m * np.sin(yaw), radius_m * (1.0 - np.cos(yaw)), 0.0 * t], axis=1)
    return Trajectory(stamps_ns, positions, np.array([wxyz_from_rpy(0.0, 0.0, a) for a in yaw]),
                      'dead reckoning')


def main(duration_s: float = 5.0) -> float:
    """Walk an arc; return the absolute trajectory error [m]."""
    scenario = Scenario.load('baseline')
    gait = scenario.gait_controller()
    gait.set_velocity(FORWARD_MPS, YAW_RATE_RADPS)
    states = []
    with scenario.simulation(scenario.load_world()) as simulation:
        state = simulation.state
        while state.stamp_ns < duration_s * 1e9:
            legs = gait.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(5)
            states.append(state)
    truth = Trajectory.of_states(states)
    result = evaluate(truth, dead_reckoning(truth.stamps_ns))
    print(result)
    return result.ate_m.rmse


if __name__ == '__main__':
    main()
