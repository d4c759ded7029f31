"""The locomotion study on several grounds: straight walks over the relief of regolith.

One world per seed, of the recipe of `baseline` without craters and rocks, is walked over on every
ground at every speed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
import functools
from pathlib import Path

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.judge.studies.ground_comparison import (compare, comparison_text,
                                                             plot_comparison, Quantity)
from lunar_rover_sim.judge.studies.study_folder import map_in_processes
from lunar_rover_sim.judge.studies.terramechanics import Ground, GroundWalk, measure, WalkSettings

SIZE_M, SAMPLES = 12.8, 257   # of the worlds: room for a walk, and no more
WALKED = 'walked'

QUANTITIES = (
    Quantity('speed [m/s]', lambda w: w.speed_mps, 4),
    Quantity('slip [%]', lambda w: 1e2 * w.slip, 1),
    Quantity('electric cost of transport', lambda w: w.transport, 2),
    Quantity('electric power [W]', lambda w: w.power_w, 3),
    Quantity('pitch RMS [°]', lambda w: w.pitch_rms_deg, 2),
    Quantity('share that stops', lambda w: float(w.outcome != WALKED), 2, share=True))

Walks = Mapping[float, Mapping[str, Sequence[GroundWalk]]]


def study(settings: WalkSettings, grounds: Sequence[str],
          speeds_mps: Sequence[float], seeds: Sequence[int], workers: int = 1,
          progress: Callable[[int, int], object] = lambda done, total: None) -> Walks:
    """Return speed → ground → walks in the order of seeds."""
    worlds = WorldConfig()
    relief = dataclasses.replace(
        worlds, size_m=SIZE_M, craters=dataclasses.replace(worlds.craters, density=0.0),
        rocks=dataclasses.replace(worlds.rocks, abundance=0.0),
        surroundings=dataclasses.replace(worlds.surroundings, samples=SAMPLES))
    jobs = [(speed, name, seed) for seed in seeds for speed in speeds_mps for name in grounds]
    walks = dict(zip(jobs, map_in_processes(functools.partial(_walk, settings, relief), jobs,
                                            workers,
                                            lambda _, done, total: progress(done, total))))
    return {speed: {name: [walks[speed, name, seed] for seed in seeds] for name in grounds}
            for speed in speeds_mps}


def write_all(walks: Walks, folder: Path) -> str:
    """Write grounds.md and a figure for each speed into a folder; return the text."""
    parts = ['# Straight walks on several grounds', '']
    for speed, results in walks.items():
        parts += [f'## {speed:g} m/s', '',
                  comparison_text(compare(results, QUANTITIES), next(iter(results)))]
        plot_comparison(results, QUANTITIES, folder / f'grounds_{speed:g}.png')
    text = '\n'.join(parts)
    atomic_write(folder / 'grounds.md', text, StudyError)
    return text


def _walk(settings: WalkSettings, relief: WorldConfig,
          job: tuple[float, str, int]) -> GroundWalk:
    speed, name, seed = job
    return measure(dataclasses.replace(settings, speed_mps=speed), Ground(name),
                   _relief_world(relief, seed))


@functools.lru_cache(maxsize=1)
def _relief_world(config: WorldConfig, seed: int) -> World:
    return build_world(config, seed)
