"""Record a drive with all nodes, then read the bag. Recording needs ROS 2; reading does not."""

from pathlib import Path
import sys

from lunar_rover_sim import open_bag, record, Scenario
from lunar_rover_sim.bag.series import read_imu, read_odometry


def main(folder: Path) -> None:
    """Record two seconds into a folder that does not exist yet."""
    recording = record(Scenario.load('baseline', seed=3, duration_s=2.0), folder)
    print(f'{recording.bag}: real-time factor {recording.real_time_factor:.2f}')
    with open_bag(recording.bag) as bag:
        path, imu = read_odometry(bag), read_imu(bag)
        for topic, count in sorted(bag.counts.items()):
            print(f'{count:6d} {topic}')
    driven_m = path.positions_m[-1] - path.positions_m[0]
    print(f'moved by {driven_m[0]:.3f}, {driven_m[1]:.3f} m; mean specific force '
          f'{imu.specific_forces_mps2.mean(axis=0).round(2)} m/s^2')


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else 'record_and_read'))
