"""The locomotion study: the pitch that spoke legs cause, against that of a velocity interface.

The same velocity command is driven on perfectly flat ground through the gait and contact model,
and through a chassis that simply tracks it; the pitch of both is compared. Three claims are
tested, each by a number: legs start with a transient above their steady amplitude, their pitch has
the frequency of the steps, and a velocity interface shows neither.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import dataclasses
import math
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base import frames
from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.results import markdown_table, save_figure
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.gravity import EARTH_MPS2, MOON_MPS2
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.judge.studies.gait_measurement import CommandTracking
from lunar_rover_sim.judge.studies.study_folder import Progress, silent, write_report
from lunar_rover_sim.judge.studies.walking import (flat_world, STATE_PERIOD_S, walk, Walk,
                                                   with_physics)
from lunar_rover_sim.products.inspection.tracking import LOST_PX, prediction_miss, PredictionMiss
from lunar_rover_sim.rover.description import chassis_inertia, RoverDescription
from lunar_rover_sim.rover.gait.controller import GaitController
from lunar_rover_sim.rover.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.run.scenario import Scenario

START_S = 5.0         # the transient is looked for in this time after the command
STEADY_FROM_S = 10.0  # the steady walk begins this time after the command


@dataclasses.dataclass(frozen=True)
class PitchCurve:
    """Pitch over time: time_s (n,) even steps, pitch_deg (n,), positive nose down."""

    name: str
    time_s: Array
    pitch_deg: Array


@dataclasses.dataclass(frozen=True)
class PitchReport:
    """What a pitch curve shows.

    Attributes:
        steady_low_deg, steady_high_deg: Least and greatest pitch of the steady part.
        rms_deg: About the mean, after the command.
        overshoot_deg: How far the first seconds after the command go beyond the steady range,
            which here includes the pitch at rest, so that leaving it is no overshoot.
        decay_s: Time after the command when the curve is last beyond that range by a tenth of the
            steady amplitude.
        dominant_hz: Frequency of the highest line of the steady spectrum (Hann window).
        step_share: Share of the steady variance within 10 % of the step frequency; NaN if unknown.
        periodicity: Autocorrelation of the steady part at one gait cycle, 1 = strictly periodic.
    """

    steady_low_deg: float
    steady_high_deg: float
    rms_deg: float
    overshoot_deg: float
    decay_s: float
    dominant_hz: float
    step_share: float
    periodicity: float

    @property
    def steady_amplitude_deg(self) -> float:
        """Half the steady range."""
        return 0.5 * (self.steady_high_deg - self.steady_low_deg)

    @property
    def transient(self) -> float:
        """Steady amplitude plus overshoot, over steady amplitude: above 1 there is a transient."""
        amplitude = self.steady_amplitude_deg
        return 1.0 + self.overshoot_deg / amplitude if amplitude > 1e-6 else math.nan


def analyse(curve: PitchCurve, command_s: float, cycle_hz: float = math.nan,
            step_hz: float = math.nan) -> PitchReport:
    """Return what a curve shows.

    Args:
        command_s: When the command begins [s].
        cycle_hz, step_hz: Gait cycles and steps per second.
    """
    time, pitch = curve.time_s - command_s, curve.pitch_deg
    steady = time >= STEADY_FROM_S
    low, high = float(pitch[steady].min()), float(pitch[steady].max())
    after, rest = time >= 0.0, float(np.interp(0.0, time, pitch))
    beyond = np.maximum(pitch - max(high, rest), min(low, rest) - pitch)
    late = time[after & (beyond > 0.05 * (high - low))]
    interval = float(np.median(np.diff(time)))
    signal = pitch[steady] - pitch[steady].mean()
    dominant, share = _spectrum(signal, interval, step_hz)
    return PitchReport(
        low, high, float(pitch[after].std()),
        max(0.0, float(beyond[after & (time <= START_S)].max())),
        float(late[-1]) if len(late) else 0.0, dominant, share,
        _autocorrelation(signal, 1.0 / (cycle_hz * interval)))


def _spectrum(signal: Array, interval_s: float, step_hz: float) -> tuple[float, float]:
    """Return the dominant frequency [Hz] and the share of power near the step frequency."""
    n = len(signal)
    power = np.abs(np.fft.rfft(signal * np.hanning(n), 8 * n)) ** 2
    frequency = np.fft.rfftfreq(8 * n, interval_s)
    total = power.sum()
    if total < 1e-20 * n:
        return math.nan, math.nan
    near = np.abs(frequency - step_hz) <= max(0.1 * step_hz, 2.0 / (n * interval_s))
    share = float(power[near].sum() / total) if math.isfinite(step_hz) else math.nan
    return float(frequency[np.argmax(power)]), share


def _autocorrelation(signal: Array, lag: float) -> float:
    """Return the normalised autocorrelation at a lag [samples], or NaN."""
    if not math.isfinite(lag) or not 1 <= round(lag) < len(signal) - 1:
        return math.nan
    a, b = signal[:-round(lag)], signal[round(lag):]
    norm = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / norm if norm > 1e-12 else math.nan


SPEEDS_MPS = (0.06, 0.12, 0.2)
GRAVITIES_MPS2 = (MOON_MPS2, EARTH_MPS2)
FRAME_RATES_HZ = (10, 20, 40)
STAND_S = 1.0        # standing before the command
TRACKING_S = 0.1     # time constant with which the velocity interface tracks its command


@dataclasses.dataclass(frozen=True)
class LocomotionCase:
    """One speed under one gravity: both curves and their reports.

    Attributes:
        step_hz: Groups of legs that touch down, per second.
        misses: How far a tracker would mispredict images of the walk, at FRAME_RATES_HZ.
    """

    speed_mps: float
    gravity_mps2: float
    step_hz: float
    gait: PitchCurve
    interface: PitchCurve
    gait_report: PitchReport
    interface_report: PitchReport
    misses: tuple[PredictionMiss, ...]


@dataclasses.dataclass(frozen=True)
class Claim:
    """A claim, whether it holds in one case, and the number that shows it."""

    name: str
    text: str
    holds: bool
    value: float
    bound: str


def claims(case: LocomotionCase) -> list[Claim]:
    """Return the claims, tested on one case."""
    gait, interface = case.gait_report, case.interface_report
    ratio = gait.dominant_hz / case.step_hz
    smooth = interface.rms_deg / gait.rms_deg
    peak = interface.overshoot_deg / gait.steady_amplitude_deg
    return [
        Claim('start transient', 'steady amplitude and overshoot over the steady amplitude',
              gait.transient > 1.1, gait.transient, '> 1.1'),
        Claim('step frequency', 'dominant frequency of the pitch over the step frequency',
              abs(ratio - 1.0) < 0.1, ratio, '0.9 to 1.1'),
        Claim('smooth interface', 'RMS of the velocity interface over that of the gait',
              smooth < 1.0 / 3.0, smooth, '< 1/3'),
        Claim('no interface peak', 'overshoot of the velocity interface over the steady amplitude'
              ' of the gait', peak < 1.0 / 3.0, peak, '< 1/3'),
    ]


def study(scenario: Scenario, speeds_mps: Sequence[float] = SPEEDS_MPS,
          gravities_mps2: Sequence[float] = GRAVITIES_MPS2, duration_s: float = 30.0,
          progress: Progress = silent) -> list[LocomotionCase]:
    """Walk and track every speed under every gravity.

    Args:
        duration_s: Length of each walk, from the command on [s].
        progress: Called after each case with the number of cases done, and of all.
    """
    rig = StereoRig(scenario.rover, scenario.render_node.camera)
    ground, cases = flat_world(), []
    for gravity in gravities_mps2:
        under = with_physics(scenario, gravity_mps2=gravity, start=StartPose())
        with under.simulation(ground) as simulation:
            for speed in speeds_mps:
                cases.append(_case(simulation, under.gait_controller(), speed, duration_s, rig))
                progress(len(cases), len(gravities_mps2) * len(speeds_mps))
    return cases


def velocity_interface(time_s: ArrayLike, speed_mps: float, command_s: float,
                       rover: RoverDescription, physics: PhysicsConfig) -> PitchCurve:
    """Return the pitch of a chassis that tracks a commanded speed on compliant support.

    The mass m of the rover rests on springs k and dampers c of the ground at the feet, at
    x from its middle, and is pushed at the ground so that its speed tracks the command with a
    time constant; being h above the ground it pitches by

        J p'' = -m h v' - sum(x^2) (k p + c p'),    v' = (v_command - v) / tau,

    integrated by the semi-implicit Euler method at no more than 0.5 ms.
    """
    time = np.asarray(time_s, dtype=float)
    chassis, legs = rover.chassis, rover.legs
    mass = rover.total_mass_kg
    axles = np.array(rover.legs.axle_positions_m())
    inertia = (chassis_inertia(chassis)[1, 1] + chassis.mass_kg * chassis.com_m[0] ** 2
               + legs.mass_kg * np.sum(axles[:, 0] ** 2))
    height = (chassis.mass_kg * chassis.com_m[2] + legs.mass_kg * np.sum(axles[:, 2])) / mass
    height += rover.standing_height_m
    lever = float(np.sum(axles[:, 0] ** 2))
    stiffness = lever * physics.contact.stiffness_npm
    damping = lever * physics.contact.damping_nspm
    interval = float(np.median(np.diff(time)))
    inner = max(1, math.ceil(interval / 0.0005))
    dt = interval / inner
    speed = pitch = rate = 0.0
    curve = np.empty(len(time))
    for i, now in enumerate(time):
        curve[i] = math.degrees(pitch)
        asked = speed_mps if now >= command_s else 0.0
        for _ in range(inner):
            acceleration = (asked - speed) / TRACKING_S
            moment = -mass * height * acceleration - stiffness * pitch - damping * rate
            speed += dt * acceleration
            rate += dt * moment / inertia
            pitch += dt * rate
    return PitchCurve('velocity interface', time, curve)


def _case(simulation: Simulation, controller: GaitController, speed: float, duration_s: float,
          rig: StereoRig) -> LocomotionCase:
    def command(controller: GaitController, stamp_ns: int) -> None:
        controller.set_velocity(speed if stamp_ns * 1e-9 >= STAND_S else 0.0, 0.0, stamp_ns)

    done = walk(simulation, controller, STAND_S + duration_s, command)
    cycle_hz = controller.stride.phase_rate_hz
    step_hz = cycle_hz * len(set(controller.config.offsets(simulation.rover.legs)))
    pitch = np.degrees(done.rpy_rad[:, 1])
    walked = PitchCurve('gait and contact', done.time_s, pitch)
    tracked = velocity_interface(done.time_s, speed, STAND_S, simulation.rover, simulation.config)
    return LocomotionCase(
        speed, simulation.config.gravity_mps2, step_hz, walked, tracked,
        analyse(walked, STAND_S, cycle_hz, step_hz), analyse(tracked, STAND_S, cycle_hz, step_hz),
        tuple(_misses(done, rig, simulation.rover)))


def _misses(done: Walk, rig: StereoRig, rover: RoverDescription) -> Iterator[PredictionMiss]:
    """Yield how far constant velocity misses at each frame rate, from the command on."""
    T_world_base = np.array([
        frames.se3(frames.matrix_from_wxyz(frames.wxyz_from_rpy(*rpy)), position)
        for rpy, position in zip(done.rpy_rad, done.position_m)])
    first = int(np.searchsorted(done.time_s, STAND_S))
    for rate_hz in FRAME_RATES_HZ:
        every = round(1.0 / (rate_hz * STATE_PERIOD_S))
        miss = prediction_miss(T_world_base[first::every], rig, rover.standing_height_m, rate_hz)
        if miss is not None:
            yield miss


_COLUMNS = ('curve', 'v [m/s]', 'g [m/s²]', 'steps [Hz]', 'dominant [Hz]', 'at steps', 'RMS [°]',
            'amplitude [°]', 'overshoot [°]', 'transient', 'decay [s]', 'periodicity')


def plot_cases(cases: Sequence[LocomotionCase], path: Path) -> None:
    """Write a plot with one panel per case: both curves.

    Raises:
        StudyError: If the file cannot be written.
    """
    gravities = sorted({case.gravity_mps2 for case in cases})
    speeds = sorted({case.speed_mps for case in cases})
    figure = Figure(figsize=(7.5 * len(gravities), 2.6 * len(speeds)), layout='constrained')
    axes = figure.subplots(len(speeds), len(gravities), sharex=True, squeeze=False)
    for case in cases:
        axis = axes[speeds.index(case.speed_mps)][gravities.index(case.gravity_mps2)]
        axis.plot(case.gait.time_s, case.gait.pitch_deg, lw=0.8, label=case.gait.name)
        axis.plot(case.interface.time_s, case.interface.pitch_deg, lw=1.2,
                  label=case.interface.name)
        axis.axvline(STAND_S, color='0.6', lw=0.8)
        axis.axvline(STAND_S + STEADY_FROM_S, color='0.8', lw=0.8, ls='--')
        axis.set_title(f'{case.speed_mps:g} m/s, {case.gravity_mps2:g} m/s², steps at'
                       f' {case.step_hz:.2f} Hz', fontsize=9)
        axis.grid(alpha=0.3)
    axes[0][0].legend(fontsize=8, loc='upper right')
    for row in axes:
        row[0].set_ylabel('pitch [°], nose down')
    for axis in axes[-1]:
        axis.set_xlabel('time [s]')
    save_figure(figure, path, StudyError)


def write_curves(cases: Sequence[LocomotionCase], path: Path) -> None:
    """Write the curves of all cases as one CSV: time [s], then pitch [deg] column by column.

    Raises:
        StudyError: If the file cannot be written.
    """
    names = ['time_s']
    columns = [cases[0].gait.time_s]
    for case in cases:
        for curve, kind in ((case.gait, 'gait'), (case.interface, 'interface')):
            names.append(f'{kind}_{case.speed_mps:g}mps_{case.gravity_mps2:g}mps2_deg')
            columns.append(curve.pitch_deg)
    atomic_write(path, lambda stream: np.savetxt(
        stream, np.stack(columns, axis=1), fmt='%.5f', delimiter=',', header=','.join(names),
        comments=''), StudyError)


def report_text(cases: Sequence[LocomotionCase],
                tracking: Sequence[CommandTracking] = ()) -> str:
    """Return the report as Markdown."""
    lines = ['# Pitch of a spoke-leg walk against a velocity interface', '',
             f'Perfectly flat ground; the command begins at {STAND_S:g} s. The steady walk begins'
             f' {STEADY_FROM_S:g} s later. Transient: steady amplitude and overshoot over the'
             ' steady amplitude. At steps: share of the steady variance near the step frequency.'
             ' Periodicity: autocorrelation at one gait cycle.', '',
             *markdown_table(_COLUMNS, (
                 [curve.name, f'{case.speed_mps:g}', f'{case.gravity_mps2:g}',
                  f'{case.step_hz:.2f}', *_figures(report)] for case in cases
                 for curve, report in ((case.gait, case.gait_report),
                                       (case.interface, case.interface_report)))),
             '', '## Claims', '',
             *markdown_table(
                 ('v [m/s]', 'g [m/s²]', 'claim', 'measure', 'value', 'bound', 'shown'),
                 ([f'{case.speed_mps:g}', f'{case.gravity_mps2:g}', claim.name, claim.text,
                   f'{claim.value:.3f}', claim.bound, 'yes' if claim.holds else 'NO']
                  for case in cases for claim in claims(case)))]
    lines += ['', '## Images that a tracker can follow', '', 'How far a prediction by constant'
              ' velocity misses, from the command on, and the share of frames beyond'
              f' {LOST_PX:g} px, the second search of a stereo tracker.', '',
              *markdown_table(
                  ('v [m/s]', 'g [m/s²]', 'frames/s', 'median [px]', 'p90 [px]', 'beyond'),
                  ([f'{case.speed_mps:g}', f'{case.gravity_mps2:g}', f'{miss.rate_hz:g}',
                    f'{miss.median_px:.1f}', f'{miss.p90_px:.1f}', f'{100 * miss.lost:.0f} %']
                   for case in cases for miss in case.misses))]
    if tracking:
        followed = sum(each.followed for each in tracking)
        lines += ['', '## Commands followed', '', f'{followed} of {len(tracking)} within 10 % of'
                  ' the forward speed and 15 % of the yaw rate.', '',
                  *markdown_table(('v [m/s]', 'ω [rad/s]', 'v measured', 'error', 'ω measured',
                                   'error', 'within'), map(_tracking_row, tracking))]
    return '\n'.join(lines) + '\n'


def write_all(cases: Sequence[LocomotionCase], tracking: Sequence[CommandTracking],
              folder: Path) -> str:
    """Write locomotion.md, locomotion.png and pitch.csv; return the text of the first.

    Raises:
        StudyError: If one cannot be written.
    """
    text = write_report(folder, 'locomotion', report_text(cases, tracking))
    plot_cases(cases, folder / 'locomotion.png')
    write_curves(cases, folder / 'pitch.csv')
    return text


def _tracking_row(one: CommandTracking) -> list[str]:
    (v, w), (mv, mw) = one.commanded, one.measured
    return [f'{v:g}', f'{w:g}', f'{mv:.4f}', f'{100 * one.forward_error:+.1f} %', f'{mw:.4f}',
            f'{100 * one.yaw_error_radps / w:+.1f} %' if w else f'{one.yaw_error_radps:+.4f}',
            'yes' if one.followed else 'NO']


def _figures(report: PitchReport) -> list[str]:
    values = [(report.dominant_hz, '.2f'), (report.step_share, '.2f'), (report.rms_deg, '.3f'),
              (report.steady_amplitude_deg, '.3f'), (report.overshoot_deg, '.3f'),
              (report.transient, '.2f'), (report.decay_s, '.2f'), (report.periodicity, '.3f')]
    return [format(value, spec) if math.isfinite(value) else '–' for value, spec in values]
