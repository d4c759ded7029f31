"""A figure of what the sensors of the rover say over a recorded drive: a panel a topic."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from matplotlib.figure import Figure

from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.sensors.registry import SENSORS
from lunar_rover_sim.sensors.sensor import Sensor

FILE = 'sensors.png'
_PANEL = 5.5, 2.7       # its size [inch]
# `imu.png` shows it.
_SHOWN_ELSEWHERE = (topics.IMU_RAW,)


def sensor_figure(bag: Bag, save: Callable[[Figure, str], None]) -> None:
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
        _draw(axes, bag, name, sensor)
    for axes in list(panels):
        axes.set_axis_off()
    save(figure, FILE)


def _draw(axes: Any, bag: Bag, name: str, sensor: type[Sensor]) -> None:
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
