"""The entry point of the nodes: one line instead of a traceback where ROS 2 is missing.

    lunar_rover_sim_node NODE --ros-args ...

is the console script, which `resource/nodes/start` runs under the names of all nodes;
`python -m lunar_rover_sim.nodes.entry_points NODE --ros-args ...` does the same.
"""

from __future__ import annotations

import gc
import os
from pathlib import Path
import signal
import sys
from types import FrameType

NODES = tuple(sorted(path.stem for path in Path(__file__).parent.glob('*_node.py')))

_USAGE = """usage: {node} [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO]]

A node of lunar_rover_sim. Its parameters: lunar_rover_sim parameters {node}"""


def _leave(number: int, frame: FrameType | None) -> None:
    # Nothing exists yet that must be closed. An exception would be printed with a traceback, by
    # the imports too.
    os._exit(0)


def main() -> int:
    """Run the node that the first argument names; return its exit status.

    The node sees the other arguments. A signal before the node exists ends it quietly, also one
    that came while signals were blocked for the start of Python.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _leave)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))
    # The node gets the arguments that a script of its name would get.
    arguments = sys.argv[1:]
    name = arguments[0] if arguments else ''
    asks = {'-h', '--help'}
    if name in asks:
        print(f'usage: lunar_rover_sim_node NODE [--ros-args ...]\n\nnodes: {", ".join(NODES)}')
        return 0
    if name in NODES and asks.intersection(arguments[1:]):
        print(_USAGE.format(node=name))
        return 0
    if name not in NODES:
        print(f'FATAL {name!r} is not a node; valid are {", ".join(NODES)}', file=sys.stderr)
        return 1
    # No node draws with MuJoCo. Else its import looks for GLFW in a process of its own, which a
    # signal would end with a traceback.
    os.environ.setdefault('MUJOCO_GL', 'disable')
    # Imports take a second or so: hence not at the top of this module. A tenth of it was for the
    # collection of garbage, of which they make none.
    gc.disable()
    import importlib

    from lunar_rover_sim.base.errors import LunarRoverSimError
    from lunar_rover_sim.base.process import check_open_files
    from lunar_rover_sim.run.node_state import fail
    from lunar_rover_sim.run.ros_domain import dds_environment, require_ros
    try:
        check_open_files()
        require_ros()
        discovery = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', '')
        for variable, value in dds_environment(discovery).items():
            os.environ.setdefault(variable, value)
        module = importlib.import_module(f'lunar_rover_sim.nodes.{name}')
        from lunar_rover_sim.nodes.node_main import run
    except LunarRoverSimError as error:
        fail(error)
        return 1
    gc.enable()
    return run(getattr(module, name.title().replace('_', '')), arguments)


if __name__ == '__main__':
    raise SystemExit(main())
