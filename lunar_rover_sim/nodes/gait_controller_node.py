"""gait_controller_node: cmd_vel to leg phases to joint commands."""

from __future__ import annotations

from typing import Any

from sensor_msgs.msg import JointState

from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.nodes import conversions
from lunar_rover_sim.nodes.leg_controller import LegControllerNode
from lunar_rover_sim.nodes.parameters import on_change
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.calibration import differences, GaitCalibration, rover_conditions
from lunar_rover_sim.rover.gait.controller import GaitController, LegCommand
from lunar_rover_sim.run.node_config import GaitNodeConfig


class GaitControllerNode(LegControllerNode):
    """Commands the legs by their phases: the gait controller as a node."""

    def __init__(self) -> None:
        super().__init__('gait_controller_node', GaitNodeConfig)

    def make_controller(self, config: GaitNodeConfig, rover: RoverDescription) -> GaitController:
        """Return the gait controller of the rover."""
        self._own = config = config.for_rover(rover)
        calibration = GaitCalibration.of(config, rover=rover.name)
        for difference in differences(calibration.conditions, rover_conditions(rover)):
            self.get_logger().warning(f'calibration: measured with {difference}')
        self._gait = GaitController(config, calibration, rover.legs)
        return self._gait

    def prepare(self, config: Any) -> None:
        """Let parameters of the gait change."""
        on_change(self, self._own, self._gait.configure)

    def state(self) -> dict[str, Any]:
        """See `GraphNode`."""
        return {'gait': self._gait.state()}

    def resume(self, time_ns: int, state: Any) -> None:
        """See `GraphNode`."""
        super().resume(time_ns, state)
        self._gait.resume(state['gait'])

    def command_for(self, state: JointState) -> LegCommand:
        """Return the command for a state."""
        return self._gait.update(
            time_ns(state.header.stamp), conversions.legs_of(state, self.legs, 'position'),
            conversions.legs_of(state, self.legs, 'velocity'))
