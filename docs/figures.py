"""Figures of the pages: taken from result files, marked where they are old, measured anew.

    python docs/figures.py                  which are missing or older than what they depend on
    python docs/figures.py measure          measure these, one after the other; Ctrl-C and go on
    python docs/figures.py measure NAME     measure this one, whatever its age

`docs/measurements/results/NAME.json` has a command, a line for the shell, and what its results
depend on. What the command writes to `{file}`, as JSON, are values; tables that it prints are kept
as lines. `{new}` is a folder that is not there yet, `{kept}` one in which it goes on; `files` of
the latter stay for pages, each by a name of its own. A page says `{{ NAME.value }}` or, on a line,
`{{ NAME.table }}`, and is filled in when it is built.

What a figure depends on is a subject, such as the light. Its state is a sum over files that change
whenever its behaviour does: hashes of worlds, stored numbers of the regression cases, reference
pictures; or code.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
import datetime
import hashlib
import json
import os
from pathlib import Path
import platform
import re
import shutil
import subprocess
import sys
from typing import Any

import lunar_rover_sim

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / 'docs' / 'measurements' / 'results'
# Files; of some only the lines that begin so.
SUBJECTS: dict[str, tuple[str, ...]] = {
    'ground': ('test/ground/world/test_same_everywhere.py::KNOWN',),
    'walk': ('test/regression/test_rover/*.csv',),
    'soil': ('lunar_rover_sim/ground/regolith/law.py', 'lunar_rover_sim/ground/regolith/soil.py'),
    'light': ('test/regression/test_light/*.csv', 'test/regression/test_images/*.csv',
              'test/image/rendering/test_pictures/*.npz'),
    'place': ('lunar_rover_sim/judge/slam/graph/*.py',
              'lunar_rover_sim/ground/world/orbital_making.py',
              'lunar_rover_sim/ground/world/orbital_map.py'),
    'navigator': ('lunar_rover_sim/autonomy/navigation/*.py',),
    'reward': ('lunar_rover_sim/autonomy/learning/follow.py', 'config/policies/*'),
}


def state(subject: str) -> str:
    """Return the sum over the files of a subject, 12 hexadecimal digits."""
    digest = hashlib.sha256()
    for pattern in SUBJECTS[subject]:
        files, _, begin = pattern.partition('::')
        for path in sorted(ROOT.glob(files)):
            digest.update(b''.join(line for line in path.read_bytes().splitlines(keepends=True)
                                   if line.startswith(begin.encode())))
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
    """Return what pages put in: NAME → value → text.

    What is older than a change is marked by † and, below a table and in `where`, in words.
    """
    texts = {}
    for name, result in read().items():
        measured, old = result.get('measured'), changed(result)
        command = re.sub(r' (--json {file}|-o {(new|kept)}(\.csv)?|--resume)', '',
                         result['command']).replace('{new}', 'DIR')
        where = 'not yet measured' if measured is None else (
            f'{measured["machine"]}, {measured["date"]}, version {measured["version"]}')
        where += f'; **† before a change of the {", ".join(old)}**' if old else ''
        texts[name] = {'command': f'`{command}`', 'where': where, **{
            key: (f'{value:g}' if isinstance(value, float) else str(value)) + ' †' * bool(old)
            for key, value in result.get('values', {}).items()}}
        if 'table' in result:
            texts[name]['table'] = '\n'.join([*result['table'], '', f'`{command}`: {where}.'])
    return texts


def table_of(printed: Sequence[str]) -> list[str]:
    """Return tables among printed lines as Markdown, also those with boxes, with their titles."""
    lines: list[str] = []
    title: list[str] = []
    for said in map(str.strip, printed):
        row = [cell.strip() for cell in re.split('[|│┃]', said)[1:-1]]
        if said.startswith('## '):
            title = ['', f'**{said[3:]}**', '']
        elif said[:1] in ('|', '│', '┃') and not all(re.fullmatch(':?-+:?', cell) for cell in row):
            goes_on = lines and not title
            lines += [*title, f'| {" | ".join(row)} |',
                      *([] if goes_on else ['|---' * len(row) + '|'])]
            title = []
    return lines


def measure(names: Iterable[str]) -> None:
    """Measure results one after the other; each is written as soon as it is there."""
    for name in names:
        path = RESULTS / f'{name}.json'
        result = json.loads(path.read_text(encoding='utf-8'))
        states = {subject: state(subject) for subject in result['depends']}
        print(f'{name}: {result["command"]}', flush=True)
        work = ROOT / 'build' / 'figures' / '-'.join([name, *states.values()])
        paths = {'file': work / 'values.json', 'new': work / 'new', 'kept': work / 'kept'}
        shutil.rmtree(paths['new'], ignore_errors=True)
        work.mkdir(parents=True, exist_ok=True)
        line = re.sub('{(file|new|kept)}', lambda word: str(paths[word[1]]), result['command'])
        printed = []
        with subprocess.Popen(line, shell=True, cwd=ROOT, stdout=subprocess.PIPE, text=True, env={
                **os.environ, 'COLUMNS': '200',
                'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}'}) as process:
            for said in process.stdout or ():
                print(said, end='', flush=True)
                printed.append(said)
        if process.returncode:
            raise SystemExit(f'{name}: ended with status {process.returncode}')
        if '{file}' in result['command']:
            result['values'] = json.loads(paths['file'].read_text(encoding='utf-8'))
        else:
            result['table'] = table_of(printed)
        result['measured'] = {
            'version': lunar_rover_sim.__version__,
            'date': datetime.date.today().isoformat(),
            'machine': f'{processor()}, Python {platform.python_version()}',
            'states': states}
        path.write_text(json.dumps(result, indent=2, ensure_ascii=False) + '\n', encoding='utf-8')
        for of_command, of_pages in result.get('files', {}).items():
            shutil.copyfile(paths['kept'] / of_command, RESULTS.parent / of_pages)
        shutil.rmtree(work)


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
