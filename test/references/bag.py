"""Bags: series, stamps, hashes, validity of messages, QoS, recovery.

Messages have numbers that are exact in binary, so that their bytes are the same everywhere.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
import shutil
from types import SimpleNamespace
from typing import Any

import numpy as np
from references.cases import reference
from references.words import said
from rosbags.typesys import get_typestore, Stores
import synthetic_bag as synthetic
from synthetic_bag import header, image, Item, msg, quaternion, vector

from lunar_rover_sim import topics
from lunar_rover_sim.bag import message_validity, scan_validity
from lunar_rover_sim.bag.checksums import damage, has_end
from lunar_rover_sim.bag.content_hash import bag_hash, combine, is_skipped, topic_hashes
from lunar_rover_sim.bag.driven_distance import driven_distance_m, every_step
from lunar_rover_sim.bag.file_counts import file_counts, is_count
from lunar_rover_sim.bag.ground_history import ground_at
from lunar_rover_sim.bag.ground_points import changes_of, points_of, problem
from lunar_rover_sim.bag.marker import mark, mark_failed, why_incomplete
from lunar_rover_sim.bag.qos import as_recorded, contract_qos, qos_of_text, reliable_qos
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.bag.series import (common_stamps, picture, read_calibration, read_imu,
                                        read_odometry)
from lunar_rover_sim.bag.stamps import stamp_ns, StampTable
from lunar_rover_sim.errors import LunarRoverSimError
from lunar_rover_sim.regolith.overlay import GroundChanges
from lunar_rover_sim.seconds import in_seconds
from lunar_rover_sim.world.grid import HeightGrid


def pose_message(k: int) -> Any:
    return msg('geometry_msgs/Pose', position=msg('geometry_msgs/Point', x=0.5 * k, y=-0.25 * k,
                                                  z=0.125),
               orientation=quaternion([0.0, 1.0, 0, 0]))


def exact_items() -> list[Item]:
    """Return messages of several types and topics with exact numbers."""
    found = []
    for k in range(12):
        ns = 25_000_000 * (k + 1)
        twist = msg('geometry_msgs/TwistWithCovariance', covariance=np.zeros(36), twist=msg(
            'geometry_msgs/Twist', linear=vector([0.5, 0.0, 0.25 * k]),
            angular=vector([k, 0.5, -1.0])))
        odometry = msg('nav_msgs/Odometry', header=header(ns, 'odom'), child_frame_id='base_link',
                       pose=msg('geometry_msgs/PoseWithCovariance', pose=pose_message(k),
                                covariance=np.zeros(36)), twist=twist)
        found += [Item('clock', 'rosgraph_msgs/msg/Clock', msg('rosgraph_msgs/Clock',
                                                               clock=synthetic.time(ns))),
                  Item('odom', 'nav_msgs/msg/Odometry', odometry),
                  Item('imu/data_raw', 'sensor_msgs/msg/Imu', synthetic.imu(
                      ns, np.array([0.5, k, 0.25]), np.array([0.0, -0.5 * k, 1.5])))]
        if k % 3 == 1:
            for name in (topics.LEFT_IMAGE, topics.RIGHT_IMAGE):
                pixels = (np.arange(7 * 11).reshape(7, 11) * (k + 1) % 256).astype(np.uint8)
                found.append(Item(name.name, name.type, image(ns, 'a_frame', 'mono8', pixels)))
            if k > 2:
                found.append(Item(topics.RIGHT_INFO.name, topics.RIGHT_INFO.type,
                                  synthetic.camera_info(ns, 'right_frame', 0.25)))
    found.append(Item(topics.SCENARIO.name, topics.SCENARIO.type, msg(
        'std_msgs/String', data='/**:\n  ros__parameters: {seed: 7}\nphysics_node:\n'
        '  ros__parameters: {imu: {rate_hz: 100.0, on: true}, empty: null}\nodd: 3\n'
        'none: {ros__parameters: null}\n'), 5))
    return found


@reference
def series(folder: Path) -> dict[str, Any]:
    """What is read of a bag: odometry, IMU, images, calibration, scenario, names."""
    path = synthetic.write(folder / 'bag', exact_items(), '/rover_1')
    found: dict[str, Any] = {}
    with open_bag(path) as bag:
        shots = [picture(bag, message) for _, _, message in bag.messages([topics.LEFT_IMAGE.name])]
        calibration = read_calibration(bag, topics.RIGHT_INFO.name)
        scenario = recorded_scenario(bag)
        found = {
            'odometry': read_odometry(bag), 'imu': read_imu(bag), 'images': shots,
            'common': common_stamps(bag, [topics.LEFT_IMAGE.name, topics.RIGHT_INFO.name, 'odom']),
            'calibration': calibration, 'numbers': list(calibration.fx_fy_cx_cy_px),
            'baseline': calibration.baseline_m, 'counts': bag.counts, 'types': bag.types,
            'times': [bag.start_ns, bag.end_ns, bag.message_count],
            'names': [bag.namespace, bag.truth, bag.resolve('odom'),
                      bag.resolve('/rover_1/clock')],
            'has': [bag.has(name) for name in ('odom', 'nothing', '/rover_1/odom', 'clock')],
            'window': [m.time_ns for m in bag.raw(['odom'], 50_000_000, 125_000_000)],
            'said': [said(bag.resolve, 'odo').replace(str(path), 'BAG'),
                     said(bag.first, topics.RIGHT_INFO.name)],
            'scenario': [scenario.get('physics_node', name) for name in (
                'imu.on', 'seed', 'imu', 'nothing', 'empty', 'imu.rate_hz.more')
                if not isinstance(scenario.get('physics_node', name), dict)],
            'sections': sorted(scenario.sections), 'rate': scenario.number(
                'physics_node', 'imu.rate_hz', 1.0),
            'defaults': [scenario.number('physics_node', 'imu.on', 2.5), scenario.number(
                'other', 'x', 3.5)], 'incomplete': bag.incomplete,
            'stamps': [bag.stamp_ns(message) for message in bag.raw(['clock'])][:7]}
    return found


@reference
def hashes(folder: Path) -> dict[str, Any]:
    """Hashes of bags: storages, orders, namespaces; what is skipped."""
    items = exact_items()
    first = synthetic.write(folder / 'a', items)
    found: dict[str, Any] = {'topics': topic_hashes(first), 'bag': bag_hash(first),
                             'order': bag_hash(synthetic.write(folder / 'b', items[::-1])),
                             'sqlite': bag_hash(synthetic.write(folder / 'c', items,
                                                                storage='sqlite3')),
                             'zstd': bag_hash(synthetic.write(folder / 'd', items,
                                                              compression='zstd')),
                             'few': bag_hash(synthetic.write(folder / 'e', items[:20])),
                             'named': bag_hash(synthetic.write(folder / 'f', items, '/x')),
                             'combined': combine({'b': '1', 'a': '2'}, {'a': 't', 'b': 'u'})}
    found['skipped'] = [is_skipped(name) for name in (
        '/rosout', 'rosout', '/x/diagnostics', '/my_rosout', '/odom', '/x/recorder/written')]
    return found


@reference
def stamps() -> dict[str, Any]:
    """Where the stamps of all message types are, in both byte orders."""
    table = StampTable(get_typestore(Stores.ROS2_JAZZY))
    store = get_typestore(Stores.ROS2_JAZZY)
    raw = {'little': bytes([0, 1, 0, 0]) + (3).to_bytes(4, 'little') + (7).to_bytes(4, 'little')
           + (9).to_bytes(4, 'little'), 'big': bytes([0, 0, 0, 0]) + (3).to_bytes(4, 'big')
           + (7).to_bytes(4, 'big') + (9).to_bytes(4, 'big'),
           'empty': bytes([0, 1, 0, 0]) + bytes(12), 'short': bytes([0, 1, 0, 0]) + bytes(7)}
    found: dict[str, Any] = {name: ' '.join(
        f'{kind.partition("/msg/")[2]}={table.stamp_ns(kind, data)}'
        for kind in sorted(store.fielddefs) if kind.partition('/')[0] in (
            'std_msgs', 'tf2_msgs', 'nav_msgs', 'rosgraph_msgs', 'builtin_interfaces'))
        for name, data in raw.items()}
    found['known'] = stamp_ns('rosgraph_msgs/msg/Clock', raw['little'])
    found['unknown'] = stamp_ns('a/msg/B', raw['little'])
    found['seconds'] = [in_seconds(ns) for ns in (0, 1, -1, 1_500_000_000, -2_000_000_001,
                                                  1_700_000_000_123_456_789)]
    return found


@reference
def distances() -> dict[str, Any]:
    """The first position of every tenth of a second, and the last."""
    found = {}
    for start in (0, 1_700_000_000_123_456_789):
        stamped = [(start + ns, (0.001 * ns / 1e6, (k % 3) * 0.01, 5.0 * k))
                   for k, ns in enumerate(range(0, 1_000_000_000, 37_000_000))]
        found[f'{start}'] = {'distance': driven_distance_m(stamped),
                             'kept': [ns - start for ns, _ in every_step(stamped)]}
    found['none'] = driven_distance_m([])
    return found


@reference
def ground_changes(folder: Path) -> dict[str, Any]:
    """Changes of the ground as points, back, and over time; what is refused."""
    index = np.array([[-200, 3], [0, 0], [41, -7], [250, 99]], np.int32)
    changes = GroundChanges(index, np.array([-0.01, 0.5, -1.0, 1.0], np.float32),
                            np.array([0.0, 0.25, 0.125, 2.0], np.float32))
    ground = HeightGrid(np.arange(81 * 81).reshape(81, 81).astype(np.float32) / 4096.0, 0.03125)
    points = points_of(changes, ground)
    found: dict[str, Any] = {'points': np.array(points.tolist())}

    def cloud(**values: Any) -> Any:
        fields = [SimpleNamespace(name=name, offset=4 * i, datatype=7, count=1)
                  for i, name in enumerate(points.dtype.names)]
        return SimpleNamespace(**{'fields': fields, 'point_step': 20, 'is_bigendian': False,
                                  'height': 1, 'width': 4, 'data': points.tobytes(), **values})

    found['back'] = changes_of(cloud())
    problems = [problem(cloud(**values)) for values in (
        {}, {'height': 2}, {'width': 3}, {'point_step': 24}, {'is_bigendian': True},
        {'fields': []})] + [problem(cloud(), 1.0), problem(cloud(), 1.245), problem(cloud(), 1.2)]
    for name, value in (('x', 0.0025), ('y', 0.00504), ('y', 0.00506), ('x', np.nan),
                        ('z', np.inf), ('height_change', 1.001), ('height_change', -1.0),
                        ('compaction', -1e-5), ('compaction', -5e-7)):
        odd = points.copy()
        odd[name][1] = value
        problems.append(problem(cloud(data=odd.tobytes())))
    found['said'] = problems
    bag_path = synthetic.write(folder / 'bag', synthetic.ground_items(1.0))
    with open_bag(bag_path) as bag:
        for time in (None, 0, 350_000_000, 1_000_000_000, 1_199_999_999):
            made = ground_at(bag, time)
            found[f'at {time}'] = [*made.sums_m(), float(len(made.snapshot()))]
        found['late'] = [said(ground_at, bag, time).replace(str(bag_path), 'BAG')
                         for time in (1_199_999_999, 1_200_000_000)]
    return found


@reference
def validity_of_messages() -> dict[str, Any]:
    """What is wrong with messages, in words."""
    nan = float('nan')
    check = message_validity.FiniteCheck(synthetic.STORE)
    items = {item.topic: item for item in exact_items()}
    odometry = items['odom'].message
    array = dataclasses.replace(odometry.pose, covariance=np.full(36, nan))
    path = msg('nav_msgs/Path', header=header(0, 'odom'), poses=[
        msg('geometry_msgs/PoseStamped', header=header(0, ''), pose=pose_message(k))
        for k in (0, 1)])
    path.poses[1].pose.position.y = float('inf')
    scan = msg('sensor_msgs/LaserScan', header=header(0, ''), angle_min=-1.0, angle_max=1.0,
               angle_increment=0.5, time_increment=0.0, scan_time=0.1, range_min=0.1,
               range_max=9.0, ranges=np.array([1.0, np.inf, 2.0, 3.0, 9.0], np.float32),
               intensities=np.zeros(0, np.float32))
    found: dict[str, Any] = {'finite': [
        check.problem('nav_msgs/msg/Odometry', odometry),
        check.problem('nav_msgs/msg/Odometry', dataclasses.replace(odometry, pose=array)),
        check.problem('nav_msgs/msg/Path', path), check.problem('sensor_msgs/msg/LaserScan', scan),
        check.problem('geometry_msgs/msg/Vector3', vector([0.0, nan, 1.0]))]}
    shots = []
    for encoding, width, step, size, big in (
            ('mono8', 5, 7, 21, False), ('mono16', 3, 6, 18, True), ('mono16', 3, 6, 18, False),
            ('rgb8', 2, 6, 18, False), ('32FC1', 2, 8, 24, False), ('32FC3', 1, 12, 36, False),
            ('mono8', 5, 4, 12, False), ('yuv', 5, 5, 15, False), ('mono8', 5, 5, 14, False),
            ('mono8', 0, 0, 0, False)):
        shot = SimpleNamespace(encoding=encoding, width=width, height=3, step=step,
                               data=np.arange(size).astype(np.uint8), is_bigendian=big)
        text = message_validity.image_problem(shot)
        shots.append({'text': text, 'pixels': None if text else message_validity.pixels(
            shot).astype(float)})
    found['images'] = shots

    def depth(*values: float) -> Any:
        data = np.array(values, np.float32)
        return image(0, '', '32FC1', data.reshape(1, -1))

    found['depths'] = [check_of(depth(*values)) for values in (
        (1.0, np.inf), (nan, 1.0), (0.0, 2.0), (-1.0, nan, nan))
        for check_of in (message_validity.true_depth_problem, message_validity.depth_problem)]
    found['disparities'] = [message_validity.disparity_problem(SimpleNamespace(
        f=f, t=t, image=shot)) for f, t, shot in (
            (1.0, 0.1, depth(1.0, 2.0)), (0.0, 0.1, depth(1.0)), (1.0, 0.0, depth(1.0)),
            (1.0, 0.1, depth(nan)), (1.0, 0.1, image(0, '', 'mono8', np.zeros((2, 2), np.uint8))))]
    turn = message_validity.quaternion_problem('pose.pose.orientation')
    odd = [turn(dataclasses.replace(odometry, pose=dataclasses.replace(
        odometry.pose, pose=dataclasses.replace(odometry.pose.pose, orientation=quaternion(q)))))
        for q in ([1.0 + 2e-6, 0, 0, 0], [1.0 + 5e-7, 0, 0, 0], [0.5, 0.5, 0.5, 0.6])]
    found['turns'] = odd
    found['joints'] = [message_validity.joints_problem(SimpleNamespace(
        name=['a', 'b'], position=[0] * p, velocity=[0] * v, effort=[0] * e))
        for p, v, e in ((2, 2, 0), (2, 2, 2), (1, 2, 0), (2, 3, 0), (2, 2, 1))]
    info = synthetic.camera_info(0, '', 0.25)
    found['cameras'] = [message_validity.camera_info_problem(SimpleNamespace(
        k=k, p=p, width=w, height=h)) for k, p, w, h in (
            (info.k, info.p, 3, 2), (0.0 * info.k, info.p, 3, 2), (info.k, -info.p, 3, 2),
            (info.k, info.p, 0, 2), (info.k, info.p, 3, 0))]
    scans = [scan]
    for values in ({'angle_max': 1.4}, {'angle_increment': 0.0}, {'range_max': 8.0},
                   {'range_max': 8.9992}, {'ranges': np.array([1, nan, 2, 3, 4.0], np.float32)}):
        scans.append(dataclasses.replace(scan, **values))
    found['scans'] = [scan_validity.laser_scan_problem(one) for one in scans]
    return found


@reference
def validity_of_clouds() -> dict[str, Any]:
    """Clouds of a LiDAR: whole, without fields, cut, not finite, with times before 0."""
    kinds = [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('intensity', '<f4'), ('ring', '<u2'),
             ('time', '<f4')]
    points = np.zeros(3, kinds)
    points['x'], points['ring'], points['time'] = [1.0, 2.0, 3.0], [4, 5, 6], [0.0, 0.1, 0.2]
    numbers = {'<f4': 7, '<u2': 4}

    def cloud(data: np.ndarray, **values: Any) -> Any:
        fields = [SimpleNamespace(name=name, offset=data.dtype.fields[name][1],
                                  datatype=numbers[kind]) for name, kind in kinds]
        return SimpleNamespace(**{'fields': fields, 'point_step': data.dtype.itemsize, 'width': 3,
                                  'height': 1, 'row_step': data.nbytes, 'is_dense': True,
                                  'is_bigendian': False,
                                  'data': np.frombuffer(data.tobytes(), np.uint8), **values})

    late, odd = points.copy(), points.copy()
    late['time'][0], odd['y'][1] = -0.1, np.nan
    clouds = [cloud(points), cloud(points, width=2), cloud(points, row_step=3),
              cloud(points, fields=cloud(points).fields[:4]), cloud(late), cloud(odd),
              cloud(odd, is_dense=False)]
    return {'said': [scan_validity.lidar_cloud_problem(one) for one in clouds],
            'points': np.array(scan_validity.lidar_points(clouds[0]).tolist())}


@reference
def offered_qualities() -> dict[str, Any]:
    """QoS as it is recorded, of the contract, of rclpy, of texts."""
    duration = SimpleNamespace(nanoseconds=1_500_000_007)
    found: dict[str, Any] = {'contract': {topic.name: str(contract_qos(topic.name))
                                          for topic in (topics.CLOCK, topics.TF_STATIC,
                                                        topics.SCENARIO, topics.ODOM)},
                             'other': str(contract_qos('/a/x')), 'deep': str(reliable_qos(3)),
                             'latched': str(contract_qos('/ns/' + topics.SCENARIO.name))}
    found['profiles'] = [str(as_recorded(SimpleNamespace(
        history=history, depth=depth, reliability=reliability, durability=durability,
        deadline=duration, lifespan=duration, liveliness=liveliness,
        liveliness_lease_duration=duration, avoid_ros_namespace_conventions=False), 'odom'))
        for history, depth, reliability, durability, liveliness in (
            (1, 7, 1, 2, 1), (2, 5, 2, 1, 1), (3, 4, 0, 0, 0), (1, 0, 1, 1, 3), (99, 1, 77, 5, 9))]
    text = ('- {history: HISTORY, depth: 4, reliability: 1, durability: volatile, deadline: '
            '{sec: 1, nsec: 2}, lifespan: {sec: 3, nsec: 4}, liveliness: automatic, '
            'liveliness_lease_duration: {sec: 5, nsec: 6}, avoid_ros_namespace_conventions: true}')
    found['texts'] = [str(qos_of_text(text.replace('HISTORY', word)))
                      for word in ('keep_last', '2', 'no')]
    found['said'] = [said(qos_of_text, '- {history: 1}'), str(qos_of_text(''))]
    return found


@reference
def cut_bags(folder: Path) -> dict[str, Any]:
    """Marks, checksums, damage, and what is recovered of bags that were cut off."""
    found: dict[str, Any] = {}
    for storage in ('mcap', 'sqlite3'):
        path = synthetic.write(folder / storage, exact_items(), storage=storage)
        file = next(path.glob('*.mcap' if storage == 'mcap' else '*.db3'))
        if storage == 'mcap':
            data = bytearray(file.read_bytes())
            found['whole'] = [has_end(file), damage(file) is None]
            for place in (len(data) // 3, len(data) - 60):
                data[place] ^= 1
                file.write_bytes(data)
                with open(file, 'rb'):
                    found[f'damage {place > len(data) // 2}'] = str(_damage(file))
                data[place] ^= 1
            file.write_bytes(data)
        found[f'counts {storage}'] = file_counts(path)
        cut = folder / f'cut {storage}'
        shutil.copytree(path, cut)
        (cut / 'metadata.yaml').unlink()
        cut_file = cut / file.name
        if storage == 'mcap':
            cut_file.write_bytes(file.read_bytes()[:-700])
            found['end'] = has_end(cut_file)
        found[f'why {storage}'] = why_incomplete(cut)
        mark(cut, 'no\n  light')
        mark_failed(cut, 'other')
        (folder / 'long').mkdir(exist_ok=True)
        (folder / 'long' / 'incomplete.yaml').write_text(f'reason: {"long " * 120}')
        found['long'] = len(why_incomplete(folder / 'long') or '')
        found[f'recovered {storage}'] = recover(cut, folder / f'new {storage}')
        with open_bag(folder / f'new {storage}') as bag:
            found[f'content {storage}'] = {'counts': bag.counts, 'why': bag.incomplete,
                                           'times': [bag.start_ns, bag.end_ns]}
    mark_failed(folder / 'mcap', 'late')
    found['late'] = why_incomplete(folder / 'mcap')
    found['counts'] = [is_count(value) for value in (0, -1, True, 1 << 63, (1 << 63) - 1, 1.0)]
    return found


def _damage(file: Path) -> str:
    try:
        return str(damage(file)).partition(' at byte')[0]
    except LunarRoverSimError as error:
        return str(error).replace(str(file), 'FILE').partition(' at byte')[0]
