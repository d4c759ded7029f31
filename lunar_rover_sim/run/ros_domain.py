"""The ROS domain of a run: a free one, who publishes in it, how far its time has come.

Helper processes look and listen. They keep ROS out of the process that supervises a run, which may
be a user's own program.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import importlib.util
import numbers
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile

from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.errors import brief, ConfigError, GraphError, with_extra
from lunar_rover_sim.base.files.paths import config_path, lock
from lunar_rover_sim.run.lockstep import machine_slowness

_ENVIRONMENT = {
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    'PYTHONUNBUFFERED': '1',
    # Five processes share the cores; threads of linear algebra would only fight for them.
    'OPENBLAS_NUM_THREADS': '1',
    # glibc keeps the memory of freed images. Otherwise the recorder spends half of its time on
    # page faults.
    'MALLOC_MMAP_THRESHOLD_': str(32 << 20),
    'MALLOC_TRIM_THRESHOLD_': str(64 << 20),
    'MALLOC_TOP_PAD_': str(4 << 20),
    # `node_logs` reads the lines of rclpy's logger, which a shell may have told to look otherwise.
    'RCUTILS_COLORIZED_OUTPUT': '0',
    'RCUTILS_CONSOLE_OUTPUT_FORMAT': '[{severity}] [{time}] [{name}]: {message}',
}
_PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'


def require_ros() -> None:
    """Raise GraphError with the remedy if rclpy is not installed."""
    if importlib.util.find_spec('rclpy') is None:
        raise GraphError('rclpy is missing: source /opt/ros/jazzy/setup.bash, or '
                         + with_extra('ros'))


def dds_environment(discovery: str = '') -> dict[str, str]:
    """Return the environment variable by which Fast DDS reads a profile of `config`.

    Nodes that have it discover each other, and repair the loss of a message, in tenths of a
    second, without it in 3 s. Other middleware does not read it. A file that the user names
    instead takes precedence: that is for the caller.

    Args:
        discovery: ROS_AUTOMATIC_DISCOVERY_RANGE. With LOCALHOST the profile has no socket that
            another machine reaches: ROS itself only keeps quiet, and answers every call.
    """
    name = 'fastdds_localhost.xml' if discovery == 'LOCALHOST' else 'fastdds.xml'
    return {_PROFILES: str(config_path(name))}


def ros_environment(domain: int) -> dict[str, str]:
    """Return the environment of a process that takes part in the graph of a ROS domain."""
    environment = {**dds_environment('LOCALHOST'), **os.environ, **_ENVIRONMENT,
                   'ROS_DOMAIN_ID': str(domain)}
    # It would override ROS_AUTOMATIC_DISCOVERY_RANGE.
    environment.pop('ROS_LOCALHOST_ONLY', None)
    return environment


# Of these a graph may have several publishers.
_SHARED = ('/tf', '/tf_static')
_NO_WORDS = 'no reason given'
_PROBE_S = 30.0
_LEAVE_S = 2.0      # for the helper to leave the graph


def shell_domain() -> int:
    """Return the ROS_DOMAIN_ID of the shell, 0 where it has none; raise ConfigError for others."""
    text = os.environ.get('ROS_DOMAIN_ID') or '0'
    if not (text.isdecimal() and int(text) <= _MOST):
        raise ConfigError(f'ROS_DOMAIN_ID: {brief(text)} is not valid; valid is 0 to {_MOST}')
    return int(text)


def check_domain(domain: int, topics: Sequence[str], join: bool = False) -> None:
    """Raise GraphError if somebody publishes one of these topics in a ROS domain.

    It takes some seconds: a node that does not answer discovery within 4 s counts as absent.

    Args:
        join: Others may publish those that several nodes share, such as tf.
    """
    if join:
        topics = [topic for topic in topics if topic not in _SHARED]
    limit_s = _PROBE_S * machine_slowness()
    try:
        found = subprocess.run(
            [sys.executable, '-m', 'lunar_rover_sim.nodes.domain_probe', *topics],
            env=ros_environment(domain), stdin=subprocess.DEVNULL, capture_output=True, text=True,
            timeout=limit_s)
    except subprocess.TimeoutExpired:
        raise GraphError(f'--domain {domain}: who publishes there could not be found out within '
                         f'{limit_s:.3g} s') from None
    if found.returncode not in (0, -signal.SIGALRM):    # the latter: it could not leave the graph
        raise GraphError(f'--domain {domain}: who publishes there could not be found out: '
                         + (found.stderr.strip().splitlines() or [_NO_WORDS])[-1])
    # Fast DDS writes its own messages to standard output too.
    answers = [words for words in map(str.split, found.stdout.splitlines())
               if len(words) == 2 and words[0] in topics]
    if answers:
        topic, node = answers[0]
        raise GraphError(f'--domain {domain}: {node} publishes {topic} there; '
                         + ('stop it, or choose another domain' if join
                            else 'take part in its graph with --join, or choose another domain'
                            if topic in _SHARED else 'choose another domain, or leave it out'))


class ClockReader(Closing):
    """The newest simulated time of the graph in a ROS domain; context manager."""

    def __init__(self, domain: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'lunar_rover_sim.nodes.clock_monitor'],
            env=ros_environment(domain), stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, start_new_session=True)
        assert self._process.stdin is not None and self._process.stdout is not None
        self._running = self._process.stdin
        self._pipe = self._process.stdout
        os.set_blocking(self._pipe.fileno(), False)
        self._rest = b''
        self._now_ns = 0
        self._last_words = ''

    def now_ns(self) -> int:
        """Return the newest simulated time [ns]; 0 before the first clock message."""
        *lines, self._rest = (self._rest + (self._pipe.read() or b'')).split(b'\n')
        # Fast DDS writes its own messages to standard output too.
        times = [line for line in lines if line.isdigit()]
        if times:
            self._now_ns = int(times[-1])
        others = [line for line in lines if line.strip() and not line.isdigit()]
        if others:
            self._last_words = others[-1].decode('utf-8', 'replace')
        return self._now_ns

    def check(self) -> None:
        """Raise GraphError if the helper process has ended: nobody tells the time any more."""
        status = self._process.poll()
        if status is not None:
            self.now_ns()
            raise GraphError('the process that reads the clock ended with status '
                             f'{status}: {self._last_words or _NO_WORDS}')

    def close(self) -> None:
        """End the helper process."""
        # A participant that is killed leaves its shared memory behind.
        self._running.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_LEAVE_S)
        self._process.kill()
        self._process.wait()
        self._pipe.close()


# Domains whose ports stay clear of the ephemeral range on Linux.
_FIRST, _LAST = 1, 101
# Ports of DDS are 7400 + 250 per domain (RTPS specification 2.5, 9.6.2), and end at 65535.
_MOST = 232


class OwnDomain(Closing):
    """Holds a free ROS_DOMAIN_ID of this machine until closed; context manager.

    The lock is a file that other runs of this package respect. Other programs do not know it; name
    a domain that they do not use.

    Attributes:
        id: The domain.
    """

    def __init__(self, domain: int | None = None) -> None:
        """Take `domain`, or any free one.

        Raises:
            ConfigError: For a number that is no domain.
            GraphError: If a run of this package holds it.
        """
        if domain is not None and not (isinstance(domain, numbers.Integral)
                                       and 0 <= domain <= _MOST):
            raise ConfigError(f'--domain {brief(domain)}: is not valid; valid is 0 to {_MOST}')
        folder = Path(tempfile.gettempdir()) / f'lunar_rover_sim_domains_{os.getuid()}'
        folder.mkdir(mode=0o700, exist_ok=True)
        # Runs of two users, who do not share the folder, seldom start at the same domain.
        start = os.getpid()
        count = _LAST - _FIRST + 1
        candidates = [domain] if domain is not None else \
            [_FIRST + (start + k) % count for k in range(count)]
        for candidate in candidates:
            try:
                self._file: int | None = lock(folder / str(candidate), 0o600)
            except BlockingIOError:
                continue
            self.id = candidate
            return
        if domain is not None:
            raise GraphError(f'--domain {domain}: another run is using it; choose another')
        raise GraphError(f'all ROS domains {_FIRST} to {_LAST} are in use by other runs')

    def close(self) -> None:
        """Give the domain back."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
