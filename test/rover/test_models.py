"""The rover's description, MJCF, URDF and meshes say the same."""

from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import trimesh
import yaml

from lunar_rover_sim.base import frames
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import config_path
from lunar_rover_sim.rover.description import (Chassis, ImuMount, Legs, LidarMount, load_rover,
                                               rectangle, RoverDescription, save_rover,
                                               StereoMount)
from lunar_rover_sim.rover.mjcf import IMU_SITE, rover_spec, tip_geom
from lunar_rover_sim.rover.mounts import (camera_poses, Footprint, imu_pose, lidar_pose,
                                          optical_poses)
from lunar_rover_sim.rover.urdf import urdf
from lunar_rover_sim.rover.visual import link_poses, visual_parts

ROVER = RoverDescription()
OTHER = RoverDescription(
    chassis=Chassis(mass_kg=5.0, length_m=0.5, com_m=(0.02, -0.01, -0.03)),
    legs=Legs(spokes=5, spoke_length_m=0.12, mass_kg=0.1, each=rectangle(x=0.2, z=0.01)),
    stereo=StereoMount(position_m=(0.2, 0.01, 0.3), pitch_deg=25.0, baseline_m=0.2),
    imu=ImuMount(position_m=(0.05, 0.02, 0.01), rpy_deg=(10.0, -20.0, 30.0)),
    lidar=LidarMount(position_m=(0.1, -0.03, 0.4), rpy_deg=(5.0, 15.0, -40.0)))


def compiled(rover):
    model = rover_spec(rover).compile()
    return model, mujoco.MjData(model)


@pytest.mark.parametrize('rover', [ROVER, OTHER])
def test_masses_and_inertias_are_those_of_the_description(rover):
    model, _ = compiled(rover)
    assert model.body_mass.sum() == pytest.approx(rover.total_mass_kg)
    base = model.body('base_link').id
    np.testing.assert_allclose(model.body_ipos[base], rover.chassis.com_m)
    assert model.body_mass[base] == pytest.approx(rover.chassis.mass_kg)
    # Thin rods from the axle: m L^2 / 3 about it, half of that across for >= 3 spokes.
    about_axle = rover.legs.mass_kg * rover.legs.spoke_length_m ** 2 / 3
    inertia = np.sort(model.body_inertia[model.body('front_left').id])
    np.testing.assert_allclose(inertia, np.array([0.5, 0.5, 1.0]) * about_axle, rtol=0.02)
    reflected = model.dof_M0 if hasattr(model, 'dof_M0') else model.dof_invweight0
    assert np.all(reflected > 0.0)


@pytest.mark.parametrize('rover', [ROVER, OTHER])
def test_positive_angles_move_the_lower_tip_backward(rover):
    """Spoke k stands at q + k 2 pi / n from straight down, towards -x."""
    model, data = compiled(rover)
    angles = np.array([0.0, 0.3, -0.7, 2.0])
    data.qpos[7:11] = angles
    mujoco.mj_kinematics(model, data)
    reach = rover.legs.spoke_length_m - rover.legs.tip_radius_m
    for leg, angle, axle in zip(Legs().names, angles, rover.legs.axle_positions_m()):
        for k in range(rover.legs.spokes):
            a = angle + k * rover.legs.spoke_pitch_rad
            expected = axle + reach * np.array([-np.sin(a), 0.0, -np.cos(a)])
            np.testing.assert_allclose(data.geom(tip_geom(leg, k)).xpos, expected, atol=1e-12)


@pytest.mark.parametrize('rover', [ROVER, OTHER])
def test_link_poses_are_the_bodies_of_the_simulation(rover):
    model, data = compiled(rover)
    angles = [0.4, -1.0, 3.0, 0.0]
    data.qpos[7:11] = angles
    mujoco.mj_kinematics(model, data)
    for link, pose in link_poses(rover, angles).items():
        np.testing.assert_allclose(pose[:3, 3], data.body(link).xpos, atol=1e-12)
        np.testing.assert_allclose(pose[:3, :3], data.body(link).xmat.reshape(3, 3), atol=1e-12)
    site = data.site(IMU_SITE)
    np.testing.assert_allclose(imu_pose(rover)[:3, 3], site.xpos, atol=1e-12)
    np.testing.assert_allclose(imu_pose(rover)[:3, :3], site.xmat.reshape(3, 3), atol=1e-12)


