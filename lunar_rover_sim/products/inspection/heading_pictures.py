"""A figure of the heading sensors, of power and of other sensors over a recorded drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from scipy.spatial.transform import Rotation

from lunar_rover_sim.bag import series
from lunar_rover_sim.bag.messages import header_ns, wxyz, xyz
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.run.recorded_run import RecordedRun
from lunar_rover_sim.sensors.registry import SENSORS
from lunar_rover_sim.sensors.sensor import Sensor

Save = Callable[[Figure, str], None]
Panel = Callable[[Any], None]

FILE = 'heading_and_power.png'
_ARCSEC = 3600.0 * 180.0 / np.pi
_PANEL = 5.5, 2.7       # its size [inch]
_TRUE: dict[str, Any] = {'color': 'black', 'lw': 0.8}
_COLOURS = 'tab:blue', 'tab:orange', 'tab:green', 'tab:red'
_MA_PER_A = 1000.0
_TIME = 'time [s]'
_MARGIN = 0.02          # of the time
# Topics with panels of their own, here or in `bag_pictures`.
_DRAWN = (topics.IMU_RAW, topics.SUN_SENSOR, topics.STAR_TRACKER, topics.WHEEL_ODOM,
          *topics.POWER, topics.SOLAR_POWER)
_ROOM = 1.35            # over the curves, for the legend


class _Truth:
    """True poses, by time."""

    def __init__(self, odometry: series.Odometry) -> None:
        self._odometry = odometry
        self.t: Array = np.asarray(odometry.stamps_ns * 1e-9, float)
        self.rotations = Rotation.from_quat(odometry.orientations_wxyz[:, [1, 2, 3, 0]])
        self.positions_m = odometry.positions_m

    def index(self, stamps_ns: series.Stamps) -> Any:
        """Return where the last pose at or before each stamp is; the first before it."""
        found = np.searchsorted(self._odometry.stamps_ns, stamps_ns, side='right') - 1
        return np.maximum(found, 0)


def heading_figure(bag: Bag, save: Save) -> None:
    """Draw what sensors say, and the truth beside those whose truth is known here."""
    truth = None
    if bag.count(bag.truth):
        truth = _Truth(series.read_odometry(bag))
    panels = [*_sun_panels(bag, truth), *_star_panels(bag, truth), *_wheel_panels(bag, truth),
              *_power_panels(bag), *_other_panels(bag)]
    if not panels:
        return
    rows = -(-len(panels) // 2)
    columns = min(len(panels), 2)
    figure = Figure(figsize=(_PANEL[0] * columns, _PANEL[1] * rows), layout='constrained')
    grid = figure.subplots(rows, columns, squeeze=False).flat
    for axes, draw in zip(grid, panels):
        draw(axes)
        if truth is not None and axes.get_xlabel() == _TIME:
            margin = _MARGIN * (truth.t[-1] - truth.t[0])
            axes.set_xlim(truth.t[0] - margin, truth.t[-1] + margin)
        axes.grid(alpha=0.3)
        axes.tick_params(labelsize=8)
        axes.title.set_fontsize(9)
        for label in (axes.xaxis.label, axes.yaxis.label):
            label.set_fontsize(8)
    for axes in list(grid):
        axes.set_axis_off()
    save(figure, FILE)


def _read(bag: Bag, name: str, row: Callable[[Any], tuple[float, ...]]
          ) -> tuple[series.Stamps, Array]:
    """Return stamps [ns] and rows of a topic."""
    found = [(header_ns(message), row(message)) for _, _, message in bag.messages([name])]
    return (np.array([stamp for stamp, _ in found], np.int64),
            np.array([values for _, values in found], float))


def _sun_panels(bag: Bag, truth: _Truth | None) -> Iterator[Panel]:
    if not bag.count(topics.SUN_SENSOR.name):
        return
    stamps, measured = _read(bag, topics.SUN_SENSOR.name, lambda m: xyz(m.vector))
    sun = _true_sun(bag)
    true = truth.rotations.inv().apply(sun(truth.t)) if truth is not None and sun else None

    def direction(axes: Any) -> None:
        for values, style in ((true, _TRUE), (measured, {})):
            if values is None:
                continue
            t = truth.t if style and truth is not None else stamps * 1e-9
            azimuth, elevation = _angles_deg(values)
            if style:
                axes.plot(t, azimuth, label='true', **style)
                axes.plot(t, elevation, **style)
            else:
                axes.plot(t, azimuth, '.', ms=5, color=_COLOURS[0], label='azimuth, to the left')
                axes.plot(t, elevation, '.', ms=5, color=_COLOURS[1], label='elevation')
        _label(axes, f'{topics.SUN_SENSOR.name}: direction in base_link', '[deg]')

    yield direction
    if true is not None and truth is not None:
        at = true[truth.index(stamps)]
        cosine = np.sum(at * measured, axis=1)
        error = np.degrees(np.arctan2(np.linalg.norm(np.cross(at, measured), axis=1), cosine))

        def difference(axes: Any) -> None:
            axes.plot(stamps * 1e-9, error, '.', ms=5, color=_COLOURS[0])
            axes.set_ylim(bottom=0.0)
            _label(axes, f'{topics.SUN_SENSOR.name}: angle to the true direction', '[deg]',
                   legend=False)

        yield difference


def _true_sun(bag: Bag) -> Callable[[Array], Array] | None:
    """Return a function from times [s] to unit vectors to the sun; None where none is known.

    Runs without render_node have no topic of it; a sun that stands still is in their scenario.
    """
    if bag.count(topics.SUN.name):
        stamps, vectors = _read(bag, topics.SUN.name, lambda m: xyz(m.vector))
        return lambda t: vectors[np.maximum(
            np.searchsorted(stamps * 1e-9, t, side='right') - 1, 0)]
    scenario = RecordedRun(bag).scenario
    angles = [scenario.get('render_node', f'sun.{name}_deg') for name in ('azimuth', 'elevation')]
    if scenario.get('render_node', 'sun.date') or not all(
            isinstance(angle, (int, float)) for angle in angles):
        return None
    direction = frames.sun_direction(*angles)
    return lambda t: np.tile(direction, (len(t), 1))


def _angles_deg(directions: Array) -> tuple[Array, Array]:
    """Return azimuths, without jumps, and elevations of (n, 3) directions."""
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    # Within half a turn of their mean, so that measured and true ones are not a turn apart.
    mean = np.degrees(np.arctan2(*directions[:, [1, 0]].sum(axis=0)))
    azimuth = mean + (azimuth - mean + 180.0) % 360.0 - 180.0
    return azimuth, np.degrees(np.arcsin(np.clip(directions[:, 2], -1.0, 1.0)))


def _star_panels(bag: Bag, truth: _Truth | None) -> Iterator[Panel]:
    name = topics.STAR_TRACKER.name
    if truth is None or not bag.count(name):
        return
    stamps, quaternions = _read(bag, name, lambda m: wxyz(m.orientation))
    measured = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]])
    error = (truth.rotations[truth.index(stamps)].inv() * measured).as_rotvec() * _ARCSEC

    def draw(axes: Any) -> None:
        for k, axis in enumerate('xyz'):
            axes.plot(stamps * 1e-9, error[:, k], 'o', ms=3, color=_COLOURS[k],
                      label=f'about {axis}')
        axes.axhline(0.0, **_TRUE)
        _label(axes, f'{name}: error of the attitude', '[arcsec]')

    yield draw


def _wheel_panels(bag: Bag, truth: _Truth | None) -> Iterator[Panel]:
    name = topics.WHEEL_ODOM.name
    if not bag.count(name):
        return
    wheel = series.read_odometry(bag, name)
    t = wheel.stamps_ns * 1e-9
    yaw = np.unwrap(frames.rpy_from_wxyz(wheel.orientations_wxyz)[:, 2])
    path = wheel.positions_m[:, :2]
    at = None
    if truth is not None:
        # From the true place and heading at its first message on.
        at = truth.index(wheel.stamps_ns)
        true_yaw = np.unwrap(truth.rotations[at].as_euler('ZYX')[:, 0])
        true_path = truth.positions_m[at, :2]
        turn = true_yaw[0] - yaw[0]
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        path = (path - path[0]) @ R.T + true_path[0]

    def plan(axes: Any) -> None:
        axes.plot(*path.T, color=_COLOURS[0], lw=1.2, label=name)
        if at is not None:
            axes.plot(*true_path.T, label='true', **_TRUE)
        axes.plot(*path[0], 'o', color='tab:green', ms=5)
        axes.set_aspect('equal', adjustable='datalim')
        _label(axes, f'{name}: path', 'y, north [m]', 'x, east [m]')

    yield plan
    if at is None:
        return
    away, turned = np.linalg.norm(path - true_path, axis=1), yaw - yaw[0] - true_yaw + true_yaw[0]

    def distance(axes: Any) -> None:
        axes.plot(t, away, lw=0.8, color=_COLOURS[0])
        _label(axes, f'{name}: distance from the true place', '[m]', legend=False)

    def heading(axes: Any) -> None:
        axes.plot(t, np.degrees(turned), lw=0.8, color=_COLOURS[0])
        axes.axhline(0.0, **_TRUE)
        _label(axes, f'{name}: error of the heading', '[deg]', legend=False)

    yield distance
    yield heading


def _power_panels(bag: Bag) -> Iterator[Panel]:
    *of_motors, of_all = topics.of_legs(topics.POWER, topics.legs_of(bag.types))
    lines = {topic.name: _read(bag, topic.name, lambda m: (m.voltage, m.current))
             for topic in (*of_motors, of_all, topics.SOLAR_POWER) if bag.count(topic.name)}
    motors = [topic.name for topic in of_motors if topic.name in lines]

    def currents(axes: Any) -> None:
        for k, topic in enumerate(of_motors):
            if topic.name in motors:
                stamps, values = lines[topic.name]
                axes.plot(stamps * 1e-9, -values[:, 1] * _MA_PER_A, lw=0.6,
                          color=_COLOURS[k % len(_COLOURS)], label=topic.name.rpartition('/')[2])
        _label(axes, 'power: currents that motors draw', '[mA]')

    def powers(axes: Any) -> None:
        for topic, sign, text in ((of_all, -1.0, 'drawn by all motors'),
                                  (topics.SOLAR_POWER, 1.0, 'given by the panel')):
            if topic.name in lines:
                stamps, values = lines[topic.name]
                axes.plot(stamps * 1e-9, sign * values.prod(axis=1), lw=0.8,
                          label=f'{topic.name}, {text}')
        axes.set_ylim(top=_ROOM * axes.get_ylim()[1])
        _label(axes, 'power', '[W]')

    if motors:
        yield currents
    if set(lines) - set(motors):
        yield powers


def _other_panels(bag: Bag) -> Iterator[Panel]:
    """Yield a panel of the numbers of each sensor that has none of its own."""
    for sensor in SENSORS:
        for topic in sensor.published:
            if topic not in _DRAWN and bag.count(topic.name):
                yield _numbers_panel(bag, topic.name, sensor)


def _numbers_panel(bag: Bag, name: str, sensor: type[Sensor]) -> Panel:
    rows = [(header_ns(message) * 1e-9, _flat(sensor.read(name, message)))
            for _, _, message in bag.messages([name])]

    def draw(axes: Any) -> None:
        for key in rows[0][1]:
            axes.plot([t for t, _ in rows], [values.get(key) for _, values in rows], lw=0.8,
                      label=key)
        _label(axes, name, '')

    return draw


def _flat(values: Any, name: str = '') -> dict[str, float]:
    """Return the numbers among values of JSON, by their names and places."""
    if isinstance(values, dict):
        return {key: number for part, value in values.items()
                for key, number in _flat(value, part).items()}
    if isinstance(values, list):
        return {key: number for k, value in enumerate(values)
                for key, number in _flat(value, f'{name}[{k}]').items()}
    return {name: values} if isinstance(values, (int, float)) else {}


def _label(axes: Any, title: str, y: str, x: str = _TIME, legend: bool = True) -> None:
    axes.set(title=title, ylabel=y, xlabel=x)
    if legend:
        for line in axes.legend(loc='best', fontsize=7).get_lines():
            line.set_linewidth(max(line.get_linewidth(), 1.2))
