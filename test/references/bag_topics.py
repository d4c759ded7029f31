"""Bags: types that come along, poses, hazard cameras, trajectories and images of bags."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from references.bag import exact_items, pose_message
from references.cases import reference
from references.words import said
from rosbags.typesys import get_typestore, Stores
import synthetic_bag as synthetic
from synthetic_bag import header, image, Item, msg, quaternion, vector

from lunar_rover_sim import topics
from lunar_rover_sim.bag import messages
from lunar_rover_sim.bag.definitions import learn
from lunar_rover_sim.bag.hazard_topics import hazard_topics
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.errors import BagError
from lunar_rover_sim.evaluation.image_layouts import open_images
from lunar_rover_sim.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.evaluation.trajectory_sources import (bag_of, image_stamps_ns, load, split,
                                                           trajectory_of_topic)


@reference
def other_types() -> dict[str, Any]:
    """Definitions that are learned, and those that cannot be."""
    store = get_typestore(Stores.ROS2_JAZZY)
    texts = ('std_msgs/Header header\nOther[] parts\n' + 80 * '=' + '\nMSG: my/Other\nfloat64 x',
             'Missing part', 'float64', 'int32 MORE=3\nint32 y')
    found = [said(learn, store, f'my/msg/T{k}', text) for k, text in enumerate(texts)]
    return {'said': found, 'known': sorted(name for name in store.fielddefs if 'my/' in name)}


@reference
def numbers_of_messages() -> dict[str, Any]:
    """Poses, transforms and rows of messages; the order of joints."""
    transform = msg('geometry_msgs/TransformStamped', header=header(5, 'a'), child_frame_id='b',
                    transform=msg('geometry_msgs/Transform', translation=vector([1.0, 2.0, 3.0]),
                                  rotation=quaternion([0.5, 0.5, -0.5, 0.5])))
    odometry = SimpleNamespace(pose=SimpleNamespace(pose=pose_message(3)))
    names = [f'{leg}_joint' for leg in topics.LEGS]
    joints = SimpleNamespace(name=[names[2], 'x', names[0], names[3], names[1]])
    return {'transform': messages.transform_matrix(transform),
            'pose': messages.pose_matrix(odometry), 'stamp': messages.header_ns(transform),
            'order': messages.joint_order(joints, 'a bag', BagError),
            'missing': said(messages.joint_order, SimpleNamespace(name=names[1:]), 'a bag',
                            BagError)}


def _poses(count: int, kind: str) -> list[Item]:
    found = []
    stamped = []
    for k in range(count):
        ns = 1_000_000_000 + 50_000_000 * k
        pose = msg('geometry_msgs/Pose', position=msg(
            'geometry_msgs/Point', x=0.25 * k, y=0.5 * ((k * k) % 7), z=0.125 * (k % 3)),
            orientation=quaternion([1.0, 0.0, 0.0, 0.0]))
        one = msg('geometry_msgs/PoseStamped', header=header(ns, 'map'), pose=pose)
        stamped.append(one)
        if kind == 'Path':
            one = msg('nav_msgs/Path', header=header(ns, 'map'), poses=list(stamped))
        elif kind == 'PoseWithCovarianceStamped':
            one = msg(f'geometry_msgs/{kind}', header=header(ns, 'map'), pose=msg(
                'geometry_msgs/PoseWithCovariance', pose=pose, covariance=np.zeros(36)))
        elif kind == 'TransformStamped':
            one = msg(f'geometry_msgs/{kind}', header=header(ns, 'map'), child_frame_id='b',
                      transform=msg('geometry_msgs/Transform', translation=vector(
                          [pose.position.x, pose.position.y, pose.position.z]),
                          rotation=pose.orientation))
        package = 'nav_msgs' if kind == 'Path' else 'geometry_msgs'
        found.append(Item('estimate', f'{package}/msg/{kind}', one))
    return found


@reference
def trajectories_of_bags(folder: Path) -> dict[str, Any]:
    """Poses of each type, errors of an estimate in a bag, images and their truth."""
    found: dict[str, Any] = {}
    for kind in ('PoseStamped', 'PoseWithCovarianceStamped', 'TransformStamped', 'Path'):
        path = synthetic.write(folder / kind, _poses(9, kind))
        made = load(f'{path}:estimate')
        found[kind] = {'positions': made.positions_m, 'stamps': [int(t) for t in made.stamps_ns]}
    drive = synthetic.write(folder / 'drive', synthetic.drive(0.6, 50, 10))
    with open_bag(drive) as bag:
        truth = trajectory_of_topic(bag)
        found['said'] = said(trajectory_of_topic, bag, 'clock', without=folder)
    stamps = image_stamps_ns(drive)
    found['drive'] = {
        'positions': truth.positions_m, 'stamps': stamps, 'file': image_stamps_ns('a.txt') is None,
        'bags': [bag_of(source) is None for source in (truth, str(drive), 'a.txt')],
        'split': [str(split(text)[1]) for text in (
            'a:b', str(drive), 'c:/d:e', ':f', 'g')],
        'evaluated': evaluate(drive, truth, estimate_frame='imu', align='none',
                              distance_m=0.03, time_s=0.2).to_mapping()['ate_m']}
    images = open_images(folder / 'drive')
    found['images'] = {'layout': f'{images.layout} {images.total}', 'pairs': [
        [pair.left, pair.right, pair.truth_px] for pair in images.read(2)]}
    return found


@reference
def hazard_cameras(folder: Path) -> dict[str, Any]:
    """Topics of hazard cameras, of one and of a pair; writers that refuse."""
    items = exact_items()[:3]        # whose names show the namespace
    for name in ('rear', 'front/left', 'front/right'):
        topic = topics.hazard(name)[0]
        items.append(Item(topic.name, topic.type, image(7, 'f', 'mono8',
                                                        np.ones((2, 3), np.uint8))))
    path = synthetic.write(folder / 'bag', items, '/rover')
    with open_bag(path) as bag:
        found: dict[str, Any] = {camera: [f'{topic.name} {name}' for topic, name in named.items()]
                                 for camera, named in hazard_topics(bag).items()}
        found['size'] = bag.size_bytes > 1000
    with BagWriter(folder / 'new') as writer:
        writer.add_topic('a', 'std_msgs/msg/String')
        found['said'] = [said(writer.add_topic, 'a', 'std_msgs/msg/Header'),
                         said(writer.add_topic, 'b', 'my/msg/T'),
                         said(writer.add_topic, 'b', 'my/msg/T', None, 'Missing x')]
        raw = synthetic.serialise(items[0])
        kind = 'sensor_msgs/msg/Image'
        found['times'] = [writer.write('c', kind, raw, 5), writer.write('c', kind, raw, 9, 3),
                          writer.write('c', kind, raw, 9, 7), writer.newest_ns]
        found['clock'] = sorted(writer.of_another_clock)
    found['after'] = said(writer.write_at, 'c', 1, raw, without=folder)
    found['refused'] = [said(BagWriter, folder / 'x', *options) for options in (
        ('tape',), ('mcap', 'gzip'))] + [said(BagWriter, folder / 'new', without=folder)]
    return found
