"""A frame under way: what is asked of it, whether its state is valid, what its lighting needs."""

from __future__ import annotations

from collections.abc import Collection
import dataclasses
import numbers
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import brief, RenderError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import nearest
from lunar_rover_sim.image.camera.image_geometry import ImageGeometry
from lunar_rover_sim.image.camera.motion_blur import Movement, MovingBody
from lunar_rover_sim.image.camera.mount import Mount
from lunar_rover_sim.image.camera.stray_light import ImagedSun
from lunar_rover_sim.image.rendering.canvas import Drawing
from lunar_rover_sim.image.rendering.frame import FLOWS, LAYERS, RIGHT_TRUTH
from lunar_rover_sim.image.rendering.ground import SeenTracks
from lunar_rover_sim.image.rendering.ground_picture import GroundPicture
from lunar_rover_sim.image.rendering.lamp_rows import LampLight
from lunar_rover_sim.image.rendering.rover_pass import BodyLight
from lunar_rover_sim.image.rendering.rover_shadow import CastShadow
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import leg_values, Posed, RoverPose

LEFT, RIGHT = 0, 1
_SHADED = ({'left', 'radiance'}, {'right'})     # layers that need light, by side
_TRUTH = {'normal', 'label', 'crater', 'shadow'}
_PREFIXES = ('', 'right_')      # of layers of truth, by side
_NEAREST_M = 0.1                # least depth of a link that its motion is judged by
LOWEST_M = 0.1                  # of cameras over the ground: below, it is seen edge on


