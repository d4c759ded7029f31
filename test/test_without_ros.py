"""Commands and nodes where no ROS, or no extra, is installed."""

from pathlib import Path
import subprocess
import sys

from command_line import unfolded
from waiting import LIMIT_S

ROOT = Path(__file__).resolve().parent.parent


# Hides rclpy, as where no ROS 2 is installed; then runs a console script.
_WITHOUT_ROS = """
import importlib.abc, sys
class Hide(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == 'rclpy':
            raise ModuleNotFoundError(name)
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == 'rclpy' else found(name, *rest)
sys.meta_path.insert(0, Hide())
from lunar_rover_sim.{module} import {function}
sys.argv = {words}
sys.exit({function}({argument}))
"""


def without_ros(module: str, function: str, argument: str = '', words: str = '[""]') \
        -> subprocess.CompletedProcess[str]:
    """Run a function of ours in a process where rclpy cannot be imported."""
    script = _WITHOUT_ROS.format(module=module, function=function, argument=argument,
                                 words=words)
    return subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          cwd=ROOT, timeout=LIMIT_S)


def test_nodes_without_ros() -> None:
    """A node says in one line what is missing and how to get it."""
    finished = without_ros('nodes.entry_points', 'main', words="['', 'render_node']")
    assert finished.returncode == 1
    assert finished.stderr.count('\n') == 1
    assert 'rclpy is missing' in finished.stderr
    assert "pip install '.[ros]' in a clone" in finished.stderr


def test_run_without_ros(tmp_path: Path) -> None:
    """So does `run`, before it makes its folder; other commands do without ROS."""
    folder = tmp_path / 'run'
    finished = without_ros('cli.main', 'main', f"['run', 'flat', '-o', {str(folder)!r}]")
    assert finished.returncode == 1
    error, = unfolded(finished.stderr).splitlines()
    assert 'rclpy is missing' in error
    assert not folder.exists()
    finished = without_ros('cli.main', 'main', "['bag', 'check', '/no/such/bag']")
    assert finished.stderr == 'lunar_rover_sim: /no/such/bag: there is no such bag\n'


# What the extras bring; each is imported by the command that needs it, when it needs it.
_EXTRAS = ('distributed', 'gymnasium', 'onnx', 'onnxruntime', 'pxr', 'rclpy', 'sb3_contrib',
           'stable_baselines3', 'websockets')


def test_every_command_starts_without_extras() -> None:
    """In a process of its own: here the modules of the package have been imported before."""
    script = f"""
import sys
sys.modules.update(dict.fromkeys({_EXTRAS!r}))
from lunar_rover_sim.cli.main import COMMANDS, load
for name in COMMANDS:
    load(name)
"""
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              cwd=ROOT, timeout=LIMIT_S)
    assert finished.returncode == 0, finished.stderr
