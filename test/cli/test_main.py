"""The command line as a whole: help, words that no command takes, completion, progress."""

import fcntl
import json
import os
from pathlib import Path
import pty
import re
import resource
import struct
import subprocess
import sys
import termios
import time
from typing import Any

from command_line import given, unfolded
import pytest
import worlds

from lunar_rover_sim.base.compilation import COMPILATION
from lunar_rover_sim.cli import terminal
from lunar_rover_sim.cli.main import COMMANDS, GROUPS, load, main
from lunar_rover_sim.ground.world.world_folder import save_world

HEAVY = {'cv2', 'matplotlib', 'mujoco', 'numpy', 'rclpy', 'rich', 'scipy', 'yaml'}
BAD_INPUT = {
    # A command that does not exist.
    'rnu baseline': (1, 'rnu: no such command; did you mean run?'),
    'bag chek x': (1, 'bag chek: no such command; did you mean bag check'),
    'validate stero': (1, 'did you mean validate stereo'),
    'validate traverse -o {new}': (1, 'no such command; see validate navigation'),
    'xyzzy': (1, 'xyzzy: no such command; see lunar_rover_sim --help'),
    # An option that does not exist, lacks its value, or does not go with another one.
    'run flat --durration 3': (2, "'--durration'. Did you mean '--duration'? See lunar_rover_sim "
                                  'run --help'),
    'run flat': (2, "Missing option '-o' / '--output'"),
    # What is wrong is told beside what is missing.
    'run dem': (1, "GeoTIFF or folder; also missing option '-o'"),
    'run dem -o {new}': (1, 'not_set: no such file; --set world.path=FILE: a GeoTIFF or'),
    'run flat --set sun.elevation=5': (1, 'did you mean render_node.sun.elevation_deg?; also '
                                          "missing option '-o'"),
    'run flat -o': (2, "'-o' requires an argument"),
    'benchmark -o {new} --scenarios --seeds 2': (2, "'--scenarios' requires an argument"),
    'run flat dem -o {new}': (2, 'unexpected extra argument (dem)'),
    'run flat -o {new} --goal 1,2 --route circle': (2, '--goal, --route: both are given'),
    'world build -o {new} --dem a.tif --mesh b.obj': (2, '--dem, --mesh: both are given'),
    # A value that is not valid: name, value and what is.
    'bag export x -o {new} --format eurok': (2, "'eurok' is not valid; did you mean euroc?"),
    'bag export x -o {new} --epoch soon': (2, "'--epoch': 'soon' is not a date; valid is YYYY"),
    'run flat -o {new} --duration abc': (2, "'--duration': 'abc' is not a valid float"),
    'run flat -o {new} --duration -3': (1, 'run.duration_s: -3.0 is not valid; valid is > 0'),
    'validate odometry --duration nan': (1, '--duration: nan is not valid; valid is'),
    'run flat -o {new} --set rover.motor.stall_torque_nm=1e300': (
        1, 'stall_torque_nm: 1e+300 is not valid; valid is 1e-06 to 1000 [N m]'),
    'run flat -o {new} --set physics_node.contact.stiffness_npm=nan': (
        1, "contact.stiffness_npm: 'nan' is not a number"),
    'run flat -o {new} --goal 1': (1, "--goal '1': is no place; valid is X,Y [m]"),
    'run flat -o {new} --goal 1e9,0': (1, 'goal: x 1e+09 m, y 0 m is beyond the site; valid are '
                                          '-2000 to 2000 m, see world.site_km'),
    'run flat -o {new} --set physics_node.start.x_m=1e6': (
        1, 'physics_node.start: x 1e+06 m, y 0 m is beyond the site; valid are -2000 to 2000 m'),
    'run flat -o {new} --slam': (2, "'--slam' requires an argument"),
    'run flat -o {new} --slam=': (1, "--slam: '' is not valid; valid is a program"),
    'run flat -o {new} --slam "': (1, "--slam: '\"' is not valid: No closing quotation"),
    'run flat -o {new} --slam no_such_program': (1, 'no_such_program: there is no such program'),
    'slam run x -o {new} --timeout nan': (1, '--timeout: nan is not valid; valid is >= 0 [s]'),
    'slam run x -o {new} --max-ate nan': (1, '--max-ate: nan is not valid; valid is > 0 [m]'),
    'evaluate x y --min-tracked nan': (1, '--min-tracked: nan is not valid; valid is 0 to 1'),
    **{f'evaluate x y --tolerance {bad}': (
        1, f'--tolerance: {bad} is not valid; valid is 0 to 1000 [s]')
       for bad in ('inf', 'nan', '-0.02')},
    'evaluate x y --distance inf': (1, '--distance: inf is not valid; valid is > 0 [m]'),
    'evaluate x y --time 0': (1, '--time: 0 is not valid; valid is > 0 [s]'),
    'slam run x -o {new} --doubt 5': (1, '--doubt: needs --orbital'),
    'run flat -o {new} --slam graph --doubt 5': (1, '--doubt: needs --orbital'),
    'run flat -o {new} --goal 2,0 --set mapping_node.depth=lidar': (
        1, "depth: 'lidar' is not valid without lidar_node in run.nodes, or lidar/points_desk"),
    'run flat -o {new} --goal 2,0 --set mapping_node.pose=slam': (
        1, "mapping_node.pose: 'slam' is not valid without slam_node in run.nodes (--slam), or"),
    'run flat -o {new} --goal 2,0 --set navigator_node.pose=slam': (
        1, "navigator_node.pose: 'slam' is not valid without slam_node in run.nodes (--slam)"),
    'run flat -o {new} --goal 2,0 --set run.nodes=[physics_node]': (
        1, "depth: 'stereo' is not valid without render_node in run.nodes, or stereo/depth/i"),
    'slam run x -o {new} --system command --run=': (1, '--run: missing; it is the command'),
    'slam run x -o {new} --system command --run "': (1, "--run: '\"' is not valid: No cl"),
    'render flat -o {new} --pose 1,2': (2, "'1,2' is not 3 or 4 numbers"),
    'render flat -o {new} --chase-from 1,2,x': (2, "'1,2,x' is not a list of numbers"),
    'bag video x -o {new}.mp4 --tripod 1,nan,2': (2, 'valid is finite numbers'),
    'bag video x -o {new}.mp4 --speed 1e-9': (1, '--speed: 1e-09 is not valid; valid is 0.001 to'),
    'bag video x -o {new}.gif --fps 1e-9': (1, '--fps: 1e-09 is not valid; valid is 0.1 to 100'),
    'bag video x -o {new}.gif --fps 30': (1, '--fps: 30 is not valid for a .gif, whose frames la'),
    'bag video x -o {new}.gif --fps 80': (1, 'and two at least; near it is 50'),
    'validate locomotion -o {new} --speeds 0.1 0': (1, '--speeds: 0 is not valid; valid is > 0'),
    'parameters nonsense': (1, "'nonsense' is not valid; see lunar_rover_sim parameters"),
    'run flat -o {new} --set shared.sed=3': (1, "'shared'; see lunar_rover_sim parameters"),
    'slam run x -o {new} --system orbslam': (2, 'did you mean orbslam3? See lunar_rover_sim slam'),
    'world info no_world': (1, 'make one with `lunar_rover_sim world build`'),
    'parameters physics': (1, "section: 'physics' is not valid; did you mean physics_node"),
    'parameters render_node.sunn': (1, 'did you mean sun?'),
    'parameters --search xyzzy': (1, "no parameter has 'xyzzy'"),
    'render baseline --world {world} -o {new} --pose 1e6,0,0': (
        1, '--pose: (1e+06, 0) lies outside the world; valid are x and y within'),
    'render baseline --world {world} -o {new} --set render_node.reflectance.ground=mars': (
        1, "reflectance.ground: 'mars' is not valid"),
    'render flat -o {new} --chase-from 0,0,0': (1, '--chase-from: distance_m: 0.0 is not valid'),
    'calibrate gait flatt -o {new}': (1, 'flatt: no such scenario; did you mean flat'),
    'calibrate gait -o {new} --workers 0': (1, '--workers: 0 is not valid'),
    'calibrate gait -o {new} --measure 0': (1, '--measure: 0 is not valid'),
    'calibrate gait -o {new} --set rover.legs.spokes=6': (1, 'foot_width_deg: 60'),
    'validate locomotion -o {new} --duration 5': (1, '--duration: 5 is not valid'),
    'validate locomotion -o {new} --gravities nan': (1, '--gravities: nan is not valid'),
    'validate locomotion -o {new} --seeds 0': (1, '--seeds: 0 is not valid'),
    'validate navigation -o {new} --set shared.seed=3': (1, "no such section 'shared'"),
    'validate navigation flat -o {new} --seeds 1 --distance 500 --workers 1': (
        1, '--distance: 500 is not valid; valid is <= '),
    'validate odometry -n 2': (1, '--drives: 2 is not valid; valid is >= 3'),
    'validate odometry --duration 1': (1, '--duration: 1 is not valid'),
    'world sun 0 -95': (1, 'PLACE: 0 -95 is not valid; valid are'),
    'world sun 0 x': (1, 'valid are two numbers'),
    'world sun 0 0 0': (1, 'PLACE: 0 0 0 is not valid'),
    'world sun 0 0 --from 1950-01-01': (1, '--from: 1950-01-01T00:00:00Z is not valid'),
    'world sun 0 0 --from 2026-01-02 --to 2026-01-01': (1, '--to: 2026-01-01 is -24 h after'),
    'world sun 0 0 --step 0': (1, '--step: 0 is not valid; valid is 0.1 to'),
    'world sun 0 0 --at 1 2': (1, '--at: is for a world folder'),
    'world sun {world}': (1, 'does not say where on the Moon it is; give --at LON LAT'),
    'world export {world} -o {new}.tif --set orbital.pixel_m=2': (1, '--set: is for --orbital'),
    'world export {world} -o {new}.tif': (
        1, 'valid is a folder, with --orbital, for maps'),
    'world export {world} --orbital -o {world}': (1, 'exists already'),
    'world export {world} --orbital -o {new}.tif': (
        1, 'new.tif is not valid with --orbital, which writes a folder'),
    'world export {world} --orbital -o {new} --stride 3': (
        1, '--stride: is not for --orbital; valid is --set orbital.PARAM=VALUE'),
    'world export {world} --orbital -o {new} --set world.seed=3': (
        1, '--set world.seed=3: valid is orbital.PARAM=VALUE'),
    'world export {world} --orbital -o {new} --set orbital.extent_m=30000': (
        1, 'extent_m: 30000 is not valid; valid is <= '),
    'world export {world} --orbital -o {new} --set orbital.pixel_m=100 --set orbital.extent_m=120':
        (1, 'pixel_m: 100 is not valid; valid is <= 15 [m], for 120 m of ground'),
    'world export {world} --orbital -o {new} --sun 20 0': (
        1, 'sun_elevation_deg: 0.0 is not valid; valid is 1 to 90'),
}


