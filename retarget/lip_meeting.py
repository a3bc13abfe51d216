"""Lips that touch and are pressed, but do not pass through each other.

Pairs of points stop at each other (`LipMeeting`). Between them the deformer leaves gaps, and lets
one lip into the other, mostly towards the corners of the mouth in a smile. `LipSeam` therefore
looks at the outcome: at places along the seam, the upper and the lower lip move alike where FAPs
keep the lips closed, apart from what FAPs say of the one against the other; and they stop at each
other everywhere.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..core.mesh import SurfacePoints
from ..heads.head import Head
from ..heads.lip_slit import LIP_PAIRS, lips_part
from ..heads.raycast import RayScene
from .auxiliary_points import PREFIX, auxiliary_model
from .controls import joined_points, size_of
from .deformer import FeaturePointDeformer
from .followers import Followers
from .lip_places import CORNERS, LipPlaces, find_lip_places

Floats = NDArray[np.float64]
Pairs = Iterable[tuple[str, str]]

#: Lips that touch may be pressed into each other this far, mm, more and more slowly.
PRESS_MM = 0.06
#: Lips that FAPs hold this far apart, on a head of average size, each go their own way.
APART_MM = 1.0
#: What lies this far behind the lips, on a head of average size, is the mouth.
_BEHIND_MM = 5.0
_STEP_MM = 0.05
_AROUND_MM = 4.0
_FAR_MM = 500.0
#: What keeps corrections calm where the mesh is coarser than the places are dense.
_CALM = 0.02
#: Points that go where FAPs say whatever the seam does.
_KEPT = ("2.1", "2.2", "2.3", "2.4", "2.5", "2.10", "8.1", "8.2")
#: A column that does less for a place is not asked.
_LEAST = 0.02


class LipMeeting:
    """The room between a head's lips at rest, and what stops them.

    Parameters
    ----------
    head : Head
    points : SurfacePoints
        Among them the upper and lower points of the pairs.
    pairs : iterable of (upper, lower)
        Names of points that meet; those of which one is missing are left out.
    """

    def __init__(self, head: Head, points: SurfacePoints, pairs: Pairs) -> None:
        known = [p for p in pairs if set(p) <= set(points.names)]
        self._rows = [(points.index(upper), points.index(lower)) for upper, lower in known]
        self._together = not lips_part(head)
        self.room_mm = _rooms(head, points, known)

    def meet(self, found: Floats) -> None:
        """Take back from both lips by how far they would pass through each other.

        Parameters
        ----------
        found : (T, N, 3) float64, mm
            Displacements of the points.
        """
        for (u, l), room in zip(self._rows, self.room_mm, strict=True):
            if self._together:  # skin lies between them: what parts them would tear it
                found[:, [u, l]] = found[:, [u, l]].mean(axis=1, keepdims=True)
                continue
            excess = _excess(found[:, l, 1] - found[:, u, 1] - room)
            found[:, u, 1] += excess / 2
            found[:, l, 1] -= excess / 2


class LipSeam:
    """The seam of a head's lips, which stays one curve where they are closed.

    Parameters
    ----------
    head : Head
    on_skin : FeaturePointDeformer
        Whose auxiliary points are taken to follow, as in a drive.

    Attributes
    ----------
    deformer : FeaturePointDeformer
        `on_skin` with the columns that hold the lips together behind its points; the same where
        the head has no lips that part, or no such places.
    """

    def __init__(self, head: Head, on_skin: FeaturePointDeformer) -> None:
        self.deformer = on_skin
        pairs = [p for p in LIP_PAIRS if set(p) <= set(on_skin.points.names)]
        places = find_lip_places(head) if pairs and lips_part(head) else None
        self._places = places
        if places is None or not set(CORNERS) <= set(on_skin.points.names):
            self._places = None
            return
        x, size = places.x, size_of(head)
        self._n, self._apart_mm = len(on_skin.points), APART_MM * size
        self._parting = _parting(places, on_skin)
        self._pairs = np.array([[on_skin.points.index(n) for n in pair] for pair in pairs])
        at = on_skin.points.at(head.mesh.vertices)[:, 0]
        knots = np.append([at[on_skin.points.index(n)] for n in CORNERS], at[self._pairs[:, 0]])
        order = np.argsort(knots, kind="stable")
        hats = [np.interp(x, knots[order], hat) for hat in np.eye(len(knots))[np.argsort(order)]]
        self._between = np.array(hats[2:])  # (pairs, S)
        self._rooms = _rooms(head, on_skin.points, pairs) @ self._between
        self._slits = places.slit_mm
        kept = on_skin.points.select(tuple(n for n in _KEPT if n in on_skin.points.names))
        self._undo = [
            _held(spread, kept) @ _calm_inverse(reached) / 2
            for spread, reached in (
                (places.upper_spread, places.upper_reached),
                (places.lower_spread, places.lower_reached),
            )
        ]
        names = [f"lip.seam.{lip}.{k}" for lip in ("upper", "lower") for k in range(len(x))]
        added = SurfacePoints(
            tuple(names),
            np.concatenate([places.upper.corners, places.lower.corners]),
            np.concatenate([places.upper.barycentric, places.lower.barycentric]),
        )
        columns = sparse.hstack([places.upper_spread, places.lower_spread]).tocsr()
        self.deformer = _with_columns(on_skin, added, columns)

    def close(self, found: Floats) -> None:
        """Hold the lips together where they are closed.

        Parameters
        ----------
        found : (T, N, 3) float64, mm
            Displacements of the deformer's points, auxiliary ones without what they follow; those
            of the seam are filled in.
        """
        if self._places is None:
            return
        n, frames = len(self._places.x), len(found)
        moved = found[:, : self._n].reshape(frames, -1)
        parting = (moved @ self._parting).reshape(frames, n, 3)
        said = found[:, self._pairs[:, 0]] - found[:, self._pairs[:, 1]]
        wanted = np.einsum("tpa,ps->tsa", said, self._between)
        t = np.clip((wanted[:, :, 1] + self._rooms) / self._apart_mm, 0.0, 1.0)
        closed = 1 - t * t * (3 - 2 * t)
        wanted[:, :, 0] = 0.0
        change = closed[:, :, None] * (wanted - parting)
        change[:, :, 1] += _excess(-(parting + change)[:, :, 1] - self._slits)
        upper, lower = (np.einsum("ks,tsa->tka", undo, change) for undo in self._undo)
        found[:, self._n : self._n + n] = upper
        found[:, self._n + n : self._n + 2 * n] = -lower


def _excess(pressed: Floats) -> Floats:
    """What lips that are pressed by so much must give back, mm."""
    soft = PRESS_MM * np.tanh(pressed / PRESS_MM)
    return np.asarray(np.where(pressed > 0, pressed - soft, 0.0))


def _parting(places: LipPlaces, on_skin: FeaturePointDeformer) -> Floats:
    """(3 N, 3 S): how far points' displacements part the lips at the places."""
    n, s = len(on_skin.points), len(places.x)
    found = np.zeros((s, 3, n, 3))
    for axis, table in enumerate(on_skin.tables):
        for sign, lip in ((1.0, places.upper), (-1.0, places.lower)):
            for corner in range(3):
                rows = table[lip.corners[:, corner]].toarray()
                found[:, axis, :, axis] += sign * lip.barycentric[:, corner, None] * rows
    flat = found.reshape(3 * s, 3 * n)
    if any(name.startswith(PREFIX) for name in on_skin.points.names):
        followers = Followers.of(auxiliary_model(), on_skin.points)
        flat = np.asarray((followers.matrix(n).T @ flat.T).T)
    return np.ascontiguousarray(flat.T)


