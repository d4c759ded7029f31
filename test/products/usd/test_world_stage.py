"""A world as a stage: what MuJoCo collides with, what the renderer is lit by."""

from pathlib import Path

import cv2
import mujoco
import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdSemantics, UsdShade
import pytest
from stages import problems

from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.ground.world.far_rocks import far_rocks
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.illumination.hapke import SETS
from lunar_rover_sim.image.rendering.config import DetailConfig
from lunar_rover_sim.image.rendering.relief_tiles import relief_heights
from lunar_rover_sim.products.usd.ground import TEXTURE_SCALE, tile_cells
from lunar_rover_sim.products.usd.material import fit_shading
from lunar_rover_sim.products.usd.world_stage import StageSettings, write_world
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.rover.physics.model import build_model


@pytest.fixture(scope='module')
def stage(world_file: Path) -> Usd.Stage:
    return Usd.Stage.Open(str(world_file))


def placed(prim: Usd.Prim) -> np.ndarray:
    """Return the (n, 3) points of a mesh in the world, in double precision."""
    matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim))
    vertices = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(), float)
    return vertices @ matrix[:3, :3] + matrix[3, :3]


def tiles(stage: Usd.Stage) -> list[Usd.Prim]:
    return [p for p in stage.GetPrimAtPath('/World/ground').GetChildren() if p.IsA(UsdGeom.Mesh)]


def test_units_and_gravity(stage: Usd.Stage, moon: World) -> None:
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    assert UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    top = stage.GetDefaultPrim()
    assert top.GetPath() == Sdf.Path('/World')
    assert top.GetCustomDataByKey('world_hash') == moon.hash
    scenes = [UsdPhysics.Scene(p) for p in stage.Traverse() if p.IsA(UsdPhysics.Scene)]
    assert len(scenes) == 1
    assert scenes[0].GetGravityDirectionAttr().Get() == Gf.Vec3f(0, 0, -1)
    assert scenes[0].GetGravityMagnitudeAttr().Get() == pytest.approx(1.62)


