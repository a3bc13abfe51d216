"""Feature points on another head: where the laid template has them, put right at lids and lips.

A warp follows the surface; it does not see where a lid ends or two lips meet as sharply as rays
do. There the rules by which the template's own points were placed (`place_feature_points`) are
applied to the mesh itself, near where the warp says.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ..core.mesh import SurfacePoints
from .head import Eye
from .raycast import NO_HIT, RayScene
from .template import load_template, template_feature_points
from .template_warp import LaidTemplate, Surface

Floats = NDArray[np.float64]
Triangles = NDArray[np.int32]

_SCAN_MM = 0.1
_AHEAD_MM = 300.0
#: As on the template: lips' points lie this far from the seam, lids' from the edge.
_FROM_SEAM_MM, _FROM_EDGE_MM = 0.7, 0.3
_LIPS_AGREE_MM = 2.5
_LIP_REACH_MM, _LID_REACH_MM = 6.0, 9.0
_BEHIND_LIPS_MM = 6.0
_NO_SURFACE_MM = 7.0
_AROUND_MM = 9.0  # the lips' middles: within it no way leads round the corners of the mouth
#: (upper, lower) points of the lips at the seam, those of the lids at the edge.
_LIP_PAIRS = (("2.2", "2.3"), ("2.7", "2.9"), ("2.6", "2.8"))
_LID_PAIRS = {"left": ("3.1", "3.3"), "right": ("3.2", "3.4")}
_INNER = {
    "eye_left": ("3.5",), "eye_right": ("3.6",),
    "teeth_upper": ("9.8", "9.10"), "teeth_lower": ("9.11", "9.9"),
    "tongue": ("6.1", "6.2", "6.3", "6.4"),
}  # fmt: skip
_ON_INNER = {point for points in _INNER.values() for point in points}


@dataclass(frozen=True, eq=False)
class PlacedPoints:
    """Feature points on a mesh, and what was found on the way.

    Attributes
    ----------
    points : SurfacePoints
    lips_part : bool
        Whether the mesh has a slit between the lips.
    lids_open : tuple of str
        Sides on which an eyeball, or a hole, shows between the lids.
    """

    points: SurfacePoints
    lips_part: bool
    lids_open: tuple[str, ...]


def place_points(
    surface: Surface,
    vertices: Floats,
    triangles: Triangles,
    groups: Mapping[str, NDArray[np.int32]],
    eyes: Mapping[str, Eye],
    laid: LaidTemplate,
    given: Mapping[str, Floats],
) -> PlacedPoints:
    """Place all feature points that a head has surface for.

    Parameters
    ----------
    surface : Surface
        Of the skin; its triangles index `vertices`.
    vertices, triangles, groups
        Of the whole mesh, mm, head frame.
    eyes : mapping from side to Eye
    laid : LaidTemplate
        Onto the skin.
    given : mapping from feature point to (3,) mm
        Places that a person has given: taken as they are, on the nearest surface.
    """
    wanted = laid.at(template_feature_points())
    wanted.update({n: p for n, p in given.items() if n in wanted})
    lips_part = _put_lips_right(surface, wanted, given)
    lids_open = _put_lids_right(surface, vertices, triangles, groups, wanted, given)
    on_skin = {n: p for n, p in wanted.items() if n not in _ON_INNER}
    kept = near_surface(surface, {n: p for n, p in on_skin.items() if n not in given})
    on_skin = {n: p for n, p in on_skin.items() if n in given or n in kept}
    placed = [surface.points_at(tuple(on_skin), np.array(list(on_skin.values())))]
    for part, names in _INNER.items():
        places = _on_part(part, names, vertices, triangles, groups, eyes, laid)
        places.update({n: given[n] for n in names if n in given and part in groups})
        if places:
            on = surface if part not in groups else Surface(vertices, triangles[groups[part]])
            placed.append(on.points_at(tuple(places), np.array(list(places.values()))))
    order = list(template_feature_points().names)
    return PlacedPoints(_ordered(placed, order), lips_part, lids_open)


def near_surface(surface: Surface, places: Mapping[str, Floats]) -> dict[str, Floats]:
    """Those of some places that have surface near them: masks have no ears."""
    if not places:
        return {}
    at, _, _ = surface.closest(np.array(list(places.values())))
    off = np.linalg.norm(at - np.array(list(places.values())), axis=1)
    return {n: p for (n, p), d in zip(places.items(), off, strict=True) if d < _NO_SURFACE_MM}


def _ordered(parts: list[SurfacePoints], order: list[str]) -> SurfacePoints:
    names = [n for part in parts for n in part.names]
    corners = np.concatenate([part.corners for part in parts])
    barycentric = np.concatenate([part.barycentric for part in parts])
    rows = sorted(range(len(names)), key=lambda i: order.index(names[i]))
    return SurfacePoints(tuple(names[i] for i in rows), corners[rows], barycentric[rows])


def _column(surface: RayScene, x: float, ys: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Depth z of the first surface in front at x and each height; whether there is any."""
    origins = np.stack([np.full_like(ys, x), ys, np.full_like(ys, _AHEAD_MM)], axis=1)
    t, triangle, _ = surface.cast(origins, np.tile([0.0, 0.0, -1.0], (len(ys), 1)))
    return _AHEAD_MM - t.astype(np.float64), triangle != NO_HIT


