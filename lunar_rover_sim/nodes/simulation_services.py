"""The services of simulation_interfaces, where that package is installed.

github.com/ros-simulation/simulation_interfaces, versions 1 (Jazzy) and 2. The requests are checked
and answered here; what they ask for is done by physics_node. Services of the package that make no
sense for one rover on given ground answer RESULT_FEATURE_UNSUPPORTED, so that nobody waits.
"""

from __future__ import annotations

from collections.abc import Callable
import importlib
import itertools
from pathlib import Path
import re
from types import ModuleType
from typing import Any, TYPE_CHECKING

from geometry_msgs.msg import Vector3
import numpy as np
from rclpy.node import Node

from lunar_rover_sim.base.errors import PhysicsError
from lunar_rover_sim.base.frames import Array, rotated
from lunar_rover_sim.nodes import conversions
from lunar_rover_sim.nodes.node_main import GraphNode
from lunar_rover_sim.nodes.pacing import ServiceThread
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import bounds_m

if TYPE_CHECKING:
    from lunar_rover_sim.nodes.physics_node import PhysicsNode

ENTITY = 'lunar_rover'      # the name in the URDF
# Those that version 1 does not know are left out there. Jazzy's SetEntityState has no flags: it
# sets pose and twist.
_FEATURES = ('ENTITY_BOUNDS', 'ENTITY_BOUNDS_BOX', 'ENTITY_CATEGORIES', 'ENTITY_STATE_GETTING',
             'ENTITY_STATE_SETTING', 'ENTITY_INFO_GETTING', 'SIMULATION_RESET',
             'SIMULATION_RESET_TIME', 'SIMULATION_RESET_STATE', 'SIMULATION_STATE_GETTING',
             'SIMULATION_STATE_SETTING', 'SIMULATION_STATE_PAUSE', 'STEP_SIMULATION_SINGLE',
             'STEP_SIMULATION_MULTIPLE', 'STEP_SIMULATION_ACTION', 'WORLD_INFO_GETTING')


def offer(node: GraphNode, simulator: PhysicsNode, rover: RoverDescription,
          world: str) -> ServiceThread | None:
    """Create the services `~/get_simulator_features` etc.; return the thread that is to be closed.

    Without the package it logs one line and returns None.

    Args:
        world: Folder of the terrain.
    """
    try:
        msg = importlib.import_module('simulation_interfaces.msg')
        srv = importlib.import_module('simulation_interfaces.srv')
    except ImportError:
        node.get_logger().info('simulation_interfaces is not installed: its services are not '
                               'offered')
        return None
    services = SimulationServices(simulator, msg, srv, rover, world)
    for kind, callback in services.callbacks().items():
        node.create_service(getattr(srv, kind), f'~/{topic_of(kind)}', callback)

    def offer_steps(own: Node, resolved: Callable[[str], str]) -> None:
        own.create_service(srv.StepSimulation, resolved('step_simulation'), services.step)
        kind = importlib.import_module('simulation_interfaces.action').SimulateSteps
        importlib.import_module('rclpy.action').ActionServer(
            own, kind, resolved('simulate_steps'),
            lambda handle: services.simulate(handle, kind))

    return ServiceThread(node, 'step_simulation', offer_steps)


def topic_of(kind: str) -> str:
    """Return the name of a service by that of its type: `get_entity_state`."""
    return re.sub('(?<!^)(?=[A-Z])', '_', kind).lower()


