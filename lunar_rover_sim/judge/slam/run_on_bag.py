"""Running one estimator on one bag: export, estimate, evaluate."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math
from pathlib import Path
import shutil
from typing import Any

import numpy as np

from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import EvaluationError, SlamError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.results import json_text, plain
from lunar_rover_sim.image.camera.encoding import EIGHT_BITS, has_16_bits
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.judge.evaluation.trajectory_files import (trajectory_of_topic, write_tum,
                                                               write_tum_covariance)
from lunar_rover_sim.judge.evaluation.trajectory_plots import save_plots
from lunar_rover_sim.judge.slam import euroc_reader
from lunar_rover_sim.judge.slam.estimators import ANCHORED, Estimate, Estimator, join
from lunar_rover_sim.judge.slam.graph.anchor import Anchor
from lunar_rover_sim.judge.slam.graph.from_bag import estimate as estimate_by_graph
from lunar_rover_sim.judge.slam.graph.pose_graph import has_gtsam, MISSING
from lunar_rover_sim.products.sequences.export import export, FORMATS
from lunar_rover_sim.products.sequences.sensors import recorded_sensors, SensorSuite
from lunar_rover_sim.rover.physics.state import TipOver
from lunar_rover_sim.run.child_process import Echo

ESTIMATE, COVARIANCE, LIVE = 'estimate.txt', 'estimate_covariance.txt', 'live_covariance.txt'

Step = Callable[[str, 'int | None'], None]


@dataclasses.dataclass(frozen=True)
class SlamResult:
    """The result of one run; what is unknown is NaN.

    Attributes:
        reason: Why there is no result, or what else went wrong; empty if all went well.
        frames: Images that the estimator was given.
        tracked_share: Share of these that have a pose.
        ate_m: Absolute trajectory error [m], RMS, after alignment by Sim(3) for mono, else by
            SE(3).
        scale: True over estimated size of the path, from the alignment by Sim(3).
        ate_percent: The error in percent of the distance.
        rpe_m: Relative pose error over pieces of equal length [m], RMS.
        drift_percent: Drift in percent of the distance.
        distance_m: Distance driven over the whole recording [m].
        duration_s, wall_s: Simulated time of the recording, and wall time of the estimator [s].
        tipped_over_s: When the rover tipped over [s]; NaN if it did not. The drive then says
            little of the estimator.
        nees_position, nees_orientation: Per degree of freedom; of estimates with covariances.
        words: What the estimator counted.
        fixes, false_fixes, first_fix_m: How often it found its place on a site, wrongly, and the
            way to the first time; NaN without a map.
        absolute_median_m, absolute_p95_m: Horizontal errors of what it told from then on.
    """

    system: str
    sensor: str
    reason: str = ''
    frames: int = 0
    tracked_share: float = 0.0
    ate_m: float = float('nan')
    scale: float = float('nan')
    ate_percent: float = float('nan')
    rpe_m: float = float('nan')
    drift_percent: float = float('nan')
    distance_m: float = float('nan')
    duration_s: float = float('nan')
    wall_s: float = float('nan')
    tipped_over_s: float = float('nan')
    nees_position: float = float('nan')
    nees_orientation: float = float('nan')
    words: str = ''
    fixes: float = float('nan')
    false_fixes: float = float('nan')
    first_fix_m: float = float('nan')
    absolute_median_m: float = float('nan')
    absolute_p95_m: float = float('nan')

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values for JSON; NaN becomes None."""
        return plain(dataclasses.asdict(self))

    @classmethod
    def from_mapping(cls, values: dict[str, Any]) -> SlamResult:
        """Return the result that `to_mapping` wrote."""
        names = {field.name for field in dataclasses.fields(cls)}
        plain: dict[str, Any] = {k: float('nan') if v is None else v for k, v in values.items()
                                 if k in names}
        return cls(**plain)


