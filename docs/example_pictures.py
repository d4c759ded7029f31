"""The pictures of the gallery: each program of `examples/` runs, and what it makes is drawn.

    python docs/example_pictures.py resource/pictures/examples [--only own_sensor teleop]

Writes FOLDER/NAME.webp. Needs ROS 2 for the recording and for teleop, and the extra `cluster`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
import importlib.util
import os
from pathlib import Path
import tempfile
import threading
import time
from typing import Any

import cv2
import matplotlib
import numpy as np

from lunar_rover_sim import evaluate, open_bag, record, Scenario, Simulation, Trajectory
from lunar_rover_sim.bag.series import read_odometry
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.products.sequences.export import export
from lunar_rover_sim.run.ros_domain import OwnDomain

matplotlib.use('Agg')
from matplotlib import pyplot  # noqa: E402  (behind the choice of a backend)

SIZE_IN, DPI, QUALITY = (4.8, 2.7), 100, 80
FARTHEST_M = 8.0
# Of the keys w, a and d, each pressed ten times a second for so long [s].
KEYS = ('w', 4.0), ('a', 2.5), ('w', 4.0), ('d', 2.5), ('w', 3.0)


def example(name: str) -> Any:
    """Return an example as a module."""
    path = Path(__file__).parents[1] / 'examples' / f'{name}.py'
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@contextmanager
def watched() -> Iterator[list[Any]]:
    """Yield a list that gets every state which a simulation reaches meanwhile."""
    advance, states = Simulation.advance, list[Any]()

    def kept(simulation: Simulation, steps: int = 1) -> Any:
        state = advance(simulation, steps)
        if states and state.stamp_ns <= states[-1].stamp_ns:
            states.clear()      # the rover had settled
        states.append(state)
        return state

    Simulation.advance = kept       # type: ignore[method-assign]
    try:
        yield states
    finally:
        Simulation.advance = advance    # type: ignore[method-assign]


def axes(columns: int = 1, height_in: float = SIZE_IN[1]) -> Any:
    """Return the axes of a new figure, one or several side by side."""
    return pyplot.subplots(1, columns, figsize=(SIZE_IN[0], height_in), dpi=DPI,
                           layout='constrained')[1]


def images(*pairs: tuple[str, Array]) -> None:
    """Draw images side by side: grey ones, and depths as colours."""
    height, width = pairs[0][1].shape
    height_in = SIZE_IN[0] / len(pairs) * height / width + 0.3
    for one, (title, pixels) in zip(np.atleast_1d(axes(len(pairs), height_in)), pairs):
        depth = pixels.dtype == np.float32
        shown = np.where(np.isfinite(pixels) & (pixels > 0), pixels, np.nan) if depth else pixels
        one.imshow(shown, cmap='turbo' if depth else 'gray', vmin=0,
                   vmax=FARTHEST_M if depth else 255)
        one.set_title(title, fontsize=9)
        one.set_axis_off()


def path(one: Any, positions_m: Array, label: str = '') -> None:
    """Draw a path from above."""
    one.plot(positions_m[:, 0], positions_m[:, 1], label=label)
    one.set(xlabel='x [m]', ylabel='y [m]', aspect='equal')
    one.set_adjustable('datalim')


def step_and_draw(folder: Path) -> None:
    example('step_and_draw').main(folder)
    images(('left.png', cv2.imread(str(folder / 'left.png'), cv2.IMREAD_GRAYSCALE)),
           ('depth_m.npy', np.load(folder / 'depth_m.npy').astype(np.float32)))


def record_and_read(folder: Path) -> None:
    example('record_and_read').main(folder)
    with open_bag(folder / 'bag') as bag:
        counts = sorted(bag.counts.items(), key=lambda entry: entry[1])
    one = axes()
    one.barh([name for name, _ in counts][-14:], [count for _, count in counts][-14:])
    one.tick_params(labelsize=6)
    one.set_xlabel('messages')


def recorded(folder: Path) -> Path:
    """Return a bag of a second."""
    return record(Scenario.load('baseline', seed=3, duration_s=1.0), folder).bag or folder


def frames_as_numpy(folder: Path) -> None:
    bag = recorded(folder)
    example('frames_as_numpy').main(bag)
    with open_bag(bag) as opened:
        frame = next(frame for frame in opened.frames() if frame.depth_m is not None)
    assert frame.right is not None and frame.depth_m is not None
    images(('frame.left', frame.left), ('frame.right', frame.right),
           ('frame.depth_m', frame.depth_m))


def own_scenario(folder: Path) -> None:
    folder.mkdir()
    example('own_scenario').main(folder / 'own.yaml')
    scenario = Scenario.load(folder / 'own.yaml')
    with scenario.simulation() as simulation, scenario.renderer() as renderer:
        for k in range(3):      # the exposure settles
            frame = renderer.render(simulation.state, k)
    images(('abundance 0.05, sun at 3° from behind', frame.left))


def own_controller(folder: Path) -> None:
    module, goal_m = example('own_controller'), (1.0, 0.5)
    with watched() as states:
        module.main(*goal_m)
    one = axes()
    path(one, np.array([state.position_m for state in states]), 'path')
    one.plot(*goal_m, 'x', label='goal')
    one.legend()


def own_sensor(folder: Path) -> None:
    readings, one = example('own_sensor').main(), axes()
    one.plot(0.1 * np.arange(1, len(readings) + 1), readings, '.-', label=['roll', 'pitch'])
    one.set(xlabel='time [s]', ylabel='tilt [deg]')
    one.legend()


def own_estimator(folder: Path) -> None:
    module = example('own_estimator')
    with watched() as states:
        module.main(10.0)
    truth = Trajectory.of_states(states)
    estimate, one = module.dead_reckoning(truth.stamps_ns), axes()
    path(one, truth.positions_m, 'truth')
    path(one, estimate.positions_m, 'dead reckoning')
    one.set_title(f'ATE {1e3 * evaluate(truth, estimate).ate_m.rmse:.0f} mm', fontsize=9)
    one.legend()


def sweep_with_dask(folder: Path) -> None:
    reached, one = example('sweep_with_dask').main(), axes()
    one.plot(list(reached), list(reached.values()), 'o-', label='reached')
    one.plot(list(reached), list(reached), '--', color='grey', label='commanded')
    one.set(xlabel='commanded [m/s]', ylabel='speed [m/s]')
    one.legend()


def live_view(folder: Path) -> None:
    example('live_view').main(6.0)
    pyplot.gcf().set_size_inches(6.4, 2.7)


def teleop(folder: Path) -> None:
    module, over = example('teleop'), threading.Event()
    scenario = Scenario.load('flat', {
        'time_mode': 'real_time', 'run.duration_s': 600.0,
        'run.nodes': ['physics_node', 'gait_controller_node', 'recorder_node']})
    source, keyboard = os.pipe()
    with OwnDomain() as own:        # a free one
        domain = own.id
    os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
    with ThreadPoolExecutor(2) as threads:
        going = threading.Event()
        run = threads.submit(record, scenario, folder, domain=domain, should_stop=over.is_set,
                             on_progress=lambda now_ns: going.set() if now_ns else None)

        def press() -> None:
            going.wait(60.0)
            for key, how_long_s in KEYS:
                end = time.monotonic() + how_long_s
                while time.monotonic() < end:
                    os.write(keyboard, key.encode())
                    time.sleep(0.1)
            os.write(keyboard, b'q')

        threads.submit(press)
        module.main(module.pressed(source))
        over.set()
        bag = run.result().bag
    assert bag is not None
    with open_bag(bag) as opened:
        one = axes()
        path(one, read_odometry(opened).positions_m)
    one.set_title('keys: ' + ', '.join(f'{key} {s:g} s' for key, s in KEYS), fontsize=9)


def table_in_short(folder: Path) -> None:
    errors_mm, one = example('table_in_short').main(), axes()
    bars = one.barh(list(errors_mm), list(errors_mm.values()))
    one.bar_label(bars, fmt='%.2f')
    one.set_xlabel('ATE [mm] after 3 s')


def pytorch_shards(folder: Path) -> None:
    export(recorded(folder), folder / 'shards', 'webdataset')
    module = example('pytorch_shards')
    module.main(folder / 'shards')
    samples = [sample for sample, _ in zip(module.Shards(folder / 'shards'), range(3))]
    images(*((f'image {k}', 255 * image[0].astype(float)) for k, (image, _) in enumerate(samples)),
           ('depth 2', samples[-1][1]))


DRAWN: dict[str, Callable[[Path], None]] = {draw.__name__: draw for draw in (
    step_and_draw, record_and_read, frames_as_numpy, own_scenario, own_controller, own_sensor,
    own_estimator, sweep_with_dask, live_view, teleop, table_in_short, pytorch_shards)}


def main() -> None:
    """Draw them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('folder', type=Path)
    parser.add_argument('--only', nargs='+', choices=DRAWN, default=list(DRAWN), metavar='NAME')
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    for name in args.only:
        with tempfile.TemporaryDirectory() as text:
            DRAWN[name](Path(text) / name)
        canvas: Any = pyplot.gcf().canvas
        canvas.draw()
        pixels = cv2.cvtColor(np.asarray(canvas.buffer_rgba()), cv2.COLOR_RGBA2BGR)
        cv2.imwrite(str(args.folder / f'{name}.webp'), pixels,
                    [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
        pyplot.close('all')


if __name__ == '__main__':
    main()
