"""What is checked of a scenario before its world is built."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib

from lunar_rover_sim.autonomy.navigation.config import SLAM
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.run.node_config import DEPTH_TOPICS
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.scenario_options import with_policy


def check_places(scenario: Scenario) -> None:
    """Raise ConfigError if the start, or a goal of the navigator, lies beyond the site."""
    start = scenario.physics_node.start
    places = [('physics_node.start', (start.x_m, start.y_m))]
    if 'navigator_node' in scenario.run.nodes:
        places += [('goal', goal) for goal in scenario.navigator_node.goals]
    half_m = max(0.5 * scenario.world.size_m, 500.0 * scenario.world.site_km)
    for name, place in places:
        if max(map(abs, place)) > half_m:
            raise ConfigError(f'{name}: x {place[0]:g} m, y {place[1]:g} m is beyond the site; '
                              f'valid are -{half_m:g} to {half_m:g} m, see world.site_km')


def check_scenario(scenario: Scenario) -> None:
    """Check what needs no world: depth that is mapped, pose, policy, gait and physics.

    A program of the user may give depth and pose: time waits for it, or its topic is a
    participant's. Where physics runs elsewhere, so may the others.

    Raises:
        ConfigError: If nobody gives depth or pose, gait or start are for another number of legs,
            or steps are too long for the contacts.
        LearningError: If there is no such policy, or it is not for the rover.
        PhysicsError: If the rover cannot be simulated.
    """
    nodes, depth = scenario.run.nodes, scenario.mapping_node.depth
    given = {*scenario.physics_node.wait.topics, *scenario.shared.participants}
    needs = {'mapping_node.depth': (depth, DEPTH_TOPICS[depth], '')}
    needs |= {f'{name}.pose': (SLAM, topics.SLAM_POSE, ' (--slam)')
              for name in ('mapping_node', 'navigator_node')
              if getattr(scenario, name).pose == SLAM}
    for name, (value, topic, option) in needs.items():
        if ({'physics_node', name.partition('.')[0]} <= set(nodes) and topic.node not in nodes
                and topic.name not in given):
            raise ConfigError(f'{name}: {value!r} is not valid without {topic.node} in run.nodes'
                              f'{option}, or {topic.name} in physics_node.wait.topics')
    if 'policy_node' in nodes:
        with_policy(scenario, scenario.policy_node.policy)
    if 'gait_controller_node' in nodes:
        with _parameters_of('gait_controller_node'):
            scenario.gait_controller_node.for_rover(scenario.rover)
    if 'physics_node' in nodes:
        # MuJoCo takes 0.1 s to import, and the rest of this module does not need it.
        from lunar_rover_sim.rover.physics.model import check_contacts
        from lunar_rover_sim.rover.physics.placing import check_joint_angles
        with _parameters_of('physics_node'):
            check_joint_angles(scenario.physics_node.start, scenario.rover)
            check_contacts(scenario.rover, scenario.physics_node)


@contextlib.contextmanager
def _parameters_of(node: str) -> Iterator[None]:
    """Name the node in errors of its parameters."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f'{node}.{error}') from None
