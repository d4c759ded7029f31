"""Albedo and roughness of common materials that come nearest to Hapke's reflectance in a scene.

UsdPreviewSurface is Lambert's law plus a microfacet lobe (GGX, Schlick's Fresnel term; Walter et
al., 2007, and the UsdPreviewSurface proposal); OmniPBR without its lobe is Lambert's law alone.
Neither scatters back towards the sun as regolith does: no opposition effect, no roughness that
darkens the limb, no phase function. So both are fitted where the rover's cameras look, under the
sun of the scene, and what remains is measured.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination.hapke import HapkeParameters, reflectance

# Of the microfacet lobe: index of refraction 1, so that it has no reflectance at normal incidence.
IOR = 1.0
_ROUGHNESS = np.linspace(0.05, 1.0, 20)
# What a camera 0.25 m above level ground sees between 0.4 and 10 m: elevations of the line of
# sight, evenly spaced as image rows are.
_LEAST_DEG, _MOST_DEG = 1.5, 32.0
# RMS slope of the facets that are looked at, along both axes: of the default ground at a cell.
_SLOPE = np.tan(np.radians(6.0))
_LEAST_MU = 0.02        # of cosines: what is seen or lit at less counts for nothing in an image


@dataclasses.dataclass(frozen=True)
class ShadingFit:
    """Common materials for one kind of ground under one sun.

    preview_albedo, preview_roughness: of UsdPreviewSurface; lambert_albedo: of OmniPBR
    preview_residual, lambert_residual: RMS of ln(radiance / Hapke's), weighted as the fit is
    towards, across, away: radiance over Hapke's of Lambert's law, mean within 45 deg of looking
        towards the sun, at right angles, and away from it
    """

    preview_albedo: float
    preview_roughness: float
    preview_residual: float
    lambert_albedo: float
    lambert_residual: float
    towards: float
    across: float
    away: float


@dataclasses.dataclass(frozen=True)
class Geometry:
    """Directions in a scene: cosines of incidence, emission, phase, weights, azimuth of view.

    azimuth_rad: 0 looks towards the sun
    """

    cos_i: Array
    cos_e: Array
    cos_g: Array
    weight: Array
    azimuth_rad: Array


def scene_geometry(sun_elevation_deg: float) -> Geometry:
    """Return the directions that occur in images of rough ground under a sun."""
    elevation = np.radians(max(sun_elevation_deg, 0.25))
    sun = np.array([np.cos(elevation), 0.0, np.sin(elevation)])
    nodes, weights = np.polynomial.hermite_e.hermegauss(7)
    look = np.radians(np.linspace(_LEAST_DEG, _MOST_DEG, 12))
    azimuth = np.arange(24) * 2.0 * np.pi / 24
    a, l, p, q = np.meshgrid(azimuth, look, _SLOPE * nodes, _SLOPE * nodes, indexing='ij')
    weight = np.broadcast_to(weights[:, None] * weights, a.shape)
    # From the ground to the camera, which looks along (cos a, sin a).
    view = np.stack([-np.cos(l) * np.cos(a), -np.cos(l) * np.sin(a), np.sin(l)], axis=-1)
    normal = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    cos_i, cos_e = normal @ sun, np.sum(normal * view, axis=-1)
    seen = (cos_i > _LEAST_MU) & (cos_e > _LEAST_MU)
    # A facet covers cos_e of the image.
    weight = weight * cos_e
    weight = weight[seen] / weight[seen].sum()
    return Geometry(cos_i[seen], cos_e[seen], (view @ sun)[seen], weight, a[seen])


def preview_surface(geometry: Geometry, albedo: float, roughness: float) -> Array:
    """Return the reflectance [1/sr] of UsdPreviewSurface times the cosine of incidence."""
    cos_i, cos_e, cos_g = geometry.cos_i, geometry.cos_e, geometry.cos_g
    alpha2 = roughness ** 4
    half = np.sqrt(np.maximum(2.0 + 2.0 * cos_g, 1e-12))      # |sun + view|
    cos_h, cos_d = (cos_i + cos_e) / half, 0.5 * half
    spread = alpha2 / (np.pi * (cos_h ** 2 * (alpha2 - 1.0) + 1.0) ** 2)
    k = 0.5 * roughness ** 2
    masking = 0.25 / ((cos_i * (1.0 - k) + k) * (cos_e * (1.0 - k) + k))
    normal = ((1.0 - IOR) / (1.0 + IOR)) ** 2
    fresnel = normal + (1.0 - normal) * (1.0 - cos_d) ** 5
    return ((1.0 - fresnel) * albedo / np.pi + fresnel * spread * masking) * cos_i


def fit_shading(ground: HapkeParameters, sun_elevation_deg: float,
                albedo_scale: float = 1.0) -> ShadingFit:
    """Return the materials nearest to a kind of ground under a sun [deg above the horizon].

    The mean radiance agrees exactly; the roughness is that with the least residual.
    """
    scene = scene_geometry(sun_elevation_deg)
    truth = reflectance(scene.cos_i, scene.cos_e, scene.cos_g, ground, albedo=albedo_scale)
    weight = scene.weight

    def albedo(without: Array, per_albedo: Array) -> float:
        rest = float(weight @ (truth - without)) / float(weight @ per_albedo)
        return float(np.clip(rest, 1e-4, 1.0))

    def residual(radiance: Array) -> float:
        share = weight * truth
        wrong = np.log(np.maximum(radiance, 1e-9) / np.maximum(truth, 1e-9))
        return float(np.sqrt(share @ wrong ** 2 / share.sum()))

    found = []
    for roughness in _ROUGHNESS:
        lobe = preview_surface(scene, 0.0, roughness)
        value = albedo(lobe, preview_surface(scene, 1.0, roughness) - lobe)
        found.append((residual(preview_surface(scene, value, roughness)), value, roughness))
    least, preview_albedo, roughness = min(found)
    lambert = albedo(np.zeros_like(truth), scene.cos_i / np.pi)
    radiance = lambert * scene.cos_i / np.pi
    turn = np.abs((scene.azimuth_rad + np.pi) % (2.0 * np.pi) - np.pi)

    def ratio(which: NDArray[np.bool_]) -> float:
        return float((weight * radiance)[which].sum() / (weight * truth)[which].sum())

    return ShadingFit(preview_albedo, float(roughness), least, lambert, residual(radiance),
                      ratio(turn < 0.25 * np.pi), ratio(np.abs(turn - 0.5 * np.pi) < 0.25 * np.pi),
                      ratio(turn > 0.75 * np.pi))
