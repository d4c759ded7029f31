"""`lunar_rover_sim campaign`: many randomised runs into one data set."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
from pathlib import Path
import signal
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from lunar_rover_sim.campaign.campaign_file import Campaign, load_campaign
from lunar_rover_sim.campaign.card import write_card
from lunar_rover_sim.campaign.dataset import Dataset, DatasetProgress
from lunar_rover_sim.campaign.episode import EpisodeTask, Outcome
from lunar_rover_sim.campaign.episode_plans import draw, episode_names, episode_scenario, plan
from lunar_rover_sim.campaign.schedulers import run_local, run_on_cluster
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.outputs import check_folder
from lunar_rover_sim.files.wording import counted
from lunar_rover_sim.run.ros_installation import require_ros

_CHECKED = 100     # episodes whose parameters a dry run checks; each takes some 10 ms
_PLAIN: dict[str, Any] = {'highlight': False, 'markup': False, 'soft_wrap': True}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Record the episodes of a campaign file, check each one, export it, and '
        'write a data card. What is there already is kept: the same call goes on '
        'after Ctrl-C, a crash or a power cut.')
    parser.add_argument('campaign', help='name of a packaged campaign, or a YAML file')
    parser.add_argument('-o', '--output', type=Path, metavar='DIR',
                        help='folder of the data set; may hold part of it')
    parser.add_argument('--jobs', type=int, default=1, metavar='N',
                        help='episodes side by side on this machine (default: %(default)s)')
    parser.add_argument('--scheduler', metavar='ADDRESS',
                        help='send episodes to the Dask cluster at this address (tcp://host:port)'
                             '; DIR must be shared by its workers')
    parser.add_argument('--retry', action='store_true', help='repeat episodes that failed')
    parser.add_argument('--dry-run', action='store_true',
                        help='print what would be drawn for each episode, record nothing')
    parser.set_defaults(run=run, check_output=check_folder)


def run(args: argparse.Namespace) -> int:
    """Make what is missing; return 1 where an episode failed."""
    if args.jobs < 1:
        raise ConfigError(f'--jobs {args.jobs}: is not valid; valid is 1 or more')
    if args.output is None and not args.dry_run:
        raise ConfigError('-o is missing: name the folder of the data set')
    campaign = load_campaign(args.campaign)
    if args.dry_run:
        return _dry_run(campaign)
    console = Console()
    plans = []
    with console.status('planning') as status:
        for planned in plan(campaign):
            plans.append(planned)
            if len(plans) % 100 == 0:
                status.update(f'planning: {len(plans)} of {campaign.count} episodes')
    require_ros()
    # SIGTERM stops a campaign as Ctrl-C does: unfinished episodes are dropped, the others stay.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with Dataset(args.output, campaign) as dataset:
        with console.status('') as status:
            progress = dataset.survey(plans, args.retry, lambda name: status.update(
                f'looking at what is there: {name}'))
        dataset.record()
        for name, reason in progress.remade.items():
            console.print(f'{name} is made again: {reason}', **_PLAIN)
        console.print(f'{campaign.config.name}: {counted(len(plans), "episode")}, '
                      f'{len(progress.finished)} there, {len(progress.missing)} to make'
                      + (f', {len(progress.failed)} failed before (--retry makes them again)'
                         if progress.failed else ''), **_PLAIN)
        try:
            _make(dataset, dataset.tasks(plans, progress.missing), args, progress, console)
        except KeyboardInterrupt:
            console.print('interrupted; the same call goes on from here', **_PLAIN)
            raise
        finally:
            card = write_card(dataset.folder)
    there = len(card['episodes'])
    console.print(f'{there} of {counted(len(plans), "episode")} in {dataset.folder}; data card: '
                  f'{dataset.folder / "README.md"}', **_PLAIN)
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


def _make(dataset: Dataset, tasks: list[EpisodeTask], args: argparse.Namespace,
          progress: DatasetProgress, console: Console) -> None:
    """Run the tasks here or on a cluster, and show the progress."""
    simulated_s = {task.plan.name: task.plan.duration_s for task in tasks}

    with _bar(console, sum(simulated_s.values())) as advance:
        made = failed = 0

        def done(outcome: Outcome) -> None:
            nonlocal made, failed
            if outcome.error:
                failed += 1
                progress.failed[outcome.name] = outcome.error
                console.print(f'{outcome.name} failed: {outcome.error}', **_PLAIN)
            else:
                made += 1
                console.print(f'{outcome.name}: {outcome.frames} frames in {outcome.wall_s:.0f} s',
                              **_PLAIN)
            advance(simulated_s[outcome.name], f'{made}/{len(tasks)} made'
                    + (f', {failed} failed' if failed else ''))

        if not tasks:
            return
        if args.scheduler is not None:
            run_on_cluster(tasks, dataset.folder, args.scheduler, done)
        else:
            run_local(tasks, dataset.folder, args.jobs, done)


@contextlib.contextmanager
def _bar(console: Console, total_s: float) -> Iterator[Any]:
    """Show a progress bar over simulated time, with the time left once an episode is done."""
    columns = (TextColumn('{task.description}'), BarColumn(),
               TextColumn('{task.completed:.0f}/{task.total:.0f} s simulated'),
               TimeElapsedColumn(), TextColumn('left'), TimeRemainingColumn())
    # Episodes take minutes: the pace is that of all of them, not of the last 30 s.
    with Progress(*columns, console=console, speed_estimate_period=1e9) as progress:
        task = progress.add_task('recording', total=total_s)

        def advance(simulated_s: float, text: str) -> None:
            progress.update(task, advance=simulated_s, description=text)

        yield advance
