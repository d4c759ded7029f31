"""Pictures of a bag: stereo sets, trajectory over the hillshade, attitude, IMU."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.patches import Circle
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.bag import series
from lunar_rover_sim.bag.message_validity import lidar_cloud_problem, lidar_points
from lunar_rover_sim.bag.messages import exposure_s, header_ns
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.series import hazard_topics
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.base.files.results import save_figure
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
from lunar_rover_sim.image.camera.encoding import eight_bits
from lunar_rover_sim.image.rendering import layer_pictures
from lunar_rover_sim.products.inspection.map_pictures import map_figure, overview_figure
from lunar_rover_sim.run.recorded_run import RecordedRun
from lunar_rover_sim.sensors.registry import SENSORS
from lunar_rover_sim.sensors.sensor import Sensor

Save = Callable[[Figure, str], None]

Draw = Callable[[NDArray[Any]], NDArray[np.uint8]]     # pixels as (h, w, 3) BGR colours

# What is shown of a camera, and how it is drawn.
_OF_LEFT: Mapping[topics.Topic, Draw] = {
    topics.LABELS: layer_pictures.label_picture, topics.CRATERS: layer_pictures.crater_picture,
    topics.SHADOW: layer_pictures.shadow_picture, topics.NORMALS: layer_pictures.normal_picture,
    topics.OPTICAL_FLOW: layer_pictures.flow_picture,
    topics.SCENE_FLOW: layer_pictures.flow_picture}
_OF_RIGHT: Mapping[topics.Topic, Draw] = {
    topics.RIGHT_TRUE_DEPTH: layer_pictures.depth_picture,
    topics.RIGHT_LABELS: layer_pictures.label_picture,
    topics.RIGHT_CRATERS: layer_pictures.crater_picture,
    topics.RIGHT_SHADOW: layer_pictures.shadow_picture,
    topics.RIGHT_NORMALS: layer_pictures.normal_picture}
_OF_HAZARD: Mapping[topics.Topic, Draw] = {
    topics.HAZARD_IMAGE: layer_pictures.gray8, topics.HAZARD_DEPTH: layer_pictures.depth_picture,
    topics.HAZARD_LABELS: layer_pictures.label_picture,
    topics.HAZARD_CRATERS: layer_pictures.crater_picture}
_CHASE_FRAMES = 4
_MOST_WINDOWS = 16      # of a site, whose fine ground a map shows
_NEAR_SHARE = 95.0      # the map of a scan extends to this percentile of the distances
_CLOUDS = topics.LIDAR_POINTS, topics.LIDAR_DESKEWED
FRAMES = 4
_PANEL = 5.5, 2.7       # of a sensor [inch]
_SHOWN_ELSEWHERE = (topics.IMU_RAW,)    # imu.png shows it


def truth_figures(bag: Bag, save: Save) -> None:
    """Draw the truth of the last frame with all recorded layers, for each camera of the pair."""
    _figure(bag, _OF_LEFT, 'truth.png', save)
    _figure(bag, _OF_RIGHT, 'truth_right.png', save)


def _figure(bag: Bag, shown: Mapping[topics.Topic, Draw], file: str, save: Save) -> None:
    wanted = [topic for topic in shown if bag.has(topic.name)]
    stamps = series.common_stamps(bag, [topic.name for topic in wanted])
    if not stamps:
        return
    found = series.messages_at(bag, wanted, stamps[-1])
    save(_panels((10, 5.2), (2, 3), f'{stamps[-1] * 1e-9:.3f} s', [
        (topic.name, shown[topic](series.picture(bag, found[topic]).pixels))
        for topic in wanted if topic in found]), file)


def _panels(size: tuple[float, float], shape: tuple[int, int], title: str,
            shown: Sequence[tuple[str, NDArray[np.uint8]]]) -> Figure:
    """Return a figure of titles and BGR pictures in rows and columns."""
    figure = Figure(figsize=size, layout='constrained')
    for axes in figure.subplots(*shape, squeeze=False).flat:
        axes.set_axis_off()
    for axes, (name, picture) in zip(figure.axes, shown):
        axes.set_title(name, fontsize=9)
        axes.imshow(picture[..., ::-1])
    figure.suptitle(title, fontsize=9)
    return figure


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
        shape = (1, 1) if len(found) == 1 else (2, 2)
        save(_panels((10, 7.5), shape, f'{stamps[-1] * 1e-9:.3f} s', [
            (kind.name.replace(topics.NAME, camera), draw(series.picture(bag, found[kind]).pixels))
            for kind, draw in _OF_HAZARD.items() if kind in found]),
            f'hazard_{camera.replace("/", "_")}.png')


def chase_figure(bag: Bag, save: Save) -> None:
    """Draw images of the chase camera, spread over the bag."""
    name = topics.CHASE_IMAGE.name
    stamps = series.common_stamps(bag, [name])
    if not stamps:
        return
    found = {stamp: series.messages_at(bag, [topics.CHASE_IMAGE], stamp)[topics.CHASE_IMAGE]
             for stamp in series.spread(stamps, _CHASE_FRAMES)}
    save(_panels((10, 6), (2, 2), name, [
        (f'{stamp * 1e-9:.3f} s', layer_pictures.gray8(series.picture(bag, message).pixels))
        for stamp, message in found.items()]), 'chase.png')


def lidar_figure(bag: Bag, save: Save) -> None:
    """Draw the last scan: from above, coloured by intensity, and by direction, by distance."""
    cloud = next((t for t in _CLOUDS if bag.count(t.name)), None)
    scans = topics.LIDAR_SCAN
    if cloud is None and not bag.count(scans.name):
        return
    name = scans.name if cloud is None else cloud.name
    stamp = series.common_stamps(bag, [name])[-1]
    found = series.messages_at(bag, (scans, *([] if cloud is None else [cloud])), stamp)
    figure = Figure(figsize=(12, 5.5), layout='constrained')
    above, panorama = figure.subplots(1, 2)
    if cloud is not None:
        _draw_cloud(figure, above, panorama, bag, found[cloud])
    else:
        panorama.set_axis_off()
    if scans in found:
        _draw_ring(above, found[scans])
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


def preview(path: Path | str, output: Path | str, world: Path | str | None = None,
            progress: Callable[[str], None] | None = None,
            maps: OrbitalMap | None = None) -> list[Path]:
    """Write PNG pictures of a bag into the folder `output` and return their paths.

    stereo_<n>.png left and right image side by side, disparity and true depth below them;
    truth.png and truth_right.png labels, craters, shadow, normals, flow; hazard_<name>.png image
    and truth of each hazard camera; chase.png; lidar.png; exposure.png where exposure times
    change; sensors.png the numbers of other sensors over time; trajectory.png over
    the hillshade of the world, where its folder is found (`world` names it); attitude.png and
    imu.png over time; map.png maps with plan and goal; with `maps`, overview.png, the way over the
    maps of the site from orbit.
    Pictures of topics that the bag does not hold are left out.

    Raises:
        BagError: Where nothing can be shown.
        WorldError: Where `world` is another world.
    """
    output = Path(output)
    paths: list[Path] = []

    def save(figure: Figure, name: str) -> None:
        save_figure(figure, output / name, BagError, dpi=100)
        paths.append(output / name)
        if progress is not None:
            progress(name)

    with open_bag(path) as bag:
        _stereo(bag, save)
        truth_figures(bag, save)
        hazard_figures(bag, save)
        chase_figure(bag, save)
        lidar_figure(bag, save)
        _exposure(bag, save)
        sensor_figure(bag, save)
        if bag.has(bag.truth):
            odometry = series.read_odometry(bag)
            if len(odometry.stamps_ns):
                _trajectory(bag, odometry, world, save)
                _attitude(odometry, save)
                map_figure(bag, odometry, save)
                if maps is not None:
                    overview_figure(bag, odometry, maps, save)
        if bag.has(topics.IMU_RAW.name):
            _imu(bag, save)
    if not paths:
        raise BagError(f'{path}: holds no images, odometry, IMU, LiDAR or sensors; there is '
                       'nothing to preview')
    return paths


def _stereo(bag: Bag, save: Save) -> None:
    if not bag.has(topics.LEFT_IMAGE.name):
        return
    wanted = [t for t in (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.DISPARITY,
                          topics.TRUE_DEPTH) if bag.has(t.name)]
    stamps = series.common_stamps(bag, [t.name for t in wanted])
    for n, stamp in enumerate(series.spread(stamps, FRAMES)):
        found = series.messages_at(bag, wanted, stamp)
        figure = Figure(figsize=(10, 7.5), layout='constrained')
        for axes, topic in zip(figure.subplots(2, 2).flat,
                               (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.DISPARITY,
                                topics.TRUE_DEPTH), strict=True):
            axes.set_axis_off()
            axes.set_title(topic.name, fontsize=9)
            if topic in found:
                _draw(figure, axes, bag, topic, found[topic])
        figure.suptitle(f'{stamp * 1e-9:.3f} s', fontsize=9)
        save(figure, f'stereo_{n}.png')


def _draw(figure: Figure, axes: Any, bag: Bag, topic: topics.Topic, message: Any) -> None:
    missing = colormaps['turbo'].with_extremes(bad='0.15')
    if topic is topics.DISPARITY:
        pixels = series.picture(bag, message.image).pixels
        shown = np.where((pixels >= message.min_disparity) & (pixels > 0.0), pixels, np.nan)
        image = axes.imshow(shown, cmap=missing, vmin=0.0, vmax=_percentile(shown, 99.0))
        figure.colorbar(image, ax=axes, label='px', shrink=0.8)
    elif topic is topics.TRUE_DEPTH:
        pixels = series.picture(bag, message).pixels
        shown = np.where(np.isfinite(pixels), pixels, np.nan)
        image = axes.imshow(shown, cmap=missing.reversed(), vmin=0.0,
                            vmax=_percentile(shown, 90.0))
        figure.colorbar(image, ax=axes, label='m', shrink=0.8)
    else:
        picture = series.picture(bag, message)
        if picture.pixels.ndim == 3:
            rgb = eight_bits(picture.pixels[..., :3])
            axes.imshow(rgb[..., ::-1] if picture.encoding.startswith('bgr') else rgb)
        else:
            axes.imshow(picture.pixels, cmap='gray', vmin=0,
                        vmax=np.iinfo(picture.pixels.dtype).max)


def _percentile(values: np.ndarray, percent: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if known.size else 1.0


def _exposure(bag: Bag, save: Save) -> None:
    """Draw exposure times that change."""
    name = topics.EXPOSURE.name
    found = [(header_ns(m) * 1e-9, 1e3 * exposure_s(m)) for _, _, m in bag.messages([name])] \
        if bag.has(name) else []
    if len({time_ms for _, time_ms in found}) < 2:
        return
    t_s, times_ms = zip(*found)
    save(_over_time(t_s, {'[ms]': {name: times_ms}}, 2.5), 'exposure.png')


def _trajectory(bag: Bag, odometry: series.Odometry, world: Path | str | None,
                save: Save) -> None:
    figure = Figure(figsize=(7, 6.5), layout='constrained')
    axes = figure.subplots()
    xy = odometry.positions_m[:, :2]
    draw_around(axes, xy, 0.75, bag, world)
    axes.plot(xy[:, 0], xy[:, 1], color='tab:red', lw=1.5, label='path of base_link')
    axes.plot(*xy[0], 'o', color='tab:green', ms=6, label='start')
    axes.plot(*xy[-1], 's', color='tab:red', ms=6, label='end')
    axes.legend(loc='upper right')
    axes.set_title(f'{odometry.distance_m:.2f} m in {odometry.stamps_ns[-1] * 1e-9:.1f} s',
                   fontsize=9)
    save(figure, 'trajectory.png')


def draw_around(axes: Any, xy: NDArray[np.float64], margin: float, bag: Bag | None,
                folder: Path | str | None = None) -> None:
    """Frame a path, (n, 2) places, and draw the hillshade of the site of a bag below it.

    Args:
        margin: Half of the width, as a share of the longer side of the path.
        folder: As `draw_hillshade` has it.
    """
    low, high = xy.min(axis=0), xy.max(axis=0)
    middle, half = (low + high) / 2, max(margin * float((high - low).max()), 0.25)
    if bag is not None:
        draw_hillshade(axes, bag, middle, half, folder)
    x, y = middle
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect='equal',
             xlabel='x, east [m]', ylabel='y, north [m]')


def draw_hillshade(axes: Any, bag: Bag, centre_m: np.ndarray, half_m: float,
                   folder: Path | str | None = None) -> None:
    """Draw the hillshade of the site of a bag, lit from its sun's azimuth, where it is found.

    It is that of the windows in which the rover was; of many, of some of them.

    Raises:
        WorldError: Where `folder` is given and holds another world.
    """
    driven = RecordedRun(bag).driven(folder)
    if driven is None:
        return
    azimuth = 135.0
    if bag.has(topics.SUN.name):
        sun = bag.first(topics.SUN.name).vector
        azimuth = float(np.degrees(np.arctan2(sun.y, sun.x)))
    side = np.linspace(-half_m, half_m, 600)
    x, y = np.meshgrid(centre_m[0] + side, centre_m[1] + side)
    places = np.stack([x, y], axis=-1)
    height, distant = np.full(x.shape, np.nan), np.full(x.shape, np.nan)
    rocks: dict[int, tuple[float, float, float]] = {}      # by key: x, y, diameter
    stamps_ns = [stamp for stamp, _ in driven.windows] or [0]
    for stamp in stamps_ns[::-(-len(stamps_ns) // _MOST_WINDOWS)]:
        world = driven.at(stamp)
        here = world.ground.contains(places) & np.isnan(height)
        height[here] = world.ground.height_at(places[here])
        todo = np.isnan(distant)
        if todo.any():
            distant[todo] = world.height_at(places[todo])
        # Smaller ones would not be seen, and are by far the most.
        near = ((np.abs(world.rocks.position_m[:, :2] - centre_m).max(axis=1) < half_m)
                & (world.rocks.diameter_m >= side[1] - side[0]))
        rocks.update(zip(world.rocks.key[near].tolist(), zip(
            *world.rocks.position_m[near, :2].T.tolist(), world.rocks.diameter_m[near].tolist())))
    height = np.where(np.isnan(height), distant, height)
    slope_y, slope_x = np.gradient(height, side[1] - side[0])
    # The light is always 30 degrees above the horizon, so that the ground is readable.
    light = frames.sun_direction(azimuth, 30.0)
    shade = (light[2] - light[0] * slope_x - light[1] * slope_y) / np.sqrt(
        1.0 + slope_x**2 + slope_y**2)
    extent = (x[0, 0], x[0, -1], y[0, 0], y[-1, 0])
    axes.imshow(shade, cmap='gray', origin='lower', extent=extent, vmin=0.0, vmax=1.0)
    for k, (rock_x, rock_y, diameter) in enumerate(rocks.values()):
        # One of them is enough for a legend.
        axes.add_patch(Circle((rock_x, rock_y), diameter / 2, facecolor='0.12',
                              label='rocks' if k == 0 else None))


def _attitude(odometry: series.Odometry, save: Save) -> None:
    rpy = np.degrees(frames.rpy_from_wxyz(odometry.orientations_wxyz))
    save(_over_time(odometry.stamps_ns * 1e-9, {
        '[deg]': {'roll': rpy[:, 0], 'pitch, + nose down': rpy[:, 1]},
        '[m]': {'height': odometry.positions_m[:, 2]},
        '[m/s]': {'forward speed': odometry.twists[:, 0]}}, 5.5), 'attitude.png')


def _imu(bag: Bag, save: Save) -> None:
    imu = series.read_imu(bag)
    if len(imu.stamps_ns):
        save(_over_time(imu.stamps_ns * 1e-9, {
            'specific force [m/s²]': dict(zip('xyz', imu.specific_forces_mps2.T)),
            'rate [rad/s]': dict(zip('xyz', imu.rates_radps.T))}, 5.0), 'imu.png')


def _over_time(t_s: ArrayLike, panels: Mapping[str, Mapping[str, ArrayLike]],
               height: float) -> Figure:
    """Return a figure of so many inches with a panel for each unit: curves over time by name."""
    figure = Figure(figsize=(9, height), layout='constrained')
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (unit, curves) in zip(rows, panels.items()):
        for name, values in curves.items():
            axes.plot(t_s, values, lw=0.8, label=name)
        axes.set_ylabel(unit)
        axes.grid(alpha=0.3)
        axes.legend(loc='upper right', fontsize=8)
    rows[-1].set_xlabel('time [s]')
    return figure


def sensor_figure(bag: Bag, save: Save) -> None:
    """Draw the numbers of each sensor's messages over time."""
    legs = topics.legs_of(bag.types)
    found = [(topic.name, sensor) for sensor in SENSORS
             for topic in topics.of_legs(sensor.published, legs)
             if topic not in _SHOWN_ELSEWHERE and bag.count(topic.name)]
    if not found:
        return
    rows = -(-len(found) // 2)
    columns = min(len(found), 2)
    figure = Figure(figsize=(_PANEL[0] * columns, _PANEL[1] * rows), layout='constrained')
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for axes, (name, sensor) in zip(panels, found):
        _draw_sensor(axes, bag, name, sensor)
    for axes in list(panels):
        axes.set_axis_off()
    save(figure, 'sensors.png')


def _draw_sensor(axes: Any, bag: Bag, name: str, sensor: type[Sensor]) -> None:
    rows = [(header_ns(message) / NS_PER_S, _numbers(sensor.read(name, message)))
            for _, _, message in bag.messages([name])]
    for key in rows[0][1]:
        axes.plot([t for t, _ in rows], [values.get(key) for _, values in rows], lw=0.8, label=key)
    axes.set_title(name, fontsize=9)
    axes.set_xlabel('time [s]', fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)
    axes.legend(loc='best', fontsize=7)


def _numbers(values: Any, name: str = '') -> dict[str, float]:
    """Return the numbers among values of JSON, by their names and places."""
    if isinstance(values, dict):
        return {key: number for part, value in values.items()
                for key, number in _numbers(value, part).items()}
    if isinstance(values, list):
        return {key: number for k, value in enumerate(values)
                for key, number in _numbers(value, f'{name}[{k}]').items()}
    return {name: values} if isinstance(values, (int, float)) else {}
