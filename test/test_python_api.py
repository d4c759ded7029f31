"""The way in for Python programs: what a user types, without ROS and with it."""

from collections.abc import Callable, Iterator
import contextlib
import inspect
import math
import os
from pathlib import Path
import random
import subprocess
import sys
import threading
from typing import Any

from command_line import unfolded
from conftest import PLAIN, SMALL, SOFT
import psutil
import pytest
import synthetic_bag
import worlds

import lunar_rover_sim
from lunar_rover_sim import (LunarRoverSimError, open_bag, record, Scenario, Trajectory,
                             VisualOdometry)
from lunar_rover_sim.bag.content_hash import bag_hash, topic_hashes
from lunar_rover_sim.bag.totals import recorded_factor
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.judge.slam.euroc_reader import Camera


def test_every_name_is_there_and_documented() -> None:
    """What `__all__` lists can be imported; an unknown name is an AttributeError."""
    for name in lunar_rover_sim.__all__:
        assert inspect.getdoc(getattr(lunar_rover_sim, name)), name
        assert name in dir(lunar_rover_sim)
    assert not {'Any', 'TYPE_CHECKING', 'importlib'} & set(dir(lunar_rover_sim))
    with pytest.raises(AttributeError, match='no attribute .Roover.'):
        lunar_rover_sim.Roover


@pytest.mark.parametrize('program, absent', [
    ('import lunar_rover_sim', ('mujoco', 'moderngl', 'cv2', 'rclpy', 'numpy')),
    # Every node reads one: what is loaded here delays the start of each of them.
    ('from lunar_rover_sim import Scenario; Scenario.load("flat")',
     ('mujoco', 'moderngl', 'cv2', 'rclpy', 'scipy', 'matplotlib', 'numba', 'jinja2')),
])
def test_import_is_light(program: str, absent: tuple[str, ...]) -> None:
    """The package loads no physics, renderer or ROS, and reading a scenario does not either."""
    program += f'; import sys; print({set(absent)} & set(sys.modules))'
    printed = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                             check=True).stdout
    assert printed == 'set()\n'


def test_objects_say_what_they_are(tmp_path: Path) -> None:
    """In a line, and in a notebook."""
    world = worlds.small()
    scenario = Scenario.load('flat')
    bag_path = synthetic_bag.write(tmp_path / 'bag', synthetic_bag.drive(
        0.2, only=(topics.ODOM, topics.LEFT_IMAGE)))
    with open_bag(bag_path) as bag, scenario.simulation(world) as simulation:
        for one, words in ((world, world.hash), (scenario, 'flat'), (bag, '2 topics, 42 messages'),
                           (simulation, 'kg at (0.00, 0.00) m, 0 s')):
            assert words in repr(one).replace('-0.00', '0.00') and len(repr(one)) < 200
        gait = scenario.gait_controller()
        gait.set_velocity(0.1, -0.2)
        camera = Camera((100.0, 100.0), (50.0, 50.0), 0.1)
        for one, words in (
                (gait, 'GaitController(rover, 4 legs, at 0.1 m/s and -0.2 rad/s)'),
                (scenario.matcher(), 'SgmMatcher(0 to 128 px)'),
                (scenario.lidar(world), 'Lidar(velodyne_vlp16, 28928 beams, 10 Hz)'),
                (VisualOdometry(camera), 'VisualOdometry(0 frames located)'),
                (Trajectory.of_states([simulation.state]),
                 "Trajectory('truth', 1 poses, 0.0 s, 0.00 m)")):
            assert repr(one) == words
        for one, words in ((world, 'image/png'), (scenario, '<table>'), (bag, 'image/png')):
            assert words in one._repr_html_()
        # One topic may be given as such.
        assert sum(1 for _ in bag.messages('odom')) == bag.count('odom') == 40
    assert repr(bag).endswith('closed)') and repr(simulation) == 'Simulation(closed)'


def test_scenario_takes_overrides_as_text_or_mapping() -> None:
    """Both spellings give the same scenario."""
    text = Scenario.load('flat', ['render_node.camera.width=320', 'seed=3'], duration_s=2.0)
    mapping = Scenario.load('flat', {'render_node.camera.width': 320}, seed=3, duration_s=2.0)
    assert text == mapping
    assert mapping.render_node.camera.width == 320
    assert mapping.physics_node.seed == 3
    assert mapping.run.duration_s == 2.0


