"""The entry points of the nodes: one line instead of a traceback where ROS 2 is missing.

    python -m lunar_rover_sim.nodes.entry_points NODE --ros-args ...

starts a node as its console script does.
"""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType


def _leave(number: int, frame: FrameType | None) -> None:
    # Nothing exists yet that must be closed. An exception would be printed with a traceback, by
    # the imports too.
    os._exit(0)


def _start(name: str) -> int:
    """Run a node; return its exit status. A signal before the node exists ends it quietly."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _leave)
    # No node draws with MuJoCo. Else its import looks for GLFW in a process of its own, which a
    # signal would end with a traceback.
    os.environ.setdefault('MUJOCO_GL', 'disable')
    # Imports take a second or so: hence not at the top of this module.
    import importlib

    from lunar_rover_sim.errors import LunarRoverSimError
    from lunar_rover_sim.run.ros_installation import discovery_environment, require_ros
    try:
        require_ros()
        for variable, value in discovery_environment().items():
            os.environ.setdefault(variable, value)
        module = importlib.import_module(f'lunar_rover_sim.nodes.{name}')
    except LunarRoverSimError as error:
        print(f'FATAL {error}', file=sys.stderr)
        return 1
    return module.main()


def physics_node() -> int:
    """Run physics_node."""
    return _start('physics_node')


def gait_controller_node() -> int:
    """Run gait_controller_node."""
    return _start('gait_controller_node')


def render_node() -> int:
    """Run render_node."""
    return _start('render_node')


def recorder_node() -> int:
    """Run recorder_node."""
    return _start('recorder_node')


def drive_node() -> int:
    """Run drive_node."""
    return _start('drive_node')


def slam_node() -> int:
    """Run slam_node."""
    return _start('slam_node')


def trajectory_recorder_node() -> int:
    """Run trajectory_recorder_node."""
    return _start('trajectory_recorder_node')


def pose_bridge_node() -> int:
    """Run pose_bridge_node."""
    return _start('pose_bridge_node')


if __name__ == '__main__':
    # The node sees the arguments that its console script would see.
    del sys.argv[0]
    raise SystemExit(_start(sys.argv[0]))
