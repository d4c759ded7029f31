"""A drive as a stage: poses, cameras and signals as recorded, one stage with world and rover."""

from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics
import pytest
from stages import problems
import synthetic_bag as synthetic

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.series import read_odometry
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, UsdError, WorldError
from lunar_rover_sim.base.frames import matrix_from_wxyz, se3
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.world_folder import save_world
from lunar_rover_sim.products.usd.drive_stage import write_drive
from lunar_rover_sim.products.usd.drive_tracks import continuous
from lunar_rover_sim.rover.description import Legs
from lunar_rover_sim.rover.mounts import optical_poses
from lunar_rover_sim.rover.visual import link_poses
from lunar_rover_sim.run.scenario import Scenario

SCENARIO = Scenario.load('flat')


def items(moon: World, *without: topics.Topic, duration_s: float = 0.1) -> list[synthetic.Item]:
    """Return a drive on a world, without some topics."""
    said = {topics.WORLD_HASH.name: moon.hash, topics.SCENARIO.name: SCENARIO.to_yaml()}
    result = []
    for item in synthetic.drive(duration_s):
        if item.topic in said:
            item.message = synthetic.msg('std_msgs/String', data=said[item.topic])
        if item.topic not in [topic.name for topic in without]:
            result.append(item)
    return result


@pytest.fixture(scope='module')
def bag(moon: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic.write(tmp_path_factory.mktemp('drive') / 'bag',
                           items(moon, duration_s=1.0))


@pytest.fixture(scope='module')
def file(bag: Path, world_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(bag, tmp_path_factory.mktemp('drive') / 'drive.usda',
                       world_stage=world_file)


@pytest.fixture(scope='module')
def stage(file: Path) -> Usd.Stage:
    return Usd.Stage.Open(str(file))


def pose(stage: Usd.Stage, path: str, code: float) -> np.ndarray:
    """Return the (4, 4) pose of a prim in the world."""
    return np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(
        stage.GetPrimAtPath(path))).T


def test_poses_are_those_of_odom(stage: Usd.Stage, bag: Path) -> None:
    with open_bag(bag) as opened:
        odometry = read_odometry(opened)
    left, right = optical_poses(SCENARIO.rover)
    assert stage.GetTimeCodesPerSecond() == 200.0 and stage.GetFramesPerSecond() == 10.0
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1.0, 200.0)
    for k in range(0, 200, 7):
        stamp = odometry.stamps_ns[k]
        code = stamp * 200 / 1e9
        truth = se3(matrix_from_wxyz(odometry.orientations_wxyz[k]), odometry.positions_m[k])
        assert np.abs(pose(stage, '/Drive/Rover/base_link', code) - truth).max() < 1e-6
        legs = link_poses(SCENARIO.rover, np.full(4, 2.0 * stamp * 1e-9))
        for leg in Legs().names:
            assert np.abs(pose(stage, f'/Drive/Rover/{leg}', code) - truth @ legs[leg]
                          ).max() < 1e-6
        for name, optical in (('left_camera', left), ('right_camera', right)):
            # The camera of UsdGeom looks along -z, y up.
            theirs = pose(stage, f'/Drive/Rover/base_link/{name}', code) \
                @ np.diag([1.0, -1.0, -1.0, 1.0])
            assert np.abs(theirs - truth @ optical).max() < 1e-6


def test_signals(stage: Usd.Stage) -> None:
    leg = stage.GetPrimAtPath('/Drive/Rover/rear_left')
    assert leg.GetAttribute('lunar_rover_sim:angle_rad').Get(100) == pytest.approx(1.0)
    assert leg.GetAttribute('lunar_rover_sim:velocity_radps').Get(100) == pytest.approx(2.0)
    assert leg.GetAttribute('lunar_rover_sim:torque_nm').Get(100) == pytest.approx(0.1)
    assert leg.GetAttribute('lunar_rover_sim:contact_force_n').Get(100)[2] == pytest.approx(0.9)
    base = stage.GetPrimAtPath('/Drive/Rover/base_link')
    velocity = np.array(base.GetAttribute('physics:velocity').Get(100))
    assert np.allclose(velocity, synthetic.velocity_at(0.5), atol=1e-4)
    imu = stage.GetPrimAtPath('/Drive/Rover/base_link/imu_link')
    assert imu.GetAttribute('lunar_rover_sim:specific_force_mps2').GetNumTimeSamples() == 200
    camera = stage.GetPrimAtPath('/Drive/Rover/base_link/left_camera')
    stamps = camera.GetAttribute('lunar_rover_sim:stamp_ns')
    assert [stamps.Get(t) for t in stamps.GetTimeSamples()] == [
        k * 100_000_000 for k in range(1, 11)]


