"""Defaults of parameters that are known: from nature, a data sheet and animals."""

import math

import pytest

from lunar_rover_sim.ground.world.config import CraterConfig
from lunar_rover_sim.image.camera.config import SensorConfig
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.rover.description import Legs
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.physics.config import ContactConfig, PhysicsConfig


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


def test_gait_arrays_are_those_of_animals():
    """Of a pace the legs of one side move together, of a bound those in front."""
    left_front, right_front, left_rear, right_rear = GaitConfig(gait='bound').offsets(Legs())
    assert left_front == right_front and left_rear == right_rear
    assert (left_front - left_rear) % 1.0 == 0.5
    left_front, right_front, left_rear, right_rear = GaitConfig(gait='pace').offsets(Legs())
    assert left_front == left_rear and right_front == right_rear
    assert (left_front - right_front) % 1.0 == 0.5
