"""Pictures of further cameras and of the LiDAR that a bag holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag import series
from lunar_rover_sim.bag.hazard_topics import hazard_topics
from lunar_rover_sim.bag.message_validity import lidar_cloud_problem, lidar_points
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.errors import BagError
from lunar_rover_sim.rendering import layer_pictures

_OF_LEFT = (topics.LABELS, topics.CRATERS, topics.SHADOW, topics.NORMALS, topics.OPTICAL_FLOW,
            topics.SCENE_FLOW)
_LEFT_OF = dict(zip(topics.OF_RIGHT, (topics.TRUE_DEPTH, topics.LABELS, topics.CRATERS,
                                      topics.SHADOW, topics.NORMALS), strict=True))


def truth_figures(bag: Bag, save: Callable[[Figure, str], None]) -> None:
    """Draw the truth of the last frame with all recorded layers, for each camera of the pair."""
    _figure(bag, _OF_LEFT, 'truth.png', save)
    _figure(bag, topics.OF_RIGHT, 'truth_right.png', save)


def _figure(bag: Bag, shown: Sequence[topics.Topic], file: str,
            save: Callable[[Figure, str], None]) -> None:
    wanted = [topic for topic in shown if bag.has(topic.name)]
    stamps = series.common_stamps(bag, [topic.name for topic in wanted])
    if not stamps:
        return
    names = {bag.resolve(topic.name): topic for topic in wanted}
    found = {names[name]: message for name, _, message in
             bag.messages(names, stamps[-1], stamps[-1] + 1)}
    figure = Figure(figsize=(10, 5.2), layout='constrained')
    panels = figure.subplots(2, 3).flat
    for axes in panels:
        axes.set_axis_off()
    for axes, topic in zip(figure.axes, (topic for topic in wanted if topic in found)):
        axes.set_title(topic.name, fontsize=9)
        pixels = series.picture(bag, found[topic]).pixels
        axes.imshow(truth_picture(_LEFT_OF.get(topic, topic), pixels)[..., ::-1])
    figure.suptitle(f'{stamps[-1] * 1e-9:.3f} s', fontsize=9)
    save(figure, file)


def truth_picture(topic: topics.Topic, pixels: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Return (h, w, 3) BGR colours of an image of a topic of the left camera's truth."""
    if topic is topics.TRUE_DEPTH:
        return layer_pictures.depth_picture(np.asarray(pixels, np.float32))
    if topic is topics.LABELS:
        return layer_pictures.label_picture(np.asarray(pixels, np.int32))
    if topic is topics.CRATERS:
        return layer_pictures.crater_picture(np.asarray(pixels, np.int32))
    if topic is topics.SHADOW:
        return layer_pictures.shadow_picture(np.asarray(pixels, np.uint8))
    if topic is topics.NORMALS:
        return layer_pictures.normal_picture(np.asarray(pixels, np.float32))
    return layer_pictures.flow_picture(np.asarray(pixels, np.float32))


Save = Callable[[Figure, str], None]

_OF_HAZARD = (topics.HAZARD_IMAGE, topics.HAZARD_DEPTH, topics.HAZARD_LABELS,
              topics.HAZARD_CRATERS)
_CHASE_FRAMES = 4
_NEAR_SHARE = 95.0      # the map of a scan extends to this percentile of the distances
_CLOUDS = topics.LIDAR_POINTS, topics.LIDAR_DESKEWED


def hazard_figures(bag: Bag, save: Save) -> None:
    """Draw for each hazard camera the last image with all recorded truth, and that truth.

    If no image has all of it, draw the last image alone.
    """
    for camera, names in hazard_topics(bag).items():
        named = {bag.resolve(names[kind]): kind for kind in _OF_HAZARD if kind in names}
        stamps = series.common_stamps(bag, list(named)) if named else []
        if not stamps and topics.HAZARD_IMAGE in names:
            stamps = series.common_stamps(bag, [names[topics.HAZARD_IMAGE]])
        if not stamps:
            continue
        found = {named[name]: message for name, _, message in
                 bag.messages(named, stamps[-1], stamps[-1] + 1)}
        if topics.HAZARD_IMAGE in names and len(found) < len(named):
            found = {topics.HAZARD_IMAGE: found[topics.HAZARD_IMAGE]}
        figure = Figure(figsize=(10, 7.5), layout='constrained')
        shape = (1, 1) if len(found) == 1 else (2, 2)
        for axes in figure.subplots(*shape, squeeze=False).flat:
            axes.set_axis_off()
        for axes, kind in zip(figure.axes, (kind for kind in _OF_HAZARD if kind in found)):
            pixels = series.picture(bag, found[kind]).pixels
            axes.set_title(kind.name.replace(topics.NAME, camera), fontsize=9)
            axes.imshow(_hazard_picture(kind, pixels)[..., ::-1])
        figure.suptitle(f'{stamps[-1] * 1e-9:.3f} s', fontsize=9)
        save(figure, f'hazard_{camera.replace("/", "_")}.png')


