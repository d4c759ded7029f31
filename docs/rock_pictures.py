"""WebDataset shards of single pictures with labels and depth, drawn without a graph.

    python docs/rock_pictures.py FOLDER [--train 4] [--test 2] [--pictures 40]

For each scenario so many worlds are built for training and for testing, and the rover is put
somewhere on them, under one sun a world. FOLDER/train-000000.tar, ... hold what is drawn, a world
a shard, and FOLDER/train.json and test.json list them. Samples have the files of `bag export
--format webdataset`: left.png, labels.npy, depth.npy and json. What is there already is kept.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from lunar_rover_sim.base.files.images import png_bytes
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.snapshot import standing
from lunar_rover_sim.products.sequences.shards import (described, index_text, npy_bytes,
                                                       shard_name, ShardWriter)
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

SCENARIOS = ('baseline', 'feature_sparse', 'permanent_shadow')
# Small worlds with coarse surroundings: seconds each.
SETTINGS = ('world.size_m=12.8', 'world.surroundings.samples=257', 'render_node.camera.width=320',
            'render_node.camera.height=240', 'render_node.sensor.exposure_mode=auto',
            'render_node.sensor.auto_lag=0.0')
REACH_M = 4.5               # of places from the middle of a world
ELEVATIONS_DEG = (4.0, 30.0)


def draw(writer: ShardWriter, base: str, seed: int, pictures: int) -> None:
    """Write pictures of one world."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(-180.0, 180.0), rng.uniform(*ELEVATIONS_DEG)
    scenario = Scenario.load(base, [
        *SETTINGS, f'seed={seed}', f'render_node.sun.azimuth_deg={azimuth:.6f}',
        f'render_node.sun.elevation_deg={elevation:.6f}'])
    world = scenario.load_world()
    # Noise and the relief below the grid have one seed: they are prepared once.
    with Renderer(world, scenario.rover, scenario.render_node, 1) as renderer:
        for k in range(pictures):
            x, y = rng.uniform(-REACH_M, REACH_M, 2)
            state = RoverPose(standing(world, x, y, rng.uniform(-180.0, 180.0)))
            renderer.render(state, k, ('left',))    # exposure follows the frame before
            frame = renderer.render(state, k, ('left', 'label', 'depth'))
            told = {'drive': f'{base}-{seed}', 'base': base, 'world': world.hash,
                    'T_odom_left': (state.T_world_base @ renderer.rig.T_base_left).tolist()}
            writer.write(f'{base}-{seed}-{k:06d}', {
                'left.png': png_bytes(frame.layer('left')), 'json': json.dumps(told).encode(),
                'labels.npy': npy_bytes(frame.layer('label').astype(np.uint16)),
                'depth.npy': npy_bytes(frame.layer('depth'))})


def main() -> None:
    """Draw what the command line names."""
    parser = argparse.ArgumentParser(description='Shards of pictures with labels and depth.')
    parser.add_argument('folder', type=Path)
    parser.add_argument('--train', type=int, default=4, help='worlds a scenario')
    parser.add_argument('--test', type=int, default=2, help='worlds a scenario')
    parser.add_argument('--pictures', type=int, default=40, help='pictures a world')
    args = parser.parse_args()
    # Worlds differ by their seeds: no seed is used twice.
    jobs = [(split, base, 1000 * (split == 'test') + 10 * k + number)
            for split, count in (('train', args.train), ('test', args.test))
            for k in range(count) for number, base in enumerate(SCENARIOS)]
    args.folder.mkdir(parents=True, exist_ok=True)
    shards = {'train': [], 'test': []}
    for split, base, seed in jobs:
        path = args.folder / shard_name(split, len(shards[split]))
        if not path.exists():
            partial = args.folder / f'.{split}'
            partial.mkdir(exist_ok=True)
            with ShardWriter(partial, args.pictures) as writer:
                draw(writer, base, seed, args.pictures)
            (partial / writer.shards[0].name).rename(path)
            partial.rmdir()
            print(path, flush=True)
        shards[split].append(described(path, args.pictures))
        (args.folder / f'{split}.json').write_text(index_text(f'rocks {split}', shards[split], {}),
                                                   encoding='ascii')


if __name__ == '__main__':
    main()
