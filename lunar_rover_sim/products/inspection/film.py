"""A film of a recorded drive: the rover from outside, and in a corner what its camera saw.

The view from outside is drawn anew from the true states, the changes of the ground and the
scenario in the bag; no ROS is needed.
"""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
from pathlib import Path
from typing import NamedTuple

import cv2
from matplotlib import font_manager
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from lunar_rover_sim.bag import series
from lunar_rover_sim.bag.ground_points import changes_of
from lunar_rover_sim.bag.reader import Bag, open_bag, RawMessage
from lunar_rover_sim.bag.totals import recorded_factor, simulated_end_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, ConfigError, WorldError
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, se3
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.world.moon_place import reported_site
from lunar_rover_sim.image.camera.chase import ChaseConfig, ChaseMount
from lunar_rover_sim.image.illumination.sun_of_date import sun_of_date, SunPath
from lunar_rover_sim.image.rendering.layer_pictures import gray8
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.description import Legs
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.recorded_run import RecordedRun


class DriveSeries(NamedTuple):
    """States that the bag holds, (n, …) arrays.

    stamps_ns (n,); poses (n, 13) as `odometry_row`; angles, velocities (n, legs)
    """

    stamps_ns: NDArray[np.int64]
    poses: Array
    angles: Array
    velocities: Array

    def nearest(self, time_ns: int) -> int:
        """Return the index of the last state up to a time, or the first one."""
        return max(int(np.searchsorted(self.stamps_ns, time_ns, side='right')) - 1, 0)

    def pose(self, k: int) -> RoverPose:
        """Return pose, velocities and leg angles of state `k`."""
        row = self.poses[k]
        return RoverPose(se3(matrix_from_wxyz(row[3:7]), row[:3]), self.angles[k], row[7:10],
                         row[10:13], self.velocities[k])


def read_drive(bag: Bag, legs: Legs, start_ns: int | None = None,
               end_ns: int | None = None) -> DriveSeries:
    """Return the motion in a bag between two times; raise BagError where it holds none.

    Args:
        legs: Of the recorded rover, for the order of the values.
    """
    found = series.read_motion(bag, legs, None, start_ns, end_ns)
    (pose_ns, poses), (joint_ns, joints) = found[bag.truth], found[topics.JOINT_STATES.name]
    common, of_pose, of_joints = np.intersect1d(pose_ns, joint_ns, return_indices=True)
    if not len(common):
        raise BagError(f'{bag.path}: holds no drive: no {topics.JOINT_STATES.name} has the stamp '
                       f'of a message of {bag.truth}')
    angles, speeds, _ = np.split(joints[of_joints], 3, axis=1)
    # Legs without velocities are at rest.
    return DriveSeries(common, poses[of_pose], angles, np.where(np.isnan(speeds), 0.0, speeds))


U8 = NDArray[np.uint8]

_INSET = 4      # width of the film over that of the image in its corner


