"""What of the ground is drawn: chunks by view, and rows by what their pixels need."""

import dataclasses

import camera_scene as scene
import numpy as np

from lunar_rover_sim.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.rendering.chunk_tree import ChunkTree, level_ranges
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.ground_pass import GroundRows
from lunar_rover_sim.rendering.projection import Projection

K = np.array([[100.0, 0.0, 79.5], [0.0, 100.0, 59.5], [0.0, 0.0, 1.0]])
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def rows_of(values: np.ndarray) -> set[tuple[float, ...]]:
    """Return the rows of an array."""
    return set(map(tuple, values.tolist()))


def test_a_view_within_a_wider_one() -> None:
    """What a view takes of all that is around it are the chunks it would choose by itself.

    It has no other skirts than those: chunks next to it are known, so that it may have fewer.
    """
    world = scene.plane(n=513, heights=scene.hills(n=513))
    tree = ChunkTree(world.ground, 0.0)
    ranges_m = level_ranges([tree], DetailConfig())[0]
    projection = Projection(K, 160, 120, 0.01, 1000.0)
    for yaw_rad in (0.3, 2.0, 4.1):
        turn = matrix_from_wxyz(wxyz_from_rpy(0.0, 0.3, yaw_rad)) @ OPTICAL
        view = projection.view_volume([se3(turn, np.array([0.4, -0.3, 0.5]))], world)
        around = tree.select(dataclasses.replace(view, planes=np.zeros((0, 4))), ranges_m)
        alone, taken = tree.select(view, ranges_m), around.within(view)
        assert np.array_equal(taken.chunks, alone.chunks)
        assert np.array_equal(taken.boxes, alone.boxes)
        assert 0 < len(taken.chunks) < 0.5 * len(around.chunks)
        assert 0 < len(taken.skirts) and rows_of(taken.skirts) <= rows_of(alone.skirts)
        # Each skirt belongs to its chunk.
        own = taken.chunks[taken.rims]
        assert np.array_equal(own[:, :2], taken.skirts[:, :2])
        assert np.array_equal(own[:, 2], np.floor(taken.skirts[:, 2]))


def test_chunks_tile_the_ground_outside_the_finer_grid() -> None:
    """Each cell is drawn once, by a mesh as fine as its distance asks for."""
    world = scene.plane(n=513, heights=scene.hills(n=513))
    cell_m, inner_m = world.ground.cell_m, 64 * world.ground.cell_m
    tree = ChunkTree(world.ground, inner_m)
    ranges_m = level_ranges([tree], DetailConfig())[0]
    view = dataclasses.replace(Projection(K, 160, 120, 0.01, 1000.0).view_volume(
        [se3(OPTICAL, np.array([0.4, -0.3, 0.5]))], world), planes=np.zeros((0, 4)))
    chosen = tree.select(view, ranges_m)
    times = np.zeros((512, 512), int)
    for column, row, stride, limit_m in chosen.chunks:
        cells = int(8 * stride)
        times[int(row):int(row) + cells, int(column):int(column) + cells] += 1
        assert limit_m in (ranges_m[int(np.log2(stride))], 1e9)
    inside = np.abs((np.arange(512) + 0.5) * cell_m - 256 * cell_m) < inner_m
    assert np.array_equal(times, np.where(inside[:, None] & inside, 0, 1))
    # No chunk is coarser than the nearest of its points may be drawn.
    centre, near = view.centre_m[:2], np.concatenate([[0.0], ranges_m])
    away = np.maximum(np.abs(chosen.boxes.mean(axis=1)[:, :2] - centre)
                      - 0.5 * np.ptp(chosen.boxes, axis=1)[:, :2], 0.0)
    finest = near[np.log2(chosen.chunks[:, 2]).astype(int)]
    assert np.all((away**2).sum(axis=1) >= finest**2 - view.above_m**2)
    assert np.all(np.diff((away**2).sum(axis=1)) >= -1e-9)      # nearest first


def test_rows_by_what_they_need() -> None:
    """Spans cover the ground's rows once, each with all that any of its rows needs."""
    rows = GroundRows(first=10, middle=60, last=100, tracks=(70, 120), shaded=(90, 95))

    def parts(*needs: str) -> list[tuple[int, int, list[str]]]:
        return [(top, bottom, [name for name, has in found.items() if has])
                for top, bottom, found in rows.parts(*needs)]
    assert parts('refined', 'shaded', 'tracks') == [
        (10, 60, ['refined']), (60, 70, []), (70, 90, ['tracks']), (90, 95, ['shaded', 'tracks']),
        (95, 100, ['tracks'])]
    assert parts('refined', 'tracks') == [
        (10, 60, ['refined']), (60, 70, []), (70, 100, ['tracks'])]
    assert GroundRows().parts('refined') == []
