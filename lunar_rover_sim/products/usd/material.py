"""Materials: UsdPreviewSurface, and OmniPBR of Omniverse as its twin, for RTX.

The twins stand in a layer of their own, `omniverse.usda` among the parts of a stage, that is laid
over the stage as a sublayer. OmniPBR.mdl belongs to Omniverse, which finds it by its name. It is
not among our files, and a stage that refers to a missing file would not be valid elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from pathlib import Path

import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.illumination.hapke import HapkeParameters, reflectance
from lunar_rover_sim.products.usd.stage import Gf, Sdf, Usd, UsdPhysics, UsdShade

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

    Attributes:
        preview_albedo, preview_roughness: Of UsdPreviewSurface.
        lambert_albedo: Of OmniPBR.
    """

    preview_albedo: float
    preview_roughness: float
    lambert_albedo: float


@dataclasses.dataclass(frozen=True)
class Geometry:
    """Directions in a scene: cosines of incidence, emission, phase; weights."""

    cos_i: Array
    cos_e: Array
    cos_g: Array
    weight: Array


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
    return Geometry(cos_i[seen], cos_e[seen], (view @ sun)[seen], weight)


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
    _, preview_albedo, roughness = min(found)
    return ShadingFit(preview_albedo, float(roughness),
                      albedo(np.zeros_like(truth), scene.cos_i / np.pi))


TWINS = 'omniverse.usda'
_MDL = 'OmniPBR.mdl'
_Types = Sdf.ValueTypeNames


@dataclasses.dataclass(frozen=True)
class Look:
    """How a surface looks.

    Attributes:
        albedo, roughness: Linear red, green, blue, and roughness of UsdPreviewSurface.
        twin_albedo: That of the twin, which has no microfacet lobe.
        texture: Of factors on the albedo, 0 to `texture_scale`, raw; its name among the parts.
        relief: Normal map; its name among the parts.
        relief_repeats: Its copies along the texture.
    """

    albedo: Sequence[float]
    roughness: float
    twin_albedo: Sequence[float]
    texture: str = ''
    texture_scale: float = 1.0
    relief: str = ''
    relief_repeats: float = 1.0


def add_material(stage: Usd.Stage, path: Sdf.Path, look: Look,
                 parts: str = '.') -> UsdShade.Material:
    """Define a material without its twin; parts: path of the folder that holds its texture."""
    material = UsdShade.Material.Define(stage, path)
    preview = UsdShade.Shader.Define(stage, path.AppendChild('preview'))
    preview.CreateIdAttr('UsdPreviewSurface')
    preview.CreateInput('roughness', _Types.Float).Set(look.roughness)
    preview.CreateInput('metallic', _Types.Float).Set(0.0)
    preview.CreateInput('ior', _Types.Float).Set(IOR)
    colour = preview.CreateInput('diffuseColor', _Types.Color3f)
    if look.texture:
        st = _coordinates(stage, path)
        colour.ConnectToSource(_texture(stage, path, look, f'{parts}/{look.texture}', st))
        if look.relief:
            preview.CreateInput('normal', _Types.Normal3f).ConnectToSource(
                _relief(stage, path, look, f'{parts}/{look.relief}', st))
    else:
        colour.Set(Gf.Vec3f(*look.albedo))
    material.CreateSurfaceOutput().ConnectToSource(
        preview.CreateOutput('surface', _Types.Token))
    return material


def write_twins(path: Path, looks: Mapping[Sdf.Path, Look]) -> None:
    """Write the layer that adds its twin to each material, beside their textures."""
    stage = Usd.Stage.CreateNew(str(path))
    for prim, look in looks.items():
        stage.OverridePrim(prim)
        twin = UsdShade.Shader.Define(stage, prim.AppendChild('omni_pbr'))
        twin.SetSourceAsset(Sdf.AssetPath(_MDL), 'mdl')
        twin.SetSourceAssetSubIdentifier('OmniPBR', 'mdl')
        albedo = Gf.Vec3f(*look.twin_albedo)
        if look.texture:
            _set_texture(twin, 'diffuse_texture', f'./{look.texture}')
            twin.CreateInput('diffuse_tint', _Types.Color3f).Set(albedo * look.texture_scale)
            if look.relief:
                _set_texture(twin, 'detail_normalmap_texture', f'./{look.relief}')
                twin.CreateInput('detail_texture_scale', _Types.Float2).Set(
                    Gf.Vec2f(look.relief_repeats))
                twin.CreateInput('detail_bump_factor', _Types.Float).Set(1.0)
        else:
            twin.CreateInput('diffuse_color_constant', _Types.Color3f).Set(albedo)
        twin.CreateInput('reflection_roughness_constant', _Types.Float).Set(look.roughness)
        twin.CreateInput('metallic_constant', _Types.Float).Set(0.0)
        twin.CreateInput('specular_level', _Types.Float).Set(0.0)
        output = twin.CreateOutput('out', _Types.Token)
        material = UsdShade.Material(stage.GetPrimAtPath(prim))
        for terminal in (material.CreateSurfaceOutput('mdl'),
                         material.CreateDisplacementOutput('mdl'),
                         material.CreateVolumeOutput('mdl')):
            terminal.ConnectToSource(output)
    stage.Save()