def test_variants(file: Path) -> None:
    """Recorded: samples, physics of the rover off. Simulated: the first pose, physics on."""
    stage = Usd.Stage.Open(str(file), Usd.Stage.LoadNone)
    top = stage.GetDefaultPrim()
    base = stage.GetPrimAtPath('/Drive/Rover/base_link')
    rover = stage.GetPrimAtPath('/Drive/Rover')
    parsed: dict[Any, Any] = UsdPhysics.UsdPhysicsLoadStageFromPrimRange(
        stage, ['/Drive/Rover'])
    assert UsdPhysics.ObjectType.RevoluteJoint not in parsed
    assert not UsdPhysics.RigidBodyAPI(base).GetRigidBodyEnabledAttr().Get()
    assert not rover.HasAPI(UsdPhysics.ArticulationRootAPI)
    first = pose(stage, '/Drive/Rover/base_link', 1.0)
    top.GetVariantSet('motion').SetVariantSelection('simulated')
    assert base.GetAttribute('xformOp:translate').GetNumTimeSamples() == 0
    assert np.allclose(pose(stage, '/Drive/Rover/base_link', 150.0), first)
    assert UsdPhysics.RigidBodyAPI(base).GetRigidBodyEnabledAttr().Get()
    assert rover.HasAPI(UsdPhysics.ArticulationRootAPI)
    joint = stage.GetPrimAtPath('/Drive/Rover/joints/rear_right_joint')
    target = joint.GetAttribute('drive:angular:physics:targetVelocity')
    assert target.Get(100) == pytest.approx(np.degrees(2.0))
    assert problems(stage) == []


def test_one_stage(stage: Usd.Stage, file: Path) -> None:
    assert problems(stage) == []
    assert stage.GetPrimAtPath('/Drive/World/ground/tile_00_00').IsA(UsdGeom.Mesh)
    assert sum(p.IsA(UsdPhysics.Scene) for p in stage.Traverse()) == 1
    size = sum(f.stat().st_size for f in file.with_name('drive_parts').rglob('*.*'))
    # 60 s are to take less than 60 MB.
    assert size < 1e6


def test_package_holds_all(bag: Path, moon: World, tmp_path: Path) -> None:
    """A .usdz with a world of its own, found by its folder."""
    folder = save_world(moon, tmp_path / 'moon')
    path = write_drive(bag, tmp_path / 'drive.usdz', world=folder)
    assert sorted(f.name for f in tmp_path.iterdir()) == ['drive.usdz', 'moon']
    moved = path.rename(tmp_path / 'other.usdz')
    stage = Usd.Stage.Open(str(moved))
    assert problems(stage) == []
    assert stage.GetPrimAtPath('/Drive/World/ground/tile_00_00').IsA(UsdGeom.Mesh)
    assert pose(stage, '/Drive/Rover/base_link', 100.0)[0, 3] > 0.05


def test_signs_of_quaternions_do_not_jump() -> None:
    turn = np.linspace(0.0, 4.0 * np.pi, 50)
    smooth = np.stack([np.cos(turn / 2), 0 * turn, 0 * turn, np.sin(turn / 2)], axis=-1)
    jumping = np.where(smooth[:, :1] < 0.0, -smooth, smooth)
    assert np.allclose(continuous(jumping), smooth)


@pytest.mark.parametrize('missing', [topics.ODOM, topics.JOINT_STATES, topics.SCENARIO])
def test_bag_without_a_drive(missing: topics.Topic, moon: World, world_file: Path,
                             tmp_path: Path) -> None:
    bag = synthetic.write(tmp_path / 'bag', items(moon, missing))
    with pytest.raises((BagError, UsdError), match=f'{missing.name} is missing|holds no scenario'):
        write_drive(bag, tmp_path / 'd.usd', world_stage=world_file)
    assert [f.name for f in tmp_path.iterdir()] == ['bag']


def test_world_of_the_drive(moon: World, bag: Path, tmp_path: Path,
                            monkeypatch: pytest.MonkeyPatch) -> None:
    """A world that is missing, another one, and a stage that is none of a world."""
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))
    with pytest.raises(UsdError, match='no folder holds the world'):
        write_drive(bag, tmp_path / 'd.usd')
    other = tmp_path / 'other.usda'
    Usd.Stage.CreateNew(str(other)).Save()
    for given in (other, tmp_path / 'nothing.usda'):
        with pytest.raises(UsdError, match='not a stage of a world'):
            write_drive(bag, tmp_path / 'd.usd', world_stage=given)
    with pytest.raises(WorldError, match='world'):
        write_drive(bag, tmp_path / 'd.usd', world=tmp_path / 'nowhere')
    assert sorted(f.name for f in tmp_path.iterdir()) == ['other.usda']