def _calm_inverse(reached: Floats) -> Floats:
    """What columns must do so that places move as wanted, (K, S); nothing for places far off."""
    gram = reached.T @ reached + _CALM**2 * np.eye(reached.shape[1])
    found = np.linalg.solve(gram, reached.T)
    return np.where(np.abs(found) < _LEAST, 0.0, found)


def _held(spread: sparse.csr_matrix, kept: SurfacePoints) -> Floats:
    """(K, K): what columns do, less what would move points that are kept."""
    moves = np.zeros((len(kept), spread.shape[1]))
    for corner in range(3):
        rows = spread[kept.corners[:, corner]].toarray()
        moves += kept.barycentric[:, corner, None] * rows
    return np.asarray(np.eye(spread.shape[1]) - np.linalg.pinv(moves, rcond=1e-12) @ moves)


def _with_columns(
    on_skin: FeaturePointDeformer, added: SurfacePoints, columns: sparse.csr_matrix
) -> FeaturePointDeformer:
    tables: list[sparse.csr_matrix] = []
    for axis, table in enumerate(on_skin.tables):
        if axis and table is on_skin.tables[axis - 1]:
            tables.append(tables[-1])
        else:
            tables.append(sparse.hstack([table, columns]).tocsr())
    return on_skin.joined(joined_points(on_skin.points, (added,)), tuple(tables))


def _rooms(head: Head, points: SurfacePoints, pairs: list[tuple[str, str]]) -> Floats:
    """Heights of the opening between the lips at rest, at pairs of points, mm."""
    at = points.at(head.mesh.vertices)
    scene = RayScene(head.mesh.vertices, head.mesh.triangles[head.mesh.groups["skin"]])
    ends = [(at[points.index(upper)], at[points.index(lower)]) for upper, lower in pairs]
    return np.array([_slit(scene, upper, lower, size_of(head)) for upper, lower in ends])


def _slit(scene: RayScene, upper: Floats, lower: Floats, size: float) -> float:
    """Height of the opening between two points of the lips, as seen from the front, mm."""
    middle = (upper + lower) / 2
    half = abs(upper[1] - lower[1]) / 2 + _AROUND_MM * size
    ys = np.arange(middle[1] - half, middle[1] + half, _STEP_MM)
    start = np.stack([np.full_like(ys, middle[0]), ys, np.full_like(ys, _FAR_MM)], axis=1)
    t, *_ = scene.cast(start, np.tile([0.0, 0.0, -1.0], (len(ys), 1)))
    is_open = _FAR_MM - t < min(upper[2], lower[2]) - _BEHIND_MM * size
    return float(is_open.sum() * _STEP_MM)