def run_on_bag(bag: Path, estimator: Estimator, folder: Path, echo: Echo | None = None,
               step: Step = lambda _text, _total: None,
               advance: Callable[[], None] = lambda: None,
               kept_sequence: Path | None = None,
               stop: Callable[[], bool] = lambda: False, plots: bool = False,
               anchor: Anchor | None = None) -> SlamResult:
    """Export a bag, run an estimator on it and judge the outcome. A lost track is a result.

    Args:
        bag: A bag folder.
        estimator: The program and its input.
        folder: Must exist; gets settings, log, estimate.txt (TUM), estimate_covariance.txt if the
            estimate has covariances, evaluation.json and path.npz (`stamps_ns`, `truth_m`,
            `estimate_m`, aligned).
        echo: Called with each line of the log.
        step: Called with what is being done and in how many parts, None where nobody knows.
        advance: Called after each of them.
        kept_sequence: Folder of the exported sequence, which stays; if it exists, it is the
            sequence of this bag in the format of the estimator. None: the sequence is removed.
        stop: Once it returns True, the program is ended early.
        plots: Whether to write the figures of an evaluation, too.
        anchor: Of the graph: finds the place on a site. live_covariance.txt then has what it told.

    Raises:
        SlamError, BagError, SequenceError, EvaluationError: If there can be no result.
    """
    sequence = kept_sequence or folder / 'sequence'
    if kept_sequence is None:
        shutil.rmtree(sequence, ignore_errors=True)
    with open_bag(bag) as opened:
        truth = trajectory_of_topic(opened)
        if estimator.system == 'orbslam3' and opened.count(topics.LEFT_IMAGE.name):
            encoding = opened.first(topics.LEFT_IMAGE.name).encoding
            if has_16_bits(encoding):
                raise SlamError(f'{bag}: images of encoding {encoding} are not valid for '
                                f'ORB-SLAM3; valid are {", ".join(EIGHT_BITS)}')
        kind = FORMATS[estimator.format]
        suite = recorded_sensors(opened, kind.needs)
        messages = sum(opened.counts[opened.resolve(name)] for name in kind.needs + kind.uses
                       if opened.has(name))
        if estimator.system == 'wheels':
            return _judge(bag, estimator, folder, truth, _wheels(opened), step, plots)
        if estimator.system == ANCHORED and (anchor is None or not has_gtsam()):
            raise SlamError('anchored: needs a map from orbit' if has_gtsam() else MISSING)
        if estimator.system in ('graph', ANCHORED):
            outcome = _graph(opened, suite, step, advance, stop, anchor)
            return _judge(bag, estimator, folder, truth, outcome, step, plots)
    if not sequence.exists():
        step('exporting', messages)
        export(bag, sequence, estimator.format, advance, epoch_ns=0)     # stamps of the bag
    try:
        # Only of the built-in odometry is it known how far it is.
        step('estimating', len(euroc_reader.stamps_ns(sequence))
             if estimator.system == 'reference' else None)
        outcome = estimator.estimate(sequence, suite, folder, echo, advance, stop)
    finally:
        if kept_sequence is None:
            shutil.rmtree(sequence, ignore_errors=True)
    return _judge(bag, estimator, folder, truth, outcome, step, plots)


def _graph(bag: Bag, suite: SensorSuite, step: Step, advance: Callable[[], None],
           stop: Callable[[], bool], anchor: Anchor | None) -> Estimate:
    left = bag.resolve(topics.LEFT_IMAGE.name)
    step('estimating', bag.counts.get(left))
    return estimate_by_graph(bag, suite, advance, stop, anchor)


