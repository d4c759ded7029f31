"""The command line as a whole: a table of commands, and only the chosen one is imported."""

from __future__ import annotations

import pkgutil
import subprocess
import sys

import pytest

from lunar_rover_sim import cli
from lunar_rover_sim.cli.main import COMMANDS, main, parse, parser

HEAVY = {'cv2', 'matplotlib', 'mujoco', 'numpy', 'rclpy', 'scipy'}


def test_every_module_is_in_the_table() -> None:
    modules = {info.name for info in pkgutil.iter_modules(cli.__path__)} - {'main'}
    assert {command.module for command in COMMANDS.values()} == modules


@pytest.mark.parametrize('name', COMMANDS)
def test_every_command_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        parser().parse_args([*name.split(), '--help'])
    assert ended.value.code == 0
    assert f'usage: lunar_rover_sim {name}' in capsys.readouterr().out


@pytest.mark.parametrize('words', [['--help'], ['validate', '--help'], ['--version']])
def test_help_is_quick(words: list[str]) -> None:
    """Help of the whole imports no library that takes time."""
    code = ('import sys\n'
            'from lunar_rover_sim.cli.main import main\n'
            'try:\n'
            f'    main({words!r})\n'
            'finally:\n'
            f'    sys.exit(len(set(sys.modules) & {HEAVY!r}))\n')
    assert subprocess.run([sys.executable, '-c', code], stdout=subprocess.DEVNULL).returncode == 0


def test_lists_may_begin_with_a_negative_number() -> None:
    args = parse(['render', 'flat', '--pose', '-2,3,240', '--pose=-.5,1,2', '--joints',
                  '-1,2,-3,4', '-o', 'out'])
    assert args.pose == [(-2.0, 3.0, 240.0), (-0.5, 1.0, 2.0)]
    assert args.joints == [-1.0, 2.0, -3.0, 4.0]
    assert parse(['world', 'preview', 'folder', '--sun', '-60', '6']).sun == [-60.0, 6.0]


def test_errors_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['parameters', 'physics']) == 1
    error = capsys.readouterr().err
    assert error.startswith('lunar_rover_sim: section:') and error.count('\n') == 1


@pytest.mark.parametrize(('words', 'hint'), [
    (['rnu', 'baseline'], 'rnu: no such command; did you mean run?'),
    (['validate', 'stero'], 'validate stero: no such command; did you mean validate stereo'),
    (['parameters', 'render_node.sunn'], 'did you mean sun?'),
    (['parameters', '--search', 'no such thing'], "no parameter has 'no such thing'")])
def test_mistyped_words_get_a_hint(words: list[str], hint: str,
                                   capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 1
    error = capsys.readouterr().err
    assert hint in error and error.count('\n') == 1


def test_parameters_are_found(capsys: pytest.CaptureFixture[str],
                              monkeypatch: pytest.MonkeyPatch) -> None:
    """By group and by text, at the width of the terminal."""
    monkeypatch.setenv('COLUMNS', '100')
    assert main(['parameters', 'render_node.sun']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) == 100
    assert any('sun.angular_diameter_deg' in line for line in lines)
    assert main(['parameters', '--search', 'ALBEDO']) == 0
    found = capsys.readouterr().out
    assert 'albedo.fresh_crater' in found and 'duty_factor' not in found


@pytest.mark.parametrize('shell', ['bash', 'zsh'])
def test_completion_knows_every_command(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['completion', shell]) == 0
    script = capsys.readouterr().out
    for name in COMMANDS:
        assert name.split()[-1] in script
    assert '--real-time' in script
    if shell == 'bash':
        subprocess.run(['bash', '-n'], input=script, text=True, check=True)
