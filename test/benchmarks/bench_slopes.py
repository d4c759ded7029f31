"""Tilt of walks on slopes of soft ground: straight, in arcs, and turning on the spot.

    python test/benchmarks/bench_slopes.py --slopes 8 13
    python test/benchmarks/bench_slopes.py --slopes 13 --let-down-above 28
"""

import argparse
import math

from lunar_rover_sim.autonomy.navigation.rearing import Rearing
from lunar_rover_sim.base.frames import matrix_from_wxyz, tilt_deg
from lunar_rover_sim.judge.studies.walking import sloping_world, walk
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.run.scenario import Scenario

HEADINGS_DEG = (0.0, 90.0, 180.0)       # 0 is uphill
COMMANDS = ((0.12, 0.0), (0.12, 0.15), (0.045, 0.15), (0.0, 0.15))


def tilts(slope_deg: float, heading_deg: float, command: tuple[float, float],
          duration_s: float, limit_deg: float) -> list[float]:
    """Return the tilt [deg] at each state of a walk; a body above the limit is let down."""
    scenario = Scenario.load('baseline', [f'physics_node.start.yaw_deg={heading_deg}'])
    found, rearing = [], Rearing(limit_deg, 0)
    world = sloping_world(slope_deg, 3.0)
    with Simulation(world, scenario.rover, scenario.physics_node) as walked:
        def say(controller, stamp_ns):
            found.append(float(tilt_deg(matrix_from_wxyz(walked.state.orientation_wxyz))))
            rearing.note_tilt(stamp_ns, found[-1])
            velocity = rearing.let_down(stamp_ns)
            if velocity is None:
                rearing.note_motion(*command)
            controller.set_velocity(*(command if velocity is None else velocity), stamp_ns)
        walk(walked, scenario.gait_controller(), duration_s, say)
    return found


def main() -> None:
    """Print a table of the greatest tilt of each walk [deg], a heading after the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--slopes', nargs='+', type=float, default=[8.0, 13.0])
    parser.add_argument('--duration', type=float, default=20.0)
    parser.add_argument('--let-down-above', type=float, default=math.inf)
    given = parser.parse_args()
    print('| slope [deg] |', ' | '.join(f'{v:g} m/s, {w:g} rad/s' for v, w in COMMANDS), '|')
    print('|---' * (1 + len(COMMANDS)) + '|')
    for slope in given.slopes:
        print(f'| {slope:g} |', ' | '.join(', '.join(
            f'{max(tilts(slope, heading, command, given.duration, given.let_down_above)):.1f}'
            for heading in HEADINGS_DEG) for command in COMMANDS), '|', flush=True)


if __name__ == '__main__':
    main()
