"""policy_node: a policy in the place of the gait controller, with the same topics.

It answers every joint state, as gait_controller_node does, from joint states, IMU and cmd_vel.
"""

from __future__ import annotations

import collections
import time
from typing import Any

import numpy as np
from sensor_msgs.msg import Imu, JointState

from lunar_rover_sim.autonomy.learning.controller import PolicyController
from lunar_rover_sim.autonomy.learning.senses import Sample
from lunar_rover_sim.bag.messages import time_ns, xyz
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.leg_controller import LegControllerNode
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.controller import LegCommand
from lunar_rover_sim.run.node_config import PolicyNodeConfig

_WATCH_S = 0.05


class PolicyNode(LegControllerNode):
    """Walks by a policy; stands still when its observations stop.

    In real time the legs are told to stop once a state has waited for its IMU, or the node for a
    state, for `observation_timeout_s` of wall time. In lockstep time itself waits.
    """

    needs = (topics.JOINT_STATES.name, topics.IMU_RAW.name)
    fields = ('position', 'velocity', 'effort')

    def __init__(self) -> None:
        super().__init__('policy_node', PolicyNodeConfig)

    def make_controller(self, config: PolicyNodeConfig,
                        rover: RoverDescription) -> PolicyController:
        """Return the controller of the policy."""
        self._policy = PolicyController.load(config.policy, rover)
        card = self._policy.policy.card
        self.get_logger().info(f'policy {self._policy.policy.path}: {card.task} of {card.rover} on'
                               f' {card.ground}')
        for doubt in self._policy.on_ground(config.ground) if config.ground else ():
            self.get_logger().warning(doubt)
        return self._policy

    def prepare(self, config: Any) -> None:
        """Read the IMU, and watch that it and the joint states go on."""
        self._felt: collections.deque[tuple[int, Array, Array]] = collections.deque()
        self._timeout_s = config.observation_timeout_s
        self._answered_s: float | None = None
        self._stands = False
        qos.subscription(self, topics.IMU_RAW, self._imu_callback, config.lockstep)
        if not config.lockstep:
            self.create_timer(_WATCH_S, self._stand_without_observations)

    def next_state(self) -> JointState | None:
        """Return the first state whose IMU has arrived; drop what will have no counterpart."""
        while self.states and self._felt:
            stamp_ns, felt_ns = time_ns(self.states[0].header.stamp), self._felt[0][0]
            if felt_ns == stamp_ns:
                return self.states[0]
            (self._felt if felt_ns < stamp_ns else self.states).popleft()
        return None

    def forget(self) -> None:
        """Drop IMU messages of a time before."""
        self._felt.clear()

    def command_for(self, state: JointState) -> LegCommand:
        """Return the command for a state whose IMU has arrived."""
        stamp_ns, force, rate = self._felt.popleft()
        values = {name: conversions.legs_of(state, self.legs, field) for name, field in
                  (('angle_rad', 'position'), ('speed_radps', 'velocity'),
                   ('torque_nm', 'effort'))}
        self._answered_s, self._stands = time.monotonic(), False
        self._stamp, self._angles = state.header.stamp, values['angle_rad']
        return self._policy.update(Sample(stamp_ns, rate_radps=rate, force_mps2=force, **values))

    def _imu_callback(self, msg: Imu) -> None:
        self._felt.append((time_ns(msg.header.stamp), np.array(xyz(msg.linear_acceleration)),
                           np.array(xyz(msg.angular_velocity))))
        self.work()

    def _stand_without_observations(self) -> None:
        if (self._answered_s is None or self._stands
                or time.monotonic() - self._answered_s < self._timeout_s):
            return
        self._stands = True
        self.get_logger().warning(f'no observation for {self._timeout_s:g} s: standing still')
        self.states.clear()
        legs = len(self.legs.each)
        self.publish(LegCommand(np.zeros(legs), self._angles, np.zeros(legs)), self._stamp)
