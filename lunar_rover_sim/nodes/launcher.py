"""Starts the nodes of a run as forks of one process, which has imported what they share.

    python -m lunar_rover_sim.nodes.launcher FOLDER < PLAN

PLAN is JSON: {"environment": {name: value}, "nodes": [[name, log file, [argument, ...]], ...]}.
Until it comes the launcher imports. Prints `started NAME PID` for each node, and `ended NAME
STATUS` once it has gone (negative: the signal); ends with the last of them. Where six processes
import for themselves, two cores need two seconds more until the first frame. FOLDER is that of the
run, for those who look at the list of processes.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import os
from pathlib import Path
import sys

from lunar_rover_sim.run.node_processes import die_with_parent

_PR_SET_NAME = 15
# Not rclpy: its libraries start threads (LTTng's), and a process with threads must not fork.
_SHARED = ('lunar_rover_sim.run.scenario', 'lunar_rover_sim.rover.rover_file',
           'lunar_rover_sim.bag.stamps', 'lunar_rover_sim.nodes.entry_points', 'geometry_msgs.msg',
           'nav_msgs.msg', 'rcl_interfaces.msg', 'rcl_interfaces.srv', 'rosgraph_msgs.msg',
           'sensor_msgs.msg', 'std_msgs.msg', 'std_srvs.srv', 'stereo_msgs.msg')


def main() -> int:
    """Start the nodes, report how each ends."""
    # What an import may print is not a report.
    reports = os.dup(1)
    os.dup2(2, 1)
    for module in _SHARED:
        with contextlib.suppress(ImportError):      # the nodes report it, each in its log
            importlib.import_module(module)
    gc.freeze()
    said = sys.stdin.read()
    if not said:
        return 0    # the runner has found an error and ended
    plan = json.loads(said)
    os.environ.update(plan['environment'])
    names = {}
    for name, log, arguments in plan['nodes']:
        pid = os.fork()
        if pid == 0:
            os.close(reports)
            return _become(name, log, arguments)
        names[pid] = name
        os.write(reports, f'started {name} {pid}\n'.encode())
    while names:
        pid, status = os.wait()
        how = os.waitstatus_to_exitcode(status)
        os.write(reports, f'ended {names.pop(pid)} {how}\n'.encode())
    return 0


def _become(name: str, log: str, arguments: list[str]) -> int:
    """Be a node: its log, its session, its command line; return its exit status."""
    # Ctrl-C reaches the runner only, which stops the nodes in order.
    os.setsid()
    die_with_parent()
    ctypes.CDLL(None).prctl(_PR_SET_NAME, name.encode())
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    module = f'lunar_rover_sim.nodes.{name}'
    _show_command_line([module, *sys.argv[1:]])
    sys.argv = [module, *arguments]
    from lunar_rover_sim.nodes import entry_points

    return int(getattr(entry_points, name)())


def _show_command_line(words: list[str]) -> None:
    """Let ps, pgrep and top show these words: written over those that this process began with."""
    # Start and end of the arguments: fields 48 and 49 of proc(5), the name being the 2nd.
    fields = Path('/proc/self/stat').read_text().rpartition(')')[2].split()
    first, last = int(fields[45]), int(fields[46])
    text = b'\0'.join(word.encode() for word in words)[:last - first - 1]
    if first:
        ctypes.memmove(first, text.ljust(last - first, b'\0'), last - first)


if __name__ == '__main__':
    raise SystemExit(main())
