"""`lunar_rover_sim demo`: a first drive, recorded, checked and pictured."""

from __future__ import annotations

from pathlib import Path
import shlex

from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import say

_DURATION_S = 5
# To the left of the rover, so that the sun lights what it sees from the side.
_SUN = 'render_node.sun.azimuth_deg=100'


@options.command(help=f"""Record a first drive, check it and draw pictures of it.

    The drive takes {_DURATION_S} s. Each step is a command, which is printed.""")
@options.new_folder('folder of the demo; by default runs/demo-N', required=False)
@options.fast_option
def demo(output: Path | None, fast: bool) -> int:
    """Run the commands one after the other; the first one that fails ends the demo."""
    from lunar_rover_sim.cli.main import execute  # it imports this module

    folder = output or _free_folder()
    bag, pictures = folder / 'bag', folder / 'preview'
    run = ['run', 'baseline', '--duration', str(_DURATION_S), '--set', _SUN, '-o', str(folder)]
    for words in (run + (['--fast'] if fast else []),
                  ['bag', 'check', str(bag)],
                  ['bag', 'preview', str(bag), '-o', str(pictures)]):
        print(f'$ lunar_rover_sim {shlex.join(words)}', flush=True)   # one line, to be copied
        if status := execute(words):
            return status
    say(f'pictures: {pictures.resolve()}')
    return 0


def _free_folder() -> Path:
    """Return the first folder of runs/demo-1, runs/demo-2, … that there is not."""
    number = 1
    while (folder := Path('runs', f'demo-{number}')).exists():
        number += 1
    return folder
