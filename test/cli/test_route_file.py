"""Places of a file as a route, and the way that a run tells of."""

import os

from command_line import unfolded
import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.cli.run import _Display, _of_absent_nodes, _route
from lunar_rover_sim.run import node_state
from lunar_rover_sim.run.node_state import NodeState, ON_THE_WAY, READY, StateReader, tell


def test_a_route_is_a_shape_or_the_places_of_a_file(tmp_path):
    assert _route('figure_eight') == 'figure_eight'
    file = tmp_path / 'way.csv'
    file.write_text('# to the crater\n10, 2.5\n\n-3,400\n')
    assert _route(str(file)) == [(10.0, 2.5), (-3.0, 400.0)]
    file.write_text('10,2.5\n-3,400\n', encoding='utf-8-sig')
    assert _route(str(file)) == [(10.0, 2.5), (-3.0, 400.0)]
    for text, said in (('10,2\n7\n', "way.csv, line 2: '7': is no place"),
                       ('# none\n', 'no place')):
        file.write_text(text)
        with pytest.raises(ConfigError, match=said):
            _route(str(file))
    file.write_bytes(b'\xff\xfe1,2\n')
    with pytest.raises(ConfigError, match='--route: .*way.csv: cannot be read: it is not UTF-8'):
        _route(str(file))
    with pytest.raises(ConfigError, match='neither a shape nor a file; did you mean figure_eight'):
        _route('figure_eigth')


def test_settings_of_nodes_that_do_not_run_are_named():
    words = ['navigator_node.creep=true', 'drive_node.speed_mps=0.1', 'world.size_m=25.6']
    nodes = ('physics_node', 'drive_node')
    assert _of_absent_nodes(words, nodes, False) == [
        'navigator_node.creep: has no effect, navigator_node is not among the nodes of this run']
    # A route around obstacles is made of the parameters of drive_node, which does not run.
    assert _of_absent_nodes(words, ('navigator_node',), True) == []


@pytest.mark.parametrize('other', ['--goal=8,3', '--route=tour'])
def test_two_who_drive_are_refused(tmp_path, capsys, other):
    assert main(['run', 'baseline', '--teleop', other, '-o', str(tmp_path / 'run')]) == 2
    told = unfolded(capsys.readouterr().err)
    assert f'{other.partition("=")[0]}, --teleop: both are given; valid is one of them' in told
    assert not list(tmp_path.iterdir())


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