def _wheels(bag: Bag) -> Estimate:
    """Return wheel odometry at the stamps of the images."""
    frames_ns = np.array([bag.stamp_ns(m) for m in bag.raw([topics.LEFT_INFO.name])], np.int64)
    rolled = trajectory_of_topic(bag, topics.WHEEL_ODOM.name)
    k = np.clip(np.searchsorted(rolled.stamps_ns, frames_ns), 1, len(rolled) - 1)
    before, after = rolled.stamps_ns[k - 1], rolled.stamps_ns[k]
    nearest = np.unique(np.where(frames_ns - before <= after - frames_ns, k - 1, k))
    return Estimate(Trajectory(rolled.stamps_ns[nearest], rolled.positions_m[nearest],
                               rolled.orientations_wxyz[nearest], 'wheels'),
                    '', 'base', frames_ns, 0.0)


def _judge(bag: Path, estimator: Estimator, folder: Path, truth: Trajectory, outcome: Estimate,
           step: Step, plots: bool) -> SlamResult:
    """Write and judge what an estimator returned."""
    step('evaluating', None)
    distance_m = truth.length_m
    tipped_s = tipped_over_s(truth)
    reason = join(outcome.reason,
                  '' if math.isnan(tipped_s) else f'the rover tipped over at {tipped_s:.1f} s')
    known = SlamResult(estimator.system, estimator.sensor, reason, len(outcome.frames_ns),
                       distance_m=distance_m, wall_s=outcome.wall_s, tipped_over_s=tipped_s,
                       duration_s=1e-9 * float(truth.stamps_ns[-1] - truth.stamps_ns[0]),
                       words=outcome.words)
    if outcome.trajectory is None:
        return known
    write_tum(folder / ESTIMATE, outcome.trajectory)
    if outcome.trajectory.covariances is not None:
        write_tum_covariance(folder / COVARIANCE, outcome.trajectory)
    if outcome.live is not None:
        known = _with_fixes(known, bag, outcome.live, folder, estimator.poses_of)
    try:
        judged = evaluate(bag, outcome.trajectory,
                          align='sim3' if estimator.sensor == 'mono' else 'se3',
                          estimate_frame=estimator.poses_of, frame_stamps_ns=outcome.frames_ns)
    except EvaluationError as error:
        return dataclasses.replace(known, reason=join(reason, str(error)),
                                   tracked_share=len(outcome.trajectory)
                                   / max(1, len(outcome.frames_ns)))
    atomic_write(folder / 'evaluation.json', json_text(judged.to_mapping()) + '\n')
    if plots:
        save_plots(judged, folder, bag)
    atomic_write(folder / 'path.npz', lambda file: np.savez(
        file, stamps_ns=judged.truth.stamps_ns, truth_m=judged.truth.positions_m,
        estimate_m=judged.estimate.positions_m))
    return dataclasses.replace(
        known, tracked_share=judged.tracked_share, ate_m=judged.ate_m.rmse, scale=judged.scale,
        ate_percent=100.0 * judged.ate_m.rmse / distance_m if distance_m else float('nan'),
        rpe_m=judged.rpe_distance_m.rmse, drift_percent=judged.drift_percent,
        nees_position=judged.consistency.position.per_dof if judged.consistency else math.nan,
        nees_orientation=judged.consistency.orientation.per_dof if judged.consistency
        else math.nan)


def _with_fixes(known: SlamResult, bag: Path, live: Trajectory, folder: Path,
                frame: str) -> SlamResult:
    write_tum_covariance(folder / LIVE, live)
    found = evaluate(bag, live, align='none', estimate_frame=frame).fixes
    if found is None:
        return known
    return dataclasses.replace(known, fixes=found.count, false_fixes=found.false,
                               first_fix_m=found.first_m, absolute_median_m=found.error_median_m,
                               absolute_p95_m=found.error_p95_m)


def tipped_over_s(truth: Trajectory) -> float:
    """Return when the rover tipped over [s]; NaN if it did not."""
    tip_over = TipOver()
    for stamp_ns, orientation_wxyz in zip(truth.stamps_ns, truth.orientations_wxyz):
        if tip_over.has_begun(orientation_wxyz):
            return float(stamp_ns * 1e-9)
    return math.nan
