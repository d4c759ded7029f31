"""Regolith: soils, forces, prints, slides."""

from __future__ import annotations

from typing import Any

import numpy as np
from references.cases import reference
from references.scenes import craters, hills, stony_world

from lunar_rover_sim.regolith import ball
from lunar_rover_sim.regolith.config import GroundConfig
from lunar_rover_sim.regolith.fine_ground import base_heights, FineGround
from lunar_rover_sim.regolith.footprint import hull, press
from lunar_rover_sim.regolith.looseness import soil_map
from lunar_rover_sim.regolith.overlay import Overlay, pieces
from lunar_rover_sim.regolith.patch import changed_patch
from lunar_rover_sim.regolith.repose import relax
from lunar_rover_sim.regolith.resistive_force import (GENERIC, plate_force_n, POPPY_CLOSE,
                                                      POPPY_LOOSE)
from lunar_rover_sim.regolith.soil import PRESETS
from lunar_rover_sim.regolith.spoke import SpokeInSoil
from lunar_rover_sim.world.grid import HeightGrid

_SHAPES = {'generic': GENERIC, 'loose': POPPY_LOOSE, 'close': POPPY_CLOSE}


@reference
def forces() -> dict[str, Any]:
    """Resistive forces of plates, bearing and silhouette of a ball."""
    beta, gamma = np.meshgrid(np.linspace(-3.1, 3.1, 23), np.linspace(-3.1, 3.1, 19))
    depths = np.linspace(-0.002, 0.03, 33).tolist()
    found: dict[str, Any] = {
        name: _over_depths(depths, name) for name in ('bearing_n', 'bearing_slope_npm')}
    found['area'] = np.array([ball.contact_area_m2(z, 0.0081) for z in depths])
    found['silhouette'] = np.array([ball.silhouette_m3(z, 0.0081) for z in depths])
    found['depth'] = np.array([ball.depth_m(f, 0.0081, 1.3e6) for f in np.linspace(-0.3, 6.0, 31)])
    for name, shape in _SHAPES.items():
        found[name] = {'alpha': list(shape.alpha(beta, gamma)), 'bearing': shape.bearing,
                       'side': shape.side_ratio,
                       'plate': plate_force_n(shape, 1.1e6, 2e-4, 0.03, 0.4, 0.7)}
    return found


def _over_depths(depths: list[float], name: str) -> np.ndarray:
    """Return a function of `ball` over depths."""
    return np.array([getattr(ball, name)(z, 0.0081, 1.3e6) for z in depths])


@reference
def digging() -> dict[str, Any]:
    """The lift on a dragged ball, and the slope of its way."""
    gamma = np.linspace(-1.5, 1.57, 14)
    table = ball.DigTable(GENERIC)
    loads, depths = np.linspace(-0.1, 1.2, 27), np.linspace(-0.2, 3.4, 19)
    return {'swept': np.array([ball.swept_bearing(shape, depth, gamma)
                               for shape in _SHAPES.values() for depth in (0.3, 1.2, 2.5)]),
            'slope': np.array([[table.slope(a, b) for a in loads] for b in depths])}


@reference
def soils() -> dict[str, Any]:
    """Soils under gravities, and with numbers of their own."""
    found: dict[str, Any] = {}
    for name, soil in PRESETS.items():
        former = [soil.former_depth_m(a, b) for a, b in (
            (-0.004, 0.001), (-0.001, 0.004), (0.0, 0.01), (0.002, 0.003), (-0.01, 0.0))]
        found[name] = {
            'earth': soil.under(9.81), 'former': former,
            'slope': [soil.bearing_on_slope(t) for t in (0.0, 0.2, 0.6, 0.95, 2.0)]}
    config = GroundConfig(model='regolith', bearing_mnpm3=0.7, friction=0.5, cohesion_kpa=0.9,
                          compacted=0.45, repose_deg=31.0, shear_mm=7.0, elastic_npm=1500.0,
                          damping_nspm=33.0, weak_slopes=False)
    own = config.soil(3.7)
    found['own'] = own
    found['cohesive'] = own.cohesive_bearing_pa
    found['names'] = [config.name, GroundConfig().name, GroundConfig(preset='mare').name]
    found['strong slope'] = own.bearing_on_slope(0.8)
    return found


@reference
def spokes() -> dict[str, Any]:
    """A spoke in soils with and without cohesion, tip and rod."""
    found: dict[str, Any] = {}
    config = GroundConfig(model='regolith', cohesion_kpa=1.3, friction=0.7)
    for name, soil in (('firm', PRESETS['highland']), ('cohesive', config.soil(1.62))):
        spoke = SpokeInSoil(soil, 0.0082, 0.0047)
        depths = np.linspace(-0.001, 0.04, 21).tolist()
        found[name] = {
            'bears': np.array([[spoke.bears_n(z, lean) for z in depths] for lean in (0.0, 0.7)]),
            'slope': np.array([[spoke.slope_npm(z, lean) for z in depths] for lean in (0.0, 0.7)]),
            'ploughs': np.array([[spoke.ploughs_n(z, r) for z in depths] for r in (0.3, 1.0)]),
            'yielded': np.array([spoke.yielded(z + 0.002, 0.6 * z, 2000.0, part, 0.4)
                                 for z in (0.0, 0.001, 0.004, 0.012, 0.03)
                                 for part in (0.2, 1.0)])}
    return found


