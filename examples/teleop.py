"""Drive with the keys w a s d (space stops, q ends) or with a joystick; needs ROS 2.

Beside `lunar_rover_sim run baseline --teleop --domain 7 -o runs/driven`, start it with
ROS_DOMAIN_ID=7. A joystick: `python examples/teleop.py /dev/input/js0`. The page of
`run --view` has a stick that needs no ROS.
"""

from collections.abc import Iterator
import os
import struct
import sys
import termios
import tty

from geometry_msgs.msg import Twist
import rclpy

SPEED_MPS, TURN_RADPS = 0.15, 0.4
KEYS = {'w': (1, 0), 's': (-1, 0), 'a': (0, 1), 'd': (0, -1), ' ': (0, 0)}


def pressed(source: int = 0) -> Iterator[tuple[float, float]]:
    """Yield what each key means, from -1 to 1: ahead, to the left."""
    while (key := os.read(source, 1).decode(errors='replace')) not in ('', 'q'):
        if key in KEYS:
            yield KEYS[key]


def pulled(source: int) -> Iterator[tuple[float, float]]:
    """Yield the same from the events of a Linux joystick (linux/joystick.h)."""
    ahead = left = 0.0
    while len(event := os.read(source, 8)) == 8:
        _, value, kind, number = struct.unpack('IhBB', event)
        if kind & 0x7F == 2 and number in (0, 1):      # an axis
            ahead, left = (ahead, -value / 32767) if number == 0 else (-value / 32767, left)
            yield ahead, left


def main(moves: Iterator[tuple[float, float]]) -> None:
    """Publish a velocity for each move; the rover stops 0.5 s after the last one."""
    rclpy.init()
    publisher = rclpy.create_node('teleop').create_publisher(Twist, 'cmd_vel', 10)
    for ahead, left in moves:
        message = Twist()
        message.linear.x, message.angular.z = SPEED_MPS * ahead, TURN_RADPS * left
        publisher.publish(message)
    rclpy.shutdown()


if __name__ == '__main__':
    if len(sys.argv) > 1:
        main(pulled(os.open(sys.argv[1], os.O_RDONLY)))
    else:
        before = termios.tcgetattr(0) if os.isatty(0) else sys.exit('keys come from a terminal')
        tty.setcbreak(0)        # keys come without Enter
        try:
            main(pressed())
        finally:
            termios.tcsetattr(0, termios.TCSADRAIN, before)
