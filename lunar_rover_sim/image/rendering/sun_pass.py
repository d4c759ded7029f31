"""The pass of the sun: what hides its disc from the cameras, and the disc in their images.

A disc of half a degree is a few pixels wide. What hides it is drawn once more from each camera,
through a narrow view of the disc alone in which a pixel of the image is many. So the disc is cut
at the right place within a pixel, and it is known how much of the sun a camera sees that looks
elsewhere, too. Mostly nothing is in that view, and nothing is drawn.

The disc of the Earth is drawn into the sky, behind whatever stands in front of it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
import dataclasses
import math

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array, se3, sun_direction
from lunar_rover_sim.image.camera.development import LitImage
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.illumination.discs import disc_radiance, earth_disc, limb_darkening
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.context import clear_window, release_all
from lunar_rover_sim.image.rendering.projection import Projection, View, view_numbers, ViewVolume
from lunar_rover_sim.image.rendering.rock_pass import ROCK_MIN_PX
from lunar_rover_sim.image.rendering.scene import Scene, SeenSun
from lunar_rover_sim.image.rendering.world_passes import WorldPasses

_MARGIN = 1.05              # of the view of the disc, over its diameter
_LEAST, _MOST = 64, 512     # pixels of that view along a side
_CLEAR = 3.0                # radii of the sun above the ground's horizon that surely clear it
_FINE, _FINE_EARTH = 16, 64     # samples across a disc, at least, that make its image


class SunPass:
    """Draws the disc of the sun into the radiance, and tells what the cameras see of it."""

    def __init__(self, context: moderngl.Context, projection: Projection, config: RenderConfig,
                 strays: Callable[[Array], bool]) -> None:
        """Make targets.

        Args:
            projection: Of both cameras.
            strays: Whether sunlight from a (3,) direction, in axes of the cameras, strays in their
                lenses.
        """
        self._projection, self._strays = projection, strays
        radius = self._radius = math.radians(0.5 * config.sun.angular_diameter_deg)
        across = 2.0 * projection.focal_px * math.tan(radius)
        n = self._n = int(np.clip(4 * math.ceil(across), _LEAST, _MOST))
        focal = 0.5 * n / (_MARGIN * math.tan(radius))
        K = np.array([[focal, 0.0, 0.5 * (n - 1)], [0.0, focal, 0.5 * (n - 1)], [0.0, 0.0, 1.0]])
        self._narrow = Projection(K, n, n, projection.near_m, projection.far_m)
        place = (np.arange(n) - 0.5 * (n - 1)) / (focal * math.tan(radius))
        self._weights = limb_darkening(np.hypot(place[:, None], place[None]))
        self._square = _Square(projection, radius, _FINE)
        self._views = [View(context) for _ in range(2)]
        self._depth = context.depth_renderbuffer((n, 2 * n))
        self._hidden = context.framebuffer(depth_attachment=self._depth)
        self.relight(config.sun)

    def relight(self, sun: SunConfig) -> None:
        """Move the sun."""
        self._sun = sun
        self._direction = sun_direction(sun.azimuth_deg, sun.elevation_deg)

    def look(self, scene: Scene, volume: ViewVolume, shared: WorldPasses) -> None:
        """Draw what hides the sun from the cameras of a scene, unless they cannot see it at all.

        It changes the choice of rocks. volume: of the images
        """
        direction = scene.T_world_cameras[0][:3, :3].T @ self._direction
        if not self._sun.shines or not self._matters(direction):
            return
        scene.sun = SeenSun(direction, np.full(2, self._sun.irradiance))
        turn = _turn(scene.T_world_cameras[0][:3, 1], self._direction)
        views = [se3(turn, T[:3, 3]) for T in scene.T_world_cameras]
        # Bounds mostly show that nothing is in the way.
        width = _MARGIN * math.tan(self._radius)
        rover = any(shared.body.is_in_cone(scene.T_world_links, view, width)
                    for view in views)
        rocks = any(shared.rocks.any_in_cone(view, width) for view in views)
        ground = np.any(shared.sunlight.angle_above_horizon(
            np.stack([view[:3, 3] for view in views])) < _CLEAR * self._radius)
        if not (rover or rocks or ground):
            return
        scene.sun.T_world_views = views
        narrow = dataclasses.replace(volume, planes=self._narrow.planes(views))
        if ground:
            scene.sun.over_ground = np.stack([shared.ground.depth(
                view_numbers(view, self._narrow, volume.centre_m), self._narrow,
                shared.ground.tracks_in(narrow), shared.workers) == 0.0 for view in views])
        shared.rocks.choose(narrow, self._projection.focal_px, ROCK_MIN_PX)
        n = self._n
        for side in scene.request.lit_sides:
            window = (0, side * n, n, n)
            self._views[side].place(views[side], self._narrow, volume.centre_m)
            self._views[side].bind()
            clear_window(self._hidden, window)
            shared.rocks.draw()
            if rover:
                shared.body.draw(scene.T_world_links)

    def read(self, scene: Scene) -> None:
        """Note how much of the disc each camera of a scene sees."""
        sun = scene.sun
        if sun is not None and sun.T_world_views is not None:
            sun.sky = self._sky() & sun.over_ground
            sun.irradiance *= (self._weights * sun.sky).sum(axis=(1, 2)) / self._weights.sum()

    def draw(self, scene: Scene, images: Mapping[int, LitImage]) -> None:
        """Add the disc to the radiance of lit images, by side."""
        if scene.sun is None or scene.sun.direction[2] <= 0.0:
            return
        found = self._square.place(scene.sun.direction)
        if found is None:
            return
        first, part, own = found
        patches = self._image(scene, first)
        for side, image in images.items():
            image.radiance[part] += patches[side][own]

    def _matters(self, direction: Array) -> bool:
        """Return whether light from a direction, in axes of the cameras, reaches their lenses."""
        if direction[2] <= 0.0:
            return False
        return self._strays(direction) or self._square.place(direction) is not None

    def _sky(self) -> NDArray[np.bool_]:
        """Return (2, n, n) where the narrow views see the sky."""
        n = self._n
        data = self._hidden.read(viewport=(0, 0, n, 2 * n), components=1, attachment=-1,
                                 alignment=1, dtype='f4')
        return np.frombuffer(data, np.float32).reshape(2, n, n) == 1.0

    def _image(self, scene: Scene, first: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the (2, side, side) mean radiance of pixels, of both cameras."""
        assert scene.sun is not None
        rays, K = self._square.rays(first), self._projection.K
        radiance = disc_radiance(rays, scene.sun.direction, self._sun)
        # Whatever the sampling, the whole disc has the irradiance of the sun.
        solid_angle = (rays**2).sum(axis=-1)**-1.5 / (K[0, 0] * K[1, 1] * self._square.finer**2)
        radiance *= self._sun.irradiance / (radiance * solid_angle).sum()
        images = np.stack([radiance, radiance])
        sky = scene.sun.sky
        if sky is not None and scene.sun.T_world_views is not None:
            lit = np.nonzero(radiance)
            for k, (camera, view) in enumerate(zip(scene.T_world_cameras,
                                                   scene.sun.T_world_views)):
                q = rays[lit] @ (view[:3, :3].T @ camera[:3, :3]).T
                at = q[:, :2] / q[:, 2:] * self._narrow.focal_px + self._narrow.K[:2, 2]
                column, row = np.clip(np.rint(at), 0, self._n - 1).astype(int).T
                images[k][lit] *= sky[k, row, column]
        return self._square.mean(images)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self._hidden, self._depth, *self._views)


