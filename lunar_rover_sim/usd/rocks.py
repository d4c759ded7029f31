"""Rocks: instances of a few shapes.

Those that a rover may touch are prims of their own, so that each has a collider (its convex hull,
which it is), a label and a brightness. Those beyond the fine ground are points of an instancer.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lunar_rover_sim.usd.conventions import (add_mesh, integers, label, place, points,
                                             single_quaternion)
from lunar_rover_sim.usd.material import bind, bind_contact
from lunar_rover_sim.usd.pixar import Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt
from lunar_rover_sim.world.rocks import Rocks, RockShape

_SHAPES = '/shapes'


def brightness_classes(rocks: Rocks, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the class of each rock, and the mean albedo factor of the classes: quantiles."""
    if not len(rocks):
        return np.zeros(0, int), np.zeros(0)
    edges = np.quantile(rocks.albedo, np.linspace(0.0, 1.0, count + 1)[1:-1])
    found, member = np.unique(np.searchsorted(edges, rocks.albedo), return_inverse=True)
    return member, np.array([rocks.albedo[member == k].mean() for k in range(len(found))])


def write_rocks(path: Path, rocks: Rocks, shapes: tuple[RockShape, ...]) -> None:
    """Write rocks that can be touched, as instances `/rocks/rock_<index>`."""
    stage = Usd.Stage.CreateNew(str(path))
    group = UsdGeom.Scope.Define(stage, '/rocks').GetPath()
    known = set()
    for i in range(len(rocks)):
        shape = shapes[int(rocks.shape[i])]
        prototype = Sdf.Path(_SHAPES).AppendChild(shape.name)
        if shape.name not in known:
            known.add(shape.name)
            stage.CreateClassPrim(_SHAPES)
            UsdGeom.Xform.Define(stage, prototype)
            mesh = add_mesh(stage, prototype.AppendChild('hull'), shape.vertices,
                            shape.faces).GetPrim()
            UsdPhysics.CollisionAPI.Apply(mesh)
            UsdPhysics.MeshCollisionAPI.Apply(mesh).CreateApproximationAttr(
                UsdPhysics.Tokens.convexHull)
        rock = UsdGeom.Xform.Define(stage, group.AppendChild(f'rock_{i}')).GetPrim()
        rock.GetReferences().AddInternalReference(prototype)
        rock.SetInstanceable(True)
        place(rock, rocks.position_m[i], rocks.orientation_wxyz[i], float(rocks.diameter_m[i]))
        label(rock, 'rock', f'rock_{i}')
    stage.Save()


def write_far_rocks(path: Path, rocks: Rocks, shapes: tuple[RockShape, ...]) -> None:
    """Write rocks that are only seen, as one instancer `/rocks`."""
    stage = Usd.Stage.CreateNew(str(path))
    instancer = UsdGeom.PointInstancer.Define(stage, '/rocks')
    group = UsdGeom.Scope.Define(stage, '/rocks/shapes').GetPath()
    targets = []
    for shape in shapes:
        targets.append(group.AppendChild(shape.name))
        add_mesh(stage, targets[-1], shape.vertices, shape.faces)
    instancer.CreatePrototypesRel().SetTargets(targets)
    instancer.CreateProtoIndicesAttr(integers(rocks.shape))
    instancer.CreatePositionsAttr(points(rocks.position_m))
    instancer.CreateOrientationsfAttr(Vt.QuatfArray(
        [single_quaternion(q) for q in rocks.orientation_wxyz]))
    instancer.CreateScalesAttr(points(np.repeat(rocks.diameter_m[:, None], 3, axis=1)))
    if len(rocks):
        reach = 0.75 * rocks.diameter_m[:, None]
        instancer.CreateExtentAttr(points([(rocks.position_m - reach).min(axis=0),
                                           (rocks.position_m + reach).max(axis=0)]))
    label(instancer.GetPrim(), 'rock')
    stage.Save()


def bind_rocks(stage: Usd.Stage, parent: Sdf.Path, member: np.ndarray,
               materials: list[UsdShade.Material], contact: UsdShade.Material) -> None:
    """Bind the material of its class to each rock below `parent`, by overs in the root layer."""
    for i, k in enumerate(member):
        bind(stage.OverridePrim(parent.AppendChild(f'rock_{i}')), materials[int(k)])
    bind_contact(stage.GetPrimAtPath(parent), contact)
