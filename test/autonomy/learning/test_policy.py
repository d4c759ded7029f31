"""Policies as files: what is written is read and runs; what does not fit is refused in a line."""

import dataclasses
import json
import math

import numpy as np
import pytest

from lunar_rover_sim.autonomy.learning.controller import PolicyController
from lunar_rover_sim.autonomy.learning.policy_file import (constant_layers, KEY, Policy,
                                                           policy_names, save_network, save_policy)
from lunar_rover_sim.autonomy.learning.senses import Sample
from lunar_rover_sim.autonomy.learning.tasks import make_task
from lunar_rover_sim.autonomy.learning.validation import validate_policy
from lunar_rover_sim.base.errors import GaitError, LearningError
from lunar_rover_sim.rover.description import load_rover

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


def test_what_was_written_is_what_acts(walk_file):
    """Against the layers by NumPy."""
    policy, rng, actions = Policy(walk_file), np.random.default_rng(1), []
    task = make_task('walk', {'ground': 'highland'})
    layers = random_layers(task, np.random.default_rng(3))
    for _ in range(20):
        observation = rng.normal(size=len(policy.card.observation)).astype(np.float32)
        actions.append(policy.act(observation))
        here = observation
        for k, (weight, bias) in enumerate(layers):
            here = weight @ here + bias if k == len(layers) - 1 else np.tanh(weight @ here + bias)
        np.testing.assert_allclose(actions[-1], np.clip(here, -1.0, 1.0), atol=1e-5)
    assert np.ptp(actions, axis=0).min() > 0.1
    card = walk_file.with_suffix('.md').read_text('utf-8')
    assert '| spoke_sin/front_left | 1 | 1 |' in card
    assert 'Trained for a speed of 0.06 to 0.16 m/s.' in card


def test_the_node_sees_what_the_environment_shows(walk_file):
    checks = validate_policy(Policy(walk_file), duration_s=1.0)
    assert len(checks) == 31
    assert [check.name for check in checks if not check.holds] == []
    # One constant command alone does not move.
    assert sum(check.span > 0.01 for check in checks) >= 27


def test_a_packaged_policy_agrees_for_longer_than_a_command_holds_in_training():
    policy = Policy('smooth')
    assert policy.config().command_s < 3.6
    assert [check.name for check in validate_policy(policy, 3.6) if not check.holds] == []


def test_a_node_that_sees_something_else_is_noticed(walk_file, monkeypatch):
    real = PolicyController.update
    monkeypatch.setattr(PolicyController, 'update', lambda self, sample: real(
        self, dataclasses.replace(sample, rate_radps=1.01 * sample.rate_radps)))
    checks = validate_policy(Policy(walk_file), duration_s=0.5)
    assert {check.name for check in checks if not check.holds} >= {'rate_x', 'rate_y', 'rate_z'}


def changed(path, tmp_path, change):
    """Return a copy of a file whose metadata `change` has changed."""
    model = onnx.load(path)
    document = json.loads(model.metadata_props[0].value)
    change(document)
    onnx.helper.set_model_props(model, {KEY: json.dumps(document)})
    copy = tmp_path / 'changed.onnx'
    onnx.save(model, copy)
    return copy


def with_nodes(path, tmp_path, name, change):
    """Return a copy of a file whose network `change(graph, helper)` has changed."""
    model = onnx.load(path)
    change(model.graph, onnx.helper)
    onnx.save(model, tmp_path / name)
    return tmp_path / name


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
    with pytest.raises(LearningError, match='no such file'):
        Policy(tmp_path / 'missing.onnx')
    with pytest.raises(LearningError, match='no such policy'):
        Policy('graceful')


def test_an_operator_of_another_domain_is_not_run_as_that_of_onnx(walk_file, tmp_path):
    def change(graph, helper):
        next(node for node in graph.node if node.op_type == 'Tanh').domain = 'org.example'

    with pytest.raises(LearningError, match='onnxruntime cannot run it') as refused:
        Policy(with_nodes(walk_file, tmp_path, 'domain.onnx', change))
    assert '\n' not in str(refused.value)


