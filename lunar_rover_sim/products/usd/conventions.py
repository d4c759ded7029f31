"""Conventions of all stages: units, axes, poses, labels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.frames import wxyz_from_matrix
from lunar_rover_sim.products.usd.output import (Gf, Kind, Sdf, Usd, UsdGeom, UsdPhysics,
                                                 UsdSemantics, Vt)

GRAVITY_PRIM = 'PhysicsScene'


def new_stage(path: Path, name: str) -> tuple[Usd.Stage, Usd.Prim]:
    """Return a new stage in metres, kilograms and seconds, z up, and its default prim."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.SetMetadata('comment', 'written by lunar_rover_sim')
    root = UsdGeom.Xform.Define(stage, f'/{name}').GetPrim()
    stage.SetDefaultPrim(root)
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    return stage, root


def place(prim: Usd.Prim, position_m: ArrayLike, orientation_wxyz: ArrayLike | None = None,
          scale: float | None = None) -> None:
    """Give a prim a pose in its parent: translation [m], orientation, uniform scale."""
    xformable = UsdGeom.Xformable(prim)
    xformable.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(vector(position_m))
    if orientation_wxyz is not None:
        xformable.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(quaternion(orientation_wxyz))
    if scale is not None:
        xformable.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(scale))


def place_matrix(prim: Usd.Prim, T_parent_prim: ArrayLike) -> None:
    """Give a prim the pose of a rigid (4, 4) transform."""
    T = np.asarray(T_parent_prim, float)
    place(prim, T[:3, 3], wxyz_from_matrix(T[:3, :3]))


def vector(values: ArrayLike) -> Gf.Vec3d:
    """Return three numbers as OpenUSD takes them."""
    return Gf.Vec3d(*(float(v) for v in np.asarray(values, float)))


def quaternion(wxyz: ArrayLike) -> Gf.Quatd:
    """Return a quaternion as OpenUSD takes it."""
    w, x, y, z = (float(v) for v in np.asarray(wxyz, float))
    return Gf.Quatd(w, x, y, z)


def single_quaternion(wxyz: ArrayLike) -> Gf.Quatf:
    """Return a quaternion in single precision, which some attributes want."""
    return Gf.Quatf(quaternion(wxyz))


def points(array: ArrayLike) -> Vt.Vec3fArray:
    """Return an (n, 3) array as OpenUSD takes it."""
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(array, np.float32))


def integers(array: ArrayLike) -> Vt.IntArray:
    """Return an array of any shape as a flat one of OpenUSD."""
    return Vt.IntArray.FromNumpy(np.ascontiguousarray(array, np.int32).ravel())


def add_mesh(stage: Usd.Stage, path: Sdf.Path, vertices: NDArray[np.floating],
             faces: NDArray[np.integer]) -> UsdGeom.Mesh:
    """Define a mesh of triangles with flat facets: (n, 3) vertices, (m, 3) indices."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(points(vertices))
    mesh.CreateFaceVertexCountsAttr(integers(np.full(len(faces), 3)))
    mesh.CreateFaceVertexIndicesAttr(integers(faces))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(points([vertices.min(axis=0), vertices.max(axis=0)]))
    return mesh


def label(prim: Usd.Prim, kind: str, instance: str = '') -> None:
    """Label a prim with its class and, where there are several, its instance."""
    UsdSemantics.LabelsAPI.Apply(prim, 'class').CreateLabelsAttr([kind])
    if instance:
        UsdSemantics.LabelsAPI.Apply(prim, 'instance').CreateLabelsAttr([instance])


def add_gravity(stage: Usd.Stage, parent: Usd.Prim, gravity_mps2: float) -> None:
    """Add the one physics scene of a stage: gravity along -z."""
    scene = UsdPhysics.Scene.Define(stage, parent.GetPath().AppendChild(GRAVITY_PRIM))
    scene.CreateGravityDirectionAttr(Gf.Vec3f(0.0, 0.0, -1.0))
    scene.CreateGravityMagnitudeAttr(gravity_mps2)


def set_foreign(prim: Usd.Prim, name: str, kind: Sdf.ValueTypeName, value: object) -> None:
    """Set an attribute of a schema of others, which need not be installed here."""
    prim.CreateAttribute(name, kind, custom=False).Set(value)
