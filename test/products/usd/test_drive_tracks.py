"""Tracks of a drive as a stage: the recorded ground at each frame, and no gap around it."""

from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom
import pytest
from stages import problems
import synthetic_bag as synthetic
from synthetic_ground import ground_items

from lunar_rover_sim.bag.ground_points import ground_at
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.world_folder import save_world
from lunar_rover_sim.products.usd.drive_stage import write_drive
from lunar_rover_sim.products.usd.drive_tracks import can_hold_tracks
from lunar_rover_sim.run.scenario import Scenario

GROUND = '/Drive/World/ground'


@pytest.fixture(scope='module')
def drive(moon: World, world_file: Path, tmp_path_factory: pytest.TempPathFactory
          ) -> tuple[Path, Path]:
    """Return a bag of 1 s on ground that gives, and its stage."""
    folder = tmp_path_factory.mktemp('tracks')
    said = {topics.WORLD_HASH.name: moon.hash,
            topics.SCENARIO.name: Scenario.load('flat').to_yaml()}
    items = [item for item in synthetic.drive(1.0) if item.topic != topics.GROUND_CHANGES.name]
    for item in items:
        if item.topic in said:
            item.message = synthetic.msg('std_msgs/String', data=said[item.topic])
    bag = synthetic.write(folder / 'bag', [*items, *ground_items(1.0)])
    save_world(moon, folder / 'moon')
    return bag, write_drive(bag, folder / 'drive.usda', world=folder / 'moon',
                            world_stage=world_file)


def surface(stage: Usd.Stage, code: float) -> dict[tuple[float, float], float]:
    """Return x, y [mm] → height [m] of the vertices of all patches at a time code."""
    found: dict[tuple[float, float], float] = {}
    for prim in stage.GetPrimAtPath(f'{GROUND}/tracks').GetChildren():
        at = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim)).T
        local = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(code), float)
        for x, y, z in local @ at[:3, :3].T + at[:3, 3]:
            key = round(1e3 * x), round(1e3 * y)
            assert found.setdefault(key, z) == pytest.approx(z, abs=1e-6)     # no gap between two
    return found


@pytest.mark.parametrize('frame', [0, 3, 10])
def test_the_surface_is_the_recorded_one(drive: tuple[Path, Path], moon: World,
                                         frame: int) -> None:
    """At each frame: the untouched ground plus the overlay of that time."""
    bag, file = drive
    found = surface(Usd.Stage.Open(str(file)), 20.0 * frame)
    xy = np.array(list(found)) / 1e3
    wanted = moon.ground.height_at(xy)
    if frame:
        with open_bag(bag) as opened:
            wanted = wanted + ground_at(opened, frame * 10**8).height_change(xy)
    assert np.allclose(list(found.values()), wanted, atol=1e-6)
    assert frame == 0 or np.ptp(np.array(list(found.values())) - moon.ground.height_at(xy)) > 5e-3


def test_it_takes_the_place_of_the_cells_below(drive: tuple[Path, Path], moon: World) -> None:
    """Every cell of the ground is drawn once: coarse, or as a patch."""
    stage = Usd.Stage.Open(str(drive[1]))
    area = patches = 0.0
    for prim in Usd.PrimRange(stage.GetPrimAtPath(GROUND)):
        if prim.IsA(UsdGeom.Mesh):
            mesh = UsdGeom.Mesh(prim)
            xy = np.array(mesh.GetPointsAttr().Get(0.0), float)[:, :2]
            a, b, c = (xy[np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)[:, k]]
                       for k in range(3))
            (ux, uy), (vx, vy) = (b - a).T, (c - a).T
            size = 0.5 * np.abs(ux * vy - uy * vx).sum()
            area += size
            patches += size if 'patch' in prim.GetName() else 0.0
    assert 0.01 < patches < 0.2
    assert area == pytest.approx((2.0 * moon.ground.half_extent_m)**2, rel=1e-5)


def test_variants(drive: tuple[Path, Path]) -> None:
    """A simulation starts on untouched ground; coarse ground has no tracks; all is valid."""
    stage = Usd.Stage.Open(str(drive[1]))
    assert not problems(stage)
    ground = stage.GetPrimAtPath(GROUND)
    whole = {tile.GetName(): len(UsdGeom.Mesh(tile).GetFaceVertexCountsAttr().Get())
             for tile in ground.GetChildren() if tile.GetName().startswith('tile')}
    ground.GetVariantSet('resolution').SetVariantSelection('quarter')
    assert not stage.GetPrimAtPath(f'{GROUND}/tracks') and not problems(stage)
    ground.GetVariantSet('resolution').SetVariantSelection('full')
    stage.GetPrimAtPath('/Drive').GetVariantSet('motion').SetVariantSelection('simulated')
    assert not stage.GetPrimAtPath(f'{GROUND}/tracks')
    tiles = {tile.GetName(): len(UsdGeom.Mesh(tile).GetFaceVertexCountsAttr().Get())
             for tile in stage.GetPrimAtPath(GROUND).GetChildren()}
    assert sum(tiles.values()) > sum(whole.values())


def test_without_the_world_there_are_no_tracks(drive: tuple[Path, Path], world_file: Path,
                                               tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                               caplog: pytest.LogCaptureFixture) -> None:
    """A warning says so; the drive is written."""
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))    # without worlds
    file = write_drive(drive[0], tmp_path / 'drive.usda', world_stage=world_file)
    assert 'its tracks are left out' in caplog.text
    assert not Usd.Stage.Open(str(file)).GetPrimAtPath(f'{GROUND}/tracks')


def test_a_ground_that_cannot_hold_tracks_is_told(drive: tuple[Path, Path], world_file: Path,
                                                  tmp_path: Path,
                                                  monkeypatch: pytest.MonkeyPatch,
                                                  caplog: pytest.LogCaptureFixture) -> None:
    """The samples of the tracks have to lie on those of the ground."""
    heights = np.zeros((5, 5))
    assert can_hold_tracks(HeightGrid(heights, 0.025))
    assert not can_hold_tracks(HeightGrid(heights, 0.012))
    monkeypatch.setattr('lunar_rover_sim.products.usd.drive_stage.can_hold_tracks',
                        lambda grid: False)
    write_drive(drive[0], tmp_path / 'drive.usda', world=drive[0].parent / 'moon',
                world_stage=world_file)
    assert 'are no multiple of the 0.005 m of tracks' in caplog.text
