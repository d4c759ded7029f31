"""Command lines in README, documentation and results: each is one that the program takes."""

from __future__ import annotations

import ast
import json
from pathlib import Path
import re
import shlex

from command_line import given
import pytest
from snippets import commands, ROOT, snippets

from lunar_rover_sim.base.files.paths import packaged_names
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.run.node_config import COMPANION_CONFIGS, NODE_CONFIGS
from lunar_rover_sim.run.scenario import Scenario

NODES = {**NODE_CONFIGS, **COMPANION_CONFIGS}
# Programs of others; ours are looked at word by word.
FOREIGN = {'.', 'apt', 'cat', 'cd', 'cmake', 'colcon', 'cosmic-ray', 'cr-report', 'dask', 'docker',
           'git', 'pip', 'rosdep', 'rviz2', 'sqlite3', '~/orbslam3/bin/pip', '~/svo/bin/pip'}
LINES = [pytest.param(words, id=f'{snippet.name} {" ".join(words)[:60]}')
         for snippet in snippets('sh') for words in commands(snippet)]
LINES += [pytest.param(shlex.split(line), id=f'{path.stem} {line[:60]}')
          for path in sorted((ROOT / 'docs/measurements/results').glob('*.json'))
          for line in re.split(' (?:> /dev/null )?&& ', json.loads(path.read_text())['command'])]


@pytest.mark.parametrize('words', LINES)
def test_command_line(words: list[str]) -> None:
    """The parser, the parameters, the launch file or the file system knows every word."""
    if words[0] == 'lunar_rover_sim':
        check_ours(words[1:])
    elif words[:2] == ['ros2', 'run'] and words[2] == 'lunar_rover_sim':
        check_node(words[3], words[4:])
    elif words[:2] == ['ros2', 'launch']:
        check_launch(words[2:])
    elif words[:3] == ['ros2', 'param', 'set']:
        node = words[3].removeprefix('/')
        info = {name: info for name, _, info, _ in NODES[node]().flatten()}
        assert info[words[4]].live
    elif words[0] in ('python', 'python3', 'pytest'):
        check_python(words)
    elif words[0] == './bootstrap':
        assert ' '.join(words[1:]) in ('', 'demo', 'docs', 'lock', 'test', 'test --quick')
    elif words[0] == 'ros2':
        assert words[1:3] in (['bag', 'play'], ['action', 'send_goal'], ['topic', 'pub'],
                              ['run', 'teleop_twist_keyboard'], ['run', 'joy'],
                              ['run', 'teleop_twist_joy'])
    else:
        assert words[0] in FOREIGN


def check_ours(words: list[str]) -> None:
    """Parse a command line of ours; load its scenario with what it sets."""
    arguments = given(*words)
    overrides = arguments.get('overrides', [])
    scenario = arguments.get('scenario')
    if scenario in packaged_names('scenario') and scenario != 'dem':
        Scenario.load(scenario, [text for text in overrides if not text.startswith('rover=')])


def check_node(node: str, words: list[str]) -> None:
    """Check names and values of parameters that are handed to a node."""
    names = {name for name, *_ in NODES[node]().flatten()}
    for flag, text in zip(words, words[1:]):
        if flag == '-p':
            assert text.partition(':=')[0] in names


def check_launch(words: list[str]) -> None:
    """Check the arguments of a launch file against those that it declares.

    `ros2 launch` finds the examples by their names, too.
    """
    package, file, *settings = words
    assert package == 'lunar_rover_sim'
    if (ROOT / 'config' / 'launch_examples' / file).is_file():
        assert not settings
        return
    tree = ast.parse((ROOT / package / 'nodes' / 'launch' / file).read_text(encoding='utf-8'))
    declared = next(ast.literal_eval(node.value) for node in tree.body
                    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
                    and node.targets[0].id == '_ARGUMENTS')
    assert {text.partition(':=')[0] for text in settings if ':=' in text} <= set(declared)


def check_python(words: list[str]) -> None:
    """Check that scripts and test files exist; those of the reader are named alone."""
    for word in words[1:]:
        if re.fullmatch(r'[\w/]+\.py', word) and '/' in word:
            assert (ROOT / word).is_file()


def test_inline_scripts_exist() -> None:
    """Files that a page names in running text exist too."""
    missing = []
    for page in [*(ROOT / 'docs').rglob('*.md'), ROOT / 'README.md', ROOT / 'CONTRIBUTING.md']:
        if '_build' in page.parts:
            continue
        for name in re.findall(r'`(?:python |pytest )?((?:test|config|docs|lunar_rover_sim)'
                               r'/[\w/.]+\.\w+)', page.read_text(encoding='utf-8')):
            if 'NAME' not in name and not (ROOT / name).exists():
                missing.append(f'{page.name}: {name}')
    assert not missing


def test_parameters_to_vary_exist() -> None:
    """Each name on the page is a parameter, or a group of them, below the prefix of its row."""
    text = (ROOT / 'docs/reference/parameters.md').read_text(encoding='utf-8')
    known, section = set(), ''
    for line in text.splitlines():
        if head := re.match(r'## `(.+)`', line):
            section = head[1]
        elif row := re.match(r'\| (`.+?`) \|', line):
            known |= {f'{section}.{name}' for name in re.findall('`(.+?)`', row[1])}
    page = (ROOT / 'docs/howto/vary.md').read_text(encoding='utf-8')
    rows = [line.split(' | ') for line in page.splitlines() if line.startswith('| ')][1:]
    assert len(rows) > 15
    for _, prefixes, names in rows:
        for name in re.findall(r'`([\w.]+)`', names):
            full = {name, *(f'{above}.{name}' for prefix in re.findall(r'`(.+?)`', prefixes)
                            for above in (prefix, prefix.partition('.')[0]))}
            assert any(each.startswith(tuple(full)) or each.rpartition('.')[2].startswith(name)
                       for each in known), name


def test_links_of_pages_outside_sphinx() -> None:
    """README and CONTRIBUTING link to files that exist; other addresses are https."""
    for page in (ROOT / 'README.md', ROOT / 'CONTRIBUTING.md'):
        for link in re.findall(r'\]\(([^)#]+)\)', page.read_text(encoding='utf-8')):
            assert link.startswith('https://') or (ROOT / link).exists(), link


def test_rover_file(tmp_path: Path) -> None:
    """The rover of the how-to page is one: it loads, and differs where it says so."""
    (block,) = [snippet for snippet in snippets('yaml')
                if snippet.page.name == 'rover_and_gait.md']
    (tmp_path / 'rover.yaml').write_text(block.text, encoding='utf-8')
    rover = load_rover(tmp_path / 'rover.yaml')
    assert (rover.chassis.mass_kg, rover.legs.spoke_length_m, rover.stereo.baseline_m) == \
        (3.5, 0.11, 0.15)
