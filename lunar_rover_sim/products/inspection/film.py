"""A film of a recorded drive: the rover from outside, what its camera saw, map, pitch and slip.

The view from outside is drawn anew from the true states, the changes of the ground and the
scenario in the bag; no ROS is needed.
"""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import cv2
from matplotlib import font_manager
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from lunar_rover_sim.bag import series
from lunar_rover_sim.bag.ground_points import changes_of
from lunar_rover_sim.bag.messages import header_ns, joint_order, odometry_row, xyz
from lunar_rover_sim.bag.reader import Bag, open_bag, RawMessage
from lunar_rover_sim.bag.totals import recorded_factor, simulated_end_ns
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import BagError, ConfigError, WorldError
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, se3
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.site import reported_site
from lunar_rover_sim.image.camera.chase import ChaseConfig, ChaseMount
from lunar_rover_sim.image.illumination.sun_of_date import sun_of_date, SunPath
from lunar_rover_sim.image.rendering.layer_pictures import disparity_picture, gray8
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.products.inspection.map_pictures import (goal_of, map_picture, MapMessage,
                                                              path_of)
from lunar_rover_sim.rover.description import Legs, RoverDescription
from lunar_rover_sim.rover.physics.foot_motion import FootObserver
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.recorded_run import RecordedRun

WINDOW_S = 1.0             # window of a slip ratio
_SLIP_RATE_HZ = 50.0        # sampling rate of the feet
_LEAST_SWEEP_M = 0.02       # sum over the feet in a window; below it there is no slip ratio


class DriveSeries(NamedTuple):
    """States that the bag holds, (n, …) arrays.

    stamps_ns (n,); poses (n, 13) as `odometry_row`; angles, velocities (n, legs);
    forces_n (n, legs, 3) on the legs, NaN where contacts were not recorded
    """

    stamps_ns: NDArray[np.int64]
    poses: Array
    angles: Array
    velocities: Array
    forces_n: Array

    def nearest(self, time_ns: int) -> int:
        """Return the index of the last state up to a time, or the first one."""
        return max(int(np.searchsorted(self.stamps_ns, time_ns, side='right')) - 1, 0)

    def pose(self, k: int) -> RoverPose:
        """Return pose, velocities and leg angles of state `k`."""
        row = self.poses[k]
        return RoverPose(se3(matrix_from_wxyz(row[3:7]), row[:3]), self.angles[k], row[7:10],
                         row[10:13], self.velocities[k])

    def pitch_deg(self) -> Array:
        """Return the (n,) pitch [deg], positive with the nose down."""
        return np.degrees(frames.rpy_from_wxyz(self.poses[:, 3:7])[:, 1])

    def slip(self, rover: RoverDescription, ground: HeightGrid, gravity_mps2: float,
             window_s: float = WINDOW_S) -> tuple[Array, Array]:
        """Return times [s] and slip ratios of the rover over the window before each.

        The ratio is slipped over swept distance of all feet, see `physics/foot_motion.py`; NaN
        where they hardly move or contacts were not recorded.
        """
        n = len(self.stamps_ns)
        steps = np.diff(self.stamps_ns)
        stride = max(1, round(1e9 / _SLIP_RATE_HZ / float(np.median(steps)))) if n > 1 else 1
        chosen = np.arange(0, n, stride)
        observer = FootObserver(rover, ground, gravity_mps2)
        motions = [observer.observe(self._state(int(k))) for k in chosen]
        sweep = np.array([motion.sweep_mps.sum() for motion in motions])
        slipped = np.array([motion.slip_mps.sum() for motion in motions])
        times_s = np.asarray(self.stamps_ns[chosen] * 1e-9, float)
        step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
        count = max(1, round(window_s / step_s)) if step_s else 1
        kernel = np.ones(count)
        swept_m: Array = np.convolve(sweep, kernel)[:len(sweep)] * step_s
        slipped_m = np.convolve(slipped, kernel)[:len(sweep)] * step_s
        ratio: Array = np.divide(slipped_m, swept_m, out=np.full(len(sweep), np.nan),
                                 where=np.abs(swept_m) > _LEAST_SWEEP_M)
        if not np.all(np.isfinite(self.forces_n)):
            ratio[:] = np.nan
        return times_s, ratio

    def _state(self, k: int) -> RoverState:
        row, zeros = self.poses[k], np.zeros_like(self.angles[k])
        return RoverState(int(self.stamps_ns[k]), row[:3], row[3:7], row[7:10], row[10:13],
                          self.angles[k], self.velocities[k], zeros, zeros, self.forces_n[k],
                          np.zeros_like(self.forces_n[k]), np.zeros(3), np.zeros(3))


