"""The second half of an episode, in a process of its own: check, export, describe, seal.

    python -m lunar_rover_sim.campaign.finish FOLDER

FOLDER is that of an attempt: task.json, and the run in episodes/.
"""

from __future__ import annotations

from pathlib import Path
import shutil
import sys
from typing import Any

from lunar_rover_sim import __version__
from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.campaign.layout import EPISODES, TASK_FILE
from lunar_rover_sim.campaign.manifest import file_table, FORMAT, MANIFEST, read_json, write_json
from lunar_rover_sim.campaign.statistics import statistics
from lunar_rover_sim.errors import BagError, LunarRoverSimError
from lunar_rover_sim.inspection.check import check
from lunar_rover_sim.run.plan import BAG_FOLDER
from lunar_rover_sim.sequences.export import export


def finish(attempt: Path) -> None:
    """Check the bag, export it, write the manifest; BagError where the check fails."""
    task = read_json(attempt / TASK_FILE)
    folder = attempt / EPISODES
    bag = folder / BAG_FOLDER
    report = check(bag)
    if not report.ok:
        raise BagError('the bag check failed: ' + '; '.join(
            f'{finding.check}: {finding.detail}' for finding in report.failed))
    notes = {kind: export(bag, folder / kind, kind)[1:] for kind in task['formats']}
    manifest: dict[str, Any] = {
        'format': FORMAT, 'name': task['name'], 'version': __version__,
        'scenario_sha256': task['scenario_sha256'], 'drawn': task['drawn'],
        'bag_hash': bag_hash(bag), 'run_wall_s': task['run_wall_s'],
        'check': [{'check': f.check, 'status': f.status.value, 'detail': f.detail}
                  for f in report.findings],
        'export_notes': notes, 'statistics': statistics(bag)}
    if not task['keep_bag']:
        shutil.rmtree(bag)
    manifest['files'] = file_table(folder)
    write_json(folder / MANIFEST, manifest)


def main() -> int:
    """Finish the attempt that the command line names; one line says why it could not be."""
    try:
        finish(Path(sys.argv[1]))
    except (LunarRoverSimError, OSError) as error:
        print(' '.join(str(error).split()), file=sys.stderr)
        return 1
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
