"""The benchmark: cells done once, stopped anywhere, failures that keep their reason."""

from collections.abc import Callable
import functools
import json
from pathlib import Path
import shutil
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest
import synthetic_bag as synthetic
from waiting import LIMIT_S

from lunar_rover_sim.base.errors import GraphError, SlamError
from lunar_rover_sim.base.frames import wxyz_from_rpy
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory
from lunar_rover_sim.judge.slam import benchmark, table
from lunar_rover_sim.judge.slam.benchmark import Cell, plan
from lunar_rover_sim.judge.slam.estimators import Estimator
from lunar_rover_sim.judge.slam.run_on_bag import tipped_over_s
from lunar_rover_sim.run.recording import Recording
from lunar_rover_sim.run.scenario import Scenario

# The truth as exported, of the IMU, a little too small, and nothing in the dark.
FAKE = """\
import pathlib, sys
sequence, out = map(pathlib.Path, sys.argv[1:3])
lines = (sequence / 'mav0/state_groundtruth_estimate0/data.csv').read_text().splitlines()
rows = {line.split(',')[0]: line.split(',')[1:8] for line in lines if line[0] != '#'}
with out.open('w') as file:
    for stamp in (sequence / 'times.txt').read_text().split():
        x, y, z, w, i, j, k = (float(v) for v in rows[stamp])
        print(int(stamp) / 1e9, 0.8 * x, 0.8 * y, 0.8 * z, i, j, k, w, file=file)
"""


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    items = synthetic.drive(1.2, state_hz=50, only=synthetic.FOR_ESTIMATORS)
    return synthetic.write(tmp_path_factory.mktemp('benchmark') / 'bag', items)


@pytest.fixture
def fake(tmp_path) -> list[Estimator]:
    (tmp_path / 'fake.py').write_text(FAKE)
    command = f'{sys.executable} {tmp_path}/fake.py {{sequence}} {{out}}'
    return [Estimator('command', sensor, command=command, frame='imu')
            for sensor in ('mono', 'stereo')]


class Recorder:
    """Copies a bag instead of a run; fails on demand."""

    def __init__(self, bag: Path) -> None:
        self.bag = bag
        self.drives: list[str] = []
        self.broken: dict[str, BaseException] = {}

    def __call__(self, scenario: Scenario, folder: Path, timeout_s: float,
                 on_progress: Callable[[int], None],
                 should_stop: Callable[[], bool]) -> Recording:
        name = f'{scenario.name}-seed{scenario.shared.seed}'
        self.drives.append(name)
        folder.mkdir()
        if name in self.broken:
            (folder / 'half').write_text('written')
            raise self.broken[name]
        on_progress(1_500_000_000)
        shutil.copytree(self.bag, folder / 'bag')
        (folder / 'scenario.yaml').write_text(scenario.to_yaml())
        return Recording(folder, folder / 'bag', scenario, {}, 2.0, 1.0, {}, False)


def outcome(cells: list[Cell]) -> list[tuple[str, bool]]:
    return [(cell.name, cell.failed) for cell in cells]


def reason(cell: Cell) -> str:
    assert cell.result is not None
    return cell.result.reason


def test_stopped_and_gone_on_with(tmp_path, bag, fake) -> None:
    """What is done stays, whatever ended the first call, and only what is missing is done."""
    cells = [cell for cell in plan(['baseline', 'low_albedo'], fake, (1, 2), 2.0)
             if cell.drive.name != 'low_albedo-seed2']
    assert len(cells) == 6
    folder = tmp_path / 'out'
    recorder = Recorder(bag)
    recorder.broken['low_albedo-seed1'] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        benchmark.run(cells, folder, recorder=recorder)
    assert recorder.drives == ['baseline-seed1', 'baseline-seed2', 'low_albedo-seed1']
    first = (folder / 'cells/baseline-seed1-mono-command/result.json').stat().st_mtime_ns
    (folder / 'cells/baseline-seed2-stereo-command/result.json').unlink()   # stopped in a cell
    recorder.broken.clear()
    recorder.drives.clear()
    steps: list[tuple[str, str]] = []
    done = benchmark.run(cells, folder, lambda cell, text: steps.append((cell.name, text)),
                         recorder=recorder)
    assert recorder.drives == ['low_albedo-seed1']
    # A recording is exported once for all estimators, and no sequence stays.
    assert [name for name, text in steps if text == 'exporting'] == [
        'baseline-seed2-stereo-command', 'low_albedo-seed1-mono-command']
    assert sorted(p.name for p in folder.iterdir()) == ['cells', 'recordings']
    assert (folder / 'cells/baseline-seed1-mono-command/result.json').stat().st_mtime_ns == first
    assert outcome(done) == [(cell.name, False) for cell in cells]
    assert not [p for p in (folder / 'recordings').iterdir() if p.name.startswith('.')]
    for cell in done:
        assert cell.result is not None
        assert cell.result.scale == pytest.approx(1.25, rel=1e-6)
        assert cell.result.tracked_share == 1.0
    mono, stereo = (cell.result.ate_m for cell in done[:2] if cell.result)
    assert mono < 1e-6 < stereo   # Sim(3) takes the scale out, SE(3) does not
    with pytest.raises(SlamError, match='other settings'):
        benchmark.run(plan(['baseline'], fake, (1,), 3.0), folder, recorder=recorder)


