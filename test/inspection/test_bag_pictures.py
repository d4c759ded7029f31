"""`bag preview`, its figure of heading and power, and the other commands on bags."""

import shutil

import cv2
import pytest
import synthetic_bag as synthetic
import worlds

from lunar_rover_sim.bag import marker
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.errors import BagError, WorldError
from lunar_rover_sim.inspection.bag_pictures import preview
from lunar_rover_sim.world.world_folder import load_world, save_world

STEREO = [f'stereo_{k}.png' for k in range(4)]


@pytest.fixture(scope='module')
def world(tmp_path_factory):
    return save_world(worlds.small(), tmp_path_factory.mktemp('world') / 'small')


@pytest.fixture(scope='module')
def items(world):
    items = synthetic.drive(0.6)
    next(i for i in items if i.topic == 'world_hash').message.data = load_world(world).hash
    return items


@pytest.fixture(scope='module')
def bag(items, tmp_path_factory):
    return synthetic.write(tmp_path_factory.mktemp('bag') / 'bag', items)


@pytest.fixture(scope='module')
def driven(items, tmp_path_factory):
    """Return the bag without images."""
    return synthetic.write(tmp_path_factory.mktemp('driven') / 'bag',
                           [i for i in items if 'image' not in i.topic])


def test_pictures_are_written_and_named(tmp_path, bag, driven, world, monkeypatch):
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))
    paths = preview(bag, tmp_path / 'out', world)
    names = [*STEREO, 'trajectory.png', 'attitude.png', 'imu.png']
    assert [p.name for p in paths] == names
    for path in paths:
        assert cv2.imread(str(path)).std() > 5.0
    bare = preview(driven, tmp_path / 'bare')
    assert not (cv2.imread(str(bare[0])) == cv2.imread(str(paths[4]))).all()
    shutil.copytree(world, tmp_path / 'cache' / 'worlds' / 'any_name')
    cached = preview(driven, tmp_path / 'cached')
    assert (cv2.imread(str(cached[0])) == cv2.imread(str(paths[4]))).all()


def test_what_is_missing_is_left_out(tmp_path, items, driven):
    assert [p.name for p in preview(driven, tmp_path / 'out')] == [
        'trajectory.png', 'attitude.png', 'imu.png']
    empty = synthetic.write(tmp_path / 'empty', [i for i in items if i.topic == 'sun'])
    with pytest.raises(BagError, match='nothing to preview'):
        preview(empty, tmp_path / 'none')
    assert not (tmp_path / 'none').exists()


def test_a_folder_that_cannot_be_made_is_named(tmp_path, bag):
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match='stereo_0.png: cannot be written: Not a directory'):
        preview(bag, tmp_path / 'file' / 'out')


def test_another_world_is_refused(tmp_path, items, world):
    other = [i for i in items if i.topic != 'world_hash' and 'stereo' not in i.topic]
    other.append(synthetic.Item('world_hash', 'std_msgs/msg/String',
                                synthetic.msg('std_msgs/String', data='0' * 32)))
    path = synthetic.write(tmp_path / 'bag', other)
    with pytest.raises(WorldError, match='is not that of the world of .*bag, 000000000000'):
        preview(path, tmp_path / 'out', world)


def test_the_commands(tmp_path, bag, capsys):
    assert main(['bag', 'info', str(bag)]) == 0
    assert '/stereo/disparity' in capsys.readouterr().out
    assert main(['bag', 'hash', '--topics', str(bag)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines[-1]) == 64 and any(line.endswith('  /odom') for line in lines)
    assert main(['bag', 'check', str(bag)]) == 0
    assert 'passed' in capsys.readouterr().out
    marker.mark(bag, 'the power went')
    try:
        assert main(['bag', 'check', str(bag)]) == 1
        assert 'the power went' in capsys.readouterr().out
        assert main(['bag', 'recover', str(bag)]) == 0
        assert 'INCOMPLETE: the power went' in (main(['bag', 'info', str(bag)]),
                                                capsys.readouterr().out)[1]
    finally:
        marker.unmark(bag)
    assert main(['bag', 'recover', str(bag)]) == 1
    assert 'nothing to recover' in capsys.readouterr().err
    assert main(['bag', 'info', str(tmp_path / 'missing')]) == 1
    assert capsys.readouterr().err.count('\n') == 1
    assert main(['bag', 'export', str(bag), '-o', str(tmp_path / 'seq'), '--format', 'tum']) == 0
    assert '6 image sets' in capsys.readouterr().out
