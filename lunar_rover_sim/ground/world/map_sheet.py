"""A sheet of maps and statistics of a world, as a PNG."""

from __future__ import annotations

from collections.abc import Sequence
import pathlib
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.files.results import save_figure
from lunar_rover_sim.ground.world import rockfield, shade
from lunar_rover_sim.ground.world.craters import density_per_m2
from lunar_rover_sim.ground.world.model import World

_MAX_PIXELS = 1025  # along a side of a map
_LARGE_M = 0.15      # rocks from this size are marked

Views = Sequence[tuple[str, NDArray[Any]]]


def sheet(world: World, azimuth_deg: float = 60.0, elevation_deg: float = 6.0,
          views: Views = ()) -> Any:
    """Return a matplotlib figure: shaded ground, heights, slope, albedo and rocks, surroundings,
    horizon, and the size distributions of craters and rocks; below them up to four views.

    The sun is at azimuth (from east towards north) and elevation [deg]. views: titles and (h, w)
    images.
    """
    rows = 3 if views else 2
    figure = Figure(figsize=(20, 5.2 * rows - 0.9 * (rows == 3)), constrained_layout=True)
    axes = figure.subplots(rows, 4)
    for axis, (title, image) in zip(axes[2] if views else (), views):
        axis.imshow(image, cmap='gray', vmin=0, vmax=np.iinfo(image.dtype).max)
        axis.set_title(title)
    for axis in axes[2] if views else ():
        axis.set_axis_off()
    sun = f'sun at {elevation_deg:g}°, azimuth {azimuth_deg:g}°'
    _ground(figure, axes[0], world, azimuth_deg, elevation_deg, sun)
    _surroundings(figure, axes[1, 0], world, azimuth_deg, elevation_deg)
    _horizon(axes[1, 1], world, azimuth_deg, elevation_deg)
    _crater_sizes(axes[1, 2], world)
    _rock_sizes(axes[1, 3], world)
    figure.suptitle(f'{world.config.source} world, seed {world.config.seed}, '
                    f'{len(world.rocks)} rocks, hash {world.hash[:12]}')
    return figure


def write(world: World, path: str | pathlib.Path, azimuth_deg: float = 60.0,
          elevation_deg: float = 6.0, views: Views = ()) -> None:
    """Write the sheet to a PNG file; raise WorldError if it cannot be written."""
    save_figure(sheet(world, azimuth_deg, elevation_deg, views), path, WorldError, dpi=90)


