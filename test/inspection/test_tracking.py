"""Whether the frame rate of a recording fits its motion, from the bag alone."""

import copy

import numpy as np
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.inspection import tracking
from lunar_rover_sim.inspection.check import check
from lunar_rover_sim.inspection.report import Status
from lunar_rover_sim.inspection.summary import summarise
from lunar_rover_sim.inspection.tracking import PredictionMiss

SCENARIO = 'rover:\n  ros__parameters: {legs: {spoke_length_m: 0.08}}\n'


def drive(monkeypatch, factor, **options):
    """Return a drive whose body pitches `factor` times as much, without its images."""
    gentle = synthetic.pose_at

    def pose_at(t):
        T = gentle(t)
        nod = synthetic.frames.wxyz_from_rpy(0.0, 0.02 * factor * np.sin(20.0 * t), 0.0)
        T[:3, :3] = T[:3, :3] @ synthetic.frames.matrix_from_wxyz(nod)
        return T

    monkeypatch.setattr(synthetic, 'pose_at', pose_at)
    items = [i for i in synthetic.drive(1.0, **options)
             if i.topic in (topics.ODOM.name, topics.LEFT_INFO.name, topics.SCENARIO.name)]
    next(i for i in items if i.topic == topics.SCENARIO.name).message.data = SCENARIO
    return items


def test_a_rate_that_is_too_low_is_a_warning_that_names_one_that_is_not(tmp_path, monkeypatch):
    path = synthetic.write(tmp_path / 'bag', drive(monkeypatch, 5.0))
    with open_bag(path) as bag:
        found = tracking.of_bag(bag)
    assert [miss.rate_hz for miss in found] == pytest.approx([10.0, 20.0, 40.0])   # of 200 Hz
    assert found[0].median_px > 2.0 * found[1].median_px > 4.0 * found[2].median_px
    assert found[0].lost > tracking.MAX_LOST >= found[1].lost
    finding = next(f for f in check(path).findings if f.check == 'tracking')
    assert finding.status is Status.WARN
    assert finding.detail == tracking.sentence(found)
    assert 'at 10 Hz' in finding.detail
    assert 'at 20 Hz by' in finding.detail
    assert finding.detail in summarise(path).lines()


def test_a_gentle_drive_passes(tmp_path, monkeypatch):
    path = synthetic.write(tmp_path / 'bag', drive(monkeypatch, 0.0))
    finding = next(f for f in check(path).findings if f.check == 'tracking')
    assert finding.status is Status.PASS
    assert finding.detail.count('Hz') == 1


def test_rates_of_a_run_in_real_time_are_rounded():
    """Frames that this machine could not draw leave rates such as 20 / 3 Hz."""
    line = tracking.sentence([PredictionMiss(20.0 / 3.0, 9.0, 30.0, 0.4),
                              PredictionMiss(40.0 / 3.0, 3.0, 9.0, 0.0)])
    assert line.startswith('at 6.67 Hz, ')
    assert 'at 13.3 Hz by' in line


def test_the_truth_is_judged_where_it_has_a_topic_of_its_own(tmp_path, monkeypatch):
    """An estimator owns `odom` there; this one stands still."""
    items = drive(monkeypatch, 5.0)
    truth = [copy.deepcopy(item) for item in items if item.topic == topics.ODOM.name]
    for item in truth:
        item.topic = topics.TRUE_ODOM.name
    still = truth[0].message.pose.pose
    for item in items:
        if item.topic == topics.ODOM.name:
            item.message.pose.pose = still
    path = synthetic.write(tmp_path / 'bag', items + truth)
    with open_bag(path) as bag:
        found = tracking.of_bag(bag)
    assert found[0].lost > tracking.MAX_LOST
    finding = next(f for f in check(path).findings if f.check == 'tracking')
    assert finding.detail == tracking.sentence(found)


def test_a_bag_that_does_not_describe_its_rover_is_not_judged(tmp_path, monkeypatch):
    items = [i for i in drive(monkeypatch, 1.0) if i.topic != topics.SCENARIO.name]
    path = synthetic.write(tmp_path / 'bag', items)
    assert [f.status for f in check(path).findings if f.check == 'tracking'] == [Status.SKIP]
    assert 'tracking' not in summarise(path).lines()
