"""What is recognised as finished, what is made again, what is left alone; no ROS."""

from collections.abc import Callable
import json
import os
from pathlib import Path
import shutil
from typing import Any

import pytest
import synthetic_bag

from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.base.errors import CampaignError
from lunar_rover_sim.campaign.campaign_file import EpisodePlan, parse_campaign, plan
from lunar_rover_sim.campaign.card import write_card
from lunar_rover_sim.campaign.dataset import Dataset, verify
from lunar_rover_sim.campaign.episode_process import finish
from lunar_rover_sim.campaign.manifest import (EPISODES, file_table, MANIFEST, read_json,
                                               why_unfinished, write_json)
from lunar_rover_sim.campaign.statistics import MEANINGS, statistics
from lunar_rover_sim.cli.main import main

CAMPAIGN = parse_campaign('episodes: 3\nsettings: {run.duration_s: 1.0}',
                          Path('/nowhere/test.yaml'))


@pytest.fixture(scope='module')
def plans() -> list[EpisodePlan]:
    """Return the plans of the small campaign."""
    return list(plan(CAMPAIGN))


def task(scenario_hash: str = '', **more: object) -> dict[str, Any]:
    """Return what an episode is asked to be."""
    return {'name': '0000', 'drawn': {'seed': 1}, 'formats': ['tum'], 'keep_bag': True,
            'scenario_sha256': scenario_hash, **more}


def run_folder(folder: Path) -> Path:
    """Lay out the folder of a run whose bag is the analytic one."""
    folder.mkdir(parents=True)
    synthetic_bag.write(folder / 'bag', synthetic_bag.drive(1.0))
    (folder / 'scenario.yaml').write_text('x: 1\n')
    return folder


@pytest.fixture(scope='module')
def episode(tmp_path_factory: pytest.TempPathFactory, plans: list[EpisodePlan]) -> Path:
    """Return a finished episode, made from an analytic bag."""
    folder = run_folder(tmp_path_factory.mktemp('made') / 'episode')
    finish(folder, task(plans[0].scenario_hash), 1.0)
    return folder


def test_manifest_tells_all(episode: Path, plans: list[EpisodePlan]) -> None:
    """Every file with size and hash; the bag's hash; the check; every statistic named."""
    manifest = read_json(episode / MANIFEST)
    assert manifest['bag_hash'] == bag_hash(episode / 'bag')
    assert set(manifest['files']) == {
        p.relative_to(episode).as_posix() for p in episode.rglob('*')
        if p.is_file() and p.name != MANIFEST}
    assert {entry['status'] for entry in manifest['check']} <= {'pass', 'warn', 'skip'}
    assert set(MEANINGS) <= set(manifest['statistics'])
    assert why_unfinished(episode, plans[0].scenario_hash) is None


def test_statistics_of_the_analytic_bag(episode: Path) -> None:
    """Path, sun, noise and depth are those that the bag was made with."""
    found = statistics(episode / 'bag')
    assert found['frames'] == 10
    # From the first sample at 0.005 s to the last one at 1 s, on an arc.
    assert found['distance_m'] == pytest.approx(0.995 * synthetic_bag.SPEED, rel=1e-3)
    assert found['sun_azimuth_deg'] == pytest.approx(30.0)
    assert found['sun_elevation_deg'] == pytest.approx(10.0)
    # 1e-2 m/s^2 and 1e-3 rad/s per sample at 200 Hz; 200 samples know it to 5 %.
    assert found['accel_noise_density'] == pytest.approx(1e-2 / 200**0.5, rel=0.15)
    assert found['gyro_noise_density'] == pytest.approx(1e-3 / 200**0.5, rel=0.15)
    assert found['sgm_error_px'] < 1e-4
    assert abs(found['sgm_bias_px']) < 1e-4
    assert 0.0 < found['ground_share'] < 1.0
    # Levels are uniform from 30 to 230 and stand for the root of the signal: bright ground is 210,
    # 5 % of its signal is 210 sqrt(0.05) = 47.
    assert found['shadow_share'] == pytest.approx((47.0 - 30.0) / 200.0, abs=0.015)
    assert found['textured_share'] > 0.5


def cut(path: Path) -> None:
    """Lose the end of a file."""
    os.truncate(path, path.stat().st_size - 1)


