"""The pool of episodes: what it is told, what ends, and what one failure does to the others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from lunar_rover_sim.campaign.campaign_file import parse_campaign
from lunar_rover_sim.campaign.dataset import Dataset
from lunar_rover_sim.campaign.episode import EpisodeTask, make_episode, Outcome
from lunar_rover_sim.campaign.episode_plans import EpisodePlan, plan
from lunar_rover_sim.campaign.schedulers import run_local

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

    monkeypatch.setattr('lunar_rover_sim.campaign.schedulers.make_episode', slow)
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

    monkeypatch.setattr('lunar_rover_sim.campaign.schedulers.make_episode', broken)
    outcomes: list[Outcome] = []
    with Dataset(tmp_path / 'data', CAMPAIGN) as dataset:
        run_local(dataset.tasks(plans, [p.name for p in plans]), tmp_path, 2, outcomes.append)
    assert {o.name: o.error for o in outcomes} == {
        '0000': '', '0001': 'RuntimeError: unexpected', '0002': ''}
