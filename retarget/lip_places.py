"""Places on the two lips that lie at each other where the mouth is closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from ..core.mesh import SurfacePoints
from ..heads.head import Head
from ..heads.raycast import NO_HIT, RayScene
from .boundary_points import size_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Triangles = NDArray[np.int32]

#: Corners of the mouth, right and left.
CORNERS = ("2.5", "2.4")
#: Points of the two lips: what lies nearer to the one, along the surface, is not on the other.
_LIPS = (("2.2", "2.6", "2.7"), ("2.3", "2.8", "2.9"))
#: On a head of average size: how far apart places are; how near to the corners they go; how far
#: the seam is looked for above and below the feature points, and how far behind them it may lie.
_SPACING_MM, _FROM_CORNER_MM, _LOOK_MM, _DEEP_MM = 2.2, 1.0, 5.0, 5.0
#: A correction is whole up to this way from the seam along the lip, and ends at that one.
_WHOLE_MM, _REACH_MM = 5.0, 12.0
#: Width of a correction along the seam, in spacings.
_BELL = 0.6
_STEP_MM, _FAR_MM = 0.04, 500.0


@dataclass(frozen=True, eq=False)
class LipPlaces:
    """S places along the seam of the lips, from right to left.

    Attributes
    ----------
    x : (S,) float64, mm
    upper, lower : SurfacePoints
        S points each: where each lip's edge is seen.
    slit_mm : (S,) float64
        Height of the opening between them at rest.
    upper_spread, lower_spread : (V, S) sparse
        How a correction at a place spreads over its lip.
    upper_reached, lower_reached : (S, S) float64
        Row s: what the spreads do at place s.
    """

    x: Floats
    upper: SurfacePoints
    lower: SurfacePoints
    slit_mm: Floats
    upper_spread: sparse.csr_matrix
    lower_spread: sparse.csr_matrix
    upper_reached: Floats
    lower_reached: Floats


def find_lip_places(head: Head) -> LipPlaces | None:
    """Places along a head's seam; None if it lacks feature points, or no seam is seen."""
    own, v, size = head.points, head.mesh.vertices, size_of(head)
    if not {*CORNERS, "2.2", "2.3"} <= set(own):
        return None
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    right, left = (own[n][0] for n in CORNERS)
    ends = (right + _FROM_CORNER_MM * size, left - _FROM_CORNER_MM * size)
    if ends[1] - ends[0] < 4 * _SPACING_MM * size:
        return None
    x = np.linspace(*ends, round((ends[1] - ends[0]) / (_SPACING_MM * size)) + 1)
    away = _away_from_lips(head, skin)
    is_upper = (away[0] < away[1])[skin]
    kept = np.isfinite(away.min(axis=0))[skin].all(axis=1)
    lips = skin[kept & is_upper.all(axis=1)], skin[kept & ~is_upper.any(axis=1)]
    seen = _edges(head, lips, x)
    is_seen = np.isfinite(seen).all(axis=(0, 2))
    if is_seen.sum() < 3:
        return None
    x, seen = x[is_seen], seen[:, is_seen]
    upper, lower = (_on(v, lip, at) for lip, at in zip(lips, seen, strict=True))
    spread_upper, spread_lower = (
        _spread(v, lip, p, x, size) for lip, p in zip(lips, (upper, lower), strict=True)
    )
    return LipPlaces(
        x=x,
        upper=upper,
        lower=lower,
        slit_mm=np.maximum(seen[0, :, 1] - seen[1, :, 1] - _STEP_MM, 0.0),
        upper_spread=spread_upper,
        lower_spread=spread_lower,
        upper_reached=_reached(spread_upper, upper),
        lower_reached=_reached(spread_lower, lower),
    )


def _reached(spread: sparse.csr_matrix, places: SurfacePoints) -> Floats:
    """(S, S): row s: what the spreads do at place s."""
    found = np.zeros((len(places), spread.shape[1]))
    for corner in range(3):
        rows = spread[places.corners[:, corner]].toarray()
        found += places.barycentric[:, corner, None] * rows
    return found


