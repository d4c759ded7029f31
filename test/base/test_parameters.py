"""Parameter sets: declaration, checks, errors that name the parameter, round trip."""

import dataclasses
import math

import numpy as np
import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import (group, merge, Named, named, nest, param, Parameters,
                                             replaced)
from lunar_rover_sim.run.node_config import PhysicsNodeConfig


@dataclasses.dataclass(frozen=True)
class Inner(Parameters):
    """A nested set."""

    gone = {'colour': 'red'}

    size_m: float = param(1.0, 'size', unit='m', low=0.0, open_low=True)
    kind: str = param('a', 'kind', choices=('a', 'b'))


@dataclasses.dataclass(frozen=True)
class Outer(Parameters):
    """A set with every type."""

    count: int = param(3, 'count', low=0, high=10)
    on: bool = param(True, 'on')
    offsets: tuple[float, ...] = param((0.0, 0.5), 'offsets', low=0.0, high=1.0, length=2)
    names: tuple[str, ...] = param((), 'names')
    inner: Inner = group(Inner)
    own: Named[Inner] = named(Inner)

    def validate(self) -> None:
        """Tie two fields together."""
        if self.count == 7 and not self.on:
            raise ConfigError('count: 7 is not valid while on is false')


def test_round_trip() -> None:
    """What `to_mapping` writes, `from_mapping` reads; dotted names are the same thing."""
    outer = Outer.from_mapping({'count': 4, 'inner.size_m': 2, 'inner.kind': 'b',
                                'offsets': [0, 1], 'names': ['x']})
    assert outer.inner == Inner(2.0, 'b')
    assert isinstance(outer.inner.size_m, float)
    assert outer.offsets == (0.0, 1.0)
    assert Outer.from_mapping(outer.to_mapping()) == outer
    assert {name for name, *_ in outer.flatten()} == {
        'count', 'on', 'offsets', 'names', 'inner.size_m', 'inner.kind'}


def test_parameters_of_earlier_versions(caplog: pytest.LogCaptureFixture) -> None:
    """They are left out; it is said of a value that was not the default."""
    assert Outer.from_mapping({'inner.colour': 'red', 'inner.size_m': 2.0}).inner == Inner(2.0)
    assert not caplog.records
    assert Outer.from_mapping({'inner': {'colour': 'blue'}}).inner == Inner()
    assert caplog.messages == ["inner.colour: there is no such parameter any more; 'blue' is "
                               'ignored']


def test_sets_that_users_name() -> None:
    """Each name adds a set with its own values; in documentation it stands for all of them."""
    outer = Outer.from_mapping({'own.left.size_m': 2, 'own': {'right': {'kind': 'b'}}})
    assert dict(outer.own) == {'left': Inner(2.0), 'right': Inner(kind='b')}
    assert Outer.from_mapping(outer.to_mapping()) == outer
    assert 'own' not in Outer().to_mapping()
    assert repr(Outer.from_mapping({'own.left.size_m': 2}).own) == \
        "Named({'left': Inner(size_m=2.0, kind='a')})"
    assert [name for name, *_ in outer.flatten() if name.startswith('own')] == [
        'own.left.size_m', 'own.left.kind', 'own.right.size_m', 'own.right.kind']
    assert [name for name, *_ in outer.flatten(documented=True) if name.startswith('own')] == [
        'own.NAME.size_m', 'own.NAME.kind']


@pytest.mark.parametrize(('values', 'named'), [
    ({'own': {'Left': {}}}, 'own: '), ({'own': {'left': 3}}, 'own.left: '), ({'own': 3}, 'own: '),
    ({'own.left.sizem': 3}, 'own.left.sizem: '), ({'inner': {'sizem': 1}}, 'inner.sizem: '),
    ({'cuont': 1}, 'cuont: '), ({'count': 11}, 'count: 11'), ({'count': 1.5}, 'count: 1.5'),
    ({'count': True}, 'count: True'), ({'on': 1}, 'on: 1'), ({'offsets': [0.1]}, 'offsets: '),
    ({'offsets': [0.1, 1.1]}, 'offsets: 1.1'), ({'offsets': 0.1}, 'offsets: 0.1'),
    ({'names': 'abc'}, "names: 'abc'"), ({'inner.size_m': 0}, 'inner.size_m: 0.0'),
    ({'inner.size_m': math.nan}, 'inner.size_m: nan'),
    ({'inner.size_m': 'big'}, "inner.size_m: 'big'"), ({'inner.kind': 5}, 'inner.kind: 5'),
    ({'inner.kind': 'c'}, "inner.kind: 'c'"), ({'inner': 3}, 'inner: 3'),
    ({'count': 7, 'on': False}, 'count: 7'), ({1: 2}, '')])
def test_errors_name_the_parameter(values: dict, named: str) -> None:
    """Every mistake is one line with name and value."""
    with pytest.raises(ConfigError) as error:
        Outer.from_mapping(values, 'o')
    assert not named or str(error.value).startswith(f'o.{named}')
    assert '\n' not in str(error.value)


def test_what_is_meant_and_what_is_valid_is_said() -> None:
    with pytest.raises(ConfigError, match='did you mean size_m'):
        Outer.from_mapping({'inner.sizem': 1})
    with pytest.raises(ConfigError, match='valid is 0 to 10'):
        Outer(count=-1)


def test_nest_and_merge() -> None:
    """Dotted and nested names meet; the later value wins."""
    assert nest({'a.b': 1, 'a': {'c': 2}}) == {'a': {'b': 1, 'c': 2}}
    assert merge({'a': {'b': 1, 'c': 2}}, {'a': {'b': 3}}) == {'a': {'b': 3, 'c': 2}}


def test_numbers_and_arrays_of_numpy_are_taken() -> None:
    """They become the plain values that they stand for, and are bounded as those are."""
    outer = Outer(count=np.int64(4), on=np.bool_(False), offsets=np.array([0.25, 1.0]),
                  inner=Inner(size_m=np.float32(2.5)))
    assert outer == Outer(4, False, (0.25, 1.0), (), Inner(2.5))
    assert type(outer.count) is int and type(outer.inner.size_m) is float
    with pytest.raises(ConfigError, match='count: 11 is not valid'):
        Outer(count=np.int64(11))
    with pytest.raises(ConfigError, match='size_m: nan is not a finite number'):
        Inner(size_m=np.float64('nan'))


def test_dotted_names_replace_values_of_nested_sets() -> None:
    """Values of one set are replaced together, so that what ties them is checked once."""
    config = PhysicsNodeConfig()
    changed = replaced(config, {'wait.topics': ('a',), 'wait.lags_s': (0.5,),
                                'state_rate_hz': 100, 'contact.sliding_friction': 0.7})
    assert changed.wait.lag_ns_by_topic() == {'a': 500_000_000}
    assert (changed.state_rate_hz, changed.contact.sliding_friction) == (100, 0.7)
    assert dataclasses.replace(changed, wait=config.wait, contact=config.contact,
                               state_rate_hz=200) == config
    with pytest.raises(ConfigError, match='lags_s: 0 elements given for 1'):
        replaced(config, {'wait.topics': ('a',)})
