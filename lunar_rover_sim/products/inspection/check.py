"""Check of a bag: complete, in step, and consistent with itself.

Time starts at one period: with states at 200 Hz the first stamp is 5 ms and the last one the
duration, so that counts are exactly rate x duration. Rates are those of the scenario in the bag,
or measured where it has none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
from pathlib import Path
import zlib

from mcap.records import DataEnd, Footer
from mcap.stream_reader import StreamReader

from lunar_rover_sim.bag.marker import has_end, MAGIC, METADATA_NAME
from lunar_rover_sim.bag.metadata import COMPRESSED
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.totals import is_at_wall_time, recorded_counts, resumed_line
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import one_line
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.base.topics import DEPTH_FRAME, FRAME, STATE
from lunar_rover_sim.products.inspection import checks, message_checks, tracking
from lunar_rover_sim.products.inspection.bag_scan import (measured_period_ns, read_rover_data,
                                                          RoverData, scenario_period_ns)
from lunar_rover_sim.products.inspection.report import CheckReport, Status

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
    for one in (rates, duration, message_checks.contract_topics, message_checks.counts,
                message_checks.commands,
                message_checks.stamps, message_checks.stereo_sets, message_checks.contents,
                message_checks.world_hash, message_checks.windows,
                message_checks.ground, checks.scans,
                checks.imu_and_odometry, checks.imu_noise, checks.calibration,
                checks.disparity_and_depth, checks.hazards, tracking.tracking):
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
