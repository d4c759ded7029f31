"""Injects faults into real runs and judges how they end; run on demand, not a test of pytest.

    python test/faults.py -o FOLDER [--seed 1] [--scale 1.0] [--only KIND]

Each fault must have its effect within LIMIT_S, times `slowness` of a loaded machine: the run ends
with a status that is not 0 and one line that names the cause, or goes on and completes where that
is what is documented; the bag up to the fault opens; nothing is left running. Faults are drawn
from the seed. Writes faults.json and faults.md into FOLDER and exits with 1 if any fault was not
survived.

Kinds: kill (SIGKILL of a node), stop (SIGSTOP of a node), disk (a small tmpfs fills; needs root),
world (files of the world vanish while the nodes start or run), cmd_vel (NaN, infinity, 1e9, a
flood of 1 kHz; the run must go on).
"""

from __future__ import annotations

import argparse
from collections import Counter
import dataclasses
import json
import os
from pathlib import Path
import shutil
import signal
import subprocess
import time

from faulty_run import ALL, BLIND, END_S, Fault, must_end, opens, Run, SMALL_WORLD, START_S
import numpy as np

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.ground.world.cache import cached
from lunar_rover_sim.run.ros_domain import OwnDomain
from lunar_rover_sim.run.scenario import Scenario

TMPFS_MB = 12
GARBAGE = ('nan', 'inf', '-inf', '1e9', '-1e9', 'flood', 'flood of nan')
FLOOD_HZ, FLOOD_S = 1000, 2.0


def plan(rng: np.random.Generator, scale: float) -> list[Fault]:
    """Return the faults to inject, drawn from the generator."""
    faults = []
    for kind, times in (('kill', 8), ('stop', 3)):
        for node in ALL:
            for _ in range(max(1, round(times * scale))):
                faults.append(Fault(kind, node, float(rng.uniform(0.0, 2.0)),
                                    ALL if node == 'render_node' else BLIND))
    for _ in range(max(1, round(8 * scale))):
        faults.append(Fault('disk', f'{TMPFS_MB} MB', 0.0,
                            ALL if rng.random() < 0.4 else BLIND))
    for _ in range(max(1, round(8 * scale))):
        seen = rng.random() < 0.4
        faults.append(Fault('world', str(rng.choice(['height_0.npy', 'world.yaml', 'the folder'])),
                            float(rng.uniform(0.0, 4.0)), ALL if seen else BLIND))
    rng.shuffle(faults)  # type: ignore[arg-type]
    return faults


def inject(fault: Fault, folder: Path, world: Path) -> None:
    """Start a run, inject the fault, fill in what came of it."""
    if fault.kind == 'disk':
        disk(fault, folder, world)
    elif fault.kind == 'world':
        lose_world(fault, folder, world)
    else:
        with Run(folder, fault.nodes, world, 600.0) as run:
            trouble = run.wait_for_recording()
            if trouble:
                fault.problems.append(trouble)
                return
            time.sleep(fault.delay_s)
            pid = run.node(fault.target)
            os.kill(pid, signal.SIGKILL if fault.kind == 'kill' else signal.SIGSTOP)
            must_end(fault, run, [f'{fault.target} ended with SIGKILL'] if fault.kind == 'kill'
                     else [fault.target])


def disk(fault: Fault, folder: Path, world: Path) -> None:
    """Record onto a tmpfs that is too small."""
    mount = folder.with_name(folder.name + '_disk')
    mount.mkdir()
    subprocess.run(['mount', '-t', 'tmpfs', '-o', f'size={TMPFS_MB}m', 'tmpfs', str(mount)],
                   check=True)
    try:
        with Run(mount / 'run', fault.nodes, world, 600.0) as run:
            deadline = time.monotonic() + 4 * START_S
            while run.process.poll() is None and time.monotonic() < deadline:
                if shutil.disk_usage(mount).free < 65536:
                    break
                time.sleep(0.05)
            must_end(fault, run, ['No space left'])
    finally:
        subprocess.run(['umount', '-l', str(mount)], check=False)
        mount.rmdir()


def lose_world(fault: Fault, folder: Path, world: Path) -> None:
    """Remove a file of the world some time after the start, while nodes load it or later.

    Who has read it goes on (the ground is held in memory), and then the run completes; who has
    not says so.
    """
    copy = folder.with_name(folder.name + '_world')
    shutil.copytree(world, copy)
    with Run(folder, fault.nodes, copy, 2.0) as run:
        deadline = time.monotonic() + START_S
        while not (folder / 'logs').is_dir() and run.process.poll() is None:
            if time.monotonic() > deadline:
                fault.problems.append('did not start')
                return
            time.sleep(0.02)
        time.sleep(fault.delay_s)
        if fault.target == 'the folder':
            shutil.rmtree(copy)
        else:
            (copy / fault.target).unlink()
        start = time.monotonic()
        fault.status, fault.said = run.finish(END_S)
        fault.took_s = time.monotonic() - start
        if fault.status:    # who goes on takes as long as the run
            run.judge_time(fault)
        if fault.status == 0:
            opens(fault, run, complete=True)
        elif fault.status is None:
            fault.problems.append('neither ended nor went on')
        elif str(copy) not in fault.said and 'world' not in fault.said:
            fault.problems.append(f'does not name the world: {fault.said[-300:]}')
        elif len(fault.said.splitlines()) != 1:
            fault.problems.append(f'{len(fault.said.splitlines())} lines')
    shutil.rmtree(copy, ignore_errors=True)


