"""What parameters may be, by what they are: lengths, times, shares, angles."""

import dataclasses
import importlib
import math
import pkgutil
import re

import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import Parameters
from lunar_rover_sim.ground.world.config import CraterConfig, MeshConfig, ReliefConfig, RockConfig
from lunar_rover_sim.image.camera.config import (CameraConfig, CompressionConfig,
                                                 MiscalibrationConfig, SensorConfig)
from lunar_rover_sim.image.illumination.config import LampConfig, SunConfig
from lunar_rover_sim.image.stereo.config import SgmConfig
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.physics.config import ContactConfig, PhysicsConfig

ROOMS = ('ground.world', 'rover.physics', 'ground.regolith', 'rover.gait', 'image.illumination',
         'image.camera', 'image.stereo', 'image.lidar', 'rover', 'autonomy.path_following', 'bag',
         'image.rendering', 'sensors')


def parameter_sets():
    """Return every parameter set of the rooms that can be made without an argument."""
    found = []
    for room in ROOMS:
        package = importlib.import_module(f'lunar_rover_sim.{room}')
        for info in pkgutil.iter_modules(package.__path__, package.__name__ + '.'):
            module = importlib.import_module(info.name)
            found += [kind for kind in vars(module).values() if isinstance(kind, type)
                      and issubclass(kind, Parameters) and kind.__module__ == module.__name__]
    return found


SETS = parameter_sets()

# Units of what cannot be negative; places and coordinates are named otherwise.
MAGNITUDES = {'m', 's', 'Hz', 'Hz/s', '1/s', '1/m', 'N/m', 'N s/m', 'W', 'W/m^2', '1/J', 'e-',
              'e-/s', '%', 'of 255', 'px'}
DIRECTIONS = ('azimuth', 'yaw_deg', 'lon_deg', 'rpy', 'north_deg', 'elevation_deg', 'lat_deg',
              'pitch_deg', 'vertical_')
PLACES = {'x_m', 'y_m', 'position_m', 'aim_m', 'center', 'height_scale',
          'min_disparity'}


def parameters():
    """Return (set, name, info) of every number of the sets, without nested ones."""
    found = []
    for kind in SETS:
        for field in dataclasses.fields(kind):
            value = getattr(kind(), field.name)
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                found.append((kind, field.name, field.metadata['info']))
    return found


def chosen(keep):
    return [pytest.param(kind, name, id=f'{kind.__name__}.{name}')
            for kind, name, info in parameters() if keep(name, info)]


def refuses(kind, name, value):
    """Return whether a value is out of the range of its parameter."""
    try:
        kind(**{name: value})
    except ConfigError as error:
        return f'{name}: {value}' in str(error)
    return False


def a_little(kind, name):
    """Return the smallest step that counts for a parameter."""
    return 1 if isinstance(getattr(kind(), name), int) else 1e-9


@pytest.mark.parametrize('kind,name', chosen(
    lambda name, info: info.unit in MAGNITUDES and name not in PLACES and '-1' not in info.doc))
def test_a_magnitude_is_not_negative(kind, name):
    assert refuses(kind, name, -a_little(kind, name))


@pytest.mark.parametrize('kind,name', chosen(
    lambda name, info: any(word in info.doc for word in ('0:', '0 switches', '0 keeps',
                                                         '0 trusts', '0 matches'))))
def test_a_zero_that_has_a_meaning_is_valid(kind, name):
    assert getattr(kind(**{name: type(getattr(kind(), name))(0)}), name) == 0


@pytest.mark.parametrize('kind,name', [
    *[(ContactConfig, field.name) for field in dataclasses.fields(ContactConfig)],
    *[(GaitConfig, name) for name in ('duty_factor', 'foot_width_deg', 'max_angle_lead_deg',
                                      'max_phase_rate_hz', 'max_yaw_rate_radps', 'cmd_timeout_s',
                                      'phase_acceleration_hzps', 'settle_rate_hz', 'blend_time_s',
                                      'max_joint_velocity_radps')],
    (CraterConfig, 'min_diameter_m'), (CraterConfig, 'max_diameter_m'), (MeshConfig, 'scale'),
    (ReliefConfig, 'baseline_m'), (ReliefConfig, 'far_baseline_m'), (SensorConfig, 'exposure_s')])
def test_what_is_divided_by_or_never_ends_at_zero_is_greater(kind, name):
    """Without friction, stiffness, acceleration or time nothing would ever hold or happen."""
    assert refuses(kind, name, 0.0)


@pytest.mark.parametrize('kind,name', chosen(
    lambda name, info: info.doc.startswith(('share', 'fraction', 'mean fraction', 'k: area'))))
def test_a_share_is_not_more_than_the_whole(kind, name):
    assert refuses(kind, name, 1.0 + 1e-9) and refuses(kind, name, -1e-9)


