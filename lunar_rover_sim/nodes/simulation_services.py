"""The services of simulation_interfaces, where that package is installed.

github.com/ros-simulation/simulation_interfaces, versions 1 (Jazzy) and 2. The requests are checked
and answered here; what they ask for is done by physics_node.
"""

from __future__ import annotations

import importlib
import re
from types import ModuleType
from typing import Any, TYPE_CHECKING

import numpy as np

from lunar_rover_sim.base.errors import PhysicsError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.nodes import conversions
from lunar_rover_sim.nodes.node_main import GraphNode
from lunar_rover_sim.nodes.pacing import ServiceThread

if TYPE_CHECKING:
    from lunar_rover_sim.nodes.physics_node import PhysicsNode

ENTITY = 'lunar_rover'      # the name in the URDF
RADIUS_M = 0.3              # of a sphere around base_link that holds the packaged rover
# Jazzy's SetEntityState has no flags: it sets pose and twist.
_FEATURES = ('ENTITY_CATEGORIES', 'ENTITY_STATE_GETTING', 'ENTITY_STATE_SETTING',
             'SIMULATION_RESET', 'SIMULATION_RESET_TIME', 'SIMULATION_RESET_STATE',
             'SIMULATION_STATE_GETTING', 'SIMULATION_STATE_SETTING', 'SIMULATION_STATE_PAUSE',
             'STEP_SIMULATION_SINGLE', 'STEP_SIMULATION_MULTIPLE')


def offer(node: GraphNode, simulator: PhysicsNode) -> ServiceThread | None:
    """Create the services `~/get_simulator_features` etc.; return the thread that is to be closed.

    Without the package it logs one line and returns None.
    """
    try:
        msg = importlib.import_module('simulation_interfaces.msg')
        srv = importlib.import_module('simulation_interfaces.srv')
    except ImportError:
        node.get_logger().info('simulation_interfaces is not installed: its services are not '
                               'offered')
        return None
    services = SimulationServices(simulator, msg, srv)
    for name, kind, callback in (
            ('get_simulator_features', srv.GetSimulatorFeatures, services.features),
            ('get_simulation_state', srv.GetSimulationState, services.get_state),
            ('set_simulation_state', srv.SetSimulationState, services.set_state),
            ('reset_simulation', srv.ResetSimulation, services.reset),
            ('get_entities', srv.GetEntities, services.entities),
            ('get_entity_state', srv.GetEntityState, services.get_entity),
            ('set_entity_state', srv.SetEntityState, services.set_entity)):
        node.create_service(kind, f'~/{name}', callback)
    return ServiceThread(node, srv.StepSimulation, 'step_simulation', services.step)