@pytest.fixture(scope='module', name='world')
def _world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_world(worlds.small(), tmp_path_factory.mktemp('worlds') / 'moon')


@pytest.mark.parametrize('line', BAD_INPUT)
def test_bad_input_is_one_short_error(line: str, world: Path, tmp_path: Path,
                                      capsys: pytest.CaptureFixture[str]) -> None:
    """Folded to 100 columns, in which paths stay whole; nothing on stdout, nothing written."""
    status, words = BAD_INPUT[line]
    assert main(line.format(new=tmp_path / 'new', world=world).split()) == status
    said = capsys.readouterr()
    # A slow machine tells its progress.
    assert all(len(line) <= 100 or len(line.split()) == 1 for line in said.err.splitlines())
    error, = (line for line in unfolded(said.err).splitlines()
              if not line.startswith(('building the world: ', 'driving: ')))
    assert error.startswith('lunar_rover_sim: ') and words in error
    assert not said.out and not list(tmp_path.iterdir())
    error = error.replace(str(tmp_path), '').replace(str(world), 'moon')
    assert len(error) < 160     # two lines of a terminal


# Contacts that are too fast for the steps of physics, and what is valid on this rover.
UNRESOLVED = {
    'contact.stiffness_npm=1e9': 'contact.stiffness_npm: 1e+09 is not valid with step_s = 0.001; '
                                 'valid is <= 170000 [N/m] for the mass of this rover, or step_s '
                                 '<= 1.3e-05',
    'contact.damping_nspm=1e9': 'contact.damping_nspm: 1e+09 is not valid with step_s = 0.001; '
                                'valid is <= 690 [N s/m] for the mass of this rover',
    'ground.elastic_npm=1e6': 'ground.elastic_npm: 1e+06 is not valid with step_s = 0.001 and '
                              'gravity_mps2 = 1.62; valid is <= 38000 [N/m] for the mass of this '
                              'rover, or step_s <= 0.00019',
    'ground.damping_nspm=1e4': 'ground.damping_nspm: 10000 is not valid with step_s = 0.001',
    'gravity_mps2=30': 'ground.damping_nspm: 60 is not valid with step_s = 0.001 and gravity_mps2 '
                       '= 30; valid is <= 35',
    'gravity_mps2=0': 'gravity_mps2: 0 is not valid on ground.model = regolith; valid is > 0',
    'step_s=0.005': 'ground.damping_nspm: 60 is not valid with step_s = 0.005'}


