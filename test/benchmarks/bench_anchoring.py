"""Finding the place on a map from orbit, over unseen sites: way to the first fix, false fixes.

    python test/benchmarks/bench_anchoring.py -o DIR
    python test/benchmarks/bench_anchoring.py -o DIR --maps other shifted negated

What is seen of the relief is that of `relief_ways`. The odometry drifts by a scale and a heading
that are wrong for the whole drive and by a random walk. The start is known to 50 m. Finished
drives are kept in DIR: the same command goes on.
"""

import argparse
import dataclasses
import math
from pathlib import Path

import numpy as np
from relief_ways import orbital, STEP_M, Way, way
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.files.results import markdown_table
from lunar_rover_sim.base.frames import inverse, se3
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
from lunar_rover_sim.judge.evaluation.statistics import Median, Share, signed_rank_p
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import fixes, Nees
from lunar_rover_sim.judge.slam.graph.anchor import Anchor, Doubt
from lunar_rover_sim.judge.slam.graph.pose_graph import PoseGraph
from lunar_rover_sim.judge.studies.study_folder import StudyFolder

LENGTH_M, DOUBT_M, GOAL_M = 100.0, 50.0, 60.0
SCALE, WALK_M = 0.005, np.array([0.01, 0.01, 0.015])    # a drive; each root of a metre
HEADING_RAD, TILT_RAD = math.radians(0.3), math.radians(0.1)
KNOWN_RAD = np.radians([0.3, 0.3, 0.4])     # of the attitude, as the graph has it
TOLD_EVERY = 2
# Maps of the site that are not those of `world export --orbital` as it is.
OTHERWISE = {'heights of 5 m': {'pixel_m': 5.0}, 'photo at 10°': {'sun_elevation_deg': 10.0},
             'photo at 45°': {'sun_elevation_deg': 45.0}}
KINDS = 'own', 'without photo', *OTHERWISE, 'other', 'shifted', 'negated'


def mapped(seed: int, kind: str, folder: Path) -> OrbitalMap:
    """Return the map of a site, or one that is not of it."""
    of = seed + 1 if kind == 'other' else seed
    file = folder / '_'.join(['map', str(of), *(kind.split() if kind in OTHERWISE else ())])
    if not file.exists():
        orbital(of, **OTHERWISE.get(kind, {})).save(file)
    good = OrbitalMap.load(file)
    if kind == 'without photo':
        return dataclasses.replace(good, photo=np.zeros((0, 0), np.uint8))
    if kind == 'negated':
        # Slopes that were bright are dark.
        dark = np.clip(np.median(good.photo)**2 / np.maximum(good.photo, 1.0), 1.0, 255.0)
        return dataclasses.replace(good, heights_m=-good.heights_m, photo=dark.astype(np.uint8))
    if kind == 'shifted':
        first, photo_first = ((x + 100.0, y) for x, y in (good.first_m, good.photo_first_m))
        return dataclasses.replace(good, first_m=first, photo_first_m=photo_first)
    return good


def walk(seen: Way, anchor: Anchor, rng: np.random.Generator) -> tuple[Trajectory, Trajectory]:
    """Return the truth, and what was told at the time, after each TOLD_EVERY looks."""
    graph, true = PoseGraph(), seen.T_world_base
    scale = 1.0 + SCALE * rng.standard_normal()
    wrong = Rotation.from_rotvec([*TILT_RAD * rng.standard_normal(2),
                                  HEADING_RAD * rng.standard_normal()]).as_matrix()
    sigma = np.array([*3 * [1e-4], *WALK_M * math.sqrt(STEP_M)])
    drifted = se3(wrong @ true[0, :3, :3], np.zeros(3))
    graph.add(0, drifted)
    R = drifted[:3, :3]
    known = 1e-10 * np.eye(6)
    known[:3, :3] = R.T @ np.diag(KNOWN_RAD**2) @ R
    graph.prior(0, drifted, known)
    anchor.begin(graph, True)
    told = []
    for key, points in enumerate(seen.points_m):
        if key:
            moved = inverse(true[key - 1]) @ true[key]
            moved[:3, 3] = scale * moved[:3, 3] + true[key, :3, :3].T @ (
                sigma[3:] * rng.standard_normal(3))
            drifted = graph.pose(key - 1) @ moved
            graph.add(key, drifted)
            graph.between(key - 1, key, moved, np.diag(sigma**2))
        graph.solve()
        anchor.add(key, graph.pose(key), points[np.isfinite(points[:, 0])], seen.T_base_left)
        if anchor.look(graph):
            graph.solve()
        if key % TOLD_EVERY == 0:
            graph.solve()
            told.append((key, *anchor.told(graph, key)))
    keys = [key for key, _, _ in told]
    stamps = np.array(keys, np.int64) * 1_000_000_000
    poses = np.array([T for _, T, _ in told])
    covariances = []
    for T, P in zip(poses, (P for _, _, P in told)):
        J = np.zeros((6, 6))
        J[:3, 3:] = J[3:, :3] = T[:3, :3]
        covariances.append(J @ P @ J.T)

    def trajectory(T, name, P=None):
        return Trajectory(stamps, T[:, :3, 3], wxyz(Rotation.from_matrix(T[:, :3, :3])), name, P)
    return (trajectory(true[keys], 'truth'),
            trajectory(poses, 'told', np.array(covariances)))


