"""Campaigns over real graphs: killed, resumed, reproduced byte for byte, on a real cluster."""

from collections.abc import Iterator
import contextlib
import json
import os
from pathlib import Path
import signal
import subprocess
import sys

from command_line import unfolded
from conftest import command, PLAIN, processes_naming
import pytest
from waiting import LIMIT_S, wait_until

from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.campaign import episode
from lunar_rover_sim.campaign.dataset import failures, manifests
from lunar_rover_sim.cli.main import main

pytestmark = pytest.mark.ros

SMALL = """
settings:
  run.duration_s: 0.3
  world.size_m: 12.8
  world.surroundings.samples: 257
  world.seed: 1
  render_node.camera.width: 160
  render_node.camera.height: 120
  render_node.sgm.num_disparities: 32
  render_node.frame_rate_hz: 20
  render_node.depth_every: 2
  physics_node.ground.model: rigid
""" + ''.join(f'  {setting.replace("=", ": ")}\n' for setting in PLAIN)
KILLED = 'design: grid\nformats: [tum]\nvary:\n  case:\n    choice:\n' + ''.join(
    f'      - {case}\n' for case in (
        '{physics_node.start.yaw_deg: 20.0, seed: 5}',
        '{world.source: dem, world.path: there_is_none.tif}')) + SMALL
BLIND = """
episodes: 2
vary:
  physics_node.start.yaw_deg: {uniform: [-180, 180]}
""" + SMALL + """  run.nodes: [physics_node, gait_controller_node, drive_node, recorder_node]
"""


def start(*arguments: str) -> subprocess.Popen[str]:
    """Start `lunar_rover_sim campaign` in the background."""
    return subprocess.Popen(command('campaign', *arguments), stdout=subprocess.PIPE,
                            stderr=subprocess.STDOUT, text=True)


def recording(folder: Path) -> bool:
    """Return whether an episode is being recorded."""
    return any((folder / 'partial').glob('*/episodes/bag/*.mcap'))


def test_killed_resumed_reproduced(tmp_path: Path, world_folder: Path,
                                   capsys: pytest.CaptureFixture[str]) -> None:
    """After kill -9 nothing runs on; the same call completes; a scenario alone makes its bag."""
    (tmp_path / 'killed.yaml').write_text(KILLED)
    arguments = (str(tmp_path / 'killed.yaml'), '-o', str(tmp_path / 'data'), '--jobs', '2')
    campaign = start(*arguments)
    wait_until(lambda: recording(tmp_path / 'data'), 'nothing was recorded')
    campaign.kill()
    campaign.communicate(timeout=LIMIT_S)    # its processes hold the pipe
    wait_until(lambda: not processes_naming(str(tmp_path / 'data')), 'processes are left')

    again = start(*arguments)
    output, _ = again.communicate(timeout=LIMIT_S)
    # One of two cannot be made: told, recorded, and no reason to stop.
    assert again.returncode == 1, output
    assert '1 of 2 episodes' in output
    made = {m['name']: m for m in manifests(tmp_path / 'data')}
    assert list(made) == ['0000']
    assert 'there_is_none.tif' in failures(tmp_path / 'data')['0001']
    assert not list((tmp_path / 'data' / 'partial').iterdir())
    for name, manifest in made.items():
        folder = tmp_path / 'data' / 'episodes' / name
        assert (folder / 'tum' / 'groundtruth.txt').stat().st_size > 0
        assert manifest['statistics']['frames'] == 6
        assert {'stereo/right/image_raw', 'imu/data_raw'} <= set(manifest['topics'])
        assert 'lidar/points' not in manifest['topics']
        assert manifest['bag_hash'] == bag_hash(folder / 'bag')
    assert 'CC-BY-4.0' in (tmp_path / 'data' / 'README.md').read_text()

    assert main(['campaign', *arguments]) == 1
    assert '1 there, 0 to make, 1 failed before' in ''.join(capsys.readouterr())

    scenario = tmp_path / 'data' / 'episodes' / '0000' / 'scenario.yaml'
    subprocess.run(command('run', str(scenario), '-o', str(tmp_path / 'alone')), check=True,
                   capture_output=True, timeout=LIMIT_S)
    assert bag_hash(tmp_path / 'alone' / 'bag') == made['0000']['bag_hash']
    assert (tmp_path / 'alone' / 'scenario.yaml').read_bytes() == scenario.read_bytes()


@contextlib.contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Start a Dask scheduler and two workers of one thread; yield its address and the workers."""
    file = folder / 'scheduler.json'
    with contextlib.ExitStack() as stack:
        def background(*arguments: str) -> subprocess.Popen[bytes]:
            process = subprocess.Popen([sys.executable, '-m', 'distributed.cli.' + arguments[0],
                                        *arguments[1:]], cwd=folder, stderr=subprocess.DEVNULL)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        background('dask_scheduler', '--host', '127.0.0.1', '--port', '0', '--no-dashboard',
                   '--scheduler-file', str(file))
        wait_until(lambda: file.is_file() and file.stat().st_size, 'no scheduler')
        address = json.loads(file.read_text())['address']
        workers = [background('dask_worker', address, '--no-nanny', '--nthreads', '1',
                              '--no-dashboard') for _ in range(2)]
        yield address, workers


def test_a_cluster_loses_a_worker(tmp_path: Path, world_folder: Path) -> None:
    """One of two workers is killed while it records: all episodes arrive all the same."""
    pytest.importorskip('distributed')
    (tmp_path / 'blind.yaml').write_text(BLIND)
    with cluster(tmp_path) as (address, workers):
        campaign = start(str(tmp_path / 'blind.yaml'), '-o', str(tmp_path / 'data'),
                         '--scheduler', address)
        wait_until(lambda: len(list((tmp_path / 'data' / 'partial').glob('*/episodes/bag'))) > 1
                   or campaign.poll() is not None, 'the workers did not start')
        os.kill(workers[0].pid, signal.SIGKILL)
        output, _ = campaign.communicate(timeout=LIMIT_S)
        assert campaign.returncode == 0, output
    assert [m['name'] for m in manifests(tmp_path / 'data')] == ['0000', '0001']
    assert not failures(tmp_path / 'data')
    assert not processes_naming(str(tmp_path / 'data'))


def test_a_scheduler_that_is_not_there_is_named(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    """One line, and the folder stays usable."""
    pytest.importorskip('distributed')
    monkeypatch.setattr(episode, '_CONNECT_S', 0.2)
    (tmp_path / 'blind.yaml').write_text(BLIND)
    assert main(['campaign', str(tmp_path / 'blind.yaml'), '-o', str(tmp_path / 'data'),
                 '--scheduler', 'tcp://127.0.0.1:9']) == 1
    said = unfolded(capsys.readouterr().err)
    assert '--scheduler tcp://127.0.0.1:9: no Dask scheduler answers' in said
