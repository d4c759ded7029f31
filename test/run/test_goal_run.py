"""A rover that drives to a goal by what its cameras see, as a graph."""

from __future__ import annotations

from pathlib import Path

from conftest import PLAIN, simulate
import numpy as np
import pytest

from lunar_rover_sim import topics
from lunar_rover_sim.bag import series
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.evaluation.map_evaluation import evaluate_maps

pytestmark = pytest.mark.ros

GOAL_M = 0.6, 0.1


def test_it_maps_arrives_and_ends(tmp_path: Path) -> None:
    """On flat ground; the run ends when the navigator is done, long before its duration."""
    plain = [word for setting in PLAIN for word in ('--set', setting)]
    done = simulate(tmp_path / 'run', '--goal', '{:g},{:g}'.format(*GOAL_M), '--duration', '60',
                    '--set', 'world.craters.density=0', '--set', 'world.rocks.abundance=0',
                    *plain)
    assert done.returncode == 0, done.stderr
    with open_bag(tmp_path / 'run' / 'bag') as bag:
        topic = f'/{topics.NAVIGATOR_STATUS.name}'
        said = [status.message for _, _, message in bag.messages([topic])
                for status in message.status]
        assert 'arrived' in said[-1], said
        odometry = series.read_odometry(bag)
        assert bag.counts[f'/{topics.PLAN.name}'] >= 1
    assert np.linalg.norm(odometry.positions_m[-1, :2] - GOAL_M) < 0.3
    assert odometry.stamps_ns[-1] < 30e9
    assert evaluate_maps(tmp_path / 'run' / 'bag').near.rms_m < 0.03
