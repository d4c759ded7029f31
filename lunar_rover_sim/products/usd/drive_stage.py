"""A recorded drive as a stage: world, rover and motion.

The root layer refers to a stage of the world and one of the rover, and has the motion as a
sublayer. The motion stands in the variant set `motion` of the default prim: `recorded` plays the
drive and switches the physics of the rover off, because a simulator would fight the samples;
`simulated` starts it from the first state with physics on and gives its motors the recorded
commands. On ground that gives `recorded` shows the tracks (`drive_tracks`); `simulated` has the
untouched ground.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
import logging
import os
from pathlib import Path
from typing import Any

import numpy as np

from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.series import Series
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import UsdError
from lunar_rover_sim.base.frames import Array, BASE_FRAME, IMU_FRAME, matrix_from_wxyz
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.regolith.overlay import CELL_M
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.products.usd.drive_tracks import (can_hold_tracks, continuous, DriveMotion,
                                                       link_motion, motion_of, read_ground_changes,
                                                       write_tracks)
from lunar_rover_sim.products.usd.rover_stage import compose_rover, JOINTS, LEFT, RIGHT
from lunar_rover_sim.products.usd.stage import (check_output, Gf, is_package, new_stage,
                                                quaternion, Sdf, Tf, Usd, UsdPhysics, vector,
                                                write_stage)
from lunar_rover_sim.products.usd.world_stage import compose_world, HASH_KEY, StageSettings
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.node_config import PhysicsNodeConfig, RenderNodeConfig
from lunar_rover_sim.run.recorded_run import RecordedNodes, RecordedRun


def settings_of(physics: PhysicsNodeConfig, render: RenderNodeConfig) -> StageSettings:
    """Return what the stage of a world is to be made for, by the parameters of the nodes."""
    return StageSettings(render.sun, render.reflectance, physics.gravity_mps2,
                         physics.contact.sliding_friction, render.detail)


logger = logging.getLogger(__name__)

NAME, WORLD, ROVER = 'Drive', 'World', 'Rover'
VARIANTS, RECORDED, SIMULATED = 'motion', 'recorded', 'simulated'
_MOTION = 'motion.usdc'
_Types = Sdf.ValueTypeNames


def write_drive(bag: str | Path, path: str | Path, *, world: str | Path | None = None,
                world_stage: str | Path | None = None, overwrite: bool = False) -> Path:
    """Write the drive in a bag as a stage whose default prim is `/Drive`; return its path.

    Args:
        world: Folder of the world that was driven on, where it is not in the cache.
        world_stage: A stage of that world, which is referred to; by default one is written.

    Raises:
        BagError: Where the bag cannot be read, holds no drive or no scenario of this version, or
            `world` is another world.
        UsdError: Where its world is not found, or the stage cannot be written.
    """
    path = Path(path)
    check_output(path, overwrite)
    with open_bag(bag) as opened:
        recorded = RecordedRun(opened).nodes
        motion = motion_of(opened, recorded.rover.legs)
        changes = read_ground_changes(opened)
        found = None
        if world_stage is None:
            found = _window(opened, world)
            if found is None:
                raise UsdError(f'{opened.path}: no folder holds the world of this drive; name it '
                               'with --world, or a stage of it with --world-stage')
        else:
            _check_world_stage(Path(world_stage), opened)
        track_world = found or (_window(opened, world) if changes else None)
    if changes and track_world is None:
        logger.warning('%s: no folder holds the world of this drive, so its tracks are left out; '
                       'name it with --world', bag)
    elif changes and track_world is not None and not can_hold_tracks(track_world.ground):
        logger.warning('%s: cells of the ground of %g m are no multiple of the %g m of tracks, '
                       'which are left out', bag, track_world.ground.cell_m, CELL_M)

    def tracks(stage: Usd.Stage, world_path: Sdf.Path) -> None:
        if track_world is not None:
            write_tracks(stage, world_path.AppendChild('ground'), track_world.ground,
                         [frame.around(track_world.origin_m) for frame in changes],
                         lambda ns: _codes(motion, [ns])[0])

    def compose(root: Path, parts: Path) -> None:
        reference = f'./{parts.name}/world.usdc'
        if world_stage is not None:
            reference = _reference(Path(world_stage), path)
        _compose(motion, recorded, found, reference, root, parts, tracks)

    return write_stage(path, compose, overwrite)


def _window(bag: Bag, folder: str | Path | None) -> World | None:
    """Return the window of the site at the end of a drive, in its own frame."""
    driven = RecordedRun(bag).driven(folder)
    if driven is None:
        return None
    middles = {middle for _, middle in driven.windows}
    if len(middles) > 1:
        logger.warning('%s: the drive crosses %d windows of its site; the stage has the ground of '
                       'the last one', bag.path, len(middles))
    return driven.at().local()


def _reference(stage: Path, path: Path) -> str:
    """Return the reference of a stage at `path` to another one.

    It is absolute for a package, which copies the other one.
    """
    if is_package(path):
        return str(stage.absolute())
    relative = os.path.relpath(stage, path.parent)
    return relative if relative.startswith('.') else f'./{relative}'


def _check_world_stage(path: Path, bag: Bag) -> None:
    """Raise UsdError unless a file is a stage of the world of a bag."""
    try:
        stage = Usd.Stage.Open(str(path), Usd.Stage.LoadNone) if path.is_file() else None
    except Tf.ErrorException:
        stage = None
    if stage is None or not stage.GetDefaultPrim():
        raise UsdError(f'{path}: is not a stage of a world; make one with: lunar_rover_sim world '
                       'export')
    found = stage.GetDefaultPrim().GetCustomDataByKey(HASH_KEY)
    wanted = bag.first(topics.WORLD_HASH.name).data if bag.has(topics.WORLD_HASH.name) else found
    if found != wanted:
        raise UsdError(f'{path}: is a stage of the world {found}; the bag was recorded on '
                       f'{wanted}')


def _compose(motion: DriveMotion, recorded: RecordedNodes, world: World | None, world_stage: str,
             root: Path, parts: Path, tracks: Callable[[Usd.Stage, Sdf.Path], None]) -> None:
    stage, top = new_stage(root, NAME)
    if world is not None:
        (parts / 'world_parts').mkdir()
        compose_world(world, parts / 'world.usdc', parts / 'world_parts',
                      settings_of(recorded.physics, recorded.render), WORLD)
    (parts / 'rover_parts').mkdir()
    compose_rover(recorded.rover, parts / 'rover.usdc', parts / 'rover_parts',
                  recorded.render.camera, recorded.render.sensor,
                  recorded.physics.contact.sliding_friction, ROVER)
    _write_motion(parts / _MOTION, motion, recorded.rover, tracks)
    frames = motion.others.get('frames')
    frame_hz = (NS_PER_S / float(np.median(np.diff(frames.stamps_ns)))
                if frames is not None and len(frames.stamps_ns) > 1 else motion.rate_hz)
    _set_time(stage, motion, frame_hz)
    stage.Save()
    path = top.GetPath()
    del stage, top      # from here on nothing is composed: paths hold where the stage will lie
    layer = Sdf.Layer.FindOrOpen(str(root))
    layer.subLayerPaths.append(f'./{parts.name}/{_MOTION}')
    for name, asset in ((WORLD, world_stage), (ROVER, f'./{parts.name}/rover.usdc')):
        prim = Sdf.PrimSpec(layer.GetPrimAtPath(path), name, Sdf.SpecifierDef)
        prim.referenceList.Prepend(Sdf.Reference(asset))
    layer.Save()


def _set_time(stage: Usd.Stage, motion: DriveMotion, frame_hz: float) -> None:
    """Let a stage count time in states, from 0 at the beginning of the recording."""
    stage.SetTimeCodesPerSecond(motion.rate_hz)
    stage.SetFramesPerSecond(frame_hz)
    codes = _codes(motion, motion.odometry.stamps_ns[[0, -1]])
    stage.SetStartTimeCode(codes[0])
    stage.SetEndTimeCode(codes[1])


def _codes(motion: DriveMotion, stamps_ns: Any) -> list[float]:
    """Return stamps as time codes; whole numbers for states."""
    rate_hz = motion.rate_hz
    return [int(t) * rate_hz / NS_PER_S for t in stamps_ns]


def _write_motion(path: Path, motion: DriveMotion, rover: RoverDescription,
                  tracks: Callable[[Usd.Stage, Sdf.Path], None]) -> None:
    stage = Usd.Stage.CreateNew(str(path))
    _set_time(stage, motion, motion.rate_hz)
    top = stage.OverridePrim(f'/{NAME}')
    variants = top.GetVariantSets().AddVariantSet(VARIANTS)
    for name, write in ((RECORDED, _write_recorded), (SIMULATED, _write_simulated)):
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        with variants.GetVariantEditContext():
            write(stage, top.GetPath().AppendChild(ROVER), motion, rover)
            if name == RECORDED:
                tracks(stage, top.GetPath().AppendChild(WORLD))
    variants.SetVariantSelection(RECORDED)
    stage.Save()


def _poses(motion: DriveMotion, rover: RoverDescription) -> dict[str, tuple[Array, Array]]:
    odometry = motion.odometry
    return {BASE_FRAME: (odometry.positions_m, odometry.orientations_wxyz),
            **link_motion(rover, motion)}


def _write_recorded(stage: Usd.Stage, rover_path: Sdf.Path, motion: DriveMotion,
                    rover: RoverDescription) -> None:
    """Write poses and everything else that was recorded as samples, with physics off."""
    stamps = motion.odometry.stamps_ns
    for link, (positions, orientations) in _poses(motion, rover).items():
        prim = stage.OverridePrim(rover_path.AppendChild(link))
        _sample(motion, prim, 'xformOp:translate', _Types.Double3, stamps,
                (vector(p) for p in positions))
        _sample(motion, prim, 'xformOp:orient', _Types.Quatd, stamps,
                (quaternion(q) for q in continuous(orientations)))
        prim.CreateAttribute('physics:rigidBodyEnabled', _Types.Bool, custom=False).Set(False)
    # A joint needs an enabled body, an articulation a joint.
    stage.OverridePrim(rover_path.AppendChild(JOINTS)).SetActive(False)
    stage.OverridePrim(rover_path).RemoveAPI(UsdPhysics.ArticulationRootAPI)
    _write_signals(stage, rover_path, motion, rover)


def _write_signals(stage: Usd.Stage, rover_path: Sdf.Path, motion: DriveMotion,
                   rover: RoverDescription) -> None:
    """Write velocities, joint states, contacts, IMU and the stamps of frames."""
    odometry, others = motion.odometry, motion.others
    base = stage.OverridePrim(rover_path.AppendChild(BASE_FRAME))
    # In axes of the world, which are those of the rover's parent; angles in degrees.
    rotation = matrix_from_wxyz(odometry.orientations_wxyz)
    linear = np.einsum('nij,nj->ni', rotation, odometry.twists[:, :3])
    angular = np.degrees(np.einsum('nij,nj->ni', rotation, odometry.twists[:, 3:]))
    for name, values in (('physics:velocity', linear), ('physics:angularVelocity', angular)):
        _sample(motion, base, name, _Types.Vector3f, odometry.stamps_ns, _singles(values))
    for k, leg in enumerate(rover.legs.names):
        prim = stage.OverridePrim(rover_path.AppendChild(leg))
        _sample(motion, prim, 'lunar_rover_sim:angle_rad', _Types.Double, odometry.stamps_ns,
                motion.joints[:, k].tolist())
        for name, series in (('velocity_radps', others.get('joint_velocity')),
                             ('torque_nm', others.get('joint_torque')),
                             ('command_radps', others.get('joint_command'))):
            if series is not None and np.isfinite(series.values).all():
                _sample(motion, prim, f'lunar_rover_sim:{name}', _Types.Float, series.stamps_ns,
                        series.values[:, k].tolist())
        contact = others.get(f'contact/{leg}')
        if contact is not None:
            _sample(motion, prim, 'lunar_rover_sim:contact_force_n', _Types.Vector3f,
                    contact.stamps_ns, _singles(contact.values))
    imu = others.get('imu')
    if imu is not None:
        prim = stage.OverridePrim(base.GetPath().AppendChild(IMU_FRAME))
        for name, part in (('rate_radps', imu.values[:, :3]),
                           ('specific_force_mps2', imu.values[:, 3:])):
            _sample(motion, prim, f'lunar_rover_sim:{name}', _Types.Vector3f, imu.stamps_ns,
                    _singles(part))
    frames = others.get('frames')
    if frames is not None:
        for side in (LEFT, RIGHT):
            prim = stage.OverridePrim(base.GetPath().AppendChild(side))
            _sample(motion, prim, 'lunar_rover_sim:stamp_ns', _Types.Int64, frames.stamps_ns,
                    frames.stamps_ns.tolist())


def _write_simulated(stage: Usd.Stage, rover_path: Sdf.Path, motion: DriveMotion,
                     rover: RoverDescription) -> None:
    """Write the first pose, and the commands to the motors as samples."""
    for link, (positions, orientations) in _poses(motion, rover).items():
        prim = stage.OverridePrim(rover_path.AppendChild(link))
        prim.CreateAttribute('xformOp:translate', _Types.Double3, custom=False).Set(
            vector(positions[0]))
        prim.CreateAttribute('xformOp:orient', _Types.Quatd, custom=False).Set(
            quaternion(orientations[0]))
    command: Series | None = motion.others.get('joint_command')
    if command is None or not np.isfinite(command.values).all():
        return
    for k, leg in enumerate(rover.legs.names):
        joint = stage.OverridePrim(rover_path.AppendPath(f'{JOINTS}/{leg}_joint'))
        _sample(motion, joint, 'drive:angular:physics:targetVelocity', _Types.Float,
                command.stamps_ns, np.degrees(command.values[:, k]).tolist())


def _sample(motion: DriveMotion, prim: Usd.Prim, name: str, kind: Sdf.ValueTypeName,
            stamps_ns: Any, values: Iterable[Any]) -> None:
    """Give an attribute a value at each stamp."""
    attribute = prim.CreateAttribute(name, kind, custom=False)
    for code, value in zip(_codes(motion, stamps_ns), values, strict=True):
        attribute.Set(value, code)


def _singles(values: Array) -> Iterable[Gf.Vec3f]:
    """Return the rows of (n, 3) values in single precision."""
    return (Gf.Vec3f(*row) for row in values.tolist())