def _put_lips_right(
    surface: Surface, wanted: dict[str, Floats], given: Mapping[str, Floats]
) -> bool:
    """Move points of the lips that are off it to the seam; whether the lips part there.

    The seam is a hole or the deepest place between the lips. They part if what lies above and
    below it hangs together only by a long way.
    """
    parts = []
    for upper, lower in _LIP_PAIRS:
        x = float((wanted[upper][0] + wanted[lower][0]) / 2)
        middle = float((wanted[upper][1] + wanted[lower][1]) / 2)
        ys = np.arange(middle + _LIP_REACH_MM, middle - _LIP_REACH_MM, -_SCAN_MM)
        z, hit = _column(surface.scene, x, ys)
        front = float(max(wanted[upper][2], wanted[lower][2]))
        seam = _seam(ys, np.where(hit, z, -np.inf), front)
        if seam is None:
            continue
        for name, y in ((upper, seam[0] + _FROM_SEAM_MM), (lower, seam[1] - _FROM_SEAM_MM)):
            depth, there = _column(surface.scene, x, np.array([y]))
            seen = np.array([x, y, depth[0]])
            # a warp that agrees is the better one: lips overlap, rays see what is in front
            agrees = abs(wanted[name][1] - y) < _LIPS_AGREE_MM
            stays = name in given or not there[0]
            if not stays and (not agrees or _is_slit(surface, wanted[name], seen)):
                wanted[name] = seen
        parts.append(_is_slit(surface, wanted[upper], wanted[lower]))
    return bool(parts) and sum(parts) * 2 > len(parts)


