"""What colcon, pip and ros2 need to know of the package: all of it said, and said alike."""

from __future__ import annotations

import ast
import importlib
from importlib import resources
import os
from pathlib import Path
import re
import subprocess
import sys
from typing import Any
from unittest import mock
import xml.etree.ElementTree as ET

import pytest

import lunar_rover_sim

ROOT = Path(__file__).resolve().parent.parent
NODES = {'physics_node', 'gait_controller_node', 'render_node', 'recorder_node', 'drive_node'}
# That catkin_pkg takes for an address; with any other colcon does not see a ROS package.
ADDRESS = re.compile(r'[-a-zA-Z0-9_%+]+(\.[-a-zA-Z0-9_%+]+)*'
                     r'@[-a-zA-Z0-9%]+(\.[-a-zA-Z0-9%]+)*\.[a-zA-Z]{2,}')
ROS = ('rclpy', 'launch', 'launch_ros', 'rcl_interfaces', 'builtin_interfaces')


@pytest.fixture(scope='module')
def manifest() -> ET.Element:
    """Return the root of package.xml."""
    return ET.parse(ROOT / 'package.xml').getroot()


@pytest.fixture(scope='module')
def arguments() -> dict[str, Any]:
    """Return what setup.py hands to setuptools."""
    pytest.importorskip('setuptools')
    folder = os.getcwd()
    os.chdir(ROOT)
    try:
        with mock.patch('setuptools.setup') as setup:
            exec(compile((ROOT / 'setup.py').read_text(encoding='utf-8'), 'setup.py', 'exec'),
                 {'__name__': '__main__'})
    finally:
        os.chdir(folder)
    return setup.call_args.kwargs


def installed_files(arguments: dict[str, Any]) -> dict[str, str]:
    """Return data file below the prefix → its place in the source tree."""
    return {f'{folder}/{Path(name).name}': name
            for folder, names in arguments['data_files'] for name in names}


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
    for folder in ('nodes', 'launch'):
        for path in (ROOT / 'lunar_rover_sim' / folder).glob('*.py'):
            for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
                if isinstance(node, ast.ImportFrom):
                    imported.add(str(node.module).partition('.')[0])
                elif isinstance(node, ast.Import):
                    imported.update(alias.name.partition('.')[0] for alias in node.names)
    needed = {name for name in imported
              if name in ROS or name.endswith(('_msgs', '_srvs', '_interfaces'))}
    assert 'rclpy' in needed
    assert needed <= declared


def test_versions(manifest: ET.Element, arguments: dict[str, Any]) -> None:
    """One version and one description, wherever they stand."""
    assert manifest.findtext('version') == arguments['version'] == lunar_rover_sim.__version__
    assert manifest.findtext('name') == arguments['name']
    assert manifest.findtext('license') == arguments['license']
    maintainer = manifest.find('maintainer')
    assert maintainer is not None
    assert maintainer.get('email') == arguments['maintainer_email']
    assert maintainer.text == arguments['maintainer']


def test_data_files(arguments: dict[str, Any]) -> None:
    """Marker, manifest, launch file and every file of config/ go where ros2 looks for them."""
    installed = installed_files(arguments)
    assert 'share/ament_index/resource_index/packages/lunar_rover_sim' in installed
    assert installed['share/lunar_rover_sim/package.xml'] == 'package.xml'
    assert 'share/lunar_rover_sim/launch/sim.launch.py' in installed
    for path in (ROOT / 'config').rglob('*'):
        if path.is_file():
            name = path.relative_to(ROOT).as_posix()
            assert installed.get(f'share/lunar_rover_sim/{name}') == name
    for source in installed.values():
        assert (ROOT / source).is_file()


def test_package_data(arguments: dict[str, Any]) -> None:
    """Everything in the package that is not Python is declared, or wheels come without it."""
    package = ROOT / 'lunar_rover_sim'
    declared = {path for pattern in arguments['package_data']['lunar_rover_sim']
                for path in package.glob(pattern)}
    others = {path for path in package.rglob('*')
              if path.is_file() and path.suffix not in ('.py', '.pyc')}
    assert others == {path for path in declared if path.is_file()}
    assert resources.files('lunar_rover_sim.rendering').joinpath('shaders/common.glsl').is_file()


