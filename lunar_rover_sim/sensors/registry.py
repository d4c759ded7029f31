"""The sensors of the rover, and their parameters in physics_node.

Cameras and the LiDAR are nodes and rooms of their own.
"""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import group, Parameters
from lunar_rover_sim.base.topics import Topic
from lunar_rover_sim.sensors.feet import FootSlip, Sinkage
from lunar_rover_sim.sensors.imu import Imu, ImuConfig
from lunar_rover_sim.sensors.power_monitor import PowerMonitorConfig, SupplyLines
from lunar_rover_sim.sensors.sensor import Content, Platform, Sensor
from lunar_rover_sim.sensors.solar_panel import SolarPanel, SolarPanelConfig
from lunar_rover_sim.sensors.star_tracker import StarTracker, StarTrackerConfig
from lunar_rover_sim.sensors.sun_sensor import SunSensor, SunSensorConfig
from lunar_rover_sim.sensors.wheel_odometry import LegEncoders, WheelOdometryConfig

# In the order in which they are published and listed.
SENSORS: tuple[type[Sensor], ...] = (
    Imu, FootSlip, Sinkage, LegEncoders, SupplyLines, SunSensor, StarTracker, SolarPanel)


@dataclasses.dataclass(frozen=True)
class SensorsConfig(Parameters):
    """The parameters of each sensor, by its name."""

    gone = {'odometry': {'position_stddev_m': 1e-4, 'orientation_stddev_rad': 1e-4,
                         'linear_stddev_mps': 1e-4, 'angular_stddev_radps': 1e-4}}

    imu: ImuConfig = group(ImuConfig)
    wheel_odometry: WheelOdometryConfig = group(WheelOdometryConfig)
    power_monitor: PowerMonitorConfig = group(PowerMonitorConfig)
    sun_sensor: SunSensorConfig = group(SunSensorConfig)
    star_tracker: StarTrackerConfig = group(StarTrackerConfig)
    solar_panel: SolarPanelConfig = group(SolarPanelConfig)


def _check() -> None:
    """Raise ConfigError unless sensors, topics and parameters belong together.

    What stood in one place only would vanish in silence.
    """
    named = {field.name for field in dataclasses.fields(SensorsConfig)}
    for sensor in SENSORS:
        for topic in sensor.published:
            if topic not in topics.CONTRACT or topic.node != 'physics_node':
                raise ConfigError(f'sensor {sensor.name}: topic {topic.name} is no row of '
                                  'physics_node in CONTRACT of base/topics.py')
        if (sensor.parameters is not None) != (sensor.name in named):
            raise ConfigError(f'sensor {sensor.name}: its parameters are in only one of its class '
                              'and SensorsConfig')
    unknown = named - {sensor.name for sensor in SENSORS}
    if unknown:
        raise ConfigError(f'SensorsConfig: {", ".join(sorted(unknown))}: no such sensor in '
                          'SENSORS')


_check()


def mounted(config: SensorsConfig, platform: Platform) -> list[Sensor]:
    """Return the sensors that are measured while somebody reads them, in the order of SENSORS."""
    return [sensor(getattr(config, sensor.name, None), platform) for sensor in SENSORS
            if not sensor.in_state]


def sensor_of(topic: str) -> type[Sensor] | None:
    """Return the sensor that publishes a topic, by the topic's name; None if none does."""
    found = topics.topic_of(topic)
    return next((sensor for sensor in SENSORS if found in sensor.published), None)


def card_contents() -> dict[Content, tuple[Topic, ...]]:
    """Return what a data card calls the data of sensors → the topics, any of which makes it."""
    found: dict[Content, tuple[Topic, ...]] = {}
    for sensor in SENSORS:
        content = sensor.card()
        found[content] = (*found.get(content, ()), *sensor.published)
    return found
