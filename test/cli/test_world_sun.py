"""`world sun`: table, share of light, figure."""

from pathlib import Path

from PIL import Image
import pytest
import worlds

from lunar_rover_sim.cli.main import main
from lunar_rover_sim.ground.world.world_folder import save_world

TIME = ['--from', '2024-06-15T00:00:00Z', '--to', '2024-06-16T00:00:00Z']


@pytest.fixture(scope='module', name='folder')
def _folder(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(save_world(worlds.small(), tmp_path_factory.mktemp('world') / 'world'))


def test_a_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rows at the step, with the values of Horizons, and a figure."""
    figure = tmp_path / 'sun.png'
    assert main(['world', 'sun', '0', '0', *TIME, '--step', '12', '-o', str(figure)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines[:6])) <= 80
    row = next(line for line in lines if '2024-06-15 12:00' in line).split()
    assert row[2:] == ['15.18°', '1.54°', '88.46°', '100', '%', row[-2], row[-1]]
    assert sum('2024-06-1' in line and ':00 ' in line for line in lines) == 3
    assert any('in light 100.0 % of the time' in line for line in lines)
    assert Image.open(figure).size[0] > 1000


def test_a_world_hides_the_sun(folder: str, capsys: pytest.CaptureFixture[str]) -> None:
    """After the sun has risen over a level plain it is still behind hills."""
    words = ['world', 'sun', folder, '--at', '0', '0', '--from', '2024-06-14T06:00:00Z',
             '--to', '2024-06-14T12:00:00Z', '--step', '1']
    assert main(words) == 0
    out = capsys.readouterr().out
    assert 'of the ground within' in out
    assert main(['world', 'sun', '0', '0', *words[6:]]) == 0
    level = capsys.readouterr().out
    share = [float(text.split('in light')[2].split('%')[0]) for text in (out, level)]
    assert share[0] < share[1]
