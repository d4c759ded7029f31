"""Topics that are to be recorded although nobody in a run publishes them."""

from __future__ import annotations

import difflib

from lunar_rover_sim import topics
from lunar_rover_sim.bag.config import ALL
from lunar_rover_sim.camera.hazard import sides
from lunar_rover_sim.run.scenario import Scenario

_BY_NAME = {topic.name: topic for topic in topics.CONTRACT}
_SENSORS = 'lidar_node', 'render_node'
_ALIKE = 0.85        # least similarity of names for a hint, from 0 to 1
_OF_CHASE = topics.CHASE_IMAGE, topics.CHASE_INFO, topics.CHASE_POSE


def silent_topics(scenario: Scenario) -> list[str]:
    """Return a line on each topic in `recorder_node.topics` that nobody will publish, with why.

    A name outside the contract may be that of a user's own node; it is listed only if it
    resembles a name of the contract.
    """
    return [f'{name}: {reason}' for name in scenario.recorder_node.topics
            if name != ALL and (reason := _reason(scenario, name.lstrip('/')))]


def _reason(scenario: Scenario, name: str) -> str:
    """Return why nobody publishes a topic; '' where somebody does or may."""
    found = topics.of_hazard(name)
    topic = _BY_NAME.get(name) if found is None else found[0]
    if topic is None:
        near = difflib.get_close_matches(name, list(_BY_NAME), n=1, cutoff=_ALIKE)
        return f'no topic of this package; did you mean {near[0]}?' if near else ''
    # What is not on request may come from a program of the user instead.
    if topic.on_request and topic.node in _SENSORS and topic.node not in scenario.run.nodes:
        return f'run.nodes lacks {topic.node}'
    render, ground = scenario.render_node, scenario.physics_node.ground
    if topic in _OF_CHASE and not render.chase.enabled:
        return 'render_node.chase.enabled is false'
    if topic in topics.OF_SOFT_GROUND and not ground.deforms:
        return f'physics_node.ground.model is {ground.model}'
    cameras = [camera for key, hazard in render.hazard.items() for camera in sides(key, hazard)]
    if found is not None and found[1] not in cameras:
        return ('render_node.hazard has no such camera; there '
                + (f'are {", ".join(cameras)}' if cameras else 'is none'))
    return ''
