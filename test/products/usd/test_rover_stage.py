"""The rover as a stage: masses, joints, shapes, cameras."""

import dataclasses
import math
from pathlib import Path

import mujoco
import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics
import pytest
from stages import problems

from lunar_rover_sim.base.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.products.usd.rover_stage import add_camera, CameraModel, write_rover
from lunar_rover_sim.products.usd.stage import new_stage
from lunar_rover_sim.rover.description import ImuMount, Legs, Motor, RoverDescription
from lunar_rover_sim.rover.mjcf import rover_spec
from lunar_rover_sim.rover.mounts import imu_pose

ROVER = dataclasses.replace(RoverDescription(), imu=ImuMount((0.02, -0.01, 0.03),
                                                             (10.0, -20.0, 30.0)))
CAMERA = CameraConfig(width=752, height=480, horizontal_fov_deg=81.0)


@pytest.fixture(scope='module')
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rover(ROVER, tmp_path_factory.mktemp('rover') / 'rover.usda', camera=CAMERA)


@pytest.fixture(scope='module')
def stage(file: Path) -> Usd.Stage:
    return Usd.Stage.Open(str(file))


@pytest.fixture(scope='module')
def model() -> mujoco.MjModel:
    return rover_spec(ROVER).compile()


def pose(prim: Usd.Prim) -> np.ndarray:
    """Return the (4, 4) pose of a prim, of column vectors."""
    return np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim)).T


def test_masses_and_inertias_are_mujocos(stage: Usd.Stage, model: mujoco.MjModel) -> None:
    total = 0.0
    for name in ('base_link', *Legs().names):
        prim = stage.GetPrimAtPath(f'/Rover/{name}')
        mass = UsdPhysics.MassAPI(prim)
        body = model.body(name)
        total += mass.GetMassAttr().Get()
        assert mass.GetMassAttr().Get() == pytest.approx(body.mass[0])
        assert np.allclose(mass.GetCenterOfMassAttr().Get(), body.ipos)
        axes = mass.GetPrincipalAxesAttr().Get()
        turn = matrix_from_wxyz([axes.GetReal(), *axes.GetImaginary()])
        inertia = turn @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ turn.T
        theirs = matrix_from_wxyz(body.iquat)
        assert np.allclose(inertia, theirs @ np.diag(body.inertia) @ theirs.T, rtol=1e-5,
                           atol=1e-9)
        assert np.allclose(pose(prim)[:3, 3], body.pos)
    assert total == pytest.approx(ROVER.total_mass_kg)


def test_joints_and_drives(stage: Usd.Stage, model: mujoco.MjModel) -> None:
    motor = Motor()
    for leg in Legs().names:
        joint = UsdPhysics.RevoluteJoint.Get(stage, f'/Rover/joints/{leg}_joint')
        axis = {'X': 0, 'Y': 1, 'Z': 2}[joint.GetAxisAttr().Get()]
        assert np.array_equal(np.eye(3)[axis], model.joint(f'{leg}_joint').axis)
        assert joint.GetBody0Rel().GetTargets() == [Sdf.Path('/Rover/base_link')]
        assert joint.GetBody1Rel().GetTargets() == [Sdf.Path(f'/Rover/{leg}')]
        # Both bodies see the joint at the same place.
        for body, local in ((joint.GetBody0Rel(), joint.GetLocalPos0Attr()),
                            (joint.GetBody1Rel(), joint.GetLocalPos1Attr())):
            T = pose(stage.GetPrimAtPath(body.GetTargets()[0]))
            assert np.allclose((T @ [*local.Get(), 1.0])[:3], model.body(leg).pos, atol=1e-7)
        assert not math.isfinite(joint.GetUpperLimitAttr().Get())
        drive = UsdPhysics.DriveAPI(joint.GetPrim(), 'angular')
        # A degree per second of error gives pi / 180 of the gain per radian.
        assert drive.GetDampingAttr().Get() == pytest.approx(math.pi / 180 * 1.0)
        assert drive.GetStiffnessAttr().Get() == 0.0
        assert drive.GetMaxForceAttr().Get() == pytest.approx(motor.leg_stall_torque_nm)
        armature = joint.GetPrim().GetAttribute('physxJoint:armature').Get()
        assert armature == pytest.approx(1.2e-7 * 84.0 ** 2)