def test_packages(arguments: dict[str, Any]) -> None:
    """Every folder with modules is a package: setuptools leaves out what has no __init__.py."""
    folders = {path.parent for path in (ROOT / 'lunar_rover_sim').rglob('*.py')}
    names = {'.'.join(folder.relative_to(ROOT).parts) for folder in folders}
    # The launch file is data, not a module.
    assert set(arguments['packages']) == names - {'lunar_rover_sim.launch'}


def test_console_scripts(arguments: dict[str, Any]) -> None:
    """The command line and every node have a script, and each leads to a function."""
    scripts = dict(re.split(r'\s*=\s*', line, maxsplit=1)
                   for line in arguments['entry_points']['console_scripts'])
    nodes = {path.stem for path in (ROOT / 'lunar_rover_sim' / 'nodes').glob('*_node.py')}
    assert nodes >= NODES
    assert set(scripts) == {'lunar_rover_sim', *nodes}
    for target in scripts.values():
        module, _, function = target.partition(':')
        assert callable(getattr(importlib.import_module(module), function))


def test_scripts_folder() -> None:
    """Ros2 run looks in lib/lunar_rover_sim, wherever colcon installs or links."""
    from configparser import ConfigParser

    settings = ConfigParser()
    settings.read(ROOT / 'setup.cfg')
    assert settings['install']['install_scripts'] == '$base/lib/lunar_rover_sim'
    assert settings['develop']['script_dir'] == '$base/lib/lunar_rover_sim'


def test_colcon_test_finds_pytest(arguments: dict[str, Any]) -> None:
    """Colcon runs pytest only where the package says that it tests with it."""
    assert any(line.startswith('pytest') for line in arguments['extras_require']['test'])


def test_bootstrap_refuses_nonsense() -> None:
    """An unknown word ends it in one line that names the valid ones, before anything is done."""
    finished = subprocess.run([str(ROOT / 'bootstrap'), 'tset'], capture_output=True, text=True)
    assert finished.returncode == 1
    assert finished.stdout == ''
    assert finished.stderr == \
        "bootstrap: 'tset' is not valid; valid are: no argument, demo, test\n"


# Hides rclpy, as where no ROS 2 is installed; then runs a console script.
_WITHOUT_ROS = """
import importlib.abc, sys
class Hide(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == 'rclpy':
            raise ModuleNotFoundError(name)
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == 'rclpy' else found(name, *rest)
sys.meta_path.insert(0, Hide())
from lunar_rover_sim.{module} import {function}
sys.exit({function}({argument}))
"""


def without_ros(module: str, function: str, argument: str = '') \
        -> subprocess.CompletedProcess[str]:
    """Run a function of ours in a process where rclpy cannot be imported."""
    script = _WITHOUT_ROS.format(module=module, function=function, argument=argument)
    return subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          cwd=ROOT, timeout=60)


def test_nodes_without_ros() -> None:
    """A node says in one line what is missing and how to get it."""
    finished = without_ros('nodes.entry_points', 'render_node')
    assert finished.returncode == 1
    assert finished.stderr.count('\n') == 1
    assert 'rclpy is missing' in finished.stderr
    assert "pip install 'lunar_rover_sim[ros]'" in finished.stderr


def test_run_without_ros(tmp_path: Path) -> None:
    """So does `run`, before it makes its folder; other commands do without ROS."""
    folder = tmp_path / 'run'
    finished = without_ros('cli.main', 'main', f"['run', 'flat', '-o', {str(folder)!r}]")
    assert finished.returncode == 1
    assert finished.stderr.count('\n') == 1
    assert 'rclpy is missing' in finished.stderr
    assert not folder.exists()
    finished = without_ros('cli.main', 'main', "['bag', 'check', '/no/such/bag']")
    assert finished.stderr == 'lunar_rover_sim: /no/such/bag: there is no such bag\n'
