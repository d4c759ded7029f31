"""The learning study: policies held against the packaged gait on seeds that no training saw.

Each walker follows one velocity command over the relief of regolith, as the nodes would make it
walk: a state every 5 ms, each answered. All walkers have the same worlds and commands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
import functools
import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np

from lunar_rover_sim.autonomy.learning.controller import PolicyController
from lunar_rover_sim.autonomy.learning.follow import FollowConfig
from lunar_rover_sim.autonomy.learning.policy_file import policy_path
from lunar_rover_sim.autonomy.learning.randomisation import physics_of, terrain
from lunar_rover_sim.autonomy.learning.senses import Sample
from lunar_rover_sim.autonomy.learning.task import FALLEN_DEG, STATE_HZ
from lunar_rover_sim.base.errors import ConfigError, PhysicsError, StudyError
from lunar_rover_sim.base.files.paths import check_regular
from lunar_rover_sim.base.files.results import csv_table, markdown_table
from lunar_rover_sim.base.frames import tilt_deg
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.judge.evaluation.statistics import adjusted, Comparison, Mean
from lunar_rover_sim.judge.studies.study_folder import StudyFolder, write_report
from lunar_rover_sim.judge.studies.walking import by_gait, DUG_IN, WALKED, Walker
from lunar_rover_sim.products.inspection.tracking import prediction_miss
from lunar_rover_sim.rover.description import load_rover, RoverDescription
from lunar_rover_sim.rover.gait.calibration import GaitCalibration
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.gait.controller import GaitController, LegCommand
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise

PACKAGED = 'packaged'
GROUNDS, SLOPES_DEG = ('rigid', 'highland', 'highland_loose'), (0.0, 8.0)
# Of reliefs; training draws its seeds below 10,000 and is watched on some of 20,000.
HIDDEN_SEEDS = tuple(range(90_000, 90_020))
# Forward [m/s] and yaw rate [rad/s]: over the range that packaged policies are offered for.
COMMANDS = ((0.12, 0.0), (0.06, 0.0), (0.16, 0.0), (0.12, 0.15), (0.12, -0.15))
SKIP_S, DURATION_S = 3.0, 9.0
FRAME_HZ = 20.0         # of the constant-velocity tracker
SETTINGS = f'{DURATION_S:g} s of which {SKIP_S:g} s are not judged\n'
_SLIP_EVERY = 4         # states
_STUCK = 0.1            # share of the commanded speed below which a rover is stuck
_LEVER_M = FollowConfig().yaw_lever_m
_SIZE_M = 12.8
LEAST_P = 1e-3          # that is told as it is
_NAN = math.nan


@dataclasses.dataclass(frozen=True)
class Case:
    """One walk to be made.

    Attributes:
        walker: `packaged`, or a policy: its name or file.
        ground: Rigid, or a soil.
        slope_deg: Uphill.
        seed: Of the relief.
        rover: Its name or file.
        forward_mps: Commanded speed.
        yaw_rate_radps: Commanded yaw rate.
    """

    walker: str
    ground: str
    slope_deg: float
    seed: int
    rover: str = 'quad'
    forward_mps: float = COMMANDS[0][0]
    yaw_rate_radps: float = COMMANDS[0][1]


@dataclasses.dataclass(frozen=True)
class PolicyWalk:
    """What was measured of a walk after its start.

    Attributes:
        outcome: walked, stuck, dug in, fallen, or the error of the simulation.
        speed_mps: Forward, in the mean.
        turned_radps: Yaw rate, in the mean.
        tracking_error: Share of the commanded velocity that is missed, as `Walk` judges it.
        transport: Electric energy over weight times way, NaN where it does not get on.
        slip: Of all feet.
        pitch_rate_rms_radps: About the y axis of the base.
        miss_px: Median by which a constant-velocity tracker mispredicts at `FRAME_HZ` [px].
    """

    case: Case
    outcome: str
    speed_mps: float = _NAN
    turned_radps: float = _NAN
    tracking_error: float = _NAN
    transport: float = _NAN
    slip: float = _NAN
    pitch_rate_rms_radps: float = _NAN
    miss_px: float = _NAN


MEASURED = tuple(field.name for field in dataclasses.fields(PolicyWalk)[2:])
# Column → title and digits; lower is better in each.
QUANTITIES = {'transport': ('cost of transport', 3), 'pitch_rate_rms_radps':
              ('pitch rate RMS [rad/s]', 3), 'miss_px': ('predicted miss [px]', 2),
              'tracking_error': ('tracking error', 3), 'slip': ('slip', 3)}


def walk(case: Case) -> PolicyWalk:
    """Walk a case, and return what was measured; what cannot be simulated is a result, too."""
    rover = load_rover(case.rover)
    world = terrain(case.seed, _SIZE_M, False, case.slope_deg)
    try:
        with Simulation(world, rover, physics_of(case.ground)) as simulation:
            return _measured(case, simulation, Walker(
                simulation, answer_of(case, rover), _SLIP_EVERY))
    except (ConfigError, PhysicsError) as error:
        return PolicyWalk(case, str(error))


def answer_of(case: Case, rover: RoverDescription) -> Callable[[RoverState], LegCommand]:
    """Return what answers the states of a walk: the packaged gait of the ground, or a policy."""
    if case.walker == PACKAGED:
        gait = GaitConfig().for_rover(rover)
        controller = GaitController(gait, GaitCalibration.of(gait, case.ground, rover.name),
                                    rover.legs)
        controller.set_velocity(case.forward_mps, case.yaw_rate_radps)
        return by_gait(controller)
    policy = PolicyController.load(case.walker, rover)
    policy.set_velocity(case.forward_mps, case.yaw_rate_radps)
    noise = ImuNoise(ImuConfig(), STATE_HZ, np.random.default_rng(case.seed))
    return lambda state: policy.update(Sample.of(state, noise))


class WalkStore(StudyFolder[Case, PolicyWalk]):
    """The finished walks of a study, by case and by the content of the policy's file."""

    def name(self, case: Case) -> str:
        """Return the case in a word."""
        digest = ''
        if case.walker != PACKAGED:
            path = policy_path(case.walker)
            check_regular(path, StudyError)
            digest = '_' + hashlib.sha256(path.read_bytes()).hexdigest()[:12]
        return (f'{Path(case.walker).stem}{digest}_{Path(case.rover).stem}_{case.ground}_'
                f'{case.slope_deg:g}_{case.forward_mps:g}_{case.yaw_rate_radps:g}_{case.seed}')

    def drive(self, values: dict[str, Any]) -> PolicyWalk:
        """Return the walk of its values."""
        return PolicyWalk(**{**values, 'case': Case(**values['case'])})