def test_metadata_nested_without_end(walk_file, tmp_path):
    model = onnx.load(walk_file)
    for text in ('[' * 200_000, '{"options":' * 50_000):
        onnx.helper.set_model_props(model, {KEY: text})
        onnx.save(model, tmp_path / 'deep.onnx')
        with pytest.raises(LearningError, match='deep.onnx: metadata: not JSON'):
            Policy(tmp_path / 'deep.onnx')


def nan_where(graph, helper, column, low, high):
    """Let a network give NaN where a number of the observation is within two bounds."""
    last = graph.node[-1]
    last.output[0] = 'finite'
    numbers = {'column': np.array([column]), 'low': np.array([[low]], np.float32),
               'high': np.array([[high]], np.float32), 'nan': np.array([[np.nan]], np.float32)}
    graph.initializer.extend(onnx.numpy_helper.from_array(value, name)
                             for name, value in numbers.items())
    graph.node.extend([
        helper.make_node('Gather', ['observation', 'column'], ['one'], axis=1),
        helper.make_node('Greater', ['one', 'low'], ['above']),
        helper.make_node('Less', ['one', 'high'], ['below']),
        helper.make_node('And', ['above', 'below'], ['inside']),
        helper.make_node('Where', ['inside', 'nan', 'finite'], ['action'])])


def test_a_policy_that_gives_nan_on_drawn_observations_does_not_load(walk_file, tmp_path):
    """On zeros it is finite."""
    path = with_nodes(walk_file, tmp_path, 'nan.onnx',
                      lambda graph, helper: nan_where(graph, helper, 9, 1.0, 20.0))
    with pytest.raises(LearningError, match='gives .*nan.* for drawn observations'):
        Policy(path)


def test_the_first_nan_on_the_way_names_its_stamp(walk_file, tmp_path):
    """One so rare that no drawn observation meets it: at a forward command of 0.12 m/s."""
    path = with_nodes(walk_file, tmp_path, 'rare.onnx',
                      lambda graph, helper: nan_where(graph, helper, 0, 0.5999, 0.6001))
    controller = PolicyController.load(path, ROVER)
    controller.set_velocity(0.11, 0.0, 0)
    controller.update(sample(0))
    controller.set_velocity(0.12, 0.0, 5_000_000)
    controller.update(sample(5_000_000))
    with pytest.raises(LearningError, match=r'rare.onnx: gives .*nan.* at 0.020 s'):
        controller.update(sample(20_000_000))


def test_commands_and_grounds_that_were_not_trained_are_reported_once(walk_file):
    controller = PolicyController.load(walk_file, ROVER)
    assert controller.on_ground('highland') == []
    assert controller.on_ground('rigid') == [
        'policy walk was trained on highland; here is rigid']

    def reports(forward, yaw_rate, from_s):
        for k in range(30):
            controller.set_velocity(forward, yaw_rate, round(1e9 * (from_s + 0.05 * k)))
        return controller.take_reports()

    # To stand, and what passes within a second, are fine.
    assert reports(0.12, -0.2, 0.0) == reports(0.0, 0.0, 2.0) == []
    controller.set_velocity(0.03, 0.0, 4_000_000_000)
    assert reports(0.06, 0.0, 4.1) == []
    assert reports(0.12, 0.3, 6.0) == [
        'policy walk was trained for a yaw rate of -0.2 to 0.2 rad/s; 0.3 is commanded']
    assert reports(0.12, 0.0, 8.0) == reports(0.12, 0.3, 10.0) == []
    assert reports(0.2, 0.3, 12.0) == [
        'policy walk was trained for a speed of 0.06 to 0.16 m/s; 0.2 is commanded']


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
    assert all(check.holds for check in validate_policy(policy, duration_s=1.0))


