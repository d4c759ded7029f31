"""Check of a bag: complete, in step, and consistent with itself.

Time starts at one period: with states at 200 Hz the first stamp is 5 ms and the last one the
duration, so that counts are exactly rate x duration. Rates are those of the scenario in the bag,
or measured where it has none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import functools
import math
from pathlib import Path
import re
from typing import Any
import zlib

from mcap.records import DataEnd, Footer
from mcap.stream_reader import StreamReader
import numpy as np

from lunar_rover_sim.bag.marker import has_end, MAGIC, METADATA_NAME
from lunar_rover_sim.bag.metadata import COMPRESSED
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.totals import is_at_wall_time, recorded_counts, resumed_line
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import one_line, WorldError
from lunar_rover_sim.base.files.yaml_text import read_yaml
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.base.topics import DEPTH_FRAME, EVENT, FRAME, LATCHED, STATE, Topic
from lunar_rover_sim.ground.regolith.config import REGOLITH
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.products.inspection import sensor_checks, tracking
from lunar_rover_sim.products.inspection.bag_scan import (DEPTH_SET, IMAGE_SET, measured_period_ns,
                                                          read_rover_data, RoverData,
                                                          scenario_period_ns)
from lunar_rover_sim.products.inspection.report import CheckReport, grouped, Status
from lunar_rover_sim.run.publication import is_recorded, unpublished
from lunar_rover_sim.sensors.registry import sensor_of

_RATE_TOLERANCE_NS = 1000
_LATEST_NS = 5 * NS_PER_S    # longer than a run waits for the last answers


def check(path: Path | str, progress: Callable[[], None] | None = None) -> CheckReport:
    """Check a bag; `progress` is called once per message.

    Raises:
        BagError: If it cannot be read.
    """
    report = CheckReport()
    ends_ns: list[int] = []
    read: dict[str, int] = {}
    with open_bag(path) as bag:
        if bag.incomplete:
            report.add('complete', Status.FAIL, bag.incomplete)
        else:
            resumed = resumed_line(bag)
            report.add('complete', Status.PASS, f'{bag.message_count} messages on '
                       f'{len(bag.types)} topics' + (f'; {resumed}' if resumed else ''))
        checksums(bag, report)
        if not bag.namespaces:
            report.add('contract', Status.FAIL, 'no odometry and no stereo images in the bag')
        for namespace in bag.namespaces:
            rover = read_rover_data(bag, namespace, progress)
            several = len(bag.namespaces) > 1
            ends_ns.append(rover.end_ns)
            read.update({t.name: len(t.stamps_ns) for t in rover.scan.topics.values()})
            _check(rover, report.of(f'{namespace.lstrip("/")} ' if several else ''))
        readable(bag, read, report)
        span(bag, report)
        one_clock(bag, max(ends_ns, default=0), report)
    return report


def checksums(bag: Bag, report: CheckReport) -> None:
    """The files fit their checksums: of chunks, of the data and of the summary (mcap.dev/spec)."""
    files = list(bag.file_counts)
    if bag.storage_path.suffix != '.mcap' or not all(map(has_end, files)):
        report.add('checksums', Status.SKIP, 'the file has none')
        return
    report.verdict('checksums', [f'{file.name}: {problem}' if len(files) > 1 else problem
                                 for file in files if (problem := _damage(file))], 'fit')


def _damage(path: Path) -> str | None:
    """Return what of an MCAP file does not fit its checksum; a checksum of 0 means: none."""
    with path.open('rb') as file:
        footer: Footer | None = None
        is_data_verified = False
        try:
            for record in StreamReader(file, validate_crcs=True,
                                       record_size_limit=path.stat().st_size).records:
                is_data_verified |= isinstance(record, DataEnd)
                footer = record if isinstance(record, Footer) else None
        except Exception as error:  # whatever mcap and its decompressors make of damaged bytes
            return one_line(error)
        if footer is None or not is_data_verified:
            return 'the end of the data or of the file is damaged'
        # It covers all from the summary's start to itself, which the last magic follows.
        end = file.seek(0, 2) - 4 - len(MAGIC)
        start = file.seek(min(footer.summary_start, end))
        if footer.summary_crc not in (0, zlib.crc32(file.read(end - start))):
            return 'the summary does not fit its checksum'
    return None


def readable(bag: Bag, read: Mapping[str, int], report: CheckReport) -> None:
    """As many messages are read as the bag counts, and as were recorded.

    Args:
        read: Topic → messages that were read already.
    """
    found = {**dict.fromkeys(bag.types, 0), **read}
    others = [topic for topic in bag.types if topic not in read]
    for message in bag.raw(others) if others else ():
        found[message.topic] += 1
    problems = [f'{topic}: {found[topic]} of {count} messages are found'
                for topic, count in bag.counts.items() if found[topic] != count]
    problems = problems or [f'{topic}: {found.get(topic, 0)} of {count} recorded messages'
                            for topic, count in recorded_counts(bag).items()
                            if found.get(topic, 0) != count]
    total = sum(found.values())
    if not problems and total != bag.message_count:
        problems.append(f'message_count: {bag.message_count} by {METADATA_NAME}, {total} are '
                        'found')
    for file, count in bag.file_counts.items():
        if file.suffix == COMPRESSED and len(bag.file_counts) > 1:
            break       # all are read as one
        # The messages of the only file have been counted above.
        held = total if len(bag.file_counts) == 1 else _messages_in(file)
        if not problems and count not in (None, held):
            problems.append(f'{file.name}: {count} messages by {METADATA_NAME}, {held} are found')
    report.verdict('readable', problems, 'as many messages as the bag counts')


def _messages_in(file: Path) -> int:
    with open_bag(file) as bag:
        return sum(1 for _ in bag.raw())


def span(bag: Bag, report: CheckReport) -> None:
    """The first and the last message have the times that the bag begins and ends with."""
    if not bag.message_count:
        return
    start_ns, end_ns = bag.start_ns, bag.end_ns
    problems = [f'{name} at {ns / NS_PER_S:.9f} s: {what}' for name, ns, what, is_so in (
        ('begins', start_ns, 'there are earlier messages', _has(bag, None, start_ns)),
        ('begins', start_ns, 'there is no message', not _has(bag, start_ns, start_ns + 1)),
        ('ends', end_ns, 'there are later messages', _has(bag, end_ns + 1, None)),
        ('ends', end_ns, 'there is no message', not _has(bag, end_ns, end_ns + 1))) if is_so]
    report.verdict('span', problems, f'{start_ns / NS_PER_S:.3f} s to {end_ns / NS_PER_S:.3f} s')


def _has(bag: Bag, start_ns: int | None, stop_ns: int | None) -> bool:
    return next(bag.raw(start_ns=start_ns, stop_ns=stop_ns), None) is not None


def one_clock(bag: Bag, end_ns: int, report: CheckReport) -> None:
    """No message is stamped long after the last state: that would be another clock.

    Topics that bear wall time by their nature, such as /diagnostics, are left out.
    """
    if not end_ns:
        return
    late: dict[str, int] = {}
    names = [name for name in bag.types if not is_at_wall_time(name)]
    for message in bag.raw(names, start_ns=end_ns + _LATEST_NS):
        late[message.topic] = message.time_ns
    problems = [f'{topic}: up to {ns / NS_PER_S:.3f} s, {(ns - end_ns) / NS_PER_S:.0f} s after '
                'the last state (stamped with wall time?)' for topic, ns in late.items()]
    report.verdict('one clock', problems, f'all within {_LATEST_NS // NS_PER_S} s of the states')


def _check(rover: RoverData, report: CheckReport) -> None:
    """Run all checks on one rover of a bag."""
    for one in (rates, duration, contract_topics, counts, commands, stamps, stereo_sets, contents,
                world_hash, windows, ground, sensor_checks.scans, sensor_checks.imu_and_odometry,
                sensor_checks.imu_noise, sensor_checks.calibration,
                sensor_checks.disparity_and_depth, sensor_checks.hazards, tracking.tracking):
        one(rover, report)


def rates(rover: RoverData, report: CheckReport) -> None:
    """The measured rates are those of the scenario."""
    for rate in (STATE, FRAME, DEPTH_FRAME):
        meant_ns = scenario_period_ns(rate, rover.scenario)
        measured_ns = measured_period_ns(rate, rover.scan)
        if not meant_ns or not measured_ns:
            continue
        if abs(measured_ns - meant_ns) > _RATE_TOLERANCE_NS:
            report.add(f'{rate} rate', Status.WARN if rover.real_time else Status.FAIL,
                       f'{NS_PER_S / measured_ns:g} Hz measured, {NS_PER_S / meant_ns:g} Hz in '
                       'the scenario')


def duration(rover: RoverData, report: CheckReport) -> None:
    """The recording is as long as its scenario runs, or until its navigator was done."""
    meant_s = rover.scenario.number('run', 'duration_s', 0.0)
    if not meant_s:
        return
    navigated = rover.scan.topics.get(topics.NAVIGATED.name)
    if navigated is not None and navigated.stamps_ns:
        meant_s = min(meant_s, navigated.stamps_ns[0] / NS_PER_S)
    step = rover.frame_ns or rover.state_ns or 1
    meant_ns = math.ceil(round(meant_s * NS_PER_S) / step) * step
    problems = []
    if rover.end_ns < meant_ns:
        problems.append(f'ends at {rover.end_ns / NS_PER_S:.3f} s of the '
                        f'{meant_ns / NS_PER_S:.3f} s that the scenario runs')
    report.verdict('duration', problems, f'{rover.end_ns / NS_PER_S:.3f} s',
                   Status.WARN if rover.real_time else Status.FAIL)


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
    excluded = rover.names(rover.scenario.get('recorder_node', 'exclude', []))
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
        if not is_recorded(topic, rover.names(listed), excluded):
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
                                if (p := t.count_problem(expected))})
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
             # Recordings of 1.0 name two frames of a pair.
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


def _hash_of_world(folder: Path) -> str | None:
    try:
        document = read_yaml(folder / 'world.yaml', _MAX_BYTES, WorldError)
    except WorldError:
        return None
    return str(document['hash']) if isinstance(document, dict) and 'hash' in document else None
