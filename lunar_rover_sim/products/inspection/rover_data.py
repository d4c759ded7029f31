"""The data that the checks read: one rover's topics, scenario and periods."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses

import numpy as np

from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario, RecordedScenario
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.topics import DEPTH_FRAME, FRAME, STATE
from lunar_rover_sim.products.inspection.bag_scan import BagScan, scan, TopicScan
from lunar_rover_sim.run.publication import period_ns

IMAGE_SET = (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.LEFT_INFO, topics.RIGHT_INFO)
DEPTH_SET = (topics.DISPARITY, topics.DEPTH, topics.TRUE_DEPTH)

# The topics that the rates are measured on.
_MEASURED = {STATE: (topics.TRUE_ODOM, topics.ODOM, topics.CLOCK),
             FRAME: topics.OF_PAIRS,
             DEPTH_FRAME: (topics.DISPARITY, topics.TRUE_DEPTH, topics.DEPTH)}


@dataclasses.dataclass(frozen=True)
class RoverData:
    """What one rover recorded.

    Attributes:
        state_ns, frame_ns, depth_ns: Periods of states, of frames, and of frames with depth [ns];
            0 where they are not known.
        end_ns: Last stamp of the states, else of the frames; 0 in an empty recording.
    """

    namespace: str
    scenario: RecordedScenario
    scan: BagScan
    state_ns: int
    frame_ns: int
    depth_ns: int
    end_ns: int

    @property
    def real_time(self) -> bool:
        """Whether it was recorded in real time, where samples may be lost."""
        return self.scenario.get('physics_node', 'time_mode') == 'real_time'

    def of_rate(self, rate: str) -> list[TopicScan]:
        """Return the topics of a rate class; velocity commands belong to none."""
        return [t for t in self.scan.topics.values()
                if t.topic.rate == rate and t.topic is not topics.CMD_VEL]


def read_rover_data(bag: Bag, namespace: str, progress: Callable[[], None] | None) -> RoverData:
    """Scan one namespace of a bag; `progress` is called once per message."""
    scenario = recorded_scenario(bag, namespace)
    found = scan(bag, namespace, progress)
    rover = RoverData(namespace, scenario, found, _period_ns(STATE, scenario, found),
                      _period_ns(FRAME, scenario, found),
                      _period_ns(DEPTH_FRAME, scenario, found), end_ns=0)
    ends = [t.stamps_ns[-1] for t in rover.of_rate(STATE) if t.stamps_ns]
    ends = ends or [t.stamps_ns[-1] for t in rover.of_rate(FRAME) if t.stamps_ns]
    return dataclasses.replace(rover, end_ns=max(ends, default=0))


def scenario_period_ns(rate: str, scenario: RecordedScenario) -> int:
    """Return the period [ns] of a rate class in the scenario; 0 where there is none."""
    # Recordings of versions before depth_every have depth with every frame.
    return period_ns(rate, scenario.number('physics_node', 'state_rate_hz', 0.0),
                     scenario.number('render_node', 'frame_rate_hz', 0.0),
                     scenario.number('render_node', 'depth_every', 1.0))


def measured_period_ns(rate: str, found: BagScan) -> int:
    """Return the median period [ns] of a rate class; 0 where too little was recorded."""
    recorded = next((found.topics[t.name] for t in _MEASURED[rate] if t.name in found.topics),
                    None)
    steps = np.diff(np.unique(recorded.stamps_ns if recorded is not None else []))
    return int(np.median(steps)) if len(steps) else 0


def _period_ns(rate: str, scenario: RecordedScenario, found: BagScan) -> int:
    return scenario_period_ns(rate, scenario) or measured_period_ns(rate, found)
