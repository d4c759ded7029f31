"""Policies as files: what is written is read and runs; what does not fit is refused in a line."""

import dataclasses
import json

import numpy as np
import pytest

from lunar_rover_sim.autonomy.learning.controller import PolicyController
from lunar_rover_sim.autonomy.learning.policy_file import (constant_layers, KEY, Policy,
                                                           policy_names, save_policy)
from lunar_rover_sim.autonomy.learning.senses import Sample
from lunar_rover_sim.autonomy.learning.tasks import make_task
from lunar_rover_sim.autonomy.learning.validation import validate_policy
from lunar_rover_sim.base.errors import GaitError, LearningError
from lunar_rover_sim.rover.rover_file import load_rover

onnx = pytest.importorskip('onnx')
pytest.importorskip('onnxruntime')
FACTS = {'algorithm': 'none', 'decisions': 0, 'seeds': [1]}
ROVER = load_rover()


def random_layers(task, rng, width=16):
    sizes = [len(task.channels), width, width, len(task.actions)]
    return [(rng.normal(0.0, 0.3, (b, a)), rng.normal(0.0, 0.1, b))
            for a, b in zip(sizes, sizes[1:])]


@pytest.fixture(scope='module')
def walk_file(tmp_path_factory):
    path = tmp_path_factory.mktemp('policy') / 'walk.onnx'
    task = make_task('walk', {'ground': 'highland', 'residual_radps': 1.0})
    save_policy(path, random_layers(task, np.random.default_rng(3)), task, FACTS)
    return path


def test_onnxruntime_and_numpy_run_what_was_written(walk_file):
    runtime, layers = Policy(walk_file), Policy(walk_file, 'numpy')
    assert (runtime.runtime, layers.runtime) == ('onnxruntime', 'numpy')
    rng, actions = np.random.default_rng(1), []
    for _ in range(20):
        observation = rng.normal(size=len(runtime.card.observation)).astype(np.float32)
        actions.append(runtime.act(observation))
        np.testing.assert_allclose(layers.act(observation), actions[-1], atol=1e-6)
        np.testing.assert_array_equal(runtime.act(observation.astype(float)), actions[-1])
    assert np.ptp(actions, axis=0).min() > 0.1
    assert walk_file.stat().st_size < 1 << 20
    assert '| spoke_sin/front_left | 1 | 1 |' in walk_file.with_suffix('.md').read_text('utf-8')


def test_the_node_sees_what_the_environment_shows(walk_file):
    checks = validate_policy(Policy(walk_file), duration_s=1.0)
    assert len(checks) == 31 + 4
    assert [check.name for check in checks if not check.holds] == []
    assert sum(check.span > 0.01 for check in checks) >= 30


def test_a_node_that_sees_something_else_is_noticed(walk_file, monkeypatch):
    real = PolicyController.update
    monkeypatch.setattr(PolicyController, 'update', lambda self, sample: real(
        self, dataclasses.replace(sample, rate_radps=1.01 * sample.rate_radps)))
    checks = validate_policy(Policy(walk_file), duration_s=0.5)
    assert {check.name for check in checks if not check.holds} >= {'rate_x', 'rate_y', 'rate_z'}


def changed(path, tmp_path, change, opset=None):
    """Return a copy of a file whose metadata `change` has changed."""
    model = onnx.load(path)
    document = json.loads(model.metadata_props[0].value)
    change(document)
    onnx.helper.set_model_props(model, {KEY: json.dumps(document)})
    if opset is not None:
        model.opset_import[0].version = opset
    copy = tmp_path / 'changed.onnx'
    onnx.save(model, copy)
    return copy


@pytest.mark.parametrize('change, text', [
    (lambda d: d.pop('legs'), 'metadata: legs missing'),
    (lambda d: d.update(colour='red'), 'metadata: colour: no such entry'),
    (lambda d: d.update(format=7), 'metadata: format: 7 is not valid; valid is 1'),
    (lambda d: d.update(task='swim'), "metadata: task: 'swim' is not valid"),
    (lambda d: d['observation'].pop(), 'its network does not take 30 numbers'),
    (lambda d: d['action'].pop(), r'its network gives \(4,\) numbers'),
    (lambda d: d.update(observation=3), 'metadata: not as format 1 has it'),
])
def test_files_that_are_refused(walk_file, tmp_path, change, text):
    with pytest.raises(LearningError, match=text) as refused:
        Policy(changed(walk_file, tmp_path, change))
    assert '\n' not in str(refused.value) and 'changed.onnx' in str(refused.value)


