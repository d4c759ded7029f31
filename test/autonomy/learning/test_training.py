"""The training scripts: a run that was stopped goes on, and its policy is valid."""

import importlib
import json
from pathlib import Path
import subprocess
import sys

import pytest

from lunar_rover_sim.autonomy.learning.policy_file import Policy

for package in ('cma', 'onnx', 'stable_baselines3', 'tensorboard'):
    pytest.importorskip(package)
EXAMPLES = Path(__file__).parents[3] / 'examples/learning'


def trained(monkeypatch, name, folder, *words):
    """Run a training script, and return the lines of its log."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.setattr(sys, 'argv', [name, '-o', str(folder), '--ground', 'rigid', *words])
    importlib.import_module(name).main()
    return [json.loads(line) for line in (folder / 'log.jsonl').read_text('utf-8').splitlines()]


def test_a_search_that_was_stopped_goes_on(monkeypatch, tmp_path):
    words = ('--gait', 'smooth', '--population', '4', '--episodes', '1', '--episode', '0.2')
    first = trained(monkeypatch, 'train_feedback', tmp_path, *words, '--generations', '1')
    # Two processes find what one finds.
    both = trained(monkeypatch, 'train_feedback', tmp_path, *words, '--generations', '2',
                   '--workers', '2')
    alone = trained(monkeypatch, 'train_feedback', tmp_path / 'alone', *words, '--generations',
                    '2')
    assert [one.get('mean') for one in alone] == [one.get('mean') for one in both]
    assert both[:2] == first and [one['generation'] for one in both] == [0, 1, 2]
    assert both[1]['mean'] != both[2]['mean']
    card = Policy(tmp_path / 'policy.onnx').card
    assert card.decisions == 2 * 4 * 10 and card.options['gait']['gait'] == 'custom'


def test_ppo_that_was_stopped_goes_on(monkeypatch, tmp_path):
    words = ('--envs', '2', '--batch', '512', '--set', 'episode_s=0.2', '--every', '512', '--calm')
    first = trained(monkeypatch, 'train_walk', tmp_path, *words, '--decisions', '512')
    both = trained(monkeypatch, 'train_walk', tmp_path, *words, '--decisions', '1024')
    assert both[:len(first)] == first
    assert first[-1]['decisions'] == 512 and both[-1]['decisions'] == 1024
    assert Policy(tmp_path / 'policy.onnx').card.decisions == 1024


def test_sac_gives_the_speeds_of_the_legs(monkeypatch, tmp_path):
    log = trained(monkeypatch, 'train_walk', tmp_path, '--algorithm', 'sac', '--set',
                  'action=speeds', '--set', 'episode_s=0.2', '--envs', '2', '--calm',
                  '--decisions', '64')
    card = Policy(tmp_path / 'policy.onnx').card
    assert log[-1]['decisions'] == card.decisions == 64 and card.options['action'] == 'speeds'


def test_feedback_that_is_to_give_speeds_is_refused_in_one_line(tmp_path):
    """It is what PPO trains; an empty folder was left."""
    folder = tmp_path / 'walk'
    ended = subprocess.run([sys.executable, EXAMPLES / 'train_walk.py', '-o', folder, '--ground',
                            'rigid', '--set', 'action=speeds'], capture_output=True, text=True)
    assert ended.returncode == 1 and not folder.exists()
    assert ended.stderr.count('\n') == 1
    assert "action: 'speeds' is not valid" in ended.stderr and 'residual' in ended.stderr