@pytest.mark.parametrize(('line', 'words'), [
    ('run dem', 'not_set: no such file; --set world.path=FILE'),
    ('run flat --policy nope.onnx', 'nope.onnx: cannot be read: no such file'),
    ('run flat --policy nope', 'nope: no such policy; valid are'),
    ('run flat --set run.nodes=[physics_node,policy_node,recorder_node] '
     '--set policy_node.policy=nope.onnx', 'nope.onnx: cannot be read: no such file'),
    ('run flat --set run.nodes=[physics_node,policy_node,recorder_node]',
     'policy: not given; valid is a file, or '),
    ('run flat --set physics_node.start.joint_angle_rad=[0.0,1.0]',
     'physics_node.start.joint_angle_rad: 2 elements given; valid is one for all legs, or 4'),
    ('run flat --set gait_controller_node.gait=custom '
     '--set gait_controller_node.phase_offsets=[0.0,0.5]',
     'gait_controller_node.phase_offsets: 2 elements given; valid is one for each leg'),
    *((f'run baseline --set physics_node.{setting}', f'physics_node.{words}')
      for setting, words in UNRESOLVED.items())])
def test_what_a_run_lacks_is_said_before_a_world_is_built(
        line: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))
    assert main([*line.split(), '-o', str(tmp_path / 'new')]) == 1
    # A slow machine tells its progress.
    error, = (line for line in unfolded(capsys.readouterr().err).splitlines()
              if not line.startswith('building the world: '))
    assert words in error and not (tmp_path / 'new').exists()
    assert {path.suffix for path in tmp_path.rglob('*') if path.is_file()} <= {'.lock'}


