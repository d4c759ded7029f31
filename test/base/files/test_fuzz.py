"""A share of the mutated inputs; all of them: `python test/fuzz/main.py`."""

from pathlib import Path
import subprocess
import sys

PROGRAM = Path(__file__).resolve().parents[2] / 'fuzz' / 'main.py'


def test_mutated_inputs_are_refused_in_one_line_or_right():
    ended = subprocess.run([sys.executable, str(PROGRAM), '--cases', '80', '--seed', '1'],
                           capture_output=True, text=True)
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-1000:]
    assert '80 cases' in ended.stdout