def test_collision_shapes_are_mujocos(stage: Usd.Stage, model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found = {}
    for prim in stage.Traverse():
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            link, name = prim.GetPath().GetPrefixes()[1].name, prim.GetName()
            found[name if link == 'base_link' else f'{link}_{name}'] = prim
    assert len(found) == model.ngeom == 26
    for name, prim in found.items():
        geom = model.geom(name)
        T = pose(prim)
        assert np.allclose(T[:3, 3], data.geom(name).xpos, atol=1e-7)
        size = geom.size
        if prim.IsA(UsdGeom.Sphere):
            assert UsdGeom.Sphere(prim).GetRadiusAttr().Get() == pytest.approx(size[0])
        elif prim.IsA(UsdGeom.Capsule):
            capsule = UsdGeom.Capsule(prim)
            assert capsule.GetRadiusAttr().Get() == pytest.approx(size[0])
            assert capsule.GetHeightAttr().Get() == pytest.approx(2.0 * size[1])
            along = data.geom(name).xmat.reshape(3, 3)[:, 2]
            assert abs(along @ T[:3, 2]) == pytest.approx(1.0)
        else:
            assert np.allclose(np.linalg.norm(T[:3, :3], axis=0), 2.0 * size)
        assert UsdGeom.Imageable(prim).GetPurposeAttr().Get() == 'guide'


def test_physics_is_parsed(stage: Usd.Stage) -> None:
    """OpenUSD's own parser finds one articulation, five bodies, four revolute joints."""
    parsed = UsdPhysics.UsdPhysicsLoadStageFromPrimRange(stage, ['/'])
    count = {kind: len(paths) for kind, (paths, _) in parsed.items()}
    assert count[UsdPhysics.ObjectType.Articulation] == 1
    assert count[UsdPhysics.ObjectType.RigidBody] == 5
    assert count[UsdPhysics.ObjectType.RevoluteJoint] == 4
    assert count[UsdPhysics.ObjectType.CapsuleShape] == 13


def projected(camera: UsdGeom.Camera, points: np.ndarray, width: int, height: int) -> np.ndarray:
    """Project world points with nothing but what OpenUSD says; pixels as OpenCV counts them."""
    frustum = camera.GetCamera(Usd.TimeCode.Default()).frustum
    matrix = np.array(frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix())
    clip = np.column_stack([points, np.ones(len(points))]) @ matrix
    ndc = clip[:, :2] / clip[:, 3:]
    ndc[clip[:, 3] <= 0.0] = np.nan
    return np.stack([(0.5 + 0.5 * ndc[:, 0]) * width - 0.5,
                     (0.5 - 0.5 * ndc[:, 1]) * height - 0.5], axis=-1)


def test_cameras_project_as_ours(file: Path) -> None:
    """13,000 points agree to 0.01 px in both cameras of a rover that stands anywhere."""
    stage = Usd.Stage.Open(str(file))
    stage.SetEditTarget(stage.GetSessionLayer())
    T = se3(matrix_from_wxyz(wxyz_from_rpy(0.1, -0.2, 2.5)), [12.3, -4.5, 0.6])
    base = UsdGeom.Xformable(stage.GetPrimAtPath('/Rover/base_link'))
    base.MakeMatrixXform().Set(Gf.Matrix4d(T.T.tolist()))
    rig = StereoRig(ROVER, CAMERA)
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.3, 50.0, 13000)
    rays = np.stack([rng.uniform(-0.8, 0.8, 13000), rng.uniform(-0.5, 0.5, 13000),
                     np.ones(13000)], axis=-1)
    T_world_left = T @ rig.T_base_left
    points = (rays * depth[:, None]) @ T_world_left[:3, :3].T + T_world_left[:3, 3]
    for name, truth in zip(('left_camera', 'right_camera'), rig.project(points, T)):
        camera = UsdGeom.Camera.Get(stage, f'/Rover/base_link/{name}')
        assert np.abs(projected(camera, points, 752, 480) - truth).max() < 0.01
        near, far = camera.GetClippingRangeAttr().Get()
        assert (near, far) == (pytest.approx(CAMERA.near_m), pytest.approx(CAMERA.far_m))
        assert camera.GetFStopAttr().Get() == 0.0


def test_camera_of_a_calibration(tmp_path: Path) -> None:
    """The principal point lies off the middle, pixels are not square, the lens distorts."""
    K = np.array([[430.0, 0.0, 301.5], [0.0, 445.0, 260.25], [0.0, 0.0, 1.0]])
    stage, top = new_stage(tmp_path / 'c.usda', 'Test')
    model = CameraModel(640, 480, K, (-0.1, 0.02, 1e-3, -2e-3, 0.0), 0.05, 900.0, 5e-6)
    camera = add_camera(stage, Sdf.Path('/Test/c'), model, np.eye(4))
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-1, 1, (500, 2)), rng.uniform(1, 3, 500)])
    homogeneous = points @ K.T
    assert np.abs(projected(camera, points, 640, 480)
                  - homogeneous[:, :2] / homogeneous[:, 2:]).max() < 0.001
    # The aperture is that of the sensor: tenths of a metre.
    assert camera.GetHorizontalApertureAttr().Get() == pytest.approx(640 * 5e-6 * 10)
    lens = 'omni:lensdistortion:opencvPinhole:'
    attribute = camera.GetPrim().GetAttribute
    assert attribute(lens + 'k1').Get() == pytest.approx(-0.1)
    assert attribute(lens + 'cx').Get() == pytest.approx(302.0)
    assert 'OmniLensDistortionOpenCvPinholeAPI' in str(
        camera.GetPrim().GetMetadata('apiSchemas'))


def test_imu_frame(stage: Usd.Stage) -> None:
    assert np.allclose(pose(stage.GetPrimAtPath('/Rover/base_link/imu_link')), imu_pose(ROVER))


def test_validators(stage: Usd.Stage) -> None:
    assert problems(stage) == []
