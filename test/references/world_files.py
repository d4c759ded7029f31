"""World: measured terrain, meshes, maps, relief below the grid."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from references.cases import reference
from references.figures import drawn
from references.scenes import hills, small_world, stony_world, waves
from references.world import parts
import trimesh

from lunar_rover_sim.world import export, fine_relief, map_sheet, mesh, shade, tile
from lunar_rover_sim.world.build import build_world
from lunar_rover_sim.world.config import SurroundingsConfig, WorldConfig
from lunar_rover_sim.world.craters import Craters
from lunar_rover_sim.world.dem import dem_site, open_dem
from lunar_rover_sim.world.grid import HeightGrid
from lunar_rover_sim.world.mesh import MeshSource
from lunar_rover_sim.world.model import World
from lunar_rover_sim.world.tile import Tile


def _config(path: Path, source: str, **parameters: Any) -> WorldConfig:
    return WorldConfig.from_mapping({
        'source': source, 'path': str(path), 'seed': 3, 'size_m': 6.4, 'cell_m': 0.05,
        'surroundings': {'samples': 65, 'extent_m': 30.0}, **parameters})


def _measured_heights() -> np.ndarray:
    return 1234.0 + 4.0 * hills(47, 0.5, 0.3, 0.05).heights_m[:41].astype(float)


def _tiles(source: Any) -> dict[str, Any]:
    found: dict[str, Any] = {'area': source.area_m, 'pixel': source.pixel_m,
                             'reference': source.reference_m}
    for half, cell in ((2.9, 0.05), (7.0, 0.4), (11.0, 2.3), (40.0, 3.2), (90.0, 25.0)):
        found[f'{half} {cell}'] = source.tile(half, cell)
    return found


@reference
def folders_of_heights(folder: Path) -> dict[str, Any]:
    """A folder of dem.npy: north up and south up, off its middle, with gaps."""
    found = {}
    for name, sign, centre, mode, gap in (
            ('north', -1.0, [1.3, -0.8], 'offset', False),
            ('south', 1.0, [1.3, -0.8], 'offset', True),
            ('pixel', -1.0, [20.5, 17.25], 'pixel', True)):
        place = folder / name
        place.mkdir()
        heights = _measured_heights()
        if gap:
            heights[18:22, 21:26] = np.nan
            heights[3, 4] = 3e9
        np.save(place / 'dem.npy', heights)
        (place / 'dem.yaml').write_text(f'pixel_size: [0.5, {sign * 0.6}]\n'
                                        'center_coordinates: [11.0, -80.0]\n')
        config = _config(place, 'dem', dem={'center': centre, 'center_mode': mode,
                                            'nodata': 'fill' if gap else 'refuse',
                                            'height_scale': 1.5})
        source = open_dem(config)
        report = {key: value for key, value in source.report.items() if key != 'file'}
        found[name] = {**_tiles(source), 'report': report,
                       'world': parts(build_world(config)), 'alone': build_world(
                           dataclasses.replace(config, surroundings=SurroundingsConfig(
                               extent_m=0.0))).ground.heights_m,
                       'site': dem_site(config) is None}
    return found


@reference
def maps_of_heights(folder: Path) -> dict[str, Any]:
    """A GeoTIFF of the south pole: places, directions, scales, bands."""
    found = {}
    for name, unit, step, offset, mode, centre in (
            ('metres', 'm', 0.5, 0.0, 'offset', (0.7, 1.1)),
            ('kilometres', 'km', 0.0005, -2.0, 'crs', (150.0035, -40.007)),
            ('lonlat', 'm', 0.5, 3.0, 'lonlat', (104.9321, -84.88362))):
        path = folder / f'{name}.tif'
        scale = 1.0 if unit == 'm' else 0.001
        transform = rasterio.Affine(step, 0.0, 150000.0 * scale - 12.0 * step, 0.0, -step,
                                    -40000.0 * scale + 11.0 * step)
        if mode == 'lonlat':
            transform = rasterio.Affine(step, 0.0, 149988.0, 0.0, -step, -39989.0)
        heights = np.stack([_measured_heights() - 1200.0, _measured_heights()[::-1]])
        with rasterio.open(path, 'w', driver='GTiff', width=47, height=41, count=2,
                           dtype='float32', transform=transform, nodata=-99.0,
                           crs=f'+proj=stere +lat_0=-90 +R=1737400 +units={unit}') as file:
            heights[0, 2, 3] = -99.0
            file.write(heights.astype(np.float32))
            file.offsets, file.scales = (0.0, offset), (1.0, 2.0)
        band = 1 if name == 'metres' else 2
        source = open_dem(config := _config(path, 'dem', dem={
            'center': list(centre), 'center_mode': mode, 'band': band}))
        report = {key: value for key, value in source.report.items() if key not in ('file', 'crs')}
        lon, lat = report['lon_deg'], report['lat_deg']
        found[name] = {**_tiles(source), 'report': report,
                       'beside': dem_site(config, (lon + 0.00005, lat)),
                       'pixel': [source.column0, source.row0]}
        source.close()
    return found


@reference
def meshes(folder: Path) -> dict[str, Any]:
    """Meshes with each axis up, with holes and overhangs; rays that meet edges."""
    found: dict[str, Any] = {}
    vertices, faces = export.surface(hills(23, 0.7, 0.4, 0.1))
    turns = {'z': [0, 1, 2], 'x': [2, 0, 1], 'y': [0, 2, 1]}
    for up, order in turns.items():
        points = vertices[:, order]
        if up == 'y':
            points = points * [1.0, 1.0, -1.0]
        path = folder / f'{up}.ply'
        kept = faces[np.arange(len(faces)) % 61 != 7]
        trimesh.Trimesh(points, kept if up == 'x' else faces[:, ::-1 if up == 'z' else 1],
                        process=False).export(path)
        config = _config(path, 'mesh', mesh={
            'up_axis': up, 'holes': 'fill', 'scale': 1.1, 'center': [0.6, -0.4],
            'resolution_m': 0.0 if up == 'y' else 0.3})
        source = MeshSource(config)
        report = {key: value for key, value in source.report.items() if key != 'file'}
        found[up] = {**_tiles(source), 'report': report}
        if up == 'x':
            found['world'] = parts(build_world(config))
    axis = np.linspace(-3.0, 3.0, 31)
    roof = np.concatenate([vertices[faces], vertices[faces[:40]] + [0.0, 0.0, 2.0]])
    found['cast'] = mesh.cast(roof, axis, 0.7 * axis[:20])
    found['without layers'] = mesh.cast(roof, axis, 0.7 * axis[:20], False)
    return found


@reference
def tiles() -> dict[str, Any]:
    """Measured heights laid into a level: on all of it, on a part, and what is kept of them."""
    found: dict[str, Any] = {}
    for name, x0, y0, nx, ny, keep in (
            ('part', -1.1, -2.3, 9, 14, 0.5), ('all', -9.0, -8.0, 40, 38, 2.0),
            ('edge', 0.7, -5.0, 30, 12, 0.9), ('thin', 1.0, 1.0, 12, 1, 0.2),
            ('far', 20.0, 20.0, 5, 5, 0.2), ('tight', -0.6, -0.7, 6, 5, 0.6)):
        pixel = 0.5
        x, y = x0 + pixel * np.arange(nx), y0 + pixel * np.arange(ny)
        known = Tile((2.0 + 0.3 * np.sin(x) + 0.2 * np.cos(1.7 * y[:, None])).astype(np.float32),
                     x, y, pixel)
        heights = hills(83, 0.1, 0.2, 0.1).heights_m.copy()
        tile.lay(heights, 0.1, known, keep)
        found[f'laid {name}'] = heights.copy()
        heights += hills(83, 0.1, 0.1).heights_m
        tile.restore(heights, 0.1, known, keep, 2)
        found[f'restored {name}'] = heights
    rng = np.random.default_rng(1)
    many = Craters(rng.uniform(-40.0, 40.0, (200, 2)), rng.uniform(0.1, 9.0, 200), rng.random(200),
                   np.zeros(200, np.int32))
    source = dataclasses.make_dataclass('Source', ['pixel_m', 'area_m'])(
        0.5, (-11.0, 7.0, -3.0, 14.0))
    found['below'] = tile.below_its_scale(many, source)
    return found


@reference
def relief_below_the_grid() -> dict[str, Any]:
    """Tiles of millimetre relief: heights, slopes, horizons, mip levels."""
    found: dict[str, Any] = {}
    recipe = fine_relief.TileRecipe(96, 0.4, 0.3, 0.05, 0.7, 0.2, (0.02, 0.09), 0.15, (0.01, 0.05))
    for name, cover in (('all', {}), ('no pits', {'pit_cover': 0.0}),
                        ('no pebbles', {'pebble_cover': 0.0})):
        height = fine_relief.relief(dataclasses.replace(recipe, **cover), np.random.default_rng(6))
        found[name] = height
    texel = recipe.period_m / recipe.n
    height = fine_relief.relief(recipe, np.random.default_rng(6))
    slope = fine_relief.slopes(height, texel)
    found['slopes'] = slope
    tangents = np.linspace(-0.2, 1.1, 14)
    for azimuth in (0.0, 0.6, 1.57079632, 2.2, 3.5, 4.4, 5.9):
        tangent = fine_relief.horizon(height, texel, azimuth, tangents)
        found[f'horizon {azimuth}'] = tangent
    found['salience'] = fine_relief.salience(slope, tangent)
    for centre in (0.03, 0.1, 0.6):
        made = fine_relief.mip_levels(slope, tangent, 3.0, centre, 0.5)
        found[f'mips {centre}'] = {
            'codes': [code.astype(np.float32) for code in made.codes],
            'variance': made.slope_variance, 'spread': made.spread}
    large = np.tile(tangent, (3, 3))
    found['large'] = fine_relief.mip_levels(np.tile(slope, (3, 3, 1)), large, 3.0, 0.1, 0.4).spread
    found['share'] = fine_relief.disc_share(np.linspace(-1.3, 1.3, 21))
    return found


@reference
def shading() -> dict[str, Any]:
    """Light, shadows, slopes and horizons of maps."""
    world = stony_world()
    ground = world.ground
    found: dict[str, Any] = {'rocks': shade.with_rocks(world),
                             'rocks 3': shade.with_rocks(world, 3),
                             'slope': shade.slope_deg(ground.heights_m, ground.cell_m),
                             'rms': [shade.rms_slope_deg(ground, b) for b in (0.01, 0.12, 0.9)]}
    for azimuth, elevation in ((20.0, 4.0), (117.0, 11.0), (251.0, 1.0), (300.0, 50.0)):
        found[f'light {azimuth}'] = shade.shaded(found['rocks'], 0.05, azimuth, elevation)
        found[f'shadow {azimuth}'] = float(shade.shadow(ground.heights_m, 0.05, azimuth,
                                                        elevation).mean())
    azimuths = np.linspace(-180.0, 170.0, 13)
    found['horizon'] = shade.horizon_deg(world, azimuths)
    found['higher'] = shade.horizon_deg(world, 33.0, 2.0)
    return found


@reference
def map_sheets() -> dict[str, Any]:
    """What the sheet of a world shows."""
    flat = WorldConfig.from_mapping({'size_m': 1.6, 'seed': 1, 'surroundings': {'samples': 65},
                                     'relief': {'rms_slope_deg': 0.0, 'far_rms_slope_deg': 0.0},
                                     'craters': {'density': 0.0}, 'rocks': {'abundance': 0.0}})
    views = [('eight', (200.0 * waves((9, 12))).astype(np.uint8)),
             ('sixteen', (9000.0 * waves((9, 12))).astype(np.uint16))]
    return {'stony': drawn(map_sheet.sheet(small_world(2), 77.0, 9.0, views)),
            'flat': drawn(map_sheet.sheet(build_world(flat), 190.0, 3.0))}


@reference
def exported_worlds(folder: Path) -> dict[str, Any]:
    """Meshes of a world for other tools."""
    world = stony_world((hills(49, 0.1), hills(33, 0.8, 0.4)), 6)
    fine = export.FinePart(np.linspace(-0.9, 0.4, 14), np.linspace(0.3, 1.2, 10),
                           0.1 + 0.01 * np.arange(140.0).reshape(10, 14))
    wide = World((HeightGrid(np.zeros((514, 514), np.float32), 0.1),),
                 np.ones((514, 514), np.float32), world.rocks, (), WorldConfig(), '')
    found: dict[str, Any] = {'stride': len(export.to_scene(wide, rocks=False).geometry[
        'ground'].vertices)}
    for name, scene in (('all', export.to_scene(world, 2, True, True, fine)),
                        ('plain', export.to_scene(world, rocks=False))):
        found[name] = {key: {'vertices': np.asarray(one.vertices), 'faces': np.asarray(one.faces),
                             'grey': np.asarray(one.visual.vertex_colors)}
                       for key, one in scene.geometry.items()}
        found[f'{name} nodes'] = {node: np.asarray(scene.graph[node][0])
                                  for node in scene.graph.nodes_geometry if 'rock' in node}
    for suffix in export.FORMATS:
        path = export.write(world, folder / f'world{suffix}', 4, False, True)
        loaded: Any = trimesh.load(path, process=False)
        whole = loaded.to_mesh() if hasattr(loaded, 'to_mesh') else loaded
        found[suffix] = np.sort(np.asarray(whole.vertices), axis=0).astype(np.float32)
    return found
