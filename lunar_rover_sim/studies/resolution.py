"""The resolution study: an image against the mean of one with several times the pixels.

Both are radiance, before lens and sensor. If relief, shadows and edges are filtered as they should
be, the finer image averaged over the pixels of the coarser one is as bright at every distance, and
as much of it is in shadow.
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

import numpy as np

from lunar_rover_sim.errors import StudyError
from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.labels import rover_links
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import Posed
from lunar_rover_sim.studies.brightness import law_radiance

_DARK = 0.25            # of sunlit level ground: a pixel below it counts as shadow
_FEWEST = 200           # pixels of a band


@dataclasses.dataclass(frozen=True)
class ResolutionCurve:
    """Means over bands of distance; bands with fewer than 200 pixels are NaN.

    edges_m: (n + 1,); radiance, finer_radiance: (n,) mean [W m-2 sr-1]; shadow, finer_shadow: (n,)
    share of pixels darker than a quarter of level ground in the sun, of the image and of the
    averaged finer one
    """

    edges_m: Array
    radiance: Array
    finer_radiance: Array
    shadow: Array
    finer_shadow: Array

    @property
    def ratio(self) -> Array:
        """Radiance over that of the finer image, (n,)."""
        return self.radiance / self.finer_radiance

    @property
    def shadow_difference(self) -> Array:
        """Share in shadow less that of the finer image, (n,)."""
        return self.shadow - self.finer_shadow


def against_finer(renderer: Renderer, finer: Renderer, states: Sequence[Posed],
                  edges_m: Sequence[float]) -> ResolutionCurve:
    """Compare what two renderers draw of all states together, ground and rocks.

    finer: the same scene with a whole multiple of the pixels, along both sides. Raises StudyError
    if it is none.
    """
    size, finer_size = ((each.config.camera.height, each.config.camera.width)
                        for each in (renderer, finer))
    times = finer_size[0] // size[0]
    if times < 1 or (times * size[0], times * size[1]) != finer_size:
        raise StudyError(f'finer: {finer_size[1]} x {finer_size[0]} pixels are not valid; valid '
                         f'is a multiple of {size[1]} x {size[0]}')
    edges = np.asarray(edges_m, float)
    bands = len(edges) - 1
    totals = np.zeros((5, bands))
    up = np.broadcast_to([0.0, 0.0, 1.0], (*size, 3))
    for state in states:
        frame = renderer.render(state, 0, ('radiance', 'depth', 'label'))
        fine = finer.render(state, 0, ('radiance',)).radiance
        assert frame.radiance is not None and frame.depth_m is not None
        assert frame.label is not None and fine is not None
        mean = fine.astype(float).reshape(size[0], times, size[1], times).mean(axis=(1, 3))
        drawn = frame.radiance.astype(float)
        dark = _DARK * renderer.config.sun.irradiance * law_radiance(renderer, state, up)
        band = np.digitize(frame.depth_m, edges) - 1
        inside = (band >= 0) & (band < bands) & ~rover_links(frame.label)
        for k, values in enumerate((np.ones(size), drawn, mean, drawn < dark, mean < dark)):
            totals[k] += np.bincount(band[inside], values[inside], bands)
    count = np.where(totals[0] < _FEWEST, np.nan, totals[0])
    return ResolutionCurve(edges, *(totals[1:] / count))
