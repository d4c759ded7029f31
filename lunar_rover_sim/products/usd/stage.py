"""Stages: on the disk, and their units, axes, poses and labels.

A stage is a root layer and a folder of its parts, both whole or not at all.

`NAME.usd` (binary), `.usda` (text) and `.usdc` (binary) have their parts (meshes, textures) in the
folder `NAME_parts` beside them; `.usdz` holds all in one file. Everything is written into a
temporary folder first. The parts get their name before the root layer gets its own, so that a root
layer never lacks its parts.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import zipfile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.errors import brief, one_line, UsdError, with_extra
from lunar_rover_sim.base.files.atomic import partial_folder
from lunar_rover_sim.base.frames import wxyz_from_matrix
from lunar_rover_sim.products.usd.names import is_package, is_stage, parts_name, SUFFIXES

try:
    from pxr import (Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdSemantics, UsdShade,
                     UsdUtils, Vt)
except ImportError:
    raise UsdError(f"OpenUSD is missing; install it with: {with_extra('usd')} (Python 3.11 or "
                   'newer)') from None

__all__ = ['Gf', 'Kind', 'Sdf', 'Tf', 'Usd', 'UsdGeom', 'UsdLux', 'UsdPhysics', 'UsdSemantics',
           'UsdShade', 'UsdUtils', 'Vt']


# They have a meaning in the paths of assets.
_RESERVED = '@[]:'


def check_output(path: Path, overwrite: bool = False) -> None:
    """Raise UsdError where a stage cannot get this name."""
    if not is_stage(path):
        raise UsdError(f'{path}: {path.suffix or "no suffix"} is not valid; valid for a stage are '
                       + ', '.join(SUFFIXES))
    bad = sorted(set(path.name) & set(_RESERVED))
    if bad or not path.name.isprintable():
        raise UsdError(f'{path}: the name of a stage must not hold '
                       f'{" ".join(bad) or "control characters"}: OpenUSD reads that as part of '
                       'a path')
    if not path.parent.is_dir():
        raise UsdError(f'{path}: there is no folder {path.parent}')
    names = [path] if is_package(path) else [path, path.with_name(parts_name(path))]
    for taken in names:
        if not (taken.exists() or taken.is_symlink()):
            continue
        if not overwrite:
            raise UsdError(f'{taken}: exists already; choose another name or say --overwrite')
        if taken.is_dir() == (taken == path):
            raise UsdError(f'{taken}: exists already and is not what would be replaced; choose '
                           'another name')


def check_prim_name(name: str) -> str:
    """Return the name of a prim; raise UsdError where OpenUSD does not allow it."""
    if not Sdf.Path.IsValidIdentifier(name):
        raise UsdError(f'name: {brief(name)} is not valid; valid are letters, digits and _, not '
                       'beginning with a digit')
    return name


def write_stage(path: Path, compose: Callable[[Path, Path], None],
                overwrite: bool = False) -> Path:
    """Write a stage under `path`, its suffix being one of `SUFFIXES`.

    Args:
        compose: Called with the root layer that is to be written and the folder for the parts,
            which lies beside it and exists; it refers to the parts by `parts_name(path)`.

    Raises:
        UsdError: Where the name is not valid or taken, or a file cannot be written; what `compose`
            raises is passed on. Then nothing is left behind.
    """
    path = Path(path)
    check_output(path, overwrite)
    packed = is_package(path)
    try:
        with partial_folder(path, UsdError) as work:
            root = work / (path.with_suffix('.usdc').name if packed else path.name)
            parts = work / parts_name(path)
            parts.mkdir()
            compose(root, parts)
            if packed:
                package = work / path.name
                # It says nothing of a full disk: then the table at the end is missing.
                if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(root)), str(package)) \
                        or not zipfile.is_zipfile(package):
                    raise OSError('the package is not whole; is the disk full?')
                package.replace(path)
            else:
                _replace(parts, path.with_name(parts.name), work)
                root.replace(path)
    except Tf.ErrorException as error:
        # Others follow from the first one, and each has its place in the source of OpenUSD.
        reason = one_line(error.args[0].commentary)
        raise UsdError(f'{path}: cannot be written: {reason}') from None
    return path


def _replace(parts: Path, final: Path, work: Path) -> None:
    """Move the parts to their place, if there are any; older ones go to the temporary folder."""
    if final.exists():
        final.replace(work / 'replaced')
    if any(parts.iterdir()):
        parts.replace(final)


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
    set_faces(mesh, faces)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(points([vertices.min(axis=0), vertices.max(axis=0)]))
    return mesh


def set_faces(mesh: UsdGeom.Mesh, faces: NDArray[np.integer]) -> None:
    """Give a mesh its triangles, (m, 3) indices."""
    mesh.CreateFaceVertexCountsAttr(integers(np.full(len(faces), 3)))
    mesh.CreateFaceVertexIndicesAttr(integers(faces))


def set_texels(mesh: UsdGeom.Mesh, places: ArrayLike) -> None:
    """Give the vertices of a mesh their (n, 2) places in its texture."""
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        'st', Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex).Set(
            Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(places, np.float32)))


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
