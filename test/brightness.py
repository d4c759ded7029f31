"""The brightness study: the mean radiance of ground against Hapke's law, by distance.

Relief is drawn near the camera and averaged far away. If what is drawn and what is left to the
law agree, the mean over many pixels of one geometry does not depend on the distance, nor on the
resolution of the image.
"""

from collections.abc import Sequence
import dataclasses

import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.illumination import hapke
from lunar_rover_sim.image.rendering.labels import LABEL_GROUND
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.snapshot import standing
from lunar_rover_sim.rover.pose import Posed, RoverPose

EDGES_M = (0.3, 0.4, 0.6, 0.9, 1.3, 2.0, 3.0, 4.5, 7.0, 11.0, 20.0)
DIRECTIONS_DEG = {'towards': 0.0, 'across': 90.0, 'away': 180.0}    # of the view, from the sun
_DARK = 0.25            # of the law: a pixel below it counts as shadow


@dataclasses.dataclass(frozen=True)
class BrightnessCurve:
    """Means over bands of distance; bands with fewer than 20 pixels are NaN.

    edges_m: (n + 1,); radiance, law: (n,) mean radiance over irradiance [1/sr], drawn and of
    Hapke's law on the slopes of the grid; shadow: (n,) share of pixels in shadow
    """

    edges_m: Array
    radiance: Array
    law: Array
    shadow: Array

    @property
    def ratio(self) -> Array:
        """Drawn over law, (n,)."""
        return self.radiance / self.law


def brightness(renderer: Renderer, plain: Renderer, states: Sequence[Posed],
               edges_m: Sequence[float] = EDGES_M) -> BrightnessCurve:
    """Return the brightness of sunlit ground of all states together.

    plain: the same without relief below the grid; what it shows dark lies in the shadow of the
    grid, of rocks or of the rover, and does not count. The law is that of ground of albedo 1.
    """
    edges = np.asarray(edges_m, float)
    totals = np.zeros((4, len(edges) - 1))      # pixels, radiance, law, dark pixels
    for state in states:
        frame = renderer.render(state, 0, ('radiance', 'depth', 'normal', 'label'))
        assert frame.depth_m is not None and frame.normal is not None
        assert frame.radiance is not None and frame.label is not None
        law = law_radiance(renderer, state, frame.normal.astype(float))
        drawn = frame.radiance / renderer.config.sun.irradiance
        lit = plain.render(state, 0, ('radiance',)).radiance
        assert lit is not None
        ground = (frame.label == LABEL_GROUND) \
            & (lit > 0.9 * law * plain.config.sun.irradiance)
        band = np.digitize(frame.depth_m[ground], edges) - 1
        inside = (band >= 0) & (band < len(edges) - 1)
        for k, values in enumerate((np.ones(law.shape), drawn, law, drawn < _DARK * law)):
            totals[k] += np.bincount(band[inside], values[ground][inside], len(edges) - 1)
    count = np.where(totals[0] < 20, np.nan, totals[0])
    return BrightnessCurve(edges, *(totals[1:] / count))


def law_radiance(renderer: Renderer, state: Posed, normal: Array) -> Array:
    """Return Hapke's radiance over irradiance [1/sr] of the left image, for (h, w, 3) normals."""
    T_world_left = state.T_world_base @ renderer.rig.T_base_left
    view = -renderer.rig.rays() @ T_world_left[:3, :3].T
    view /= np.linalg.norm(view, axis=2, keepdims=True)
    sun = renderer.sun_direction
    config = renderer.config.reflectance
    return hapke.reflectance(normal @ sun, np.sum(normal * view, axis=2), view @ sun,
                             hapke.parameter_set(config.ground), albedo=config.albedo_scale)


def views(renderer: Renderer, direction: str, places: int = 3) -> list[RoverPose]:
    """Return rovers that stand some metres apart and look towards, across or away from the sun.
    """
    yaw_deg = renderer.config.sun.azimuth_deg + DIRECTIONS_DEG[direction]
    return [RoverPose(standing(renderer.world, 1.37 * k, -0.71 * k, yaw_deg))
            for k in range(places)]
