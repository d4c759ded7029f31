"""The command `view`: physics in MuJoCo's window."""

import os
import re
import shutil
import subprocess
import sys

from command_line import unfolded
import pytest
from waiting import LIMIT_S

from lunar_rover_sim.cli.main import main

DISPLAY = ':93'


def test_without_a_display(monkeypatch: pytest.MonkeyPatch,
                           capsys: pytest.CaptureFixture[str]) -> None:
    """Where no window can open, one line says so, before a world is built."""
    for name in ('DISPLAY', 'WAYLAND_DISPLAY'):
        monkeypatch.delenv(name, raising=False)
    assert main(['view', 'flat']) == 1
    assert 'there is no display (DISPLAY is not set)' in unfolded(capsys.readouterr().err)
    assert main(['view', 'flat', '--rtf', '0']) == 1
    assert '--rtf: 0 is not valid' in unfolded(capsys.readouterr().err)


@pytest.mark.skipif(shutil.which('Xvfb') is None, reason='Xvfb is not installed')
def test_walk() -> None:
    """It walks ahead in a window of a virtual display, and ends with status 0."""
    display = subprocess.Popen(['Xvfb', DISPLAY, '-screen', '0', '640x480x24'],
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        done = subprocess.run(
            [sys.executable, '-m', 'lunar_rover_sim.cli.main', 'view', 'flat', '--duration', '1.0',
             '--rtf', '0.5', '--set', 'world.size_m=12.8', '--set',
             'world.surroundings.samples=257'],
            env={**os.environ, 'DISPLAY': DISPLAY, 'LIBGL_ALWAYS_SOFTWARE': '1'},
            capture_output=True, text=True, timeout=LIMIT_S, check=False)
    finally:
        display.kill()
        display.wait(timeout=LIMIT_S)
    assert done.returncode == 0, done.stderr
    found = re.fullmatch(r'1\.0 s, at \((\S+), \S+\) m\n', done.stdout)
    assert found is not None and float(found.group(1)) > 0.05
