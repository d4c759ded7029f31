"""What a bag says of its run: where its world is found, by everything that asks for it."""

from pathlib import Path
import shutil

import numpy as np
import pytest
import synthetic_bag as synthetic
import worlds

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base.errors import BagError, ConfigError, WorldError
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.world_folder import save_world
from lunar_rover_sim.run.recorded_run import RecordedRun


@pytest.fixture(scope='module')
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('world') / 'small'
    save_world(build_world(WorldConfig.from_mapping(worlds.SMALL), 1), folder)
    return folder


@pytest.fixture
def bag(tmp_path: Path, world: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give a bag on that world, which is nowhere near."""
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))
    from lunar_rover_sim.ground.world.world_folder import load_world
    items = [item for item in synthetic.drive(0.1) if 'image' not in item.topic]
    for item in items:
        if item.topic == 'world_hash':
            item.message.data = load_world(world).hash
    return synthetic.write(tmp_path / 'run' / 'bag', items)


@pytest.mark.parametrize('place', ['run/world', 'cache/worlds/a', None])
def test_its_world_is_found_by_pictures_and_exports_alike(tmp_path: Path, bag: Path, world: Path,
                                                          place: str | None) -> None:
    """Beside the bag and in the cache; the recording is on rigid ground, which is said then."""
    if place is not None:
        shutil.copytree(world, tmp_path / place)
    with open_bag(bag) as opened:
        run = RecordedRun(opened)
        found = run.world()
        if place is None:
            assert found is None
            with pytest.raises(WorldError, match='its world is not found; give the folder'):
                run.ground()
        else:
            assert found is not None and run.world_folder() == tmp_path / place
            with pytest.raises(BagError, match='recorded where ground.model is regolith'):
                run.ground()
        assert run.world(world) is not None


def test_frames_and_rover_of_a_bag_without_them(tmp_path: Path) -> None:
    items = [i for i in synthetic.drive(0.1) if i.topic in ('odom', 'scenario')]
    with open_bag(synthetic.write(tmp_path / 'bag', items)) as bag:
        run = RecordedRun(bag)
        assert run.rover is None and np.array_equal(run.frame('base'), np.eye(4))
        with pytest.raises(BagError, match='neither tf_static nor a scenario'):
            run.frame('left')
        with pytest.raises(ConfigError, match="frame: 'lef' is not valid; did you mean left"):
            run.frame('lef')
        with pytest.raises(BagError, match='the rover of the drive is not known'):
            assert run.nodes
