"""An exported rover in Newton: mass, joint axes, resting load. Not collected by pytest.

    python test/products/usd/cross_check_newton.py rover.usd

Needs an environment of its own, because Newton's dependencies bring another OpenUSD: pip install
newton usd-core mujoco-warp. Exits with 1 where something differs from the stage or the load at
rest from the weight by more than 1 %.
"""

import sys

import mujoco
import newton
import numpy as np
from pxr import Usd, UsdPhysics
import warp

GRAVITY = 1.62
STAGE = Usd.Stage.Open(sys.argv[1])
MASS_KG = sum(UsdPhysics.MassAPI(prim).GetMassAttr().Get() for prim in STAGE.Traverse()
              if prim.HasAPI(UsdPhysics.MassAPI))

warp.set_device('cpu')
builder = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY), up_axis=newton.Axis.Z)
builder.add_usd(sys.argv[1], floating=True,
                xform=warp.transform((0.0, 0.0, 0.12), warp.quat_identity()))
builder.add_ground_plane()
model = builder.finalize()
mass = float(model.body_mass.numpy().sum())
axes = model.joint_axis.numpy()[-4:]
solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True)
now, then = model.state(), model.state()
newton.eval_fk(model, model.joint_q, model.joint_qd, now)
for _ in range(4000):
    now.clear_forces()
    solver.step(now, then, model.control(), None, 0.001)
    now, then = then, now
load = 0.0
for index in range(solver.mj_data.ncon):
    force = np.zeros(6)
    mujoco.mj_contactForce(solver.mj_model, solver.mj_data, index, force)
    load += float((solver.mj_data.contact[index].frame.reshape(3, 3).T @ force[:3])[2])
print(f'mass {mass:.6g} kg of {MASS_KG:.6g}, axes {axes.tolist()}, '
      f'resting load {load / (mass * GRAVITY):.6f} of the weight')
sys.exit(not (abs(mass - MASS_KG) < 1e-5 and np.allclose(axes, [0.0, 1.0, 0.0])
              and abs(load / (mass * GRAVITY) - 1.0) < 0.01))
