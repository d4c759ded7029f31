"""Checks of the messages of a bag: all there, in step, and valid one by one."""

from __future__ import annotations

import functools
from pathlib import Path
import re
from typing import Any

import numpy as np

from lunar_rover_sim.bag.totals import is_at_wall_time
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.files.yaml_text import read_yaml
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.base.topics import DEPTH_FRAME, EVENT, FRAME, LATCHED, STATE, Topic
from lunar_rover_sim.ground.regolith.config import REGOLITH
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.products.inspection.bag_scan import DEPTH_SET, IMAGE_SET, RoverData, TopicScan
from lunar_rover_sim.products.inspection.report import CheckReport, grouped, Status
from lunar_rover_sim.run.publication import is_recorded, unpublished
from lunar_rover_sim.sensors.registry import sensor_of

# Velocity commands come at the pace of their publisher; recordings of earlier versions lack the
# CameraInfo of the depth image, the exposure and the window; slam_node, lidar_node, mapping_node
# and navigator_node take part on request.
OPTIONAL = tuple(topic.name for topic in (
    *topics.OF_VISION, topics.CMD_VEL, topics.DEPTH_INFO, topics.EXPOSURE, topics.SLAM_STATUS,
    topics.LIDAR_SCANNED, topics.TRAVERSABILITY, topics.NAVIGATOR_STATUS, topics.MISCALIBRATION,
    topics.GLOBAL_PLAN, topics.WORLD_WINDOW))
_MAX_BYTES = 1 << 20     # of world.yaml
_VOLUME_M = 1e-5    # sum over all samples that rounding to float32 may leave


def contract_topics(rover: RoverData, report: CheckReport) -> None:
    """Every topic that was to be recorded is there, and has its type."""
    listed = rover.scenario.get('recorder_node', 'topics', ['all'])
    excluded = _names(rover, rover.scenario.get('recorder_node', 'exclude', []))
    nodes = rover.scenario.get('run', 'nodes')
    silent = _unpublished(rover)
    missing = []
    for topic in topics.of_legs(topics.CONTRACT, rover.scenario.legs):
        sensor = sensor_of(topic.name)
        if topic.name in OPTIONAL or topic in silent or (topic.rate == EVENT and sensor is None):
            continue
        if (sensor is not None and not sensor.in_state and sensor.parameters is not None
                and rover.scenario.get('physics_node', sensor.name) is None):
            continue    # a recording of before there was this sensor
        if not is_recorded(topic, _names(rover, listed), excluded):
            continue
        if isinstance(nodes, list) and topic.node not in nodes:
            continue
        if topic.name not in rover.scan.topics:
            missing.append(topic.name)
    wrong = [f'{t.name} has type {t.msgtype}, not {t.topic.type}'
             for t in rover.scan.topics.values()
             if t.msgtype != t.topic.type and t.topic is not topics.CMD_VEL]
    problems = wrong + ([f'missing: {", ".join(missing)}'] if missing else [])
    only_missing = bool(missing) and not wrong and not rover.scenario
    report.verdict('topics', problems, f'{len(rover.scan.topics)} of the contract',
                   Status.WARN if only_missing else Status.FAIL)


def counts(rover: RoverData, report: CheckReport) -> None:
    """Counts are rate x duration, stamp by stamp; latched topics came once."""
    for rate, period in ((STATE, rover.state_ns), (FRAME, rover.frame_ns),
                         (DEPTH_FRAME, rover.depth_ns)):
        found = rover.of_rate(rate)
        if not found:
            continue
        if not period:
            report.add(f'{rate} counts', Status.FAIL, 'too few messages to find their rate')
            continue
        expected = np.arange(period, rover.end_ns + 1, period)
        if rover.real_time:
            problems = grouped({t.name: f'{count} of {len(expected)}' for t in found
                                if (count := len(np.unique(t.stamps_ns))) < len(expected)})
        else:
            problems = grouped({t.name: p for t in found
                                if (p := count_problem(t, expected))})
        fine = f'{len(found)} topics x {len(expected)} at {NS_PER_S / period:g} Hz'
        report.verdict(f'{rate} counts', problems, fine,
                       Status.WARN if rover.real_time else Status.FAIL)
    problems = [f'{t.name}: {len(t.stamps_ns)} messages' for t in rover.of_rate(LATCHED)
                if len(t.stamps_ns) != 1 and not (t.topic is topics.TF_STATIC and t.stamps_ns)
                # Sent again to every new reader.
                and not (t.topic is topics.GROUND_SNAPSHOT and t.stamps_ns)
                # A dated sun moves, a navigator goes on.
                and not (t.topic in topics.CHANGING and (np.diff(t.stamps_ns) > 0).all())]
    report.verdict('latched', problems, f'{len(rover.of_rate(LATCHED))} topics, once each')


