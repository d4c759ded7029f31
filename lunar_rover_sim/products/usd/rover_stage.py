"""The rover as a stage: an articulation with drives, cameras and an IMU frame.

Below the default prim stand the links side by side, `base_link` and one per leg, in the pose with
all joint angles 0; `joints/<leg>_joint` turn the legs about +y of base_link. Each link has its
collision shapes below `collisions` (purpose guide) and its meshes below `visuals`. Collision
shapes are those of `rover.mjcf`.

A camera of UsdGeom looks along -z, y up. Its aperture and focal length are in tenths of the
stage's unit; only their ratios matter to a projection: fx = width focalLength /
horizontalAperture. Pixel coordinates follow OpenCV: the centre of the upper left pixel is (0, 0),
so the middle of the image is at ((width - 1) / 2, (height - 1) / 2).
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import math
from pathlib import Path

import numpy as np

from lunar_rover_sim.base.frames import Array, BASE_FRAME, IMU_FRAME, se3, wxyz_from_matrix
from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.products.usd.material import (add_contact_material, add_material, bind,
                                                   bind_contact, Look, TWINS, write_twins)
from lunar_rover_sim.products.usd.stage import (add_mesh, check_prim_name, Gf, label, new_stage,
                                                place, place_matrix, points, Sdf, set_foreign,
                                                single_quaternion, Usd, UsdGeom, UsdPhysics,
                                                UsdShade, write_stage)
from lunar_rover_sim.rover.description import chassis_inertia, leg_inertia, RoverDescription
from lunar_rover_sim.rover.mounts import imu_pose, MAST_RADIUS_M
from lunar_rover_sim.rover.visual import link_poses, visual_parts, VisualPart

JOINTS = 'joints'
_ROUGHNESS = 1.0
LEFT, RIGHT = 'left_camera', 'right_camera'
# From the axes of UsdGeom (y up, looking along -z) to optical ones (y down, along z).
_T_OPTICAL_USD = se3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
_TENTHS_PER_M = 10.0
_Types = Sdf.ValueTypeNames


def write_rover(rover: RoverDescription, path: str | Path, *,
                camera: CameraConfig = CameraConfig(), sensor: SensorConfig = SensorConfig(),
                friction: float = 0.8,
                name: str = 'Rover', overwrite: bool = False) -> Path:
    """Write the rover as a stage whose default prim is `/NAME`; return its path.

    Args:
        camera, sensor: Of its stereo cameras.
        friction: Of its contacts.

    Raises:
        UsdError: Where the name of file or prim is not valid or the file cannot be written.
    """
    check_prim_name(name)

    def compose(root: Path, parts: Path) -> None:
        compose_rover(rover, root, parts, camera, sensor, friction, name)

    return write_stage(Path(path), compose, overwrite)


def compose_rover(rover: RoverDescription, root: Path, parts: Path, camera: CameraConfig,
                  sensor: SensorConfig, friction: float, name: str = 'Rover') -> None:
    """Write the root layer of a rover, and the layer of its twin materials into `parts`."""
    stage, top = new_stage(root, name)
    path = top.GetPath()
    UsdPhysics.ArticulationRootAPI.Apply(top)
    top.AddAppliedSchema('PhysxArticulationAPI')
    set_foreign(top, 'physxArticulation:enabledSelfCollisions', _Types.Bool, False)
    label(top, 'rover')
    poses = link_poses(rover, np.zeros(len(rover.legs.each)))
    for link, T in poses.items():
        prim = UsdGeom.Xform.Define(stage, path.AppendChild(link)).GetPrim()
        place_matrix(prim, T)
        UsdPhysics.RigidBodyAPI.Apply(prim)
        UsdGeom.Xform.Define(stage, prim.GetPath().AppendChild('collisions'))
    base = stage.GetPrimAtPath(path.AppendChild(BASE_FRAME))
    _set_mass(base, rover.chassis.mass_kg, rover.chassis.com_m, chassis_inertia(rover.chassis))
    _add_chassis(stage, base.GetPath(), rover)
    for leg in rover.legs.names:
        prim = stage.GetPrimAtPath(path.AppendChild(leg))
        _set_mass(prim, rover.legs.mass_kg, (0.0, 0.0, 0.0), leg_inertia(rover.legs))
        _add_spokes(stage, prim.GetPath(), rover)
    _add_joints(stage, path, rover)
    looks = _add_visuals(stage, path, visual_parts(rover))
    write_twins(parts / TWINS, looks)
    bind_contact(top, add_contact_material(stage, path.AppendPath('looks/contact'), friction))
    group = UsdPhysics.CollisionGroup.Define(stage, path.AppendChild('collision_group'))
    group.GetCollidersCollectionAPI().CreateIncludesRel().AddTarget(path)
    group.CreateFilteredGroupsRel().AddTarget(group.GetPath())      # no link touches another one
    imu = UsdGeom.Xform.Define(stage, base.GetPath().AppendChild(IMU_FRAME)).GetPrim()
    place_matrix(imu, imu_pose(rover))
    for side, (model, T) in stereo_models(rover, camera, sensor.pixel_pitch_m).items():
        add_camera(stage, base.GetPath().AppendChild(side), model, T)
    stage.Save()


def _set_mass(prim: Usd.Prim, mass_kg: float, com_m: tuple[float, ...], inertia: Array) -> None:
    """Give a link its mass, centre of mass and inertia (about it, axes of the link)."""
    mass = UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr(mass_kg)
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*com_m))
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments.tolist()))
    mass.CreatePrincipalAxesAttr(single_quaternion(wxyz_from_matrix(axes)))


def _add_chassis(stage: Usd.Stage, link: Sdf.Path, rover: RoverDescription) -> None:
    chassis = rover.chassis
    body = UsdGeom.Cube.Define(stage, link.AppendPath('collisions/chassis'))
    body.CreateSizeAttr(1.0)
    body.CreateExtentAttr(points([[-0.5] * 3, [0.5] * 3]))
    UsdGeom.Xformable(body).AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(
        Gf.Vec3d(chassis.length_m, chassis.width_m, chassis.height_m))
    _set_collider(body.GetPrim())
    x, y, z = rover.stereo.position_m
    top = chassis.height_m / 2
    if z - top > 2.0 * MAST_RADIUS_M:
        _add_capsule(stage, link.AppendPath('collisions/mast'), np.array([x, y, top]),
                     np.array([x, y, z]), MAST_RADIUS_M)


def _add_spokes(stage: Usd.Stage, link: Sdf.Path, rover: RoverDescription) -> None:
    legs = rover.legs
    for k, direction in enumerate(np.array(legs.spoke_directions())):
        tip = (legs.spoke_length_m - legs.tip_radius_m) * direction
        ball = UsdGeom.Sphere.Define(stage, link.AppendPath(f'collisions/tip_{k}'))
        ball.CreateRadiusAttr(legs.tip_radius_m)
        ball.CreateExtentAttr(points([[-legs.tip_radius_m] * 3, [legs.tip_radius_m] * 3]))
        place(ball.GetPrim(), tip)
        _set_collider(ball.GetPrim())
        _add_capsule(stage, link.AppendPath(f'collisions/rod_{k}'), np.zeros(3), tip,
                     legs.spoke_radius_m)


def _add_capsule(stage: Usd.Stage, path: Sdf.Path, start_m: Array, end_m: Array,
                 radius_m: float) -> None:
    """Define a capsule between the middles of its round ends."""
    along = end_m - start_m
    length = float(np.linalg.norm(along))
    capsule = UsdGeom.Capsule.Define(stage, path)
    capsule.CreateAxisAttr(UsdGeom.Tokens.z)
    capsule.CreateHeightAttr(length)
    capsule.CreateRadiusAttr(radius_m)
    reach = [radius_m, radius_m, 0.5 * length + radius_m]
    capsule.CreateExtentAttr(points([[-r for r in reach], reach]))
    z = along / length
    y = np.array([0.0, 1.0, 0.0]) if abs(z[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    x = np.cross(y, z)
    x /= np.linalg.norm(x)
    place(capsule.GetPrim(), (start_m + end_m) / 2,
          wxyz_from_matrix(np.stack([x, np.cross(z, x), z], axis=-1)))
    _set_collider(capsule.GetPrim())


def _set_collider(prim: Usd.Prim) -> None:
    UsdPhysics.CollisionAPI.Apply(prim)
    UsdGeom.Imageable(prim).CreatePurposeAttr(UsdGeom.Tokens.guide)


def _add_joints(stage: Usd.Stage, top: Sdf.Path, rover: RoverDescription) -> None:
    """Add the joints with their motors: velocity drives, per degree as UsdPhysics wants them.

    The gain is that of the velocity loop, and viscous friction adds to it at a target of 0 only;
    so it is left to `newton:damping`. Dry friction and armature have no place in UsdPhysics; they
    are written for PhysX and Newton.
    """
    motor = rover.motor
    group = UsdGeom.Scope.Define(stage, top.AppendChild(JOINTS)).GetPath()
    for leg, position in zip(rover.legs.names, rover.legs.axle_positions_m()):
        joint = UsdPhysics.RevoluteJoint.Define(stage, group.AppendChild(f'{leg}_joint'))
        joint.CreateBody0Rel().SetTargets([top.AppendChild(BASE_FRAME)])
        joint.CreateBody1Rel().SetTargets([top.AppendChild(leg)])
        joint.CreateAxisAttr(UsdPhysics.Tokens.y)
        joint.CreateLocalPos0Attr(Gf.Vec3f(*position))
        joint.CreateLocalPos1Attr(Gf.Vec3f(0.0))
        joint.CreateLocalRot0Attr(Gf.Quatf(1.0))
        joint.CreateLocalRot1Attr(Gf.Quatf(1.0))
        prim = joint.GetPrim()
        drive = UsdPhysics.DriveAPI.Apply(prim, UsdPhysics.Tokens.angular)
        drive.CreateTypeAttr(UsdPhysics.Tokens.force)
        drive.CreateStiffnessAttr(0.0)
        drive.CreateDampingAttr(math.radians(motor.velocity_gain_nms))
        drive.CreateMaxForceAttr(motor.leg_stall_torque_nm)
        drive.CreateTargetVelocityAttr(0.0)
        armature = motor.rotor_inertia_kgm2 * motor.gear_ratio ** 2
        prim.AddAppliedSchema('PhysxJointAPI')
        set_foreign(prim, 'physxJoint:armature', _Types.Float, armature)
        set_foreign(prim, 'physxJoint:maxJointVelocity', _Types.Float,
                    math.degrees(motor.leg_no_load_speed_radps))
        prim.AddAppliedSchema('NewtonJointAPI')
        set_foreign(prim, 'newton:armature', _Types.Float, armature)
        set_foreign(prim, 'newton:friction', _Types.Float, motor.coulomb_friction_nm)
        set_foreign(prim, 'newton:damping', _Types.Float,
                    math.radians(motor.viscous_friction_nms))


def _add_visuals(stage: Usd.Stage, top: Sdf.Path,
                 parts: Sequence[VisualPart]) -> dict[Sdf.Path, Look]:
    """Add the meshes, with one material for each colour; return the looks of the materials."""
    group = UsdGeom.Scope.Define(stage, top.AppendChild('looks')).GetPath()
    materials: dict[tuple[float, float, float], UsdShade.Material] = {}
    looks: dict[Sdf.Path, Look] = {}
    for k, part in enumerate(parts):
        path = top.AppendChild(part.link).AppendPath(f'visuals/part_{k}')
        UsdGeom.Xform.Define(stage, path.GetParentPath())
        # Facets are flat, as our renderer draws them.
        mesh = add_mesh(stage, path, part.vertices, part.faces)
        if part.albedo not in materials:
            look = Look(part.albedo, _ROUGHNESS, part.albedo)
            looks[group.AppendChild(f'paint_{len(materials)}')] = look
            materials[part.albedo] = add_material(stage, list(looks)[-1], look)
        bind(mesh.GetPrim(), materials[part.albedo])
    return looks


@dataclasses.dataclass(frozen=True)
class CameraModel:
    """A camera as its calibration gives it.

    Attributes:
        width, height: Of images [px].
        K: (3, 3) intrinsics [px].
        distortion: k1, k2, p1, p2, k3 (Brown-Conrady) of raw images.
        near_m, far_m: Depths that are drawn.
        pitch_m: Side of a pixel.
    """

    width: int
    height: int
    K: Array
    distortion: Sequence[float]
    near_m: float
    far_m: float
    pitch_m: float


def stereo_models(rover: RoverDescription, camera: CameraConfig,
                  pitch_m: float) -> dict[str, tuple[CameraModel, Array]]:
    """Return model and T_base_optical (4, 4) of both cameras of a rover."""
    rig = StereoRig(rover, camera)
    model = CameraModel(rig.width, rig.height, rig.K, camera.distortion, camera.near_m,
                        camera.far_m, pitch_m)
    return {LEFT: (model, rig.T_base_left), RIGHT: (model, rig.T_base_right)}


def add_camera(stage: Usd.Stage, path: Sdf.Path, model: CameraModel,
               T_parent_optical: Array) -> UsdGeom.Camera:
    """Define a camera.

    The undistorted projection is in the aperture and its offsets. Distortion is written as
    Omniverse's schema for OpenCV's model has it, and only where there is any, because there that
    schema replaces aperture and focal length. `size_px` names the size of images.
    """
    camera = UsdGeom.Camera.Define(stage, path)
    place_matrix(camera.GetPrim(), T_parent_optical @ _T_OPTICAL_USD)
    fx, fy, cx, cy = model.K[0, 0], model.K[1, 1], model.K[0, 2], model.K[1, 2]
    unit = _TENTHS_PER_M * model.pitch_m
    camera.CreateFocalLengthAttr(fx * unit)
    camera.CreateHorizontalApertureAttr(model.width * unit)
    camera.CreateVerticalApertureAttr(model.height * unit * fx / fy)
    camera.CreateHorizontalApertureOffsetAttr((0.5 * (model.width - 1) - cx) * unit)
    camera.CreateVerticalApertureOffsetAttr((cy - 0.5 * (model.height - 1)) * unit * fx / fy)
    camera.CreateClippingRangeAttr(Gf.Vec2f(model.near_m, model.far_m))
    camera.CreateFStopAttr(0.0)         # sharp at all depths
    camera.CreateFocusDistanceAttr(1.0)
    prim = camera.GetPrim()
    set_foreign(prim, 'lunar_rover_sim:size_px', _Types.Int2, Gf.Vec2i(model.width, model.height))
    set_foreign(prim, 'lunar_rover_sim:fx_fy_cx_cy', _Types.Double4, Gf.Vec4d(fx, fy, cx, cy))
    set_foreign(prim, 'lunar_rover_sim:distortion', _Types.DoubleArray,
                [float(v) for v in model.distortion])
    if any(model.distortion):
        _add_lens(prim, model)
    return camera


def _add_lens(prim: Usd.Prim, model: CameraModel) -> None:
    """Add the distortion for RTX, where the corner of the image is (0, 0)."""
    prim.AddAppliedSchema('OmniLensDistortionOpenCvPinholeAPI')
    set_foreign(prim, 'omni:lensdistortion:model', _Types.Token, 'opencvPinhole')
    group = 'omni:lensdistortion:opencvPinhole:'
    set_foreign(prim, group + 'imageSize', _Types.Int2, Gf.Vec2i(model.width, model.height))
    k1, k2, p1, p2, k3 = model.distortion
    for name, value in {'fx': model.K[0, 0], 'fy': model.K[1, 1], 'cx': model.K[0, 2] + 0.5,
                        'cy': model.K[1, 2] + 0.5, 'k1': k1, 'k2': k2, 'k3': k3, 'p1': p1,
                        'p2': p2}.items():
        set_foreign(prim, group + name, _Types.Float, float(value))
