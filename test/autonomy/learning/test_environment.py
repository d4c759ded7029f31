"""The environments: Gymnasium's own checks, exact seeding, endings, and what they refuse."""

from pathlib import Path

import numpy as np
import pytest

from lunar_rover_sim.autonomy.learning.tasks import make_task
from lunar_rover_sim.base.errors import ConfigError, LearningError

gymnasium = pytest.importorskip('gymnasium')
EXAMPLES = Path(__file__).parents[3] / 'examples/learning'
SHORT = {'episode_s': 0.6, 'ground': 'highland'}
NAMES = ('Walk', 'Gait', 'Reach')


def made(name='Walk', **options):
    return gymnasium.make(f'lunar_rover_sim.autonomy.learning:lunar_rover_sim/{name}-v0',
                          **{**SHORT, **options})


@pytest.mark.parametrize('name', NAMES[:2])
def test_gymnasium_finds_nothing_wrong(name):
    from gymnasium.utils.env_checker import check_env
    with made(name) as env:
        check_env(env.unwrapped, skip_render_check=True)
        channels = env.unwrapped.channels
        assert env.observation_space.shape == (len(channels),)
        assert len({channel.name for channel in channels}) == len(channels)


def episode(env, seed, actions):
    observations, rewards = [env.reset(seed=seed)[0]], []
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
        if terminated or truncated:
            break
    return np.array(observations), np.array(rewards), truncated


def test_one_seed_gives_one_episode_bit_by_bit():
    rng = np.random.default_rng(5)
    with made() as env, made() as other:
        actions = rng.uniform(-1, 1, (40, 4))
        first = episode(env, 3, actions)
        episode(env, 4, actions)
        again, elsewhere = episode(env, 3, actions), episode(other, 3, actions)
    for found in (again, elsewhere):
        np.testing.assert_array_equal(first[0], found[0])
        np.testing.assert_array_equal(first[1], found[1])
    assert first[2] and len(first[1]) == 30      # 0.6 s at 50 Hz
    assert np.ptp(first[0], axis=0).max() > 0.1


def test_several_step_as_each_does_alone():
    actions = np.random.default_rng(1).uniform(-1, 1, (35, 3, 4))
    envs = gymnasium.make_vec('lunar_rover_sim.autonomy.learning:lunar_rover_sim/Walk-v0',
                              num_envs=3, threads=2, **SHORT)
    assert envs.metadata['autoreset_mode'] is gymnasium.vector.AutoresetMode.SAME_STEP
    batch, _ = envs.reset(seed=7)
    found, ended = [batch], None
    for k, action in enumerate(actions):
        observations, _, _, truncated, infos = envs.step(action)
        found.append(observations)
        if truncated.any():
            assert truncated.all() and ended is None
            ended, last = k, infos['final_obs']
    envs.close()
    assert ended == 29
    for k in range(3):
        with made() as env:
            alone, _, _ = episode(env, 7 + k, actions[:, k])
        np.testing.assert_array_equal(np.array(found)[:30, k], alone[:30])
        np.testing.assert_array_equal(last[k], alone[30])


def test_a_residual_of_zero_walks_as_commanded():
    task = make_task('walk', {'randomise': False, 'forward_mps': [0.12, 0.12], 'ground': 'rigid',
                              'yaw_rate_radps': [0.0, 0.0], 'episode_s': 8.0})
    task.reset(np.random.default_rng(0))
    start = task.state.position_m[0]
    for _ in range(400):
        outcome = task.step(np.zeros(4))
    assert outcome.truncated and not outcome.terminated
    # 10 % is the tolerance of the gait's own calibration; the first cycle is the start.
    assert (task.state.position_m[0] - start) / 7.4 == pytest.approx(0.12, rel=0.1)
    task.close()


def test_privileged_observations_stand_apart():
    with made(privileged=True, randomise={'mass_factor': [1.1, 1.1]}) as env:
        observation, info = env.reset(seed=1)
        names = [channel.name for channel in env.unwrapped.privileged_channels]
        assert observation['privileged'][names.index('mass_factor')] == pytest.approx(1.1)
        np.testing.assert_array_equal(observation['privileged'], info['privileged'])
        assert not set(names) & {channel.name for channel in env.unwrapped.channels}
        for _ in range(20):
            observation, *_ = env.step(np.zeros(4))
        sinkage = [k for k, name in enumerate(names) if name.startswith('sinkage/')]
        assert observation['privileged'][sinkage].max() > 0.0


@pytest.mark.parametrize('delay', [0, 3])
def test_actions_come_late_by_the_delay(delay):
    task = make_task('walk', {**SHORT, 'randomise': {'delay': [delay, delay], 'push_n': [0, 0]}})
    task.reset(np.random.default_rng(2))
    applied = []
    for k in range(6):
        task.step(np.full(4, 0.1 * (k + 1)))
        applied.append(round(float(task.driver.action[0]), 3))
    assert applied == [0.0] * delay + [round(0.1 * (k + 1), 3) for k in range(6 - delay)]
    task.close()