def test_ctrl_c_while_classes_are_imported_is_no_error(monkeypatch: pytest.MonkeyPatch,
                                                       capsys: pytest.CaptureFixture[str]) -> None:
    """As while a dataclass with parameters is made, whose fields learn their names."""
    class Stopped:
        def __set_name__(self, _owner: type, _name: str) -> None:
            raise KeyboardInterrupt

    monkeypatch.setattr('lunar_rover_sim.cli.main.execute',
                        lambda _argv: type('Made', (), {'x': Stopped()}))
    assert main(['world', 'info', 'x']) == 130
    assert capsys.readouterr().err == ''


def test_an_error_is_folded_to_a_terminal() -> None:
    """Between words; to 100 columns elsewhere."""
    words = [sys.executable, '-m', 'lunar_rover_sim.cli.main', 'run', 'nowhere', '-o', 'new']
    plain = subprocess.run(words, capture_output=True, text=True).stderr
    screen, behind = pty.openpty()
    fcntl.ioctl(behind, termios.TIOCSWINSZ, struct.pack('4H', 24, 60, 0, 0))
    subprocess.run(words, stderr=behind)
    lines = os.read(screen, 4096).decode().splitlines()
    assert max(map(len, lines)) <= 60 < max(map(len, plain.splitlines())) <= 100
    assert unfolded('\n'.join(lines)) == unfolded(plain).strip()
    os.close(screen)
    os.close(behind)


