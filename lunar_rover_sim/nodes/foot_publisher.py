"""How deep the feet stand in the ground, and how they slip over it: topics on request."""

from __future__ import annotations

from rclpy.node import Node
from sensor_msgs.msg import JointState

from lunar_rover_sim import topics
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.physics.foot_motion import SlipMeter
from lunar_rover_sim.physics.simulation import Simulation

_LEGS = list(topics.LEGS)
_SLIP = [*_LEGS, *(f'{leg}_sweep' for leg in topics.LEGS)]


class FootPublisher:
    """Publishes sinkage and slip of each leg while somebody reads them.

    publishers: those of both topics; on rigid ground that of slip only
    """

    def __init__(self, node: Node, simulation: Simulation, period_s: float) -> None:
        self._simulation, self._period_s = simulation, period_s
        self._meter = SlipMeter()
        self._slip = node.create_publisher(JointState, topics.FOOT_SLIP.name,
                                           qos.offered(topics.FOOT_SLIP))
        self.publishers = [self._slip]
        if simulation.ground_contact is not None:
            self.publishers.append(node.create_publisher(
                JointState, topics.SINKAGE.name, qos.offered(topics.SINKAGE)))

    def restart(self) -> None:
        """Begin to count ways again."""
        self._meter = SlipMeter()

    def publish(self, stamp_ns: int) -> None:
        """Publish what is read of the present state."""
        for publisher in self.publishers:
            if publisher.get_subscription_count():
                message = self._slip_message() if publisher is self._slip else self._sinkage()
                message.header.stamp = conversions.time_msg(stamp_ns)
                publisher.publish(message)

    def _slip_message(self) -> JointState:
        motion, meter = self._simulation.foot_motion, self._meter
        meter.add(motion, self._period_s)
        return JointState(name=_SLIP,
                          position=[*meter.slipped_m.tolist(), *meter.swept_m.tolist()],
                          velocity=[*motion.slip_mps.tolist(), *motion.sweep_mps.tolist()])

    def _sinkage(self) -> JointState:
        contact = self._simulation.ground_contact
        return JointState(name=_LEGS,
                          position=[] if contact is None else contact.sinkage_m.tolist())