def drive(seed: int, kind: str, folder: Path) -> dict:
    """Return the figures of one drive."""
    rng = np.random.default_rng([seed, 5])
    seen = way(seed, LENGTH_M, folder)
    angle, radius = rng.uniform(-math.pi, math.pi), DOUBT_M * math.sqrt(rng.uniform())
    near = seen.T_world_base[0, :2, 3] + radius * np.array([math.cos(angle), math.sin(angle)])
    anchor = Anchor(mapped(seed, kind, folder), Doubt((near[0], near[1]), DOUBT_M))
    truth, told = walk(seen, anchor, rng)
    found = fixes(truth, told)
    after = truth.distances_m >= found.first_m
    errors = (told.positions_m - truth.positions_m)[after]
    nees = (Nees.of(errors, told.covariances[after, :3, :3]).per_dof if after.any()
            else math.nan)
    return {'seed': seed, 'kind': kind, 'first_m': found.first_m,
            'fixes': found.count, 'false': found.false, 'nees': nees, 'looks': anchor.looks,
            'refused': anchor.refused, 'contradicted': anchor.contradicted,
            'losses': anchor.losses,
            'errors_m': np.linalg.norm(errors[:, :2], axis=1).round(3).tolist()}


def table(drives: list[dict]) -> list[str]:
    """Return a table with a line for each map."""
    lines = []
    for kind in dict.fromkeys(d['kind'] for d in drives):
        some = [d for d in drives if d['kind'] == kind]
        fixed = [d for d in some if d['fixes']]
        errors = np.concatenate([d['errors_m'] for d in fixed]) if fixed else np.zeros(0)

        def share(flags):
            found = Share.of(sum(flags), len(some))
            return f'{sum(flags)}/{len(some)} [{found.low:.2f}, {found.high:.2f}]'

        lines.append([
            kind, share([bool(d['fixes']) for d in some]),
            share([d['first_m'] <= GOAL_M for d in some]),
            Median.of([d['first_m'] for d in some]).text(0),
            share([d['false'] > 0 for d in some]),
            Median.of([np.median(d['errors_m']) for d in fixed]).text(2),
            f'{np.percentile(errors, 95):.2f}, {errors.max():.2f}' if fixed else '–',
            Median.of([d['nees'] for d in fixed]).text(2), str(sum(d['losses'] for d in some))])
    return markdown_table(
        ['map', 'found', f'within {GOAL_M:g} m', 'first fix [m]', 'false fix',
         'error after [m]', 'p95, greatest [m]', 'NEES per dof', 'losses'], lines)


def main() -> None:
    """Make the drives that are missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--seeds', type=int, default=30)
    parser.add_argument('--first-seed', type=int, default=201)
    parser.add_argument('--maps', nargs='+', default=KINDS, choices=KINDS)
    given = parser.parse_args()
    store: StudyFolder[str, dict] = StudyFolder(
        given.output, f'{LENGTH_M:g} m, doubt {DOUBT_M:g} m\n', resume=True)
    drives = []
    for kind in given.maps:
        for seed in range(given.first_seed, given.first_seed + given.seeds):
            name = f'{kind.rstrip("°").replace(" ", "_")}_{seed}'
            made = store.load(name)
            if made is None:
                made = drive(seed, kind, given.output / 'ways')
                store.save(name, made)
                print(name, {k: v if k != 'errors_m' else v[-1:] for k, v in made.items()
                             if k not in ('seed', 'kind')}, flush=True)
            drives.append(made)
    print(*table(drives), sep='\n')
    own = {d['seed']: d['first_m'] for d in drives if d['kind'] == 'own'}
    for kind in ('without photo', *OTHERWISE):
        pairs = [(d['first_m'], own[d['seed']]) for d in drives
                 if d['kind'] == kind and d['seed'] in own]
        later = np.subtract(*np.transpose(pairs)) if pairs else np.zeros(0)
        later = later[np.isfinite(later)]
        if len(later) > 1:
            print(f'{kind}: the first fix is {np.median(later):.0f} m later, median of '
                  f'{len(later)} pairs; p of no difference {signed_rank_p(later):.2g}')


if __name__ == '__main__':
    main()
