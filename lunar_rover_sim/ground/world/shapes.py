"""The library of rock shapes: fresh angular blocks, and old ones that are rounded.

Fragments of impacts have mean axes of 2 : 1.4 : 1 (Fujiwara, Kamimoto and Tsukamoto 1978), so
b / a = 0.7 and c / a = 0.5, with a spread of about 0.13 each (Capaccioni et al. 1984; Michikami et
al. 2016). Rocks on the Moon stand 0.6 of their visible diameter high or less (Demidov and
Basilevsky 2014), more than fragments that all lie flat: half of the angular shapes stand on an
edge, which is a choice. Fresh blocks are bounded by a few broken faces with sharp edges, "very
angular" to "sub-angular" in the classes of Powers (1953), whose corners have 0.12 to 0.35 of the
radius of the largest ball within. Meteoroids round them at about 1 mm in a million years (Hoerz et
al. 1974) to "sub-rounded" and "rounded", 0.35 to 0.7. Number of shapes, of faces and of ledges are
choices, and so are the figures below that have no source.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray
import scipy  # its parts when they are used

from lunar_rover_sim.ground.world.grid import on_lattice
from lunar_rover_sim.ground.world.rocks import RockShape

Array = NDArray[np.float64]

ANGULAR, ROUNDED = 'angular', 'rounded'
KINDS = {ANGULAR: (7, 5), ROUNDED: (5, 3)}      # shapes of one piece, and of several
LEDGES_M = 0.12         # diameter from which rocks may have several pieces, a choice
_STEP = 2.0**-20        # lattice of the corners
_SEED = 1969            # the library is the same in all worlds, so that meshes can be shared
_OVERLAP = 0.12         # of pieces that lie on each other, in half diameters
_SURE = 1e-6            # far more than rounding
_BLUNT = 0.85           # cosine between faces whose edge is left as it is
_ROOM, _TRIES = 0.06, 200       # within a block, in half diameters, and steps to find it


@functools.cache
def library() -> tuple[RockShape, ...]:
    """Return the shapes: the same ones at every call."""
    rng = np.random.default_rng(_SEED)
    shapes = []
    for kind, (single, several) in KINDS.items():
        for i in range(single + several):
            make = _angular if kind == ANGULAR else _rounded
            shapes.append(shape_of(f'{kind}_{i:02d}', make(rng, i >= single, i % 2 == 1)))
    return tuple(shapes)


def chosen(shapes: tuple[RockShape, ...], angular: float, diameter_m: Array,
           chance: Array) -> NDArray[np.int64]:
    """Return the (m,) shapes of rocks.

    Args:
        angular: Share of angular ones, where the shapes are those of the library.
        diameter_m: (m,); small rocks are of one piece.
        chance: (m,) uniform from 0 to 1.
    """
    result = np.zeros(len(chance), np.int64)
    fresh = np.array([shape.name.startswith(ANGULAR) for shape in shapes], bool)
    if not fresh.any() or fresh.all():
        angular = float(fresh.any())
    single = np.array([len(shape.pieces) < 2 for shape in shapes], bool)
    is_fresh = chance < angular
    rank = np.where(is_fresh, chance / max(angular, _SURE),
                    (chance - angular) / max(1.0 - angular, _SURE))
    for kind in (True, False):
        for small in (True, False):
            members = (is_fresh == kind) & ((diameter_m < LEDGES_M) == small)
            index = np.flatnonzero((fresh == kind) & (single | (not small)))
            if members.any():
                result[members] = index[np.minimum((rank[members] * len(index)).astype(np.int64),
                                                   len(index) - 1)]
    return result


def shape_of(name: str, pieces: list[Array]) -> RockShape:
    """Return the convex hulls of some (n, 3) points as one shape, faces in a fixed order.

    The centroid of the hull of all is moved to the origin, and its largest horizontal diameter is
    scaled to 1.
    """
    everything = np.concatenate(pieces)
    centroid = _centroid(everything)
    flat = everything[:, :2]
    diameter = np.linalg.norm(flat[:, None] - flat[None], axis=-1).max()
    vertices, faces, count = [], [], 0
    for points in pieces:
        # Rounded first: then the hull is convex to the last bit.
        unit = on_lattice((points - centroid) / diameter, _STEP)
        triangles = _in_order(hull_faces(unit))
        used = np.unique(triangles)
        vertices.append(unit[used].astype(np.float32))
        faces.append((np.searchsorted(used, triangles) + count).astype(np.int32))
        count += len(used)
    result = RockShape(name, np.concatenate(vertices), np.concatenate(faces),
                       tuple(len(part) for part in faces) if len(faces) > 1 else ())
    result.vertices.setflags(write=False)
    result.faces.setflags(write=False)
    return result


def _centroid(points: Array) -> Array:
    """Return the centroid of the convex hull of points."""
    # Signed tetrahedra from the origin give volume and centroid.
    corners = points[hull_faces(points)]
    volume = np.einsum('ij,ij->i', corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return np.asarray((volume[:, None] * corners.sum(axis=1)).sum(axis=0) / (4.0 * volume.sum()))


def hull_faces(points: Array) -> NDArray[np.integer[Any]]:
    """Return the (f, 3) triangles of the convex hull of (n, 3) points.

    They index the points, counter-clockwise seen from outside.
    """
    shell = scipy.spatial.ConvexHull(points)
    faces = shell.simplices.copy()
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum('ij,ij->i', normals, shell.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return faces


def _in_order(faces: NDArray[np.integer[Any]]) -> NDArray[np.integer[Any]]:
    """Return triangles sorted by their corners, the least first; their sense stays."""
    turned = np.array([np.roll(face, -int(face.argmin())) for face in faces])
    return turned[np.lexsort(turned.T[::-1])]


def _axes(rng: np.random.Generator, on_edge: bool) -> Array:
    """Return the (3,) axes of a fragment as it lies: the shortest one up, or across.

    They are those of a box around it; cut at the corners, it is shorter along its diagonals, so
    that its longest, middle and shortest diameters have the measured ratios.
    """
    b = float(np.clip(rng.normal(0.65, 0.12), 0.5, 0.95))
    c = float(np.clip(rng.normal(0.52, 0.09), 0.4, b))
    return np.array([1.0, c, b] if on_edge else [1.0, b, c])


def _laid(pieces: list[Array], axes: Array, rpy_rad: Array) -> list[Array]:
    """Return (n, 3) points of pieces that together are as long as the axes, turned."""
    turn = scipy.spatial.transform.Rotation.from_euler('xyz', rpy_rad).as_matrix()
    scale = 2.0 * axes / np.ptp(np.concatenate(pieces), axis=0)
    return [np.einsum('ij,nj->ni', turn, points * scale) for points in pieces]


def _angular(rng: np.random.Generator, ledges: bool, on_edge: bool) -> list[Array]:
    """Return the corners of the pieces of a broken block.

    Three sets of fractures, nearly at right angles, bound it, and a few more cut its corners. With
    ledges it has parted along one set, and what lies above the parting has lost a side.
    """
    planes = _fractures(rng)
    groups = [planes]
    if ledges:
        parting = planes[4, :3] + rng.normal(0.0, 0.15, 3)      # near the face that is up
        parting /= np.linalg.norm(parting)
        at = rng.uniform(-0.3, 0.15)
        below, above = (np.append(parting, at), np.append(-parting, _OVERLAP - at))
        groups = [np.vstack([planes, below])]
        for _ in range(int(rng.integers(1, 3))):
            # It stands back a little on all sides, and far where a part has broken off.
            back = planes * [1.0, 1.0, 1.0, rng.uniform(0.85, 0.98)]
            azimuth = rng.uniform(-np.pi, np.pi) + np.array([0.0, rng.uniform(1.2, 2.4)])
            lost = np.column_stack([np.cos(azimuth), np.sin(azimuth), rng.uniform(-0.1, 0.8, 2)])
            lost /= np.linalg.norm(lost, axis=1, keepdims=True)
            lost = np.column_stack([lost, rng.uniform([0.1, 0.35], [0.4, 0.7])])
            groups.append(np.vstack([back, above, lost]))
    axes, tilt = _axes(rng, on_edge), rng.uniform(-0.3, 0.3, 3)
    worn = rng.uniform(0.012, 0.04)
    pieces = _laid([_corners(_bevelled(rng, group, worn)) for group in groups], axes, tilt)
    z = pieces[0][:, 2]
    if not ledges and 2.0 * _centroid(pieces[0])[2] > z.min() + z.max():
        pieces = [pieces[0] * [1.0, -1.0, -1.0]]        # it comes to rest on its broader side
    return pieces


def _fractures(rng: np.random.Generator) -> Array:
    """Return (n, 4) planes n . x = d that bound a block with half axes of about 1."""
    sides = np.repeat(np.eye(3), 2, axis=0) * np.tile([[1.0], [-1.0]], (3, 1))
    sides = sides + rng.normal(0.0, 0.25, (6, 3))
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    sides = np.column_stack([sides, rng.uniform(0.6, 0.92, 6)])
    # Breaks are not even: a part of each side leans by another ten to twenty degrees.
    bent = sides[:, :3] + rng.normal(0.0, 0.2, (6, 3))
    bent = np.column_stack([bent, sides[:, 3] + rng.uniform(0.0, 0.12, 6)])
    count = int(rng.integers(3, 6))
    cuts = np.column_stack([_spread(rng, count, jitter=0.9), rng.uniform(0.7, 0.95, count)])
    planes = np.vstack([sides, bent, cuts])
    planes[:, :3] /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    return planes


def _corners(planes: Array) -> Array:
    """Return the (n, 3) corners of what lies within (p, 4) planes; (0, 0, 0) need not."""
    normal, distance = planes[:, :3], planes[:, 3]
    # A place well within: away from each plane that is near, again and again.
    middle = np.zeros(3)
    for _ in range(_TRIES):
        room = distance - np.einsum('pi,i->p', normal, middle)
        nearest = int(room.argmin())
        middle = middle - max(_ROOM - room[nearest], 0.0) * normal[nearest]
    middle = on_lattice(middle, _STEP)
    corners = scipy.spatial.HalfspaceIntersection(
        np.column_stack([normal, -distance]), middle).intersections
    # Qhull finds each corner more than once, in an order of its own.
    return np.unique(on_lattice(corners[np.all(np.isfinite(corners), axis=1)], _STEP), axis=0)


def _bevelled(rng: np.random.Generator, planes: Array, worn: float) -> Array:
    """Return planes and those that take off their edges, by about `worn`, each by its own."""
    corners = _corners(planes)
    on = np.abs(corners @ planes[:, :3].T - planes[:, 3]) < 16.0 * _STEP
    bevels = []
    for i in range(len(planes)):
        for j in range(i):
            share = worn * np.exp(rng.normal(0.0, 0.5))
            if (on[:, i] & on[:, j]).sum() < 2 or planes[i, :3] @ planes[j, :3] > _BLUNT:
                continue
            normal = planes[i, :3] + planes[j, :3]
            length = np.linalg.norm(normal)
            edge = (corners[on[:, i] & on[:, j]] @ normal).mean() / length
            bevels.append(np.append(normal / length, edge - share))
    return np.vstack([planes, *bevels])


def _rounded(rng: np.random.Generator, lumps: bool, _: bool) -> list[Array]:
    """Return points of the pieces of an old block: the same fractures, their edges worn round.

    With lumps harder parts stand out of it, as clasts of a breccia do.
    """
    axes, tilt = _axes(rng, False), rng.uniform(-0.35, 0.35, 3)
    body = _worn(rng, rng.uniform(5.0, 11.0), 84)
    pieces = [body]
    for _lump in range(int(rng.integers(1, 4)) if lumps else 0):
        upper = body[body[:, 2] > -0.1]
        place = rng.uniform(0.75, 0.9) * upper[int(rng.integers(len(upper)))]
        pieces.append(place + rng.uniform(0.35, 0.5) * _worn(rng, rng.uniform(5.0, 9.0), 48))
    return _laid(pieces, axes, tilt)


def _worn(rng: np.random.Generator, sharpness: float, count: int) -> Array:
    """Return (count, 3) points of a convex body: planes that blend at the edges.

    One over the distance is the norm of the positive parts of n . x / d, which is convex.
    """
    planes, rays = _fractures(rng), _spread(rng, count, jitter=0.35)
    ratio = np.maximum(np.einsum('ri,pi->rp', rays, planes[:, :3]), 0.0) / planes[:, 3]
    size = np.exp(np.log(np.sum(np.exp(sharpness * np.log(np.maximum(ratio, _SURE))), axis=1))
                  / sharpness)
    return rays / size[:, None]


def _spread(rng: np.random.Generator, count: int, jitter: float = 0.45) -> Array:
    """Return (count, 3) unit vectors: a Fibonacci lattice, randomly turned and jittered."""
    i = np.arange(count) + 0.5
    z = 1.0 - 2.0 * i / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * i
    ring = np.sqrt(1.0 - z * z)
    vectors = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])
    scale = jitter * np.sqrt(4.0 * np.pi / count)
    turn = scipy.spatial.transform.Rotation.from_rotvec(rng.uniform(-np.pi, np.pi, 3))
    vectors = np.einsum('ij,nj->ni', turn.as_matrix(), vectors)
    vectors += scale * rng.uniform(-0.5, 0.5, vectors.shape)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