class SimulationServices:
    """Answers the requests; `msg` and `srv` are the modules of simulation_interfaces."""

    def __init__(self, simulator: PhysicsNode, msg: ModuleType, srv: ModuleType) -> None:
        self._simulator = simulator
        self._msg, self._srv = msg, srv
        self._is_stopped = False

    def features(self, _: Any, response: Any) -> Any:
        """Answer GetSimulatorFeatures."""
        features = self._msg.SimulatorFeatures
        response.features.features = [getattr(features, name) for name in _FEATURES]
        response.features.custom_info = (
            'lunar_rover_sim: one entity, the rover; a step is one period of the state topics; in '
            'lockstep the rover is set and reset while paused only')
        return response

    def get_state(self, _: Any, response: Any) -> Any:
        """Answer GetSimulationState."""
        response.state.state = self._state()
        return self._ok(response)

    def set_state(self, request: Any, response: Any) -> Any:
        """Answer SetSimulationState: play, pause, stop (which resets), quit."""
        states, wanted = self._msg.SimulationState, request.state.state
        if wanted == self._state():
            return self._result(response, self._srv.SetSimulationState.Response
                                .ALREADY_IN_TARGET_STATE, 'this is its state')
        if wanted == states.STATE_QUITTING:
            self._simulator.quit()
        elif wanted in (states.STATE_PLAYING, states.STATE_PAUSED):
            self._is_stopped = False
            self._simulator.pause(wanted == states.STATE_PAUSED)
        elif wanted == states.STATE_STOPPED:
            self._simulator.pause(True)
            self._simulator.restart()
            self._is_stopped = True
        else:
            return self._unsupported(response, f'state {wanted}: physics_node always has a world')
        return self._ok(response)

    def reset(self, request: Any, response: Any) -> Any:
        """Answer ResetSimulation: the rover alone, or with the time."""
        kinds = self._srv.ResetSimulation.Request
        scope = request.scope or kinds.SCOPE_ALL
        if not scope & kinds.SCOPE_STATE:
            return self._unsupported(response, f'scope {scope}: valid are SCOPE_STATE, SCOPE_STATE'
                                     ' with SCOPE_TIME, SCOPE_ALL')
        refusal = self._refusal_in_lockstep()
        if refusal:
            return self._result(response, self._msg.Result.RESULT_INCORRECT_STATE, refusal)
        if scope & kinds.SCOPE_TIME:
            self._simulator.restart()
        else:
            self._simulator.reset()
        return self._ok(response)

    def step(self, request: Any, response: Any) -> Any:
        """Answer StepSimulation. It returns when the steps are made: not for the node's thread."""
        if not self._simulator.is_paused:
            return self._failed(response, 'time runs: pause it first')
        problem = self._simulator.step(request.steps) if request.steps else ''
        self._is_stopped = self._is_stopped and not request.steps
        return self._failed(response, problem) if problem else self._ok(response)

    def entities(self, request: Any, response: Any) -> Any:
        """Answer GetEntities: the rover, if the filters let it through."""
        filters = request.filters
        if filters.tags.tags:
            return self._unsupported(response, 'tags: entities have none')
        try:
            named = not filters.filter or re.search(filters.filter, ENTITY) is not None
        except re.error as error:
            return self._failed(response, f'filter: {filters.filter!r}: {error}')
        robot = self._msg.EntityCategory.CATEGORY_ROBOT
        wanted = not filters.categories or any(c.category == robot for c in filters.categories)
        inside = True
        bounds = self._msg.Bounds
        if filters.bounds.type == bounds.TYPE_SPHERE:
            if len(filters.bounds.points) != 2:
                return self._failed(response, 'bounds: a sphere has two points: its centre, and '
                                    'its radius as x')
            centre, radius = filters.bounds.points
            offset = _xyz(centre) - self._simulator.rover_state().position_m
            inside = bool(np.linalg.norm(offset) <= radius.x + RADIUS_M)
        elif filters.bounds.type != bounds.TYPE_EMPTY:
            return self._unsupported(response, f'bounds of type {filters.bounds.type}: valid are '
                                     'none and a sphere')
        response.entities = [ENTITY] if named and wanted and inside else []
        return self._ok(response)

    def get_entity(self, request: Any, response: Any) -> Any:
        """Answer GetEntityState: true pose and twist, both in axes of the world frame."""
        if request.entity != ENTITY:
            return self._not_found(response, request.entity)
        conversions.fill_entity_state(response.state, self._simulator.rover_state(),
                                      conversions.time_msg(self._simulator.now_ns),
                                      self._simulator.world_frame)
        return self._ok(response)

    def set_entity(self, request: Any, response: Any) -> Any:
        """Answer SetEntityState; accelerations are ignored, as the interface allows."""
        if request.entity != ENTITY:
            return self._not_found(response, request.entity)
        refusal = self._refusal_in_lockstep()
        if refusal:
            return self._result(response, self._msg.Result.RESULT_INCORRECT_STATE, refusal)
        state = request.state
        if state.header.frame_id not in ('', 'world', self._simulator.world_frame):
            return self._failed(response, f'frame {state.header.frame_id!r}: valid is '
                                f'{self._simulator.world_frame!r} or none')
        pose: tuple[Array | None, Array | None] = (None, None)
        twist: tuple[Array | None, Array | None] = (None, None)
        if getattr(request, 'set_pose', True):
            q = state.pose.orientation
            pose = _xyz(state.pose.position), np.array([q.w, q.x, q.y, q.z])
        if getattr(request, 'set_twist', True):
            twist = _xyz(state.twist.linear), _xyz(state.twist.angular)
        if pose[0] is None and twist[0] is None:
            return self._result(response, self._msg.Result.RESULT_OK,
                                'nothing is set: set_pose and set_twist are false')
        try:
            self._simulator.move(*pose, *twist)
        except PhysicsError as error:
            return self._result(response, self._srv.SetEntityState.Response.INVALID_POSE,
                                str(error))
        return self._ok(response)

    def _state(self) -> int:
        states = self._msg.SimulationState
        if not self._simulator.is_paused:
            self._is_stopped = False
            return states.STATE_PLAYING
        return states.STATE_STOPPED if self._is_stopped else states.STATE_PAUSED

    def _refusal_in_lockstep(self) -> str:
        """Return why the rover cannot be touched now; '' if it can."""
        if self._simulator.is_lockstep and not self._simulator.is_paused:
            return ('in lockstep the result would depend on when the request arrives: pause time '
                    'first')
        return ''

    def _result(self, response: Any, code: int, message: str = '') -> Any:
        response.result.result, response.result.error_message = code, message
        return response

    def _ok(self, response: Any) -> Any:
        return self._result(response, self._msg.Result.RESULT_OK)

    def _failed(self, response: Any, message: str) -> Any:
        return self._result(response, self._msg.Result.RESULT_OPERATION_FAILED, message)

    def _unsupported(self, response: Any, message: str) -> Any:
        return self._result(response, self._msg.Result.RESULT_FEATURE_UNSUPPORTED, message)

    def _not_found(self, response: Any, entity: str) -> Any:
        return self._result(response, self._msg.Result.RESULT_NOT_FOUND,
                            f'{entity}: no such entity; valid is {ENTITY}')


def _xyz(vector: Any) -> Array:
    return np.array([vector.x, vector.y, vector.z])
