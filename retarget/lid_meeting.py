"""Lids that slide over the eyeball and meet: worked out for each head, then linear.

A deformer leaves the lids' edges where its few points and the mesh between them happen to put
them: up to a millimetre apart at full closure, mostly towards the corners. Here the edge of each
lid is found on the mesh, and for some positions of a lid the difference between where its edge is
and where it should be becomes a column of the deformer, spread over the lid and fading out:

- a vertex of the edge goes down (up) by the part p that its lid closes of what there is to close
  in its own column, and its distance from the horizontal axis through the eye's centre goes by p
  to that of the other lid's edge, so that lids meet on one line whatever parts they take
  (p upper + p lower = 1);
- the other lid's edge stays;
- skin that would come nearer to the eyeball than it may is lifted; the eyeball counts as thick as
  it is anywhere within 25° above or below, so that lids pass over the cornea of a turned eye.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..core.mesh import SurfacePoints
from ..core.mpeg4 import fap_by_name
from ..heads.head import Head
from .auxiliary_points import PREFIX, auxiliary_model
from .controls import Controls, joined_points
from .deformer import FeaturePointDeformer
from .followers import Followers
from .lid_edges import LidEdges, find_lid_edges
from .lid_points import PRESS_MM, LidPoint

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Lids: edge points of the middle, and the FAPs that move them.
LIDS = {
    "left": ("3.1", "3.3", "close_t_l_eyelid", "close_b_l_eyelid"),
    "right": ("3.2", "3.4", "close_t_r_eyelid", "close_b_r_eyelid"),
}
#: A lid opens at most this much of its gap beyond rest.
WIDEST = 0.7
#: Parts of the way at which a lid is corrected; linear between, nothing at rest and beyond.
KNOTS = (0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True, eq=False)
class _Eye:
    """One eye's lids: what moves them, and in which rows of the deformer's points.

    Attributes
    ----------
    gap_mm : float
        What there is to close at the middle point of the upper lid, the press included.
    top, bottom : int
    points : tuple of (LidPoint, int)
    fixes : mapping from (is upper, knot) to rows of its y and its z column
    """

    centre: Floats
    gap_mm: float
    top: int
    bottom: int
    points: tuple[tuple[LidPoint, int], ...]
    fixes: dict[tuple[bool, float], tuple[int, int]]


class LidMeeting:
    """The lids of a head.

    Parameters
    ----------
    head : Head
    controls : Controls
    on_skin : FeaturePointDeformer
        Of the controls' points.

    Attributes
    ----------
    deformer : FeaturePointDeformer
        `on_skin` with the columns that make lids meet behind its points.
    """

    def __init__(self, head: Head, controls: Controls, on_skin: FeaturePointDeformer) -> None:
        self._head = head
        self._rest = on_skin.points.at(head.mesh.vertices)
        self.deformer = on_skin
        self._eyes: dict[str, _Eye] = {}
        skin = head.mesh.triangles[head.mesh.groups["skin"]]
        as_driven = _as_driven(on_skin)
        columns: list[sparse.csr_matrix] = []
        placed: list[SurfacePoints] = []
        for side in LIDS:
            edges = find_lid_edges(head, skin, side)
            if edges is None or not set(LIDS[side][:2]) <= set(on_skin.points.names):
                continue  # no eyeball shows: nothing to slide on
            self._eyes[side] = _eye(head, controls, on_skin, edges, side)
            for upper in (True, False):
                made = self._corrections(as_driven, edges, side, upper)
                first = len(on_skin.points) + sum(c.shape[1] for c in columns)
                for k, knot in enumerate(KNOTS):
                    at = first + 2 * k
                    self._eyes[side].fixes[upper, knot] = (at, at + 1)
                columns.append(made)
                placed.append(_places(edges, skin, side, upper))
        if columns:
            self.deformer = _with_columns(on_skin, placed, sparse.hstack(columns).tocsr())

    def meet(self, found: Floats, faps: Mapping[str, Floats]) -> None:
        """Put the lids' points where FAPs 19 to 22 say, as far as there is room.

        Parameters
        ----------
        found : (T, N, 3) float64, mm
            Displacements of the deformer's points; those of lids are filled in.
        faps : mapping from name to (T,) float64, table units
        """
        for side, eye in self._eyes.items():
            down, up = (self._mm(faps, name, len(found)) for name in LIDS[side][2:])
            down, up = parts_of_way(down, up, eye.gap_mm)
            self._put(found, eye, down, up)
            for (upper, knot), rows in eye.fixes.items():
                share = _hat(down if upper else up, knot)
                for axis, row in zip((1, 2), rows, strict=True):
                    found[:, row, axis] = share

    def _mm(self, faps: Mapping[str, Floats], name: str, n: int) -> Floats:
        if name not in faps:
            return np.zeros(n)
        return faps[name] * self._head.fapu.unit(fap_by_name()[name])

    def _put(self, found: Floats, eye: _Eye, down: Floats, up: Floats) -> None:
        self._slide(found, eye, eye.top, -down * eye.gap_mm)
        self._slide(found, eye, eye.bottom, up * eye.gap_mm)
        for lid, row in eye.points:
            part = -down if lid.upper else up
            self._slide(found, eye, row, part * (lid.gap_mm + PRESS_MM) * lid.share)

    def _slide(self, found: Floats, eye: _Eye, row: int, rise_mm: Floats) -> None:
        """Move a point up, on the sphere about the eye's centre that it lies on at rest."""
        p = self._rest[row] - eye.centre
        squared = p @ p - p[0] ** 2 - (p[1] + rise_mm) ** 2
        found[:, row, 1] = rise_mm
        found[:, row, 2] = np.sqrt(np.maximum(squared, 0.0)) - max(p[2], 0.0)

    def _corrections(
        self, on_skin: FeaturePointDeformer, edges: LidEdges, side: str, upper: bool
    ) -> sparse.csr_matrix:
        """(V, 2 knots): for each knot what is missing in y and in z."""
        eye, n = self._eyes[side], len(KNOTS)
        moved = np.zeros((n, len(on_skin.points), 3))
        part, rest = np.array(KNOTS), np.zeros(n)
        self._put(moved, eye, part if upper else rest, rest if upper else part)
        held = _held_rows(on_skin.points, LIDS[side][:2])
        rows, columns = edges.near, []
        for k, knot in enumerate(KNOTS):
            made = on_skin.displace(moved[k])
            missing = edges.correction(made, knot, upper=upper)
            for axis in (1, 2):
                _let_go(missing[:, axis], rows, on_skin.points, held[axis])
                columns.append(missing[:, axis])
        dense = np.stack(columns, axis=1)
        found = sparse.lil_matrix((len(self._head.mesh.vertices), dense.shape[1]))
        found[rows] = dense
        return found.tocsr()


