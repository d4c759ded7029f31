"""Prints who publishes given topics in a ROS domain, as `TOPIC NODE`, one line each.

    python -m lunar_rover_sim.nodes.domain_probe TOPIC ...

It ends with the first that it finds, or after 4 s of wall time. Where DDS does not let it leave,
it ends by SIGALRM, with all work done.
"""

from __future__ import annotations

import sys
import time

import rclpy

from lunar_rover_sim.nodes.node_main import bound_leaving
from lunar_rover_sim.nodes.reader_discovery import UNKNOWN_NAME

# Usually 0.1 to 0.4 s, at times 3.4 s.
_DISCOVERY_S, _POLL_S = 4.0, 0.1


def main() -> None:
    """Look at the topics that the arguments name."""
    rclpy.init(args=[])
    node = rclpy.create_node('lunar_rover_sim_probe', start_parameter_services=False,
                             enable_rosout=False)
    deadline = time.monotonic() + _DISCOVERY_S
    found = False
    while not found and time.monotonic() < deadline:
        time.sleep(_POLL_S)
        for topic in sys.argv[1:]:
            for info in node.get_publishers_info_by_topic(topic):
                if info.node_name != UNKNOWN_NAME or time.monotonic() > deadline - _POLL_S:
                    print(topic, info.node_name, flush=True)
                    found = True
    bound_leaving()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