def write_all(walks: Sequence[PolicyWalk], against: str, folder: Path) -> str:
    """Write learning.md and learning.csv; return the text of the first."""
    names = [field.name for field in dataclasses.fields(Case)]
    return write_report(folder, 'learning', report_text(walks, against), csv_table(
        [*names, 'outcome', *MEASURED],
        ([Path(one.case.walker).stem, *dataclasses.astuple(one.case)[1:], one.outcome,
          *(f'{getattr(one, name):.6g}' for name in MEASURED)] for one in walks)))


def report_text(walks: Sequence[PolicyWalk], against: str = PACKAGED) -> str:
    """Return tables of all grounds, slopes and commands: each walker against one of them.

    Differences are those of medians of pairs; p, corrected for the number of all tests, and effect
    (rank-biserial) are of Wilcoxon's test.
    """
    lines = ['Means with 95 % intervals. p and effect are of the paired test against '
             f'{Path(against).stem} on the same worlds, p for the number of tests in all tables; '
             'an effect of -1 is lower in every world.']
    found: dict[tuple[str, str], list[PolicyWalk]] = {}
    for one in sorted(walks, key=lambda one: one.case.seed):
        found.setdefault((_place(one), one.case.walker), []).append(one)
    tests = {}
    for (place, name), here in found.items():
        others = found.get((place, against), [])
        if name != against and _seeds(here) == _seeds(others):
            tests.update({(place, name, column): Comparison.of(
                _values(here, column), _values(others, column)) for column in QUANTITIES})
    corrected = dict(zip(tests, adjusted([test.p for test in tests.values()])))
    for place in dict.fromkeys(map(_place, walks)):
        rows = []
        for name in dict.fromkeys(one.case.walker for one in walks):
            here = found.get((place, name), [])
            cells = [Path(name).stem,
                     f'{sum(one.outcome == WALKED for one in here)}/{len(here)}']
            for column, (_, digits) in QUANTITIES.items():
                cell = Mean.of(_values(here, column)).text(digits)
                if (place, name, column) in tests:
                    p = corrected[place, name, column]
                    # Of a sample of all ways to swap pairs, none may be as extreme.
                    shown = f'= {p:.2g}' if p >= LEAST_P else f'< {LEAST_P:g}'
                    cell += f'; p {shown}, {tests[place, name, column].effect:+.2f}'
                cells.append(cell)
            rows.append(cells)
        lines += ['', f'## {place}', '', *markdown_table(
            ('walker', 'walked', *(title for title, _ in QUANTITIES.values())), rows)]
    return '\n'.join([*lines, ''])


