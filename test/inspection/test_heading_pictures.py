"""The figure of heading and power of `bag preview`."""

from pathlib import Path

from matplotlib.figure import Figure
import numpy as np
import pytest
import sensor_items
import synthetic_bag as synthetic

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.inspection.bag_pictures import preview
from lunar_rover_sim.inspection.heading_pictures import FILE, heading_figure

MS = 1_000_000
TITLES = ['sun_sensor/direction: direction in base_link',
          'sun_sensor/direction: angle to the true direction',
          'star_tracker/attitude: error of the attitude', 'wheel/odometry: path',
          'wheel/odometry: distance from the true place', 'wheel/odometry: error of the heading',
          'power: currents that motors draw', 'power']


@pytest.fixture(scope='module')
def items() -> list[synthetic.Item]:
    """Return half a second of truth, and sensors that measure just that."""
    found = synthetic.drive(0.5, only=(topics.ODOM, topics.SUN))
    for ns in range(100 * MS, 501 * MS, 100 * MS):
        found += sensor_items.heading_items(ns) + sensor_items.power_items(ns)
    return found


def drawn(path: Path) -> list[Figure]:
    """Return the figures of a bag, without writing them."""
    figures: list[Figure] = []
    with open_bag(path) as bag:
        heading_figure(bag, lambda figure, name: figures.append(figure))
    return figures


def values(figure: Figure, title: str) -> list[np.ndarray]:
    """Return the heights of the curves of a panel."""
    axes = next(axes for axes in figure.axes if axes.get_title() == title)
    return [np.asarray(line.get_ydata(), float) for line in axes.get_lines()]


def test_true_measurements_have_no_error(tmp_path: Path, items: list[synthetic.Item]) -> None:
    """Angles in double precision; the root of the rounding of a cosine is not in them."""
    figure, = drawn(synthetic.write(tmp_path / 'bag', items))
    assert [axes.get_title() for axes in figure.axes] == TITLES
    assert np.abs(values(figure, TITLES[1])[0]).max() < 1e-9        # [deg]
    for curve in values(figure, TITLES[2])[:3]:
        assert np.abs(curve).max() < 1e-8 * 206265                  # [arcsec]
    assert np.abs(values(figure, TITLES[4])[0]).max() < 1e-9        # [m]
    assert np.abs(values(figure, TITLES[5])[0]).max() < 1e-7        # [deg]


def test_errors_are_those_of_the_messages(tmp_path: Path, items: list[synthetic.Item]) -> None:
    """A sun sensor turned by 2 degrees; what is drawn is positive, power is volts amperes."""
    turned = []
    for item in items:
        if item.topic == topics.SUN_SENSOR.name:
            vector = item.message.vector
            v = np.array([vector.x, vector.y, vector.z])
            across = np.cross(v, [0.0, 0.0, 1.0])
            across /= np.linalg.norm(across)
            angle = np.radians(2.0)
            measured = np.cos(angle) * v + np.sin(angle) * across
            item = synthetic.Item(item.topic, item.msgtype, synthetic.msg(
                'geometry_msgs/Vector3Stamped', header=item.message.header,
                vector=synthetic.vector(measured)))
        turned.append(item)
    figure, = drawn(synthetic.write(tmp_path / 'bag', turned))
    np.testing.assert_allclose(values(figure, TITLES[1])[0], 2.0, atol=1e-9)
    for k, curve in enumerate(values(figure, TITLES[6]), 1):
        np.testing.assert_allclose(curve, 100.0 * k, rtol=1e-6)     # [mA]
    bus, solar = values(figure, TITLES[7])
    np.testing.assert_allclose(bus, 12.0 * 0.5, rtol=1e-6)
    np.testing.assert_allclose(solar, 12.0 * 0.8, rtol=1e-6)


@pytest.mark.parametrize('topic', [topics.WHEEL_ODOM, topics.SOLAR_POWER])
def test_one_topic_is_enough(tmp_path: Path, items: list[synthetic.Item],
                             topic: topics.Topic) -> None:
    bag = synthetic.write(tmp_path / 'bag', [i for i in items if i.topic == topic.name])
    assert [path.name for path in preview(bag, tmp_path / 'out')] == [FILE]
    assert (tmp_path / 'out' / FILE).stat().st_size > 5000


def test_a_sun_that_stands_still_is_in_the_scenario(tmp_path: Path,
                                                    items: list[synthetic.Item]) -> None:
    """Runs without cameras have no topic of the sun, which is at (30, 10) degrees here."""
    text = ('render_node:\n  ros__parameters:\n'
            '    sun: {azimuth_deg: 30.0, elevation_deg: 10.0, date: ""}\n')
    scenario = synthetic.text(topics.SCENARIO, text)
    kept = [item for item in items if item.topic != topics.SUN.name]
    figure, = drawn(synthetic.write(tmp_path / 'bag', [*kept, scenario]))
    assert np.abs(values(figure, TITLES[1])[0]).max() < 1e-9
    figure, = drawn(synthetic.write(tmp_path / 'unknown', kept))
    assert TITLES[1] not in [axes.get_title() for axes in figure.axes]


def test_nothing_is_drawn_without_them(tmp_path: Path, items: list[synthetic.Item]) -> None:
    assert not drawn(synthetic.write(tmp_path / 'bag', [
        item for item in items if item.topic in (topics.ODOM.name, topics.SUN.name)]))