def _set_texture(shader: UsdShade.Shader, name: str, file: str) -> None:
    """Set a raw texture of OmniPBR."""
    image = shader.CreateInput(name, _Types.Asset)
    image.Set(Sdf.AssetPath(file))
    image.GetAttr().SetColorSpace('raw')


def _coordinates(stage: Usd.Stage, path: Sdf.Path) -> UsdShade.Output:
    """Return the texture coordinates of a mesh."""
    reader = UsdShade.Shader.Define(stage, path.AppendChild('st'))
    reader.CreateIdAttr('UsdPrimvarReader_float2')
    reader.CreateInput('varname', _Types.String).Set('st')
    return reader.CreateOutput('result', _Types.Float2)


def _relief(stage: Usd.Stage, path: Sdf.Path, look: Look, file: str,
            st: UsdShade.Output) -> UsdShade.Output:
    """Return the normals that a repeated map holds."""
    repeat = UsdShade.Shader.Define(stage, path.AppendChild('relief_st'))
    repeat.CreateIdAttr('UsdTransform2d')
    repeat.CreateInput('in', _Types.Float2).ConnectToSource(st)
    repeat.CreateInput('scale', _Types.Float2).Set(Gf.Vec2f(look.relief_repeats))
    image = _image(stage, path.AppendChild('relief'), file, 'repeat',
                   repeat.CreateOutput('result', _Types.Float2), (2.0, 2.0, 2.0, 1.0))
    image.CreateInput('bias', _Types.Float4).Set(Gf.Vec4f(-1.0, -1.0, -1.0, 0.0))
    return image.CreateOutput('rgb', _Types.Float3)


def _texture(stage: Usd.Stage, path: Sdf.Path, look: Look, file: str,
             st: UsdShade.Output) -> UsdShade.Output:
    """Return the albedo that a texture holds."""
    factor = [look.texture_scale * a for a in look.albedo]
    image = _image(stage, path.AppendChild('albedo'), file, 'clamp', st, (*factor, 1.0))
    return image.CreateOutput('rgb', _Types.Float3)


def _image(stage: Usd.Stage, path: Sdf.Path, file: str, wrap: str, st: UsdShade.Output,
           scale: Sequence[float]) -> UsdShade.Shader:
    """Define the reader of a raw texture; scale: factors on its four channels."""
    image = UsdShade.Shader.Define(stage, path)
    image.CreateIdAttr('UsdUVTexture')
    image.CreateInput('file', _Types.Asset).Set(Sdf.AssetPath(file))
    image.CreateInput('sourceColorSpace', _Types.Token).Set('raw')
    image.CreateInput('wrapS', _Types.Token).Set(wrap)
    image.CreateInput('wrapT', _Types.Token).Set(wrap)
    image.CreateInput('scale', _Types.Float4).Set(Gf.Vec4f(*scale))
    image.CreateInput('st', _Types.Float2).ConnectToSource(st)
    return image


def add_contact_material(stage: Usd.Stage, path: Sdf.Path, friction: float) -> UsdShade.Material:
    """Define a material for contacts: Coulomb friction, no restitution."""
    material = UsdShade.Material.Define(stage, path)
    contact = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    contact.CreateStaticFrictionAttr(friction)
    contact.CreateDynamicFrictionAttr(friction)
    contact.CreateRestitutionAttr(0.0)
    return material


def bind(prim: Usd.Prim, material: UsdShade.Material) -> None:
    """Bind what a prim, and all below it, looks like."""
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def bind_contact(prim: Usd.Prim, material: UsdShade.Material) -> None:
    """Bind the contact material of a prim and all below it."""
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(
        material, UsdShade.Tokens.weakerThanDescendants, 'physics')
