"""A surface to lay things on: closest points with their normals, and where its borders are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.mesh import SurfacePoints, vertex_normals
from .own_mesh import side_keys
from .raycast import RayScene

Floats = NDArray[np.float64]

_ON_BORDER = 1e-3


class Surface:
    """The skin that is laid onto: closest points, normals, and whether they are on a border.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    triangles : (F, 3) int32
        Counter-clockwise seen from outside.
    """

    def __init__(self, vertices: Floats, triangles: NDArray[np.int32]) -> None:
        self.vertices, self.triangles = vertices, triangles
        self.scene = RayScene(vertices, triangles)
        self.normals = vertex_normals(vertices, triangles)
        self._border = _border_sides(triangles)

    def closest(self, points: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Closest points (N, 3), unit normals there (N, 3), and whether each is on a border."""
        at, triangle, b = self.scene.closest(points)
        normals = np.einsum("nc,ncx->nx", b, self.normals[self.triangles[triangle]])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        on_border = (self._border[triangle] & (b < _ON_BORDER)).any(axis=1)
        return at, np.asarray(normals / np.maximum(length, 1e-12)), np.asarray(on_border)

    def points_at(self, names: tuple[str, ...], places: Floats) -> SurfacePoints:
        """The points of the surface that are closest to places (N, 3)."""
        _, triangle, b = self.scene.closest(places)
        b = np.clip(b, 0, 1)
        return SurfacePoints(names, self.triangles[triangle], b / b.sum(axis=1, keepdims=True))


def _border_sides(triangles: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(F, 3): whether the side opposite each corner belongs to no other triangle."""
    sides = np.stack([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]], axis=1)
    keys = side_keys(sides.reshape(-1, 2), int(triangles.max(initial=0)) + 1)
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    return np.asarray(counts[inverse].reshape(-1, 3) == 1)
