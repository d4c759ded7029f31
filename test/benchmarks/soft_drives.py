"""Drives of an hour on loose ground: `python test/benchmarks/soft_drives.py -o DIR [--seeds 10]`.

Each drive follows random commands on a rough slope at the friction angle of its soil, so that
about two fifths of what the feet sweep is slip. It has its own terrain, commands and start. Held
to, at every checkpoint (a minute):

- nothing diverges: no error of physics, and all heights are finite;
- no soil is lost: height changes, compaction and residue add up to 0;
- no change is lost: with --follow an overlay that is fed with the changes alone, ten times a
  second, equals that of the simulation at the end. It doubles the memory of the tracks.

A drive writes `seed_N.csv` as it goes and `seed_N.json` at its end; one that has its .json is not
driven again, so a run that was stopped goes on with the next drive. `--straight` drives straight
on over level ground at 0.2 m/s instead: the memory of a track of a given length.

Not a test of pytest: a drive takes 6 to 15 minutes of one core.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import csv
import json
import logging
import math
from pathlib import Path
import subprocess
import sys
import time

import numpy as np
import psutil

from lunar_rover_sim.base.errors import PhysicsError
from lunar_rover_sim.ground.regolith.config import GroundConfig, REGOLITH
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.calibration import GaitCalibration
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.gait.controller import GaitController
from lunar_rover_sim.rover.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.rover.physics.simulation import Simulation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from physics_scene import make_world  # noqa: E402

STATE_S = 0.005
COMMAND_S = 10.0
CHECK_S = 60.0
SLIP_EVERY = 20              # states; the slip of the feet is computed at one of them
SAMPLES, CELL_M = 3201, 0.25   # 800 m
RELIEF_M, RELIEF_CELLS = 0.05, 4.0
VOLUME_M = 1e-9              # of heights and compaction, over some 1e6 samples of 1e-3 to 1e-2 m
FIELDS = ('time_s', 'cpu_s', 'distance_m', 'x_m', 'y_m', 'slip', 'deepest_mm', 'dug_in_s',
          'overlay_mib', 'rss_mib', 'rss_grown_mib', 'sums_m')


def terrain(seed: int, slope_deg: float) -> np.ndarray:
    """Return heights that rise towards +x, with hills of 5 cm RMS some metres apart."""
    spectrum = np.fft.rfft2(np.random.default_rng(seed).normal(size=(SAMPLES, SAMPLES)))
    fx, fy = np.meshgrid(np.fft.rfftfreq(SAMPLES), np.fft.fftfreq(SAMPLES))
    spectrum *= np.exp(-2.0 * (np.pi * RELIEF_CELLS) ** 2 * (fx ** 2 + fy ** 2))
    hills = np.fft.irfft2(spectrum, (SAMPLES, SAMPLES))
    x = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) * CELL_M
    heights = hills * (RELIEF_M / hills.std()) + math.tan(math.radians(slope_deg)) * x
    return heights.astype(np.float32)


def commands(seed: int, straight: bool) -> Iterator[tuple[float, float]]:
    """Yield velocities [m/s, rad/s], one for every ten seconds."""
    rng = np.random.default_rng([seed, 1])
    while True:
        yield (0.2, 0.0) if straight else (rng.uniform(-0.05, 0.2), rng.uniform(-0.2, 0.2))


class SoftDrive:
    """One drive, its records and what is held of it."""

    def __init__(self, args: argparse.Namespace, seed: int) -> None:
        self._args, self._seed = args, seed
        slope_deg = 0.0 if args.straight else args.slope
        self._ground = GroundConfig(model=REGOLITH, preset=args.preset, friction=(
            -1.0 if args.straight else args.friction))
        world = make_world(terrain(seed, slope_deg), CELL_M)
        self._half_m = world.ground.half_extent_m
        yaw = 0.0 if args.straight else np.random.default_rng([seed, 2]).uniform(-180.0, 180.0)
        start = StartPose(x_m=-0.95 * self._half_m if args.straight else 0.0, yaw_deg=yaw)
        self.simulation = Simulation(world, RoverDescription(),
                                     PhysicsConfig(ground=self._ground, start=start))
        gait = GaitConfig()
        self._controller = GaitController(gait, GaitCalibration.of(gait, self._ground.name))
        self.overlay = self.simulation.overlay or Overlay()
        self._mirror = Overlay() if args.follow else None
        self._process = psutil.Process()
        self._swept = self._slipped = self._deepest = self._dug_in_s = self._distance = 0.0
        self._follow()
        self._rss_first = math.nan   # after the first minute, when all code has run
        self._cpu = time.process_time()

    def rows(self) -> Iterator[dict[str, float]]:
        """SoftDrive, and yield what was seen at each checkpoint."""
        simulation, controller, args = self.simulation, self._controller, self._args
        state, steps = simulation.state, round(STATE_S / simulation.config.step_s)
        xy = state.position_m[:2]
        per_command, per_check = round(COMMAND_S / STATE_S), round(CHECK_S / STATE_S)
        source = commands(self._seed, args.straight)
        for k in range(round(args.duration / STATE_S)):
            if k % per_command == 0:
                command = next(source)
                xy, before = state.position_m[:2], xy
                self._distance += float(np.hypot(*(xy - before)))
            controller.set_velocity(*command, state.stamp_ns)
            legs = controller.update(state.stamp_ns, state.joint_angle_rad,
                                     state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(steps)
            if k % SLIP_EVERY == 0:
                self._see()
            if (k + 1) % per_check == 0:
                yield self._row((k + 1) * STATE_S, state.position_m)
                if self._distance > args.distance:
                    return

    def lost_changes(self) -> bool | None:
        """Return whether an overlay made of the changes alone differs; None if none follows."""
        if self._mirror is None:
            return None
        self._follow()
        mine, other = self.overlay.snapshot(), self._mirror.snapshot()
        return not (np.array_equal(mine.index, other.index)
                    and np.array_equal(mine.height_m, other.height_m)
                    and np.array_equal(mine.compaction_m, other.compaction_m))

    def _see(self) -> None:
        motion, contact = self.simulation.foot_motion, self.simulation.ground_contact
        self._swept += float(np.abs(motion.sweep_mps).sum())
        self._slipped += float(np.abs(motion.slip_mps).sum())
        if contact is not None:
            self._deepest = max(self._deepest, float(contact.sinkage_m.max()))
            self._dug_in_s += contact.dug_in * SLIP_EVERY * STATE_S
        self._follow()

    def _follow(self) -> None:
        changes = self.overlay.take_changes()
        if self._mirror is not None:
            self._mirror.apply(changes)

    def _row(self, time_s: float, position_m: np.ndarray) -> dict[str, float]:
        heights, compaction = self.overlay.sums_m()
        sums = heights + compaction + self.overlay.residue_m
        if not abs(sums) < VOLUME_M:
            raise PhysicsError(f'soil is lost: the changes add up to {sums:g} m')
        rss = self._process.memory_info().rss
        if math.isnan(self._rss_first):
            self._rss_first = rss
        return dict(zip(FIELDS, (
            time_s, time.process_time() - self._cpu, self._distance, *position_m[:2].tolist(),
            self._slipped / max(self._swept, 1e-9), 1e3 * self._deepest, self._dug_in_s,
            self.overlay.memory_bytes / 2 ** 20, rss / 2 ** 20, (rss - self._rss_first) / 2 ** 20,
            sums)))


def drive(args: argparse.Namespace, seed: int) -> dict[str, object]:
    """Make one drive and return its result."""
    one = SoftDrive(args, seed)
    path = args.output / f'seed_{seed}.csv'
    outcome, row = 'driven', {}
    with open(path, 'w', newline='', encoding='utf-8') as file, one.simulation:
        table = csv.DictWriter(file, FIELDS)
        table.writeheader()
        try:
            for row in one.rows():
                table.writerow({name: f'{value:.6g}' for name, value in row.items()})
                file.flush()
        except PhysicsError as error:
            outcome = str(error)
        lost = one.lost_changes()
    if lost:
        outcome = 'changes are lost'
    return {'seed': seed, 'outcome': outcome, 'changes_followed': lost is not None,
            'settings': {name: value for name, value in vars(args).items() if name != 'output'},
            'version': version(), **row}


def version() -> str:
    """Return the commit of this file's tree, with + where it was changed."""
    here = Path(__file__).resolve().parent
    done = subprocess.run(['git', '-C', here, 'describe', '--always', '--dirty=+', '--abbrev=7'],
                          capture_output=True, text=True, check=False, timeout=60.0)
    return done.stdout.strip() or 'unknown'


