"""The resolution study: an image against the mean of one with several times the pixels.

Both are radiance, before lens and sensor. If relief, shadows and edges are filtered as they should
be, the finer image averaged over the pixels of the coarser one is as bright at every distance, and
as much of it is in shadow.
"""

from collections.abc import Sequence
import dataclasses

from brightness import law_radiance
import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera.config import FurtherCameraConfig
from lunar_rover_sim.image.camera.mount import BodyMount
from lunar_rover_sim.image.rendering.labels import rover_links
from lunar_rover_sim.image.rendering.renderer import FurtherCamera, Renderer
from lunar_rover_sim.rover.pose import Posed

_DARK = 0.25            # of sunlit level ground: a pixel below it counts as shadow
_FEWEST = 200           # pixels of a band
_LEAST = 0.02           # of sunlit level ground: a band that is darker has no ratio


@dataclasses.dataclass(frozen=True)
class ResolutionCurve:
    """Means over bands of distance; bands with fewer than 200 pixels are NaN.

    edges_m: (n + 1,); radiance, finer_radiance, law: (n,) mean of the image, of the finer one and
    of level ground in the sun [W m-2 sr-1]; shadow, finer_shadow: (n,) share of pixels darker than
    a quarter of the latter, of the image and of the averaged finer one
    """

    edges_m: Array
    radiance: Array
    finer_radiance: Array
    law: Array
    shadow: Array
    finer_shadow: Array

    @property
    def ratio(self) -> Array:
        """Radiance over that of the finer image, (n,); NaN where nearly all is in shadow."""
        return self.radiance / np.where(self.finer_radiance < _LEAST * self.law, np.nan,
                                        self.finer_radiance)

    @property
    def shadow_difference(self) -> Array:
        """Share in shadow less that of the finer image, (n,)."""
        return self.shadow - self.finer_shadow


def finer_camera(renderer: Renderer, times: int) -> FurtherCamera:
    """Return a camera in the place of the left one, with `times` as many pixels along a side.

    Raises RenderError if the device cannot draw its image size.
    """
    camera = renderer.config.camera
    finer = dataclasses.replace(camera, width=camera.width * times, height=camera.height * times)
    return renderer.add_camera(FurtherCameraConfig(camera=finer), BodyMount(renderer.rig))


def against_finer(renderer: Renderer, finer: FurtherCamera, states: Sequence[Posed],
                  edges_m: Sequence[float]) -> ResolutionCurve:
    """Compare what is drawn of all states together, ground and rocks; finer: `finer_camera`."""
    size = renderer.rig.height, renderer.rig.width
    times = finer.camera.height // size[0]
    edges = np.asarray(edges_m, float)
    bands = len(edges) - 1
    totals = np.zeros((6, bands))
    up = np.broadcast_to([0.0, 0.0, 1.0], (*size, 3))
    for state in states:
        frame = renderer.render(state, 0, ('radiance', 'depth', 'label'))
        fine = finer.render(state, 0, ('radiance',)).radiance
        assert frame.radiance is not None and frame.depth_m is not None
        assert frame.label is not None and fine is not None
        mean = fine.astype(float).reshape(size[0], times, size[1], times).mean(axis=(1, 3))
        drawn = frame.radiance.astype(float)
        law = renderer.config.sun.irradiance * law_radiance(renderer, state, up)
        band = np.digitize(frame.depth_m, edges) - 1
        inside = (band >= 0) & (band < bands) & ~rover_links(frame.label)
        for k, values in enumerate((np.ones(size), drawn, mean, law, drawn < _DARK * law,
                                    mean < _DARK * law)):
            totals[k] += np.bincount(band[inside], values[inside], bands)
    count = np.where(totals[0] < _FEWEST, np.nan, totals[0])
    return ResolutionCurve(edges, *(totals[1:] / count))
