"""Topics that a run publishes, and those that its recorder takes.

Plan, recorder, checks of a bag and warnings before a run all ask here.
"""

from __future__ import annotations

from collections.abc import Collection
import difflib

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.base.topics import Topic
from lunar_rover_sim.image.camera.hazard import sides
from lunar_rover_sim.run.node_config import ALL
from lunar_rover_sim.run.scenario import Scenario

_RENDERED_OR_SCANNED = 'lidar_node', 'render_node'
_ALIKE = 0.85        # least similarity of names for a hint, from 0 to 1
_OF_CHASE = topics.CHASE_IMAGE, topics.CHASE_INFO, topics.CHASE_POSE


def is_recorded(topic: Topic, listed: Collection[str], excluded: Collection[str] = ()) -> bool:
    """Return whether a recorder takes a topic of the contract.

    `all` leaves out what is on request, since a subscription makes another node compute it, and
    the recorder's own progress.

    Args:
        listed: `recorder_node.topics`, names without a leading slash.
        excluded: `recorder_node.exclude`, likewise.
    """
    if topic.name in listed:
        return True
    return (ALL in listed and topic.name not in excluded and topic.in_all
            and topic is not topics.RECORDED)


def unpublished(separate_truth: bool, publish_clock: bool, soft_ground: bool) -> tuple[Topic, ...]:
    """Return the topics that physics does not publish by its parameters."""
    return (topics.ODOM if separate_truth else topics.TRUE_ODOM,
            *(() if publish_clock else (topics.CLOCK,)),
            *(() if soft_ground else topics.OF_SOFT_GROUND))


def period_ns(rate: str, state_hz: float, frame_hz: float, depth_every: float,
              scan_hz: float = 0.0) -> int:
    """Return the period of a rate class [ns]; 0 where it has none.

    Args:
        rate: One of the classes of `topics`.
        state_hz, frame_hz, scan_hz: States, stereo pairs and scans per second [Hz]; 0: unknown.
        depth_every: Frames from one frame with depth to the next.
    """
    rate_hz = {topics.STATE: state_hz, topics.FRAME: frame_hz, topics.SCAN: scan_hz,
               topics.DEPTH_FRAME: frame_hz / max(1.0, depth_every)}.get(rate, 0.0)
    return round(NS_PER_S / rate_hz) if rate_hz else 0


def period_of(scenario: Scenario, topic: Topic) -> int:
    """Return the period of a topic in a run [ns]; 0 where it has none."""
    render = scenario.render_node
    return period_ns(topic.rate, scenario.physics_node.state_rate_hz, render.frame_rate_hz,
                     render.depth_every, scenario.lidar_node.rate_hz)


def recorded_periodic(scenario: Scenario) -> list[Topic]:
    """Return the topics with a period that a run publishes for certain, and records."""
    physics, recorder = scenario.physics_node, scenario.recorder_node
    never = (*topics.OF_VISION, *unpublished(scenario.shared.separate_truth,
                                             physics.publish_clock, physics.ground.deforms))
    nodes = set(scenario.run.nodes).difference(scenario.run.may_fail)
    return [topic for topic in topics.of_legs(topics.CONTRACT, scenario.rover.legs.names)
            if topic.node in nodes and topic not in never and period_of(scenario, topic)
            and is_recorded(topic, recorder.topics, recorder.exclude)]


def recorded_beside_the_pair(scenario: Scenario) -> list[str]:
    """Return the topics of cameras besides the stereo pair that a run offers and records."""
    if not {'render_node', 'recorder_node'} <= set(scenario.run.nodes):
        return []
    return [output.topic.name for camera in scenario.render_node.cameras[1:]
            for output in camera.outputs if output.topic.name in scenario.recorder_node.topics]


def unrecorded_cameras(scenario: Scenario) -> list[str]:
    """Return a line on each hazard camera of which a recorder of `all` takes nothing, with how.

    They are topics on request: to set up a camera does not record it.
    """
    listed = scenario.recorder_node.topics
    if ALL not in listed or not {'render_node', 'recorder_node'} <= set(scenario.run.nodes):
        return []
    lines = []
    for name, config in scenario.render_node.hazard.items():
        image, info, *truth = zip(*map(topics.hazard, sides(name, config)))
        if not {topic.name for of in (image, info, *truth) for topic in of}.intersection(listed):
            needed = ', '.join((*listed, *(topic.name for topic in (*image, *info))))
            lines.append(f'{name}: is not recorded; to record it set '
                         f'recorder_node.topics=[{needed}]')
    return lines


def silent_topics(scenario: Scenario) -> list[str]:
    """Return a line on each topic in `recorder_node.topics` that nobody will publish, with why.

    A name outside the contract may be that of a user's own node; it is listed only if it
    resembles a name of the contract.
    """
    return [f'{name}: {reason}' for name in scenario.recorder_node.topics
            if name != ALL and (reason := _why_silent(scenario, name.lstrip('/')))]


def misspelt_exclusions(scenario: Scenario) -> list[str]:
    """Return a line on each name in `recorder_node.exclude` that resembles a topic and is none."""
    return [f'{name}: {hint}' for name in scenario.recorder_node.exclude
            if (hint := _nearest_name(name.lstrip('/'), [
                topic.name for topic in topics.of_legs(topics.CONTRACT,
                                                       scenario.rover.legs.names)]))]


def _nearest_name(name: str, known: Collection[str]) -> str:
    """Return which of the known names may be meant; '' if it is one, or resembles none."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=_ALIKE)
    return f'no topic of this package; did you mean {near[0]}?' if near and name not in known \
        else ''


def _why_silent(scenario: Scenario, name: str) -> str:
    """Return why nobody publishes a topic; '' where somebody does or may."""
    found = topics.of_hazard(name)
    by_name = {topic.name: topic
               for topic in topics.of_legs(topics.CONTRACT, scenario.rover.legs.names)}
    topic = by_name.get(name) if found is None else found[0]
    if topic is None:
        return _nearest_name(name, by_name)
    # What `all` records may come from a program of the user instead.
    if (not topic.in_all and topic.node in _RENDERED_OR_SCANNED
            and topic.node not in scenario.run.nodes):
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