def main() -> int:
    """SoftDrive what has not been driven yet; 1 if anything was lost or diverged."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--seeds', type=int, default=10, help='drives, with seeds from 1')
    parser.add_argument('--first', type=int, default=1, help='first seed')
    parser.add_argument('--duration', type=float, default=3600.0, help='simulated time [s]')
    parser.add_argument('--distance', type=float, default=math.inf, help='[m] that end a drive')
    parser.add_argument('--preset', default='highland_loose')
    parser.add_argument('--friction', type=float, default=0.47)
    parser.add_argument('--slope', type=float, default=25.0, help='[deg]')
    parser.add_argument('--follow', action='store_true', help='rebuild the ground from changes')
    parser.add_argument('--straight', action='store_true', help='straight on, on level ground')
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    logging.getLogger('lunar_rover_sim').setLevel(logging.ERROR)   # a warning each time it digs in
    failed = 0
    for seed in range(args.first, args.first + args.seeds):
        path = args.output / f'seed_{seed}.json'
        if not path.exists():
            result = drive(args, seed)
            path.write_text(json.dumps(result, indent=1) + '\n', encoding='utf-8')
        result = json.loads(path.read_text(encoding='utf-8'))
        print(json.dumps(result), flush=True)
        failed += result['outcome'] != 'driven'
    return min(failed, 1)


if __name__ == '__main__':
    sys.exit(main())