def test_a_network_from_elsewhere_gets_a_card_and_walks(tmp_path):
    """Its own names, operators, opset and batch size; it sees the gyroscope and stops a leg."""
    helper = onnx.helper
    task = make_task('walk', {'ground': 'rigid', 'forward_mps': [0.1, 0.14]})
    column = [one.name for one in task.channels].index('rate_y')
    weight = np.zeros((31, 4), np.float32)
    weight[column, 2] = -3.0
    graph = helper.make_graph(
        [helper.make_node('MatMul', ['obs', 'w'], ['m']), helper.make_node('Erf', ['m'], ['out'])],
        'theirs', [helper.make_tensor_value_info('obs', onnx.TensorProto.FLOAT, ['batch', 31])],
        [helper.make_tensor_value_info('out', onnx.TensorProto.FLOAT, ['batch', 4])],
        [onnx.numpy_helper.from_array(weight, 'w')])
    content = helper.make_model(graph, opset_imports=[helper.make_opsetid('', 13)],
                                ir_version=8).SerializeToString()
    save_network(tmp_path / 'theirs.onnx', content, task, {**FACTS, 'licence': 'MIT'})
    controller = PolicyController.load(tmp_path / 'theirs.onnx', ROVER)
    controller.set_velocity(0.12, 0.0)
    controller.update(sample(0, rate_radps=np.array([0.0, 0.2, 0.0])))
    np.testing.assert_allclose(controller.driver.action, [0.0, 0.0, -math.erf(0.6), 0.0],
                               atol=1e-6)
    assert 'Licence: MIT' in (tmp_path / 'theirs.md').read_text('utf-8')
    before = (tmp_path / 'theirs.onnx').read_bytes()
    for wrong in (content[:-9], b'', make_task('gait', {})):
        with pytest.raises(LearningError):
            if isinstance(wrong, bytes):
                save_network(tmp_path / 'theirs.onnx', wrong, task, FACTS)
            else:
                save_network(tmp_path / 'theirs.onnx', content, wrong, FACTS)
    assert (tmp_path / 'theirs.onnx').read_bytes() == before


def test_a_module_of_pytorch_acts_in_the_node_as_it_does_at_home(tmp_path):
    torch = pytest.importorskip('torch')
    from lunar_rover_sim.autonomy.learning.export import save_torch
    torch.manual_seed(1)
    module = torch.nn.Sequential(torch.nn.Linear(31, 8), torch.nn.ELU(), torch.nn.LayerNorm(8),
                                 torch.nn.Dropout(0.5), torch.nn.Linear(8, 4), torch.nn.Tanh())
    save_torch(tmp_path / 'torch.onnx', module, make_task('walk', {}), FACTS)
    assert module.training
    controller = PolicyController.load(tmp_path / 'torch.onnx', ROVER)
    controller.set_velocity(0.12, 0.0)
    controller.update(sample(0))
    expected = module.eval()(torch.as_tensor(controller.observed)[None])[0].detach().numpy()
    np.testing.assert_allclose(controller.driver.action, expected, atol=1e-6)


@pytest.mark.parametrize('kind', ['PPO', 'SAC'])
def test_a_model_of_stable_baselines3_with_its_normalisation(tmp_path, kind):
    sb3 = pytest.importorskip('stable_baselines3')
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    from lunar_rover_sim.autonomy.learning.environment import RoverEnv
    from lunar_rover_sim.autonomy.learning.export import save_sb3
    envs = VecNormalize(DummyVecEnv([lambda: RoverEnv('walk', ground='rigid', episode_s=0.2)]))
    envs.reset()
    for _ in range(20):
        envs.step(np.zeros((1, 4)))
    model = getattr(sb3, kind)('MlpPolicy', envs, seed=1)
    save_sb3(tmp_path / 'sb3.onnx', model, make_task('walk', {}), FACTS, envs)
    seen = np.random.default_rng(1).normal(size=31).astype(np.float32)
    expected = model.predict(envs.normalize_obs(seen[None]), deterministic=True)[0][0]
    np.testing.assert_allclose(Policy(tmp_path / 'sb3.onnx').act(seen), expected, atol=1e-5)


@pytest.mark.parametrize('name', policy_names())
def test_packaged_policies_fit_their_rover(name):
    policy = Policy(name)
    PolicyController(policy, load_rover(policy.card.rover))
    assert all(check.holds for check in validate_policy(policy, duration_s=0.6))