@pytest.mark.parametrize('name', [*COMMANDS, *GROUPS, ''])
def test_every_command_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*name.split(), '--help']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f'Usage: lunar_rover_sim {name}'.rstrip())
    assert max(map(len, lines)) <= 100
    if name in COMMANDS:
        assert re.match('  [A-Z]', lines[2] or lines[3])    # a sentence of its own


@pytest.mark.parametrize('words', [[], ['bag'], ['evaluate']])
def test_no_command_shows_the_help(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    assert 'Commands:' in capsys.readouterr().err


@pytest.mark.parametrize('words', [['--help'], ['validate', '--help'], ['--version'], ['rnu']])
def test_help_is_quick(words: list[str]) -> None:
    """Help of the whole imports no library that takes time."""
    code = ('import sys\n'
            'from lunar_rover_sim.cli.main import main\n'
            f'main({words!r})\n'
            f'sys.exit(len(set(sys.modules) & {HEAVY!r}))\n')
    assert subprocess.run([sys.executable, '-c', code], capture_output=True).returncode == 0


def test_values_that_begin_with_a_minus() -> None:
    args = given('render', 'flat', '--pose', '-2,3,240', '--pose=-.5,1,2', '--joints',
                 '-1,2,-3,4', '-o', 'out')
    assert args['poses'] == ((-2.0, 3.0, 240.0), (-0.5, 1.0, 2.0))
    assert args['joints'] == (-1.0, 2.0, -3.0, 4.0)
    assert given('world', 'preview', 'folder', '--sun', '-60', '6')['sun'] == (-60.0, 6.0)
    assert given('world', 'sun', '-30', '-89.5', '--step', '2')['place'] == ('-30', '-89.5')


def test_options_of_several_values() -> None:
    """One after the other, repeated, none where none is valid, and the default."""
    words = ['validate', 'locomotion', 'flat', '-o', 'out']
    assert given(*words, '--speeds', '0.1', '0.2', '--seeds', '3')['speeds'] == (0.1, 0.2)
    assert given(*words, '--speeds', '0.1', '--speeds', '0.2')['speeds'] == (0.1, 0.2)
    assert given(*words, '--grounds')['grounds'] == ()
    assert given(*words)['grounds'][0] == 'rigid'
    assert given('run', 'flat', '-o', 'x', '--view')['view'] == 8765
    assert given('run', 'flat', '-o', 'x', '--view', '9000')['view'] == 9000


def test_set_goes_before_fast(tmp_path: Path) -> None:
    """In the settings of a camera that `slam settings` writes."""
    for words, width in (([], 640), (['--fast'], 320),
                         (['--fast', '--set', 'render_node.camera.width=400'], 400)):
        path = tmp_path / f'{width}.yaml'
        assert main(['slam', 'settings', 'flat', '-o', str(path), *words]) == 0
        assert f'Camera.width: {width}\n' in path.read_text()


@pytest.mark.parametrize(('columns', 'width'), [('', 100), ('60', 60)])
def test_parameters_are_found(columns: str, width: int, capsys: pytest.CaptureFixture[str],
                              monkeypatch: pytest.MonkeyPatch) -> None:
    """By group and by text: a line with name, default and range, then the meaning, folded."""
    monkeypatch.setenv('COLUMNS', columns)
    assert main(['parameters', 'render_node.sun']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert 0.8 * width < max(map(len, lines)) <= width
    k = lines.index('render_node.sun.elevation_deg = 6.0, -1 to 90 [deg]')
    assert lines[k + 1].startswith('    of the centre')
    assert main(['parameters', '--search', 'ALBEDO']) == 0
    found = capsys.readouterr().out
    assert 'albedo.fresh_crater' in found and 'duty_factor' not in found


@pytest.mark.parametrize(('text', 'offered'), [
    ('sun.elevation_deg', 'did you mean render_node.sun.elevation_deg?'),
    ('elevation_deg', ' or render_node.sun.elevation_deg or '),
    ('render_node.elevation_deg', 'did you mean render_node.sun.elevation_deg or '),
    ('render.sun.elevation_deg', 'did you mean render_node.sun.elevation_deg or '),
    ('frame_rate_hz', 'did you mean render_node.frame_rate_hz?'),   # others follow it
    ('sed', 'did you mean seed or world.seed?'),
    ('xyzzy.a', "no such section 'xyzzy'; see lunar_rover_sim parameters")])
def test_a_parameter_without_its_section_is_offered(text: str, offered: str, tmp_path: Path,
                                                    capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['render', 'flat', '-o', str(tmp_path / 'x'), '--set', f'{text}=5']) == 1
    assert offered in unfolded(capsys.readouterr().err)


def test_progress_in_a_pipe(capsys: pytest.CaptureFixture[str],
                            monkeypatch: pytest.MonkeyPatch) -> None:
    """A line now and then on stderr: what is done, how much, how long it takes; stdout is free."""
    monkeypatch.setattr(terminal, 'PIPE_FIRST_S', 0.01)
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


def test_a_wait_for_compilation_is_named_and_no_line_is_wide(
        capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba keeps what it compiles: it is said that this is once."""
    monkeypatch.setattr(terminal, 'PIPE_FIRST_S', 0.01)
    monkeypatch.setattr(terminal, 'PIPE_PERIOD_S', 0.01)
    with terminal.Progress('simulating') as progress:
        progress.named(f'nothing on {"stereo/left/camera_info " * 6}')
        COMPILATION.begin()
        time.sleep(0.1)
        COMPILATION.end()
    lines = capsys.readouterr().err.splitlines()
    assert any('compiling, once' in line for line in lines)
    assert max(map(len, lines)) <= 100


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


def test_no_line_is_wider_than_the_terminal(capsys: pytest.CaptureFixture[str],
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    """A path is not cut: it can be copied."""
    monkeypatch.setenv('COLUMNS', '40')
    path = '/a/folder/with/quite/a/long/name/of/its/own'
    terminal.say(f'the pictures are in {path} and some more words follow here')
    assert [len(line) <= 40 or line == f'  {path}' for line
            in capsys.readouterr().out.splitlines()] == [True] * 3


def completed(line: str, script: Path) -> set[str]:
    """Return what a real bash offers for the last word of a line, as the key Tab asks for it."""
    asked = subprocess.run(
        ['bash', '-c', f'source {script}; COMP_WORDS=(lunar_rover_sim {line}); '
         'COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); '
         '_lunar_rover_sim_completion lunar_rover_sim; echo ${COMPREPLY[@]}'],
        capture_output=True, text=True, check=True,
        env={**os.environ, 'PATH': f'{script.parent}:{os.environ["PATH"]}'})
    assert not asked.stderr
    return set(asked.stdout.split())


def test_completion(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Of commands, options, choices, scenarios and parameters."""
    assert main(['completion', 'bash']) == 0
    (tmp_path / 'script').write_text(capsys.readouterr().out)
    program = tmp_path / 'lunar_rover_sim'
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m lunar_rover_sim.cli.main "$@"\n')
    program.chmod(0o755)
    for line, wanted in (('bag ch', {'check'}), ('run flat --dur', {'--duration'}),
                         ('run basel', {'baseline'}), ('parameters world.cr', {'world.craters'}),
                         ('run flat --set render_node.sun.el', {'render_node.sun.elevation_deg='}),
                         ('xyzzy ', set())):
        assert completed(line, tmp_path / 'script') == wanted, line
    assert main(['completion', 'zsh']) == 0
    assert capsys.readouterr().out.startswith('#compdef lunar_rover_sim')


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
    def fail(**_: Any) -> int:
        raise error

    monkeypatch.setattr(load('parameters'), 'callback', fail)
    assert main(['parameters']) == 1
    printed = capsys.readouterr().err
    assert printed.startswith(f'lunar_rover_sim: {line}') and printed.count('\n') == 1


def test_a_reader_that_has_seen_enough_is_no_error() -> None:
    """`| head -1`: status 0 and no complaint, though much more is to be printed."""
    done = subprocess.run(
        ['bash', '-c', f'{sys.executable} -m lunar_rover_sim.cli.main parameters | head -1; '
         'echo ${PIPESTATUS[0]}'], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == '0' and not done.stderr


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
