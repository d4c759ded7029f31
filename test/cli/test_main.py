"""The command line as a whole: a table of commands, and only the chosen one is imported."""

import argparse
from collections.abc import Iterator
import json
from pathlib import Path
import pkgutil
import re
import resource
import subprocess
import sys
import time

import pytest

from lunar_rover_sim import cli
from lunar_rover_sim.cli import terminal
from lunar_rover_sim.cli.main import COMMANDS, main, parse, parser

HEAVY = {'cv2', 'matplotlib', 'mujoco', 'numpy', 'rclpy', 'scipy'}


def leaves(root: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield the parsers of the commands that have arguments."""
    groups = [a for a in root._actions if isinstance(a, argparse._SubParsersAction)]
    for child in (c for group in groups for c in group.choices.values()):
        yield from leaves(child)
    if not groups:
        yield root


def test_every_module_is_in_the_table() -> None:
    modules = {info.name for info in pkgutil.iter_modules(cli.__path__)}
    modules -= {'help_format', 'main', 'options', 'terminal'}
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
    assert args.joints == (-1.0, 2.0, -3.0, 4.0)
    assert parse(['world', 'preview', 'folder', '--sun', '-60', '6']).sun == [-60.0, 6.0]


@pytest.mark.parametrize(('words', 'message'), [
    (['render', 'flat', '-o', 'out', '--pose', '1,2'], "'1,2' is not 3 or 4 numbers"),
    (['render', 'flat', '-o', 'out', '--chase-from', '1,2,x'], "'1,2,x' is not a list of numbers"),
    (['bag', 'video', 'x', '-o', 'y.mp4', '--from', '1,2'], "'1,2' is not 3 numbers"),
    (['bag', 'video', 'x', '-o', 'y.mp4', '--tripod', '1,nan,2'], 'valid is finite numbers'),
])
def test_lists_of_numbers_are_checked(words: list[str], message: str,
                                      capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parse(words)
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(('words', 'hint'), [
    (['bag', 'chek', 'x'], '; did you mean check?'),
    (['bag', 'export', 'x', '-o', 'y', '--format', 'eurok'], '; did you mean euroc?'),
])
def test_mistyped_words_of_a_command_are_offered(words: list[str], hint: str,
                                                 capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        parse(words)
    assert ended.value.code == 2
    assert capsys.readouterr().err.rstrip().endswith(hint)


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


@pytest.mark.parametrize(('columns', 'width'), [('', 100), ('60', 60)])
def test_parameters_are_found(columns: str, width: int, capsys: pytest.CaptureFixture[str],
                              monkeypatch: pytest.MonkeyPatch) -> None:
    """By group and by text: a line with name, default and range, then the meaning, folded."""
    monkeypatch.setenv('COLUMNS', columns)
    assert main(['parameters', 'render_node.sun']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert 0.8 * width < max(map(len, lines)) <= width
    k = lines.index('render_node.sun.elevation_deg = 6.0, >= -1 and <= 90 [deg]')
    assert lines[k + 1].startswith('    height of the centre')
    assert main(['parameters', '--search', 'ALBEDO']) == 0
    found = capsys.readouterr().out
    assert 'albedo.fresh_crater' in found and 'duty_factor' not in found


@pytest.mark.parametrize('name', COMMANDS)
def test_one_vocabulary(name: str) -> None:
    """What means the same has one name; the other one is understood and not shown."""
    for command in leaves(parser([name])):
        seen = {word: action for action in command._actions for word in action.option_strings}
        for shown, hidden in (('--overwrite', '--force'), ('--workers', '--jobs')):
            assert (shown in seen) == (hidden in seen), command.prog
            if shown in seen:
                assert seen[hidden].help == argparse.SUPPRESS
                assert seen[shown].dest == seen[hidden].dest
        assert '--set' not in seen or seen['--set'].dest == 'overrides'
        assert max(map(len, command.format_help().splitlines())) <= 100


def test_the_help_of_run_lists_the_scenarios(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(['run', '--help'])
    assert 'packaged scenarios: baseline, ' in capsys.readouterr().out


def test_progress_in_a_pipe(capsys: pytest.CaptureFixture[str],
                            monkeypatch: pytest.MonkeyPatch) -> None:
    """A line now and then on stderr: what is done, how much, how long it takes; stdout is free."""
    monkeypatch.setattr(terminal, 'PIPE_PERIOD_S', 0.01)
    with terminal.Progress('walking', 8, 'walks') as progress:
        for done in range(1, 5):
            progress(done)
            time.sleep(0.05)
    said = capsys.readouterr()
    assert said.out == ''
    lines = said.err.splitlines()
    assert re.fullmatch(r'walking: \d/8 walks, 0:00', lines[0])
    assert re.fullmatch(r'walking: 4/8 walks, 0:00', lines[-1])


def test_the_time_left_is_that_of_the_whole_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten of a hundred in 20 s after the first one: 180 s are left, whatever came before."""
    now = [0.0]
    monkeypatch.setattr(time, 'monotonic', lambda: now[0])
    progress = terminal.Progress('estimating', 110)
    for done, at in ((10, 60.0), (15, 70.0), (20, 80.0)):
        now[0] = at
        progress(done)
    assert progress.told() == '20/110, 1:20, 3:00 left'


def test_json_has_no_number_that_json_lacks(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.print_json({'ate_m': float('nan'), 'pairs': [(1, float('inf'))], 'name': 'Größe'})
    text = capsys.readouterr().out
    assert json.loads(text) == {'ate_m': None, 'pairs': [[1, None]], 'name': 'Größe'}


def test_completion_of_scenarios_and_parameters(capsys: pytest.CaptureFixture[str],
                                                tmp_path: Path) -> None:
    """In a real bash, as the key Tab asks for it."""
    assert main(['completion', 'bash']) == 0
    (tmp_path / 'script').write_text(capsys.readouterr().out)
    for line, wanted in (('run basel', {'baseline'}),
                         ('run flat --set render_node.sun.el', {'render_node.sun.elevation_deg='}),
                         ('parameters world.cr', {'world.craters'}), ('run flat --dur',
                                                                      {'--duration'})):
        asked = subprocess.run(
            ['bash', '-c', f'source ./script; COMP_WORDS=(lunar_rover_sim {line}); '
             'COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); _shtab_lunar_rover_sim; '
             'echo ${COMPREPLY[@]}'], cwd=tmp_path, capture_output=True, text=True)
        assert set(asked.stdout.split()) == wanted, line


@pytest.mark.parametrize('shell', ['bash', 'zsh'])
def test_completion_knows_every_command(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['completion', shell]) == 0
    script = capsys.readouterr().out
    for name in COMMANDS:
        assert name.split()[-1] in script
    assert '--real-time' in script
    if shell == 'bash':
        subprocess.run(['bash', '-n'], input=script, text=True, check=True)


def test_few_open_files_are_named(capsys: pytest.CaptureFixture[str],
                                  monkeypatch: pytest.MonkeyPatch) -> None:
    """Before a library fails to load, each in a way of its own."""
    monkeypatch.setattr(resource, 'getrlimit', lambda kind: (16, 1024))
    assert main(['parameters']) == 1
    assert capsys.readouterr().err.startswith('lunar_rover_sim: 16 open files are allowed; at le')


@pytest.mark.parametrize(('error', 'line'), [
    (OSError(24, 'Too many open files', 'x.png'), 'x.png: Too many open files'),
    (OSError('cannot\nbe'), 'cannot be'), (MemoryError(), 'the memory of this machine')])
def test_what_the_machine_lacks_is_one_line(capsys: pytest.CaptureFixture[str],
                                            monkeypatch: pytest.MonkeyPatch,
                                            error: BaseException, line: str) -> None:
    def fail(_args: object) -> int:
        raise error

    monkeypatch.setattr('lunar_rover_sim.cli.parameters.run', fail)
    assert main(['parameters']) == 1
    printed = capsys.readouterr().err
    assert printed.startswith(f'lunar_rover_sim: {line}') and printed.count('\n') == 1


def test_warnings_of_libraries_are_not_shown() -> None:
    """Unless the user asks for all that is logged."""
    code = ('import logging, sys\n'
            'from lunar_rover_sim.cli.main import configure_logging\n'
            'configure_logging(verbose=sys.argv[1] == "-v")\n'
            'logging.getLogger("rasterio._env").warning("CPLE_AppDefined")\n'
            'logging.getLogger("lunar_rover_sim.ground.world").warning("a hole is filled")\n'
            'class Callback:\n'
            '    def __del__(self):\n'
            '        raise ValueError("not UTF-8")\n'
            'Callback()\n')
    shown = {option: subprocess.run([sys.executable, '-c', code, option], capture_output=True,
                                    text=True).stderr for option in ('', '-v')}
    assert shown[''] == 'WARNING lunar_rover_sim.ground.world: a hole is filled\n'
    assert 'CPLE_AppDefined' in shown['-v'] and 'not UTF-8' in shown['-v']
