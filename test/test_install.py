"""What colcon, pip and ros2 need to know: a wheel is built and installed, and looked at."""

import ast
from importlib import metadata
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import venv
import xml.etree.ElementTree as ET

import pytest
from waiting import LIMIT_S

import lunar_rover_sim
from lunar_rover_sim.nodes.entry_points import NODES

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / 'lunar_rover_sim'
SOURCES = ('config', 'lunar_rover_sim', 'resource', 'LICENSE', 'package.xml', 'pyproject.toml',
           'README.md', 'setup.cfg', 'setup.py')
# What catkin_pkg takes for an address; with any other, colcon does not see a ROS package.
ADDRESS = re.compile(r'[-a-zA-Z0-9_%+]+(\.[-a-zA-Z0-9_%+]+)*'
                     r'@[-a-zA-Z0-9%]+(\.[-a-zA-Z0-9%]+)*\.[a-zA-Z]{2,}')
ROS = ('rclpy', 'launch', 'launch_ros', 'rcl_interfaces', 'builtin_interfaces')


@pytest.fixture(scope='module')
def manifest() -> ET.Element:
    """Return the root of package.xml."""
    return ET.parse(ROOT / 'package.xml').getroot()


@pytest.fixture(scope='module')
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a fresh environment with the wheel of this tree, and nothing else, installed."""
    pytest.importorskip('setuptools', minversion='70.1')   # older ones build no wheel themselves
    folder = tmp_path_factory.mktemp('wheel')
    # A copy of the sources: a build leaves files beside them.
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / 'source' / name,
                            ignore=shutil.ignore_patterns('__pycache__'))
        else:
            shutil.copy(ROOT / name, folder / 'source')
    offline = ['--no-deps', '--no-index', '--disable-pip-version-check', '--quiet']
    pip = [sys.executable, '-m', 'pip']
    # With this tree on PYTHONPATH, pip would take the package for installed.
    without = {name: value for name, value in os.environ.items() if name != 'PYTHONPATH'}
    subprocess.run([*pip, 'wheel', *offline, '--no-build-isolation', '--wheel-dir', str(folder),
                    str(folder / 'source')], check=True, timeout=LIMIT_S, env=without)
    (wheel,) = folder.glob('*.whl')
    environment = folder / 'environment'
    venv.create(environment)
    subprocess.run([*pip, '--python', str(environment / 'bin' / 'python'), 'install', *offline,
                    str(wheel)], check=True, timeout=LIMIT_S, env=without)
    return environment


def run_installed(prefix: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Run a program of the fresh environment; it finds our dependencies, but not this tree."""
    paths = [path for path in sys.path if path and Path(path).resolve() != ROOT
             and not Path(path).resolve().is_relative_to(ROOT / 'test')]
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(paths)}
    return subprocess.run([str(prefix / 'bin' / command[0]), *command[1:]], cwd=prefix,
                          capture_output=True, text=True, timeout=LIMIT_S, env=environment)


def installed_package(prefix: Path) -> Path:
    """Return the folder of the installed package."""
    (folder,) = prefix.glob('lib/python*/site-packages/lunar_rover_sim')
    return folder


def distribution(prefix: Path) -> metadata.Distribution:
    """Return the metadata of the installed package."""
    (info,) = installed_package(prefix).parent.glob('lunar_rover_sim-*.dist-info')
    return metadata.Distribution.at(info)


def test_manifest(manifest: ET.Element) -> None:
    """Format 3, ament_python, a maintainer with an address, a licence: or colcon skips it."""
    assert manifest.tag == 'package'
    assert manifest.get('format') == '3'
    assert manifest.findtext('name') == 'lunar_rover_sim'
    assert manifest.findtext('export/build_type') == 'ament_python'
    assert manifest.findtext('license') == 'Apache-2.0'
    maintainers = manifest.findall('maintainer')
    assert maintainers
    for maintainer in maintainers:
        assert ADDRESS.fullmatch(maintainer.get('email', ''))


def test_manifest_names_ros_dependencies(manifest: ET.Element) -> None:
    """Every ROS package that nodes and the launch file import is declared, so rosdep brings it."""
    declared = {element.text for element in manifest.findall('exec_depend')}
    imported = set()
    for folder in ('nodes', 'nodes/launch'):
        for path in (PACKAGE / folder).glob('*.py'):
            for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
                if isinstance(node, ast.ImportFrom):
                    imported.add(str(node.module).partition('.')[0])
                elif isinstance(node, ast.Import):
                    imported.update(alias.name.partition('.')[0] for alias in node.names)
    needed = {name for name in imported
              if name in ROS or name.endswith(('_msgs', '_srvs', '_interfaces'))}
    assert 'rclpy' in needed
    assert needed <= declared


