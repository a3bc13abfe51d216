"""The edges of the lids on a mesh, and what it takes to move them exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import gaussian_filter1d
from scipy.sparse.csgraph import dijkstra

from ..core.mesh import vertex_normals
from ..heads.head import Eye, Head
from ..heads.raycast import RayScene
from .lid_points import EDGE_MM, PRESS_MM, lid_opening
from .lid_silhouette import LidSilhouette, lid_triangles

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: What is near the lids, in eyeball radii: across beyond the opening, and how high and deep.
_BESIDE, _HIGH, _DEEP = 0.45, 1.5, -0.2
#: A path along the mesh shuns places this far from the visible edge.
_OFF_EDGE_MM = 0.35
#: Depth behind it counts less.
_DEPTH_COUNTS = 2.5
_FAR_MM = 500.0
#: Corrections fade out over this distance from the edge, in eyeball radii.
_REACH = 0.5
#: Lids keep this far from the eyeball where they were further at rest.
_SLIDING_MM = 0.3
#: The eyeball counts as thick as within these angles above and below: a turned cornea.
_CORNEA_RAD = np.radians(np.linspace(-25.0, 25.0, 7))
_SMOOTH_MM = 0.3
#: How often the edge is looked at and put right, where the opening is higher than this.
_LOOKS, _OPEN_MM = 6, 0.4
#: Closed lids overlap less where they have a shorter way than this.
_PRESSED_MM = 4.0
#: What is put right at the ends of the opening fades out beside it over this distance.
_BESIDE_MM = 0.5
#: Width of an edge vertex's influence along the edge, in spacings; and what keeps it calm where
#: vertices crowd.
_BELL, _RIDGE = 0.7, 0.01


@dataclass(frozen=True, eq=False)
class LidEdges:
    """The edges of one eye's lids.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
        Of the head at rest.
    centre : (3,) float64, mm
        Of the eye.
    columns : (C,) float64, mm
        Places x across the opening, from where it begins to where it ends.
    gaps : (C,) float64, mm
        What there is to close.
    heights : (C, 2) float64, mm
        Where the upper and the lower lid's edge is seen.
    upper, lower : (n,) int64
        Vertices along the edges, from one corner to the other; corners are in neither.
    near : (K,) int64
        Vertices that corrections may move.
    spread : mapping from is upper to (K, n) float64
        What a residual at the edge does to the vertices near.
    outside : (K,) bool
        Whether a vertex is on the outer side of a lid.
    clear : (K,) float64, mm
        How far it is from the eyeball.
    globe : RayScene
        The eyeball.
    silhouettes : mapping from is upper to LidSilhouette
    """

    vertices: Floats
    centre: Floats
    columns: Floats
    gaps: Floats
    heights: Floats
    upper: Ints
    lower: Ints
    near: Ints
    spread: dict[bool, Floats]
    outside: NDArray[np.bool_]
    clear: Floats
    globe: RayScene
    silhouettes: dict[bool, LidSilhouette]

    def gap_mm(self, x: Floats | float) -> Floats:
        """What there is to close at x; 0 beside the opening."""
        return np.asarray(np.interp(x, self.columns, self.gaps, left=0.0, right=0.0))

    def correction(self, made: Floats, part: float, *, upper: bool) -> Floats:
        """What is missing where one lid has gone a part of its way, and the other rests.

        Parameters
        ----------
        made : (V, 3) float64, mm
            Displacements so far.
        part : float
            0 at rest to 1 where it meets the other.
        upper : bool

        Returns
        -------
        (K, 3) float64, mm
            For the vertices `near`; 0 in x.
        """
        moving, resting = (self.upper, self.lower) if upper else (self.lower, self.upper)
        missing = self.spread[upper] @ (self._wanted(moving, part, upper) - made[moving])
        missing += self.spread[not upper] @ -made[resting]  # the other lid rests
        missing[:, 0] = 0.0
        at = self.vertices[self.near] + made[self.near] + missing
        missing[:, 1:] += self._lift(at)[:, 1:]
        for _ in range(_LOOKS):
            at = self.vertices + made
            at[self.near] += missing
            missing[:, 1] -= self._seen_off(at, part, upper)
        return missing

    def _seen_off(self, at: Floats, part: float, upper: bool) -> Floats:
        """How far too high the edge of one lid is seen, spread over the lid, (K,) mm.

        `at`: all vertices, (V, 3) mm; `part`: of its way that the lid should have gone.
        """
        own = self.heights[:, 0 if upper else 1]
        rise = (-part if upper else part) * (self.gaps + _press_mm(self.gaps))
        wanted = np.where(self.gaps > _OPEN_MM, own + rise, np.nan)
        misses = self.silhouettes[upper].misses(at, wanted)
        edge = self.upper if upper else self.lower
        x = self.vertices[edge, 0]
        beside = np.maximum(self.columns[0] - x, x - self.columns[-1])
        at_edge = np.interp(x, self.columns, misses) * np.exp(-np.maximum(beside, 0.0) / _BESIDE_MM)
        return np.asarray(self.spread[upper] @ at_edge)

    def _wanted(self, edge: Ints, part: float, upper: bool) -> Floats:
        """Displacements of an edge's vertices, (n, 3) mm."""
        p = self.vertices[edge] - self.centre
        gap = self.gap_mm(self.vertices[edge, 0])
        rise = (-part if upper else part) * (gap + _press_mm(gap))
        far = np.hypot(p[:, 1], p[:, 2])
        own, other = (self._far(e, p[:, 0]) for e in (edge, self.lower if upper else self.upper))
        open_here = np.clip(gap / 1.0, 0.0, 1.0)  # corners stay
        far = far + part * open_here * (other - own)
        y = p[:, 1] + rise
        z = np.sqrt(np.maximum(far**2 - y**2, 0.0))
        return np.stack([np.zeros(len(p)), rise, np.where(p[:, 2] > 0, z - p[:, 2], 0.0)], axis=1)

    def _far(self, edge: Ints, x: Floats) -> Floats:
        """Distance of an edge from the horizontal axis through the eye's centre, at x."""
        p = self.vertices[edge] - self.centre
        order = np.argsort(p[:, 0], kind="stable")
        return np.asarray(np.interp(x, p[order, 0], np.hypot(p[order, 1], p[order, 2])))

    def _lift(self, at: Floats) -> Floats:
        """What lifts skin off the eyeball, (K, 3) mm."""
        now = at - self.centre
        least = np.minimum(self.clear, _SLIDING_MM)
        r = np.linalg.norm(now, axis=1)
        need = np.where(self.outside, _radius(self.globe, self.centre, now) + least - r, 0.0)
        return np.asarray(np.maximum(need, 0.0)[:, None] * now / r[:, None])