def commands(rover: RoverData, report: CheckReport) -> None:
    """In lockstep drive_node commands a velocity at each of its periods; the last may be late."""
    drive = functools.partial(rover.scenario.get, 'drive_node')
    found = rover.scan.topics.get(topics.CMD_VEL.name)
    rate_hz = rover.scenario.number('drive_node', 'rate_hz', 0.0)
    if (found is None or not rate_hz or rover.real_time or drive('mode', 'none') == 'none'
            or not drive('enable_stamped_cmd_vel', True)
            or 'drive_node' not in (rover.scenario.get('run', 'nodes') or [])):
        return
    period = round(NS_PER_S / rate_hz)
    expected = np.arange(period, rover.end_ns, period)
    lost = len(np.setdiff1d(expected, found.stamps_ns))
    problems = [f'{found.name}: {lost} of {len(expected)} missing'] if lost else []
    report.verdict('commands', problems, f'{len(expected)} at {rate_hz:g} Hz')


def stamps(rover: RoverData, report: CheckReport) -> None:
    """Stamps increase strictly; bag time is the stamp."""
    repeated, late = [], []
    for t in rover.scan.topics.values():
        if t.topic.rate in (STATE, FRAME, DEPTH_FRAME) and t.topic is not topics.TF:
            steps = np.diff(t.stamps_ns)
            if (steps <= 0).any():
                at = t.stamps_ns[int(np.argmax(steps <= 0)) + 1] / NS_PER_S
                repeated.append(f'{t.name}: {int((steps <= 0).sum())} not after the one '
                                f'before, first at {at:.3f} s')
        if t.late and not is_at_wall_time(t.name):
            late.append(f'{t.name}: {t.late} messages')
    report.verdict('stamps increase', repeated, 'strictly, on every topic')
    report.verdict('bag time', late, 'is the stamp', Status.WARN)


def stereo_sets(rover: RoverData, report: CheckReport) -> None:
    """Stereo sets and depth sets are complete at each stamp, and each stamp has a pose."""
    images, depths = _stamps(rover, IMAGE_SET), _stamps(rover, DEPTH_SET)
    if not images and not depths:
        return
    depth_ns = set().union(*depths.values())
    union = depth_ns.union(*images.values())
    if not union:
        report.add('stereo sets', Status.SKIP, 'no stereo image in the bag')
        return
    problems = [f'{name} lacks {len(all_ns - have)} of {len(all_ns)} stamps, first '
                f'{min(all_ns - have) / NS_PER_S:.6f} s'
                for sets, all_ns in ((images, union), (depths, depth_ns))
                for name, have in sets.items() if all_ns - have]
    counted = [f'{len(all_ns)} sets of {len(sets)}'
               for sets, all_ns in ((images, union), (depths, depth_ns)) if sets]
    # In real time a busy machine loses messages; the counts say how many.
    lost = Status.WARN if rover.real_time else Status.FAIL
    report.verdict('stereo sets', problems, f'{", ".join(counted)} with one stamp', lost)
    odom = rover.scan.topics.get(rover.scan.truth.name)
    if odom is None:
        return
    without_pose = np.setdiff1d(sorted(union), odom.stamps_ns).tolist()
    report.verdict('pose per image',
                   [f'no odometry at {s / NS_PER_S:.6f} s' for s in without_pose],
                   f'{len(union)} stamps', lost)


def _stamps(rover: RoverData, wanted: tuple[Topic, ...]) -> dict[str, set[int]]:
    """Return topic → stamps [ns] of the topics that are in the bag."""
    return {t.name: set(rover.scan.topics[t.name].stamps_ns) for t in wanted
            if t.name in rover.scan.topics}


def contents(rover: RoverData, report: CheckReport) -> None:
    """Numbers are finite, images have their size, frames are those of the contract."""
    problems = [f'{t.name} {t.problems[0]}' + (f' (in {len(t.problems)} messages)'
                                               if len(t.problems) > 1 else '')
                for t in rover.scan.topics.values() if t.problems]
    report.verdict('contents', problems, 'finite, of the declared size')
    separate = bool(rover.scenario.get('physics_node', 'separate_truth', False))
    wrong = [f'{t.name} in frame {sorted(t.frame_ids)}, not {t.topic.frame(separate)!r}'
             for t in rover.scan.topics.values() if t.frame_ids and t.topic.frame_id
             and t.frame_ids != {t.topic.frame(separate)}
             # Recordings of earlier versions name no frame of the feet, and two of a pair.
             and not (t.topic in (topics.FOOT_SLIP, topics.SINKAGE) and t.frame_ids == {''})
             and not ('/right/' in t.name
                      and t.frame_ids == {t.topic.frame_id.replace('left', 'right')})]
    report.verdict('frames', wrong, 'as in the contract')