class SimulationServices:
    """Answers the requests; `msg` and `srv` are the modules of simulation_interfaces."""

    def __init__(self, simulator: PhysicsNode, msg: ModuleType, srv: ModuleType,
                 rover: RoverDescription, world: str) -> None:
        self._simulator = simulator
        self._msg, self._srv = msg, srv
        self._bounds_m = bounds_m(rover)
        self._world = world
        self._is_stopped = False

    def callbacks(self) -> dict[str, Callable[[Any, Any], Any]]:
        """Return type → callback of all services of the package but StepSimulation."""
        done = {'GetSimulatorFeatures': self.features, 'GetSimulationState': self.get_state,
                'SetSimulationState': self.set_state, 'ResetSimulation': self.reset,
                'GetEntities': self.entities, 'GetEntitiesStates': self.entities_states,
                'GetEntityState': self.get_entity, 'SetEntityState': self.set_entity,
                'GetEntityInfo': self.entity_info, 'GetEntityBounds': self.entity_bounds,
                'GetCurrentWorld': self.current_world}
        kinds = [name for name in vars(self._srv) if re.fullmatch('([A-Z][a-z]+)+', name)]
        return {name: done.get(name, self._refuse(name)) for name in kinds
                if name != 'StepSimulation'}

    def features(self, _: Any, response: Any) -> Any:
        """Answer GetSimulatorFeatures."""
        features = self._msg.SimulatorFeatures
        response.features.features = [getattr(features, name) for name in _FEATURES
                                      if hasattr(features, name)]
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
        if refusal is not None:
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
        problem = self._simulator.step(request.steps) if request.steps else None
        self._is_stopped = self._is_stopped and not request.steps
        return self._ok(response) if problem is None else self._failed(response, problem)

    def simulate(self, handle: Any, kind: Any) -> Any:
        """Do SimulateSteps, of type `kind`: like `step`, and tell after each step."""
        result, count = kind.Result(), handle.request.steps
        problem = None if self._simulator.is_paused else 'time runs: pause it first'
        for done in range(1, count + 1):
            problem = self._simulator.step(1) if problem is None else problem
            if problem is not None:
                break
            self._is_stopped = False
            handle.publish_feedback(kind.Feedback(completed_steps=done,
                                                  remaining_steps=count - done))
        if problem is not None:
            handle.abort()
            return self._failed(result, problem)
        handle.succeed()
        return self._ok(result)

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
        bounds, points = self._msg.Bounds, [_xyz(point) for point in filters.bounds.points]
        kind, inside = filters.bounds.type, True
        if kind not in (bounds.TYPE_EMPTY, bounds.TYPE_SPHERE, bounds.TYPE_BOX):
            return self._unsupported(response, f'bounds of type {kind}: valid are none, a sphere '
                                     'and a box')
        if kind != bounds.TYPE_EMPTY:
            if len(points) != 2:
                return self._failed(response, f'bounds: {len(points)} points; valid are two: of a '
                                    'sphere its centre, and its radius as x, of a box two corners')
            low, high = self._extent_m()
            if kind == bounds.TYPE_SPHERE:
                nearest = np.clip(points[0], low, high)
                inside = bool(np.linalg.norm(nearest - points[0]) <= points[1][0])
            else:
                inside = bool((np.minimum(*points) <= high).all()
                              and (np.maximum(*points) >= low).all())
        response.entities = [ENTITY] if named and wanted and inside else []
        return self._ok(response)

    def entities_states(self, request: Any, response: Any) -> Any:
        """Answer GetEntitiesStates: as GetEntities, with the states."""
        self.entities(request, response)
        response.states = [self._entity_state() for _ in response.entities]
        return response

    def get_entity(self, request: Any, response: Any) -> Any:
        """Answer GetEntityState: true pose and twist, both in axes of the world frame."""
        if request.entity != ENTITY:
            return self._not_found(response, request.entity)
        response.state = self._entity_state()
        return self._ok(response)

    def entity_info(self, request: Any, response: Any) -> Any:
        """Answer GetEntityInfo."""
        if request.entity != ENTITY:
            return self._not_found(response, request.entity)
        response.info.category.category = self._msg.EntityCategory.CATEGORY_ROBOT
        response.info.description = 'a rover on legs of spokes; poses are those of base_link'
        return self._ok(response)

    def entity_bounds(self, request: Any, response: Any) -> Any:
        """Answer GetEntityBounds: a box in axes of base_link, upper corner first."""
        if request.entity != ENTITY:
            return self._not_found(response, request.entity)
        response.bounds.type = self._msg.Bounds.TYPE_BOX
        response.bounds.points = [Vector3(x=x, y=y, z=z) for x, y, z in
                                  (corner.tolist() for corner in reversed(self._bounds_m))]
        return self._ok(response)

    def current_world(self, _: Any, response: Any) -> Any:
        """Answer GetCurrentWorld: the folder of the terrain."""
        folder, world = Path(self._world).resolve(), response.world
        world.name = folder.name
        # Version 2.0 calls it the resource of a level.
        resource = getattr(world, 'world_resource', None) or world.level_resource
        resource.uri = folder.as_uri()
        return self._ok(response)

    def set_entity(self, request: Any, response: Any) -> Any:
        """Answer SetEntityState; accelerations are ignored, as the interface allows."""
        if request.entity != ENTITY:
            return self._not_found(response, request.entity)
        refusal = self._refusal_in_lockstep()
        if refusal is not None:
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

    def _refuse(self, kind: str) -> Callable[[Any, Any], Any]:
        return lambda _, response: self._unsupported(
            response, f'{topic_of(kind)}: is not offered: one rover on ground that is given at '
            'the start; get_simulator_features lists what is')

    def _entity_state(self) -> Any:
        state = self._msg.EntityState()
        conversions.fill_entity_state(state, self._simulator.rover_state(),
                                      conversions.time_msg(self._simulator.now_ns),
                                      self._simulator.world_frame)
        return state

    def _extent_m(self) -> Array:
        """Return (2, 3) the corners of a box in axes of the world that holds the rover."""
        T = self._simulator.rover_state().T_world_base
        corners = rotated(T[:3, :3], np.array(list(itertools.product(*zip(*self._bounds_m)))))
        corners += T[:3, 3]
        return np.array([corners.min(axis=0), corners.max(axis=0)])

    def _state(self) -> int:
        states = self._msg.SimulationState
        if not self._simulator.is_paused:
            self._is_stopped = False
            return states.STATE_PLAYING
        return states.STATE_STOPPED if self._is_stopped else states.STATE_PAUSED

    def _refusal_in_lockstep(self) -> str | None:
        """Return why the rover cannot be touched now; None if it can."""
        if self._simulator.is_lockstep and not self._simulator.is_paused:
            return ('in lockstep the result would depend on when the request arrives: pause time '
                    'first')
        return None

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