def test_ground_is_what_mujoco_collides_with(stage: Usd.Stage, moon: World) -> None:
    """Every vertex of MuJoCo's height fields is one of the mesh within 1 um, and no other is."""
    model = build_model(moon, RoverDescription(), PhysicsConfig())
    n, cell, half = moon.ground.n, moon.ground.cell_m, moon.ground.half_extent_m
    z, axis = np.full((n, n), np.nan), np.linspace(-half, half, n)
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD):
        field, (x, y, low) = model.geom_dataid[geom], model.geom_pos[geom]
        rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
        first = model.hfield_adr[field]
        part = model.hfield_data[first:first + rows * columns].reshape(rows, columns)
        west, south = (round((v - reach + half) / cell)
                       for v, reach in zip((x, y), model.hfield_size[field]))
        z[south:south + rows, west:west + columns] = part * model.hfield_size[field, 2] + low
    seen = np.zeros((n, n), int)
    triangles = 0
    for tile in tiles(stage):
        points = placed(tile)
        column, row = (np.rint((points[:, k] - axis[0]) / moon.ground.cell_m).astype(int)
                       for k in (0, 1))
        truth = np.stack([axis[column], axis[row], z[row, column]], axis=-1)
        assert np.abs(points - truth).max() < 1e-6
        seen[row, column] += 1
        faces = np.array(UsdGeom.Mesh(tile).GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        triangles += len(faces)
        # Two per cell, split from its south-west to its north-east corner, seen from above.
        local = np.stack([column, row], axis=-1)[faces]
        low = local.min(axis=1, keepdims=True)
        assert np.array_equal(np.sort((local - low) @ [1, 2], axis=1)[:, [0, 2]],
                              np.tile([0, 3], (len(faces), 1)))
        a, b = local[:, 1] - local[:, 0], local[:, 2] - local[:, 0]
        assert np.all(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] == 1)
    side = tile_cells(n - 1)
    assert seen.min() == 1 and triangles == 2 * (n - 1) ** 2
    assert len(tiles(stage)) == ((n - 1) // side) ** 2
    for tile in tiles(stage):
        assert tile.HasAPI(UsdPhysics.CollisionAPI) and not tile.HasAPI(UsdPhysics.RigidBodyAPI)
        assert UsdPhysics.MeshCollisionAPI(tile).GetApproximationAttr().Get() == 'none'


def test_rocks_are_what_mujoco_collides_with(stage: Usd.Stage, moon: World) -> None:
    model = build_model(moon, RoverDescription(), PhysicsConfig())
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geoms = [g for g in range(model.ngeom) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH]
    rocks = stage.GetPrimAtPath('/World/rocks').GetChildren()
    owner = moon.rocks.in_pieces(moon.rock_shapes)[2]
    assert len(rocks) == len(moon.rocks) > 10 and len(owner) == len(geoms)
    by_key = np.argsort(moon.rocks.key[owner], kind='stable')       # as MuJoCo has them
    first = np.searchsorted(owner, owner)
    for geom, piece in zip(geoms[:40], by_key.tolist()):
        rock = rocks[owner[piece]]
        assert rock.IsInstance()
        hulls = [p for p in Usd.PrimRange(rock, Usd.TraverseInstanceProxies())
                 if p.IsA(UsdGeom.Mesh)]
        hull = hulls[piece - first[piece]]
        assert UsdPhysics.MeshCollisionAPI(hull).GetApproximationAttr().Get() == 'convexHull'
        mesh = model.geom_dataid[geom]
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        truth = (model.mesh_vert[start:start + count] @ data.geom_xmat[geom].reshape(3, 3).T
                 + data.geom_xpos[geom])
        # MuJoCo keeps vertices in single precision, in axes of its own.
        points = placed(hull)
        apart = np.linalg.norm(points[:, None] - truth[None], axis=-1)
        assert apart.min(axis=1).max() < 2e-6


def test_coarse_resolutions_are_samples_of_the_fine_one(world_file: Path, moon: World) -> None:
    stage = Usd.Stage.Open(str(world_file))
    variants = stage.GetPrimAtPath('/World/ground').GetVariantSet('resolution')
    assert variants.GetVariantSelection() == 'full'
    counts = {}
    for name in variants.GetVariantNames():
        variants.SetVariantSelection(name)
        points = np.concatenate([placed(tile) for tile in tiles(stage)])
        counts[name] = len(points)
        assert np.abs(moon.ground.height_at(np.clip(points[:, :2], -6.4, 6.4)) - points[:, 2]
                      ).max() < 1e-5
        assert np.abs(points[:, :2]).max() == pytest.approx(moon.ground.half_extent_m)
    assert counts['full'] > 15 * counts['quarter'] > 15 * counts['sixteenth']


def test_nothing_heavy_without_payloads(world_file: Path) -> None:
    stage = Usd.Stage.Open(str(world_file), Usd.Stage.LoadNone)
    assert not any(p.IsA(UsdGeom.Mesh) for p in stage.Traverse())
    stage.Load('/World/ground/tile_00_00')
    assert sum(p.IsA(UsdGeom.Mesh) for p in stage.Traverse()) == 1


def test_surroundings_leave_the_inner_levels_out(stage: Usd.Stage, moon: World) -> None:
    for k, (inner, grid) in enumerate(zip(moon.levels[:-1], moon.levels[1:]), 1):
        mesh = stage.GetPrimAtPath(f'/World/surroundings/level_{k}')
        points = placed(mesh)
        away = np.abs(points[:, :2]).max(axis=1)
        outside = away > inner.half_extent_m - 1e-3
        assert np.abs(grid.height_at(np.clip(points[outside, :2], -grid.half_extent_m,
                                             grid.half_extent_m)) - points[outside, 2]
                      ).max() < 1e-4
        # One row of cells reaches below the finer level.
        below = grid.height_at(points[~outside, :2]) - points[~outside, 2]
        assert below.min() > 0.0
        assert away.min() > inner.half_extent_m - 3.0 * (points[1, 0] - points[0, 0])
        assert not mesh.HasAPI(UsdPhysics.CollisionAPI)
    rocks = UsdGeom.PointInstancer(stage.GetPrimAtPath('/World/surroundings/rocks'))
    assert len(rocks.GetPositionsAttr().Get()) == len(far_rocks(moon, 300.0))


def test_sun(moon: World, tmp_path: Path) -> None:
    path = write_world(moon, tmp_path / 'w.usd', StageSettings(SunConfig(200.0, 3.0)),
                       surroundings=False)
    stage = Usd.Stage.Open(str(path))
    light = UsdLux.DistantLight.Get(stage, '/World/sun')
    assert light.GetAngleAttr().Get() == pytest.approx(0.533)
    assert light.GetNormalizeAttr().Get()
    assert light.GetIntensityAttr().Get() == pytest.approx(98.0 * 1361.0)
    matrix = UsdGeom.XformCache().GetLocalToWorldTransform(light.GetPrim())
    shines = matrix.TransformDir(Gf.Vec3d(0, 0, -1))
    assert np.allclose(shines, -sun_direction(200.0, 3.0), atol=1e-12)


def test_albedo_texture_lies_where_the_albedo_is(stage: Usd.Stage, world_file: Path,
                                                 moon: World) -> None:
    material, _ = UsdShade.MaterialBindingAPI(tiles(stage)[0]).ComputeBoundMaterial()
    image = UsdShade.Shader(stage.GetPrimAtPath(material.GetPath().AppendChild('albedo')))
    file = world_file.parent / image.GetInput('file').Get().path
    texels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)[::-1] / 255.0 * TEXTURE_SCALE
    n = moon.ground.n
    for tile in tiles(stage):
        points = placed(tile)
        at = np.array(UsdGeom.PrimvarsAPI(tile).GetPrimvar('st').Get()) * n - 0.5
        column, row = np.rint(at).astype(int).T
        assert np.abs(at - np.stack([column, row], axis=-1)).max() < 1e-3
        assert np.allclose((column - (n - 1) / 2) * moon.ground.cell_m, points[:, 0], atol=1e-6)
        assert np.abs(texels[row, column] - moon.albedo[row, column]).max() < 0.6 / 255 * 2
    scale = image.GetInput('scale').Get()[0]
    fit = fit_shading(SETS['highland'], 6.0)
    assert scale == pytest.approx(TEXTURE_SCALE * fit.preview_albedo)