def shout(faults: list[Fault], folder: Path, world: Path) -> None:
    """Send garbage to cmd_vel of one run, one kind after the other; time must go on each time."""
    from geometry_msgs.msg import TwistStamped
    import rclpy

    from lunar_rover_sim.nodes.clock_monitor import ClockMonitor

    nodes = ('physics_node', 'gait_controller_node', 'recorder_node')
    with OwnDomain() as own:
        domain = own.id
    os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
    with Run(folder, nodes, world, 600.0, '--domain', str(domain)) as run:
        trouble = run.wait_for_recording()
        with ClockMonitor() as clock:
            node = rclpy.create_node('shouter')
            publisher = node.create_publisher(TwistStamped, 'cmd_vel', 10)
            for fault in faults:
                fault.nodes = nodes
                if trouble or run.process.poll() is not None:
                    fault.problems.append(trouble or f'had ended: {run.finish(1.0)[1]}')
                    continue
                flood = fault.target.startswith('flood')
                word = fault.target.removeprefix('flood of ')
                message = TwistStamped()
                value = 0.1 if word == 'flood' else float(word)
                message.twist.linear.x = message.twist.angular.z = value
                before_ns = clock.now_ns()
                message.header.stamp.sec = before_ns // 10**9
                start = time.monotonic()
                for k in range(round(FLOOD_S * FLOOD_HZ) if flood else 20):
                    publisher.publish(message)
                    pause = start + (k + 1) / FLOOD_HZ - time.monotonic() if flood else 0.02
                    if pause > 0.0:
                        time.sleep(pause)
                sent = time.monotonic()
                target_ns = clock.now_ns() + 500_000_000
                while clock.now_ns() < target_ns and time.monotonic() < sent + START_S:
                    time.sleep(0.02)
                fault.took_s = time.monotonic() - sent
                run.judge_time(fault)
            node.destroy_node()
        if trouble:
            return
        if run.process.poll() is None:
            run.process.send_signal(signal.SIGINT)
        status, said = run.finish(END_S)
        for fault in faults:
            fault.status, fault.said = status, said
            if status != 130:
                fault.problems.append(f'status {status} after Ctrl-C: {said[-200:]}')
            opens(fault, run)
        log = (folder / 'logs' / 'gait_controller_node.log').read_text(errors='replace')
        if 'refused' not in log and any(f.target in ('nan', 'inf', '-inf') for f in faults):
            faults[0].problems.append('the gait controller did not say that it refused a command')
        finite(faults[0], run)


def finite(fault: Fault, run: Run) -> None:
    """Nothing of the garbage has reached the state."""
    with open_bag(run.folder / 'bag') as bag:
        for _, _, message in bag.messages(['/odom']):
            p = message.pose.pose.position
            if not all(np.isfinite([p.x, p.y, p.z])):
                fault.problems.append('odometry is not finite')
                return


def main() -> int:
    """Inject, judge, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('-o', '--output', type=Path, required=True)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--scale', type=float, default=1.0, help='of the number of faults')
    parser.add_argument('--only', default='', help='one kind of fault')
    args = parser.parse_args()
    # Who is started in the background of a shell ignores Ctrl-C, and so do its children.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    folder = args.output.resolve()
    folder.mkdir(parents=True)
    rng = np.random.default_rng(args.seed)
    faults = [f for f in plan(rng, args.scale) if args.only in ('', f.kind)]
    shouts = [[Fault('cmd_vel', str(word), 0.0) for word in rng.permutation(GARBAGE)]
              for _ in range(max(1, round(5 * args.scale)))]
    if args.only not in ('', 'cmd_vel'):
        shouts = []
    scenario = Scenario.load('baseline', SMALL_WORLD)
    world = Path(cached(scenario.world, scenario.shared.seed))
    total = len(faults) + sum(map(len, shouts))
    done: list[Fault] = []

    def took(new: list[Fault], run: Path) -> None:
        done.extend(new)
        for fault in new:
            fault.load = os.getloadavg()[0]
            print(f'{len(done)}/{total} {fault.kind} {fault.target}: '
                  + ('; '.join(fault.problems) or f'ok, {fault.took_s:.1f} s'), flush=True)
        shutil.rmtree(run, ignore_errors=True)
        report(done, total, args.seed, folder)

    for k, group in enumerate(shouts):
        shout(group, folder / f'shout_{k}', world)
        took(group, folder / f'shout_{k}')
    for k, fault in enumerate(faults):
        inject(fault, folder / f'run_{k}', world)
        took([fault], folder / f'run_{k}')
    return int(any(f.problems for f in done))


def report(done: list[Fault], total: int, seed: int, folder: Path) -> None:
    """Write what is known so far."""
    (folder / 'faults.json').write_text(
        json.dumps([dataclasses.asdict(f) for f in done], indent=1) + '\n')
    kinds = Counter(f.kind for f in done)
    load, slow = (float(np.median([getattr(f, name) for f in done]))
                  for name in ('load', 'slowness'))
    lines = [f'{len(done)} of {total} faults injected, seed {seed}; median load {load:.1f} on '
             f'{os.cpu_count()} cores, where work took {slow:.1f} times its processor time.', '',
             '| fault | injected | as documented | in time | slowest [s] |',
             '|---|---|---|---|---|']
    for kind, count in kinds.items():
        of_kind = [f for f in done if f.kind == kind]
        # A problem that is only one of time says so by its first word.
        right = sum(all(p.startswith('took ') for p in f.problems) for f in of_kind)
        lines.append(f'| {kind} | {count} | {right} | {sum(not f.problems for f in of_kind)} | '
                     f'{max(f.took_s for f in of_kind):.1f} |')
    lines += ['', *(f'- {f.kind} {f.target}: {"; ".join(f.problems)}' for f in done
                    if f.problems)]
    (folder / 'faults.md').write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    raise SystemExit(main())
