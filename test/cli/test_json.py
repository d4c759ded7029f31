"""--json: one object on stdout and nothing else, for every command that has a result to read."""

import json
from pathlib import Path
from typing import Any

import map_bag
import pytest
import synthetic_bag
import worlds

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.campaign.campaign_file import parse_campaign
from lunar_rover_sim.campaign.dataset import Dataset
from lunar_rover_sim.cli import main as main_module
from lunar_rover_sim.cli.main import load, main
from lunar_rover_sim.ground.world.world_folder import save_world
from lunar_rover_sim.judge.evaluation.trajectory_files import trajectory_of_topic, write_tum
from lunar_rover_sim.products.inspection.report import Status

# Command → its words, and what its result holds.
COMMANDS = {
    'bag info': ('{bag}', {'messages', 'start_s', 'end_s', 'size_bytes', 'storage', 'topics',
                           'real_time_factor', 'resumed_s', 'incomplete'}),
    'bag check': ('{bag}', {'ok', 'findings'}),
    'dataset status': ('{dataset}', {'campaign', 'planned', 'finished', 'failed', 'under_way',
                                     'missing'}),
    'evaluate trajectory': ('{bag} {estimate}', {'align', 'ate_m', 'scale', 'drift_percent',
                                                 'tracked_share', 'poses'}),
    'evaluate map': ('{maps} --world {world}', {'maps', 'rock_m', 'offset_m', 'sun_deg', 'near',
                                                'by_distance'}),
    'evaluate drive': ('{maps} --world {world}', {
        'distance_m', 'duration_s', 'incidents', 'seen_m', 'unknown_m', 'stops', 'standing_s',
        'plans', 'end'}),
    'slam run': ('{bag} -o {new} --sensor stereo', {'system', 'ate_m', 'estimate_frame',
                                                    'tracked_share', 'reason'}),
    'validate policy': ('smooth --duration 0.4', {'policy', 'tolerance', 'holds', 'terms'}),
    'world info': ('{world}', {'hash', 'seed', 'levels', 'rocks', 'craters', 'size_bytes'}),
}
# The other commands, and why a script needs no --json of them.
WITHOUT = {
    'what it makes are files': (
        'bag preview', 'bag video', 'bag recover', 'bag export', 'dataset card', 'dataset shards',
        'demo', 'render', 'rover export', 'run', 'slam seal', 'slam settings',
        'world build', 'world export', 'world preview',
        'calibrate gait'),
    'what it finds is a CSV, JSON or Markdown file': (
        'benchmark drives', 'benchmark traverse', 'campaign', 'slam table', 'evaluate images',
        'validate learning', 'validate locomotion', 'validate navigation', 'validate stereo',
        'validate terramechanics'),
    'a person reads its table; Python has the numbers': (
        'validate imu', 'validate odometry', 'world sun'),
    'its status is the result': ('dataset verify',),
    'its lines are tables of two columns, or text to paste': (
        'bag hash', 'completion', 'parameters'),
    'a person watches it': ('bag view', 'view')}


@pytest.fixture(scope='module', name='inputs')
def _inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp('json')
    inputs = {name: folder / name for name in ('bag', 'dataset', 'estimate', 'maps', 'world')}
    synthetic_bag.write(inputs['bag'], synthetic_bag.drive(1.0))
    with open_bag(inputs['bag']) as bag:
        write_tum(inputs['estimate'], trajectory_of_topic(bag))
    campaign = parse_campaign('episodes: 3\nname: moon', folder / 'x.yaml')
    with Dataset(inputs['dataset'], campaign) as dataset:
        dataset.record()
    save_world(worlds.small(), inputs['world'])
    map_bag.write(inputs['maps'], worlds.small())
    return inputs


def test_the_table_is_complete() -> None:
    """Every command has --json, or a reason why not."""
    found = {name: any('--json' in param.opts for param in load(name).params)
             for name in main_module.COMMANDS}
    without = [name for names in WITHOUT.values() for name in names]
    assert found == {**dict.fromkeys(COMMANDS, True), **dict.fromkeys(without, False)}


@pytest.mark.parametrize('name', COMMANDS)
def test_json(name: str, inputs: dict[str, Path], tmp_path: Path,
              capfd: pytest.CaptureFixture[str]) -> None:
    words, keys = COMMANDS[name]
    paths = {**inputs, 'new': tmp_path / 'new'}
    main([*name.split(), *words.format(**paths).split(), '--json'])
    found: dict[str, Any] = json.loads(capfd.readouterr().out, parse_constant=pytest.fail)
    assert keys <= set(found)
    if name == 'bag info':
        rows = {row['topic']: row for row in found['topics']}
        assert rows['/joint_states']['rate_hz'] == pytest.approx(200.0, rel=0.01)
        assert sum(row['messages'] for row in found['topics']) == found['messages']
    if name == 'bag check':
        assert {one['status'] for one in found['findings']} <= {one.value for one in Status}
    if name == 'evaluate trajectory':
        assert found['ate_m']['rmse'] < 1e-6
    if name == 'dataset status':
        assert found['planned'] == len(found['missing']) == 3 and not found['failed']
    if name == 'world info':
        assert found['hash'] == worlds.small().hash