def test_relief_is_a_normal_map(stage: Usd.Stage, world_file: Path, moon: World) -> None:
    """A texel holds the normal of our relief there; copies are as far apart as ours."""
    shader = UsdShade.Shader(stage.GetPrimAtPath('/World/looks/regolith_0/relief'))
    file = world_file.parent / shader.GetInput('file').Get().path
    normal = cv2.imread(str(file))[::-1, :, ::-1] / 127.5 - 1.0
    (period, coarse), (_, fine) = relief_heights(DetailConfig(), moon.config.seed)
    n = len(coarse)
    slope = -normal[..., :2] / normal[..., 2:]
    dz_dx = (np.roll(coarse, -1, 1) - np.roll(coarse, 1, 1)) * n / (2.0 * period)
    dz_dy = (np.roll(coarse, -1, 0) - np.roll(coarse, 1, 0)) * n / (2.0 * period)
    for found, own in ((slope[..., 0], dz_dx), (slope[..., 1], dz_dy)):
        # The rest is the fine tile, which is as steep.
        assert np.corrcoef(found.ravel(), own.ravel())[0, 1] > 0.6
        assert found.std() > own.std()
    repeat = UsdShade.Shader(stage.GetPrimAtPath('/World/looks/regolith_0/relief_st'))
    side = moon.ground.n * moon.ground.cell_m
    assert repeat.GetInput('scale').Get()[0] == pytest.approx(side / period)
    assert len(fine) == n


def test_labels(stage: Usd.Stage) -> None:
    def labels(path: str, taxonomy: str = 'class') -> list[str]:
        return list(UsdSemantics.LabelsAPI(stage.GetPrimAtPath(path), taxonomy)
                    .GetLabelsAttr().Get())
    assert labels('/World/ground/tile_00_00') == ['ground']
    assert labels('/World/rocks/rock_3') == ['rock']
    assert labels('/World/rocks/rock_3', 'instance') == ['rock_3']


def test_twins_for_omniverse(world_file: Path) -> None:
    """With the layer of twins on top, each material has one; without it nothing refers to it."""
    assert 'OmniPBR' not in world_file.read_text()
    twins = world_file.with_name('moon_parts') / 'omniverse.usda'
    stage = Usd.Stage.Open(str(world_file))
    stage.GetSessionLayer().subLayerPaths.append(str(twins))
    looks = [p for p in stage.GetPrimAtPath('/World/looks').GetChildren()
             if not p.HasAPI(UsdPhysics.MaterialAPI)]
    for look in looks:
        output = UsdShade.Material(look).GetSurfaceOutput('mdl')
        twin = UsdShade.Shader(output.GetConnectedSources()[0][0].source)
        assert twin.GetSourceAsset('mdl').path == 'OmniPBR.mdl'
        texture = twin.GetInput('diffuse_texture')
        if texture:
            assert Path(texture.Get().resolvedPath).is_file()


@pytest.mark.parametrize('suffix', ['.usda', '.usdz'])
def test_validators(suffix: str, moon: World, world_file: Path, tmp_path: Path) -> None:
    path = world_file
    if suffix == '.usdz':
        path = write_world(moon, tmp_path / f'w{suffix}')
        assert [file.name for file in tmp_path.iterdir()] == ['w.usdz']
    stage = Usd.Stage.Open(str(path))
    assert problems(stage) == []
    assert len(tiles(stage)) > 1
