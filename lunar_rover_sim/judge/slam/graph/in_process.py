"""The graph beside a running graph of nodes: pairs go in one at a time, poses come out.

It is used as `program.SlamProgram` is, but runs in a thread of this process.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
import dataclasses
import time

import numpy as np

from lunar_rover_sim.judge.slam.client import answer, reference
from lunar_rover_sim.judge.slam.euroc_reader import Camera
from lunar_rover_sim.judge.slam.graph.anchor import Anchor
from lunar_rover_sim.judge.slam.graph.measured import Aids, Collected
from lunar_rover_sim.judge.slam.graph.odometry import GraphOdometry
from lunar_rover_sim.judge.slam.graph.pose_graph import has_gtsam, MISSING
from lunar_rover_sim.judge.slam.program import program_settings
from lunar_rover_sim.judge.slam.protocol import FrameSet, TrackedPose
from lunar_rover_sim.products.sequences.sensors import SensorSuite

Answer = Callable[[FrameSet, Aids], TrackedPose]


class GraphTracker:
    """Answers frames by the graph, or without GTSAM by the window of the reference.

    Attributes:
        collected: Takes the messages of the other sensors, see `collected.AIDS`.
        note: Why it is not the graph; empty if it is.
        is_ready: True.
    """

    is_ready = True

    def __init__(self, suite: SensorSuite, on_news: Callable[[], None] = lambda: None,
                 on_moved: Callable[[str], None] = lambda _text: None,
                 anchor: Anchor | None = None) -> None:
        """Begin.

        Args:
            on_news: Called from a thread when a frame is answered.
            on_moved: Called from a thread with what moves the estimate, such as a loop.
            anchor: Finds the place on a site; poses are those in the site then.
        """
        self._camera = Camera.of(suite)
        self._on_moved, self._anchor = on_moved, anchor
        self.collected = Collected(suite.T_base_imu)
        self.note = '' if has_gtsam() else f'{MISSING}; this is the window of the reference'
        self._graph: GraphOdometry | None = None
        if self.note:
            self._answer = self._of_window(suite)
        else:
            self._graph = GraphOdometry.of(suite, anchor=anchor)
            self._answer = self._of_graph
        self._pool = ThreadPoolExecutor(1)
        self._on_news = on_news
        self._under_way: Future[tuple[TrackedPose, float]] | None = None

    @property
    def is_busy(self) -> bool:
        """Whether it has a frame without an answer."""
        return self._under_way is not None

    @property
    def words(self) -> str:
        """What it counted so far; empty without the graph."""
        return '' if self._graph is None else self._graph.words

    def send(self, frames: FrameSet) -> None:
        """Answer a pair; only while it is not busy."""
        self._under_way = self._pool.submit(self._timed, frames,
                                            self.collected.take(frames.stamp_ns))
        self._under_way.add_done_callback(lambda _: self._on_news())

    def take(self) -> tuple[TrackedPose, float] | None:
        """Return the next answer, and how long it took [s]; None if there is none.

        Raises:
            SlamError: If the frame could not be answered.
        """
        if self._under_way is None or not self._under_way.done():
            return None
        ended, self._under_way = self._under_way, None
        return ended.result()

    def check(self) -> None:
        """Do nothing: `take` raises what goes wrong."""

    def close(self) -> None:
        """Wait for the frame that is under way, and end the thread."""
        self._on_news = lambda: None
        self._pool.shutdown()

    def _timed(self, frames: FrameSet, aids: Aids) -> tuple[TrackedPose, float]:
        start_s = time.monotonic()
        return self._answer(frames, aids), time.monotonic() - start_s

    def _of_graph(self, frames: FrameSet, aids: Aids) -> TrackedPose:
        assert self._graph is not None
        left, right = (self._camera.rectified(np.ascontiguousarray(image))
                       for image in frames.images)
        located = self._graph.add(frames.stamp_ns, left, right, aids)
        if located is None:
            return answer(frames.stamp_ns, None, False)
        if located.news:
            self._on_moved(f'{frames.stamp_ns / 1e9:.3f} s: {located.news}')
        return dataclasses.replace(answer(frames.stamp_ns, located.T_map_left, True),
                                   covariance=located.covariance, news=located.news,
                                   place='' if self._anchor is None else self._anchor.place)

    def _of_window(self, suite: SensorSuite) -> Answer:
        track, located = reference(program_settings(suite, 'stereo', False)), False

        def of_window(frames: FrameSet, _: Aids) -> TrackedPose:
            nonlocal located
            T_map_left = track(frames, [])
            located |= T_map_left is not None
            return answer(frames.stamp_ns, T_map_left, located)
        return of_window
