"""A whole run in lockstep whose camera goes blind on the way: the rover stands."""

from pathlib import Path
from typing import Any

from conftest import PLAIN, RIGID, SMALL, TINY
import numpy as np
import pytest

from lunar_rover_sim.bag.messages import header_ns, pose_matrix
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.run.recording import record
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.scenario_options import with_navigator

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from rcl_interfaces.srv import SetParameters  # noqa: E402  (needs rclpy)
from rclpy.parameter import Parameter  # noqa: E402

NS_PER_S = 10**9
# Flat ground with its texture; what is matched is matched by the brightness of grains.
FLAT = 'world.craters.density=0', 'world.rocks.abundance=0', 'navigator_node.start_delay_s=0'
DRIVEN_M, AFTER_NS = 0.15, 4 * NS_PER_S


@pytest.fixture(name='domain')
def _domain(open_domain: int) -> int:
    """Return the domain of the run, in which the peer is, too."""
    return open_domain


def test_a_rover_whose_camera_sees_nothing_stands(peer: Any, domain: int, tmp_path: Path) -> None:
    """On its way the exposure becomes a nanosecond, so that images hold noise alone; 4 s more."""
    scenario = with_navigator(
        Scenario.load('baseline', [*SMALL, *TINY, *PLAIN, *RIGID, *FLAT], duration_s=60.0),
        [(4.0, 0.0)])
    black = [Parameter('sensor.exposure_mode', value='fixed'),
             Parameter('sensor.exposure_s', value=1e-9)]
    now_ns, blind_ns = 0, 0

    def on_progress(time_ns: int) -> None:
        nonlocal now_ns
        now_ns = time_ns

    def go_blind(driven_m: float, _left_m: float) -> None:
        nonlocal blind_ns
        if driven_m > DRIVEN_M and not blind_ns:
            answer = peer.call(SetParameters, 'render_node/set_parameters', SetParameters.Request(
                parameters=[parameter.to_parameter_msg() for parameter in black]))
            assert all(result.successful for result in answer.results)
            blind_ns = now_ns

    result = record(scenario, tmp_path / 'run', domain=domain, on_progress=on_progress,
                    on_way=go_blind,
                    should_stop=lambda: bool(blind_ns) and now_ns > blind_ns + AFTER_NS)
    with open_bag(result.bag) as bag:
        bright = [header_ns(message) for _, _, message in bag.messages(['/stereo/left/image_raw'])
                  if np.asarray(message.data).mean() > 20.0]
        commands = {ns: message.twist for _, ns, message in bag.messages(['/cmd_vel'])}
        places = {ns: pose_matrix(message)[:2, 3] for _, ns, message in bag.messages(['/odom'])}
    assert blind_ns, 'it has not driven'
    last_ns = bright[-1]
    assert last_ns + 2.5 * NS_PER_S < max(commands)
    # It has been on its way, and what it knew of the ground ahead holds for `map_age_s`.
    assert commands[last_ns].linear.x > 0.05
    age_ns = round((scenario.navigator_node.map_age_s + 0.5) * NS_PER_S)
    assert not any(twist.linear.x for ns, twist in commands.items() if ns > last_ns + age_ns)
    # It may look around for depth, on the spot.
    stood = [place for ns, place in places.items() if ns > last_ns + age_ns + NS_PER_S // 2]
    assert np.ptp(stood, axis=0).max() < 0.05
