"""Ray casts of MuJoCo against the world of physics and the meshes of the rover that are drawn."""

import mujoco
import numpy as np

from lunar_rover_sim.base.frames import wxyz_from_matrix
from lunar_rover_sim.rover.description import Legs
from lunar_rover_sim.rover.mjcf import BASE_BODY, rover_spec
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.rover.physics.model import build_model
from lunar_rover_sim.rover.visual import visual_parts

_NO_ROVER = np.array([1, 0, 1, 1, 1, 1], np.uint8)      # geoms that collide are in group 1
_MESHES = np.array([0, 0, 1, 0, 0, 0], np.uint8)
LINKS = ('base_link', *Legs().names)


class RayScene:
    """A world, and a rover whose pose can be set."""

    def __init__(self, world, rover):
        self.world = build_model(world, rover, PhysicsConfig())
        self.world_data = mujoco.MjData(self.world)
        mujoco.mj_forward(self.world, self.world_data)
        spec = rover_spec(rover)
        for k, part in enumerate(visual_parts(rover)):
            mesh = spec.add_mesh(name=f'part {k}', uservert=part.vertices.ravel(),
                                 userface=part.faces.ravel(),
                                 inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
            body = spec.body(BASE_BODY if part.link == 'base_link' else part.link)
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, group=2,
                          contype=0, conaffinity=0, density=0.0)
        self.rover = spec.compile()
        self.data = mujoco.MjData(self.rover)
        self._link = [LINKS.index(self.rover.body(body).name.replace(BASE_BODY, 'base_link'))
                      if body else -1 for body in self.rover.geom_bodyid]
        rocks = self.world.geom_type == mujoco.mjtGeom.mjGEOM_MESH
        # Geoms stand in the order of keys.
        pieces, _, owner = world.rocks.in_pieces(world.rock_shapes)
        order = np.append(owner[np.argsort(pieces.key, kind='stable')], -1)
        self._rock = order[np.cumsum(rocks & (self.world.geom_bodyid == 0)) - 1]

    def place(self, state):
        """Set the rover's pose by MuJoCo's kinematics."""
        self.data.qpos[:3] = state.T_world_base[:3, 3]
        self.data.qpos[3:7] = wxyz_from_matrix(state.T_world_base[:3, :3])
        for leg, angle in zip(Legs().names, state.joint_angle_rad):
            self.data.qpos[self.rover.joint(f'{leg}_joint').qposadr[0]] = angle
        mujoco.mj_forward(self.rover, self.data)

    def T_world_link(self, link):
        """Return the (4, 4) pose of a link: 0 base_link, 1 to 4 legs."""
        body = self.data.body(BASE_BODY if link == 0 else LINKS[link])
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = body.xmat.reshape(3, 3), body.xpos
        return T

    def cast(self, origin, rays):
        """Return (n,) distances, -1 for none; (n,) rocks and links that are hit, else -1; and
        (n, 3) normals, of (n, 3) rays from one place."""
        hits = []
        for model, data, group in ((self.world, self.world_data, _NO_ROVER),
                                   (self.rover, self.data, _MESHES)):
            distance, normal = np.empty(len(rays)), np.empty(3 * len(rays))
            geom = np.empty(len(rays), np.int32)
            mujoco.mj_multiRay(model, data, origin, np.ravel(rays), group, True, -1, geom,
                               distance, normal, len(rays), 1e10)
            hits.append((distance, geom, normal.reshape(-1, 3)))
        (ground, of_world, n0), (body, of_rover, n1) = hits
        rover = (body >= 0.0) & ((ground < 0.0) | (body < ground))
        is_rock = self.world.geom_type[of_world] == mujoco.mjtGeom.mjGEOM_MESH
        rock = np.where(~rover & (of_world >= 0) & is_rock, self._rock[of_world], -1)
        link = np.where(rover, np.take(self._link, of_rover), -1)
        return (np.where(rover, body, ground), rock, link, np.where(rover[:, None], n1, n0))