def test_one_benchmark_of_a_system_in_a_folder(tmp_path, bag, fake) -> None:
    """Two would export into one folder, and judge each other's images; other systems may run."""
    folder, cells = tmp_path / 'out', plan(['baseline'], fake, (1,), 2.0)
    other = plan(['baseline'], [Estimator('reference', 'mono')], (1,), 2.0)
    seen: list[list[tuple[str, bool]]] = []

    def step(cell: Cell, text: str) -> None:
        if text == 'evaluating' and not seen:
            seen.append(outcome(benchmark.run(other, folder, recorder=Recorder(bag))))
            with pytest.raises(SlamError, match='out: another benchmark runs the same system in'):
                benchmark.run(cells, folder, recorder=Recorder(bag))

    done = benchmark.run(cells, folder, step, recorder=Recorder(bag))
    assert seen == [[('baseline-seed1-mono-reference', False)]]
    assert outcome(done) == [(cell.name, False) for cell in cells]
    assert sorted(p.name for p in folder.iterdir()) == ['cells', 'recordings']


def test_drives_at_the_same_time(tmp_path, bag, fake) -> None:
    """Two at once, each recorded once and judged by itself; the results are in order."""
    both = threading.Barrier(2, timeout=LIMIT_S)

    class TwoAtOnce(Recorder):

        def __call__(self, *args: Any, **options: Any) -> Recording:
            both.wait()     # breaks, and fails the drive, unless another is being recorded too
            return super().__call__(*args, **options)

    recorder, cells = TwoAtOnce(bag), plan(['baseline'], fake, (1, 2, 3, 4), 2.0)
    done = benchmark.run(cells, tmp_path / 'out', jobs=2, recorder=recorder)
    assert outcome(done) == [(cell.name, False) for cell in cells]
    assert sorted(recorder.drives) == [f'baseline-seed{seed}' for seed in (1, 2, 3, 4)]
    alone = benchmark.run(cells, tmp_path / 'alone', recorder=Recorder(bag))
    for cell, other in zip(done, alone):
        assert cell.result is not None and other.result is not None
        assert {**cell.result.to_mapping(), 'wall_s': 0.0} == {
            **other.result.to_mapping(), 'wall_s': 0.0}
    assert sorted(p.name for p in (tmp_path / 'out').iterdir()) == ['cells', 'recordings']


def test_an_interrupt_of_one_drive_ends_all(tmp_path, bag) -> None:
    """Nothing goes on, and what was under way leaves no result: not a failure, but nothing."""
    started = tmp_path / 'started'
    slow = Estimator('command', 'mono', command=f'/bin/sh -c "touch {started}; sleep 600" {{out}}')
    recorder, cells = Recorder(bag), plan(['baseline', 'low_albedo'], [slow], (1,), 2.0)

    class Interrupted(Recorder):

        def __call__(self, scenario: Scenario, *args: Any, **options: Any) -> Recording:
            if scenario.name == 'low_albedo':
                while not started.exists():
                    time.sleep(0.01)
                raise KeyboardInterrupt
            return recorder(scenario, *args, **options)

    start_s = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        benchmark.run(cells, tmp_path / 'out', jobs=2, recorder=Interrupted(bag))
    assert time.monotonic() - start_s < 60.0    # the program of the other drive sleeps 600 s
    assert not list((tmp_path / 'out').glob('cells/*/result.json'))
    assert recorder.drives == ['baseline-seed1']
    assert sorted(p.name for p in (tmp_path / 'out').iterdir()) == ['cells', 'recordings']


def test_a_rover_that_tips_over_is_named() -> None:
    """Once, at its first time; one that leans is not."""
    stamps_ns = np.arange(1, 7) * 500_000_000
    turns = [wxyz_from_rpy(np.radians(roll_deg), 0.0, 1.0)
             for roll_deg in (0.0, 60.0, 95.0, 120.0, 20.0, 100.0)]
    truth = Trajectory(stamps_ns, np.zeros((6, 3)), np.array(turns))
    assert tipped_over_s(truth) == 1.5
    assert np.isnan(tipped_over_s(truth.select([0, 1])))


