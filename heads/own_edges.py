"""Edges of lids and lips on another head, as rays from the front see them.

A warp follows the surface; it does not see where a lid ends or two lips meet as sharply as rays
do. The rules by which the template's own points were placed (`place_feature_points`) are applied
to the mesh itself, near where the warp says.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from .lip_slit import LIP_PAIRS, is_slit
from .raycast import NO_HIT, RayScene
from .skin_surface import Surface
from .template import template_feature_points
from .template_warp import LaidTemplate

Floats = NDArray[np.float64]
Triangles = NDArray[np.int32]

_SCAN_MM = 0.1
_AHEAD_MM = 300.0
#: As on the template: lips' points lie this far from the seam, lids' from the edge.
_FROM_SEAM_MM, _FROM_EDGE_MM = 0.7, 0.3
_LIPS_AGREE_MM = 2.5
_LIP_REACH_MM, _LID_REACH_MM = 6.0, 9.0
_BEHIND_LIPS_MM = 6.0
#: (upper, lower) points of the lids at the edge.
_LID_PAIRS = {"left": ("3.1", "3.3"), "right": ("3.2", "3.4")}


def _column(surface: RayScene, x: float, ys: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Depth z of the first surface in front at x and each height; whether there is any."""
    origins = np.stack([np.full_like(ys, x), ys, np.full_like(ys, _AHEAD_MM)], axis=1)
    t, triangle, _ = surface.cast(origins, np.tile([0.0, 0.0, -1.0], (len(ys), 1)))
    return _AHEAD_MM - t.astype(np.float64), triangle != NO_HIT


def put_lips_right(
    surface: Surface, wanted: dict[str, Floats], given: Mapping[str, Floats]
) -> bool:
    """Move points of the lips that are off it to the seam; whether the lips part there.

    The seam is a hole or the deepest place between the lips. They part if what lies above and
    below it hangs together only by a long way.
    """
    parts = []
    for upper, lower in LIP_PAIRS:
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
            if not stays and (not agrees or is_slit(surface, wanted[name], seen)):
                wanted[name] = seen
        parts.append(is_slit(surface, wanted[upper], wanted[lower]))
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


def eye_shows(surface: Surface, laid: LaidTemplate, side: str) -> bool:
    """Whether the skin has a hole between the lids: rays from the front pass or go deep."""
    upper, lower = _LID_PAIRS[side]
    at = laid.at(template_feature_points().select((upper, lower)))
    middle = (at[upper] + at[lower]) / 2
    z, hit = _column(surface.scene, float(middle[0]), middle[1] + np.linspace(-1.5, 1.5, 16))
    front = float(min(at[upper][2], at[lower][2]))
    return bool((~hit | (z < front - _BEHIND_LIPS_MM)).any())


def put_lids_right(
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