def read_drive(bag: Bag, legs: Legs, start_ns: int | None = None,
               end_ns: int | None = None) -> DriveSeries:
    """Return the motion in a bag between two times; raise BagError where it holds none.

    Args:
        legs: Of the recorded rover, for the order of the values.
    """
    for name in (bag.truth, topics.JOINT_STATES.name):
        if not bag.count(name):
            raise BagError(f'{bag.path}: holds no drive: {name} is missing')
    contacts = [topic.name for topic in topics.of_legs([topics.CONTACT], legs.names)]
    names = {bag.resolve(name): name
             for name in (bag.truth, topics.JOINT_STATES.name, *contacts) if bag.has(name)}
    rows: dict[str, dict[int, Any]] = {name: {} for name in names.values()}
    for topic, _, message in bag.messages(names, start_ns, end_ns):
        name = names[topic]
        value = (odometry_row(message) if name == bag.truth
                 else _legs(bag, legs, message) if name == topics.JOINT_STATES.name
                 else xyz(message.wrench.force))
        rows[name][header_ns(message)] = value
    common = sorted(set(rows[bag.truth]) & set(rows[topics.JOINT_STATES.name]))
    if not common:
        raise BagError(f'{bag.path}: holds no drive: no {topics.JOINT_STATES.name} has the stamp '
                       f'of a message of {bag.truth}')
    joints = np.array([rows[topics.JOINT_STATES.name][stamp] for stamp in common])
    forces = np.full((len(common), len(contacts), 3), np.nan)
    for leg, contact in enumerate(contacts):
        found = rows.get(contact, {})
        for k, stamp in enumerate(common):
            forces[k, leg] = found.get(stamp, np.nan)
    return DriveSeries(np.array(common, np.int64), np.array([rows[bag.truth][s] for s in common]),
                       joints[:, 0], joints[:, 1], forces)


def _legs(bag: Bag, legs: Legs, message: Any) -> Array:
    """Return (2, legs) angles and velocities in our order; legs without velocities are at rest."""
    order = joint_order(message, legs, bag.path, BagError)
    angles = np.asarray(message.position, float)[order]
    speeds = (np.asarray(message.velocity, float)[order] if len(message.velocity)
              else np.zeros(len(order)))
    return np.stack([angles, speeds])


U8 = NDArray[np.uint8]

_FACE, _INK, _GRID = '#101114', '#d8dade', '#34373d'
_COLOURS = '#6cb6ff', '#ffb454'
_TO_COME = 0.30         # brightness of what has not happened yet
_CURSOR = 235
_PERCENTILES = 0.5, 99.5
_DPI = 100


