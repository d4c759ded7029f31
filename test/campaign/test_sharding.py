"""Shards of a whole data set, and the pool that makes its episodes."""

from collections.abc import Callable
import json
from pathlib import Path
import shutil
import tarfile

import pytest
import synthetic_bag

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import CampaignError, ConfigError
from lunar_rover_sim.campaign.campaign_file import EpisodePlan, parse_campaign, plan
from lunar_rover_sim.campaign.dataset import Dataset
from lunar_rover_sim.campaign.episode import EpisodeTask, make_episode, Outcome, run_local
from lunar_rover_sim.campaign.manifest import CAMPAIGN_FILE, EPISODES, MANIFEST, write_json
from lunar_rover_sim.campaign.sharding import Episode, split_worlds
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.products.sequences.export import export
from lunar_rover_sim.products.sequences.webdataset import ShardOptions

# Episode → base and world. Two drives share a world.
EPISODE_WORLDS = {'0000': ('a', 'w0'), '0001': ('a', 'w1'), '0002': ('a', 'w0'),
                  '0003': ('b', 'w2'), '0004': ('b', 'w3')}


@pytest.fixture(scope='module')
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five episodes of 2 frames on four worlds; the last one has shards instead of a bag."""
    folder = tmp_path_factory.mktemp('data')
    write_json(folder / CAMPAIGN_FILE, {'campaign': {'name': 'few', 'base': 'a'}})
    drive = synthetic_bag.drive(0.2, only=(topics.LEFT_IMAGE, topics.LEFT_INFO, topics.TF_STATIC,
                                           topics.ODOM))
    for name, (base, world) in EPISODE_WORLDS.items():
        episode = folder / EPISODES / name
        told = synthetic_bag.text(topics.WORLD_HASH, world)
        synthetic_bag.write(episode / 'bag', [*drive, told])
        write_json(episode / MANIFEST, {'name': name, 'drawn': {'base': base} if base == 'b'
                                        else {}, 'statistics': {}})
    export(episode / 'bag', episode / 'webdataset', 'webdataset',
           shards=ShardOptions(name))
    shutil.rmtree(episode / 'bag')
    return folder


def keys(folder: Path, split: str) -> list[str]:
    found = []
    for path in sorted(folder.glob(f'{split}-*.tar')):
        with tarfile.open(path) as tar:
            found += [name.partition('.')[0] for name in tar.getnames() if name.endswith('json')]
    return found


def test_worlds_are_split_and_nothing_is_lost(dataset: Path, tmp_path: Path,
                                              capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / 'shards'
    assert main(['dataset', 'shards', str(dataset), '-o', str(output), '--test', '0.5',
                 '--shard-size', '3']) == 0
    assert 'samples in' in capsys.readouterr().out
    train, test = keys(output, 'train'), keys(output, 'test')
    assert sorted(train + test) == [f'{name}-{k:06d}' for name in EPISODE_WORLDS for k in (0, 1)]
    worlds = [{EPISODE_WORLDS[key[:4]][1] for key in part} for part in (train, test)]
    assert not worlds[0] & worlds[1] and set.union(*worlds) == {'w0', 'w1', 'w2', 'w3'}
    bases = [{EPISODE_WORLDS[key[:4]][0] for key in part} for part in (train, test)]
    assert bases == [{'a', 'b'}, {'a', 'b'}]
    for split, part in (('train', train), ('test', test)):
        index = json.loads((output / f'{split}.json').read_text())
        assert sum(s['nsamples'] for s in index['shardlist']) == len(part)
        assert set(index['drives']) == {key[:4] for key in part}
        assert all((output / s['url']).stat().st_size == s['filesize']
                   for s in index['shardlist'])
    assert sorted(p.suffix for p in output.iterdir() if p.suffix != '.tar') == ['.json', '.json']


def test_splits_are_the_same_every_time() -> None:
    drives = [Episode(f'{k:04d}', 'a', f'world {k}') for k in range(20)]
    split_of = split_worlds(drives, {'val': 0.1, 'test': 0.2})
    assert split_of == split_worlds(drives[::-1], {'val': 0.1, 'test': 0.2})
    found = list(split_of.values())
    assert [found.count(name) for name in ('train', 'val', 'test')] == [14, 2, 4]
    assert set(split_worlds(drives, {'val': 0.0, 'test': 0.0}).values()) == {'train'}


def test_what_cannot_be_split_is_refused(dataset: Path, tmp_path: Path) -> None:
    one = [Episode('0000', 'a', 'w')]
    with pytest.raises(CampaignError, match='a: 1 worlds are too few for test'):
        split_worlds(one, {'test': 0.2})
    for shares in ({'test': -0.1}, {'test': 1.0}, {'val': 0.5, 'test': 0.5}):
        with pytest.raises(ConfigError, match='is not valid'):
            split_worlds(one, shares)
    for other in ('nothing', dataset / EPISODES):
        assert main(['dataset', 'shards', str(other), '-o', str(tmp_path / 'x')]) == 1
    assert not list(tmp_path.iterdir())


CAMPAIGN = parse_campaign('episodes: 3\nsettings: {run.duration_s: 1.0}',
                          Path('/nowhere/test.yaml'))


@pytest.fixture(scope='module')
def plans() -> list[EpisodePlan]:
    """Return the plans of the small campaign."""
    return list(plan(CAMPAIGN))


def test_a_worker_that_does_not_see_the_folder_says_so(plans: list[EpisodePlan],
                                                       tmp_path: Path) -> None:
    """A cluster without a shared folder fails at once, and by name."""
    with Dataset(tmp_path / 'data', CAMPAIGN) as dataset:
        outcome = make_episode(dataset.tasks(plans, ['0000'])[0], tmp_path / 'elsewhere')
        assert 'does not see the folder' in outcome.error


def test_the_pool_stops_when_told(plans: list[EpisodePlan], tmp_path: Path,
                                  monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C: what runs is told to stop, what waits is not begun, the exception goes on."""
    begun: list[str] = []

    def slow(task: EpisodeTask, dataset: Path, stop: Callable[[], bool]) -> Outcome:
        name = task.plan.name
        begun.append(name)
        while not stop() and name != '0000':
            pass
        return Outcome(name, '', 0.0)

    def interrupt(outcome: Outcome) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr('lunar_rover_sim.campaign.episode.make_episode', slow)
    with Dataset(tmp_path / 'data', CAMPAIGN) as dataset:
        tasks = dataset.tasks(plans, [p.name for p in plans])
        with pytest.raises(KeyboardInterrupt):
            run_local(tasks, tmp_path, 1, interrupt)
    assert begun[0] == '0000'
    assert '0002' not in begun


def test_an_error_of_one_episode_is_not_that_of_the_others(
        plans: list[EpisodePlan], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even an unexpected one is reported as the failure of its episode."""
    def broken(task: EpisodeTask, dataset: Path, stop: Callable[[], bool]) -> Outcome:
        if task.plan.name == '0001':
            raise RuntimeError('unexpected')
        return Outcome(task.plan.name, '', 0.0)

    monkeypatch.setattr('lunar_rover_sim.campaign.episode.make_episode', broken)
    outcomes: list[Outcome] = []
    with Dataset(tmp_path / 'data', CAMPAIGN) as dataset:
        run_local(dataset.tasks(plans, [p.name for p in plans]), tmp_path, 2, outcomes.append)
    assert {o.name: o.error for o in outcomes} == {
        '0000': '', '0001': 'RuntimeError: unexpected', '0002': ''}
