"""Defaults of parameters that are known: from nature, data sheets and animals."""

import math

import pytest

from lunar_rover_sim.ground.world.config import CraterConfig
from lunar_rover_sim.image.camera.chase import ChaseCameraConfig, ChaseConfig
from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.camera.hazard import HazardCameraConfig, HazardConfig
from lunar_rover_sim.image.illumination.config import EarthConfig, LampConfig, SunConfig
from lunar_rover_sim.rover.description import Legs, RoverDescription
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.physics.config import ContactConfig, PhysicsConfig
from lunar_rover_sim.sensors.power_monitor import PowerMonitorConfig
from lunar_rover_sim.sensors.solar_panel import SolarPanelConfig
from lunar_rover_sim.sensors.star_tracker import StarTrackerConfig
from lunar_rover_sim.sensors.sun_sensor import SunSensorConfig


def test_defaults_that_are_known_from_nature():
    """The Moon's gravity, the solar constant (Kopp & Lean 2011), the sun's apparent diameter."""
    assert PhysicsConfig().gravity_mps2 == pytest.approx(1.625, abs=0.01)
    assert SunConfig().irradiance == pytest.approx(1360.8, abs=0.5)
    diameter = 2.0 * math.degrees(math.asin(6.957e8 / 1.496e11))
    assert SunConfig().angular_diameter_deg == pytest.approx(diameter, abs=0.005)
    # Angle of internal friction of lunar soil: 30 to 50 deg (Lunar Sourcebook, ch. 9).
    assert math.tan(math.radians(30.0)) < ContactConfig().sliding_friction \
        < math.tan(math.radians(50.0))
    # Simple craters: depth a fifth of the diameter, rim 4 % (Pike 1977).
    assert CraterConfig().fresh_depth == pytest.approx(0.2, abs=0.02)
    assert CraterConfig().fresh_rim == pytest.approx(0.04, abs=0.01)


def test_the_default_sensor_is_four_pixels_of_its_data_sheet():
    """Sony IMX273: 3.45 um, 10.7 ke-, 2.3 e- of read noise, 12 bits; summed over 2 x 2."""
    sensor = SensorConfig()
    assert sensor.pixel_pitch_m == pytest.approx(2 * 3.45e-6)
    assert sensor.full_well_e == pytest.approx(4 * 10_700)
    assert sensor.read_noise_e == pytest.approx(math.sqrt(4) * 2.3)
    assert sensor.bits == 12 and sensor.encoding == 'mono8'
    # Natural vignetting is the fourth power of the cosine, whole.
    assert sensor.vignetting == 1.0
    assert sensor.shot_noise and sensor.read_noise and sensor.fixed_pattern
    # Photons of sunlight carry 2 to 4e-19 J: fewer electrons than one for each.
    assert 1e17 < sensor.electrons_per_joule < 1.0 / 3e-19


def test_the_instruments_of_the_default_rover_are_those_of_their_data_sheets():
    """They stand on the deck behind the mast; monitors measure up to 4 A; Earth's albedo in V."""
    chassis = RoverDescription().chassis
    for instrument in (SunSensorConfig(), StarTrackerConfig(), SolarPanelConfig()):
        x, y, z = instrument.position_m
        assert -0.5 * chassis.length_m < x < 0.0 and abs(y) < 0.5 * chassis.width_m
        assert 0.5 * chassis.height_m < z < chassis.height_m
    power = PowerMonitorConfig()
    assert power.shunt_range_v / power.shunt_ohm == pytest.approx(4.096)
    assert power.shunt_ohm == 0.02
    assert EarthConfig().geometric_albedo == 0.434


def test_gait_arrays_are_those_of_animals():
    """Of a pace the legs of one side move together, of a bound those in front."""
    left_front, right_front, left_rear, right_rear = GaitConfig(gait='bound').offsets(Legs())
    assert left_front == right_front and left_rear == right_rear
    assert (left_front - left_rear) % 1.0 == 0.5
    left_front, right_front, left_rear, right_rear = GaitConfig(gait='pace').offsets(Legs())
    assert left_front == left_rear and right_front == right_rear
    assert (left_front - right_front) % 1.0 == 0.5


def test_the_default_images_have_usual_shapes():
    """4 : 3 for the sensors of the rover, 16 : 9 for the film."""
    for camera, wide, high in ((CameraConfig(), 4, 3), (HazardCameraConfig(), 4, 3),
                               (ChaseCameraConfig(), 16, 9)):
        assert camera.width * high == camera.height * wide


def test_the_default_rover_walks_as_a_trot_with_three_spokes():
    """Feet of one diagonal together, a pitch of 120 deg, more stance than flight."""
    gait = GaitConfig()
    assert gait.pitch_rad == pytest.approx(2.0 * math.pi / 3.0)
    left_front, right_front, left_rear, right_rear = gait.offsets(Legs())
    assert left_front == right_rear and right_front == left_rear
    assert (left_front - right_front) % 1.0 == 0.5
    assert 0.5 < gait.duty_factor < 0.75
    assert gait.foot_width_deg == pytest.approx(math.degrees(gait.pitch_rad) / 2.0)


def test_the_default_lamp_shows_relief_to_the_cameras():
    """It sits beside the cameras and below them, at the front: what it lights casts shadows."""
    x, y, z = LampConfig().position_m
    mount = RoverDescription().stereo
    assert 0.0 < z < mount.position_m[2]
    assert mount.baseline_m / 2.0 < y < 0.15
    assert abs(x - mount.position_m[0]) < 0.1


def test_what_is_extra_is_off_until_it_is_asked_for():
    assert not ChaseConfig().enabled and LampConfig().power_w == 0.0
    assert not SunConfig().allow_night and not EarthConfig().lights_ground
    assert not HazardConfig().stereo
