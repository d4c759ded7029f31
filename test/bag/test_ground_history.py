"""The ground at any time of a bag, exactly; what is lost is named; meshes and heights of it."""

import numpy as np
import pytest
import synthetic_bag as synthetic
from synthetic_ground import ground_items
import trimesh

from lunar_rover_sim.bag.ground_points import changes_of, ground_at, POINT, points_of
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, WorldError
from lunar_rover_sim.ground.regolith.overlay import CELL_M, GroundChanges, Overlay
from lunar_rover_sim.ground.regolith.patch import changed_patch, save_patch
from lunar_rover_sim.ground.world.export import write as write_mesh
from lunar_rover_sim.ground.world.grid import HeightGrid


@pytest.fixture
def walk(tmp_path):
    """Return a bag of 1 s, and the samples of the ground at each of its frames."""
    overlay, snapshots = Overlay(), {}

    def seen(ns):
        snapshots[ns] = overlay.snapshot()
    items = synthetic.drive(1.0) + ground_items(1.0, overlay, seen)
    return synthetic.write(tmp_path / 'bag', items), snapshots, items


def test_the_ground_at_any_time_is_that_of_the_drive_bit_by_bit(walk):
    path, snapshots, _ = walk
    with open_bag(path) as bag:
        for ns, expected in snapshots.items():
            found = ground_at(bag, ns + 50_000_000).snapshot()
            for name in ('index', 'height_m', 'compaction_m'):
                np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
        assert len(ground_at(bag, 50_000_000).snapshot()) == 0
        with pytest.raises(BagError, match=r'3\.000 s is not valid.*up to 1\.000 s'):
            ground_at(bag, 3 * 10**9)


def test_a_lost_change_is_named(walk, tmp_path):
    _, _, items = walk
    changes = [i for i in items if i.topic == 'ground/changes']
    items = [i for i in items if i is not changes[3]]
    with open_bag(synthetic.write(tmp_path / 'less', items)) as bag:
        with pytest.raises(BagError, match=r'between 0\.300 s and 0\.500 s'):
            ground_at(bag)
    with open_bag(synthetic.write(tmp_path / 'rigid', synthetic.drive(0.2))) as bag:
        with pytest.raises(BagError, match='rigid'):
            ground_at(bag)


def test_mesh_and_heights_have_the_prints(walk, tmp_path):
    path, _, _ = walk
    ground = HeightGrid(np.zeros((81, 81), np.float32), 0.025)
    with open_bag(path) as bag:
        overlay = ground_at(bag)
    patch = changed_patch(ground, overlay)
    save_patch(patch, tmp_path / 'heights.npz')
    saved = np.load(tmp_path / 'heights.npz')
    x, y = np.meshgrid(saved['x_m'], saved['y_m'])
    np.testing.assert_allclose(saved['height_m'], overlay.height_change(np.stack([x, y], -1)),
                               atol=1e-6)
    assert saved['height_m'].min() < -0.01
    with pytest.raises(WorldError, match='untouched'):
        changed_patch(ground, Overlay())
    from physics_scene import make_world
    write_mesh(make_world(np.zeros((81, 81))), tmp_path / 'tracks.glb', fine=patch)
    mesh = trimesh.load(tmp_path / 'tracks.glb').to_mesh()
    # glTF: y is up. No face of the untouched ground is left over a print.
    corners = mesh.vertices[mesh.faces]
    middle, lowest = corners.mean(axis=1), corners[:, :, 1].min(axis=1)
    over = np.hypot(middle[:, 0] - 0.0, -middle[:, 2] - 0.03) < 0.004
    assert over.sum() >= 3
    assert (lowest[over] < -0.008).all()


def test_changes_beyond_the_ground_are_refused(walk):
    """Of another world, or of a damaged message: float32 of 1e9 m is a multiple of 5 mm, too."""
    path, _, _ = walk
    with open_bag(path) as bag:
        with pytest.raises(BagError, match=r'x = -0.085 m is beyond the ground, which ends at'
                           r' 0.04 m$'):
            ground_at(bag, half_extent_m=0.04)
        message = next(bag.messages([topics.GROUND_CHANGES.name]))[2]
    points = np.frombuffer(bytes(message.data), POINT).copy()
    points['y'][0] = 1e9
    message.data = np.frombuffer(points.tobytes(), np.uint8)
    with pytest.raises(BagError, match=r'y = 1e\+09 m is beyond the ground, .* 65000 m$'):
        changes_of(message)


@pytest.mark.parametrize('middle_m', [0.0, 1234.5, -1_024.005, 8_191.99, -64_990.0])
def test_samples_kilometres_away_are_found_exactly(middle_m):
    """Each of 200,000 neighbours, in both axes; what lies between them is refused."""
    k = np.arange(-100_000 if abs(middle_m) < 6e4 else -1000, 1000) + round(middle_m / CELL_M)
    index = np.stack([k, k[::-1]], axis=-1).astype(np.int32)
    heights = np.linspace(-0.01, 0.01, len(k), dtype=np.float32)
    points = points_of(GroundChanges(index, heights, np.abs(heights)),
                       HeightGrid(np.zeros((81, 81), np.float32), 0.025))
    assert np.isfinite(points['z']).all()
    message = synthetic.cloud(topics.GROUND_CHANGES, 10**8, 'odom', points).message
    found = changes_of(message)
    np.testing.assert_array_equal(found.index, index)
    np.testing.assert_array_equal(found.height_m, heights)
    points['x'][7] += 0.0024
    message.data = np.frombuffer(points.tobytes(), np.uint8)
    if abs(middle_m) < 1e4:
        with pytest.raises(BagError, match='x is not a multiple of 5 mm'):
            changes_of(message)
