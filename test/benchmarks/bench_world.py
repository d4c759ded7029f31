"""CPU time and memory of building, saving and loading worlds: `bench_world.py [--large]`.

The next window is that of a rover that has gone on by a step of windows.

Each case runs in a process of its own, on one core. `--large` adds a world of 204.8 m at 2.5 cm.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import resource
import subprocess
import sys
import tempfile
import time

CASES = {
    'baseline': {},
    '10,000 rocks': {'rocks': {'abundance': 0.035, 'min_diameter_m': 0.01}},
    'flat': {'relief': {'rms_slope_deg': 0.0, 'far_rms_slope_deg': 0.0},
             'craters': {'density': 0.0}, 'rocks': {'abundance': 0.0}},
    'dem': {'source': 'dem'},
    'mesh': {'source': 'mesh'},
}
STEP_M = 12.8
LARGE = {'204.8 m': {'size_m': 204.8}}


def sources(folder: pathlib.Path) -> None:
    """Write an elevation model of 2000 x 2000 pixels of 5 m and a mesh of 100,000 triangles."""
    import numpy as np
    import trimesh

    from lunar_rover_sim.ground.world import export
    from lunar_rover_sim.ground.world.grid import HeightGrid
    axis = np.arange(2000) * 5.0
    heights = 20.0 * np.sin(axis / 200.0) * np.cos(axis[:, None] / 150.0)
    (folder / 'dem').mkdir()
    np.save(folder / 'dem' / 'dem.npy', heights.astype(np.float32))
    (folder / 'dem' / 'dem.yaml').write_text('size: [2000, 2000]\npixel_size: [5.0, -5.0]\n')
    axis = (np.arange(225) - 112) * 0.36
    grid = HeightGrid(np.sin(axis + axis[:, None]).astype(np.float32), 0.36)
    trimesh.Trimesh(*export.surface(grid), process=False).export(folder / 'mesh.ply')


def measure(name: str, folder: pathlib.Path, values_file: pathlib.Path | None) -> None:
    """Build one case and print one line; write its values, if a file is given."""
    from lunar_rover_sim.ground.world import world_folder
    from lunar_rover_sim.ground.world.build import Builder
    from lunar_rover_sim.ground.world.config import WorldConfig
    mapping = {**CASES, **LARGE}[name]
    if 'source' in mapping:
        mapping = {**mapping, 'path': str(folder / {'dem': 'dem', 'mesh': 'mesh.ply'}[name])}
    start = time.process_time()
    builder = Builder(WorldConfig.from_mapping({**mapping, 'seed': 1}))
    world = builder.window((0.0, 0.0))
    built = time.process_time()
    builder.window((STEP_M, 0.0))
    stepped = time.process_time()
    world_folder.save_world(world, folder / f'world {name}')
    saved = time.process_time()
    world_folder.load_world(folder / f'world {name}')
    loaded = time.process_time()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    if values_file is not None:
        values_file.write_text(json.dumps({'build_s': round(built - start, 1),
                                           'step_s': round(stepped - built, 1),
                                           'peak_mib': round(peak)}))
    print(f'{name:<14} build {built - start:6.2f} s   next window {stepped - built:5.2f} s   '
          f'save {saved - stepped:5.2f} s   '
          f'load and check {loaded - saved:5.2f} s   peak {peak:6.0f} MiB   '
          f'{len(world.rocks)} rocks', flush=True)


def main() -> None:
    """Run all cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--large', action='store_true', help='add a world of 204.8 m')
    parser.add_argument('--case', help=argparse.SUPPRESS)
    parser.add_argument('--folder', type=pathlib.Path, help=argparse.SUPPRESS)
    parser.add_argument('--json', type=pathlib.Path, help='file of the values of `baseline`')
    args = parser.parse_args()
    if args.case:
        measure(args.case, args.folder, args.json)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        sources(folder)
        environment = {**os.environ, 'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
        for case in [*CASES, *(LARGE if args.large else [])]:
            written = ['--json', str(args.json)] if args.json and case == 'baseline' else []
            subprocess.run([sys.executable, __file__, '--case', case, '--folder', str(folder),
                            *written], env=environment, check=True)


if __name__ == '__main__':
    main()
