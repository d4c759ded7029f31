"""Checks of the scans of a LiDAR."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim import topics
from lunar_rover_sim.inspection.message_checks import count_problem
from lunar_rover_sim.inspection.report import CheckReport, Status
from lunar_rover_sim.inspection.rover_data import RoverData
from lunar_rover_sim.seconds import NS_PER_S

_SCANS = (topics.LIDAR_POINTS, topics.LIDAR_DESKEWED, topics.LIDAR_SCAN)


def scans(rover: RoverData, report: CheckReport) -> None:
    """Each topic has a scan of every period that ends within the recording.

    With `run.may_fail` scans may be missing, as in real time.
    """
    found = [rover.scan.topics[t.name] for t in _SCANS if t.name in rover.scan.topics]
    rate_hz = rover.scenario.number('lidar_node', 'rate_hz', 0.0)
    if not found or not rate_hz:
        return
    period = round(NS_PER_S / rate_hz)
    expected = np.arange(period, rover.end_ns - period + 1, period)
    may_miss = rover.real_time or 'lidar_node' in (rover.scenario.get('run', 'may_fail') or [])
    problems = [f'{topic.name}: {problem}' for topic in found
                if (problem := count_problem(topic, expected))]
    report.verdict('scans', problems, f'{len(found)} topics x {len(expected)} at {rate_hz:g} Hz',
                   Status.WARN if may_miss else Status.FAIL)
