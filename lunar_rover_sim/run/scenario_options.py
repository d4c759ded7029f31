"""What options of a run change in its scenario: a SLAM program, a policy, goals, a route."""

from __future__ import annotations

from collections.abc import Sequence
import math
from pathlib import Path
from typing import Any

from lunar_rover_sim.autonomy.path_following.route import make_route
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import replaced
from lunar_rover_sim.run.child_process import executable, program_words
from lunar_rover_sim.run.scenario import Scenario

_WAYPOINT_STEP_M = 1.5      # between the waypoints that the navigator gets of a route
_WAY_TIMES = 3.0            # the time that a way may take, over that of the straight one


def with_slam(scenario: Scenario, command: str, maps: Path | None = None,
              near_m: tuple[float, float] | None = None, doubt_m: float = 50.0) -> Scenario:
    """Return the scenario with slam_node among its nodes.

    Args:
        command: The program that it starts, or `graph` for its own.
        maps: With `graph`: folder of maps from orbit, on which it finds its place.
        near_m: Place that the start is near to; None: the start of the scenario, where the rover
            was to be set down.
        doubt_m: Radius around it.

    Raises:
        ConfigError: If the command is empty or no line of a shell, the maps are not for this
            program, or a node drives by its poses.
        ProcessError: If there is no such program.
        WorldError: If the maps cannot be read.
    """
    nodes = tuple(dict.fromkeys((*scenario.run.nodes, 'slam_node')))
    is_graph = command == 'graph'
    if not is_graph:
        executable(program_words(command, '--slam')[0])
    on_maps: dict[str, Any] = {}
    if maps is not None:
        if not is_graph:
            raise ConfigError(f'--orbital: is for --slam graph, and the program is {command}')
        # It takes time to import, which other runs need not wait for.
        from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
        OrbitalMap.load(maps)       # what is wrong with them is said before anything starts
        start = scenario.physics_node.start
        x, y = (start.x_m, start.y_m) if near_m is None else near_m
        on_maps = {'slam_node.maps': str(maps.resolve()), 'slam_node.near_x_m': x,
                   'slam_node.near_y_m': y, 'slam_node.doubt_m': doubt_m,
                   'slam_node.frame_id': scenario.slam_node.truth.frame_id}
    return replaced(scenario, {
        'run.nodes': nodes, 'slam_node.system': 'graph' if is_graph else 'command',
        'slam_node.command': '' if is_graph else command, **on_maps})


def without_node(scenario: Scenario, name: str) -> Scenario:
    """Return the scenario without one of its nodes."""
    return replaced(scenario, {'run.nodes': tuple(n for n in scenario.run.nodes if n != name)})


def with_policy(scenario: Scenario, policy: str) -> Scenario:
    """Return the scenario with policy_node in the place of gait_controller_node.

    Args:
        policy: A file, or the name of a packaged policy.

    Raises:
        LearningError: The policy cannot be read, or is not for the rover of the scenario.
    """
    # It takes a second to import, which other runs need not wait for.
    from lunar_rover_sim.autonomy.learning.controller import PolicyController
    controller = PolicyController.load(policy, scenario.rover)
    nodes = tuple('policy_node' if name == 'gait_controller_node' else name
                  for name in scenario.run.nodes)
    return replaced(scenario, {'run.nodes': nodes,
                               'policy_node.policy': str(controller.policy.path.resolve())})


def with_navigator(scenario: Scenario, goals_m: Sequence[tuple[float, float]]) -> Scenario:
    """Return the scenario with mapping_node, and navigator_node in place of drive_node.

    Args:
        goals_m: Waypoints, the last of which is the goal; none: those of the scenario.

    Raises:
        ConfigError: If there is no goal at all.
    """
    nodes = [name for name in scenario.run.nodes
             if name not in ('drive_node', 'mapping_node', 'navigator_node')]
    values: dict[str, Any] = {'run.nodes': (*nodes, 'mapping_node', 'navigator_node')}
    if goals_m:
        *between, (x, y) = goals_m
        values |= {'navigator_node.has_goal': True, 'navigator_node.goal_x_m': float(x),
                   'navigator_node.goal_y_m': float(y),
                   'navigator_node.waypoints_x_m': tuple(float(p[0]) for p in between),
                   'navigator_node.waypoints_y_m': tuple(float(p[1]) for p in between)}
    scenario = replaced(scenario, values)
    if not scenario.navigator_node.goals:
        raise ConfigError('navigator_node.has_goal: false is not valid here; valid is a goal or '
                          'waypoints')
    return scenario


def with_route(scenario: Scenario, shape: str, avoid: bool) -> Scenario:
    """Return the scenario with a ready-made route from its start on.

    Args:
        shape: One of `drive_node.shape`; its size is `drive_node.shape_size_m`.
        avoid: The navigator drives it, from one waypoint to the next; else drive_node, blindly.
    """
    scenario = replaced(scenario, {
        'drive_node.shape': shape, 'drive_node.relative': False,
        'drive_node.mode': (scenario.drive_node.mode if scenario.drive_node.mode in
                            ('waypoints', 'spline') else 'spline')})
    if not avoid:
        return scenario
    start, drive = scenario.physics_node.start, scenario.drive_node
    route = make_route(drive, (start.x_m, start.y_m), math.radians(start.yaw_deg))
    count = max(2, math.ceil(route.length_m / _WAYPOINT_STEP_M))
    return with_navigator(scenario, [(float(x), float(y)) for x, y in route.at(
        [route.length_m * k / count for k in range(1, count + 1)])])


def navigated_duration_s(scenario: Scenario) -> float:
    """Return a time in which the navigator has arrived, or never will [s]."""
    start, nav = scenario.physics_node.start, scenario.navigator_node
    points = [(start.x_m, start.y_m), *nav.goals]
    way = sum(math.dist(a, b) for a, b in zip(points, points[1:]))
    # A near goal may lie behind a wall.
    return max(300.0, 60.0 + math.ceil(_WAY_TIMES * way / nav.speed_mps))
