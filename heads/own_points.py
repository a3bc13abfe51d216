"""Feature points on another head: where the laid template has them, put right at lids and lips."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.mesh import SurfacePoints
from .head import Eye
from .own_edges import put_lids_right, put_lips_right
from .skin_surface import Surface
from .template import load_template, template_feature_points
from .template_warp import LaidTemplate

Floats = NDArray[np.float64]
Triangles = NDArray[np.int32]

_NO_SURFACE_MM = 7.0
_INNER = {
    "eye_left": ("3.5",), "eye_right": ("3.6",),
    "teeth_upper": ("9.8", "9.10"), "teeth_lower": ("9.11", "9.9"),
    "tongue": ("6.1", "6.2", "6.3", "6.4"),
}  # fmt: skip
#: Feature points that are on no skin, and the part that each is on.
INNER_POINTS = {point: part for part, points in _INNER.items() for point in points}


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
    lips_part = put_lips_right(surface, wanted, given)
    lids_open = put_lids_right(surface, vertices, triangles, groups, wanted, given)
    places = {n: p for n, p in wanted.items() if n not in INNER_POINTS}
    kept = near_surface(surface, places)
    places = {n: p for n, p in places.items() if n in given or n in kept}
    for part, names in _INNER.items():
        places.update(_on_part(part, names, vertices, triangles, groups, eyes, laid))
        places.update({n: given[n] for n in names if n in given and part in groups})
    found = points_on_parts(surface, vertices, triangles, groups, places)
    return PlacedPoints(found, lips_part, lids_open)


def points_on_parts(
    surface: Surface,
    vertices: Floats,
    triangles: Triangles,
    groups: Mapping[str, NDArray[np.int32]],
    places: Mapping[str, Floats],
) -> SurfacePoints:
    """The points nearest to some places, each on the part that it belongs to.

    Parameters
    ----------
    surface : Surface
        Of the skin; its triangles index `vertices`.
    vertices, triangles, groups
        Of the whole mesh.
    places : mapping from feature point to (3,)
        Those of parts that are missing are looked for on the skin.
    """
    by_part: dict[str, list[str]] = {}
    for name in places:
        part = INNER_POINTS.get(name, "skin")
        by_part.setdefault(part if part in groups else "skin", []).append(name)
    placed = []
    for part, names in by_part.items():
        on = surface if part == "skin" else Surface(vertices, triangles[groups[part]])
        placed.append(on.points_at(tuple(names), np.array([places[n] for n in names])))
    return _ordered(placed, list(template_feature_points().names))


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
