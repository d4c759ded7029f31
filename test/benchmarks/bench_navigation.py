"""CPU time and memory of mapping and planning: of the steps, and of mapping_node as a whole.

    python test/benchmarks/bench_navigation.py

The rover drives and swings its view on `baseline`; depth of 640 x 480 px comes from rays, as in
`validate navigation`, and is given to the node in real time, one image when the last is answered.
"""

from __future__ import annotations

import array
from collections.abc import Callable
from pathlib import Path
import statistics
import sys
import time

import cv2
import numpy as np
import psutil

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from nav_msgs.msg import OccupancyGrid, Odometry  # noqa: E402  (needs the path)
from peer import at_rest_odometry, Peer, running  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

from lunar_rover_sim import Scenario  # noqa: E402
from lunar_rover_sim.autonomy.navigation.elevation_map import ElevationMap  # noqa: E402
from lunar_rover_sim.autonomy.navigation.planner import Planner  # noqa: E402
from lunar_rover_sim.autonomy.navigation.traversability import Limits, traversability  # noqa: E402
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, se3, wxyz_from_rpy  # noqa: E402
from lunar_rover_sim.image.stereo.seen_depth import SeenDepth  # noqa: E402
from lunar_rover_sim.judge.evaluation.map_evaluation import TrueSurface  # noqa: E402
from lunar_rover_sim.nodes.conversions import time_msg  # noqa: E402

IMAGES, FIRST = 80, 20      # images, and those that do not count
PERIOD_NS = 200_000_000


def median_ms(step: Callable[[], object], count: int = 20) -> float:
    """Return the median CPU time [ms] of a call; the first one does not count."""
    times = []
    for _ in range(count + 1):
        begin = time.process_time()
        step()
        times.append(time.process_time() - begin)
    return 1e3 * statistics.median(times[1:])


def node(frames: list[tuple[Array, Image]]) -> str:
    """Return CPU time an image and memory of a mapping_node that gets these images."""
    peer = Peer()
    grids = peer.listen(OccupancyGrid, 'map/traversability')
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    images = peer.node.create_publisher(Image, 'stereo/depth/image', 10)
    sent, begin = 0, (0.0, 0)

    def send() -> None:
        nonlocal sent, begin
        if not (poses.get_subscription_count() and images.get_subscription_count()) \
                or sent > len(grids) + 1:
            return
        if sent == FIRST:
            begin = cpu_s(), len(grids)
        T, image = frames[sent]
        odometry = at_rest_odometry()
        pose = odometry.pose.pose
        pose.position.x, pose.position.y, pose.position.z = T[:3, 3].tolist()
        yaw = np.arctan2(T[1, 0], T[0, 0])
        pose.orientation.z, pose.orientation.w = float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
        odometry.header.stamp = image.header.stamp = time_msg(10**9 + sent * PERIOD_NS)
        poses.publish(odometry)
        images.publish(image)
        sent += 1

    with running('mapping_node', '-p', 'camera.width:=640', '-p', 'camera.height:=480') as process:
        def cpu_s() -> float:
            return sum(psutil.Process(process.pid).cpu_times()[:2])

        peer.spin_until(lambda: sent == len(frames), meanwhile=send)
        cpu_ms = 1e3 * (cpu_s() - begin[0]) / (len(grids) - begin[1])
        memory = psutil.Process(process.pid).memory_full_info()
    return (f'{cpu_ms:.1f} ms an image; memory: its own {memory.uss / 2**20:.0f} MiB, with its '
            f'share of libraries {memory.pss / 2**20:.0f} MiB')


def main() -> int:
    """Print one line a step."""
    scenario = Scenario.load('baseline', ['render_node.sun.elevation_deg=6.0'], seed=1)
    world, limits = scenario.load_world(), Limits.of(scenario.rover, scenario.mapping_node.limits)
    eyes = SeenDepth(world, scenario.rover, scenario.render_node.camera, scenario.render_node.sun,
                     1)
    K = eyes.K * [[5.0], [5.0], [1.0]]
    frames, looks = [], []
    for k in range(IMAGES):
        place = np.array([0.024 * k, 0.0])
        height = float(world.ground.height_at(place[None])[0]) + 0.1
        T = se3(matrix_from_wxyz(wxyz_from_rpy(0.0, 0.0, 0.3 * np.sin(0.2 * k))), (*place, height))
        begin = time.process_time()
        depth = eyes.look(T, 5.0)
        looks.append(1e3 * (time.process_time() - begin))
        depth = cv2.resize(depth, (640, 480), interpolation=cv2.INTER_NEAREST)
        image = Image(height=480, width=640, step=2560, encoding='32FC1')
        image.data = array.array('B', depth.astype('<f4').tobytes())
        frames.append((T, image))
    seen = ElevationMap(scenario.mapping_node.map.by_pose('wheels'))
    T = frames[-1][0]
    print(f'a look of the study: {statistics.median(looks):.1f} ms')
    print('a depth image into the map: {:.1f} ms'.format(median_ms(lambda: seen.add_depth(
        0, depth, K, eyes.real_baseline_m / 5.0, T @ eyes.T_base_camera, T[:3, 3]))))
    print(f'costs of that map: '
          f'{median_ms(lambda: traversability(seen.elevation(), limits)):.1f} ms')
    whole = TrueSurface(world).elevation((0.0, 0.0), 12.8, 0.05, samples=1)
    print(f'costs of a whole map: {median_ms(lambda: traversability(whole, limits)):.1f} ms')
    grid, config = traversability(whole, limits), scenario.navigator_node.plan
    print('a plan over it, to the edge: {:.1f} ms'.format(median_ms(
        lambda: Planner(grid, config, limits.radius_m, (0.0, 0.0)).plan((9.0, 3.0)))))
    print(f'mapping_node: {node(frames)}')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
