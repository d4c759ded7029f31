"""The pass of the fisheye: its image from the faces that the scene was lit on."""

from __future__ import annotations

import moderngl
import numpy as np

from lunar_rover_sim.rendering.context import clear_window, load_program, release_all, set_uniform
from lunar_rover_sim.rendering.fisheye_faces import Face
from lunar_rover_sim.rendering.frame_targets import LitImages, LitTargets
from lunar_rover_sim.rendering.image_geometry import FisheyeImage

_RADIANCE, _DEPTH, _LINK = range(3)     # texture units
_STEEPEST = 3.5


class FisheyePass:
    """Samples the pair of fisheye images, the left above the right, from pairs of faces.

    lit: radiance, and distance with the signs of `LitTargets.depth`
    """

    def __init__(self, context: moderngl.Context, image: FisheyeImage, *, alone: bool,
                 samples: int) -> None:
        """Compile the programs; alone: whether one face shows all; samples: as for `faces`."""
        self._context, self._image, self._alone = context, image, alone
        self.lit = LitTargets(context, (image.width, 2 * image.height))
        self._sampler = context.sampler(repeat_x=False, repeat_y=False,
                                        filter=(context.LINEAR, context.LINEAR))
        self._programs = [load_program(context, 'screen', 'fisheye', PLACES=2 * samples,
                                       **image.defines, **kind)
                          for kind in ({}, {'LINK': 1})]
        for program in self._programs:
            set_uniform(program, **image.uniforms, u_radiance=_RADIANCE, u_depth=_DEPTH,
                        u_link=_LINK)
        self._screens = [context.vertex_array(program, []) for program in self._programs]

    def window(self, side: int) -> tuple[int, int, int, int]:
        """Return the place of an image in its attachments."""
        return 0, side * self._image.height, self._image.width, self._image.height

    def clear(self, target: moderngl.Framebuffer, sides: tuple[int, ...]) -> None:
        """Clear images before faces are added."""
        for side in sides:
            clear_window(target, self.window(side))

    def add(self, face: Face, lit: LitImages, sides: tuple[int, ...], above_m: float) -> None:
        """Sample what a face shows, from its lit pair of images.

        above_m: height of the cameras above the ground
        """
        # Inverse depth of level ground changes by 1 / (focal_px above_m) a pixel; see edges.frag.
        set_uniform(self._programs[0], u_outline=_STEEPEST / (
            face.projection.focal_px * max(above_m, 0.1)))
        lit.radiance.use(_RADIANCE)
        self._sampler.use(_RADIANCE)
        lit.depth.use(_DEPTH)
        self._draw(0, face, self.lit.framebuffer, sides)
        self._sampler.clear(_RADIANCE)

    def add_links(self, face: Face, link: moderngl.Texture, target: moderngl.Framebuffer,
                  sides: tuple[int, ...]) -> None:
        """Sample which links of the rover a face shows, see `motion_pass.LinkTargets`."""
        link.use(_LINK)
        self._draw(1, face, target, sides)

    def _draw(self, kind: int, face: Face, target: moderngl.Framebuffer,
              sides: tuple[int, ...]) -> None:
        program, projection = self._programs[kind], face.projection
        w, h, K = projection.width, projection.height, projection.K
        self._context.enable_only(self._context.NOTHING)
        target.use()
        # GL wants columns one after the other: those of the transposed matrix.
        set_uniform(program, u_turn=face.R_camera_face.astype(np.float32),
                    u_face=(K[0, 0], K[0, 2], K[1, 2], 0.0 if self._alone else 1.0),
                    u_face_texel=(1.0 / w, 0.5 / h))
        width, height = face.end - face.first
        for side in sides:
            down = side * self._image.height
            target.viewport = (int(face.first[0]), int(face.first[1]) + down, int(width),
                               int(height))
            set_uniform(program, u_first_row=(float(down), float(side * h)))
            self._screens[kind].render(vertices=3)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self._screens, *self._programs, self._sampler, self.lit)
