"""Values of the domain are frozen: nobody can change a pose, a catalogue or a setting in place."""

import dataclasses
import importlib
import pkgutil

import pytest

import lunar_rover_sim
from lunar_rover_sim.errors import one_line

ROOMS = ('world', 'regolith', 'physics', 'gait', 'illumination', 'sensors', 'camera', 'stereo',
         'evaluation')
# The renderer completes what it sees of the sun while a frame is drawn.
GROWING = {'ImagedSun'}


def value_classes():
    for room in ROOMS:
        package = importlib.import_module(f'lunar_rover_sim.{room}')
        for module in pkgutil.iter_modules(package.__path__, package.__name__ + '.'):
            for kind in vars(importlib.import_module(module.name)).values():
                if isinstance(kind, type) and dataclasses.is_dataclass(kind) \
                        and kind.__module__ == module.name and kind.__name__ not in GROWING:
                    yield pytest.param(kind, id=f'{module.name}.{kind.__name__}')


@pytest.mark.parametrize('kind', list(value_classes()))
def test_is_frozen(kind):
    assert kind.__dataclass_params__.frozen


def test_rooms_exist():
    assert set(ROOMS) <= {m.name for m in pkgutil.iter_modules(lunar_rover_sim.__path__)}


def test_reasons_are_one_line() -> None:
    """An error without words gives the name of its class."""
    assert one_line('a\n  b\tc ') == 'a b c'
    assert one_line(ValueError('not\nthis')) == 'not this'
    assert one_line(KeyError()) == 'KeyError' and one_line('') == ''
