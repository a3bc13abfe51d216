"""Points placed by geometry alone: in the mouth's cavity, and where the skin's motion ends."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..core.mesh import SurfacePoints, vertex_normals
from ..heads.head import Head
from ..heads.raycast import NO_HIT, RayScene
from .surface_weights import surface_distances

#: How far the skin's motion reaches beyond the points that move, on a head of average size.
RING_MM = 46.0
RING_SPACING_MM = 24.0
_RING_WIDTH_MM = 14.0
#: Skin further than this from all points that move stays where it is.
REACH_MM = RING_MM + _RING_WIDTH_MM
CAVITY_SPACING_MM = 11.0
_CAVITY_FROM_LIPS_MM = 9.0
AVERAGE_EYE_SEPARATION_MM = 61.5


def joined_points(first: SurfacePoints, more: Iterable[SurfacePoints]) -> SurfacePoints:
    """Points one after the other."""
    parts = [first, *more]
    return SurfacePoints(
        tuple(n for p in parts for n in p.names),
        np.concatenate([p.corners for p in parts]),
        np.concatenate([p.barycentric for p in parts]),
    )


def size_of(head: Head) -> float:
    """A head's size relative to the average."""
    return head.fapu.es / AVERAGE_EYE_SEPARATION_MM


def mouth_cavity(head: Head, skin: NDArray[np.int32]) -> NDArray[np.int64]:
    """Vertices of the skin that line the mouth inside; none if the head has no cavity.

    They lie in a box behind the lips, and the way along their normal is barred by skin.
    """
    p, s, v = head.points, size_of(head), head.mesh.vertices
    if not {"2.2", "2.3", "8.3", "8.4"} <= set(p):
        return np.zeros(0, dtype=np.int64)
    lips = (p["2.2"] + p["2.3"]) / 2
    half = (p["8.3"][0] - p["8.4"][0]) / 2
    used = np.unique(skin)
    q = v[used] - lips
    box = (np.abs(q[:, 0]) < 1.4 * half) & (np.abs(q[:, 1]) < 28 * s)
    box &= (q[:, 2] < -4 * s) & (q[:, 2] > -75 * s)
    candidates = used[box]
    if not len(candidates):
        return np.zeros(0, dtype=np.int64)
    normals = vertex_normals(v, skin)[candidates]
    t, hit, _ = RayScene(v, skin).cast(v[candidates] + 0.05 * normals, normals)
    inside = (hit != NO_HIT) & (t < 45 * s)
    return np.asarray(candidates[inside], dtype=np.int64)


def mouth_points(
    head: Head, skin: NDArray[np.int32], cavity: NDArray[np.int64]
) -> tuple[SurfacePoints, dict[str, str]]:
    """Points in the mouth: below the line of the lips carried by the jaw, above it still."""
    v, s = head.mesh.vertices, size_of(head)
    near = ("2.2", "2.3", "2.4", "2.5", "2.6", "2.7", "2.8", "2.9")
    lip_points = head.feature_points.select(tuple(n for n in near if n in head.points))
    if not len(cavity) or not len(lip_points):
        return SurfacePoints((), np.zeros((0, 3), np.int32), np.zeros((0, 3))), {}
    from_lips = surface_distances(v, skin, lip_points).nearest()[0]
    inside = cavity[from_lips[cavity] > _CAVITY_FROM_LIPS_MM * s]
    chosen = _spaced(v, inside, CAVITY_SPACING_MM * s)
    line = (head.points["2.2"][1] + head.points["2.3"][1]) / 2
    letters = {f"mouth.{i}": "JJJ" if v[c, 1] < line else "SSS" for i, c in enumerate(chosen)}
    return points_at_vertices(tuple(letters), chosen, skin), letters


def ring_points(
    head: Head,
    skin: NDArray[np.int32],
    placed: SurfacePoints,
    letters: dict[str, str],
    cavity: NDArray[np.int64],
) -> SurfacePoints:
    """Still points where the skin's motion ends: on scalp, temples and neck."""
    v, s = head.mesh.vertices, size_of(head)
    of_face = tuple(
        n for n in placed.names if set(letters[n]) - {"S", "-"} and not n.startswith("10.")
    )
    nearest = surface_distances(v, skin, placed.select(of_face)).nearest()[0]
    beyond = (nearest > RING_MM * s) & (nearest < (RING_MM + _RING_WIDTH_MM) * s)
    beyond[cavity] = False
    rows = np.flatnonzero(beyond)
    chosen = _spaced(v, rows, RING_SPACING_MM * s)
    return points_at_vertices(tuple(f"ring.{i}" for i in range(len(chosen))), chosen, skin)


def _spaced(
    v: NDArray[np.float64], rows: NDArray[np.int64], spacing_mm: float
) -> NDArray[np.int64]:
    """Some of the vertices, as far from each other as possible, down to a spacing."""
    if not len(rows):
        return np.asarray(rows)
    chosen = [int(np.argmin(v[rows, 1]))]
    distance = np.linalg.norm(v[rows] - v[rows[chosen[0]]], axis=1)
    while distance.max() > spacing_mm:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(v[rows] - v[rows[chosen[-1]]], axis=1))
    return np.asarray(rows[chosen])


def points_at_vertices(
    names: tuple[str, ...], vertices: NDArray[np.int64], skin: NDArray[np.int32]
) -> SurfacePoints:
    """Points at vertices, each in one of the triangles around it."""
    flat = skin.ravel()
    _, first = np.unique(flat, return_index=True)
    where = first[np.searchsorted(np.unique(flat), vertices)]
    triangles, corner = skin[where // 3], where % 3
    return SurfacePoints(names, np.asarray(triangles, dtype=np.int32), np.eye(3)[corner])
