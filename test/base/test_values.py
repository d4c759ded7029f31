"""Values of the domain are frozen: nobody can change a pose, a catalogue or a setting in place."""

import dataclasses
import importlib
import pkgutil

import pytest

import lunar_rover_sim
from lunar_rover_sim.base.errors import one_line
from lunar_rover_sim.base.seconds import from_seconds, in_seconds, NS_PER_S

ROOMS = ('ground.world', 'ground.regolith', 'rover.physics', 'rover.gait', 'image.illumination',
         'sensors', 'image.camera', 'image.stereo', 'judge.evaluation')
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
    assert {room.partition('.')[0] for room in ROOMS} <= {
        m.name for m in pkgutil.iter_modules(lunar_rover_sim.__path__)}


def test_reasons_are_one_line() -> None:
    """An error without words gives the name of its class."""
    assert one_line('a\n  b\tc ') == 'a b c'
    assert one_line(ValueError('not\nthis')) == 'not this'
    assert one_line(KeyError()) == 'KeyError' and one_line('') == ''


@pytest.mark.parametrize('time_ns', [
    0, 1, -1, NS_PER_S, -1_500_000_000, 1_700_000_000_123_456_789, -(1 << 62)])
def test_text_reads_back_exactly(time_ns: int) -> None:
    """Also what a float does not hold."""
    assert from_seconds(in_seconds(time_ns)) == time_ns


@pytest.mark.parametrize('text, time_ns', [
    ('2', 2 * NS_PER_S), ('.5', NS_PER_S // 2), ('+1.25', 1_250_000_000), ('-0.5', -NS_PER_S // 2),
    ('1.0000000019', NS_PER_S + 1), ('1.5e3', 1500 * NS_PER_S)])
def test_spellings(text: str, time_ns: int) -> None:
    """Signs, missing digits, more than nine decimals, exponents."""
    assert from_seconds(text) == time_ns


@pytest.mark.parametrize('text', ['', '.', 'x', 'nan', 'inf', '1.2.3'])
def test_what_is_no_time(text: str) -> None:
    """Readers of files name the line."""
    with pytest.raises((ValueError, OverflowError)):
        from_seconds(text)
