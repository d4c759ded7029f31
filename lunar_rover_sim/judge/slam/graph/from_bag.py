"""The graph on a recorded bag: its pairs of images, and what else it holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import time
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.series import picture
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.image.camera.encoding import eight_bits
from lunar_rover_sim.image.stereo.depth import grey
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.judge.slam.estimators import Estimate
from lunar_rover_sim.judge.slam.euroc_reader import Camera, Image
from lunar_rover_sim.judge.slam.graph.anchor import Anchor
from lunar_rover_sim.judge.slam.graph.measured import AIDS, Aids, Collected
from lunar_rover_sim.judge.slam.graph.odometry import GraphOdometry, Located
from lunar_rover_sim.judge.slam.graph.pose_graph import has_gtsam, MISSING
from lunar_rover_sim.judge.slam.reference.odometry import VisualOdometry
from lunar_rover_sim.products.sequences.sensors import SensorSuite

Step = tuple[int, 'Image | None', 'Image | None', Aids]


def run(bag: Bag, suite: SensorSuite, loops: bool = True,
        advance: Callable[[], None] = lambda: None,
        on_pose: Callable[[int, Located], None] = lambda _stamp_ns, _located: None,
        stop: Callable[[], bool] = lambda: False, anchor: Anchor | None = None) -> GraphOdometry:
    """Return the graph after all pairs of a bag.

    Args:
        advance: Called after each pair.
        on_pose: Called with its stamp and its answer.
        stop: Once it returns True, the rest is left out.
        anchor: Finds the place on a site.
    """
    odometry = GraphOdometry.of(suite, loops, anchor)
    for step in steps(bag, suite):
        located = odometry.add(*step)
        if located is not None:
            on_pose(step[0], located)
        advance()
        if stop():
            break
    return odometry


def estimate(bag: Bag, suite: SensorSuite, advance: Callable[[], None] = lambda: None,
             stop: Callable[[], bool] = lambda: False, anchor: Anchor | None = None) -> Estimate:
    """Return the estimate of the graph for a bag; where there is no GTSAM, that of the reference.

    Args:
        advance: Called after each pair.
        stop: Once it returns True, the rest is left out.
        anchor: Finds the place on a site; the estimate has what was told live, too.
    """
    start = time.monotonic()
    if not has_gtsam():
        return _of_reference(bag, suite, advance, stop, start)
    told: list[tuple[int, Located]] = []
    news: list[str] = []

    def on_pose(stamp_ns: int, located: Located) -> None:
        if anchor is not None:
            told.append((stamp_ns, located))
            if located.news:
                news.append(f'{stamp_ns / 1e9:.1f} s: {located.news}')

    odometry = run(bag, suite, True, advance, on_pose, stop, anchor)
    try:
        trajectory = odometry.trajectory()
    except SlamError:
        return Estimate(None, 'lost: it located no frame', 'left', odometry.frames_ns,
                        time.monotonic() - start)
    return Estimate(trajectory, '', 'left', odometry.frames_ns, time.monotonic() - start,
                    '\n'.join([odometry.words, *news]), _live(told))


def _live(told: list[tuple[int, Located]]) -> Trajectory | None:
    """Return what was told at the time of each frame; None without any."""
    if not told:
        return None
    T = np.array([located.T_map_left for _, located in told])
    return Trajectory(np.array([ns for ns, _ in told], np.int64), T[:, :3, 3],
                      wxyz(Rotation.from_matrix(T[:, :3, :3])), 'graph, live',
                      np.array([located.covariance for _, located in told]))


def _of_reference(bag: Bag, suite: SensorSuite, advance: Callable[[], None],
                  stop: Callable[[], bool], start: float) -> Estimate:
    odometry = VisualOdometry(Camera.of(suite))
    stamps = []
    for stamp_ns, left, right, _ in steps(bag, suite):
        stamps.append(stamp_ns)
        if left is not None:
            odometry.add(stamp_ns, left, right)
        advance()
        if stop():
            break
    try:
        trajectory = odometry.trajectory()
    except SlamError:
        trajectory = None
    return Estimate(trajectory, f'{MISSING}; this is the window of the reference', 'left',
                    np.array(stamps, np.int64), time.monotonic() - start)


def steps(bag: Bag, suite: SensorSuite) -> Iterator[Step]:
    """Yield the pairs of a bag in their order, with what was measured since the one before.

    A CameraInfo without images, as where they were not recorded for a while, is a step without
    them.
    """
    names = {topic: bag.resolve(topic.name) for topic in (
        topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.LEFT_INFO, *AIDS)
        if bag.has(topic.name)}
    of = {name: topic for topic, name in names.items()}
    camera = Camera.of(suite)
    waiting: dict[int, dict[topics.Topic, Any]] = {}
    collected, last_ns = Collected(suite.T_base_imu), -1

    def step(stamp: int) -> Step:
        parts = waiting.pop(stamp)
        pair = parts.get(topics.LEFT_IMAGE), parts.get(topics.RIGHT_IMAGE)
        if any(image is None for image in pair):
            pair = None, None
        return stamp, *pair, collected.take(stamp)

    for name, _, message in bag.messages(list(of)):
        topic = of[name]
        if topic not in (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.LEFT_INFO):
            collected.add(topic, message)
        elif header_ns(message) > last_ns:
            waiting.setdefault(header_ns(message), {})[topic] = (
                None if topic is topics.LEFT_INFO else _pixels(bag, message, camera))
        # Messages of a stamp may come in any order. The next pair but one tells that what is
        # missing will not come.
        while waiting:
            last = min(waiting)
            whole = {topics.LEFT_IMAGE, topics.RIGHT_IMAGE} <= waiting[last].keys()
            if len(waiting) < 3 and not (whole and collected.newest_ns >= last):
                break
            last_ns = last
            yield step(last)
    for stamp in sorted(waiting):
        yield step(stamp)


def _pixels(bag: Bag, message: Any, camera: Camera) -> Image:
    return camera.rectified(np.ascontiguousarray(eight_bits(grey(picture(bag, message).pixels))))