def ground(rover: RoverData, report: CheckReport) -> None:
    """The ground can be rebuilt: changes begin at the start, and soil is neither made nor lost."""
    changes = rover.scan.topics.get(topics.GROUND_CHANGES.name)
    if changes is None or not changes.stamps_ns:
        return
    height_m, compaction_m = rover.scan.ground.sums_m()
    problems = []
    if rover.frame_ns and changes.stamps_ns[0] > rover.frame_ns:
        problems.append(f'changes before {changes.stamps_ns[0] / NS_PER_S:.3f} s are missing')
    if abs(height_m + compaction_m) > _VOLUME_M:
        problems.append(f'height changes ({height_m:.6f} m) and compaction ({compaction_m:.6f} m)'
                        ' do not add up to 0: a change is missing')
    report.verdict('ground changes', problems,
                   f'{len(rover.scan.ground.snapshot())} samples, no soil made or lost',
                   Status.WARN if rover.real_time else Status.FAIL)


def windows(rover: RoverData, report: CheckReport) -> None:
    """The rover is in the window of the site that is told, and each begins with a state."""
    stamps_ns, middles_m = rover.scan.signal(topics.WORLD_WINDOW)
    odom_ns, odom = rover.scan.signal(rover.scan.truth)
    if not len(stamps_ns) or not len(odom_ns):
        return
    problems = [f'no state at {ns / NS_PER_S:.3f} s, when a window begins'
                for ns in np.setdiff1d(stamps_ns[stamps_ns > 0], odom_ns)[:1]]
    of_state = np.searchsorted(stamps_ns, odom_ns, side='right') - 1
    known = of_state >= 0
    apart_m = np.abs(odom[known, :2] - middles_m[of_state[known]]).max(axis=1, initial=0.0)
    half_m = 0.5 * rover.scenario.number('world', 'size_m', WorldConfig().size_m)
    if not known.all():
        problems.append(f'{int((~known).sum())} states before the first window')
    if (apart_m > half_m).any():
        at_s = odom_ns[known][int(np.argmax(apart_m > half_m))] / NS_PER_S
        problems.append(f'the rover is outside its window at {at_s:.3f} s')
    report.verdict('windows', problems, f'{len(stamps_ns)}; the rover at most '
                   f'{apart_m.max(initial=0.0):.1f} m from the middle')


def world_hash(rover: RoverData, report: CheckReport) -> None:
    """The hash of the world is recorded; it is that of the world in the scenario's folder."""
    topic = rover.scan.topics.get(topics.WORLD_HASH.name)
    if topic is None or topic.last is None:
        report.add('world hash', Status.FAIL, 'is not in the bag')
        return
    value = str(topic.last.data)
    problems = []
    if not re.fullmatch('[0-9a-f]{16,128}', value):
        problems.append(f'{value[:40]!r} is not a hexadecimal hash')
    folder = rover.scenario.get('physics_node', 'world')
    on_disk = _hash_of_world(Path(folder)) if isinstance(folder, str) and folder else None
    if on_disk is not None and on_disk != value:
        problems.append(f'{value} is not that of {folder}, {on_disk}')
    report.verdict('world hash', problems, value)


def _unpublished(rover: RoverData) -> tuple[Topic, ...]:
    def value(name: str, default: Any = None) -> Any:
        return rover.scenario.get('physics_node', name, default)

    return unpublished(value('separate_truth', False), value('publish_clock', True),
                       value('ground.model') == REGOLITH)


def recorded_names(rover: RoverData) -> set[str]:
    """Return the names, as in the contract, of the topics that the scenario names to record."""
    return _names(rover, rover.scenario.get('recorder_node', 'topics', ['all']))


def _names(rover: RoverData, listed: object) -> set[str]:
    """Return names as in the contract of topics that a scenario lists."""
    names = listed if isinstance(listed, list) else []
    return {str(name).removeprefix(rover.namespace).lstrip('/') for name in names}


def count_problem(topic: TopicScan, expected: np.ndarray) -> str | None:
    """Return how the stamps of a topic differ from those expected [ns], or None."""
    have = np.unique(topic.stamps_ns)
    missing = np.setdiff1d(expected, have)
    extra = np.setdiff1d(have, expected)
    parts = []
    if len(missing):
        parts.append(f'{len(missing)} of {len(expected)} missing, first at '
                     f'{missing[0] / NS_PER_S:.3f} s')
    if len(extra):
        parts.append(f'{len(extra)} off the grid, first at {extra[0] / NS_PER_S:.6f} s')
    if len(topic.stamps_ns) > len(have) and topic.topic is not topics.TF:
        parts.append(f'{len(topic.stamps_ns) - len(have)} more than once')
    return ', '.join(parts) or None


def _hash_of_world(folder: Path) -> str | None:
    try:
        document = read_yaml(folder / 'world.yaml', _MAX_BYTES, WorldError)
    except WorldError:
        return None
    return str(document['hash']) if isinstance(document, dict) and 'hash' in document else None
