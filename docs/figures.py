"""Figures of the pages: taken from result files, marked where they are old, measured anew.

    python docs/figures.py                  which are missing or older than what they depend on
    python docs/figures.py measure          measure these, one after the other; Ctrl-C and go on
    python docs/figures.py measure NAME     measure this one, whatever its age

`docs/measurements/results/NAME.json` has the command, which writes its values to `{file}`, and
what they depend on. A page says `{{ NAME.value }}`, and is filled in when it is built.

What a figure depends on is a subject, such as the light. Its state is a sum over files that change
whenever its behaviour does: hashes of worlds, and stored numbers of the regression cases.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
import datetime
import hashlib
import json
from pathlib import Path
import platform
import shlex
import subprocess
import sys
import tempfile
from typing import Any

import lunar_rover_sim

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / 'docs' / 'measurements' / 'results'
SUBJECTS: dict[str, tuple[str, ...]] = {
    'ground': ('test/ground/world/test_same_everywhere.py',),
    'walk': ('test/regression/test_rover/*.csv',),
    'soil': ('lunar_rover_sim/ground/regolith/law.py', 'lunar_rover_sim/ground/regolith/soil.py'),
    'light': ('test/regression/test_light/*.csv', 'test/regression/test_images/*.csv'),
}


def state(subject: str) -> str:
    """Return the sum over the files of a subject, 12 hexadecimal digits."""
    digest = hashlib.sha256()
    for pattern in SUBJECTS[subject]:
        for path in sorted(ROOT.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def read() -> dict[str, dict[str, Any]]:
    """Return all results by their names."""
    return {path.stem: json.loads(path.read_text(encoding='utf-8'))
            for path in sorted(RESULTS.glob('*.json'))}


def changed(result: Mapping[str, Any]) -> list[str]:
    """Return the subjects that have changed since a result was measured."""
    measured = result['measured']['states'] if 'measured' in result else {}
    return [subject for subject, then in measured.items() if then != state(subject)]


def substitutions() -> dict[str, dict[str, str]]:
    """Return what pages put in: NAME → value → text, with a mark where it is old."""
    texts = {}
    for name, result in read().items():
        old = changed(result)
        mark = f' (before a change of the {" and ".join(old)})' if old else ''
        texts[name] = {key: f'{value:g}{mark}' if isinstance(value, float) else f'{value}{mark}'
                       for key, value in result.get('values', {}).items()}
        texts[name]['command'] = f'`{result["command"].replace(" --json {file}", "")}`'
        texts[name]['where'] = result.get('measured', {}).get('machine', 'not yet measured')
    return texts


def measure(names: Iterable[str]) -> None:
    """Measure results one after the other; each is written as soon as it is there."""
    for name in names:
        path = RESULTS / f'{name}.json'
        result = json.loads(path.read_text(encoding='utf-8'))
        print(f'{name}: {result["command"]}', flush=True)
        with tempfile.TemporaryDirectory() as folder:
            values = Path(folder) / 'values.json'
            words = shlex.split(result['command'].replace('{file}', str(values)))
            ended = subprocess.run([sys.executable, *words[1:]] if words[0] == 'python' else words,
                                   cwd=ROOT)
            if ended.returncode or not values.is_file():
                raise SystemExit(f'{name}: ended with status {ended.returncode}')
            result['values'] = json.loads(values.read_text(encoding='utf-8'))
        result['measured'] = {
            'version': lunar_rover_sim.__version__,
            'date': datetime.date.today().isoformat(),
            'machine': f'{processor()}, Python {platform.python_version()}',
            'states': {subject: state(subject) for subject in result['depends']}}
        path.write_text(json.dumps(result, indent=2) + '\n', encoding='utf-8')


def processor() -> str:
    """Return the name of the processor."""
    for line in Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines():
        if line.startswith('model name'):
            return line.partition(':')[2].strip()
    return platform.machine()


def main() -> None:
    """List the results that are to be measured, or measure."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('action', nargs='?', choices=['measure'])
    parser.add_argument('names', nargs='*', metavar='NAME', help='of results; by default the old')
    args = parser.parse_args()
    results = read()
    unknown = set(args.names) - set(results)
    if unknown:
        parser.error(f'{", ".join(sorted(unknown))}: no such result; valid are '
                     f'{", ".join(results)}')
    old = {name: subjects for name, result in results.items()
           if (subjects := changed(result)) or 'measured' not in result}
    if args.action == 'measure':
        measure(args.names or list(old))
    else:
        for name, subjects in old.items():
            print(f'{name}: {"changed since: " + ", ".join(subjects) if subjects else "missing"}')


if __name__ == '__main__':
    main()