@pytest.mark.parametrize('name, arguments, options, message', [
    ('flatt', {}, [], 'flatt: no such scenario; did you mean flat?'),
    ('flat', {'seed': -1}, ['--seed', '-1'], 'seed: -1 is not valid; valid is 0 to'),
    ('flat', {'duration_s': 0.0}, ['--duration', '0'],
     'run.duration_s: 0.0 is not valid; valid is > 0'),
    ('flat', {'overrides': ['render_node.camera.width=1']},
     ['--set', 'render_node.camera.width=1'], 'render_node.camera.width: 1 is not valid'),
    ('flat', {'overrides': ['render_nod.camera.width=1']},
     ['--set', 'render_nod.camera.width=1'],
     'did you mean render_node.camera.width'),
])
def test_bad_input_reads_as_on_the_command_line(name: str, arguments: dict, options: list[str],
                                                message: str, tmp_path: Path,
                                                capsys: pytest.CaptureFixture[str]) -> None:
    """The error of the API is the line of the command."""
    with pytest.raises(LunarRoverSimError) as raised:
        Scenario.load(name, **arguments)
    assert message in str(raised.value)
    assert main(['run', name, '-o', str(tmp_path / 'run'), *options]) == 1
    assert unfolded(capsys.readouterr().err).endswith(f'{raised.value}\n')


@pytest.mark.parametrize('overrides', [
    None, 'a.b=1', b'a.b=1', 3, [3], ['seed=1', None], {3: 4}])
def test_overrides_are_texts_or_a_mapping(overrides: Any) -> None:
    """One text is not a list of letters."""
    with pytest.raises(ConfigError) as raised:
        Scenario.load('flat', overrides)
    assert str(raised.value) == (
        f"overrides: {overrides!r} is not valid; valid is a list of 'section.parameter=value', or "
        "a mapping of 'section.parameter' to values")
    assert Scenario.load('flat', (text for text in ['seed=3'])).shared.seed == 3


@pytest.mark.parametrize('wrong', ['baseline', Path('baseline.yaml'), None])
def test_the_name_of_a_scenario_is_none(wrong: Any) -> None:
    """The error tells how to get one."""
    with pytest.raises(ConfigError) as raised:
        record(wrong, 'never')
    assert str(raised.value) == (f'scenario: {wrong!r} is not valid; valid is a Scenario '
                                 '(Scenario.load(...))')


@pytest.mark.parametrize('call, name', [
    (open_bag, 'path'), (lunar_rover_sim.load_world, 'folder'),
    (lambda path: record(Scenario.load('flat'), path), 'folder')])
@pytest.mark.parametrize('wrong', [None, 3, b'bag'])
def test_what_is_no_path_is_refused(call: Callable[[Any], object], name: str, wrong: Any) -> None:
    """It is no traceback of pathlib."""
    with pytest.raises(ConfigError, match=f'^{name}: {wrong!r} is not valid; valid is a path$'):
        call(wrong)


@pytest.mark.parametrize('arguments, message', [
    *(({'timeout_s': value}, f'timeout_s: {value!r} is not valid; valid is > 0 [s]')
      for value in (math.nan, 0, -1, -math.inf, '3')),
    ({'world': 3}, 'world: 3 is not valid; valid is a path')])
def test_record_refuses_before_it_starts(arguments: dict, message: str, tmp_path: Path) -> None:
    """Nothing is left behind."""
    with pytest.raises(ConfigError) as raised:
        record(Scenario.load('flat'), tmp_path / 'run', **arguments)
    assert str(raised.value) == message
    assert list(tmp_path.iterdir()) == []


def test_worlds_are_built_from_parameters_and_saved() -> None:
    """Another thing is named."""
    with pytest.raises(ConfigError, match="^config: 'flat' is not valid; valid is a WorldConfig"):
        lunar_rover_sim.build_world('flat')  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match='^world: None is not valid; valid is a World'):
        lunar_rover_sim.save_world(None, 'never')  # type: ignore[arg-type]


@pytest.mark.parametrize('place, message', [
    ('', 'PLACE exists; name a new folder'),
    ('file', 'PLACE cannot be written: PLACE is not a folder'),
    ('file/run', 'PLACE cannot be written: FOLDER/file is not a folder'),
    ('/sys/run', 'PLACE cannot be written: ')])
