"""Tangents of a mesh, for the normal maps of .glb files (glTF 2.0, 3.7.2.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_TINY = 1e-20


def vertex_tangents(
    vertices: Floats, triangles: NDArray[np.int32], normals: Floats, uv: Floats
) -> Floats:
    """Where the texture's u grows along the surface, and on which side of it v does.

    A vertex's tangent is the sum of its triangles' directions of u, each weighted by the corner's
    angle, made perpendicular to the normal. Where a texture has no extent, any perpendicular.

    Parameters
    ----------
    vertices : (V, 3) float64
    triangles : (F, 3) int32
    normals : (V, 3) float64
        Unit length.
    uv : (V, 2) float64
        As glTF stores it: v grows downwards.

    Returns
    -------
    (V, 4) float64
        Unit tangent and +1 or -1: bitangent = cross(normal, tangent) times that, which points to
        where v shrinks (up in the picture).
    """
    corners, at = vertices[triangles], uv[triangles]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    s, t = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    area = s[:, 0] * t[:, 1] - t[:, 0] * s[:, 1]
    sign = np.where(area < 0, -1.0, 1.0)
    flat = np.abs(area) < _TINY
    along_u = _unit((a * t[:, 1:] - b * s[:, 1:]) * sign[:, None], flat)
    along_v = _unit((b * s[:, :1] - a * t[:, :1]) * sign[:, None], flat)
    angle = _corner_angles(corners)
    u = _gathered(along_u, angle, triangles, len(vertices))
    up = -_gathered(along_v, angle, triangles, len(vertices))
    tangent = u - normals * (u * normals).sum(axis=1, keepdims=True)
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    lost = length[:, 0] < 1e-9
    tangent = np.where(lost[:, None], _perpendicular(normals), tangent / np.maximum(length, 1e-9))
    side = np.where((np.cross(normals, tangent) * up).sum(axis=1) < 0, -1.0, 1.0)
    return np.concatenate([tangent, side[:, None]], axis=1)


def _unit(vectors: Floats, is_flat: NDArray[np.bool_]) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    found = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    return np.where(is_flat[:, None], 0.0, found)


def _corner_angles(corners: Floats) -> Floats:
    """(F, 3) rad."""
    found = np.zeros(corners.shape[:2])
    for k in range(3):
        p = corners[:, (k + 1) % 3] - corners[:, k]
        q = corners[:, (k + 2) % 3] - corners[:, k]
        found[:, k] = np.arctan2(np.linalg.norm(np.cross(p, q), axis=1), (p * q).sum(axis=1))
    return found


def _gathered(
    of_triangles: Floats, angle: Floats, triangles: NDArray[np.int32], count: int
) -> Floats:
    """Sums at the vertices, (count, 3)."""
    shares = (of_triangles[:, None] * angle[..., None]).reshape(-1, 3)
    rows = triangles.ravel()
    return np.stack([np.bincount(rows, shares[:, k], minlength=count) for k in range(3)], axis=1)


def _perpendicular(normals: Floats) -> Floats:
    """Unit vectors across each normal."""
    other = np.where(np.abs(normals[:, :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    found = np.cross(normals, other)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))
