"""What a forge runs: workflows that name what exists, and the script that judges an estimator."""

import os
from pathlib import Path
import re
import subprocess
import sys

from command_line import unfolded
from conftest import PLAIN, RIGID, SMALL, TINY
import pytest
import yaml

from lunar_rover_sim.cli.main import main
from lunar_rover_sim.run.scenario import Scenario

ROOT = Path(__file__).parents[1]
ACTION = ROOT / '.github/actions/judge'
# The commands of this interpreter's environment, which need not be on the path of who tests.
BIN = Path(sys.executable).parent
PATH = f"{BIN}:{os.environ['PATH']}"


@pytest.mark.parametrize('name', ['test', 'release'])
def test_workflows_call_what_is_there(name: str) -> None:
    workflow = yaml.safe_load((ROOT / f'.github/workflows/{name}.yml').read_text())
    jobs = workflow['jobs'].values()
    called = [job for job in jobs if 'uses' in job]
    assert all((ROOT / job['uses']).is_file() for job in called)
    jobs = [job for job in jobs if job not in called]
    assert jobs and all(job['steps'] and job['runs-on'] for job in jobs)
    lines = '\n'.join(step.get('run', '') for job in jobs for step in job['steps'])
    called = set(re.findall(r'\S*bootstrap\b( \w+)?', lines))
    assert called <= {'', ' docs', ' test'} and ' docs' in called
    # Extras and files that a step names.
    assert 'libgl1-mesa-dri' in lines or 'docker build' in lines


# A wrapper that apt does not have, and names that tests of skipping use.
NOT_OF_APT = {'orbslam3', 'lunar_rover_sim', 'no_such_package'}


def test_a_job_installs_what_the_tests_beside_other_stacks_need(
        pytestconfig: pytest.Config) -> None:
    jobs = yaml.safe_load((ROOT / '.github/workflows/test.yml').read_text())['jobs']
    lines = [step.get('run', '') for step in jobs['stacks']['steps']]
    tests = (ROOT / 'test/nodes/test_stacks.py').read_text()
    needed = {package for words in re.findall(r'needs\(([^)]*)\)', tests)
              for package in re.findall(r"'(\w+)'", words)} - NOT_OF_APT
    installed = set(re.findall(r'ros-jazzy-([a-z0-9-]+)', ''.join(lines)))
    assert len(needed) > 10 and {name.replace('_', '-') for name in needed} <= installed
    command = 'python -m pytest -m stacks -rs test/nodes'
    assert lines[-1].splitlines()[-1] == command
    assert command in (ROOT / 'docs/howto/stacks.md').read_text()
    assert 'pytest.mark.stacks' in tests
    assert any(line.startswith('stacks:') for line in pytestconfig.getini('markers'))


def test_the_action_hands_all_inputs_to_its_script() -> None:
    action = yaml.safe_load((ACTION / 'action.yml').read_text())
    handed = {value[len('${{ inputs.'):-len(' }}')]
              for step in action['runs']['steps'] for value in step.get('env', {}).values()}
    assert handed == set(action['inputs'])
    names = {name for step in action['runs']['steps'] for name in step.get('env', {})}
    read = set(re.findall(r'\$\{([A-Z_]+):', (ACTION / 'judge').read_text()))
    assert names == read


@pytest.mark.ros
def test_the_script_fails_above_a_bound_only(tmp_path: Path) -> None:
    """With an estimator of the user's that says that it moves along a parabola."""
    program = tmp_path / 'guess.py'
    program.write_text('import sys\n'
                       'with open(sys.argv[2], "w") as out:\n'
                       '    for line in open(sys.argv[1]):\n'
                       '        t = int(line.split()[0]) * 1e-9\n'
                       '        print(t, 0.1 * t, 0.1 * t * t, 0, 0, 0, 0, 1, file=out)\n')

    scenario = Scenario.load('flat', [*SMALL, *TINY, *PLAIN, *RIGID])
    (tmp_path / 'small.yaml').write_text(scenario.to_yaml())

    def judged(bound: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [ACTION / 'judge'], capture_output=True, text=True, cwd=tmp_path,
            env={**os.environ, 'PATH': PATH, 'SCENARIO': 'small.yaml', 'DURATION': '0.5',
                 'MAX_ATE': bound, 'OUTPUT': f'of_{bound}',
                 'RUN': f'python {program} {{times}} {{out}}'})
    strict = judged('0.000001')
    assert strict.returncode == 1
    said = unfolded(strict.stderr)
    assert 'ATE is' in said and '--max-ate asks for at most 1e-06 m' in said
    assert (tmp_path / 'of_0.000001/result/result.json').is_file()
    # The same drive again would take as long as the first.
    assert main(['slam', 'run', str(tmp_path / 'of_0.000001/drive'), '-o',
                 str(tmp_path / 'again'), '--system', 'command', '--max-ate', '1',
                 '--run', f'{sys.executable} {program} {{times}} {{out}}']) == 0


def test_the_script_wants_a_bound(tmp_path: Path) -> None:
    env = {name: value for name, value in os.environ.items() if name != 'MAX_ATE'}
    done = subprocess.run([ACTION / 'judge'], capture_output=True, text=True, cwd=tmp_path,
                          env=env)
    assert done.returncode != 0 and 'MAX_ATE' in done.stderr
    assert not list(tmp_path.iterdir())
