"""`lunar_rover_sim campaign`: many randomised runs into a data set; `dataset`: what is in it."""

from __future__ import annotations

from pathlib import Path
import signal

import click

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import counted
from lunar_rover_sim.campaign.campaign_file import (Campaign, draw, episode_names,
                                                    episode_scenario, load_campaign, plan)
from lunar_rover_sim.campaign.card import write_card
from lunar_rover_sim.campaign.dataset import Dataset, DatasetProgress
from lunar_rover_sim.campaign.dataset import status as status_of
from lunar_rover_sim.campaign.dataset import verify as verify_files
from lunar_rover_sim.campaign.episode import EpisodeTask, Outcome, run_local, run_on_cluster
from lunar_rover_sim.campaign.sharding import TEST, VALIDATION, write_shards
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, Progress, say
from lunar_rover_sim.products.sequences.webdataset import DEFAULT_SIZE
from lunar_rover_sim.run.ros_domain import require_ros

_CHECKED = 100     # episodes whose parameters a dry run checks; each takes some 10 ms


@options.command()
@options.argument('campaign', 'name of a packaged campaign, or a YAML file', metavar='CAMPAIGN')
@options.folder('folder of the data set; may hold part of it', required=False)
@options.workers('episodes side by side on this machine')
@click.option('--scheduler', metavar='ADDRESS', help='send episodes to the Dask cluster at '
              'tcp://host:port, whose workers share DIR')
@click.option('--retry', is_flag=True, help='repeat episodes that failed')
@click.option('--dry-run', is_flag=True,
              help='print what would be drawn for each episode, record nothing')
def campaign(campaign: str, output: Path | None, workers: int, scheduler: str | None, retry: bool,
             dry_run: bool) -> int:
    """Record the episodes of a campaign file.

    Checks and exports each, and writes a data card. The same call goes on with what is missing.
    Exits with 1 where an episode failed.
    """
    loaded = load_campaign(campaign)
    if dry_run:
        return _dry_run(loaded)
    if output is None:
        raise ConfigError('-o is missing: name the folder of the data set')
    plans = []
    with Progress('planning', loaded.count, 'episodes') as progress:
        for planned in plan(loaded):
            plans.append(planned)
            progress.advance()
    require_ros()
    # SIGTERM stops a campaign as Ctrl-C does: unfinished episodes are dropped, the others stay.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with Dataset(output, loaded) as dataset:
        with Progress('looking at what is there') as progress:
            found = dataset.survey(plans, retry, progress.named)
        dataset.record()
        for name, reason in found.remade.items():
            say(f'{name} is made again: {reason}')
        say(f'{loaded.config.name}: {counted(len(plans), "episode")}, '
            f'{len(found.finished)} there, {len(found.missing)} to make'
            + (f', {len(found.failed)} failed before (--retry makes them again)'
               if found.failed else ''))
        try:
            _make(dataset, dataset.tasks(plans, found.missing), workers, scheduler, found)
        except KeyboardInterrupt:
            say('interrupted; the same call goes on from here')
            raise
        finally:
            card = write_card(dataset.folder)
    there = len(card['episodes'])
    say(f'{there} of {counted(len(plans), "episode")} in {dataset.folder}; data card: '
        f'{dataset.folder / "README.md"}')
    return 0 if there == len(plans) else 1


def _dry_run(campaign: Campaign) -> int:
    """Print what is drawn for each episode; check the parameters of the first ones."""
    drawings = list(zip(episode_names(campaign), draw(campaign)))
    for name, drawn in drawings[:_CHECKED]:
        episode_scenario(campaign, name, drawn)
    for name, drawn in drawings:
        print(f'{name}: ' + ', '.join(f'{key} = {value}' for key, value in drawn.items()))
    if campaign.count > _CHECKED:
        print(f'checked: the parameters of the first {_CHECKED} of {campaign.count} episodes')
    return 0


def _make(dataset: Dataset, tasks: list[EpisodeTask], workers: int, scheduler: str | None,
          found: DatasetProgress) -> None:
    """Run the tasks here or on a cluster, and show the progress."""
    simulated_s = {task.plan.name: task.plan.duration_s for task in tasks}

    with Progress('recording', sum(simulated_s.values()), 's simulated') as progress:
        made = failed = 0

        def done(outcome: Outcome) -> None:
            nonlocal made, failed
            if outcome.error:
                failed += 1
                found.failed[outcome.name] = outcome.error
                say(f'{outcome.name} failed: {outcome.error}')
            else:
                made += 1
                say(f'{outcome.name}: {outcome.frames} frames in {outcome.wall_s:.0f} s')
            progress.advance(simulated_s[outcome.name], f'{made}/{len(tasks)} made'
                             + (f', {failed} failed' if failed else ''))

        if not tasks:
            return
        if scheduler is not None:
            run_on_cluster(tasks, dataset.folder, scheduler, done)
        else:
            run_local(tasks, dataset.folder, workers, done)


_folder = options.argument('dataset', 'folder of the data set', type=options.PATH, metavar='DIR')


@options.command()
@_folder
@options.as_json
def status(dataset: Path, as_json: bool) -> int:
    """Print how many episodes are finished, failed and missing."""
    found = status_of(dataset)
    if as_json:
        print_json(found)
        return 0
    say(f'{found["campaign"]}: {len(found["finished"])} of {found["planned"]} episodes finished, '
        f'{len(found["failed"])} failed, {len(found["missing"])} missing')
    for name, error in found['failed'].items():
        say(f'{name} failed: {error}')
    return 0


@options.command()
@_folder
def verify(dataset: Path) -> int:
    """Compare the episodes with the plan, and every file with the manifests.

    Exits with 1 if anything was changed, deleted, added or renamed.
    """
    with Progress('verifying') as progress:
        found = verify_files(dataset, progress.named)
    for name, reason in found.problems.items():
        say(f'{name}: {reason}')
    if found.problems:
        say(f'{len(found.problems)} differences from the plan of {found.planned} '
            'episodes and their manifests')
        return 1
    failed = f', {len(found.failed)} failed' if found.failed else ''
    say(f'{found.planned - len(found.failed)} of {found.planned} episodes are as they '
        f'were made{failed}')
    return 0


def _share(split: str, meaning: str) -> options.Decorator:
    return click.option(f'--{split}', type=float, default=0.0, metavar='SHARE',
                        help=f'share of the worlds of each scenario that are for {meaning}')


@options.command()
@_folder
@options.new_folder('folder of the shards')
@click.option('--shard-size', type=int, default=DEFAULT_SIZE, metavar='N',
              help='samples per shard')
@_share(VALIDATION, 'validation')
@_share(TEST, 'test')
def shards(dataset: Path, output: Path, shard_size: int, **shares: float) -> int:
    """Write WebDataset shards of all drives, split by world."""
    with Progress('writing') as progress:
        notes = write_shards(dataset, output, shard_size, shares, progress.named)
    for note in notes:
        print(note)
    return 0


@options.command()
@_folder
def card(dataset: Path) -> int:
    """Write the data card anew: README.md, card.json, episodes.csv, croissant.json."""
    write_card(dataset)
    print(dataset / 'README.md')
    return 0