@pytest.mark.parametrize('kind,name,least,most', [
    (SunConfig, 'elevation_deg', -90.0, 90.0), (LampConfig, 'pitch_deg', -90.0, 90.0),
    (LampConfig, 'cone_deg', 0.0, 180.0), (CameraConfig, 'horizontal_fov_deg', 0.0, 180.0),
    (ReliefConfig, 'rms_slope_deg', 0.0, 90.0), (ReliefConfig, 'far_rms_slope_deg', 0.0, 90.0),
    (RockConfig, 'tilt_deg', 0.0, 90.0), (GaitConfig, 'max_angle_lead_deg', 0.0, 120.0),
    (ReliefConfig, 'hurst', 0.0, 1.0), (ReliefConfig, 'far_hurst', 0.0, 1.0),
    (SgmConfig, 'uniqueness_percent', 0, 100), (SgmConfig, 'dark_level', 0, 255),
    (SensorConfig, 'target_level', 0.0, 1.0), (SensorConfig, 'auto_lag', 0.0, 1.0),
    (SensorConfig, 'transmission', 0.0, 1.0), (SensorConfig, 'black_level', 0.0, 1.0),
    (SensorConfig, 'bits', 8, 16)])
def test_beyond_what_geometry_allows_nothing_is_valid(kind, name, least, most):
    step = a_little(kind, name)
    assert refuses(kind, name, least - step) and refuses(kind, name, most + step)


@pytest.mark.parametrize('kind,name,values', [
    (GaitConfig, 'stance_smoothing', (0.0, 1.0)), (GaitConfig, 'flight_smoothing', (0.05, 1.0)),
    (GaitConfig, 'position_gain', (0.0, 20.0)), (GaitConfig, 'velocity_gain', (0.0, 1.0)),
    (SunConfig, 'elevation_deg', (-0.5, 0.0, 90.0)), (SunConfig, 'azimuth_deg', (-180.0, 360.0)),
    (LampConfig, 'pitch_deg', (-90.0, 0.0, 90.0)), (PhysicsConfig, 'gravity_mps2', (0.0, 9.81)),
    (CraterConfig, 'slope', (1.5, 2.0, 3.0)), (RockConfig, 'burial', (0.1, 0.5, 0.8)),
    (SensorConfig, 'bits', (8, 10, 12, 14, 16)), (SensorConfig, 'f_number', (0.95, 22.0)),
    (CompressionConfig, 'png_level', (0, 9)), (CompressionConfig, 'jpeg_quality', (1, 100)),
    (MiscalibrationConfig, 'rotation_deg', (0.0, 2.0)),
    (MiscalibrationConfig, 'focal_percent', (0.0, 5.0)),
    (CameraConfig, 'width', (160, 1920, 4096)), (SgmConfig, 'block_size', (1, 3, 21)),
    (ReliefConfig, 'hurst', (0.1, 0.5, 0.95)), (GaitConfig, 'cmd_timeout_s', (0.02, 3600.0))])
def test_what_somebody_may_ask_for_is_valid(kind, name, values):
    for value in values:
        assert getattr(kind(**{name: value}), name) == value


def ends(kind, name):
    """Return least and greatest valid value."""
    info = next(field.metadata['info'] for field in dataclasses.fields(kind) if field.name == name)
    return info.low, info.high


def names(*words):
    """Return all parameters whose name holds one of the words, also those that are lists."""
    return [pytest.param(kind, field.name, id=f'{kind.__name__}.{field.name}')
            for kind in SETS for field in dataclasses.fields(kind)
            if 'info' in field.metadata and any(word in field.name for word in words)]


@pytest.mark.parametrize('kind,name', [
    parameter for parameter in names('azimuth', 'yaw_deg', 'lon_deg', 'rpy', 'north_deg')
    if ends(*parameter.values) != (None, None)])
def test_a_direction_may_be_given_as_a_whole_turn_either_way(kind, name):
    """-180 to 180 and 0 to 360 are both in use."""
    assert ends(kind, name) == (-360.0, 360.0)


@pytest.mark.parametrize('kind,name', names('distortion', 'scale_error', 'misalignment',
                                            'position_m', 'lat_deg', 'pitch_deg'))
def test_what_may_go_either_way_may_go_as_far(kind, name):
    low, high = ends(kind, name)
    assert low == high is None or low == -high < 0.0


@pytest.mark.parametrize('kind,name', names('elevation_deg', 'lat_deg', 'pitch_deg', 'hood_deg'))
def test_nothing_is_higher_than_the_zenith(kind, name):
    low, high = ends(kind, name)
    assert -90.0 <= low < high <= 90.0 and high > 88.0


@pytest.mark.parametrize('kind,name', chosen(
    lambda name, info: info.doc.startswith(('standard deviation', 'RMS', 'error ', 'white noise',
                                            'random walk', 'step of', 'relative error'))))
def test_an_error_or_a_variation_may_be_nothing(kind, name):
    assert getattr(kind(**{name: 0.0}), name) == 0.0


def test_parameter_sets_cannot_be_changed():
    for kind in SETS:
        one = kind()
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(one, dataclasses.fields(kind)[0].name, None)


