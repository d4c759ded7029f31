"""Rocks: their places, and the shapes of which they are instances."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray


def numbered(count: int) -> NDArray[np.uint64]:
    """Return keys for things that are in no site, read-only."""
    keys = np.arange(count, dtype=np.uint64)
    keys.setflags(write=False)
    return keys


@dataclasses.dataclass(frozen=True)
class RockShape:
    """One or several convex, closed triangle meshes; together their largest diameter is 1.

    They overlap, so that a rock of several pieces has ledges and notches. Its surface is what is
    outermost. The largest diameter is the horizontal one.

    Attributes:
        vertices: (v, 3) float32, centred on the centroid of the hull of all pieces.
        faces: (f, 3) int32, counter-clockwise seen from outside, one piece after the other.
        pieces: Number of faces of each piece, which shares no vertex with another one; empty where
            all are one piece.
    """

    name: str
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    pieces: tuple[int, ...] = ()

    def convex(self) -> tuple[RockShape, ...]:
        """Return the pieces as shapes of their own, in the axes of this one."""
        if len(self.pieces) < 2:
            return self,
        parts = []
        for faces in np.split(self.faces, np.cumsum(self.pieces)[:-1]):
            used, numbers = np.unique(faces, return_inverse=True)
            parts.append(RockShape(self.name, self.vertices[used],
                                   numbers.reshape(-1, 3).astype(np.int32)))
        return tuple(parts)


@dataclasses.dataclass(frozen=True)
class Rocks:
    """Instances of the shapes; arrays of equal length m, read-only.

    Attributes:
        shape: (m,) int32 index into the shape library.
        size: (m,) int32 index into `size_classes_m`.
        position_m: (m, 3) float64 centroid, world frame.
        orientation_wxyz: (m, 4) float64.
        albedo: (m,) float32 factor on the single-scattering albedo of the rock parameter set.
        size_classes_m: (k,) diameters [m]; sizes come in classes so that physics and camera can
            share one mesh among many rocks.
        key: (m,) uint64 that a rock keeps in all windows of its site: the key of its looks. Rocks
            made without keys are numbered.
    """

    shape: NDArray[np.int32]
    size: NDArray[np.int32]
    position_m: NDArray[np.float64]
    orientation_wxyz: NDArray[np.float64]
    albedo: NDArray[np.float32]
    size_classes_m: NDArray[np.float64]
    key: NDArray[np.uint64] = dataclasses.field(default_factory=lambda: np.zeros(0, np.uint64))

    def __post_init__(self) -> None:
        if len(self.key) != len(self.shape):
            object.__setattr__(self, 'key', numbered(len(self.shape)))

    def joined(self, others: Rocks) -> Rocks:
        """Return these rocks and then others, which have the same classes of size."""
        return dataclasses.replace(self, **{
            name: np.concatenate([getattr(self, name), getattr(others, name)])
            for name in _OF_EACH})

    def select(self, chosen: NDArray) -> Rocks:
        """Return the rocks at the chosen indices, or where a mask is true."""
        return dataclasses.replace(self, **{name: getattr(self, name)[chosen]
                                            for name in _OF_EACH})

    def __len__(self) -> int:
        return len(self.shape)

    @property
    def diameter_m(self) -> NDArray[np.float64]:
        """(m,) diameter of each rock [m]: the factor on its unit shape."""
        return self.size_classes_m[self.size]

    def in_pieces(self, shapes: tuple[RockShape, ...]) -> tuple[Rocks, tuple[RockShape, ...],
                                                                NDArray[np.int64]]:
        """Return each piece as a rock, the shapes that these index, and (n,) whose it is."""
        parts = [shape.convex() for shape in shapes]
        counts = np.array([len(part) for part in parts], np.int64)
        number = counts[self.shape]
        owner = np.repeat(np.arange(len(self)), number)
        within = np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number)
        first = np.cumsum(counts) - counts
        rocks = dataclasses.replace(
            self.select(owner), shape=(first[self.shape[owner]] + within).astype(np.int32))
        return rocks, tuple(piece for part in parts for piece in part), owner


_OF_EACH = [field.name for field in dataclasses.fields(Rocks) if field.name != 'size_classes_m']