@dataclasses.dataclass(frozen=True)
class Request:
    """The layers of a frame, and its index, which gives each frame its own noise.

    Attributes:
        other: The state that flow leads to.

    Raises:
        RenderError: For an unknown layer, for flow without another state, and for an index that is
            not a whole number.
    """

    layers: frozenset[str]
    frame_index: int
    other: RoverPose | None = None

    @classmethod
    def of(cls, layers: Collection[str], frame_index: int,
           other: RoverPose | None = None) -> Request:
        """Check the names of the layers, and the index."""
        if not isinstance(frame_index, numbers.Integral):
            raise RenderError(f'frame_index: {brief(frame_index)} is not valid; valid is a whole '
                              'number')
        valid = (*LAYERS, *RIGHT_TRUTH, *FLOWS)
        for name in sorted(set(layers).difference(valid)):
            raise RenderError(f'layer {name!r} is not valid; {nearest(name, valid)}')
        for name in sorted(set(layers).intersection(FLOWS)):
            if other is None:
                raise RenderError(f'layer {name!r} is not valid without `other`, the state that '
                                  'flow leads to')
        return cls(frozenset(layers), int(frame_index), other)

    @property
    def sides(self) -> tuple[int, ...]:
        """Cameras that draw: LEFT, RIGHT, both or none."""
        of_right = self.layers & {'right', *RIGHT_TRUTH}
        left = (LEFT,) if self.layers - of_right else ()
        return left + ((RIGHT,) if of_right else ())

    def name(self, layer: str, side: int) -> str:
        """Return the name of a layer of truth of a camera."""
        return _PREFIXES[side] + layer

    def truth_of(self, side: int) -> set[str]:
        """Return which of label, crater, shadow and normal are drawn of a camera."""
        found = {layer for layer in _TRUTH if self.name(layer, side) in self.layers}
        return found | ({'label'} if side == LEFT and self.flow else set())

    def depth_of(self, side: int) -> bool:
        """Return whether the depth of a camera is read."""
        return self.name('depth', side) in self.layers or (side == LEFT and self.flow)

    def images(self, pixels: dict[int, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return those images of both sides that are asked for, by layer."""
        return {name: pixels[side] for side, name in enumerate(('left', 'right'))
                if name in self.layers}

    @property
    def lit_sides(self) -> tuple[int, ...]:
        """Cameras for which the light is computed; truth alone needs none."""
        return tuple(side for side in (LEFT, RIGHT) if self.layers & _SHADED[side])

    @property
    def lit(self) -> bool:
        """Whether the light is computed."""
        return bool(self.lit_sides)

    @property
    def developed(self) -> bool:
        """Whether the sensors take a picture."""
        return bool(self.layers & {'left', 'right'})

    @property
    def flow(self) -> bool:
        """Whether the flow to another state is computed."""
        return bool(self.layers.intersection(FLOWS))


@dataclasses.dataclass
class SeenSun(ImagedSun):
    """The sun as both cameras of a pair see it, and what hides it.

    Attributes:
        T_world_views: (4, 4) narrow views of the disc from both cameras; None if nothing hides it.
        over_ground: (2, n, n) where these views pass over the ground.
        sky: (2, n, n) where they see the sky; None before they are read.
    """

    T_world_views: list[Array] | None = None
    over_ground: NDArray[np.bool_] | bool = True
    sky: NDArray[np.bool_] | None = None


@dataclasses.dataclass(frozen=True)
class SceneLight:
    """What the light of one source needs of a frame.

    Attributes:
        shadow: That of the rover.
        body: On the rover, None if it is out of view.
    """

    shadow: CastShadow
    body: BodyLight | None


@dataclasses.dataclass
class Scene:
    """A frame that is begun.

    Attributes:
        pixels: Images of depth and truth.
        samples: Those that light is computed for, the same or with several samples a pixel.
        state: What the frame shows.
        T_world_links: (links, 4, 4).
        T_world_cameras: (4, 4) of both cameras.
        lights: Of each of `WorldPasses.sources`, the sun first.
        sun: What the cameras see of the sun, None if it cannot reach their lenses.
        above_m: Height of the middle of the cameras above the ground, at least `LOWEST_M`.
        shows_rover: Whether the rover is in view.
        tracks: Where they may be in view.
        lamp: None without a lamp, or without light.
        depth_m: Of the ground alone, by the number of the drawing and the side of its images.
        ground: Its light and truth, by the same.
    """

    request: Request
    pixels: Drawing
    samples: Drawing
    state: RoverPose
    T_world_links: Array
    T_world_cameras: list[Array]
    lights: list[SceneLight] = dataclasses.field(default_factory=list)
    sun: SeenSun | None = None
    above_m: float = LOWEST_M
    shows_rover: bool = False
    tracks: SeenTracks = SeenTracks()
    lamp: LampLight | None = None
    depth_m: dict[tuple[int, int], NDArray[np.float32]] = dataclasses.field(default_factory=dict)
    ground: GroundPicture | None = None

    @property
    def drawings(self) -> tuple[Drawing, ...]:
        """All that is drawn of the scene."""
        return (self.pixels,) if self.samples is self.pixels else (self.samples, self.pixels)

    def movement(self, side: int, mount: Mount, rover: RoverDescription, image: ImageGeometry,
                 links: list[int]) -> Movement:
        """Return how a camera moves.

        Args:
            side: LEFT or RIGHT.
            mount: Carries it.
            rover: Has the links.
            image: Geometry of its image.
            links: Indices of those that move in the image.
        """
        camera = self.T_world_cameras[side]
        R, centre = camera[:3, :3], camera[:3, 3]
        axles = (self.T_world_links[links, :3, 3] - centre) @ R
        nearness = np.minimum(image.nearness(axles), 1.0 / _NEAREST_M)
        twists = mount.link_twists(self.state, side, rover) if links else []
        feet_m = self.T_world_links[1:, 2, 3].mean() - rover.legs.spoke_length_m
        return Movement([MovingBody(mount.ground_twist(self.state, side)),
                         *(MovingBody(twists[link], 1 + link, float(near))
                           for link, near in zip(links, nearness))],
                        -R[2], float(centre[2] - feet_m))


_FIELDS = {
    'T_world_base': ((4, 4), 'a pose is a finite 4 x 4 matrix'),
    'linear_velocity_mps': ((3,), 'a velocity is three finite numbers'),
    'angular_velocity_radps': ((3,), 'an angular velocity is three finite numbers'),
}


def checked_state(state: Posed, legs: int) -> RoverPose:
    """Return pose and motion of a state; raise RenderError if they are not valid.

    Args:
        legs: How many the rover has; a state that has no values of legs has them at rest at 0.
    """
    values = {}
    fields = {**_FIELDS,
              'joint_angle_rad': ((legs,), f'leg angles are {legs} finite numbers'),
              'joint_velocity_radps': ((legs,), f'leg velocities are {legs} finite numbers')}
    for name, (shape, rule) in fields.items():
        try:
            value = np.asarray(getattr(state, name), float)
        except AttributeError:
            raise RenderError(f'state: {type(state).__name__} is not valid; valid is a RoverState '
                              'or a RoverPose') from None
        if name.startswith('joint'):
            value = leg_values(value, legs)
        if value.shape != shape or not np.all(np.isfinite(value)):
            raise RenderError(f'{name}: {rule}')
        values[name] = value
    return RoverPose(**values)
