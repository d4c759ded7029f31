"""The true slip and sinkage of the feet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TYPE_CHECKING

from lunar_rover_sim.base import topics
from lunar_rover_sim.sensors.sensor import Content, JointValues, numbers, Platform, Sensor

if TYPE_CHECKING:
    from lunar_rover_sim.rover.physics.state import RoverState

_FEET = Content('feet', 'slip or sinkage of the feet')


class _Feet(Sensor):
    """A value per foot."""

    content = _FEET

    @classmethod
    def read(cls, topic: str, message: Any) -> dict[str, Any]:
        """Return the values of a sensor_msgs/JointState."""
        return {'names': list(message.name), 'position': numbers(message.position),
                'velocity': numbers(message.velocity)}


class FootSlip(_Feet):
    """Slip and sweep of each foot (`physics.foot_motion`), and their sums since it is read."""

    name = 'foot_slip'
    published = (topics.FOOT_SLIP,)

    def __init__(self, config: None, platform: Platform) -> None:
        super().__init__(config, platform)
        legs = platform.rover.legs.names
        self._names = (*legs, *(f'{leg}_sweep' for leg in legs))
        self.restart()

    def restart(self) -> None:
        """Begin to count ways again."""
        from lunar_rover_sim.rover.physics.foot_motion import SlipMeter
        self._meter = SlipMeter(len(self.platform.rover.legs.each))

    def measure(self, state: RoverState, stamp_ns: int) -> Mapping[str, JointValues]:
        """Return ways [m] as positions and speeds [m/s] as velocities."""
        motion, meter = self.platform.simulation.foot_motion, self._meter
        meter.add(motion, self.platform.state_period_s)
        return {topics.FOOT_SLIP.name: JointValues(
            self._names, (*meter.slipped_m.tolist(), *meter.swept_m.tolist()),
            (*motion.slip_mps.tolist(), *motion.sweep_mps.tolist()))}


class Sinkage(_Feet):
    """How deep each leg stands in ground that gives."""

    name = 'sinkage'
    published = (topics.SINKAGE,)

    def measure(self, state: RoverState, stamp_ns: int) -> Mapping[str, JointValues]:
        """Return depths [m]; nothing on rigid ground."""
        contact = self.platform.simulation.ground_contact
        if contact is None:
            return {}
        return {topics.SINKAGE.name: JointValues(
            self.platform.rover.legs.names, contact.sinkage_m.tolist())}
