"""Triangle meshes and points on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from .arrays import readonly


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points fixed to a surface: each in one triangle, by barycentric coordinates.

    Attributes
    ----------
    names : tuple of str, length N
    corners : (N, 3) int32
        Vertex indices of each point's triangle.
    barycentric : (N, 3) float64
        Weights of the corners; rows sum to 1.
    """

    names: tuple[str, ...]
    corners: NDArray[np.int32]
    barycentric: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.names)
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "corners", readonly(self.corners, (n, 3), "corners", np.int32))
        b = readonly(self.barycentric, (n, 3), "barycentric")
        if n and not np.allclose(b.sum(axis=1), 1, atol=1e-9):
            raise ValueError("barycentric coordinates must sum to 1")
        object.__setattr__(self, "barycentric", b)

    def __len__(self) -> int:
        return len(self.names)

    def at(self, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions on a surface whose vertices are (..., V, 3), mm: (..., N, 3)."""
        corners = vertices[..., self.corners, :]
        return np.asarray(np.einsum("nc,...ncx->...nx", self.barycentric, corners))

    def index(self, name: str) -> int:
        """Where `name` stands."""
        return self.names.index(name)

    def select(self, names: tuple[str, ...]) -> SurfacePoints:
        """Some of the points, in the order of `names`."""
        rows = [self.names.index(n) for n in names]
        return SurfacePoints(names, self.corners[rows], self.barycentric[rows])


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh. Holds arrays, does no input or output.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
    triangles : (F, 3) int32
        Counter-clockwise seen from outside.
    uv : (U, 2) float64 or None
        Texture coordinates, origin at the bottom left (OBJ's convention).
    uv_triangles : (F, 3) int32 or None
        Rows of `uv` for the corners of each triangle.
    groups : mapping from name to (n,) int32
        Triangle indices.
    landmarks : SurfacePoints or None
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    uv: NDArray[np.float64] | None = None
    uv_triangles: NDArray[np.int32] | None = None
    groups: Mapping[str, NDArray[np.int32]] = field(default_factory=dict)
    landmarks: SurfacePoints | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", readonly(self.vertices, (None, 3), "vertices"))
        triangles = readonly(self.triangles, (None, 3), "triangles", np.int32)
        _check_indices(triangles, len(self.vertices), "triangles")
        object.__setattr__(self, "triangles", triangles)
        if (self.uv is None) != (self.uv_triangles is None):
            raise ValueError("uv and uv_triangles come together")
        if self.uv is not None and self.uv_triangles is not None:
            uv_triangles = readonly(self.uv_triangles, triangles.shape, "uv_triangles", np.int32)
            object.__setattr__(self, "uv", readonly(self.uv, (None, 2), "uv"))
            _check_indices(uv_triangles, len(self.uv), "uv_triangles")
            object.__setattr__(self, "uv_triangles", uv_triangles)
        groups = {}
        for name, rows in self.groups.items():
            group = readonly(rows, (None,), f"group {name}", np.int32)
            _check_indices(group, len(triangles), f"group {name}")
            groups[name] = group
        object.__setattr__(self, "groups", MappingProxyType(groups))
        if self.landmarks is not None:
            _check_indices(self.landmarks.corners, len(self.vertices), "landmarks")


def _check_indices(indices: NDArray[np.int32], count: int, name: str) -> None:
    if indices.size and (indices.min() < 0 or indices.max() >= count):
        raise ValueError(f"{name} must lie in 0..{count - 1}, got {indices.min()}..{indices.max()}")


def vertex_normals(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Area-weighted unit normals, (V, 3); zero where a vertex has no triangle."""
    corners = vertices[triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    found = np.empty_like(vertices)
    for axis in range(3):
        per_corner = np.repeat(face[:, axis], 3)
        found[:, axis] = np.bincount(triangles.ravel(), per_corner, minlength=len(vertices))
    length = np.linalg.norm(found, axis=1, keepdims=True)
    return np.asarray(np.divide(found, length, out=np.zeros_like(found), where=length > 0))
