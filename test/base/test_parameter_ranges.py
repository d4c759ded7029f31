"""What parameters may be, by what they are: lengths, times, shares, angles."""

import dataclasses
import importlib
import pkgutil
import re

import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import Parameters
from lunar_rover_sim.ground.world.config import CraterConfig, MeshConfig, ReliefConfig
from lunar_rover_sim.image.camera.config import SensorConfig
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.physics.config import ContactConfig

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
    lambda name, info: any(word in info.doc for word in ('0:', '0 keeps', '0 matches'))))
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
    lambda name, info: info.doc.startswith(('share', 'fraction', 'mean share', 'k: area'))))
def test_a_share_is_not_more_than_the_whole(kind, name):
    assert refuses(kind, name, 1.0 + 1e-9) and refuses(kind, name, -1e-9)


def test_parameter_sets_cannot_be_changed():
    for kind in SETS:
        one = kind()
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(one, dataclasses.fields(kind)[0].name, None)


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