def test_a_folder_that_cannot_be_made_reads_as_on_the_command_line(
        place: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Existing, below a file, and not for us."""
    (tmp_path / 'file').touch()
    output = tmp_path / place
    message = message.replace('PLACE', str(output)).replace('FOLDER', str(tmp_path))
    with pytest.raises(ConfigError) as raised:
        record(Scenario.load('flat'), output)
    said = str(raised.value)
    assert said.startswith(f'folder: {message}')
    assert main(['run', 'flat', '-o', str(output)]) == 1
    printed = unfolded(capsys.readouterr().err)
    assert printed == 'lunar_rover_sim: --output' + said[len('folder'):] + '\n'


def test_a_scenario_is_shown_in_one_short_line() -> None:
    """Its YAML has all of it."""
    scenario = Scenario.load('flat', seed=7, duration_s=2.5)
    assert repr(scenario) == "Scenario(name='flat', seed=7, duration_s=2.5)"


def small_scenario(duration_s: float) -> Scenario:
    """Return a small `baseline` on ground that gives."""
    return Scenario.load('baseline', [*SMALL, *PLAIN, *SOFT], duration_s=duration_s)


def without_cameras(duration_s: float, seed: int = 1) -> Scenario:
    """Return a small `baseline` on rigid ground in which nothing is drawn."""
    return Scenario.load('baseline', [
        *SMALL, 'physics_node.ground.model=rigid',
        'run.nodes=[physics_node,gait_controller_node,drive_node,recorder_node]'],
        seed=seed, duration_s=duration_s)


@contextlib.contextmanager
def halting_nodes() -> Iterator[None]:
    """Suspend one process that this one has started after the other, as a busy machine does."""
    ended, rng = threading.Event(), random.Random(1)

    def halt() -> None:
        while not ended.wait(0.1):
            with contextlib.suppress(psutil.NoSuchProcess, IndexError):
                node = rng.choice(psutil.Process().children())
                node.suspend()
                ended.wait(0.1)
                node.resume()

    thread = threading.Thread(target=halt)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@pytest.mark.ros
def test_record(recorded_run: Path, tmp_path: Path) -> None:
    """It records what the command records, and leaves the calling process as it was.

    The bag does not depend on when the nodes get a processor.
    """
    before = dict(os.environ)
    seen: list[int] = []
    with halting_nodes():
        recording = record(small_scenario(1.0), tmp_path / 'run', on_progress=seen.append)
    assert recording.bag == tmp_path / 'run' / 'bag'
    assert topic_hashes(recording.bag) == topic_hashes(recorded_run / 'bag')
    assert bag_hash(recording.bag) == bag_hash(recorded_run / 'bag')
    with open_bag(recording.bag) as bag:
        assert recording.counts == dict(bag.counts)
        factor = recorded_factor(bag)
    assert recording.simulated_s == 1.0
    assert recording.real_time_factor == 1.0 / recording.wall_s
    assert factor is not None
    assert factor > recording.real_time_factor      # which has the start of the nodes in it
    assert set(recording.cpu_s) == set(recording.scenario.run.nodes)
    assert not recording.interrupted
    assert seen[-1] == 1_000_000_000
    assert dict(os.environ) == before
    with pytest.raises(LunarRoverSimError, match='^folder: .* exists; name a new folder$'):
        record(small_scenario(1.0), tmp_path / 'run')


@pytest.mark.ros
def test_record_in_threads_and_stopped_early(tmp_path: Path) -> None:
    """Two runs at once do not meet; a run that is stopped leaves a bag that says so.

    What there is nothing of, cameras and soft ground, is not in it; the seed decides the world.
    """
    stop = threading.Event()
    results = {}
    scenarios = {name: without_cameras(60.0, seed) for name, seed in (('a', 1), ('b', 2))}
    for scenario in scenarios.values():
        scenario.load_world()       # so that both start at the same time

    def work(name: str) -> None:
        results[name] = record(
            scenarios[name], tmp_path / name, should_stop=stop.is_set,
            on_progress=lambda now_ns: stop.set() if now_ns > 1_000_000_000 else None)

    threads = [threading.Thread(target=work, args=[name], daemon=True) for name in scenarios]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    assert not any(thread.is_alive() for thread in threads)
    hashes = set()
    for name, recording in results.items():
        assert recording.interrupted
        with open_bag(tmp_path / name / 'bag') as bag:
            assert bag.incomplete.endswith(' s of 60 s')
            assert len(list(bag.raw(['odom']))) == bag.counts['/odom'] > 0
            assert not any(topic.startswith(('/stereo', '/ground/')) for topic in bag.types)
            hashes.add(bag.first('world_hash').data)
    assert len(hashes) == 2
    assert sorted(results) == ['a', 'b']
    assert max(r.simulated_s for r in results.values()) > 1.0


@pytest.mark.ros
def test_record_gives_up_after_its_time(tmp_path: Path) -> None:
    """A run that takes too long is an error that says so, and no process is left."""
    with pytest.raises(LunarRoverSimError, match='not done within 3 s'):
        record(without_cameras(600.0), tmp_path / 'run', timeout_s=3.0)