def _press_mm(gap: Floats) -> Floats:
    """By how much closed lids overlap where they have so far to go: less towards the corners."""
    return np.asarray(PRESS_MM * np.clip(gap / _PRESSED_MM, 0.0, 1.0))


def _radius(globe: RayScene, centre: Floats, directions: Floats) -> Floats:
    """An eyeball's radius, its largest within `_CORNEA_RAD` above and below, (K,) mm."""
    found = np.zeros(len(directions))
    x, y, z = (directions / np.linalg.norm(directions, axis=1)[:, None]).T
    for turn in _CORNEA_RAD:
        c, s = np.cos(turn), np.sin(turn)
        rays = np.stack([x, c * y - s * z, s * y + c * z], axis=1)
        t, *_ = globe.cast(np.repeat(centre[None], len(rays), axis=0), rays)
        found = np.maximum(found, np.where(np.isfinite(t), t, 0.0))
    return found


def find_lid_edges(head: Head, skin: NDArray[np.int32], side: str) -> LidEdges | None:
    """The edges of one eye's lids; None if no eyeball shows, or the mesh has no such edges."""
    xs, heights = lid_opening(head, skin, side)
    if not len(xs):
        return None
    eye, v = head.eyes[side], head.mesh.vertices
    near = _near(v, skin, xs, eye)
    graph = _edges(v, skin, near)
    scene = RayScene(v, skin)
    paths = [_path(v[near], graph, _visible_edge(scene, xs, heights, c)) for c in (0, 1)]
    if any(len(path) < 3 for path in paths):
        return None
    upper, lower = paths
    normals = vertex_normals(v, skin)[near]
    outside = (normals * (v[near] - eye.centre)).sum(axis=1) > 0
    eyeball = head.mesh.triangles[head.mesh.groups[f"eye_{side}"]]
    globe, from_centre = RayScene(v, eyeball), v[near] - eye.centre
    clear = np.linalg.norm(from_centre, axis=1) - _radius(globe, eye.centre, from_centre)
    reach = _REACH * eye.radius
    away = {
        True: _spread(graph, upper, lower, reach),
        False: _spread(graph, lower, upper, reach),
    }
    step = float(xs[1] - xs[0])
    gaps = gaussian_filter1d(heights[:, 0] - heights[:, 1], _SMOOTH_MM / step, mode="nearest")
    lids = lid_triangles(v, skin, near, graph, upper, lower)
    return LidEdges(
        v, eye.centre, xs, gaps, heights, near[upper], near[lower], near, away, outside, clear,
        globe, {up: LidSilhouette(lids[up], eyeball, xs, up) for up in (True, False)},
    )  # fmt: skip


def _near(v: Floats, skin: NDArray[np.int32], xs: Floats, eye: Eye) -> Ints:
    rows = np.unique(skin).astype(np.int64)
    p, R = v[rows] - eye.centre, eye.radius
    kept = (v[rows, 0] > xs[0] - _BESIDE * R) & (v[rows, 0] < xs[-1] + _BESIDE * R)
    kept &= (np.abs(p[:, 1]) < _HIGH * R) & (p[:, 2] > _DEEP * R)
    return np.asarray(rows[kept])