def _stride(n: int) -> int:
    return max(-(-n // _MAX_PIXELS), 1)


def _map(figure: Any, axis: Any, values: Any, half_m: float, title: str, label: str = '',
         **options: Any) -> None:
    image = axis.imshow(values, origin='lower', extent=(-half_m, half_m, -half_m, half_m),
                        **options)
    axis.set_title(title)
    axis.set_xlabel('x, east [m]')
    axis.set_ylabel('y, north [m]')
    if label:
        figure.colorbar(image, ax=axis, label=label, shrink=0.8)


def _ground(figure: Any, axes: Any, world: World, azimuth_deg: float, elevation_deg: float,
            sun: str) -> None:
    ground = world.ground
    stride, half = _stride(ground.n), ground.half_extent_m
    cell = ground.cell_m * stride
    heights = ground.heights_m[::stride, ::stride]
    light = shade.shaded(shade.with_rocks(world, stride), cell, azimuth_deg, elevation_deg)
    light = light * world.albedo[::stride, ::stride]
    _map(figure, axes[0], light ** 0.6, half, f'ground, {sun}', cmap='gray', vmin=0.0, vmax=1.0)
    _map(figure, axes[1], heights, half, 'height', 'm', cmap='viridis')
    if np.ptp(heights) > 0.0:
        line = np.linspace(-half, half, heights.shape[0])
        axes[1].contour(line, line, heights, levels=16, colors='k', linewidths=0.3)
    _map(figure, axes[2], shade.slope_deg(ground.heights_m, ground.cell_m)[::stride, ::stride],
         half, f'slope over {ground.cell_m:g} m', 'deg', cmap='inferno', vmin=0.0, vmax=35.0)
    _map(figure, axes[3], world.albedo[::stride, ::stride], half, 'albedo factor', '1',
         cmap='gray', vmin=0.8, vmax=1.2)
    large = world.rocks.diameter_m >= _LARGE_M
    if large.any():
        axes[3].set_title(f'albedo factor; rocks of {_LARGE_M:g} m and more')
        axes[3].scatter(*world.rocks.position_m[large, :2].T, c='tab:red', linewidths=0,
                        s=60.0 * world.rocks.diameter_m[large])


def _surroundings(figure: Any, axis: Any, world: World, azimuth_deg: float,
                  elevation_deg: float) -> None:
    last = world.levels[-1]
    stride = _stride(last.n)
    light = shade.shaded(last.heights_m[::stride, ::stride], last.cell_m * stride, azimuth_deg,
                         elevation_deg)
    _map(figure, axis, light ** 0.6, last.half_extent_m, 'surroundings', cmap='gray', vmin=0.0,
         vmax=1.0)
    for level in world.levels[:-1]:
        h = level.half_extent_m
        axis.plot([-h, h, h, -h, -h], [-h, -h, h, h, -h], 'c-', linewidth=0.6)


def _horizon(axis: Any, world: World, azimuth_deg: float, elevation_deg: float) -> None:
    azimuth = np.linspace(-180.0, 180.0, 721)
    line = shade.horizon_deg(world, azimuth)
    axis.fill_between(azimuth, line, min(line.min(), 0.0) - 1.0, color='0.4')
    axis.plot([(azimuth_deg + 180.0) % 360.0 - 180.0], [elevation_deg], 'o', color='orange',
              label='sun')
    axis.set_title('horizon seen from 0.3 m above the origin')
    axis.set_xlabel('azimuth from east towards north [deg]')
    axis.set_ylabel('elevation [deg]')
    axis.set_xlim(-180.0, 180.0)
    axis.legend()


def _crater_sizes(axis: Any, world: World) -> None:
    axis.set_title('craters: number above diameter')
    axis.set_xlabel('diameter [m]')
    axis.set_ylabel('number per m²')
    config, catalogue = world.config.craters, world.craters
    if not len(catalogue):
        axis.text(0.5, 0.5, 'none', transform=axis.transAxes, ha='center')
        return
    for index, level in enumerate(world.levels):
        inside = np.abs(catalogue.position_m).max(axis=1) <= level.half_extent_m
        if index:  # smaller ones are there on finer levels only
            inside &= catalogue.diameter_m >= 8.0 * level.cell_m
        diameter = np.sort(catalogue.diameter_m[inside])[::-1]
        area = (2.0 * level.half_extent_m) ** 2
        axis.loglog(diameter, np.arange(1, len(diameter) + 1) / area, '-',
                    label=f'within {2 * level.half_extent_m:.4g} m')
    ends = np.geomspace(config.min_diameter_m, config.max_diameter_m, 2)
    axis.loglog(ends, [density_per_m2(config, d) for d in ends], 'k--', lw=0.8,
                label=f'{config.density:g} of saturation')
    axis.legend()
    axis.grid(True, which='both', alpha=0.2)


def _rock_sizes(axis: Any, world: World) -> None:
    axis.set_title('rocks: number above diameter')
    axis.set_xlabel('diameter [m]')
    axis.set_ylabel('number per m²')
    if not len(world.rocks):
        axis.text(0.5, 0.5, 'none', transform=axis.transAxes, ha='center')
        return
    diameter = np.sort(world.rocks.diameter_m)[::-1]
    area = (2.0 * world.ground.half_extent_m) ** 2
    axis.loglog(diameter, np.arange(1, len(diameter) + 1) / area, '.-', label='this world')
    config = world.config.rocks
    line = np.geomspace(config.min_diameter_m, config.max_diameter_m, 200)[:-1]
    axis.loglog(line, rockfield.number_per_m2(config, line), 'k--', lw=0.8,
                label=f'k = {config.abundance:g}, q = {rockfield.decay_per_m(config):.3g} / m')
    axis.set_ylim(bottom=0.3 / area)
    axis.legend()
    axis.grid(True, which='both', alpha=0.2)