def _contents(overlay: Overlay) -> dict[str, Any]:
    return {'all': overlay.snapshot(), 'sums': list(overlay.sums_m()),
            'bytes': overlay.memory_bytes, 'writes': overlay.writes,
            'tiles': [f'{x} {y}' for x, y in overlay.tiles_since(0)]}


@reference
def prints() -> dict[str, Any]:
    """A ball on its way through a slope, across tiles and on older prints; slides; copies."""
    fine = FineGround(hills(61, 0.05, 0.02, 0.12))
    overlay = Overlay()
    found: dict[str, Any] = {}
    ways = [((-0.21, 0.19, 0.0), (-0.16, 0.2, -0.02)),
            ((0.003, -0.002, 0.0), (0.003, -0.002, -0.01)),
            ((-0.17, 0.2, -0.015), (-0.19, 0.215, -0.025)), ((0.4, 0.41, 0.02), (0.42, 0.43, 0.3)),
            ((1.497, -0.3, 0.0), (1.503, -0.31, -0.02))]
    for k, (start, end) in enumerate(ways):
        below = [float(fine.heights(round(x / 0.005), round(y / 0.005), 1, 1)[0, 0])
                 for x, y in (start[:2], (min(end[0], 1.5), end[1]))]
        window = press(overlay, fine, (*start[:2], below[0] + 0.006 + start[2]),
                       (*end[:2], below[1] + 0.006 + end[2]), 0.0085, 0.3 + 0.1 * k)
        found[f'window {k}'] = str(window)
        found[f'residue {k}'] = abs(overlay.residue_m) < 1e-5
        if k == 1:
            found['changes'] = overlay.take_changes()
            early, writes = overlay.copy(), overlay.writes
    found['pressed'] = _contents(overlay)
    found['newer'] = [f'{x} {y}' for x, y in overlay.tiles_since(writes)]
    relax(overlay, fine, -52, 32, 26, 18, 24.0)
    found['relaxed'] = _contents(overlay)
    xy = np.random.default_rng(1).uniform(-0.25, 0.45, (80, 2))
    xy[:40] = [-0.2, 0.2] + 0.1 * (xy[:40] - 0.1)
    found['heights'], found['compaction'] = overlay.height_change(xy), overlay.compaction(xy)
    found['points'] = np.array([[*overlay.at(x, y), overlay.height_at_point(x, y)]
                                for x, y in xy.tolist()])
    overlay.take_changes()
    overlay.restore(early)
    found['restored'] = _contents(overlay)
    found['differs'] = overlay.take_changes()
    found['hull'] = str(hull((1, -2, 5, 6), (-3, 0, 7, 9)))
    found['pieces'] = [str(piece) for piece in pieces(-41, 38, 45, 5)]
    return found


@reference
def steep_walls() -> dict[str, Any]:
    """Heaps and holes that slide, on level ground and on slopes; calm soil stays."""
    found: dict[str, Any] = {}
    for name, steepness, repose, height in (
            ('level', 0.0, 33.0, 0.03), ('slope', 0.35, 38.0, -0.02), ('steep', 0.9, 36.0, 0.02),
            ('calm', 0.0, 50.0, 0.004)):
        fine, overlay = FineGround(hills(81, 0.01, 0.0, steepness)), Overlay()
        heap = np.zeros((11, 13))
        heap[3:8, 4:10] = height
        overlay.put(7, -6, heap, 0.1 * np.abs(heap))
        relax(overlay, fine, 6, -7, 15, 13, repose)
        found[name] = _contents(overlay)
    return found


@reference
def loose_places() -> dict[str, Any]:
    """Looseness by craters and slopes, and the factors on strength."""
    found = {}
    for variation in (0.6, 1.7):
        soil = soil_map(stony_world((hills(97, 0.07, 0.2, 0.1),)), variation)
        xy = np.random.default_rng(3).uniform(-3.6, 3.6, (40, 2)).tolist()
        found[f'{variation}'] = {'map': soil.looseness.heights_m, 'cell': soil.looseness.cell_m,
                                 'factors': np.array([soil.factors(x, y) for x, y in xy])}
    found['craters'] = len(craters())
    return found


@reference
def patches() -> dict[str, Any]:
    """The changed part of the ground, within and at the border."""
    found: dict[str, Any] = {}
    ground: HeightGrid = hills(41, 0.05, 0.03, 0.05)
    for name, x in (('within', -0.33), ('border', 0.97)):
        overlay = Overlay()
        press(overlay, FineGround(ground), (x, 0.11, 0.0), (x, 0.13, -0.05), 0.009, 0.5)
        found[name] = changed_patch(ground, overlay)
    found['base'] = base_heights(ground, -205, 30, 12, 9)
    return found