def _away_from_lips(head: Head, skin: Triangles) -> Floats:
    """(2, V): way along the mesh from the upper and from the lower lip's points, mm."""
    graph = _graph(head.mesh.vertices, skin)
    limit = 40.0 * size_of(head)
    found = []
    for lip in _LIPS:
        names = tuple(n for n in lip if n in head.points)
        rows = np.unique(head.feature_points.select(names).corners)
        found.append(dijkstra(graph, indices=rows, limit=limit, min_only=True))
    return np.stack(found)


def _graph(v: Floats, triangles: Triangles) -> sparse.csr_matrix:
    pairs = np.concatenate([triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    lengths = np.linalg.norm(v[pairs[:, 0]] - v[pairs[:, 1]], axis=1)
    half = sparse.csr_matrix((lengths, (pairs[:, 0], pairs[:, 1])), (len(v), len(v)))
    return (half + half.T).tocsr()


def _edges(head: Head, lips: tuple[Triangles, Triangles], x: Floats) -> Floats:
    """(2, S, 3) mm: the lowest of the upper lip and the highest of the lower one that is seen.

    NaN where either is not seen.
    """
    size, own = size_of(head), head.points
    known = [n for lip in _LIPS for n in lip if n in own] + list(CORNERS)
    knots = np.array(sorted((own[n] for n in known), key=lambda p: float(p[0])))
    middle = np.interp(x, knots[:, 0], knots[:, 1])
    back = np.interp(x, knots[:, 0], knots[:, 2]) - _DEEP_MM * size
    rise = np.arange(-_LOOK_MM * size, _LOOK_MM * size, _STEP_MM)
    start = np.full((len(x), len(rise), 3), _FAR_MM)
    start[:, :, 0], start[:, :, 1] = x[:, None], middle[:, None] + rise
    flat = start.reshape(-1, 3)
    both = np.concatenate(lips)
    t, hit, _ = RayScene(head.mesh.vertices, both).cast(
        flat, np.tile([0.0, 0.0, -1.0], (len(flat), 1))
    )
    z = (_FAR_MM - t).reshape(start.shape[:2])
    is_lip = (hit != NO_HIT).reshape(z.shape) & (z > back[:, None])
    is_upper = is_lip & (hit < len(lips[0])).reshape(z.shape)
    is_lower = is_lip & ~is_upper
    found = np.full((2, len(x), 3), np.nan)
    rows = np.arange(len(x))
    last = z.shape[1] - 1
    for k, (mask, at) in enumerate(
        ((is_upper, is_upper.argmax(axis=1)), (is_lower, last - is_lower[:, ::-1].argmax(axis=1)))
    ):
        ok = mask.any(axis=1)
        found[k, ok] = np.stack([x, start[rows, at, 1], z[rows, at]], axis=1)[ok]
    return found


def _on(v: Floats, triangles: Triangles, at: Floats) -> SurfacePoints:
    _, triangle, b = RayScene(v, triangles).closest(at)
    b = b / b.sum(axis=1, keepdims=True)
    names = tuple(str(k) for k in range(len(at)))
    return SurfacePoints(names, triangles[triangle], b)


def _spread(
    v: Floats, lip: Triangles, places: SurfacePoints, x: Floats, size: float
) -> sparse.csr_matrix:
    """(V, S): bells along the seam that fade out across the lip."""
    away = dijkstra(
        _graph(v, lip), indices=np.unique(places.corners), limit=_REACH_MM * size, min_only=True
    )
    near = np.flatnonzero(np.isfinite(away))
    t = np.clip((_REACH_MM * size - away[near]) / ((_REACH_MM - _WHOLE_MM) * size), 0.0, 1.0)
    fade = t * t * (3 - 2 * t)
    spacing = float(np.median(np.diff(x)))
    bell = np.exp(-0.5 * ((v[near, 0][:, None] - x) / (_BELL * spacing)) ** 2)
    total = bell.sum(axis=1, keepdims=True)
    inside = total[:, 0] > 0.1
    rows = near[inside]
    dense = (fade[:, None] * bell / np.maximum(total, 1.0))[inside]
    dense[dense < 1e-3] = 0.0
    entries = sparse.coo_matrix(dense)
    return sparse.csr_matrix((entries.data, (rows[entries.row], entries.col)), (len(v), len(x)))
