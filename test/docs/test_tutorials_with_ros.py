"""Parts of the documentation that need a running graph: they do what their text says."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys
from typing import Any

from conftest import simulate, SMALL
import pytest
from snippets import ROOT, Snippet, snippets
import yaml

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.run.ros_domain import OwnDomain
from lunar_rover_sim.run.scenario import Scenario

pytestmark = pytest.mark.ros

WITHOUT_CAMERAS = ['physics_node', 'gait_controller_node', 'drive_node', 'recorder_node']


def blocks(page: str, language: str) -> list[Snippet]:
    """Return the code blocks of one page."""
    return [snippet for snippet in snippets(language) if snippet.page == ROOT / 'docs' / page]


def test_own_controller(tmp_path: Path) -> None:
    """The node of the tutorial drives in lockstep: one command per period, none missing.

    Its images are left out here.
    """
    page = 'tutorials/controller.md'
    (program,), (scenario,) = blocks(page, 'python'), blocks(page, 'yaml')
    (tmp_path / 'wiggle.py').write_text(program.text, encoding='utf-8')
    (tmp_path / 'wiggle.yaml').write_text(scenario.text, encoding='utf-8')
    with OwnDomain() as own:
        free = str(own.id)
    node = subprocess.Popen([sys.executable, str(tmp_path / 'wiggle.py')],
                            env={**os.environ, 'ROS_DOMAIN_ID': free})
    try:
        finished = simulate(
            tmp_path / 'run', '--duration', '2', '--domain', free, '--set',
            'run.nodes=[physics_node, gait_controller_node, recorder_node]', '--set',
            'physics_node.ground.model=rigid', scenario=str(tmp_path / 'wiggle.yaml'))
    finally:
        node.kill()
        node.wait()
    assert finished.returncode == 0, finished.stdout + finished.stderr
    with open_bag(tmp_path / 'run' / 'bag') as bag:
        turns = [message.twist.angular.z for _, _, message in bag.messages(['cmd_vel'])]
        assert turns == 39 * [-0.2] + [0.2]


def test_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                capsys: pytest.CaptureFixture[str]) -> None:
    """The page on recording from Python records two bags; here smaller and shorter ones."""
    load = Scenario.load

    def load_small(name: str, changes: dict[str, Any], **options: Any) -> Scenario:
        small = dict(text.split('=') for text in SMALL)
        values = {name: yaml.safe_load(text) for name, text in small.items()}
        values['run.nodes'] = WITHOUT_CAMERAS
        values['physics_node.ground.model'] = 'rigid'
        return load(name, {**values, **changes}, **{**options, 'duration_s': 1.0})

    block = blocks('howto/bags_in_python.md', 'python')[0]
    monkeypatch.setattr(Scenario, 'load', load_small)
    monkeypatch.chdir(tmp_path)
    exec(compile(block.text, block.name, 'exec'), {})
    for line, elevation in zip(capsys.readouterr().out.splitlines(), ('2', '6'), strict=True):
        bag, odometry, simulated_s, factor = line.split()
        assert Path(bag) == Path(os.getcwd()) / 'runs' / f'sun_{elevation}' / 'bag'
        assert (odometry, simulated_s) == ('200', '1.0')
        assert float(factor) > 0.0