@pytest.mark.parametrize('kind,name', [
    pytest.param(kind, name, id=f'{kind.__name__}.{name}') for kind, name, info in parameters()
    if info.low is not None and name not in PLACES and ' adds ' not in info.doc
    and not (info.unit == 'deg' and any(word in name for word in DIRECTIONS))])
def test_what_is_no_direction_and_no_place_is_not_negative(kind, name):
    """But for -1, where it means something else."""
    info = kind.__dataclass_fields__[name].metadata['info']
    assert info.low >= 0.0 or (
        info.low == -1 and ('-1' in info.doc or getattr(kind(), name) == -1))


@pytest.mark.parametrize('kind', [kind for kind in SETS if hasattr(kind, 'height')])
def test_an_image_may_be_as_wide_as_high(kind):
    assert ends(kind, 'width') == ends(kind, 'height')


@pytest.mark.parametrize('kind', SETS, ids=lambda kind: kind.__name__)
def test_a_bound_that_is_not_valid_itself_is_nothing(kind):
    """Any length, time or angle that is greater than 0 may be small."""
    for field in dataclasses.fields(kind):
        info = field.metadata.get('info')
        assert info is None or not info.open_low or info.low == 0.0


@pytest.mark.parametrize('kind', [CompressionConfig])
def test_what_only_the_next_message_depends_on_is_live(kind):
    assert all(field.metadata['info'].live for field in dataclasses.fields(kind)
               if field.name != 'enabled')


# Bounds that are not round, and why. A bound is to be remembered: one that is odd has a reason.
REASONS = {
    'CraterConfig.irregularity.high': 'the radii of an outline would cross',
    'DetailConfig.relief_shape_m.high': 'half of the map of heights around the cameras',
    'GaitConfig.spokes.high': 'a dozen', 'Legs.spokes.high': 'a dozen',
    'GroundConfig.friction.high': 'the tangent of 58 deg',
    'HazardCameraConfig.horizontal_fov_deg.high': 'the widest lens that is sold',
    'HazardCameraConfig.image_circle_deg.high': 'the widest lens that is sold',
    'SunSensorConfig.field_of_view_deg.high': 'short of what a plane could see',
    'StarTrackerConfig.cross_arcsec.high': 'ten degrees',
    'StarTrackerConfig.roll_arcsec.high': 'ten degrees',
    'SgmConfig.pre_filter_cap.high': 'of OpenCV',
}


def is_round(bound):
    """Return whether a bound has one digit, is of powers of two, a known angle, or just below."""
    def one_digit(value):
        return value == 0 or float(f'{value:.0e}') == value

    size = abs(bound)
    return (one_digit(size) or size % 15 == 0 and size <= 360
            or any(math.log2(size + more).is_integer() for more in (-1, 0, 1)
                   if size >= 2 and size == int(size) and size + more > 0)
            or any(one_digit(round(whole - size, 9)) and 0.0 < whole - size <= 0.1 * whole
                   for whole in (1.0, 90.0)))


@pytest.mark.parametrize('kind', SETS, ids=lambda kind: kind.__name__)
def test_bounds_are_round_numbers_or_have_a_reason(kind):
    odd = [f'{kind.__name__}.{field.name}.{end}' for field in dataclasses.fields(kind)
           if 'info' in field.metadata
           for end in ('low', 'high')
           if (bound := getattr(field.metadata['info'], end)) is not None and not is_round(bound)]
    assert [name for name in odd if name not in REASONS] == []


OVERRIDES = [pytest.param(kind, name, *map(float, span.groups()), id=f'{kind.__name__}.{name}')
             for kind, name, info in parameters()
             for span in [re.search(r'([-.\de+]+) to ([-.\de+]+); -1:', info.doc)] if span]


@pytest.mark.parametrize('kind,name,low,high', OVERRIDES)
def test_what_replaces_a_known_value_has_bounds_of_its_own(kind, name, low, high):
    """-1 leaves the known value; else the bounds hold that the documentation names."""
    for value in (-1.0, low, high):
        assert getattr(kind(**{name: value}), name) == value
    for value in (-1.0 - 1e-9, -1.0 + 1e-9, -1e-9, low - 1e-9, high * (1.0 + 1e-9)):
        with pytest.raises(ConfigError, match=name):
            kind(**{name: value})
    assert is_round(low) and (is_round(high) or f'{kind.__name__}.{name}.high' in REASONS)


def test_round_numbers():
    """One more or one less than a bound of two digits is not round."""
    for bound in (45.0, 90, 360.0, 64, 65, 4097, 8192, 0.99, 0.9, 0.3, 1e-5, 20000, 89.0, 100):
        assert is_round(bound) and is_round(-bound)
    for bound in (46.0, 44.0, 91, 359.0, 101, 99, 1.3, 1.5, 1.99, 20001, 1.005, 8190, 61.0):
        assert not is_round(bound)