def test_legs_follow_a_smoothed_action_with_its_time_constant():
    task = make_task('walk', {**SHORT, 'randomise': False, 'smoothing_s': 0.1})
    task.reset(np.random.default_rng(2))
    for _ in range(5):                  # 0.1 s
        outcome = task.step(np.full(4, 0.8))
    # What is observed is what the legs do, so that the task has no hidden state.
    seen = [k for k, one in enumerate(task.channels) if one.name.startswith('last_action/')]
    assert outcome.observation[seen] == pytest.approx(np.full(4, 0.8 * (1.0 - np.exp(-1.0))))
    assert task.driver.legs()[0] - task.driver._asked.velocity_radps == pytest.approx(
        task.config.residual_radps * task.driver.action)
    task.close()


@pytest.mark.parametrize('ground', ['highland', 'rigid'])
def test_standing_returns_less_than_a_random_gait_and_that_less_than_the_packaged(monkeypatch,
                                                                                  ground):
    """With all randomisation, over the range of commands; the mean of 2 episodes."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    from returns import PACKAGED, RANDOM, returns_of, STANDING
    standing, random, packaged = (returns_of(walker, 2, ground=ground)
                                  for walker in (STANDING, RANDOM, PACKAGED))
    # Pushes and slopes move a standing rover a little.
    assert np.abs(standing).max() < 0.1
    assert standing.mean() + 0.2 < random.mean() and random.mean() + 0.2 < packaged.mean()


@pytest.mark.parametrize('command, best', [((0.0, 0.0), 'standing'), ((0.06, 0.0), 'packaged'),
                                           ((0.0, 0.2), 'packaged')])
def test_commands_near_zero_and_turns_on_the_spot(monkeypatch, command, best):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    from returns import PACKAGED, returns_of, STANDING
    standing, packaged = (returns_of(
        walker, 1, ground='rigid', randomise=False, forward_mps=command[:1] * 2,
        yaw_rate_radps=command[1:] * 2)[0] for walker in (STANDING, PACKAGED))
    if best == 'standing':
        assert standing == pytest.approx(6.0, abs=0.05) and packaged <= standing
    else:
        assert standing < 0.01 and packaged > 1.0


@pytest.mark.parametrize('name', ['walk', 'gait'])
def test_a_fall_costs_more_than_standing(name):
    task = make_task(name, {'ground': 'rigid', 'randomise': False})
    task.reset(np.random.default_rng(1))
    task.simulation.move(position_m=task.state.position_m + [0.0, 0.0, 0.3],
                         orientation_wxyz=[np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])
    outcome = task.step(np.zeros(len(task.actions)))
    task.close()
    assert outcome.terminated and outcome.reward < -0.9


def test_noise_of_smoothed_actions_costs_less_energy():
    """Without smoothing, noise of white actions is paid for and moves no leg."""
    def mean_reward(smoothing_s, noise):
        task = make_task('walk', {'ground': 'rigid', 'randomise': False, 'episode_s': 2.0,
                                  'smoothing_s': smoothing_s})
        task.reset(np.random.default_rng(2))
        rng = np.random.default_rng(3)
        rewards = [task.step(rng.normal(0.0, noise, 4)).reward for _ in range(100)]
        task.close()
        return np.mean(rewards)

    still, at_once, smoothed = mean_reward(0.0, 0.0), mean_reward(0.0, 1.0), mean_reward(0.3, 1.0)
    assert still - at_once > 0.2 * still and abs(still - smoothed) < 0.3 * (still - at_once)


def test_a_divergence_ends_the_episode_and_is_counted():
    with made() as env:
        env.reset(seed=1)
        env.unwrapped.task.simulation.data.qvel[7] = np.nan
        _, reward, terminated, truncated, info = env.step(np.zeros(4))
    assert terminated and not truncated and 'diverged' in info['reason']
    assert info['endings'] == {'diverged': 1} and reward < -0.5


def test_a_rover_on_its_side_has_fallen():
    with made(ground='rigid', randomise=False) as env:
        env.reset(seed=1)
        env.unwrapped.task.simulation.move(
            position_m=env.unwrapped.task.state.position_m + [0.0, 0.0, 0.3],
            orientation_wxyz=[np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])
        *_, info = env.step(np.zeros(4))
    assert info['reason'].startswith('fallen: tilted by')


def test_reach_ends_at_the_goal():
    with made('Reach', ground='rigid', randomise=False, goal_m=[0.5, 0.5]) as env:
        env.reset(seed=1)
        task = env.unwrapped.task
        task.goal_m = task.state.position_m[:2] + [0.2, 0.0]
        _, reward, terminated, _, info = env.step(np.array([-1.0, 0.0]))
    assert terminated and info['reason'] == 'reached' and reward > 1.0


def test_reach_sees_the_ground_ahead_and_nothing_behind():
    """What the map has seen is the truth within its errors; what it has not is flat."""
    options = {'episode_s': 8.0, 'ground': 'rigid', 'randomise': False, 'sun': {
        'elevation_deg': 40.0}}
    seen = make_task('reach', {**options, 'elevation': 'seen'})
    true = make_task('reach', options)
    for task in (seen, true):
        task.reset(np.random.default_rng(3))
        task.goal_m = task.state.position_m[:2] + [5.0, 0.0]
        for _ in range(8):
            outcome = task.step(np.array([0.2, 0.0]))
            if task is seen:
                mapped = outcome.observation
    cells = [k for k, one in enumerate(seen.channels) if one.name.startswith('elevation/')]
    ahead = [float(seen.channels[k].name.split('/')[1]) > 0.6 for k in cells]
    known = mapped[cells] != 0.0
    assert known[ahead].mean() > 0.5 and not known[~np.array(ahead)][:9].any()
    error = 0.1 * np.abs(mapped - outcome.observation)[cells][known]
    # Half a cell of 15 cm on relief, and rocks that are no half balls.
    assert np.median(error) < 0.01
    seen.close()
    true.close()


@pytest.mark.parametrize('options, text', [
    ({'rover': 'octopod'}, 'octopod: no such rover'),
    ({'randomise': {'mass_factor': [1.2, 0.8]}},
     r'mass_factor: \[1.2, 0.8\] is not valid; valid is the least value first'),
    ({'randomise': {'delay': [0, 9]}}, 'delay: 9 is not valid'),
    ({'forward_mps': [0.16, 0.08]}, r'forward_mps: \[0.16, 0.08\] .* the least value first'),
    ({'yaw_rate_radps': [0.1, -0.1]}, r'yaw_rate_radps: \[0.1, -0.1\] .* the least value first'),
    ({'render_mode': 'ascii'}, "render_mode: 'ascii' is not valid; valid is rgb_array, or None"),
])
def test_options_that_are_refused(options, text):
    from lunar_rover_sim.autonomy.learning.environment import RoverEnv
    with pytest.raises(ConfigError, match=text) as refused:
        RoverEnv('walk', **options)
    assert '\n' not in str(refused.value)


@pytest.mark.parametrize('task, name, value', [
    ('gait', 'forward_mps', [0.2, 0.1]), ('gait', 'yaw_rate_radps', [0.2, 0.1]),
    ('reach', 'goal_m', [5.0, 1.0])])
def test_ranges_upside_down(task, name, value):
    with pytest.raises(ConfigError, match=f'{name}: .* is not valid; valid is the least value'):
        make_task(task, {name: value})


def test_what_several_refuse():
    from lunar_rover_sim.autonomy.learning.environment import RoverVectorEnv
    for options, text in (({'num_envs': 0}, 'num_envs: 0 is not'),
                          ({'num_envs': True}, 'num_envs: True is not'),
                          ({'num_envs': 2, 'threads': 0}, 'threads: 0 is not'),
                          ({'num_envs': 2, 'render_mode': 'rgb_array'}, 'make one environment')):
        with pytest.raises(ConfigError, match=text):
            RoverVectorEnv('walk', **options)
    envs = RoverVectorEnv('walk', 2, **{**SHORT, 'ground': 'rigid'})
    with pytest.raises(LearningError, match='there is no episode; call reset first'):
        envs.step(np.zeros((2, 4)))
    for seed in (-1, [1, 2, 3]):
        with pytest.raises(ConfigError, match='seed: .* valid are 2 whole numbers >= 0, or one'):
            envs.reset(seed=seed)
    envs.reset(seed=1)
    for actions, text in ((None, 'valid are 2 actions'), (np.zeros((3, 4)), 'valid are 2 actions'),
                          (np.zeros((2, 3)), 'valid are 4 finite numbers'),
                          ([np.zeros(4), np.full(4, np.nan)], 'valid are 4 finite numbers')):
        with pytest.raises(LearningError, match=text):
            envs.step(actions)
    # The first has not stepped while the second was refused.
    assert len({task.state.stamp_ns for task in envs.tasks}) == 1
    envs.close()


@pytest.mark.parametrize('action', [np.zeros(3), np.full(4, np.nan), 'left', np.zeros((4, 1))])
def test_actions_that_are_refused(action):
    task = make_task('walk', SHORT)
    with pytest.raises(LearningError, match='there is no episode; call reset first'):
        task.step(np.zeros(4))
    task.reset(np.random.default_rng(1))
    with pytest.raises(LearningError, match='action: .* is not valid; valid are 4 finite numbers'):
        task.step(action)
    task.close()


def test_the_picture_shows_the_rover_and_its_tracks():
    with made(render_mode='rgb_array') as env:
        env.reset(seed=1)
        first = env.render()
        for _ in range(10):
            env.step(np.zeros(4))
        second = env.render()
    assert first.shape == (360, 640, 3) and first.dtype == np.uint8
    assert first.std() > 10.0 and np.any(first != second)
    # Soil is redder than the sun, and the chassis golden.
    assert first[..., 0].mean() > first[..., 2].mean()
