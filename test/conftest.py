"""What tests of the real graph share: a small world, a ROS domain, one recorded run.

Garbage is collected less often, and not among what is imported (`gc.freeze`). Run in turn, the
tests of bags and of evaluation took 74.7 and 78.9 s of processor time with it, 91.6 and 82.7
without: an eighth less. If you measure less than a tenth, take it out.
"""

from collections.abc import Iterator
import fcntl
import gc
import os
from pathlib import Path
import subprocess
import sys

from kept_contexts import create_new, KeptContext
import moderngl
import psutil
import pytest
from waiting import LIMIT_S

from lunar_rover_sim.ground.world.cache import cached
from lunar_rover_sim.run.ros_domain import dds_environment, OwnDomain
from lunar_rover_sim.run.scenario import Scenario

# A small world and small images: the graph is the same, the machine is not kept busy.
SMALL_WORLD = ('world.size_m=12.8', 'world.surroundings.samples=257')
SMALL = (*SMALL_WORLD, 'render_node.camera.width=320', 'render_node.camera.height=240',
         'render_node.sgm.num_disparities=64', 'render_node.frame_rate_hz=10')
# For runs whose images need not tell much.
TINY = ('render_node.camera.width=160', 'render_node.camera.height=120',
        'render_node.sgm.num_disparities=32')
# For runs whose images nobody looks at: the renderer is ready sooner.
PLAIN = ('render_node.detail.far_rocks_m=0', 'render_node.detail.bounce=false',
         'render_node.detail.relief_rms_slope=0', 'render_node.detail.pit_cover=0',
         'render_node.detail.pebble_cover=0')
# For runs in which the ground needs not give: physics starts sooner and takes less.
RIGID = ('physics_node.ground.model=rigid',)
# For runs that have nothing to do with images: the renderer starts slowly.
BLIND = ('--set', 'run.nodes=[physics_node,gait_controller_node,drive_node,recorder_node]',
         '--set', *RIGID)


def command(*arguments: str) -> list[str]:
    """Return the command line of `lunar_rover_sim` with this interpreter."""
    return [sys.executable, '-m', 'lunar_rover_sim.cli.main', *arguments]


def simulate(folder: Path, *arguments: str, scenario: str = 'baseline',
             timeout_s: float = LIMIT_S) -> subprocess.CompletedProcess[str]:
    """Run a small scenario to its end; return the finished process."""
    settings = [word for setting in SMALL for word in ('--set', setting)]
    return subprocess.run(command('run', scenario, '-o', str(folder), *settings, *arguments),
                          capture_output=True, text=True, timeout=timeout_s)


def start_run(folder: Path, duration_s: int, *arguments: str) -> subprocess.Popen[str]:
    """Start a small run of `baseline` in the background."""
    settings = [word for setting in (*SMALL, *TINY, *PLAIN, *RIGID) for word in ('--set', setting)]
    return subprocess.Popen(
        command('run', 'baseline', '-o', str(folder), '--duration', str(duration_s), *settings,
                *arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def processes_naming(*words: str) -> list[int]:
    """Return the ids of other processes with all these words in their command line."""
    return sorted(process.pid for process in psutil.process_iter(['cmdline'])
                  if process.pid != os.getpid()
                  and all(word in ' '.join(process.info['cmdline'] or []) for word in words))


# What depends on the workspace: the installation, the command line, bags, runs and nodes. Pictures
# and studies do not. `./bootstrap test` runs all.
_OF_WORKSPACE = ('bag', 'cli', 'files', 'gait', 'nodes', 'rover', 'run', 'test')


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave to `colcon test`, which runs one at a time, what depends on the workspace.

    Tests beside this file come first: half a minute each, for which no worker may wait at the end.
    `./bootstrap test` looks for tests that run alone in test/nodes only.
    """
    items.sort(key=lambda item: item.path.parent != Path(__file__).parent)
    for item in items:
        if item.get_closest_marker('alone') and item.path.parent.name != 'nodes':
            raise pytest.UsageError(f'{item.nodeid}: is marked alone; valid is so in test/nodes')
    if config.getoption('junitprefix') != 'lunar_rover_sim' or config.getoption('markexpr'):
        return
    kept = [item for item in items if item.path.parent.name in _OF_WORKSPACE]
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = kept


def pytest_collection() -> None:
    """Leave garbage while modules of tests are imported: they make none."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Leave half a million objects that stay out of the collections, and collect less often."""
    gc.freeze()
    gc.enable()
    gc.set_threshold(2000, 10, 10)


def _of_all_workers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a temporary folder of this session that the workers of xdist share."""
    folder = tmp_path_factory.getbasetemp()
    return folder.parent if 'PYTEST_XDIST_WORKER' in os.environ else folder


@pytest.fixture(scope='session', autouse=True)
def world_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep the worlds of tests apart from those of the user; the workers of xdist share them."""
    os.environ['LUNAR_ROVER_SIM_CACHE'] = str(_of_all_workers(tmp_path_factory) / 'cache')


@pytest.fixture(scope='session', autouse=True)
def kept_contexts() -> Iterator[None]:
    """Let renderers use the GL contexts of those before them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(moderngl, 'create_context', KeptContext.create)
        yield


@pytest.fixture()
def new_contexts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each renderer a context of its own, as users have it."""
    monkeypatch.setattr(moderngl, 'create_context', create_new)


@pytest.fixture(scope='session')
def world_folder(world_cache: None) -> Path:
    """Return the folder of the small world that the small scenario uses with seed 1."""
    scenario = Scenario.load('baseline', SMALL_WORLD)
    return Path(cached(scenario.world, scenario.shared.seed))


SOFT = ('physics_node.ground.model=regolith',
        'recorder_node.topics=[all,ground_truth/sinkage,ground_truth/slip]')


@pytest.fixture(scope='session')
def recorded_run(tmp_path_factory: pytest.TempPathFactory, world_folder: Path) -> Path:
    """Return the folder of one real run of 1 s with all nodes, on ground that gives.

    The first worker that needs it records it; it is only read. What it said lies beside it.
    """
    pytest.importorskip('rclpy')
    folder = _of_all_workers(tmp_path_factory) / 'recorded_run'
    with folder.with_suffix('.lock').open('w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            settings = [word for setting in (*PLAIN, *SOFT) for word in ('--set', setting)]
            finished = simulate(folder, '--duration', '1', *settings)
            assert finished.returncode == 0, finished.stdout + finished.stderr
            folder.with_suffix('.out').write_text(finished.stdout)
            folder.with_suffix('.err').write_text(finished.stderr)
    return folder


@pytest.fixture()
def domain() -> Iterator[int]:
    """Give this process and its children a ROS domain of their own on this machine."""
    pytest.importorskip('rclpy')
    with OwnDomain() as own:
        before = dict(os.environ)
        os.environ.update(dds_environment(), ROS_DOMAIN_ID=str(own.id),
                          ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
        yield own.id
        os.environ.clear()
        os.environ.update(before)


@pytest.fixture()
def open_domain() -> Iterator[int]:
    """Give this process a ROS domain that no run holds: one that a run may join."""
    pytest.importorskip('rclpy')
    with OwnDomain() as own:
        number = own.id
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {**dds_environment(), 'ROS_DOMAIN_ID': str(number),
                            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}.items():
            patch.setenv(name, value)
        yield number