class Captions:
    """Writes into pictures of RGB."""

    def __init__(self, width: int) -> None:
        """Choose sizes; width: of the film [px]."""
        file = font_manager.findfont('DejaVu Sans')
        self._large = ImageFont.truetype(file, max(width // 45, 10))
        self._small = ImageFont.truetype(file, max(width // 80, 8))
        self._margin = max(width // 90, 4)

    def draw(self, picture: U8, left: str, right: str) -> None:
        """Write into the lower corners."""
        h, w = picture.shape[:2]
        self._write(picture, (self._margin, h - self._margin), left, 'ls', self._large)
        self._write(picture, (w - self._margin, h - self._margin), right, 'rs', self._large)

    def label(self, picture: U8, text: str) -> None:
        """Write into the upper left corner."""
        self._write(picture, (self._margin // 2, self._margin // 2), text, 'lt', self._small)

    @staticmethod
    def _write(picture: U8, at: tuple[int, int], text: str, anchor: str,
               font: ImageFont.FreeTypeFont) -> None:
        image = Image.fromarray(picture)
        ImageDraw.Draw(image).text(at, text, fill=(255, 255, 255), font=font, anchor=anchor,
                                   stroke_width=2, stroke_fill=(0, 0, 0))
        picture[...] = np.asarray(image)


def pace_caption(speed: float, real_time_factor: float | None) -> str:
    """Return how fast a film is, and how fast its drive was recorded, if that is known."""
    recorded = '' if real_time_factor is None else f'real-time factor {real_time_factor:.2g}, '
    return f'{recorded}film speed × {speed:g}'


class Plots:
    """Pitch and slip over time, with a line that moves on; what is to come is dim."""

    def __init__(self, size: tuple[int, int], span_s: tuple[float, float],
                 pitch: tuple[Array, Array], slip: tuple[Array, Array]) -> None:
        """Draw both curves once.

        Args:
            size: Width and height [px].
            span_s: First and last time.
            pitch: Times [s] and [deg].
            slip: Times [s] and ratios.
        """
        width, height = size
        self._span_s = span_s
        figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor=_FACE)
        canvas = FigureCanvasAgg(figure)
        font = max(height / 22.0, 5.0) * 72.0 / _DPI
        left, right = 5.2 * font / 72.0 * _DPI / width, 0.985
        axes = [figure.add_axes((left, bottom, right - left, 0.36)) for bottom in (0.58, 0.15)]
        for ax, (times, values), colour, name in zip(
                axes, (pitch, (slip[0], 100.0 * slip[1])), _COLOURS,
                ('pitch [°]', 'slip [%], over 1 s')):
            inside = (times >= span_s[0]) & (times <= span_s[1])
            ax.plot(times, values, color=colour, lw=max(height / 240.0, 0.6))
            ax.set_xlim(span_s)
            known = values[inside & np.isfinite(values)]
            if len(known):
                low, high = np.percentile(known, _PERCENTILES)
                room = 0.15 * max(high - low, 1e-3)
                ax.set_ylim(low - room, high + room)
            ax.set_facecolor(_FACE)
            ax.grid(color=_GRID, lw=0.5)
            ax.tick_params(colors=_INK, labelsize=font, length=2, pad=1)
            # Above the axes, where no curve is.
            ax.text(0.0, 1.02, name, color=colour, fontsize=font, transform=ax.transAxes,
                    va='bottom')
            for spine in ax.spines.values():
                spine.set_color(_GRID)
        axes[0].tick_params(labelbottom=False)
        axes[1].set_xlabel('time [s]', color=_INK, fontsize=font, labelpad=1)
        canvas.draw()
        self._picture = np.asarray(canvas.buffer_rgba())[..., :3].copy()
        boxes = [ax.get_window_extent() for ax in axes]
        self._columns = boxes[0].x0, boxes[0].x1
        self._bands = [(height - round(box.y1), height - round(box.y0)) for box in boxes]

    def at(self, time_s: float) -> U8:
        """Return the (h, w, 3) RGB picture at a time."""
        picture = self._picture.copy()
        first, last = self._columns
        start, end = self._span_s
        share = np.clip((time_s - start) / max(end - start, 1e-9), 0.0, 1.0)
        column = int(round(first + share * (last - first)))
        for top, bottom in self._bands:
            ahead = picture[top:bottom, column:int(last)]
            ahead[...] = (_TO_COME * ahead).astype(np.uint8)
        column = min(column, picture.shape[1] - 1)
        for top, bottom in self._bands:
            picture[top:bottom, column] = _CURSOR
        return picture


WIDTHS = (320, 3840)


@dataclasses.dataclass(frozen=True)
class FilmOptions:
    """What of a drive a film shows.

    Attributes:
        width: Of the film [px], a multiple of 32; its height is 3/4 of that, or 9/16 of a bare
            one.
        rate_hz: Frames per second of the film.
        speed: Simulated seconds per second of the film.
        start_s, end_s: Simulated times [s]; None: those of the bag.
        bare: Only the view from outside, without images and plots.
        samples: Of the view from outside, along a side of a pixel.

    Raises:
        ConfigError: For values that make no film.
    """

    width: int = 1280
    rate_hz: float = 20.0
    speed: float = 1.0
    start_s: float | None = None
    end_s: float | None = None
    bare: bool = False
    samples: int = 1

    def __post_init__(self) -> None:
        low, high = WIDTHS
        if self.width % 32 or not low <= self.width <= high:
            raise ConfigError(f'--width: {self.width} is not valid; valid is a multiple of 32 '
                              f'from {low} to {high}')
        if not 1 <= self.samples <= 4:
            raise ConfigError(f'--samples: {self.samples} is not valid; valid is 1 to 4')
        for name, value, most in (('--fps', self.rate_hz, 100.0), ('--speed', self.speed, 1000.0)):
            if not 0.0 < value <= most:
                raise ConfigError(f'{name}: {value:g} is not valid; valid is > 0 and <= {most:g}')


class Film:
    """The film of one bag. Making it reads the motion; `frames` draws.

    Attributes:
        times_ns: Simulated time of each frame.
        world: That was driven on.
        chase: The camera, at first that of the scenario; its image size is that of the film.
    """

    chase: ChaseConfig

    def __init__(self, path: Path, options: FilmOptions = FilmOptions(),
                 world: Path | None = None) -> None:
        """Read what the film needs to know.

        Args:
            world: Folder of the world, where it is not beside the bag or in the cache.

        Raises:
            BagError: Where the bag holds no drive, scenario or images, or its world is not found.
            ConfigError: For times outside the bag.
        """
        self._path, self._options = path, options
        with open_bag(path) as bag:
            run = RecordedRun(bag)
            self._nodes = run.nodes
            self.chase = self._nodes.render.chase
            self._factor = recorded_factor(bag)
            self._has_map = bag.has(topics.TRAVERSABILITY.name)
            if not options.bare and not bag.has(topics.LEFT_IMAGE.name):
                raise BagError(f'{path}: holds no {topics.LEFT_IMAGE.name}; --bare makes a film '
                               'without it')
            try:
                found = run.world(world)
            except WorldError as error:
                raise BagError(f'--world: {error}') from None
            if found is None:
                raise BagError(f'{path}: its world is not found; name its folder with --world')
            self.world = found
            self.times_ns = self._times(bag)
            # The first slip ratio needs the window before it.
            self._drive = read_drive(bag, self._nodes.rover.legs,
                                     int(self.times_ns[0]) - 2 * round(WINDOW_S * NS_PER_S),
                                     int(self.times_ns[-1]) + 1)

    def _times(self, bag: Bag) -> NDArray[np.int64]:
        first_s, last_s = bag.start_ns / NS_PER_S, simulated_end_ns(bag) / NS_PER_S
        options = self._options
        start_s = first_s if options.start_s is None else options.start_s
        end_s = last_s if options.end_s is None else options.end_s
        for name, value in (('--start', start_s), ('--end', end_s)):
            if not 0.0 <= value <= last_s + 1e-6:
                raise ConfigError(f'{name}: {value:g} s is not valid; the bag holds {first_s:g} '
                                  f'to {last_s:g} s')
        if start_s >= end_s:
            raise ConfigError(f'--start, --end: {start_s:g} to {end_s:g} s is not valid; valid is '
                              'a start before the end')
        step_s = options.speed / options.rate_hz
        count = int((end_s - start_s) / step_s + 1e-6) + 1
        return np.rint((start_s + step_s * np.arange(count)) * NS_PER_S).astype(np.int64)

    def frames(self) -> Iterator[U8]:
        """Yield (h, w, 3) RGB frames, one for each of `times_ns`."""
        options, drive = self._options, self._drive
        width, height = options.width, options.width * 9 // 16 // 2 * 2
        chase = dataclasses.replace(self.chase, camera=dataclasses.replace(
            self.chase.camera, width=width, height=height))
        render = self._nodes.render
        sun = sun_of_date(render.sun, reported_site(self.world.report))
        # Films have smooth outlines, whatever the scenario of an older recording states.
        config = dataclasses.replace(render, sun=sun, detail=dataclasses.replace(
            render.detail, smooth_outlines=True))
        captions = Captions(width)
        pace = pace_caption(options.speed, self._factor)
        with open_bag(self._path) as bag, \
                Renderer(self.world, self._nodes.rover, config, config.seed) as renderer:
            overlay = Overlay() if bag.has(topics.GROUND_CHANGES.name) else None
            renderer.follow(overlay)
            mount = ChaseMount(chase, sun.azimuth_deg, self.world)
            camera = renderer.add_camera(chase, mount, samples=options.samples)
            plots = None if options.bare else self._plots(width)
            path, step = SunPath(sun), 0
            for k, (time_ns, shown) in enumerate(_along(bag, self.times_ns, overlay)):
                if path.step(int(time_ns)) != step:
                    step = path.step(int(time_ns))
                    renderer.show_sun(renderer.light_of(path.of_step(step)))
                state = drive.pose(drive.nearest(int(time_ns)))
                mount.follow(state, int(time_ns))
                pixels = camera.render(state, k).picture('left')
                outside = gray8(pixels)[..., ::-1].copy()
                captions.draw(outside, f'simulated time {time_ns / NS_PER_S:.1f} s', pace)
                if plots is None:
                    yield outside
                    continue
                size = width // 4, width * 3 // 16
                left, disparity = (_fitted(_picture(bag, shown.get(topic.name), topic), size)
                                   for topic in (topics.LEFT_IMAGE, topics.DISPARITY))
                captions.label(left, 'left camera')
                captions.label(disparity, 'disparity')
                parts = [left, disparity, plots.at(time_ns / NS_PER_S)]
                if self._has_map:
                    known = _map(bag, shown, size, state.T_world_base)
                    captions.label(known, 'map and plan')
                    parts.insert(2, known)
                strip = np.hstack(parts)
                yield np.vstack([outside, strip])

    def _plots(self, width: int) -> Plots:
        drive, span_s = self._drive, self.times_ns[[0, -1]] / NS_PER_S
        slip = drive.slip(self._nodes.rover, self.world.ground,
                          self._nodes.physics.gravity_mps2)
        share = 4 if self._has_map else 2
        return Plots((width // share, width * 3 // 16), (float(span_s[0]), float(span_s[1])),
                     (drive.stamps_ns / NS_PER_S, drive.pitch_deg()), slip)


def _along(bag: Bag, times_ns: NDArray[np.int64],
           overlay: Overlay | None) -> Iterator[tuple[int, dict[str, RawMessage]]]:
    """Yield each time with the newest image of each topic; update the overlay up to it."""
    names = [topic.name for topic in (topics.LEFT_IMAGE, topics.DISPARITY, topics.GROUND_CHANGES,
                                      topics.TRAVERSABILITY, topics.PLAN, topics.GOAL)
             if bag.has(topic.name)]
    contract = {bag.resolve(name): name for name in names}
    shown: dict[str, RawMessage] = {}
    k = 0
    for message in bag.raw(names):
        while k < len(times_ns) and message.time_ns > times_ns[k]:
            yield int(times_ns[k]), shown
            k += 1
        if k == len(times_ns):
            return
        name = contract[message.topic]
        if name == topics.GROUND_CHANGES.name and overlay is not None:
            overlay.apply(changes_of(bag.decode(message.data, message.msgtype)))
        else:
            shown[name] = message
    for time_ns in times_ns[k:]:
        yield int(time_ns), shown


def _map(bag: Bag, shown: dict[str, RawMessage], size: tuple[int, int],
         T_world_base: Array) -> U8:
    """Return RGB pixels of the newest map with plan and goal; a dark picture without one."""
    found = {name: bag.decode(message.data, message.msgtype)
             for name in (topics.TRAVERSABILITY.name, topics.PLAN.name, topics.GOAL.name)
             if (message := shown.get(name)) is not None}
    if topics.TRAVERSABILITY.name not in found:
        return np.full((size[1], size[0], 3), 16, np.uint8)
    plan, goal = found.get(topics.PLAN.name), found.get(topics.GOAL.name)
    return _fitted(map_picture(
        MapMessage.of(found[topics.TRAVERSABILITY.name]), 2 * size[1], T_world_base[:3, 3],
        float(np.arctan2(T_world_base[1, 0], T_world_base[0, 0])),
        np.zeros((0, 2)) if plan is None else path_of(plan),
        None if goal is None else goal_of(goal)), size)


def _picture(bag: Bag, message: RawMessage | None, topic: topics.Topic) -> U8:
    """Return RGB pixels of an image or disparity; a dark picture where there is none yet."""
    if message is None:
        return np.full((3, 4, 3), 16, np.uint8)
    decoded = bag.decode(message.data, message.msgtype)
    if topic is topics.DISPARITY:
        pixels = series.picture(bag, decoded.image).pixels
        return disparity_picture(np.where(pixels > 0.0, pixels, -1.0),
                                 float(decoded.max_disparity))[..., ::-1]
    picture = series.picture(bag, decoded)
    if picture.encoding.startswith('bgr'):
        return np.asarray(picture.pixels[..., :3][..., ::-1], np.uint8)
    return gray8(picture.pixels)[..., ::-1]


def _fitted(picture: U8, size: tuple[int, int]) -> U8:
    """Return a picture within width and height, its proportions kept, on black."""
    width, height = size
    scale = min(width / picture.shape[1], height / picture.shape[0])
    w, h = max(1, round(scale * picture.shape[1])), max(1, round(scale * picture.shape[0]))
    small = cv2.resize(np.ascontiguousarray(picture), (w, h),
                       interpolation=cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR)
    out = np.zeros((height, width, 3), np.uint8)
    out[(height - h) // 2:(height - h) // 2 + h, (width - w) // 2:(width - w) // 2 + w] = small
    return out