def test_steps_tell_how_far_they_are(tmp_path, bag) -> None:
    """Simulated time of a recording, messages of an export, frames of the built-in odometry."""
    cells = plan(['baseline'], [Estimator('reference', 'mono')], (1,), 2.0)
    steps: list[str] = []
    done = benchmark.run(cells, tmp_path / 'out', lambda _cell, text: steps.append(text),
                         recorder=Recorder(bag))
    assert done[0].result is not None
    frames = done[0].result.frames
    assert frames > 5
    assert steps[:3] == ['recording', 'recording, 2 of 2 s', 'exporting']
    first = steps.index('estimating')
    assert steps[3] == 'exporting, 2 of 216' and 50 < first < 150
    assert steps[first + 1:first + 1 + frames] == [
        f'estimating, {n} of {frames}' for n in range(1, frames + 1)]
    assert steps[-2:] == ['evaluating', 'done']


def test_failures_keep_their_reason_and_others_go_on(tmp_path, bag, fake) -> None:
    broken = Estimator('command', 'stereo', command='/bin/false {out}')
    cells = plan(['baseline'], [fake[0], broken], (1, 2), 2.0)
    recorder = Recorder(bag)
    recorder.broken['baseline-seed1'] = GraphError('the rover fell over at 1.2 s')
    done = benchmark.run(cells, tmp_path / 'out', recorder=recorder)
    assert outcome(done) == [('baseline-seed1-mono-command', True),
                             ('baseline-seed1-stereo-command', True),
                             ('baseline-seed2-mono-command', False),
                             ('baseline-seed2-stereo-command', True)]
    assert recorder.drives == ['baseline-seed1', 'baseline-seed2']   # tried once, for both
    assert 'false: ended with status 1 and wrote no trajectory' in reason(done[3])
    assert reason(done[0]) == reason(done[1]) == 'the rover fell over at 1.2 s'
    rows = table.rows_of(cell.judged(tmp_path) for cell in done)
    text = table.markdown(rows)
    assert 'mono, seed 1: the rover fell over at 1.2 s' in text and 'status 1' in text
    assert [row.ate_m.count for row in rows] == [1, 0]
    recorder.broken.clear()
    kept = benchmark.run(cells, tmp_path / 'out', recorder=recorder)
    assert outcome(kept) == outcome(done)
    again = benchmark.run(cells, tmp_path / 'out', retry=True, recorder=recorder)
    assert [cell.failed for cell in again] == [False, True, False, True]


@pytest.mark.parametrize('arguments, message', [
    ((['baseline'], (1,), 0.0), 'duration: 0 is not valid'),
    ((['baseline', 'baseline'], (1,), 1.0), 'two cells are called baseline-seed1'),
    ((['baseline'], (1,), 1.0, 'a.b'), 'sweep: needs a parameter and its values'),
])
def test_bad_plans(fake, arguments, message) -> None:
    scenarios, *rest = arguments
    with pytest.raises(SlamError, match=message):
        plan(scenarios, fake, *rest)


def test_command_line(tmp_path, bag, fake, monkeypatch, capsys) -> None:
    """A sweep, from the command line to the files."""
    recorder = Recorder(bag)
    monkeypatch.setattr('lunar_rover_sim.cli.benchmark.run_cells',
                        functools.partial(benchmark.run, recorder=recorder))
    words = ['benchmark', '-o', str(tmp_path / 'out'), '--scenarios', 'flat', '--seeds', '2-3',
             '--duration', '2', '--sweep', 'render_node.sun.elevation_deg=2,10', '--system',
             'command', '--run', fake[0].command, '--estimate-frame', 'imu',
             '--sensors', 'mono']
    assert execute(words) == 0
    assert len(recorder.drives) == 4
    printed = capsys.readouterr().out
    text = (tmp_path / 'out/command.md').read_text()
    assert '2 drives of 2 s per line, seeds 2 to 3, 20 frames/s' in text
    assert '| flat | 2 | mono | command | 2/2 |' in text
    assert '1.2500' in printed and 'flat, mono, command, from 2 to 10: the error is' in printed
    for name in ('command.csv', 'command.tex', 'command.html', 'command.png',
                 'command_drives.csv'):
        assert (tmp_path / 'out' / name).stat().st_size > 200
    drive = json.loads((tmp_path / 'out/recordings').glob('*=2-seed2/drive.json').__next__()
                       .read_text())
    assert drive['value'] == '2'
    recorder.drives.clear()
    assert execute(words) == 0 and not recorder.drives
    args = [*words[:7], '--sweep', 'render_node.sun.elevatoin_deg=2,10']
    with pytest.raises(Exception, match='elevation_deg'):
        execute(args)
