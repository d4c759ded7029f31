"""Places of a file as a route, and the way that a run tells of."""

import os

import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.cli.run import _Display, _route
from lunar_rover_sim.run import node_state
from lunar_rover_sim.run.node_state import NodeState, ON_THE_WAY, READY, StateReader, tell


def test_a_route_is_a_shape_or_the_places_of_a_file(tmp_path):
    assert _route('figure_eight') == 'figure_eight'
    file = tmp_path / 'way.csv'
    file.write_text('# to the crater\n10, 2.5\n\n-3,400\n')
    assert _route(str(file)) == [(10.0, 2.5), (-3.0, 400.0)]
    for text, said in (('10,2\n7\n', "way.csv, line 2: '7': is no place"),
                       ('# none\n', 'no place')):
        file.write_text(text)
        with pytest.raises(ConfigError, match=said):
            _route(str(file))
    with pytest.raises(ConfigError, match='neither a shape nor a file; did you mean figure_eight'):
        _route('figure_eigth')


def test_the_newest_way_is_kept_beside_the_states(monkeypatch):
    reader = StateReader()
    monkeypatch.setenv(node_state.VARIABLE, str(reader.writer))
    tell(NodeState(READY))
    for driven in (1.0, 2.5):
        tell(NodeState(ON_THE_WAY, driven_m=driven, left_m=10.0 - driven))
    assert [state.state for state in reader.read()] == [READY]
    assert reader.way is not None and (reader.way.driven_m, reader.way.left_m) == (2.5, 7.5)
    os.close(reader.writer)
    reader.close()


def test_progress_is_by_distance_once_the_way_is_known():
    class Shown:
        def __init__(self):
            self.told = []

        def start(self, *what):
            self.told.append(what)

        def __call__(self, *what, note=''):
            self.told.append(what)

    shown = Shown()
    display = _Display(shown)
    display.update(1_000_000_000)
    display.way(2.0, 8.0)
    display.update(2_000_000_000)
    display.way(6.0, 5.0)
    display.update(3_000_000_000)
    assert ('driving', 10.0, 'm') in shown.told
    assert [told[:2] for told in shown.told[-1:]] == [(6.0, 11.0)]
