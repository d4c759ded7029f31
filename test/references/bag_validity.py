"""Bags: what is valid in a message and in a cloud, and the qualities that are offered."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
from references.bag import exact_items, pose_message
from references.cases import reference
from references.words import said
import synthetic_bag as synthetic
from synthetic_bag import header, image, msg, quaternion, vector

from lunar_rover_sim import topics
from lunar_rover_sim.bag import message_validity, scan_validity
from lunar_rover_sim.bag.qos import as_recorded, contract_qos, qos_of_text, reliable_qos


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