def _edges(v: Floats, skin: NDArray[np.int32], near: Ints) -> sparse.csr_matrix:
    """Lengths of the mesh's edges among some vertices, (K, K) symmetric, mm."""
    local = np.full(len(v), -1)
    local[near] = np.arange(len(near))
    pairs = np.concatenate([local[skin[:, [a, b]]] for a, b in ((0, 1), (1, 2), (2, 0))])
    pairs = np.unique(np.sort(pairs[(pairs >= 0).all(axis=1)], axis=1), axis=0)
    lengths = np.linalg.norm(v[near[pairs[:, 0]]] - v[near[pairs[:, 1]]], axis=1)
    half = sparse.csr_matrix((lengths, (pairs[:, 0], pairs[:, 1])), (len(near), len(near)))
    return (half + half.T).tocsr()


def _visible_edge(scene: RayScene, xs: Floats, heights: Floats, column: int) -> Floats:
    """The edge that is seen from the front, (C + 2, 3) mm, from corner to corner."""
    y = heights[:, column] + (EDGE_MM if column == 0 else -EDGE_MM)
    start = np.stack([xs, y, np.full(len(xs), _FAR_MM)], axis=1)
    t, *_ = scene.cast(start, np.tile([0.0, 0.0, -1.0], (len(xs), 1)))
    seen = np.stack([xs, heights[:, column], _FAR_MM - t], axis=1)
    ends = seen[[0, -1]]
    ends[:, 1] = heights[[0, -1]].mean(axis=1)
    return np.concatenate([ends[:1], seen, ends[1:]])


def _path(p: Floats, graph: sparse.csr_matrix, edge: Floats) -> Ints:
    """The way along the mesh from corner to corner that keeps closest to a visible edge."""
    corners = [int(np.argmin(((p - end) ** 2).sum(axis=1))) for end in edge[[0, -1]]]
    x = p[:, 0]
    off = p[:, 1] - np.interp(x, edge[1:-1, 0], edge[1:-1, 1])
    behind = np.maximum(np.interp(x, edge[1:-1, 0], edge[1:-1, 2]) - p[:, 2], 0.0)
    beside = np.maximum(np.maximum(edge[0, 0] - x, x - edge[-1, 0]), 0.0)
    shunned = 1 + (off**2 + beside**2 + (behind / _DEPTH_COUNTS) ** 2) / _OFF_EDGE_MM**2
    entries = graph.tocoo()
    cost = entries.data * (shunned[entries.row] + shunned[entries.col]) / 2
    costly = sparse.csr_matrix((cost, (entries.row, entries.col)), graph.shape)
    _, before = dijkstra(costly, indices=corners[0], return_predecessors=True)
    path = [corners[1]]
    while path[-1] != corners[0]:
        if before[path[-1]] < 0:
            return np.zeros(0, dtype=np.int64)
        path.append(int(before[path[-1]]))
    return np.array(path[-2:0:-1], dtype=np.int64)


def _spread(graph: sparse.csr_matrix, edge: Ints, other: Ints, reach_mm: float) -> Floats:
    """(K, n): what residuals at an edge's vertices do to those near.

    Exact at the edge, smooth along it, fading out with the distance from it; half-way
    between the two edges it is shared.
    """
    away = dijkstra(graph, indices=edge, limit=2 * reach_mm).T  # (K, n)
    to_other = dijkstra(graph, indices=other, limit=2 * reach_mm, min_only=True)
    nearest = away.min(axis=1)
    spacing = float(np.median(np.sort(away[edge] + 1e3 * np.eye(len(edge)), axis=1)[:, 0]))
    beyond = np.minimum(away, 1e3) - np.minimum(nearest, 1e3)[:, None]
    bell = np.exp(-0.5 * (beyond / (_BELL * spacing)) ** 2)
    bell /= bell.sum(axis=1, keepdims=True)
    at_edge = bell[edge]
    gram = at_edge.T @ at_edge + _RIDGE * np.eye(len(edge))
    bell = bell @ np.linalg.solve(gram, at_edge.T)
    t = np.clip(1 - nearest / reach_mm, 0.0, 1.0)
    fade = np.where(np.isfinite(nearest), t * t * (3 - 2 * t), 0.0)
    far = 2 * reach_mm + 1.0
    to_other, nearest = np.minimum(to_other, far), np.minimum(nearest, far)
    ours = to_other / np.maximum(nearest + to_other, 1e-9)  # 1 at the edge, 1/2 half-way
    ours = np.clip((ours - 0.3) / 0.4, 0.0, 1.0)
    fade *= ours * ours * (3 - 2 * ours)
    return np.asarray(fade[:, None] * bell)
