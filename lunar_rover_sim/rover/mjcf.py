"""The rover as a MuJoCo model.

Bodies: `base_link` on the free joint `base_free`, one body per leg named as the leg. Geoms:
`<leg>_tip_<k>` (sphere) and `<leg>_rod_<k>` (capsule) per spoke, `chassis`, `mast`. Actuators:
`<leg>_motor`, velocity setpoint in rad/s of the motor shaft (leg velocity times gear ratio).
Site: `imu`.

Contact classes (bit masks): `physics` adds ground and rocks. Tips and chassis touch both. Rods
touch rocks only, since on the ground the tip always makes contact first.
"""

from __future__ import annotations

import mujoco
import numpy as np

from lunar_rover_sim.base.frames import wxyz_from_rpy
from lunar_rover_sim.rover.description import (chassis_inertia, leg_inertia, Legs, Motor,
                                               RoverDescription)
from lunar_rover_sim.rover.mounts import MAST_RADIUS_M

GROUND_BIT = 1
ROCK_BIT = 2
ROVER_PRIORITY = 1  # the contact parameters of the rover apply on ground and rocks alike

BASE_BODY = 'base_link'
FREE_JOINT = 'base_free'
CHASSIS_GEOM = 'chassis'
MAST_GEOM = 'mast'
IMU_SITE = 'imu'
# As stiff as the solver allows: with MuJoCo's defaults a joint held by dry friction creeps.
_DRY_SOLREF = [0.002, 1.0]
_DRY_SOLIMP = [0.999, 0.999, 0.001, 0.5, 2.0]


def rover_spec(rover: RoverDescription) -> mujoco.MjSpec:
    """Return the rover alone, at the origin with all joint angles 0.

    Contact stiffness and friction belong to the ground; `physics` sets them.
    """
    spec = mujoco.MjSpec()
    spec.modelname = 'lunar_rover'
    base = spec.worldbody.add_body(name=BASE_BODY, sleep=mujoco.mjtSleepPolicy.mjSLEEP_NEVER)
    base.add_joint(name=FREE_JOINT, type=mujoco.mjtJoint.mjJNT_FREE)
    _set_inertia(base, rover.chassis.mass_kg, rover.chassis.com_m, chassis_inertia(rover.chassis))
    chassis = rover.chassis
    base.add_geom(name=CHASSIS_GEOM, type=mujoco.mjtGeom.mjGEOM_BOX,
                  size=[chassis.length_m / 2, chassis.width_m / 2, chassis.height_m / 2],
                  rgba=[0.75, 0.72, 0.6, 1.0], **_contact(GROUND_BIT | ROCK_BIT))
    x, y, z = rover.stereo.position_m
    top = chassis.height_m / 2
    if z - top > 2.0 * MAST_RADIUS_M:
        base.add_geom(name=MAST_GEOM, type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[MAST_RADIUS_M] * 3,
                      fromto=[x, y, top, x, y, z], **_contact(GROUND_BIT | ROCK_BIT))
    base.add_site(name=IMU_SITE, pos=rover.imu.position_m,
                  quat=wxyz_from_rpy(*np.radians(rover.imu.rpy_deg)))
    for leg, position in zip(rover.legs.names, rover.legs.axle_positions_m()):
        _add_leg(spec, base, leg, position, rover.legs, rover.motor)
    for leg in rover.legs.names:
        _add_motor(spec, leg, rover.motor)
    return spec


def tip_geom(leg: str, spoke: int) -> str:
    """Return the name of the geom of a spoke's tip."""
    return f'{leg}_tip_{spoke}'


def rod_geom(leg: str, spoke: int) -> str:
    """Return the name of the geom of a spoke's rod."""
    return f'{leg}_rod_{spoke}'


def _add_leg(spec: mujoco.MjSpec, base: mujoco.MjsBody, leg: str,
             position_m: tuple[float, ...], legs: Legs, motor: Motor) -> None:
    body = base.add_body(name=leg, pos=position_m)
    body.add_joint(name=f'{leg}_joint', type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0],
                   frictionloss=motor.coulomb_friction_nm, solref_friction=_DRY_SOLREF,
                   solimp_friction=_DRY_SOLIMP)
    _set_inertia(body, legs.mass_kg, (0.0, 0.0, 0.0), leg_inertia(legs))
    for k, direction in enumerate(np.array(legs.spoke_directions())):
        tip = (legs.spoke_length_m - legs.tip_radius_m) * direction
        body.add_geom(name=tip_geom(leg, k), type=mujoco.mjtGeom.mjGEOM_SPHERE,
                      size=[legs.tip_radius_m] * 3, pos=tip, rgba=[0.2, 0.2, 0.2, 1.0],
                      **_contact(GROUND_BIT | ROCK_BIT))
        body.add_geom(name=rod_geom(leg, k), type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                      size=[legs.spoke_radius_m] * 3, fromto=[0.0, 0.0, 0.0, *tip],
                      rgba=[0.5, 0.5, 0.5, 1.0], **_contact(ROCK_BIT))


def _add_motor(spec: mujoco.MjSpec, leg: str, motor: Motor) -> None:
    """Add MuJoCo's `dcmotor`: velocity loop in torque space, voltage and current limited."""
    gear = motor.gear_ratio
    actuator = spec.add_actuator(name=f'{leg}_motor', target=f'{leg}_joint',
                                 trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.gear = [gear, 0, 0, 0, 0, 0]
    actuator.armature = motor.rotor_inertia_kgm2
    actuator.damping = [motor.viscous_friction_nms / gear ** 2, 0.0, 0.0]
    constant = motor.motor_constant
    actuator.set_to_dcmotor(
        motorconst=[constant, constant], resistance=motor.resistance_ohm,
        saturation=[0.0, motor.current_limit_a, 0.0],
        controller=[0.0, 0.0, motor.velocity_gain_nms / gear ** 2, 0.0, 0.0,
                    motor.supply_voltage_v],
        ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_VEL))


def _set_inertia(body: mujoco.MjsBody, mass_kg: float, com_m: tuple[float, ...],
                 inertia: np.ndarray) -> None:
    body.explicitinertial = True
    body.mass = mass_kg
    body.ipos = com_m
    body.fullinertia = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1],
                        inertia[0, 2], inertia[1, 2]]


def _contact(affinity: int) -> dict[str, int]:
    """Return geom settings: touches geoms of these world classes, never another rover geom."""
    return {'contype': 0, 'conaffinity': affinity, 'condim': 6, 'priority': ROVER_PRIORITY,
            'group': 1}