@pytest.mark.parametrize('change, text', [
    (lambda d: d.update(rover='hexapod'), 'is a policy for rover hexapod with legs front_left'),
    (lambda d: d.update(decision_hz=10.0), 'decision_hz: 10 is not valid; valid is 50'),
    (lambda d: d['observation'][0].update(scale=2.0), 'command_forward .m/s., scale 2 is not'),
    (lambda d: d['options'].update(speed_wait=1.0), 'options.speed_wait: no such parameter'),
])
def test_policies_that_do_not_fit_the_rover(walk_file, tmp_path, change, text):
    policy = Policy(changed(walk_file, tmp_path, change))
    with pytest.raises(LearningError, match=text):
        PolicyController(policy, ROVER)


def test_damaged_files(walk_file, tmp_path):
    content = walk_file.read_bytes()
    path = tmp_path / 'cut.onnx'
    for length in (0, 10, len(content) // 2, len(content) - 3):
        path.write_bytes(content[:length])
        with pytest.raises(LearningError, match='cut.onnx: ') as refused:
            Policy(path)
        assert '\n' not in str(refused.value)
    with pytest.raises(LearningError, match='opset: 99 is not valid; valid is 13 to 21'):
        Policy(changed(walk_file, tmp_path, lambda d: None, opset=99))
    with pytest.raises(LearningError, match='no such file'):
        Policy(tmp_path / 'missing.onnx')
    with pytest.raises(LearningError, match='no such policy'):
        Policy('graceful')


def sample(stamp_ns, **values):
    return Sample(stamp_ns, **{**dict(
        angle_rad=np.zeros(4), speed_radps=np.zeros(4), torque_nm=np.zeros(4),
        rate_radps=np.zeros(3), force_mps2=np.array([0.0, 0.0, 1.62])), **values})


def test_the_controller_walks_while_commanded_and_stands_otherwise(walk_file):
    controller = PolicyController.load(walk_file, ROVER)
    assert np.abs(controller.update(sample(0)).velocity_radps).max() < 1e-9
    controller.set_velocity(0.12, 0.0, 5_000_000)
    walked, actions = [], []
    for k in range(1, 101):
        walked.append(controller.update(sample(k * 5_000_000)).velocity_radps)
        actions.append(controller.driver.action)
    # Decisions at 20 ms hold until the next; the gait below follows each state.
    np.testing.assert_array_equal(actions[3], actions[6])
    assert np.any(actions[3] != actions[7]) and np.any(walked[3] != walked[6])
    assert np.abs(walked[50]).max() > 0.2
    # 0.5 s after the last command it comes to a stand.
    for k in range(101, 1000):
        last = controller.update(sample(k * 5_000_000)).velocity_radps
    assert np.abs(last).max() < 0.05


def test_what_the_controller_refuses(walk_file):
    controller = PolicyController.load(walk_file, ROVER)
    with pytest.raises(GaitError, match='velocity: 99'):
        controller.set_velocity(99.0, 0.0)
    with pytest.raises(LearningError, match='torque_nm: .* valid are 4 finite numbers'):
        controller.update(sample(0, torque_nm=np.zeros(3)))
    with pytest.raises(LearningError, match='rate_radps: .* valid are 3 finite numbers'):
        controller.update(sample(0, rate_radps=np.full(3, np.nan)))


def test_a_policy_for_reach_is_no_leg_controller(tmp_path):
    task = make_task('reach', {})
    save_policy(tmp_path / 'reach.onnx', constant_layers(task, np.zeros(2)), task, FACTS)
    with pytest.raises(LearningError, match='valid are policies for walk, gait'):
        PolicyController.load(tmp_path / 'reach.onnx', ROVER)


def test_a_constant_policy_of_gait_agrees_with_its_environment(tmp_path):
    task = make_task('gait', {'ground': 'rigid'})
    action = np.linspace(-0.3, 0.3, len(task.actions))
    save_policy(tmp_path / 'gait.onnx', constant_layers(task, action), task, FACTS)
    policy = Policy(tmp_path / 'gait.onnx')
    np.testing.assert_allclose(policy.act(np.zeros(22, np.float32)), action, atol=1e-6)
    save_policy(tmp_path / 'tanh.onnx', constant_layers(task, action), task, FACTS, squashed=True)
    for runtime in ('onnxruntime', 'numpy'):
        np.testing.assert_allclose(Policy(tmp_path / 'tanh.onnx', runtime).act(
            np.zeros(22, np.float32)), np.tanh(action), atol=1e-6)
    assert all(check.holds for check in validate_policy(policy, duration_s=1.0))


@pytest.mark.parametrize('name', policy_names())
def test_packaged_policies_fit_their_rover(name):
    policy = Policy(name)
    PolicyController(policy, load_rover(policy.card.rover))
    assert all(check.holds for check in validate_policy(policy, duration_s=0.6))