def _seeds(walks: Sequence[PolicyWalk]) -> list[int]:
    return [one.case.seed for one in walks]


def _values(walks: Sequence[PolicyWalk], column: str) -> np.ndarray:
    return np.array([getattr(one, column) for one in walks])


def _place(walked: PolicyWalk) -> str:
    case = walked.case
    return (f'{case.ground}, {case.slope_deg:g}° uphill, {case.forward_mps:g} m/s'
            + (f', {case.yaw_rate_radps:g} rad/s' if case.yaw_rate_radps else ''))


def _measured(case: Case, simulation: Simulation, walker: Walker) -> PolicyWalk:
    rover, period_s, poses = simulation.rover, walker.period_s, []
    pitch = way_m = turned_rad = 0.0
    every = round(STATE_HZ / FRAME_HZ)
    outcome = WALKED
    first, last = round(SKIP_S * STATE_HZ), round(DURATION_S * STATE_HZ)
    for k in range(1, last + 1):
        state = walker.step()
        if float(tilt_deg(state.orientation_wxyz)) > FALLEN_DEG:
            return PolicyWalk(case, 'fallen')
        if k > first:
            way_m += period_s * float(state.linear_velocity_mps[0])
            turned_rad += period_s * float(state.angular_velocity_radps[2])
            pitch += float(state.angular_velocity_radps[1]) ** 2
        elif k == first:
            walker.begin()
        if k >= first and k % every == 0:
            poses.append(state.T_world_base)
    time_s = walker.periods * period_s
    speed, turned = way_m / time_s, turned_rad / time_s
    if case.forward_mps > 0.0 and speed < _STUCK * case.forward_mps:
        outcome = 'stuck'
    if walker.has_dug_in():
        outcome = DUG_IN
    weight_n = rover.total_mass_kg * simulation.config.gravity_mps2
    miss = prediction_miss(np.array(poses), _rig(rover), rover.standing_height_m, FRAME_HZ)
    missed = (math.hypot(speed - case.forward_mps, _LEVER_M * (turned - case.yaw_rate_radps))
              / math.hypot(case.forward_mps, _LEVER_M * case.yaw_rate_radps))
    return PolicyWalk(
        case, outcome, speed, turned, missed,
        walker.energy_j / weight_n / way_m if outcome == WALKED and way_m > 0.0 else _NAN,
        walker.feet.total, math.sqrt(pitch / walker.periods),
        _NAN if miss is None else miss.median_px)


@functools.lru_cache(maxsize=2)
def _rig(rover: RoverDescription) -> StereoRig:
    return StereoRig(rover, CameraConfig())