def urdf_poses(document: str) -> dict[str, np.ndarray]:
    """Return T_base_link of all links at joint angles 0, by walking the joints."""
    root = ElementTree.fromstring(document.encode())
    poses = {'base_link': np.eye(4)}
    for joint in root.findall('joint'):
        origin = joint.find('origin')
        xyz, rpy = (np.array(origin.get(k).split(), float) for k in ('xyz', 'rpy'))
        local = frames.se3(frames.matrix_from_wxyz(frames.wxyz_from_rpy(*rpy)), xyz)
        poses[joint.find('child').get('link')] = poses[joint.find('parent').get('link')] @ local
    assert set(poses) == {link.get('name') for link in root.findall('link')}
    return poses


@pytest.mark.parametrize('rover', [ROVER, OTHER])
def test_urdf_frames_are_where_the_description_says(rover):
    poses = urdf_poses(urdf(rover))
    expected = {frames.BASE_FRAME: np.eye(4)} | {
        frames.leg_frame(leg): link_poses(rover, np.zeros(4))[leg] for leg in Legs().names}
    expected[frames.IMU_FRAME] = imu_pose(rover)
    expected[frames.LIDAR_FRAME] = lidar_pose(rover)
    expected['stereo_left_link'], expected['stereo_right_link'] = camera_poses(rover)
    expected[frames.LEFT_OPTICAL_FRAME], expected[frames.RIGHT_OPTICAL_FRAME] = optical_poses(
        rover)
    assert set(poses) == set(expected)
    for link, pose in expected.items():
        np.testing.assert_allclose(poses[link], pose, atol=1e-8)


@pytest.mark.parametrize('rover', [ROVER, OTHER])
def test_mujoco_reads_the_urdf_with_the_same_masses(rover):
    # MuJoCo welds base_link to its world, so its mass is not among the bodies.
    model = mujoco.MjModel.from_xml_string(urdf(rover))
    own, _ = compiled(rover)
    assert [model.joint(i).name for i in range(model.njnt)] == list(Legs().joint_names)
    for leg in Legs().names:
        np.testing.assert_allclose(model.body(f'{leg}_link').mass, own.body(leg).mass)
        np.testing.assert_allclose(model.body(f'{leg}_link').pos, own.body(leg).pos)
        np.testing.assert_allclose(np.sort(model.body(f'{leg}_link').inertia),
                                   np.sort(own.body(leg).inertia), rtol=1e-6)
    root = ElementTree.fromstring(urdf(rover).encode())
    masses = [float(m.get('value')) for m in root.iter('mass')]
    assert sum(masses) == pytest.approx(rover.total_mass_kg)


def test_the_urdf_says_how_ros2_control_drives_the_legs():
    control = ElementTree.fromstring(urdf(ROVER).encode()).find('ros2_control')
    assert {p.get('name'): p.text for p in control.iter('param')} == {
        'joint_commands_topic': 'joint_commands', 'joint_states_topic': 'joint_states'}
    joints = control.findall('joint')
    assert [j.get('name') for j in joints] == list(ROVER.legs.joint_names)
    for joint in joints:
        assert [i.get('name') for i in joint.findall('command_interface')] == ['velocity']


