"""The pass of the sun: what hides its disc from the cameras, and the disc in their images.

A disc of half a degree is a few pixels wide. What hides it is drawn once more from each camera,
through a narrow view of the disc alone in which a pixel of the image is many. So the disc is cut
at the right place within a pixel, and it is known how much of the sun a camera sees that looks
elsewhere, too. Mostly nothing is in that view, and nothing is drawn.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math
from typing import NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array, se3, sun_direction
from lunar_rover_sim.illumination.config import SunConfig
from lunar_rover_sim.illumination.sun_disc import disc_radiance, limb_darkening
from lunar_rover_sim.illumination.sunlight import Sunlight
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.context import clear_window, load_program, release_all, set_uniform
from lunar_rover_sim.rendering.frame_targets import LitTargets
from lunar_rover_sim.rendering.ground_pass import GroundPass
from lunar_rover_sim.rendering.projection import Projection, ViewVolume
from lunar_rover_sim.rendering.rock_pass import RockPass
from lunar_rover_sim.rendering.rover_pass import RoverPass
from lunar_rover_sim.rendering.scene import ImagedSun, Scene
from lunar_rover_sim.rendering.view import View

_MARGIN = 1.05              # of the view of the disc, over its diameter
_LEAST, _MOST = 64, 512     # pixels of that view along a side
_CLEAR = 3.0                # radii of the sun above the ground's horizon that surely clear it
_FINE = 16                  # samples across the disc, at least, that make its image


class Occluders(NamedTuple):
    """What may hide the sun, and the sunlight, which knows the horizon of the ground."""

    ground: GroundPass
    rocks: RockPass
    rover: RoverPass
    sunlight: Sunlight


class SunPass:
    """Draws the disc of the sun into the radiance, and tells what the cameras see of it."""

    def __init__(self, context: moderngl.Context, lit: LitTargets, projection: Projection,
                 config: RenderConfig, strays: Callable[[Array], bool]) -> None:
        """Make targets.

        projection: of both cameras; strays: whether sunlight from a (3,) direction, in axes of
        the cameras, strays in their lenses
        """
        self._context, self._projection, self._strays = context, projection, strays
        radius = self._radius = math.radians(0.5 * config.sun.angular_diameter_deg)
        across = 2.0 * projection.focal_px * math.tan(radius)
        n = self._n = int(np.clip(4 * math.ceil(across), _LEAST, _MOST))
        focal = 0.5 * n / (_MARGIN * math.tan(radius))
        K = np.array([[focal, 0.0, 0.5 * (n - 1)], [0.0, focal, 0.5 * (n - 1)], [0.0, 0.0, 1.0]])
        self._narrow = Projection(K, n, n, projection.near_m, projection.far_m)
        place = (np.arange(n) - 0.5 * (n - 1)) / (focal * math.tan(radius))
        self._weights = limb_darkening(np.hypot(place[:, None], place[None]))
        # The image of a disc is longer towards the corners, by 1 / cos^2 of the angle.
        corner = np.abs(projection.K[:2, 2]).max() * math.sqrt(2.0) / projection.focal_px
        self._side = 2 * math.ceil(0.55 * across * (1.0 + corner**2)) + 4
        self._finer = int(np.clip(math.ceil(_FINE / across), 2, 16))
        self._rock_min_px = config.detail.rock_min_px
        self._views = [View(context) for _ in range(2)]
        self._depth = context.depth_renderbuffer((n, 2 * n))
        self._hidden = context.framebuffer(depth_attachment=self._depth)
        self._patch = context.texture((self._side, 2 * self._side), 1, dtype='f4')
        self._target = context.framebuffer([lit.radiance])
        self._program = load_program(context, 'screen', 'sun')
        self._screen = context.vertex_array(self._program, [])
        self.relight(config.sun)

    def relight(self, sun: SunConfig) -> None:
        """Move the sun."""
        self._sun = sun
        self._direction = sun_direction(sun.azimuth_deg, sun.elevation_deg)

    def look(self, scene: Scene, volume: ViewVolume, occluders: Occluders) -> None:
        """Draw what hides the sun from the cameras of a scene, unless they cannot see it at all.

        It changes the choice of rocks. volume: of the images
        """
        direction = scene.T_world_cameras[0][:3, :3].T @ self._direction
        if not self._sun.shines or not self._matters(direction):
            return
        scene.sun = ImagedSun(direction, np.full(2, self._sun.irradiance))
        turn = _turn(scene.T_world_cameras[0][:3, 1], self._direction)
        views = [se3(turn, T[:3, 3]) for T in scene.T_world_cameras]
        # Bounds mostly show that nothing is in the way.
        width = _MARGIN * math.tan(self._radius)
        rover = any(occluders.rover.is_in_cone(scene.T_world_links, view, width)
                    for view in views)
        rocks = any(occluders.rocks.any_in_cone(view, width) for view in views)
        ground = np.any(occluders.sunlight.angle_above_horizon(
            np.stack([view[:3, 3] for view in views])) < _CLEAR * self._radius)
        if not (rover or rocks or ground):
            return
        scene.sun.T_world_views = views
        narrow = dataclasses.replace(volume, planes=self._narrow.planes(views))
        chosen = occluders.ground.choose(narrow)
        occluders.rocks.choose(narrow, self._projection.focal_px, self._rock_min_px)
        n = self._n
        for side in scene.request.lit_sides:
            window = (0, side * n, n, n)
            self._views[side].place(views[side], self._narrow, narrow, window=window,
                                    size=(n, 2 * n))
            self._views[side].bind()
            clear_window(self._hidden, window)
            occluders.ground.draw_depth(chosen)
            occluders.rocks.draw()
            if rover:
                occluders.rover.draw(scene.T_world_links, {})

    def draw(self, scene: Scene) -> None:
        """Add the disc to the radiance of a scene, and note how much of it each camera sees."""
        if scene.sun is None:
            return
        sky = self._sky(scene.sun)
        if sky is not None:
            scene.sun.irradiance *= (self._weights * sky).sum(axis=(1, 2)) / self._weights.sum()
        if scene.sun.direction[2] > 0.0:
            self._draw_disc(scene, sky)

    def _matters(self, direction: Array) -> bool:
        """Return whether light from a direction, in axes of the cameras, reaches their lenses."""
        if direction[2] <= 0.0:
            return False
        return self._strays(direction) or self._window(direction) is not None

    def _window(self, direction: Array) -> tuple[Array, Array] | None:
        """Return first pixel and end of what is inside the image of a square around the disc."""
        first = self._first(direction)
        size = np.array([self._projection.width, self._projection.height])
        low, high = np.maximum(first, 0), np.minimum(first + self._side, size)
        return (low, high) if np.all(low < high) else None

    def _first(self, direction: Array) -> NDArray[np.int64]:
        """Return column and row of the first pixel of the square around the disc."""
        centre = (self._projection.K @ direction)[:2] / direction[2]
        limit = 1e6     # of pixels, so that directions near the plane of the lens stay whole
        return np.rint(np.clip(centre, -limit, limit)).astype(int) - self._side // 2

    def _sky(self, sun: ImagedSun) -> NDArray[np.bool_] | None:
        """Return (2, n, n) where the narrow views see the sky; None if nothing hides the sun."""
        if sun.T_world_views is None:
            return None
        n = self._n
        data = self._hidden.read(viewport=(0, 0, n, 2 * n), components=1, attachment=-1,
                                 alignment=1, dtype='f4')
        return np.frombuffer(data, np.float32).reshape(2, n, n) == 1.0

    def _draw_disc(self, scene: Scene, sky: NDArray[np.bool_] | None) -> None:
        assert scene.sun is not None
        inside = self._window(scene.sun.direction)
        if inside is None:
            return
        first, (low, high) = self._first(scene.sun.direction), inside
        self._patch.write(self._image(scene, first, sky).astype(np.float32).tobytes())
        self._context.enable_only(self._context.BLEND)
        self._context.blend_func = self._context.ONE, self._context.ONE
        self._patch.use(0)
        set_uniform(self._program, u_patch=0)
        width, height = high - low
        for side in scene.request.lit_sides:
            x, y = scene.samples.windows[side][:2]
            self._target.use()
            self._target.viewport = (x + int(low[0]), y + int(low[1]), int(width), int(height))
            set_uniform(self._program, u_corner=(float(x + first[0]),
                                                 float(y + first[1] - side * self._side)))
            self._screen.render(vertices=3)

    def _image(self, scene: Scene, first: NDArray[np.int64],
               sky: NDArray[np.bool_] | None) -> Array:
        """Return (2 side, side) mean radiance of pixels, those of the right image below."""
        assert scene.sun is not None
        side, finer, K = self._side, self._finer, self._projection.K
        fine = (np.arange(side * finer) + 0.5) / finer - 0.5
        x = (first[0] + fine - K[0, 2]) / K[0, 0]
        y = (first[1] + fine - K[1, 2]) / K[1, 1]
        rays = np.stack(np.broadcast_arrays(x[None], y[:, None], 1.0), axis=-1)
        radiance = disc_radiance(rays, scene.sun.direction, self._sun)
        # Whatever the sampling, the whole disc has the irradiance of the sun.
        solid_angle = (rays**2).sum(axis=-1)**-1.5 / (K[0, 0] * K[1, 1] * finer**2)
        radiance *= self._sun.irradiance / (radiance * solid_angle).sum()
        images = np.stack([radiance, radiance])
        if sky is not None and scene.sun.T_world_views is not None:
            lit = np.nonzero(radiance)
            for k, (camera, view) in enumerate(zip(scene.T_world_cameras,
                                                   scene.sun.T_world_views)):
                q = rays[lit] @ (view[:3, :3].T @ camera[:3, :3]).T
                at = q[:, :2] / q[:, 2:] * self._narrow.focal_px + self._narrow.K[:2, 2]
                column, row = np.clip(np.rint(at), 0, self._n - 1).astype(int).T
                images[k][lit] *= sky[k, row, column]
        return images.reshape(2, side, finer, side, finer).mean(axis=(2, 4)).reshape(-1, side)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self._screen, self._program, self._target, self._patch, self._hidden,
                    self._depth, *self._views)


def _turn(down: Array, direction: Array) -> Array:
    """Return axes (3, 3), as columns, of a camera that looks in a direction, `down` below it."""
    right = np.cross(down, direction)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right), direction], axis=1)
