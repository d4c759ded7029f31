"""A world as a stage: ground, surroundings, rocks, sun, gravity."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from lunar_rover_sim.base.frames import sun_direction, wxyz_from_matrix
from lunar_rover_sim.base.gravity import MOON_MPS2
from lunar_rover_sim.ground.world.albedo import far_albedo
from lunar_rover_sim.ground.world.far_rocks import far_rocks
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.illumination.config import ReflectanceConfig, SunConfig
from lunar_rover_sim.image.illumination.hapke import parameter_set
from lunar_rover_sim.image.rendering.config import DetailConfig
from lunar_rover_sim.image.rendering.relief_tiles import relief_heights
from lunar_rover_sim.products.usd import ground
from lunar_rover_sim.products.usd.material import (add_contact_material, add_material, bind,
                                                   bind_contact, fit_shading, Look, TWINS,
                                                   write_twins)
from lunar_rover_sim.products.usd.stage import (add_gravity, check_prim_name, label, new_stage,
                                                place, Sdf, Usd, UsdGeom, UsdLux, UsdShade,
                                                write_stage)

# Of sunlight: 133 klx at 1361 W/m2. Lights of UsdLux are photometric.
LUMENS_PER_WATT = 98.0
HASH_KEY = 'world_hash'     # custom data of the default prim
_ROCK_CLASSES = 8           # of brightness, each with a material of its own


@dataclasses.dataclass(frozen=True)
class StageSettings:
    """What a stage needs to know besides the world.

    Attributes:
        sun, reflectance: As the renderer has them.
        gravity_mps2: Along -z.
        friction: Of contacts.
        detail: Relief below the grid, reach of distant rocks.
    """

    sun: SunConfig = SunConfig()
    reflectance: ReflectanceConfig = ReflectanceConfig()
    gravity_mps2: float = MOON_MPS2
    friction: float = 0.8
    detail: DetailConfig = DetailConfig()


def write_world(world: World, path: str | Path,
                settings: StageSettings = StageSettings(), *, name: str = 'World',
                surroundings: bool = True, overwrite: bool = False) -> Path:
    """Write a world as a stage whose default prim is `/NAME`; return its path.

    Below it: `ground` (tiles; the variant set `resolution` chooses their cells), `surroundings`,
    `rocks`, `sun`, `looks` (materials), `PhysicsScene`. Meshes are payloads: a stage that is
    opened without payloads holds none of them.

    Raises:
        UsdError: Where the name of file or prim is not valid or the file cannot be written.
    """
    check_prim_name(name)

    def compose(root: Path, parts: Path) -> None:
        compose_world(world, root, parts, settings, name, surroundings)

    return write_stage(Path(path), compose, overwrite)


def compose_world(world: World, root: Path, parts: Path, settings: StageSettings,
                  name: str = 'World', surroundings: bool = True) -> None:
    """Write the root layer of a world and the files in the folder `parts` beside it."""
    _WorldStage(world, root, parts, settings, name).compose(surroundings)


class _WorldStage:
    """A stage while it is written: the root layer, and the folder of parts it refers to."""

    def __init__(self, world: World, root: Path, parts: Path, settings: StageSettings,
                 name: str) -> None:
        self._world, self._settings = world, settings
        self._parts, self._parts_path = parts, f'./{parts.name}'
        self._stage, self._root = new_stage(root, name)
        self._top = self._root.GetPath()
        self._looks_path = UsdGeom.Scope.Define(self._stage, self._path('looks')).GetPath()
        self._looks: dict[Sdf.Path, Look] = {}

    def compose(self, surroundings: bool) -> None:
        """Write everything."""
        if self._world.origin_m != (0.0, 0.0):      # a window, in the frame of its site
            place(self._root, [*self._world.origin_m, 0.0])
        add_gravity(self._stage, self._root, self._settings.gravity_mps2)
        self._add_sun()
        contact = add_contact_material(self._stage, self._looks_path.AppendChild('contact'),
                                       self._settings.friction)
        self._add_ground(contact)
        if len(self._world.rocks):
            self._add_rocks(contact)
        if surroundings:
            self._add_surroundings()
        write_twins(self._parts / TWINS, self._looks)
        self._root.SetCustomDataByKey(HASH_KEY, self._world.hash)
        self._stage.Save()

    def _path(self, *names: str) -> Sdf.Path:
        path = self._top
        for name in names:
            path = path.AppendChild(name)
        return path

    def _payload(self, path: Sdf.Path, file: str, prim: str) -> Usd.Prim:
        """Define a prim whose content is that of a prim in one of the parts."""
        result = self._stage.DefinePrim(path)
        result.GetPayloads().AddPayload(f'{self._parts_path}/{file}', prim)
        return result

    def _add_sun(self) -> None:
        """Add the sun, which shines along -z of its prim; nothing else lights the scene."""
        sun = self._settings.sun
        light = UsdLux.DistantLight.Define(self._stage, self._path('sun'))
        light.CreateAngleAttr(sun.angular_diameter_deg)
        light.CreateIntensityAttr(LUMENS_PER_WATT * sun.irradiance)
        light.CreateNormalizeAttr(True)
        z = sun_direction(sun.azimuth_deg, sun.elevation_deg)
        x = np.cross([0.0, 0.0, 1.0] if abs(z[2]) < 0.9 else [0.0, 1.0, 0.0], z)
        x /= np.linalg.norm(x)
        rotation = np.stack([x, np.cross(z, x), z], axis=-1)
        place(light.GetPrim(), np.zeros(3), wxyz_from_matrix(rotation))

    def _add_ground(self, contact: UsdShade.Material) -> None:
        """Add the tiles, each a payload; a variant set chooses their resolution."""
        grid = self._world.ground
        ground.write_ground(self._parts / 'ground.usdc', grid)
        path = self._path('ground')
        area = UsdGeom.Xform.Define(self._stage, path).GetPrim()
        label(area, 'ground')
        side = ground.tile_cells(grid.n - 1)
        count = (grid.n - 1) // side
        tiles = [f'tile_{row:02d}_{column:02d}' for row in range(count) for column in range(count)]
        variants = area.GetVariantSets().AddVariantSet('resolution')
        for name in (n for n, stride in ground.RESOLUTIONS.items() if side % stride == 0):
            variants.AddVariant(name)
            variants.SetVariantSelection(name)
            with variants.GetVariantEditContext():
                for tile in tiles:
                    self._payload(path.AppendChild(tile), 'ground.usdc', f'/{name}/{tile}')
        variants.SetVariantSelection('full')
        bind(area, self._regolith(0))
        bind_contact(area, contact)

    def _add_rocks(self, contact: UsdShade.Material) -> None:
        """Add the rocks on the fine ground; they are one payload."""
        ground.write_rocks(self._parts / 'rocks.usdc', self._world.rocks, self._world.rock_shapes)
        path = self._path('rocks')
        UsdGeom.Xform.Define(self._stage, path)
        self._payload(path, 'rocks.usdc', '/rocks')
        member, factors = ground.brightness_classes(self._world.rocks, _ROCK_CLASSES)
        materials = [self._rock(f'rock_{k}', float(factor)) for k, factor in enumerate(factors)]
        ground.bind_rocks(self._stage, path, member, materials, contact)

    def _add_surroundings(self) -> None:
        """Add the coarse levels and their rocks, which nothing collides with."""
        world = self._world
        UsdGeom.Xform.Define(self._stage, self._path('surroundings'))
        for k, name in enumerate(ground.write_surroundings(self._parts / 'surroundings.usdc',
                                                           world.levels), 1):
            bind(self._payload(self._path('surroundings', name), 'surroundings.usdc', f'/{name}'),
                 self._regolith(k))
        distant = far_rocks(world, self._settings.detail.far_rocks_m)
        if len(distant):
            ground.write_far_rocks(self._parts / 'far_rocks.usdc', distant, world.rock_shapes)
            bind(self._payload(self._path('surroundings', 'rocks'), 'far_rocks.usdc', '/rocks'),
                 self._rock('rock_far', 1.0))

    def _regolith(self, k: int) -> UsdShade.Material:
        """Return the material of a level of the ground."""
        reflectance = self._settings.reflectance
        fit = fit_shading(parameter_set(reflectance.ground), self._settings.sun.elevation_deg,
                          reflectance.albedo_scale)
        texture, relief, repeats = f'albedo_{k}.png', '', 1.0
        ground.write_texture(self._parts / texture,
                             self._world.albedo if k == 0 else far_albedo(self._world, k))
        if k == 0:
            relief = 'relief.png'
            tiles = relief_heights(self._settings.detail, max(self._world.config.seed, 0))
            grid = self._world.ground
            repeats = grid.n * grid.cell_m / ground.write_relief(self._parts / relief, tiles)
        return self._material(f'regolith_{k}', Look(
            [fit.preview_albedo] * 3, fit.preview_roughness, [fit.lambert_albedo] * 3, texture,
            ground.TEXTURE_SCALE, relief, repeats))

    def _rock(self, name: str, factor: float) -> UsdShade.Material:
        """Return a material of rocks; factor: on their single-scattering albedo."""
        fit = fit_shading(parameter_set(self._settings.reflectance.rocks),
                          self._settings.sun.elevation_deg, factor)
        return self._material(name, Look([fit.preview_albedo] * 3, fit.preview_roughness,
                                         [fit.lambert_albedo] * 3))

    def _material(self, name: str, look: Look) -> UsdShade.Material:
        path = self._looks_path.AppendChild(name)
        self._looks[path] = look
        return add_material(self._stage, path, look, self._parts_path)
