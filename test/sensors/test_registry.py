"""What holds of all sensors."""

from lunar_rover_sim import topics
from lunar_rover_sim.run.node_config import PhysicsNodeConfig
from lunar_rover_sim.sensors.power_monitor import PowerMonitorConfig
from lunar_rover_sim.sensors.registry import card_contents, sensor_of, SENSORS, SensorsConfig
from lunar_rover_sim.sensors.star_tracker import StarTrackerConfig
from lunar_rover_sim.sensors.sun_sensor import SunSensorConfig


def test_each_has_its_own_name_topics_and_stream() -> None:
    names = [sensor.name for sensor in SENSORS]
    published = [topic for sensor in SENSORS for topic in sensor.published]
    streams = [sensor.stream for sensor in SENSORS if sensor.stream]
    for values in (names, published, streams):
        assert len(values) == len(set(values))
    assert set(published) <= set(topics.CONTRACT)


def test_what_is_made_on_request_of_states_is_of_a_sensor() -> None:
    """But for maps of the ground, and diagnostics."""
    others = topics.GROUND_SNAPSHOT, topics.DIAGNOSTICS
    for topic in topics.CONTRACT:
        if topic.node == 'physics_node' and topic.on_request and topic not in others:
            assert sensor_of(topic.name) is not None, topic.name
    assert sensor_of(topics.ODOM.name) is None


def test_parameters_stand_under_the_name_of_their_sensor() -> None:
    for sensor in SENSORS:
        config = getattr(SensorsConfig(), sensor.name, None)
        assert (config is None) == (sensor.parameters is None)
        assert sensor.parameters is None or isinstance(config, sensor.parameters)
    config = PhysicsNodeConfig()
    assert (config.power_monitor, config.sun_sensor, config.star_tracker) == (
        PowerMonitorConfig(), SunSensorConfig(), StarTrackerConfig())


def test_each_has_a_place_on_the_data_card() -> None:
    found = card_contents()
    assert {topic for published in found.values() for topic in published} == {
        topic for sensor in SENSORS for topic in sensor.published}
    assert {'imu', 'feet', 'heading', 'power'} <= {content.name for content in found}