def _seam(ys: Floats, z: Floats, front: float) -> tuple[float, float] | None:
    """Heights of the upper and the lower edge of what lies between the lips; None if nothing."""
    behind = z < front - _BEHIND_LIPS_MM
    if behind.any() and not behind.all():
        rows = np.flatnonzero(behind)
        middle = rows[np.argmin(np.abs(rows - len(ys) / 2))]
        first = last = int(middle)
        while first > 0 and behind[first - 1]:
            first -= 1
        while last < len(ys) - 1 and behind[last + 1]:
            last += 1
        return float(ys[first]), float(ys[last])
    inner = slice(len(ys) // 6, -len(ys) // 6)
    at = int(np.argmin(z[inner])) + len(ys) // 6
    is_groove = z[at] < min(z[: at + 1].max(), z[at:].max()) - 0.3
    return (float(ys[at]), float(ys[at])) if is_groove else None


def _is_slit(surface: Surface, upper: Floats, lower: Floats) -> bool:
    """Whether the way over the surface between two points is far longer than the straight one."""
    ends = surface.points_at(("upper", "lower"), np.stack([upper, lower]))
    near = np.linalg.norm(surface.vertices - (upper + lower) / 2, axis=1) < _AROUND_MM
    inside = near[surface.triangles].all(axis=1)
    return not _hang_together(surface.triangles[inside], ends.corners[0], ends.corners[1])


def _hang_together(
    triangles: Triangles, first: NDArray[np.int32], second: NDArray[np.int32]
) -> bool:
    """Whether any corner of one triangle is joined to any of another by edges of `triangles`."""
    n = int(max(triangles.max(initial=0), first.max(), second.max())) + 1
    a = np.concatenate([triangles.ravel(), first, second])
    b = np.concatenate(
        [np.roll(triangles, 1, axis=1).ravel(), np.roll(first, 1), np.roll(second, 1)]
    )
    graph = sparse.coo_matrix((np.ones(len(a)), (a, b)), (n, n))
    _, label = connected_components(graph, directed=False)
    return bool(np.isin(label[first], label[second]).any())


def eye_shows(surface: Surface, laid: LaidTemplate, side: str) -> bool:
    """Whether the skin has a hole between the lids: rays from the front pass or go deep."""
    upper, lower = _LID_PAIRS[side]
    at = laid.at(template_feature_points().select((upper, lower)))
    middle = (at[upper] + at[lower]) / 2
    z, hit = _column(surface.scene, float(middle[0]), middle[1] + np.linspace(-1.5, 1.5, 16))
    front = float(min(at[upper][2], at[lower][2]))
    return bool((~hit | (z < front - _BEHIND_LIPS_MM)).any())


def _put_lids_right(
    surface: Surface,
    vertices: Floats,
    triangles: Triangles,
    groups: Mapping[str, NDArray[np.int32]],
    wanted: dict[str, Floats],
    given: Mapping[str, Floats],
) -> tuple[str, ...]:
    """Move the lids' points to their edges; the sides on which the eye is open."""
    found = []
    for side, (upper, lower) in _LID_PAIRS.items():
        part = f"eye_{side}"
        ball = None
        if part in groups:
            ball = RayScene(vertices, triangles[groups[part]])
        x = float((wanted[upper][0] + wanted[lower][0]) / 2)
        middle = float((wanted[upper][1] + wanted[lower][1]) / 2)
        ys = np.arange(middle + _LID_REACH_MM, middle - _LID_REACH_MM, -_SCAN_MM)
        z, hit = _column(surface.scene, x, ys)
        front = float(min(wanted[upper][2], wanted[lower][2]))
        shows = ~hit | (z < front - _BEHIND_LIPS_MM)
        if ball is not None:
            ball_z, ball_hit = _column(ball, x, ys)
            shows |= ball_hit & (ball_z > np.where(hit, z, -np.inf))
        if not shows.any() or shows.all():
            continue
        found.append(side)
        rows = np.flatnonzero(shows)
        edges = (ys[rows[0]] + _FROM_EDGE_MM, ys[rows[-1]] - _FROM_EDGE_MM)
        for name, y in zip((upper, lower), edges, strict=True):
            depth, there = _column(surface.scene, x, np.array([y]))
            if name not in given and there[0] and abs(y - wanted[name][1]) < _LID_REACH_MM:
                wanted[name] = np.array([x, y, depth[0]])
    return tuple(found)


def _on_part(
    part: str,
    names: tuple[str, ...],
    vertices: Floats,
    triangles: Triangles,
    groups: Mapping[str, NDArray[np.int32]],
    eyes: Mapping[str, Eye],
    laid: LaidTemplate,
) -> dict[str, Floats]:
    """Where a part's points are, if the head has the part.

    A head without eyeballs has the pupils' points on its skin, since the units of a face are
    measured between them; other parts that are missing have no points.
    """
    if part.startswith("eye_"):
        side = part.removeprefix("eye_")
        if part in groups and side in eyes:
            return {names[0]: eyes[side].centre + (0.0, 0.0, eyes[side].radius)}
        return laid.at(template_feature_points().select(names))
    if part not in groups:
        return {}
    return _as_on_template(
        names, vertices[np.unique(triangles[groups[part]])], laid, load_template().vertices_of(part)
    )


def _as_on_template(
    names: tuple[str, ...], p: Floats, laid: LaidTemplate, rows: NDArray[np.int64]
) -> dict[str, Floats]:
    """Points where the template's part has them once it is stretched into the other's box."""
    ours = laid.vertices[rows]
    low, high = ours.min(axis=0), ours.max(axis=0)
    share = np.ptp(p, axis=0) / np.maximum(high - low, 1e-6)
    at = laid.at(template_feature_points().select(names))
    return {name: p.min(axis=0) + (place - low) * share for name, place in at.items()}
