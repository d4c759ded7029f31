"""Names of stages, missing OpenUSD, nothing half-written."""

from pathlib import Path
import sys

from command_line import unfolded
import pytest

from lunar_rover_sim.base.errors import UsdError
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.products.usd import world_stage
from lunar_rover_sim.products.usd.rover_stage import write_rover
from lunar_rover_sim.products.usd.stage import write_stage
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.urdf import urdf


def fails(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command that is to fail; return its one line."""
    assert main(arguments) == 1
    error = unfolded(capsys.readouterr().err)
    assert error.count('\n') == 1
    return error


@pytest.mark.parametrize(('name', 'match'), [
    ('rover', 'no suffix is not valid'), ('rover.obj', '.obj is not valid; valid'),
    ('a[1].usd', r'must not hold \[ \]'), ('a@b.usda', 'must not hold @'),
    ('nowhere/rover.usd', 'there is no folder')])
def test_names_of_files(name: str, match: str, tmp_path: Path) -> None:
    with pytest.raises(UsdError, match=match):
        write_rover(RoverDescription(), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('name', ['', '1a', 'two words', 'a/b', 'Mond-1'])
def test_names_of_prims(name: str, tmp_path: Path) -> None:
    with pytest.raises(UsdError, match='^name: .* is not valid'):
        write_rover(RoverDescription(), tmp_path / 'r.usd', name=name)
    assert list(tmp_path.iterdir()) == []


def test_existing_output(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither a stage nor the parts of one are replaced, unless that is said."""
    output = tmp_path / 'r.usda'
    assert main(['rover', 'export', '-o', str(output)]) == 0
    before = output.read_bytes()
    assert 'exists already' in fails(['rover', 'export', '-o', str(output)], capsys)
    # The parts of r.usda and r.usd have one name.
    assert 'r_parts: exists already' in fails(
        ['rover', 'export', '-o', str(output.with_suffix('.usd'))], capsys)
    assert output.read_bytes() == before
    assert main(['rover', 'export', '-o', str(output), '--name', 'Walker', '--overwrite']) == 0
    assert b'defaultPrim = "Walker"' in output.read_bytes()
    assert sorted(f.name for f in tmp_path.iterdir()) == ['r.usda', 'r_parts']


def test_nothing_is_left_of_a_failure(moon: World, tmp_path: Path,
                                      monkeypatch: pytest.MonkeyPatch) -> None:
    """An error after the ground is written; the disk being full; OpenUSD's own errors."""
    def fail(*args: object) -> None:
        raise OSError(28, 'No space left on device')
    monkeypatch.setattr(world_stage, 'far_rocks', fail)
    with pytest.raises(UsdError, match='w.usd: cannot be written: No space left'):
        world_stage.write_world(moon, tmp_path / 'w.usd')

    def compose(root: Path, parts: Path) -> None:
        world_stage.Usd.Stage.CreateNew(str(parts / 'no' / 'folder.usdx'))
    with pytest.raises(UsdError, match='w.usd: cannot be written'):
        write_stage(tmp_path / 'w.usd', compose)
    assert list(tmp_path.iterdir()) == []


def test_without_openusd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                         capsys: pytest.CaptureFixture[str]) -> None:
    """One line says what to install; mesh files and URDF are written all the same."""
    for name in [name for name in sys.modules if name.startswith('lunar_rover_sim.products.usd.')]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, 'pxr', None)
    for command in (['rover', 'export'], ['world', 'export', 'anything'],
                    ['bag', 'export', 'anything', '--format', 'usd']):
        error = fails([*command, '-o', str(tmp_path / 'a.usd')], capsys)
        assert "pip install '.[usd]' in a clone" in error
    output = tmp_path / 'rover.urdf'
    assert main(['rover', 'export', '-o', str(output)]) == 0
    assert output.read_text() == urdf(RoverDescription())


@pytest.mark.parametrize(('arguments', 'match'), [
    (['world', 'export', 'w', '-o', 'a.glb', '--sun', '1', '2'], '--sun: is for stages'),
    (['world', 'export', 'w', '-o', 'a.usd', '--stride', '2'], '--stride: is for mesh files'),
    (['world', 'export', 'w', '-o', 'a.usd', '--sun', '1', '99'], '--sun: 1 99 is not valid'),
    (['bag', 'export', 'b', '-o', 'a', '--world', 'w'], '--world: is for --format usd'),
    (['bag', 'export', 'b', '-o', 'a.usdz'], 'a.usdz is the name of a stage, and euroc is a '
     'folder; a stage needs --format usd'),
    (['bag', 'export', 'b', '-o', 'a.usd', '--format', 'usd', '--world', 'w', '--world-stage',
      'v'], 'both are given'),
    (['rover', 'export', '-o', 'a.stl'], '.stl is not valid; valid are .usd'),
    (['rover', 'export', '-o', 'a.urdf', '--name', 'A'], '--name: is for stages')])
def test_options(arguments: list[str], match: str, tmp_path: Path,
                 monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    assert match in fails(arguments, capsys)
    assert list(tmp_path.iterdir()) == []
