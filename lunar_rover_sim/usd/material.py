"""Materials: UsdPreviewSurface, and OmniPBR of Omniverse as its twin, for RTX.

The twins stand in a layer of their own, `omniverse.usda` among the parts of a stage, that is laid
over the stage as a sublayer. OmniPBR.mdl belongs to Omniverse, which finds it by its name. It is
not among our files, and a stage that refers to a missing file would not be valid elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from pathlib import Path

from lunar_rover_sim.usd.pixar import Gf, Sdf, Usd, UsdPhysics, UsdShade
from lunar_rover_sim.usd.shading_fit import IOR

TWINS = 'omniverse.usda'
_MDL = 'OmniPBR.mdl'
_Types = Sdf.ValueTypeNames


@dataclasses.dataclass(frozen=True)
class Look:
    """How a surface looks.

    albedo, roughness: linear red, green, blue, and roughness of UsdPreviewSurface
    twin_albedo: that of the twin, which has no microfacet lobe
    texture: of factors on the albedo, 0 to `texture_scale`, raw; its name among the parts
    relief: normal map; its name among the parts; relief_repeats: its copies along the texture
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


def write_twins(path: Path, looks: Mapping[Sdf.Path, Look], parts: str = '.') -> None:
    """Write the layer that adds its twin to each material; arguments as for `add_material`."""
    stage = Usd.Stage.CreateNew(str(path))
    for prim, look in looks.items():
        stage.OverridePrim(prim)
        twin = UsdShade.Shader.Define(stage, prim.AppendChild('omni_pbr'))
        twin.SetSourceAsset(Sdf.AssetPath(_MDL), 'mdl')
        twin.SetSourceAssetSubIdentifier('OmniPBR', 'mdl')
        albedo = Gf.Vec3f(*look.twin_albedo)
        if look.texture:
            _set_texture(twin, 'diffuse_texture', f'{parts}/{look.texture}')
            twin.CreateInput('diffuse_tint', _Types.Color3f).Set(albedo * look.texture_scale)
            if look.relief:
                _set_texture(twin, 'detail_normalmap_texture', f'{parts}/{look.relief}')
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