@pytest.mark.parametrize('rover', [ROVER, OTHER])
def test_optical_frames_look_ahead_and_down(rover):
    left, right = optical_poses(rover)
    tilt = np.radians(rover.stereo.pitch_deg)
    for pose in (left, right):
        np.testing.assert_allclose(pose[:3, 2], [np.cos(tilt), 0.0, -np.sin(tilt)], atol=1e-12)
        np.testing.assert_allclose(pose[:3, 0], [0.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(left[:3, 3] - right[:3, 3], [0.0, rover.stereo.baseline_m, 0.0],
                               atol=1e-12)


@pytest.mark.parametrize('rover', [ROVER, OTHER])
def test_meshes_are_closed_and_reach_as_far_as_the_contacts(rover):
    parts = visual_parts(rover)
    assert {part.link for part in parts} == {'base_link', *Legs().names}
    for part in parts:
        assert part.vertices.dtype == np.float32 and part.faces.dtype == np.int32
        assert all(0.0 <= a <= 1.0 for a in part.albedo)
        mesh = trimesh.Trimesh(part.vertices, part.faces)
        mesh.merge_vertices()
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0
    leg = np.concatenate([p.vertices for p in parts if p.link == 'front_left'])
    assert leg[:, 2].min() == pytest.approx(-rover.legs.spoke_length_m, abs=1e-4)
    assert sum(len(part.faces) for part in parts) < 10_000


def test_nothing_stands_in_front_of_the_lenses():
    base = np.concatenate([p.vertices for p in visual_parts(ROVER) if p.link == 'base_link'])
    for pose in optical_poses(ROVER):
        x, y, z = ((base - pose[:3, 3]) @ pose[:3, :3]).T
        ahead = z > 0.0
        # Half the field of view of a wide lens: 45 deg.
        assert not np.any(np.hypot(x, y)[ahead] < z[ahead])


def test_the_packaged_file_is_the_default():
    assert load_rover() == RoverDescription()
    content = yaml.safe_load(config_path('rovers/quad.yaml').read_text(encoding='utf-8'))
    assert RoverDescription().to_mapping() == content


def test_a_rover_survives_the_file(tmp_path):
    save_rover(OTHER, tmp_path / 'rover.yaml')
    assert load_rover(tmp_path / 'rover.yaml') == OTHER


@pytest.mark.parametrize(('text', 'message'), [
    ('legs: {spoke_lenght_m: 0.1}', 'legs.spoke_lenght_m: no such parameter; did you mean'),
    ('legs: {tip_radius_m: 0.2}', 'tip_radius_m: 0.2 is not valid; valid is less than'),
    ('{', 'not valid YAML'),
    ('chassis: {mass_kg: 1.0e+30}', 'mass_kg: 1e[+]30 is not valid; valid is > 0 to 2000'),
    ('legs: {each: {a: {position_m: [40, 1, 0]}}}', r'legs.each.a.position_m: 40.0 is not valid'),
    ('legs: {each: {}}', 'legs.each: 0 legs given; valid are 3 to 12'),
    ('legs: {each: {a: {side: middle}}}', "legs.each.a.side: 'middle' is not valid; valid are"),
    ('legs: {each: {a: {side: right}}}', "legs.each.a.side: 'right' is not valid with position"),
    ('legs: {each: {a: {phase: 1.0}}}', 'legs.each.a.phase: 1.0 .* valid is 0 to < 1'),
    ('legs: {each: {a: {}, a: {}}}', "'a' is given twice"),
    ('legs: {each: {Front: {}}}', "legs.each: 'Front' is not a valid name"),
    ('chassis: {com_m: [0, 0, 0.2]}', r'chassis.com_m: \[0.0, 0.0, 0.2\] .* within the chassis'),
    ('legs: {each: {a: {}, b: {position_m: [0.1, 0.1, 0]}, c: {side: right, position_m: '
     '[0.1, -0.1, 0]}}}', 'com_m: .* between the axles'),
    ('{legs: {spokes: 3}, legs: {spokes: 4}}', "'legs' is given twice"),
])
def test_a_bad_file_is_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / 'rover.yaml'
    path.write_text(text, encoding='utf-8')
    with pytest.raises(ConfigError, match=message) as caught:
        load_rover(path)
    assert str(path) in str(caught.value) and '\n' not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match='no such rover file'):
        load_rover(tmp_path / 'none.yaml')


def test_joint_order_is_that_of_the_legs():
    model, _ = compiled(ROVER)
    assert [model.joint(i + 1).name for i in range(4)] == list(Legs().joint_names)
    assert model.nu == 4


def test_the_footprint_is_level_below_the_lowest_foot():
    """Pitched by 0.2 rad: no roll, no pitch, the yaw of the body; no tip lies below it."""
    rover = OTHER
    R_world_base = frames.matrix_from_wxyz(frames.wxyz_from_rpy(0.05, 0.2, 2.5))
    links = link_poses(rover, [0.1, 0.7, -0.3, 2.0])
    T_world_foot = frames.se3(R_world_base, np.zeros(3)) @ Footprint(rover).pose(
        R_world_base, np.array([links[leg] for leg in Legs().names]))
    roll, pitch, yaw = frames.rpy_from_wxyz(frames.wxyz_from_matrix(T_world_foot[:3, :3]))
    assert [roll, pitch, yaw] == pytest.approx([0.0, 0.0, 2.5], abs=1e-9)
    assert T_world_foot[:2, 3] == pytest.approx([0.0, 0.0], abs=1e-12)
    legs = rover.legs
    lowest = min(
        (R_world_base @ (links[leg] @ [*(legs.spoke_length_m - legs.tip_radius_m) * np.array(d),
                                       1.0])[:3])[2] - legs.tip_radius_m
        for leg in Legs().names for d in legs.spoke_directions())
    assert T_world_foot[2, 3] == pytest.approx(lowest)
