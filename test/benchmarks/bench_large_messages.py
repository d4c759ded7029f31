"""How long large frames take from one process to another in lockstep; run by hand.

    python test/benchmarks/bench_large_messages.py [--sets 5] [--rounds 2]

One node publishes sets of 20 images, 31 MB together, and publishes the next set when the other has
confirmed the whole of the last, as a run with all truth in its bag does. The defaults of Fast DDS
and the packaged profiles take turns.
"""

from __future__ import annotations

import argparse
import array
import collections
import multiprocessing
from multiprocessing.connection import Connection
import os
import time

import rclpy
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import UInt32

from lunar_rover_sim.nodes.node_main import executor
from lunar_rover_sim.run.ros_domain import dds_environment, OwnDomain, ros_environment

_SIZES = 2 * (2_500_000, 3_700_000, 3_700_000, 1_200_000, 1_200_000, 1_200_000, 500_000, 500_000,
              500_000, 500_000)
_QOS = QoSProfile(depth=10)


def _join(name: str, environment: dict[str, str]) -> tuple[Node, Executor]:
    os.environ.clear()
    os.environ.update(environment)
    rclpy.init()
    node, spinner = Node(name), executor()
    spinner.add_node(node)
    return node, spinner


def receive(environment: dict[str, str]) -> None:
    """Confirm every set of which all images have come, until the process is ended."""
    node, spinner = _join('receiver', environment)
    confirmed = node.create_publisher(UInt32, 'confirmed', _QOS)
    came: collections.Counter[int] = collections.Counter()

    def take(raw: bytes) -> None:
        number = deserialize_message(raw, Image).header.stamp.sec
        came[number] += 1
        if came[number] == len(_SIZES):
            confirmed.publish(UInt32(data=number))

    for k in range(len(_SIZES)):
        node.create_subscription(Image, f'image_{k}', take, _QOS, raw=True)
    while True:
        spinner.spin_once(timeout_sec=1.0)


def send(environment: dict[str, str], sets: int, result: Connection) -> None:
    """Publish the sets; send the wall time of each [s], and the CPU time of all."""
    node, spinner = _join('sender', environment)
    publishers = [node.create_publisher(Image, f'image_{k}', _QOS) for k in range(len(_SIZES))]
    confirmed = 0

    def note(msg: UInt32) -> None:
        nonlocal confirmed
        confirmed = msg.data

    node.create_subscription(UInt32, 'confirmed', note, _QOS)
    while not all(p.get_subscription_count() for p in publishers) \
            or not node.count_publishers('confirmed'):
        spinner.spin_once(timeout_sec=0.05)
    images = [Image(data=array.array('B', bytes(size))) for size in _SIZES]
    walls = []
    cpu = time.process_time()
    for number in range(1, sets + 1):
        start = time.perf_counter()
        for publisher, image in zip(publishers, images):
            image.header.stamp.sec = number
            publisher.publish(image)
        while confirmed < number:
            spinner.spin_once(timeout_sec=0.01)
        walls.append(time.perf_counter() - start)
    result.send((walls, time.process_time() - cpu))


def main() -> None:
    """Compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--sets', type=int, default=5)
    parser.add_argument('--rounds', type=int, default=2)
    args = parser.parse_args()
    context = multiprocessing.get_context('spawn')
    print(f'{args.sets} sets of {sum(_SIZES) / 1e6:.0f} MB in {len(_SIZES)} messages')
    with OwnDomain() as own:
        packaged = ros_environment(own.id) | dds_environment()
        defaults = {k: v for k, v in packaged.items() if k not in dds_environment()}
        for _ in range(args.rounds):
            for title, environment in (('defaults of Fast DDS', defaults), ('packaged', packaged)):
                ours, theirs = context.Pipe()
                nodes = [context.Process(target=receive, args=(environment,), daemon=True),
                         context.Process(target=send, args=(environment, args.sets, theirs),
                                         daemon=True)]
                for process in nodes:
                    process.start()
                walls, cpu = ours.recv()
                for process in nodes:
                    process.kill()
                    process.join()
                print(f'{title:22} wall {sum(walls):6.2f} s, slowest set {max(walls):5.2f} s, '
                      f'sender {1e3 * cpu / args.sets:3.0f} ms of CPU a set')


if __name__ == '__main__':
    main()
