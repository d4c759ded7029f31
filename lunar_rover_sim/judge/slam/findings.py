"""Published findings against a benchmark: shown, not shown, or contradicted.

Each sentence rests on a test over the drives, and says which. `Not shown` does not say that a
finding is wrong: the drives do not decide it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from lunar_rover_sim.judge.evaluation.statistics import Comparison, CONFIDENCE, Median
from lunar_rover_sim.judge.slam.drives import Judged
from lunar_rover_sim.judge.slam.table import is_success, rows_of, TableRow

SHOWN, NOT_SHOWN, CONTRADICTED = 'shown', 'not shown', 'contradicted'
_SPARSE, _BASELINE, _DARK = 'feature_sparse', 'baseline', 'low_albedo'
_NEAR = 0.05            # of a scale from 1
_ALIKE = 1.25           # factor between errors that count as alike
# Errors of one system and sensor on the drives of a scenario, by seed; a failure is infinite.
_Errors = dict[tuple[str, str], dict[int, float]]


def findings(judged: Sequence[Judged], parameter: str = '') -> list[str]:
    """Return a sentence for each finding that the drives of one system can speak of.

    For a sweep over `parameter` they say how many drives succeeded at each of its values, and
    whether the errors of neighbouring values differ.
    """
    if parameter:
        rows = rows_of(judged)
        return _successes(rows, parameter) + _steps(rows, judged)
    errors = _errors_of(judged)
    sensors = list(dict.fromkeys(sensor for _, sensor in errors))
    sentences = [_largest(errors, sensor) for sensor in sensors]
    sentences.append(_lowest(errors))
    sentences.append(_alike(errors))
    for scenario in (_BASELINE, _SPARSE, _DARK):
        for sensor in sensors:
            sentences.append(_scale(judged, scenario, sensor))
    return [sentence for sentence in sentences if sentence]


def _errors_of(judged: Iterable[Judged]) -> _Errors:
    errors: _Errors = {}
    for one in judged:
        if not one.failed:
            errors.setdefault((one.drive.scenario, one.result.sensor), {})[
                one.drive.seed] = one.result.ate_m if is_success(one) else float('inf')
    return errors


def _compare(first: dict[int, float], second: dict[int, float]) -> Comparison:
    seeds = sorted(first.keys() & second.keys())
    return Comparison.of([first[s] for s in seeds], [second[s] for s in seeds])


def _largest(errors: _Errors, sensor: str) -> str:
    """Say whether feature_sparse has the largest error, failures first."""
    others = [(s, sensor) for s in (_BASELINE, _DARK) if (s, sensor) in errors]
    if (_SPARSE, sensor) not in errors or not others:
        return ''
    tests = {key: _compare(errors[_SPARSE, sensor], errors[key]) for key in others}
    return _sentence(f'{sensor} is worst on {_SPARSE}', [t.sign for t in tests.values()], tests)


def _lowest(errors: _Errors) -> str:
    """Say whether stereo on low_albedo has the lowest error of all."""
    own = (_DARK, 'stereo')
    others = [key for key in errors if key != own]
    if own not in errors or not others:
        return ''
    tests = {key: _compare(errors[own], errors[key]) for key in others}
    return _sentence(f'stereo on {_DARK} has the lowest error of all',
                     [-t.sign for t in tests.values()], tests)


def _sentence(finding: str, signs: Sequence[int],
              tests: dict[tuple[str, str], Comparison]) -> str:
    """Say that all tests agree, that one of them disagrees, or that some decide nothing."""
    verdict = CONTRADICTED if min(signs) < 0 else SHOWN if min(signs) > 0 else NOT_SHOWN
    against = '; '.join(f'against {" ".join(key)} {test.text()}' for key, test in tests.items())
    return f'{verdict}: {finding} ({against})'


def _alike(errors: _Errors) -> str:
    """Say whether the errors of mono and stereo on baseline are within a factor of one another.

    Two one-sided tests at 5 %: the 90 % interval of the ratio lies within the factor.
    """
    mono, stereo = errors.get((_BASELINE, 'mono')), errors.get((_BASELINE, 'stereo'))
    if not mono or not stereo:
        return ''
    finding = f'mono and stereo are alike on {_BASELINE}'
    seeds = [s for s in sorted(mono.keys() & stereo.keys())
             if np.isfinite([mono[s], stereo[s]]).all() and mono[s] > 0.0 < stereo[s]]
    ratio = Median.of((np.log(mono[s] / stereo[s]) for s in seeds), confidence=2 * CONFIDENCE - 1)
    test = _compare(mono, stereo)
    verdict = NOT_SHOWN
    if np.isfinite(ratio.low) and max(-ratio.low, ratio.high) <= np.log(_ALIKE):
        verdict = SHOWN
    elif test.sign:
        verdict = CONTRADICTED
    interval = 'too few seeds for an interval' if np.isnan(ratio.low) else \
        f'90 % interval {np.exp(ratio.low):.2f} to {np.exp(ratio.high):.2f}'
    of = '' if not ratio.count else \
        f'ratio {np.exp(ratio.value):.2f}, {interval}, alike within {_ALIKE:g}; '
    return f'{verdict}: {finding} ({of}{test.text()})'


def _scale(judged: Sequence[Judged], scenario: str, sensor: str) -> str:
    """Say whether the scale of stereo is near 1, and that of mono is not."""
    own = [one for one in judged if is_success(one)
           and (one.drive.scenario, one.result.sensor) == (scenario, sensor)]
    if not own:
        return ''
    away = Median.of(abs(one.result.scale - 1.0) for one in own)
    near = 0
    if np.isfinite(away.low):
        near = 1 if away.high <= _NEAR else -1 if away.low > _NEAR else 0
    arbitrary = sensor == 'mono'
    finding = (f'the scale of {sensor} on {scenario} is '
               + (f'arbitrary, more than {100 * _NEAR:g} % from 1' if arbitrary
                  else f'within {100 * _NEAR:g} % of 1'))
    verdict = {0: NOT_SHOWN, 1: SHOWN, -1: CONTRADICTED}[-near if arbitrary else near]
    return (f'{verdict}: {finding} (median distance from 1 {away.text(3)}, '
            f'n = {away.count})')


def _successes(rows: Sequence[TableRow], parameter: str) -> list[str]:
    sentences = []
    for scenario, sensor in dict.fromkeys((r.scenario, r.sensor) for r in rows):
        own = [r for r in rows if (r.scenario, r.sensor) == (scenario, sensor)]
        parts = [f'{r.successes} of {r.drives} drives succeed at {r.value}' for r in own]
        sentences.append(f'{scenario}, {sensor}, {parameter}: {"; ".join(parts)}')
    return sentences


def _steps(rows: Sequence[TableRow], judged: Sequence[Judged]) -> list[str]:
    """Say of each value and the next one at which the error is larger, failures first."""
    sentences = []
    for scenario, sensor in dict.fromkeys((r.scenario, r.sensor) for r in rows):
        values = [r.value for r in rows if (r.scenario, r.sensor) == (scenario, sensor)]
        errors = [_errors_of(one for one in judged if one.drive.value == value).get(
            (scenario, sensor), {}) for value in values]
        for k, (value, following) in enumerate(zip(values, values[1:])):
            test = _compare(errors[k], errors[k + 1])
            statement = {
                1: f'{SHOWN}: the error is larger at {value} than at {following}',
                -1: f'{SHOWN}: the error is smaller at {value} than at {following}',
                0: f'{NOT_SHOWN}: the errors at {value} and {following} differ'}[test.sign]
            sentences.append(f'{statement}, {scenario}, {sensor} ({test.text()})')
    return sentences
