"""A sealed benchmark: made again, verified, scored; what is not the sealed drive is told."""

import dataclasses
import functools
import json
from pathlib import Path
import re
import shutil
import sys
from typing import Any

import click
from judge.slam.test_benchmark import FAKE, Recorder
import numpy as np
import pytest
import synthetic_bag as synthetic
import yaml

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.files.paths import find_file, packaged_names
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.judge.slam import benchmark
from lunar_rover_sim.judge.slam.drives import Drive, Judged
from lunar_rover_sim.judge.slam.run_on_bag import SlamResult
from lunar_rover_sim.judge.slam.seal import Fingerprint, fingerprint, read_seal, scores

NEEDED = (*synthetic.FOR_ESTIMATORS, topics.WORLD_HASH)


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    items = synthetic.drive(1.2, state_hz=50, only=NEEDED)
    return synthetic.write(tmp_path_factory.mktemp('seal') / 'bag', items)


@pytest.fixture(scope='module')
def program(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return the options that choose an estimator which knows the truth."""
    path = tmp_path_factory.mktemp('program') / 'fake.py'
    path.write_text(FAKE)
    return ['--sensors', 'mono', '--system', 'command', '--estimate-frame', 'imu',
            '--run', f'{sys.executable} {path} {{sequence}} {{out}}']


@pytest.fixture(scope='module')
def sealed(tmp_path_factory: pytest.TempPathFactory, bag: Path, program: list[str]) -> Path:
    """Seal two drives of one scenario that a program was judged on."""
    folder = tmp_path_factory.mktemp('sealed')
    with pytest.MonkeyPatch.context() as patch:
        recorded_by(bag, patch)
        assert execute(['benchmark', '-o', str(folder / 'made'), '--scenarios', 'flat', '--seeds',
                        '2-3', '--duration', '2', '--set', 'render_node.sun.elevation_deg=5',
                        *program]) == 0
    assert execute(['slam', 'seal', str(folder / 'made'), '-o', str(folder / 'seal.yaml'),
                    '--name', 'short walk', '--version', '3']) == 0
    return folder / 'seal.yaml'


def recorded_by(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('lunar_rover_sim.cli.benchmark.run_cells',
                        functools.partial(benchmark.run, recorder=Recorder(bag)))


def made_again(seal: Path, folder: Path, program: list[str]) -> tuple[int, Any]:
    status = execute(['benchmark', '-o', str(folder), '--sealed', str(seal), *program])
    return status, json.loads((folder / 'score.json').read_text())


def test_the_same_drives_count(sealed: Path, program: list[str], tmp_path: Path, bag: Path,
                               monkeypatch: pytest.MonkeyPatch,
                               capsys: pytest.CaptureFixture[str]) -> None:
    """Scenario, seeds, duration and settings come from the seal, and so do scores to compare."""
    recorded_by(bag, monkeypatch)
    status, score = made_again(sealed, tmp_path / 'again', program)
    assert status == 0 and score['is_sealed'] and not score['problems']
    assert (score['benchmark'], score['version']) == ('short walk', 3)
    assert score['scores'] == score['sealed_scores']
    assert [row['drives'] for row in score['scores']] == [2]
    told = json.loads((tmp_path / 'again/recordings/flat-seed3/drive.json').read_text())
    assert told['overrides'] == ['render_node.sun.elevation_deg=5'] and told['duration_s'] == 2.0
    assert 'short walk, version 3: all 2 recordings are the sealed ones' in capsys.readouterr().out


def test_other_drives_do_not(sealed: Path, program: list[str], tmp_path: Path,
                             monkeypatch: pytest.MonkeyPatch) -> None:
    """Another way, and other images, are named; the scores are there, and do not count."""
    items = synthetic.drive(1.4, state_hz=50, only=NEEDED)
    recorded_by(synthetic.write(tmp_path / 'longer', items), monkeypatch)
    status, score = made_again(sealed, tmp_path / 'again', program)
    assert status == 1 and not score['is_sealed'] and score['scores']
    assert any(problem.startswith('flat-seed2: its motion is ') for problem in score['problems'])
    assert not any('its world' in problem for problem in score['problems'])
    shutil.rmtree(tmp_path / 'again/recordings/flat-seed3')
    assert 'flat-seed3: is not recorded' in read_seal(sealed).problems(tmp_path / 'again')


def test_a_brighter_sun_is_another_drive(bag: Path) -> None:
    """Motion and world are exact, images are not: what processors differ by is allowed."""
    known = fingerprint(bag)
    assert known.world == 'ab' * 32
    assert np.array(known.images).shape == (6, 12)      # three of each camera, twelve blocks
    too_bright = 'grey levels of its images differ by up to 1.2 of 255, valid is up to 1'
    for change, words in ((0.9, []), (1.2, [too_bright])):
        other = dataclasses.replace(known, images=tuple(
            tuple(level + change for level in levels) for levels in known.images))
        assert other.differences(known) == words
    other = Fingerprint('cd' * 32, 'ef' * 32, known.images[:5])
    assert [what.split(' is ')[0] for what in other.differences(known)[:2]] == [
        'its world', 'its motion']
    assert other.differences(known)[2] == 'it has images of another kind'


def test_scores_count_failures() -> None:
    """A failure is worse than any error; a rover that tips over is no drive."""
    def judged(*errors: float | None, tipped: bool = False) -> list[Judged]:
        drive = Drive('flat', 1, 2.0)
        return [Judged(drive, SlamResult('mine', 'mono', tracked_share=0.2) if error is None
                       else SlamResult('mine', 'mono', tracked_share=1.0, ate_m=0.1,
                                       ate_percent=error,
                                       tipped_over_s=1.0 if tipped else float('nan')))
                for error in errors]

    def score(found: list[Judged]) -> tuple[int, int, float | None]:
        (row,) = scores(found)
        return row['drives'], row['successes'], row['ate_percent']

    assert score(judged(3.0, 1.0, 2.0)) == (3, 3, 2.0)
    assert score(judged(3.0, 1.0, None)) == (3, 2, 3.0)
    assert score(judged(1.0, None, None)) == (3, 1, None)
    assert score([*judged(1.0), *judged(9.0, tipped=True)]) == (1, 1, 1.0)


@pytest.mark.parametrize('words', [('--seeds', '3'), ('--duration', '1'), ('--scenarios', 'flat'),
                                   ('--set', 'render_node.sun.elevation_deg=9')])
def test_the_seal_has_these(words: tuple[str, ...], sealed: Path, tmp_path: Path) -> None:
    """Options that it answers are refused beside it."""
    with pytest.raises(click.UsageError, match=f'{words[0]}: comes from the seal'):
        execute(['benchmark', '-o', str(tmp_path / 'b'), '--sealed', str(sealed), *words])


def test_bad_seals(sealed: Path, tmp_path: Path) -> None:
    """Files that are none are told with what is wrong; so is what cannot be sealed."""
    text = sealed.read_text()
    for content, words in (('[]', 'is no seal'), ('name: a', 'it lacks version, scenarios'),
                           (text.replace('- mono', '- sonar'), "sensors: 'sonar' is not valid"),
                           (text.replace('- 3\n', '- 4\n'), 'flat-seed3, flat-seed4'),
                           (re.sub(r"images: *\n *- '?[\d.]+ ", 'images:\n    - nan ', text),
                            'valid are grey levels of 0 to 255'),
                           (text.replace('successes:', 'success:'), 'a row lacks successes'),
                           (text.replace('world: ab', 'wordl: ab'), 'is no seal'),
                           (text.replace('version: 3', 'version: .inf'), 'is no seal')):
        (tmp_path / 'bad.yaml').write_text(content)
        with pytest.raises(SlamError, match=words):
            read_seal(tmp_path / 'bad.yaml')
    assert yaml.safe_load(text)['seeds'] == [2, 3]
    with pytest.raises(SlamError, match='no results of a benchmark'):
        execute(['slam', 'seal', str(tmp_path), '-o', str(tmp_path / 'c.yaml')])


@pytest.mark.parametrize('name', packaged_names('seal'))
def test_packaged_seals_are_of_the_present_ground(name: str) -> None:
    """A new recipe of worlds makes other drives: then they are to be sealed anew."""
    seal = read_seal(find_file('seal', name))
    drive = seal.drive(seal.scenarios[0], seal.seeds[0])
    world = drive.load_scenario().load_world()
    assert world.hash == seal.drives[drive.name].world
    assert {'reference', 'graph', 'wheels'} <= {row['system'] for row in seal.results}
