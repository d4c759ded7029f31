"""The report of the locomotion study: plot, table of claims, and the curves as CSV."""

from __future__ import annotations

from collections.abc import Sequence
import math
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.results import markdown_table, save_figure
from lunar_rover_sim.judge.studies.gait_measurement import CommandTracking
from lunar_rover_sim.judge.studies.locomotion import (analyse, claims, LocomotionCase, PitchCurve,
                                                      PitchReport, STAND_S, STEADY_FROM_S)
from lunar_rover_sim.products.inspection.tracking import LOST_PX

_COLUMNS = ('curve', 'v [m/s]', 'g [m/s²]', 'steps [Hz]', 'dominant [Hz]', 'at steps', 'RMS [°]',
            'amplitude [°]', 'overshoot [°]', 'transient', 'decay [s]', 'periodicity')


def plot_cases(cases: Sequence[LocomotionCase], path: str | Path,
               overlays: Sequence[PitchCurve] = ()) -> None:
    """Write a plot with one panel per case: both curves, and any other ones.

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
        for curve in overlays:
            axis.plot(curve.time_s, curve.pitch_deg, lw=0.8, alpha=0.7, label=curve.name)
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


def write_curves(cases: Sequence[LocomotionCase], path: str | Path) -> None:
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


def report_text(cases: Sequence[LocomotionCase], overlays: Sequence[PitchCurve] = (),
                tracking: Sequence[CommandTracking] = ()) -> str:
    """Return the report as Markdown."""
    lines = ['# Pitch of a spoke-leg walk against a velocity interface', '',
             f'Perfectly flat ground; the command begins at {STAND_S:g} s. The steady walk begins'
             f' {STEADY_FROM_S:g} s later. Transient: steady amplitude and overshoot over the'
             ' steady amplitude. At steps: share of the steady variance near the step frequency.'
             ' Periodicity: autocorrelation at one gait cycle.', '',
             *markdown_table(_COLUMNS, [
                 *([curve.name, f'{case.speed_mps:g}', f'{case.gravity_mps2:g}',
                    f'{case.step_hz:.2f}', *_figures(report)] for case in cases
                   for curve, report in ((case.gait, case.gait_report),
                                         (case.interface, case.interface_report))),
                 *([curve.name, '', '', '', *_figures(analyse(curve, STAND_S))]
                   for curve in overlays)]),
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


def write_all(cases: Sequence[LocomotionCase], overlays: Sequence[PitchCurve],
              tracking: Sequence[CommandTracking], folder: Path) -> str:
    """Write locomotion.md, locomotion.png and pitch.csv; return the text of the first.

    Raises:
        StudyError: If one cannot be written.
    """
    text = report_text(cases, overlays, tracking)
    atomic_write(folder / 'locomotion.md', text, StudyError)
    plot_cases(cases, folder / 'locomotion.png', overlays)
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