def test_manifest_names_python_dependencies(manifest: ET.Element, prefix: Path) -> None:
    """Every requirement of the wheel has a rosdep key, or is listed as one for pip."""
    other_names = {'opencv-python-headless': 'opencv', 'pyyaml': 'yaml', 'pillow': 'pil',
                   'scikit-image': 'skimage'}
    declared = {str(element.text).removeprefix('python3-').removesuffix('-pip')
                for element in manifest.findall('exec_depend')}
    by_pip = re.search(r'install with pip: ([\w., ]+)\. --', (ROOT / 'package.xml').read_text())
    assert by_pip is not None
    declared.update(by_pip[1].split(', '))
    required = {re.split(r'[<>=;\[ ]', line)[0].lower()
                for line in distribution(prefix).requires or [] if 'extra ==' not in line}
    assert 'numpy' in required
    assert {other_names.get(name, name) for name in required} <= declared


def test_versions(manifest: ET.Element, prefix: Path) -> None:
    """Version, name, licence and maintainer are the same in the wheel and in package.xml."""
    wheel = distribution(prefix).metadata
    assert manifest.findtext('version') == wheel['Version'] == lunar_rover_sim.__version__
    assert manifest.findtext('name') == wheel['Name']
    assert manifest.findtext('license') == wheel['License']
    maintainer = manifest.find('maintainer')
    assert maintainer is not None
    assert maintainer.get('email') == wheel['Maintainer-email']
    assert maintainer.text == wheel['Maintainer']


