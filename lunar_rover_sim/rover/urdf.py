"""The rover as URDF: links, joints, inertias and simple visuals, for RViz, tf and other tools.

Links: base_link, `<leg>_link` on `<leg>_joint`, imu_link, stereo_left_link and stereo_right_link
(x forward), each with its optical frame. These are the frames of tf, with the same parents.

The element `ros2_control` makes a controller_manager of ros2_control drive the legs over topics.
"""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np

from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.rover.description import chassis_inertia, leg_inertia, RoverDescription
from lunar_rover_sim.rover.mounts import fixed_frames, MAST_RADIUS_M

_COLOURS = {'body': (0.78, 0.66, 0.36), 'leg': (0.55, 0.55, 0.57), 'tip': (0.15, 0.15, 0.16)}


def urdf(rover: RoverDescription) -> str:
    """Return the URDF document, frames named as in the topics."""
    robot = ElementTree.Element('robot', name='lunar_rover')
    for name, rgb in _COLOURS.items():
        material = _add(robot, 'material', name=name)
        _add(material, 'color', rgba=_numbers((*rgb, 1.0)))
    _add_base(robot, rover)
    for leg, position in zip(rover.legs.names, rover.legs.axle_positions_m()):
        _add_leg(robot, leg, position, rover)
    for parent, child, pose in fixed_frames(rover):
        _add_fixed(robot, parent, child, pose)
    _add_control(robot, rover)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding='unicode') + '\n'


def _add_base(robot: ElementTree.Element, rover: RoverDescription) -> None:
    chassis = rover.chassis
    link = _add(robot, 'link', name=frames.BASE_FRAME)
    _add_inertial(link, chassis.mass_kg, chassis.com_m, chassis_inertia(chassis))
    size = _numbers((chassis.length_m, chassis.width_m, chassis.height_m))
    for kind in ('visual', 'collision'):
        part = _add(link, kind)
        _add(_add(part, 'geometry'), 'box', size=size)
        if kind == 'visual':
            _add(part, 'material', name='body')
    x, y, z = rover.stereo.position_m
    bottom = chassis.height_m / 2
    if z > bottom:
        _add_rod(link, (x, y, bottom), (x, y, z), MAST_RADIUS_M, 'leg')


def _add_leg(robot: ElementTree.Element, leg: str, position: tuple[float, ...],
             rover: RoverDescription) -> None:
    legs, motor = rover.legs, rover.motor
    link = _add(robot, 'link', name=frames.leg_frame(leg))
    _add_inertial(link, legs.mass_kg, (0.0, 0.0, 0.0), leg_inertia(legs))
    for direction in np.array(legs.spoke_directions()):
        tip = (legs.spoke_length_m - legs.tip_radius_m) * direction
        _add_rod(link, np.zeros(3), tip, legs.spoke_radius_m, 'leg')
        for kind in ('visual', 'collision'):
            part = _add(link, kind)
            _add(part, 'origin', xyz=_numbers(tip), rpy='0 0 0')
            _add(_add(part, 'geometry'), 'sphere', radius=_number(legs.tip_radius_m))
            if kind == 'visual':
                _add(part, 'material', name='tip')
    joint = _add(robot, 'joint', name=f'{leg}_joint', type='continuous')
    _add(joint, 'parent', link=frames.BASE_FRAME)
    _add(joint, 'child', link=frames.leg_frame(leg))
    _add(joint, 'origin', xyz=_numbers(position), rpy='0 0 0')
    _add(joint, 'axis', xyz='0 1 0')
    _add(joint, 'limit', effort=_number(motor.leg_stall_torque_nm),
         velocity=_number(motor.leg_no_load_speed_radps))
    _add(joint, 'dynamics', damping=_number(motor.viscous_friction_nms),
         friction=_number(motor.coulomb_friction_nm))


def _add_rod(link: ElementTree.Element, start: tuple[float, ...] | Array,
             end: tuple[float, ...] | Array, radius_m: float, material: str) -> None:
    """Add a cylinder between two points as a visual."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    x, y, z = b - a
    visual = _add(link, 'visual')
    _add(visual, 'origin', xyz=_numbers((a + b) / 2),
         rpy=_numbers((0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x))))
    _add(_add(visual, 'geometry'), 'cylinder', radius=_number(radius_m),
         length=_number(float(np.linalg.norm(b - a))))
    _add(visual, 'material', name=material)


def _add_fixed(robot: ElementTree.Element, parent: str, child: str, pose: Array) -> None:
    """Add a link without mass, fixed at the (4, 4) T_parent_child."""
    _add(robot, 'link', name=child)
    joint = _add(robot, 'joint', name=f'{child}_joint', type='fixed')
    _add(joint, 'parent', link=parent)
    _add(joint, 'child', link=child)
    rpy = frames.rpy_from_wxyz(frames.wxyz_from_matrix(pose[:3, :3]))
    _add(joint, 'origin', xyz=_numbers(pose[:3, 3]), rpy=_numbers(rpy))


def _add_control(robot: ElementTree.Element, rover: RoverDescription) -> None:
    """Add what ros2_control reads: speeds of the legs are commanded, all else is measured."""
    control = _add(robot, 'ros2_control', name='legs', type='system')
    hardware = _add(control, 'hardware')
    _add(hardware, 'plugin').text = 'joint_state_topic_hardware_interface/JointStateTopicSystem'
    for name, topic in (('joint_commands_topic', topics.JOINT_COMMANDS),
                        ('joint_states_topic', topics.JOINT_STATES)):
        _add(hardware, 'param', name=name).text = topic.name
    for leg in rover.legs.joint_names:
        joint = _add(control, 'joint', name=leg)
        _add(joint, 'command_interface', name='velocity')
        for name in ('position', 'velocity', 'effort'):
            _add(joint, 'state_interface', name=name)


def _add_inertial(link: ElementTree.Element, mass_kg: float, com_m: tuple[float, ...],
                  inertia: Array) -> None:
    inertial = _add(link, 'inertial')
    _add(inertial, 'origin', xyz=_numbers(com_m), rpy='0 0 0')
    _add(inertial, 'mass', value=_number(mass_kg))
    _add(inertial, 'inertia', ixx=_number(inertia[0, 0]), iyy=_number(inertia[1, 1]),
         izz=_number(inertia[2, 2]), ixy=_number(inertia[0, 1]), ixz=_number(inertia[0, 2]),
         iyz=_number(inertia[1, 2]))


def _add(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _number(value: float) -> str:
    return f'{float(value):.9g}'


def _numbers(values: object) -> str:
    return ' '.join(_number(v) for v in np.asarray(values, dtype=float))
