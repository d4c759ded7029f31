"""The process of one episode: record, check, export, describe, put in place.

    python -m lunar_rover_sim.campaign.episode_process ATTEMPT EPISODE

ATTEMPT is the folder of the attempt, with task.json and the scenario in planned.yaml. The work is
done in its folder `episodes`, which becomes EPISODE when it is complete.
"""

from __future__ import annotations

from pathlib import Path
import shutil
import signal
import sys
from typing import Any

from lunar_rover_sim import __version__
from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base.errors import (CampaignError, ConfigError, GraphError,
                                         LunarRoverSimError, one_line, WorldError)
from lunar_rover_sim.base.files.paths import BAG_FOLDER
from lunar_rover_sim.campaign.card import recorded_topics
from lunar_rover_sim.campaign.manifest import (EPISODES, file_table, FORMAT, MANIFEST, PLAN_FILE,
                                               read_json, TASK_FILE, why_unfinished, write_json)
from lunar_rover_sim.campaign.statistics import statistics
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.products.sequences.export import export
from lunar_rover_sim.products.sequences.webdataset import ShardOptions
from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.resumable import record_once
from lunar_rover_sim.run.scenario import Scenario


def make(attempt: Path, episode: Path) -> None:
    """Record the episode of an attempt, and finish it; raise LunarRoverSimError if that fails."""
    task = read_json(attempt / TASK_FILE)
    plan = attempt / PLAN_FILE
    try:
        scenario = resolve(Scenario.load(str(plan)))
        if scenario.to_yaml() != plan.read_text(encoding='utf-8'):
            raise CampaignError('the scenario that would be run is not the one that was planned')
        record_once(
            scenario, episode, partial=attempt / EPISODES,
            why_unfinished=lambda folder: why_unfinished(folder, task['scenario_sha256']),
            finish=lambda folder, recording: finish(folder, task, recording.wall_s),
            timeout_s=task['timeout_s'])
    except (ConfigError, GraphError, WorldError) as error:
        raise CampaignError(f'the simulation failed: {error}') from None


def finish(folder: Path, task: dict[str, Any], run_wall_s: float) -> None:
    """Check the bag of a run, export it, and write the manifest.

    Args:
        folder: That of the run.
        task: What `EpisodeTask` asks for.
        run_wall_s: Wall time of the run.

    Raises:
        CampaignError: If the check fails.
        SequenceError: If the bag cannot be exported.
    """
    bag = folder / BAG_FOLDER
    report = check(bag)
    if not report.ok:
        raise CampaignError('the bag check failed: ' + '; '.join(
            f'{finding.check}: {finding.detail}' for finding in report.failed))
    shards = ShardOptions(drive=task['name'])
    notes = {kind: export(bag, folder / kind, kind, shards=shards)[1:]
             for kind in task['formats']}
    manifest: dict[str, Any] = {
        'format': FORMAT, 'name': task['name'], 'version': __version__,
        'scenario_sha256': task['scenario_sha256'], 'drawn': task['drawn'],
        'bag_hash': bag_hash(bag), 'run_wall_s': round(run_wall_s, 3),
        'check': [{'check': f.check, 'status': f.status.value, 'detail': f.detail}
                  for f in report.findings],
        'export_notes': notes, 'statistics': statistics(bag)}
    with open_bag(bag) as recorded:
        manifest['topics'] = recorded_topics(recorded)
    if not task['keep_bag']:
        shutil.rmtree(bag)
    manifest['files'] = file_table(folder)
    write_json(folder / MANIFEST, manifest)


def main() -> int:
    """Make the episode that the command line names; one line says why that failed."""
    # SIGTERM stops the nodes in order, as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        make(Path(sys.argv[1]), Path(sys.argv[2]))
    except (LunarRoverSimError, OSError) as error:
        print(one_line(error), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