def parts_of_way(down_mm: Floats, up_mm: Floats, gap_mm: float) -> tuple[Floats, Floats]:
    """The parts of the way to each other that the lids go: 1 in sum where they meet, at most.

    What exceeds it is taken from both in proportion.
    """
    down, up = (np.maximum(a / gap_mm, -WIDEST) for a in (down_mm, up_mm))
    excess = np.maximum(down + up - 1.0, 0.0)
    closing = np.maximum(down, 0) + np.maximum(up, 0) + 1e-12
    down, up = (a - excess * np.maximum(a, 0) / closing for a in (down, up))
    return down, up


def _as_driven(on_skin: FeaturePointDeformer) -> FeaturePointDeformer:
    """The deformer with its auxiliary points following, as in a drive."""
    if not any(name.startswith(PREFIX) for name in on_skin.points.names):
        return on_skin
    return on_skin.led(Followers.of(auxiliary_model(), on_skin.points))


def _eye(
    head: Head, controls: Controls, on_skin: FeaturePointDeformer, edges: LidEdges, side: str
) -> _Eye:
    index = on_skin.points.index
    top, bottom = (index(n) for n in LIDS[side][:2])
    gap = float(edges.gap_mm(head.points[LIDS[side][0]][0])) + PRESS_MM
    points = tuple((lid, index(lid.name)) for lid in controls.lids if lid.side == side)
    return _Eye(head.eyes[side].centre, gap, top, bottom, points, {})


def _hat(part: Floats, knot: float) -> Floats:
    """1 at a knot, 0 at its neighbours and at rest, linear between."""
    k = KNOTS.index(knot)
    keys = (0.0, *KNOTS)
    return np.asarray(np.interp(part, keys, np.eye(len(keys))[k + 1]))


def _places(edges: LidEdges, skin: NDArray[np.int32], side: str, upper: bool) -> SurfacePoints:
    """The columns' points: all in the middle of the edge that they mend."""
    path = edges.upper if upper else edges.lower
    middle = path[len(path) // 2]
    at = int(np.argmax((skin == middle).any(axis=1)))
    lid = "upper" if upper else "lower"
    names = tuple(f"lid.{side}.{lid}.meet.{knot:g}.{axis}" for knot in KNOTS for axis in "yz")
    corners = np.repeat(skin[at][None], len(names), axis=0)
    weights = np.repeat((skin[at] == middle).astype(np.float64)[None], len(names), axis=0)
    return SurfacePoints(names, corners, weights)


def _with_columns(
    on_skin: FeaturePointDeformer, placed: list[SurfacePoints], columns: sparse.csr_matrix
) -> FeaturePointDeformer:
    """The deformer with columns for points behind its own; one table where it has one."""
    tables: list[sparse.csr_matrix] = []
    for axis, table in enumerate(on_skin.tables):
        if axis and table is on_skin.tables[axis - 1]:
            tables.append(tables[-1])
        else:
            tables.append(sparse.hstack([table, columns]).tocsr())
    return on_skin.joined(joined_points(on_skin.points, placed), tuple(tables))


def _held_rows(points: SurfacePoints, middles: tuple[str, str]) -> dict[int, list[int]]:
    """Points that no correction may move along y, and along z: feature points.

    Depth of the lids' own middle points is the eyeball's affair.
    """
    own = [i for i, n in enumerate(points.names) if n[0].isdigit()]
    return {1: own, 2: [i for i in own if points.names[i] not in middles]}


def _let_go(field: Floats, near: Ints, points: SurfacePoints, rows: list[int]) -> None:
    """Change a field on some vertices as little as it takes to be 0 at points."""
    where = {int(v): k for k, v in enumerate(near)}
    for row in rows:
        local = [where.get(int(c)) for c in points.corners[row]]
        held = [(k, b) for k, b in zip(local, points.barycentric[row], strict=True) if b > 0]
        if any(k is None for k, _ in held):
            continue
        ks = np.array([k for k, _ in held], dtype=np.int64)
        b = np.array([w for _, w in held])
        field[ks] -= b * (b @ field[ks]) / (b @ b)
