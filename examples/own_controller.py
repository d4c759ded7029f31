"""Drive to a point with a controller of your own, in physics alone: many times real time.

As a node, in lockstep with all others: docs/tutorials/controller.md.
"""

import math
import sys

from lunar_rover_sim import Scenario
from lunar_rover_sim.base.frames import rpy_from_wxyz

NEAR_M = 0.05


def command(position_m, yaw_rad: float, goal_m: tuple[float, float]) -> tuple[float, float]:
    """Return speed [m/s] and yaw rate [rad/s]: turn towards the goal, slow down beside it."""
    away_m = math.hypot(goal_m[0] - position_m[0], goal_m[1] - position_m[1])
    heading = math.atan2(goal_m[1] - position_m[1], goal_m[0] - position_m[0])
    error_rad = math.remainder(heading - yaw_rad, 2.0 * math.pi)
    return min(0.12, away_m) * max(0.0, math.cos(error_rad)), max(-0.3, min(0.3, error_rad))


def main(x_m: float, y_m: float, longest_s: float = 60.0) -> float:
    """Walk to a point on flat ground; return how far away from it the rover ends [m]."""
    scenario = Scenario.load('flat')
    gait = scenario.gait_controller()
    with scenario.simulation(scenario.load_world()) as simulation:
        state = simulation.state
        away_m = math.inf
        while away_m > NEAR_M and state.stamp_ns < longest_s * 1e9:
            yaw_rad = float(rpy_from_wxyz(state.orientation_wxyz)[2])
            gait.set_velocity(*command(state.position_m, yaw_rad, (x_m, y_m)))
            for _ in range(10):     # a command every 50 ms
                legs = gait.update(state.stamp_ns, state.joint_angle_rad,
                                   state.joint_velocity_radps)
                simulation.command(legs.velocity_radps)
                state = simulation.advance(5)
            away_m = math.hypot(x_m - state.position_m[0], y_m - state.position_m[1])
    print(f'{away_m:.3f} m from the goal after {state.stamp_ns * 1e-9:.1f} s')
    return away_m


if __name__ == '__main__':
    main(*(map(float, sys.argv[1:3]) if len(sys.argv) > 2 else (1.0, 0.5)))