def flip(path: Path) -> None:
    """Change one byte."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


@pytest.mark.parametrize(('name', 'damage', 'match'), [
    ('bag/bag.mcap', cut, 'bytes'),
    ('bag/bag.mcap', flip, 'is not what was recorded'),
    ('scenario.yaml', Path.unlink, 'is missing'),
    ('tum/groundtruth.txt', flip, 'is not what was recorded'),
    (MANIFEST, Path.unlink, 'cannot be read'),
    (MANIFEST, lambda p: p.write_text('{}'), 'format None'),
    (MANIFEST, lambda p: p.write_text('[' * 100_000), 'cannot be read'),
    (MANIFEST, lambda p: p.write_bytes(b'\xff\x00'), 'cannot be read')])
def test_damage_is_found(name: str, damage: Callable[[Path], None], match: str, episode: Path,
                         plans: list[EpisodePlan], tmp_path: Path) -> None:
    """A byte more or less, and the episode is not finished."""
    copy = tmp_path / 'copy'
    shutil.copytree(episode, copy)
    assert why_unfinished(copy, plans[0].scenario_hash) is None
    damage(copy / name)
    assert match in (why_unfinished(copy, plans[0].scenario_hash) or 'nothing')


def test_survey(episode: Path, plans: list[EpisodePlan], tmp_path: Path) -> None:
    """Finished stays, damaged and half-written are made again, failed waits for --retry."""
    data = tmp_path / 'data'
    with Dataset(data, CAMPAIGN) as dataset:
        dataset.record()
        shutil.copytree(episode, data / EPISODES / '0000')
        shutil.copytree(episode, data / EPISODES / '0001')
        (data / EPISODES / '0001' / MANIFEST).unlink()
        (data / 'partial' / '0002.abc').mkdir()
        write_json_in(data / 'failed' / '0002', {'error': 'no disk'})
        progress = dataset.survey(plans, retry=False)
        assert progress.finished == ['0000']
        assert list(progress.remade) == progress.missing == ['0001']
        assert progress.failed == {'0002': 'no disk'}
        assert dataset.survey(plans, retry=True).missing == ['0001', '0002']
        with pytest.raises(CampaignError, match='another campaign is writing'):
            Dataset(data, CAMPAIGN)
    assert not list((data / 'partial').iterdir())
    card = write_card(data)
    assert list(card['episodes']) == ['0000']
    text = (data / 'README.md').read_text()
    assert '1 episode, 1 more failed' in text
    assert all(name in text for name in MEANINGS)


def write_json_in(folder: Path, content: dict[str, str]) -> None:
    """Write error.json into a new folder."""
    folder.mkdir(parents=True)
    write_json(folder / 'error.json', content)


def test_another_campaign_is_not_overwritten(episode: Path, plans: list[EpisodePlan],
                                             tmp_path: Path) -> None:
    """An episode of another scenario, or a folder of something else, is left as it is."""
    data = tmp_path / 'data'
    with Dataset(data, CAMPAIGN) as dataset:
        shutil.copytree(episode, data / EPISODES / '0001')  # it was made from 0000's scenario
        with pytest.raises(CampaignError, match='made from another scenario'):
            dataset.survey(plans, retry=False)
    assert why_unfinished(data / EPISODES / '0001') is None
    (tmp_path / 'home').mkdir()
    (tmp_path / 'home' / 'letter.txt').write_text('x')
    with pytest.raises(CampaignError, match='not a data set'):
        Dataset(tmp_path / 'home', CAMPAIGN)
    assert [p.name for p in (tmp_path / 'home').iterdir()] == ['letter.txt']


def test_a_bag_that_fails_its_check_is_no_episode(tmp_path: Path) -> None:
    """The reason names check and finding."""
    items = [i for i in synthetic_bag.drive(1.0) if i.topic != 'imu/data_raw']
    synthetic_bag.write(tmp_path / 'bag', items[:-40])
    with pytest.raises(CampaignError, match='the bag check failed: .*imu/data_raw'):
        finish(tmp_path, task(formats=[]), 1.0)


def test_exports_can_stand_alone(tmp_path: Path) -> None:
    """keep_bag: false leaves the formats, and the manifest lists no bag."""
    folder = run_folder(tmp_path / 'run')
    finish(folder, task(keep_bag=False), 1.0)
    manifest = read_json(folder / MANIFEST)
    assert not any(name.startswith('bag/') for name in manifest['files'])
    assert manifest['bag_hash']
    assert (folder / 'tum' / 'associations.txt').is_file()


def test_links_are_not_followed(tmp_path: Path) -> None:
    """A link in an episode does not pull the rest of the disk into its manifest."""
    (tmp_path / 'a').write_text('x')
    (tmp_path / 'world').symlink_to('/etc')
    (tmp_path / 'passwd').symlink_to('/etc/passwd')
    assert list(file_table(tmp_path)) == ['a']


@pytest.fixture()
def dataset(tmp_path: Path) -> Path:
    """Return a data set of three small episodes, as their plan has them; the last one failed."""
    data = tmp_path / 'data'
    with Dataset(data, CAMPAIGN) as made:
        made.record()
    for planned in list(plan(CAMPAIGN))[:2]:
        folder = data / EPISODES / planned.name
        folder.mkdir()
        for name in ('scenario.yaml', 'bag.mcap'):
            (folder / name).write_text(f'{name} of {planned.name}')
        write_json(folder / MANIFEST, {
            'format': 1, 'name': planned.name, 'scenario_sha256': planned.scenario_hash,
            'drawn': planned.drawn, 'files': file_table(folder)})
    write_json_in(data / 'failed' / '0002', {'error': 'no disk'})
    return data


@pytest.mark.parametrize(('change', 'found'), [
    (lambda d: None, {}),
    (lambda d: flip(d / '0000' / 'bag.mcap'),
     {'0000': 'bag.mcap is not what was recorded'}),
    (lambda d: (d / '0000' / 'bag.mcap').unlink(), {'0000': "'bag.mcap' is missing"}),
    (lambda d: (d / '0001' / 'notes.txt').write_text('mine'), {'0001': 'notes.txt was added'}),
    (lambda d: (d / '0001' / 'bag.mcap').rename(d / '0001' / 'other.mcap'),
     {'0001': 'bag.mcap was renamed to other.mcap'}),
    (lambda d: shutil.rmtree(d / '0001'), {'0001': 'is missing'}),
    (lambda d: (d / '0001').rename(d / '0007'),
     {'0001': 'is missing', '0007': 'is not in the plan'}),
    (lambda d: (d / '0001').rename(d / '0002'),
     {'0001': 'is missing', '0002': "is episode '0001': the folder was renamed"}),
    (lambda d: (d / '0000' / 'passwd').symlink_to('/etc/passwd'), {'0000': 'passwd is no file'}),
    (lambda d: (d / '0000' / 'world').symlink_to('/etc'), {}),
    (lambda d: (d / 'readme').write_text('mine'), {'readme': 'is not in the plan'}),
    (lambda d: shutil.rmtree(d.parent / 'failed'), {'0002': 'is missing'}),
    (lambda d: (d / '0000' / MANIFEST).write_text(
        (d / '0000' / MANIFEST).read_text().replace('"seed": ', '"seed": 1')),
     {'0000': 'its drawn values are not those of the plan'}),
    (lambda d: (d.parent / 'campaign.json').unlink(), {'campaign.json': 'the plan is not known'}),
    (lambda d: (d.parent / 'campaign.json').write_text(
        (d.parent / 'campaign.json').read_text().replace('"episodes": 3', '"episodes": 2')),
     {'campaign.json': 'was changed'}),
])
def test_verify_compares_with_the_plan(change: Callable[[Path], object], found: dict[str, str],
                                       dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What was changed, deleted, added or renamed is named, and nothing else."""
    change(dataset / EPISODES)
    problems = verify(dataset).problems
    assert set(problems) == set(found)
    assert all(found[name] in problems[name] for name in found)
    assert main(['dataset', 'verify', str(dataset)]) == (1 if found else 0)
    said = capsys.readouterr().out
    assert all(f'{name}: ' in said for name in found)
    assert found or '2 of 3 episodes are as they were made, 1 failed' in said


def test_verify_computes_the_hash_of_a_bag_anew(dataset: Path) -> None:
    episode = dataset / EPISODES / '0000'
    bag = synthetic_bag.write(episode / 'bag', synthetic_bag.drive(0.2))
    manifest = json.loads((episode / MANIFEST).read_text())
    manifest.update(bag_hash=bag_hash(bag), files=file_table(episode))
    write_json(episode / MANIFEST, manifest)
    assert not verify(dataset).problems
    write_json(episode / MANIFEST, {**manifest, 'bag_hash': 64 * '0'})
    assert 'is not that of its bag' in verify(dataset).problems['0000']
