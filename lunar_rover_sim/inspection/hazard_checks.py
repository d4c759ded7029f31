"""Checks of hazard cameras: recorded as the scenario has them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lunar_rover_sim import topics
from lunar_rover_sim.camera.hazard import sides
from lunar_rover_sim.camera.hazard_config import HazardConfig
from lunar_rover_sim.camera.models import geometry_of
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.inspection.message_checks import count_problem, recorded_names
from lunar_rover_sim.inspection.report import CheckReport, Status
from lunar_rover_sim.inspection.rover_data import RoverData
from lunar_rover_sim.seconds import NS_PER_S


def hazards(rover: RoverData, report: CheckReport) -> None:
    """Images and CameraInfos of hazard cameras that were to be recorded are there, and fit."""
    sets = rover.scenario.get('render_node', 'hazard')
    if not isinstance(sets, Mapping):
        return
    listed = recorded_names(rover)
    problems, found = [], 0
    for name, values in sets.items():
        try:
            config = HazardConfig.from_mapping(values, f'render_node.hazard.{name}')
        except ConfigError as error:
            problems.append(f'the scenario is not of this version: {error}')
            continue
        for side, camera in enumerate(sides(str(name), config)):
            for topic in topics.hazard(camera):
                if topic.name not in listed:
                    continue
                found += 1
                problem = _topic_problem(rover, topic.name, config, side)
                if problem:
                    problems.append(f'{topic.name}: {problem}')
    if found or problems:
        report.verdict('hazard cameras', problems, f'{found} topics, as in the scenario',
                       Status.WARN if rover.real_time else Status.FAIL)


def _topic_problem(rover: RoverData, name: str, config: HazardConfig, side: int) -> str:
    """Return what is wrong with one topic of a camera; side: 0 left or the only one, 1 right."""
    topic = rover.scan.topics.get(name)
    if topic is None:
        return 'missing'
    period_ns = NS_PER_S // config.rate_hz
    problem = count_problem(topic, np.arange(period_ns, rover.end_ns + 1, period_ns))
    if problem:
        return problem
    last, camera = topic.last, geometry_of(config)
    if last is None or topic.msgtype != topic.topic.type:
        return ''
    if (last.width, last.height) != (camera.width, camera.height):
        return (f'{last.width} x {last.height} px, {camera.width} x {camera.height} px in the '
                'scenario')
    if name.endswith('camera_info') and (
            last.distortion_model != camera.distortion_model
            or not np.allclose(last.k, camera.K.ravel()) or not np.allclose(last.d, camera.D)
            or not np.isclose(last.p[3], -side * camera.focal_px * config.stereo_baseline_m)):
        return 'not the camera of the scenario'
    return ''
