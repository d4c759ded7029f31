"""`run --view` as a user has it: a real graph, its live view, and a client that watches."""

import os
from pathlib import Path
import signal
import socket
import struct
import subprocess

from command_line import unfolded
from conftest import BLIND, processes_naming, start_run
import pytest
from waiting import LIMIT_S

pytest.importorskip('websockets')
from rosbags.typesys import get_typestore, Stores  # noqa: E402
from view_client import client, free_port  # noqa: E402  (needs the extra)
from websockets.exceptions import InvalidStatus  # noqa: E402

from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.base import topics  # noqa: E402
from lunar_rover_sim.cli.main import main  # noqa: E402

pytestmark = pytest.mark.ros

WATCHED = (topics.LEFT_IMAGE, topics.ODOM, topics.JOINT_STATES)
# Longer than a client takes to find the topics and a node to hear that they are read.
DURATION_S = 4


def finished(run: subprocess.Popen[str], folder: Path, port: int, missing: int = 0) -> str:
    """Return what a run says that ends well; nothing of it goes on, and its bag is whole.

    missing: how many of the last states may not have been recorded
    """
    said, errors = run.communicate(timeout=LIMIT_S)
    assert run.returncode == 0, said + errors
    assert not processes_naming(str(folder)) and not processes_naming(f'port:={port}')
    with open_bag(folder / 'bag') as bag:
        assert not bag.incomplete
        stamps = [bag.stamp_ns(message) for message in bag.raw(['/odom'])]
    assert stamps == [k * 5_000_000 for k in range(1, len(stamps) + 1)]
    assert 200 * DURATION_S - missing <= len(stamps) <= 200 * DURATION_S
    return said


def test_what_is_watched_arrives_while_the_run_goes_on(world_folder: Path,
                                                       tmp_path: Path) -> None:
    """Images, odometry and joint states, with the stamps and the content of the bag."""
    folder, port = tmp_path / 'run', free_port()
    run = start_run(folder, DURATION_S, '--view', str(port))
    got = {}
    with client(port) as viewer:
        for number, topic in enumerate(WATCHED):
            viewer.subscribe(f'/{topic.name}', number)
        while len(got) < len(WATCHED):
            number, stamp_ns, data = viewer.message()
            got[WATCHED[number]] = stamp_ns, data
    said = finished(run, folder, port)
    assert f'ws://localhost:{port}' in said and 'view_node' not in said
    store = get_typestore(Stores.ROS2_JAZZY)
    with open_bag(folder / 'bag') as bag:
        for topic, (stamp_ns, data) in got.items():
            recorded = {bag.stamp_ns(message): message for message in bag.raw([f'/{topic.name}'])}
            shown = store.deserialize_cdr(data, topic.type)
            expected = bag.decode(recorded[stamp_ns].data, topic.type)
            assert shown.header.stamp == expected.header.stamp
            assert bytes(data) == bytes(recorded[stamp_ns].data), topic.name


def test_a_run_goes_on_without_its_view(world_folder: Path, tmp_path: Path) -> None:
    """It names the view that was killed, once. Another page has not driven it before."""
    folder, port = tmp_path / 'run', free_port()
    # In real time a run without images lasts as long as its drive.
    run = start_run(folder, DURATION_S, '--view', str(port), *BLIND, '--teleop')
    with client(port) as viewer:
        viewer.subscribe('/odom')
        viewer.message()
        with pytest.raises(InvalidStatus), client(port, origin='https://evil.example') as other:
            other.drive('/cmd_vel', struct.pack('<4x6d', 0.1, 0, 0, 0, 0, 0))
        view, = processes_naming('entry_points view_node', f'port:={port}')
        os.kill(view, signal.SIGKILL)
    # Real time waits for nobody: a recorder without a processor misses the last states.
    said = finished(run, folder, port, missing=200)
    with open_bag(folder / 'bag') as bag:
        assert '/cmd_vel' not in bag.types
    assert said.count('view_node: ended with SIGKILL; the run goes on without the live view') == 1


def test_a_port_that_is_taken_is_one_line(tmp_path: Path,
                                          capsys: pytest.CaptureFixture[str]) -> None:
    """It is told before anything starts, and no folder is made."""
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(['run', 'baseline', '-o', str(tmp_path / 'run'), '--view', str(port)]) == 1
    assert unfolded(capsys.readouterr().err) == (
        f'lunar_rover_sim: --view: {port} cannot be served: Address already in use\n')
    assert not list(tmp_path.iterdir())