def test_citation_and_changelog_have_the_version() -> None:
    """CITATION.cff and the newest release of the changelog agree with the package."""
    changelog = (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8')
    newest = re.search(r'^([\d.]+) \(([\d-]+)\)\n-+$', changelog, re.M)
    assert newest is not None
    version, date = newest.groups()
    assert version == lunar_rover_sim.__version__
    citation = (ROOT / 'CITATION.cff').read_text(encoding='utf-8')
    assert f'version: {version}\ndate-released: {date}\n' in citation


def test_changelog_by_kind() -> None:
    """A release lists bullets of one line (two at most) under the four kinds, in their order."""
    changelog = (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8')
    kinds = ['Recorded data change', 'Added', 'Changed', 'Fixed']
    releases = re.split(r'^.+\n-+\n', changelog, flags=re.M)[1:]
    for release in releases:
        found = re.findall(r'^(.+)\n~+$', release, re.M)
        assert found == [kind for kind in kinds if kind in found]
        for bullet in re.split(r'^\* ', release, flags=re.M)[1:]:
            lines = bullet.split('\n\n')[0].strip().splitlines()
            assert len(lines) <= 2, lines
            assert all(len(line) <= 130 for line in lines), lines


def test_all_files_are_installed(prefix: Path) -> None:
    """Modules, shaders, templates: everything in the package, byte by byte."""
    folder = installed_package(prefix)
    # Launch files are data: ros2 launch looks for them in share. Caches are those of Python and
    # of Numba.
    wanted = {path.relative_to(PACKAGE) for path in PACKAGE.rglob('*')
              if path.is_file() and path.parent.name not in ('launch', '__pycache__')}
    installed = {path.relative_to(folder) for path in folder.rglob('*')
                 if path.is_file() and path.parent.name != '__pycache__'}
    assert installed == wanted
    for path in wanted:
        assert (folder / path).read_bytes() == (PACKAGE / path).read_bytes()


def test_data_files(prefix: Path) -> None:
    """Marker, manifest, launch files and every file of config/ are where ros2 looks for them."""
    share = prefix / 'share' / 'lunar_rover_sim'
    assert (prefix / 'share/ament_index/resource_index/packages/lunar_rover_sim').is_file()
    wanted = {Path('package.xml'): ROOT / 'package.xml',
              **{Path('launch') / path.name: path
                 for path in PACKAGE.glob('nodes/launch/*.launch.py')},
              **{path.relative_to(ROOT): path for folder in ('config', 'resource/orb_slam3')
                 for path in (ROOT / folder).rglob('*') if path.is_file()}}
    installed = {path.relative_to(share) for path in share.rglob('*')
                 if path.is_file() and path.suffix != '.pyc'}
    assert installed == set(wanted)
    for name, source in wanted.items():
        assert (share / name).read_bytes() == source.read_bytes()


def test_installed_package_works(prefix: Path) -> None:
    """It is imported from the environment, and finds its own configuration and shaders."""
    script = """
import json
from importlib import resources
import lunar_rover_sim
from lunar_rover_sim.base.files.paths import config_path, packaged_names
from lunar_rover_sim.run.scenario import Scenario
Scenario.load('baseline')
print(json.dumps([
    lunar_rover_sim.__file__, str(config_path('rovers/quad.yaml')), packaged_names('campaign'),
    resources.files('lunar_rover_sim.image.rendering').joinpath('shaders/view.glsl').is_file()]))
"""
    finished = run_installed(prefix, 'python', '-c', script)
    assert finished.returncode == 0, finished.stderr
    module, config, campaigns, has_shader = json.loads(finished.stdout)
    assert Path(module).is_relative_to(prefix)
    assert Path(config).is_relative_to(prefix)
    assert campaigns == ['polar_suns', 'rocks']
    assert has_shader


def test_console_scripts(prefix: Path) -> None:
    """The command line and every node have a script, and each leads to its program."""
    scripts = distribution(prefix).entry_points.select(group='console_scripts')
    assert {script.name for script in scripts} == {'lunar_rover_sim', 'lunar_rover_sim_node'}
    for script in scripts:
        assert callable(script.load())
        assert (prefix / 'bin' / script.name).is_file()
    finished = run_installed(prefix, 'lunar_rover_sim', 'parameters', 'run')
    assert finished.returncode == 0, finished.stderr
    assert 'duration_s' in finished.stdout
    nodes = {path.stem for path in PACKAGE.glob('nodes/*_node.py')}
    assert set(NODES) == nodes
    start = ROOT / 'resource' / 'nodes' / 'start'
    assert {path.name for path in start.parent.iterdir()} - {'start'} == nodes
    for node in nodes:
        assert (start.parent / node).samefile(start)
        installed = prefix / 'bin' / node
        assert installed.read_bytes() == start.read_bytes() and os.access(installed, os.X_OK)


def test_scripts_of_nodes_start_them(prefix: Path) -> None:
    """Under its own name, through a link, and by the name given."""
    (prefix / 'linked').mkdir()
    (prefix / 'linked' / 'drive_node').symlink_to(prefix / 'bin' / 'drive_node')
    for program in ('drive_node', '../linked/drive_node'):
        finished = run_installed(prefix, program, '--ros-args', '-p', 'no_such:=1')
        assert finished.returncode == 1
        assert finished.stderr.startswith('FATAL no_such: no such parameter of drive_node') or \
            'rclpy is missing' in finished.stderr
    for program in (['drive_node', '--help'], ['lunar_rover_sim_node', 'drive_node', '-h']):
        helped = run_installed(prefix, *program)
        assert helped.returncode == 0 and not helped.stderr
        assert helped.stdout.startswith('usage: drive_node ')
        assert helped.stdout.endswith('lunar_rover_sim parameters drive_node\n')
    finished = run_installed(prefix, 'lunar_rover_sim_node', 'walk_node')
    assert finished.returncode == 1
    assert finished.stderr == f"FATAL 'walk_node' is not a node; valid are {', '.join(NODES)}\n"


def test_extras(prefix: Path) -> None:
    """The extras that README and bootstrap name exist; colcon runs pytest where `test` has it."""
    wheel = distribution(prefix)
    assert {'ros', 'cluster', 'test', 'docs'} <= set(wheel.metadata.get_all('Provides-Extra'))
    assert any(line.startswith('pytest>') and 'test' in line for line in wheel.requires or [])


def test_setup_knows_pip_from_colcon(tmp_path: Path) -> None:
    """The command line is in bin/ of a workspace, and all its sources are seen where colcon asks
    for them: it links them for `--symlink-install`. pip makes bin/ itself.
    """
    ask = ('import sys; from distutils.core import run_setup; '
           'found = run_setup("setup.py", sys.argv[1:], stop_after="config"); '
           'print(len(found.scripts), [name for name, _ in found.data_files if name == "bin"])')
    for word, programs in (('--dry-run', ['bin']), ('develop', ['bin']), ('bdist_wheel', [])):
        finished = subprocess.run([sys.executable, '-c', f'import setuptools; {ask}', word],
                                  cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S)
        assert finished.stdout == f'{len(NODES)} {programs}\n', finished.stderr


def test_bootstrap_refuses_nonsense() -> None:
    """An unknown word ends it in one line that names the valid ones, before anything is done."""
    finished = subprocess.run([str(ROOT / 'bootstrap'), 'tset'], capture_output=True, text=True)
    assert finished.returncode == 1
    assert finished.stdout == ''
    assert finished.stderr == \
        "bootstrap: 'tset' is not valid; valid are: no argument, demo, docs, lock, test, " \
        'test --quick\n'
