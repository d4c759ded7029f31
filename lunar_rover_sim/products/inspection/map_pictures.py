"""Pictures of the maps, plans and goals that a bag holds, and of the way over a map from orbit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.messages import header_ns, xyz
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.series import Odometry
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap

_SHOWN = 4
_COLOURS = colormaps['viridis']
_AROUND, _LEAST_HALF_M = 0.15, 20.0     # of an overview beyond the way: a share of it
_ELLIPSES, _SIGMAS = 12, 3.0            # of an estimate, over the drive; their half axes
_LABELLED = 12                          # of its craters, the largest
_UNKNOWN, _LETHAL = (0.13, 0.13, 0.15), (0.93, 0.30, 0.20)


def map_of(message: Any) -> tuple[NDArray[np.uint8], tuple[float, float, float, float]]:
    """Return the (n, n, 3) RGB colours of a nav_msgs/OccupancyGrid, row 0 south, and its extent.

    The extent is least x, greatest x, least y, greatest y [m].
    """
    info, (x, y, _) = message.info, xyz(message.info.origin.position)
    cost = np.asarray(message.data, np.int8).reshape(info.height, info.width)
    colours = _COLOURS(np.clip(cost, 0, 99) / 99.0)[..., :3]
    colours[cost < 0] = _UNKNOWN
    colours[cost >= 100] = _LETHAL
    return np.asarray(255.0 * colours, np.uint8), (
        x, x + info.width * info.resolution, y, y + info.height * info.resolution)


def path_of(message: Any) -> Array:
    """Return the (n, 2) places of a nav_msgs/Path [m]."""
    return np.array([(pose.pose.position.x, pose.pose.position.y)
                     for pose in message.poses]).reshape(-1, 2)


def goal_of(message: Any) -> Array:
    """Return the place (2,) of a geometry_msgs/PoseStamped [m]."""
    return np.array([message.pose.position.x, message.pose.position.y])


def map_figure(bag: Bag, odometry: Odometry, save: Callable[[Figure, str], None]) -> None:
    """Draw the map, what was driven, plan and goal at some times of the drive, as map.png."""
    if not bag.has(topics.TRAVERSABILITY.name):
        return
    stamps = [message.time_ns for message in bag.raw([topics.TRAVERSABILITY.name])]
    chosen = sorted({stamps[k] for k in np.linspace(0, len(stamps) - 1, _SHOWN + 1).round()
                     .astype(int)[1:]})
    others = [topic.name for topic in (topics.PLAN, topics.GOAL) if bag.has(topic.name)]
    plans, goals = [], []
    for name, _, message in bag.messages([bag.resolve(name) for name in others]):
        if name == bag.resolve(topics.PLAN.name):
            plans.append((header_ns(message), path_of(message)))
        else:
            goals.append((header_ns(message), goal_of(message)))
    figure = Figure(figsize=(10, 10), layout='constrained')
    panels = figure.subplots(2, 2).flat
    for axes in panels:
        axes.set_axis_off()
    for axes, stamp in zip(figure.axes, chosen):
        axes.set_axis_on()
        _, _, message = next(iter(bag.messages([bag.resolve(topics.TRAVERSABILITY.name)], stamp,
                                               stamp + 1)))
        colours, extent_m = map_of(message)
        axes.imshow(colours, origin='lower', extent=extent_m)
        gone = odometry.positions_m[odometry.stamps_ns <= stamp]
        axes.plot(gone[:, 0], gone[:, 1], color='white', lw=1.2, label='driven')
        for listed, label, colour, marker in ((plans, 'plan', 'tab:orange', ''),
                                              (goals, 'goal', 'cyan', '*')):
            past = [value for time, value in listed if time <= stamp]
            if past and past[-1].size:
                x, y = np.atleast_2d(past[-1]).T
                axes.plot(x, y, label=label, color=colour, marker=marker, ms=12)
        axes.set(xlim=extent_m[:2], ylim=extent_m[2:], aspect='equal',
                 xlabel='x, east [m]', ylabel='y, north [m]')
        axes.set_title(f'{stamp * 1e-9:.1f} s; dark: unknown, red: not to be crossed', fontsize=9)
        axes.legend(loc='upper right', fontsize=8)
    save(figure, 'map.png')


def overview_figure(bag: Bag, odometry: Odometry, maps: OrbitalMap,
                    save: Callable[[Figure, str], None]) -> None:
    """Draw the way, plans, goals and an anchored estimate over a map from orbit, as overview.png.

    Raises:
        BagError: If the rover was nowhere on the map.
    """
    way = odometry.positions_m[:, :2]
    shown = [way]
    plans, goals = (
        [read(message) for _, _, message in bag.messages([bag.resolve(topic.name)])]
        if bag.has(topic.name) else []
        for topic, read in ((topics.GLOBAL_PLAN, path_of), (topics.GOAL, goal_of)))
    shown += [plan for plan in plans if len(plan)] + [goal[None] for goal in goals]
    low, high = (f(np.concatenate(shown), axis=0) for f in (np.min, np.max))
    west, south, east, north = maps.bounds_m
    if not ((way >= (west, south)) & (way <= (east, north))).all(axis=1).any():
        raise BagError(f'{bag.path}: the rover is at x {way[0, 0]:.0f} m, y {way[0, 1]:.0f} m, '
                       f'and the map from orbit has x of {west:g} to {east:g} m and y of '
                       f'{south:g} to {north:g} m')
    middle, half = 0.5 * (low + high), max((0.5 + _AROUND) * float((high - low).max()),
                                           _LEAST_HALF_M)
    figure = Figure(figsize=(9, 9), layout='constrained')
    axes = figure.subplots()
    if maps.photo.size:
        pixel, (x, y) = maps.config.photo_pixel_m, maps.photo_first_m
        rows, columns = maps.photo.shape
        axes.imshow(maps.photo, cmap='gray', origin='lower', vmin=0, vmax=255,
                    extent=(x - 0.5 * pixel, x + (columns - 0.5) * pixel,
                            y - 0.5 * pixel, y + (rows - 0.5) * pixel))
    else:
        axes.imshow(maps.heights_m, cmap='gray', origin='lower',
                    extent=(west, east, south, north))
    near = np.abs(maps.craters.position_m - middle).max(axis=1, initial=0.0) < half
    for k in np.flatnonzero(near)[:_LABELLED]:
        axes.add_patch(Circle(maps.craters.position_m[k], 0.5 * maps.craters.diameter_m[k],
                              fill=False, color='tab:blue', lw=1.0))
    for k, plan in enumerate(plans):
        last = k == len(plans) - 1
        axes.plot(*plan.T, color='tab:orange', lw=1.5 if last else 0.8,
                  ls='-' if last else ':', label='plan' if last else None)
    axes.plot(*way.T, color='tab:red', lw=1.5, label='driven')
    axes.plot(*way[0], 'o', color='tab:green', ms=6, label='start')
    _draw_estimate(axes, bag)
    for k, goal in enumerate(goals):
        axes.plot(*goal, '*', color='cyan', ms=12, label=None if k else 'goal')
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half),
             xlabel='x, east [m]', ylabel='y, north [m]', aspect='equal')
    axes.set_title('map from orbit; blue: the largest craters of it', fontsize=9)
    axes.legend(loc='upper right')
    save(figure, 'overview.png')


def _draw_estimate(axes: Axes, bag: Bag) -> None:
    """Draw what slam_node said of its place on the site, with ellipses of its covariance."""
    name = topics.SLAM_COVARIANCE.name
    if not bag.has(name) or not bag.has(bag.truth):
        return
    site = bag.first(bag.truth).header.frame_id
    told = [(np.array(xyz(message.pose.pose.position)[:2]),
             np.reshape(message.pose.covariance, (6, 6))[:2, :2])
            for _, _, message in bag.messages([bag.resolve(name)])
            if message.header.frame_id == site]     # else it is in a map of its own
    if not told:
        return
    places = np.array([place for place, _ in told])
    axes.plot(*places.T, color='tab:purple', lw=1.0, ls='--', label='told by slam_node')
    for k in np.unique(np.linspace(0, len(told) - 1, _ELLIPSES).round().astype(int)):
        place, P = told[k]
        variances, vectors = np.linalg.eigh(P)
        width, height = 2.0 * _SIGMAS * np.sqrt(np.maximum(variances[::-1], 0.0))
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        axes.add_patch(Ellipse(tuple(place), width, height, angle=angle, fill=False,
                               color='tab:purple', lw=1.0,
                               label=f'its {_SIGMAS:g} sigma' if k == len(told) - 1 else None))