def _hazard_picture(kind: topics.Topic, pixels: NDArray[Any]) -> NDArray[np.uint8]:
    if kind is topics.HAZARD_IMAGE:
        return layer_pictures.gray8(pixels)
    if kind is topics.HAZARD_DEPTH:
        return layer_pictures.depth_picture(pixels)
    return truth_picture(topics.LABELS if kind is topics.HAZARD_LABELS else topics.CRATERS,
                         pixels)


def chase_figure(bag: Bag, save: Save) -> None:
    """Draw images of the chase camera, spread over the bag."""
    name = topics.CHASE_IMAGE.name
    stamps = series.common_stamps(bag, [name])
    if not stamps:
        return
    figure = Figure(figsize=(10, 6), layout='constrained')
    for axes, stamp in zip(figure.subplots(2, 2).flat, _spread(stamps, _CHASE_FRAMES)):
        message = next(message for _, _, message in bag.messages([name], stamp, stamp + 1))
        axes.imshow(layer_pictures.gray8(series.picture(bag, message).pixels)[..., ::-1])
        axes.set_title(f'{stamp * 1e-9:.3f} s', fontsize=9)
    for axes in figure.axes:
        axes.set_axis_off()
    figure.suptitle(name, fontsize=9)
    save(figure, 'chase.png')


def _spread(stamps: Sequence[int], count: int) -> list[int]:
    chosen = np.linspace(0, len(stamps) - 1, min(count, len(stamps))).round().astype(int)
    return [stamps[k] for k in chosen]


def lidar_figure(bag: Bag, save: Save) -> None:
    """Draw the last scan: from above, coloured by intensity, and by direction, by distance."""
    cloud = next((t for t in _CLOUDS if bag.count(t.name)), None)
    scans = topics.LIDAR_SCAN.name
    has_scan = bag.count(scans) > 0
    if cloud is None and not has_scan:
        return
    name = scans if cloud is None else cloud.name
    stamp = series.common_stamps(bag, [name])[-1]
    names = [t for t in (name, scans) if bag.has(t)]
    found = {topic: message for topic, _, message in bag.messages(names, stamp, stamp + 1)}
    figure = Figure(figsize=(12, 5.5), layout='constrained')
    above, panorama = figure.subplots(1, 2)
    if cloud is not None:
        _draw_cloud(figure, above, panorama, bag, found[bag.resolve(name)])
    else:
        panorama.set_axis_off()
    if has_scan and bag.resolve(scans) in found:
        _draw_ring(above, found[bag.resolve(scans)])
    above.set(xlabel='x, forward [m]', ylabel='y, left [m]', aspect='equal')
    figure.suptitle(f'{name}, {stamp * 1e-9:.3f} s', fontsize=9)
    save(figure, 'lidar.png')


def _draw_cloud(figure: Figure, above: Any, panorama: Any, bag: Bag, message: Any) -> None:
    problem = lidar_cloud_problem(message)
    if problem:
        raise BagError(f'{bag.path}: {topics.LIDAR_POINTS.name}: {problem}')
    points = lidar_points(message)
    place = np.stack([points[axis] for axis in 'xyz'], axis=-1).astype(float)
    known = np.isfinite(place).all(axis=-1)
    place, intensity = place[known], points['intensity'][known]
    distance = np.linalg.norm(place, axis=-1)
    drawn = above.scatter(*place[:, :2].T, c=intensity, s=1.0, cmap='turbo')
    figure.colorbar(drawn, ax=above, label='intensity [%]', shrink=0.8)
    if len(place):
        half = max(float(np.percentile(distance, _NEAR_SHARE)), 1.0)
        above.set(xlim=(-half, half), ylim=(-half, half))
    azimuth = np.degrees(np.arctan2(place[:, 1], place[:, 0]))
    elevation = np.degrees(np.arctan2(place[:, 2], np.hypot(place[:, 0], place[:, 1])))
    drawn = panorama.scatter(azimuth, elevation, c=distance, s=1.0, cmap='turbo_r')
    figure.colorbar(drawn, ax=panorama, label='distance [m]', shrink=0.8)
    panorama.set(xlabel='azimuth, to the left [deg]', ylabel='elevation [deg]')
    panorama.invert_xaxis()


def _draw_ring(above: Any, message: Any) -> None:
    ranges = np.asarray(message.ranges, float)
    angle = message.angle_min + message.angle_increment * np.arange(len(ranges))
    known = np.isfinite(ranges)
    above.plot(ranges[known] * np.cos(angle[known]), ranges[known] * np.sin(angle[known]), '.',
               color='black', ms=2.0, label=topics.LIDAR_SCAN.name)
    above.legend(loc='upper right', fontsize=8)
