"""Run parts of the tests as other processors compute: `python test/portability.py --help`.

Libraries choose their code by the processor. A switch makes one of them choose that of an older
one; `qemu` runs whole parts on an emulated processor, where qemu-user is installed. The table says
for each switch and part how many tests passed and failed.
"""

import argparse
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import time

import numpy as np

TEST = Path(__file__).resolve().parent
PARTS = {'regression': ('regression',), 'world': ('ground/world',),
         'gait': ('rover/gait', 'autonomy/path_following'),
         'light': ('image/illumination', 'sensors'),
         'physics': ('rover/physics', 'ground/regolith'),
         'evaluation': ('judge/evaluation', 'image/stereo', 'image/camera'),
         'lidar': ('image/lidar',), 'rendering': ('image/rendering',)}
# What drawing by llvmpipe cannot change.
WITHOUT_DRAWING = tuple(name for name in PARTS if name != 'rendering')


def numpy_features(oldest: bool) -> str:
    """Return what NumPy has code for and this processor offers: AVX-512; with AVX2 and FMA too.

    Their names have changed in NumPy 2.4: X86_V3 has AVX2 and FMA, X86_V4 AVX-512.
    """
    core = np._core if hasattr(np, '_core') else np.core
    known = core._multiarray_umath.__cpu_features__
    return ' '.join(name for name in core._multiarray_umath.__cpu_dispatch__
                    if known.get(name) and (oldest or name.startswith(('AVX512', 'X86_V4'))))


def switches() -> dict[str, dict[str, str]]:
    """Return the environment of each switch. Libraries ignore what the processor does not have."""
    oldest = {
        'NumPy without AVX2': {'NPY_DISABLE_CPU_FEATURES': numpy_features(oldest=True)},
        'C library without AVX2': {
            'GLIBC_TUNABLES': 'glibc.cpu.hwcaps=-AVX512F,-AVX2,-AVX2_Usable,-FMA,-FMA_Usable'},
        'OpenCV without AVX2': {'OPENCV_CPU_DISABLE': 'AVX512_SKX,AVX512_ICL,AVX2,FMA3,AVX'},
        'Numba generic': {'NUMBA_CPU_NAME': 'generic'},
        'OpenBLAS of Nehalem': {'OPENBLAS_CORETYPE': 'Nehalem'},
        'llvmpipe with 128 bit': {'LP_NATIVE_VECTOR_WIDTH': '128'},
        'llvmpipe without AVX': {'GALLIUM_OVERRIDE_CPU_CAPS': 'sse4.1'}}
    return {'as it is': {},
            'NumPy without AVX-512': {'NPY_DISABLE_CPU_FEATURES': numpy_features(oldest=False)},
            **oldest, 'all of these': {name: value for each in oldest.values()
                                       for name, value in each.items()}}


def outcome(said: str, status: int) -> str:
    """Return `passed`, `passed, failed` or the reason of an end, from what pytest says."""
    counts = {word: int(number) for number, word in re.findall(
        r'(\d+) (passed|failed|error)', said.strip().rpartition('\n')[2])}
    if status < 0:
        return f'signal {-status}'
    if status > 1 or not counts:
        return f'status {status}'
    wrong = counts.get('failed', 0) + counts.get('error', 0)
    return f'{counts.get("passed", 0)}' + (f', {wrong} failed' if wrong else '')


def run(tests: list[str], environment: dict[str, str], emulator: list[str],
        limit_s: float) -> tuple[str, str]:
    """Run tests without ROS in a process of their own; return the outcome and what it says."""
    if 'NPY_DISABLE_CPU_FEATURES' in environment and not environment['NPY_DISABLE_CPU_FEATURES']:
        return '–', ''
    words = [*emulator, sys.executable, '-m', 'pytest', '-m', 'not ros', '-o', 'addopts=',
             '--import-mode=importlib', '--tb=short', '-p', 'no:cacheprovider', *tests]
    try:
        done = subprocess.run(words, cwd=TEST.parent, capture_output=True, text=True,
                              env={**os.environ, 'OPENBLAS_NUM_THREADS': '1', **environment},
                              timeout=limit_s)
    except subprocess.TimeoutExpired:
        return f'over {limit_s:g} s', ''
    return outcome(done.stdout, done.returncode), done.stdout + done.stderr


def table(rows: list[list[str]]) -> str:
    """Return rows as aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    return '\n'.join('  '.join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip()
                     for row in rows)


def main() -> int:
    """Run the chosen parts under the chosen switches; return 1 if a test fails."""
    known = switches()
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0].partition(':')[0])
    parser.add_argument('--parts', nargs='+', choices=PARTS, default=list(WITHOUT_DRAWING),
                        help='by default all but rendering')
    parser.add_argument('--switches', nargs='+', choices=known, default=list(known),
                        metavar='SWITCH', help='by default all: ' + '; '.join(known))
    parser.add_argument('--qemu', nargs='+', default=[], metavar='CPU',
                        help='processors to emulate as well, such as Nehalem (qemu-x86_64 -cpu '
                        'help lists them): twenty to sixty times as slow')
    parser.add_argument('--limit', type=float, default=1800.0, metavar='S',
                        help='wall time of a part under a switch')
    args = parser.parse_args()
    emulator = shutil.which('qemu-x86_64')
    if args.qemu and emulator is None:
        parser.error('--qemu: qemu-x86_64 is not installed; apt-get install qemu-user')
    ways = [(name, known[name], []) for name in args.switches]
    ways += [(f'qemu {cpu}', {}, [str(emulator), '-cpu', cpu]) for cpu in args.qemu]
    rows, failures = [['', *args.parts, 'time']], []
    for name, environment, words in ways:
        cells, start_s = [], time.monotonic()
        for part in args.parts:
            cell, said = run([str(TEST / folder) for folder in PARTS[part]], environment, words,
                             args.limit)
            cells.append(cell)
            if not re.fullmatch(r'\d+|–', cell):
                failures.append(f'{name}, {part}: {cell}\n{said[-6000:]}')
        rows.append([name, *cells, f'{time.monotonic() - start_s:.0f} s'])
        print(table(rows[-1:]), file=sys.stderr, flush=True)
    print(*failures, table(rows), sep='\n\n')
    return 1 if failures else 0


if __name__ == '__main__':
    raise SystemExit(main())
