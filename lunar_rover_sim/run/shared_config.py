"""Parameters that several nodes share, and what they wait for."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import param, Parameters

LOCKSTEP, REAL_TIME = 'lockstep', 'real_time'

MAX_DURATION_S = 2e9    # the seconds of builtin_interfaces/Time have 32 bits


@dataclasses.dataclass(frozen=True)
class NodeConfig(Parameters):
    """Parameters that all nodes share."""

    seed: int = param(1, 'seed of everything random', low=0, high=2**31 - 1)
    world: str = param('', 'folder of `lunar_rover_sim world build`')
    rover: str = param('', 'quad, hexapod or a YAML file; empty: quad')
    time_mode: str = param(REAL_TIME, 'lockstep waits for answers, real_time follows the wall '
                           'clock', choices=(LOCKSTEP, REAL_TIME))
    participants: tuple[str, ...] = param(
        (), 'topics whose publishers a node in lockstep waits for before it sends')

    checkpoints: str = param('', 'folder of the checkpoints of a run, into which nodes write '
                             'their states', by_run=True)
    resume_from: str = param('', 'checkpoint at which a run goes on', by_run=True)
    separate_truth: bool = param(
        False, 'true odometry and its frames under ground_truth/: odom is free for an estimator')

    @property
    def truth(self) -> topics.Topic:
        """The topic of the true odometry."""
        return topics.TRUE_ODOM if self.separate_truth else topics.ODOM

    @property
    def lockstep(self) -> bool:
        """Whether simulated time waits for the answers of other nodes."""
        return self.time_mode == LOCKSTEP


@dataclasses.dataclass(frozen=True)
class WaitConfig(Parameters):
    """Topics whose answers time awaits in lockstep.

    In real time, time starts when each of them has a publisher.
    """

    topics: tuple[str, ...] = param((), 'topics whose stamps are awaited, besides those of the '
                                    'nodes of a run')
    lags_s: tuple[float, ...] = param((), 'largest lag of each of these topics', unit='s', low=0.0)
    silence_s: float = param(60.0, 'wall time after which a silent participant is an error; more '
                             'on a busy machine', unit='s', low=0.1)
    start_s: float = param(60.0, 'wall time before the first answer after which a missing '
                           'participant is an error', unit='s', low=0.1)

    def validate(self) -> None:
        """Raise ConfigError unless each topic has one lag."""
        if len(self.topics) != len(self.lags_s):
            raise ConfigError(f'lags_s: {len(self.lags_s)} elements given for {len(self.topics)} '
                              'topics; valid is one lag per topic')

    def lag_ns_by_topic(self) -> dict[str, int]:
        """Return topic → lag [ns]."""
        return {t: round(s * 1e9) for t, s in zip(self.topics, self.lags_s)}