def _turn(down: Array, direction: Array) -> Array:
    """Return axes (3, 3), as columns, of a camera that looks in a direction, `down` below it."""
    right = np.cross(down, direction)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right), direction], axis=1)


class EarthImage:
    """Draws the Earth into the radiance of the sky."""

    def __init__(self, projection: Projection, config: RenderConfig) -> None:
        """Prepare the disc; projection: of both cameras."""
        self._projection = projection
        self.relight(config)

    def relight(self, config: RenderConfig) -> None:
        """Move the Earth to the date of the sun."""
        self._earth = earth_disc(config.sun) if config.earth.drawn else None
        if self._earth is None:
            return
        self._square = _Square(self._projection, self._earth.radius_rad, _FINE_EARTH)

    def draw(self, scene: Scene, images: Collection[LitImage]) -> None:
        """Add the disc to the sky of lit images; both cameras see it in one place."""
        if self._earth is None:
            return
        R = scene.T_world_cameras[0][:3, :3]
        direction = R.T @ self._earth.direction
        if direction[2] <= 0.0:
            return
        found = self._square.place(direction)
        if found is None:
            return
        first, part, own = found
        earth = dataclasses.replace(self._earth, direction=direction,
                                    sun_direction=R.T @ self._earth.sun_direction)
        patch = self._square.mean(earth.radiance(self._square.rays(first)))[own]
        for image in images:
            image.radiance[part] += np.where(image.depth_m[part] == 0.0, patch, 0.0)


Part = tuple[slice, slice]      # rows and columns


class _Square:
    """The pixels around a disc in the sky, and the samples that its image is the mean of.

    Attributes:
        finer: Samples along a side of a pixel.
    """

    def __init__(self, projection: Projection, radius_rad: float, samples: int) -> None:
        """Choose its size; samples: across the disc, at least."""
        self._projection = projection
        across = 2.0 * projection.focal_px * math.tan(radius_rad)
        # The image of a disc is longer towards the corners, by 1 / cos^2 of the angle.
        corner = np.abs(projection.K[:2, 2]).max() * math.sqrt(2.0) / projection.focal_px
        self._side = 2 * math.ceil(0.55 * across * (1.0 + corner**2)) + 4
        self.finer = int(np.clip(math.ceil(samples / across), 2, 16))

    def place(self, direction: Array) -> tuple[NDArray[np.int64], Part, Part] | None:
        """Return its first column and row, the part of the image in it, and that part of itself.

        None outside the image.
        """
        centre = (self._projection.K @ direction)[:2] / direction[2]
        limit = 1e6     # of pixels, so that directions near the plane of the lens stay whole
        first = np.rint(np.clip(centre, -limit, limit)).astype(int) - self._side // 2
        size = np.array([self._projection.width, self._projection.height])
        low, high = np.maximum(first, 0), np.minimum(first + self._side, size)
        if np.any(low >= high):
            return None
        (x0, y0), (x1, y1), (x, y) = low, high, first
        return first, np.s_[y0:y1, x0:x1], np.s_[y0 - y:y1 - y, x0 - x:x1 - x]

    def rays(self, first: NDArray[np.int64]) -> Array:
        """Return (n, n, 3) rays of depth 1 through all samples."""
        K, finer = self._projection.K, self.finer
        fine = (np.arange(self._side * finer) + 0.5) / finer - 0.5
        x, y = (first[0] + fine - K[0, 2]) / K[0, 0], (first[1] + fine - K[1, 2]) / K[1, 1]
        return np.stack(np.broadcast_arrays(x[None], y[:, None], 1.0), axis=-1)

    def mean(self, radiance: Array) -> NDArray[np.float32]:
        """Return the means of pixels of (..., n, n) samples."""
        side, finer = self._side, self.finer
        return np.asarray(radiance.reshape(*radiance.shape[:-2], side, finer, side, finer).mean(
            axis=(-3, -1)), np.float32)