def _write(picture: U8, font: ImageFont.FreeTypeFont, left: str, right: str) -> None:
    """Write into the lower corners of a picture."""
    h, w = picture.shape[:2]
    margin, image = max(w // 90, 4), Image.fromarray(picture)
    for x, text, anchor in ((margin, left, 'ls'), (w - margin, right, 'rs')):
        ImageDraw.Draw(image).text((x, h - margin), text, fill=(255, 255, 255), font=font,
                                   anchor=anchor, stroke_width=2, stroke_fill=(0, 0, 0))
    picture[...] = np.asarray(image)


WIDTHS = (320, 3840)


@dataclasses.dataclass(frozen=True)
class FilmOptions:
    """What of a drive a film shows.

    Attributes:
        width: Of the film [px], a multiple of 32; its height is 9/16 of that.
        rate_hz: Frames per second of the film.
        speed: Simulated seconds per second of the film.
        start_s, end_s: Simulated times [s]; None: those of the bag.
        bare: Only the view from outside, without the left image in its corner.
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
        for name, value, least, most in (('--fps', self.rate_hz, 0.1, 100.0),
                                         ('--speed', self.speed, 0.001, 1000.0)):
            if not least <= value <= most:
                raise ConfigError(f'{name}: {value:g} is not valid; valid is {least:g} to '
                                  f'{most:g}')


class Film:
    """The film of one bag. Making it reads the motion; `frames` draws.

    Attributes:
        times_ns: Simulated time of each frame.
        world: The window of the site that the scenario names.
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
            if not options.bare and not bag.has(topics.LEFT_IMAGE.name):
                raise BagError(f'{path}: holds no {topics.LEFT_IMAGE.name}; --bare makes a film '
                               'without it')
            try:
                found = run.driven(world)
            except WorldError as error:
                raise BagError(f'--world: {error}') from None
            if found is None:
                raise BagError(f'{path}: its world is not found; name its folder with --world')
            self._driven, self.world = found, found.world
            self.times_ns = self._times(bag)
            # A second more, so that there is a state before the first frame.
            self._drive = read_drive(bag, self._nodes.rover.legs,
                                     int(self.times_ns[0]) - NS_PER_S, int(self.times_ns[-1]) + 1)

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
        world = self._driven.at(int(self.times_ns[0]))
        font = ImageFont.truetype(font_manager.findfont('DejaVu Sans'), max(width // 45, 10))
        recorded = '' if self._factor is None else f'real-time factor {self._factor:.2g}, '
        pace = f'{recorded}film speed × {options.speed:g}'
        with open_bag(self._path) as bag, \
                Renderer(world, self._nodes.rover, config, config.seed) as renderer:
            overlay = Overlay() if bag.has(topics.GROUND_CHANGES.name) else None
            renderer.follow(overlay)
            mount = ChaseMount(chase, sun.azimuth_deg, world)
            camera = renderer.add_camera(chase, mount, samples=options.samples)
            path, step = SunPath(sun), 0
            for k, (time_ns, shown) in enumerate(_along(bag, self.times_ns, overlay)):
                if path.step(int(time_ns)) != step:
                    step = path.step(int(time_ns))
                    renderer.show_sun(renderer.light_of(path.of_step(step)))
                if self._driven.at(int(time_ns)) is not renderer.world:
                    renderer.enter(self._driven.at(int(time_ns)))
                state = drive.pose(drive.nearest(int(time_ns)))
                mount.follow(state, int(time_ns))
                pixels = camera.render(state, k).picture('left')
                outside = gray8(pixels)[..., ::-1].copy()
                if not options.bare:
                    _add_inset(outside, _picture(bag, shown))
                _write(outside, font, f'simulated time {time_ns / NS_PER_S:.1f} s', pace)
                yield outside


def _along(bag: Bag, times_ns: NDArray[np.int64],
           overlay: Overlay | None) -> Iterator[tuple[int, RawMessage | None]]:
    """Yield each time with the newest left image; update the overlay up to it."""
    names = [topic.name for topic in (topics.LEFT_IMAGE, topics.GROUND_CHANGES)
             if bag.has(topic.name)]
    contract = {bag.resolve(name): name for name in names}
    shown: RawMessage | None = None
    k = 0
    for message in bag.raw(names):
        while k < len(times_ns) and message.time_ns > times_ns[k]:
            yield int(times_ns[k]), shown
            k += 1
        if k == len(times_ns):
            return
        if contract[message.topic] == topics.LEFT_IMAGE.name:
            shown = message
        elif overlay is not None:
            overlay.apply(changes_of(bag.decode(message.data, message.msgtype)))
    for time_ns in times_ns[k:]:
        yield int(time_ns), shown


def _picture(bag: Bag, message: RawMessage | None) -> U8:
    """Return RGB pixels of an image; a dark picture where there is none yet."""
    if message is None:
        return np.full((3, 4, 3), 16, np.uint8)
    picture = series.picture(bag, bag.decode(message.data, message.msgtype))
    if picture.encoding.startswith('bgr'):
        return np.asarray(picture.pixels[..., :3][..., ::-1], np.uint8)
    return gray8(picture.pixels)[..., ::-1]


def _add_inset(outside: U8, picture: U8) -> None:
    """Draw a picture into the upper left corner of another, a quarter as wide, framed."""
    width = outside.shape[1] // _INSET
    height = min(round(width * picture.shape[0] / picture.shape[1]), outside.shape[0] // 2)
    outside[:height + 1, :width + 1] = 255
    outside[:height, :width] = cv2.resize(np.ascontiguousarray(picture), (width, height),
                                          interpolation=cv2.INTER_AREA)
