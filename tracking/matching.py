"""Which dots of different cameras are one marker: epipolar geometry over all views at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..core.rig import Rig
from .lenses import undistort
from .triangulation import MIN_VIEWS, Points, Views, triangulate

#: A match of two views only is kept if no other match of either dot comes near this fit.
_AMBIGUITY = 3.0
_MIN_FACE, _REACH = 6, 2.0  # so many markers tell where the face is; so far may others lie


def match_views(
    views: Views,
    detections: Sequence[NDArray[np.float64]],
    sd_px: Sequence[NDArray[np.float64]] | None = None,
    *,
    tolerance_px: float = 1.0,
) -> tuple[NDArray[np.int64], Points]:
    """Group dots of one instant into markers.

    Every pair of dots of two cameras whose rays pass within the tolerance is a hypothesis: its
    point is projected into all other cameras, whose nearest dots within the tolerance support it.
    Hypotheses are taken in order of support, then of residual; each dot serves once. Since on a
    face full of dots two epipolar lines often cross by chance, a hypothesis seen by two cameras
    only must lie among the others, and have no rival of similar residual, or be the only one for
    one of its dots.

    Parameters
    ----------
    views : Views
    detections : C arrays (N_c, 2) float64
        Undistorted normalised coordinates.
    sd_px : C arrays (N_c,) float64, optional
        As in `triangulate`.
    tolerance_px : float

    Returns
    -------
    (K, C) int64
        Index of each marker's dot in each camera; −1 where none.
    Points
        The K triangulated points.
    """
    C = len(detections)
    hypotheses = _hypotheses(views, detections, tolerance_px)
    if not len(hypotheses):
        return np.zeros((0, C), np.int64), _no_points(C)
    sd = None if sd_px is None else _gather(sd_px, hypotheses)
    points = triangulate(views, _gather(detections, hypotheses), sd, tolerance_px=tolerance_px)
    hypotheses, first = np.unique(np.where(points.used, hypotheses, -1), axis=0, return_index=True)
    points = points.select(first)
    support = points.used.sum(axis=1)
    order = np.lexsort((points.residual_px, -support))
    taken = [np.zeros(len(d), bool) for d in detections]
    chosen: list[int] = []

    def take(h: int) -> None:
        for c in np.flatnonzero(hypotheses[h] >= 0):
            taken[c][hypotheses[h, c]] = True
        chosen.append(h)

    for h in order[support[order] > MIN_VIEWS]:
        if _is_free(hypotheses[h], taken):
            take(int(h))
    pairs = order[(support[order] == MIN_VIEWS) & _plausible(points, chosen)[order]]
    while True:
        free = [int(h) for h in pairs if _is_free(hypotheses[h], taken)]
        sure = [h for h in free if not _has_rival(h, free, hypotheses, points)]
        sure = sure or _forced(free, hypotheses, points)
        if not sure:
            break
        for h in sure:
            if _is_free(hypotheses[h], taken):
                take(h)
    keep = np.array(chosen, dtype=np.int64)
    return hypotheses[keep], points.select(keep)


def match_pixels(
    rig: Rig,
    centres: Sequence[NDArray[np.float64]],
    sd_px: Sequence[NDArray[np.float64]],
    tolerance_px: float,
) -> NDArray[np.int64]:
    """`match_views` of pixels, as `capture.spot_matching.MatchSpots` says: (K, C) rows of dots."""
    cameras = [rig[name] for name in rig]
    normalised = [undistort(c, p) for c, p in zip(cameras, centres, strict=True)]
    rows, _ = match_views(Views.of(cameras), normalised, sd_px, tolerance_px=tolerance_px)
    return rows


def _is_free(row: NDArray[np.int64], taken: list[NDArray[np.bool_]]) -> bool:
    return not any(taken[c][row[c]] for c in np.flatnonzero(row >= 0))


def _plausible(points: Points, chosen: list[int]) -> NDArray[np.bool_]:
    """(H,) whether points lie among those that three or more cameras agree on (all, if few do).

    Two rays that cross by chance often do so far from the face.
    """
    if len(chosen) < _MIN_FACE:
        return np.ones(len(points.positions), bool)
    face = points.positions[chosen]
    middle = np.median(face, axis=0)
    reach = _REACH * np.linalg.norm(face - middle, axis=1).max()
    return np.asarray(np.linalg.norm(points.positions - middle, axis=1) < reach)


def _has_rival(h: int, free: list[int], hypotheses: NDArray[np.int64], points: Points) -> bool:
    """Whether another free hypothesis claims one of h's dots about as well."""
    limit = _AMBIGUITY * max(float(points.residual_px[h]), 0.1)
    return any(
        other != h
        and ((hypotheses[other] == hypotheses[h]) & (hypotheses[h] >= 0)).any()
        and points.residual_px[other] < limit
        for other in free
    )


def _forced(free: list[int], hypotheses: NDArray[np.int64], points: Points) -> list[int]:
    """Hypotheses that are the only one for a dot, and whose rivals are not.

    Of dots of a symmetrical face before a symmetrical rig, a left one and a right one may cross by
    chance; but then each has its true partner too, which nothing else claims.
    """
    claims: dict[tuple[int, int], list[int]] = {}
    for h in free:
        for c in np.flatnonzero(hypotheses[h] >= 0):
            claims.setdefault((int(c), int(hypotheses[h, c])), []).append(h)
    only = sorted({rows[0] for rows in claims.values() if len(rows) == 1})
    return [h for h in only if not _has_rival(h, only, hypotheses, points)]


def _hypotheses(
    views: Views, detections: Sequence[NDArray[np.float64]], tolerance_px: float
) -> NDArray[np.int64]:
    """All (H, C) groups that some pair of dots proposes; without duplicates."""
    C = len(detections)
    found = []
    for a in range(C):
        for b in range(a + 1, C):
            ia, ib = _epipolar_pairs(views, detections, a, b, tolerance_px)
            if not len(ia):
                continue
            rows = np.full((len(ia), C), -1, np.int64)
            rows[:, a], rows[:, b] = ia, ib
            pair = triangulate(views, _gather(detections, rows), tolerance_px=tolerance_px)
            rows, X = rows[pair.used.any(axis=1)], pair.positions[pair.used.any(axis=1)]
            for c in range(C):
                if c in (a, b) or not len(detections[c]) or not len(X):
                    continue
                q = X @ views.matrices[c, :, :3].T + views.matrices[c, :, 3]
                gap = (q[:, None, :2] / q[:, None, 2:] - detections[c][None]) * views.focal_px[c]
                d = np.linalg.norm(gap, axis=2)
                best = d.argmin(axis=1)
                # the pair's own error grows on the way to a third view
                near = (d[np.arange(len(X)), best] < 2 * tolerance_px) & (q[:, 2] > 0)
                rows[near, c] = best[near]
            found.append(rows)
    return np.unique(np.concatenate(found), axis=0) if found else np.zeros((0, C), np.int64)


def _epipolar_pairs(
    views: Views, detections: Sequence[NDArray[np.float64]], a: int, b: int, tolerance_px: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of dots whose distance to each other's epipolar line is within the tolerance."""
    Ra, ta = views.matrices[a, :, :3], views.matrices[a, :, 3]
    Rb, tb = views.matrices[b, :, :3], views.matrices[b, :, 3]
    R = Rb @ Ra.T
    t = tb - R @ ta
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    E = cross @ R  # x_bᵀ E x_a = 0
    xa = np.column_stack([detections[a], np.ones(len(detections[a]))])
    xb = np.column_stack([detections[b], np.ones(len(detections[b]))])
    lines_b, lines_a = xa @ E.T, xb @ E
    value = np.abs(xb @ E @ xa.T)  # (N_b, N_a)
    far_b = value / np.linalg.norm(lines_b[:, :2], axis=1)[None] * views.focal_px[b]
    far_a = value / np.linalg.norm(lines_a[:, :2], axis=1)[:, None] * views.focal_px[a]
    ib, ia = np.nonzero((far_b < 2 * tolerance_px) & (far_a < 2 * tolerance_px))
    return ia, ib


def _gather(
    detections: Sequence[NDArray[np.float64]], rows: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Values of groups' dots, (H, C) or (H, C, 2); NaN where −1."""
    xy = np.full((*rows.shape, *detections[0].shape[1:]), np.nan)
    for c, d in enumerate(detections):
        seen = rows[:, c] >= 0
        xy[seen, c] = d[rows[seen, c]]
    return xy


def _no_points(C: int) -> Points:
    return Points(
        np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0), np.zeros(0), np.zeros((0, C), bool)
    )
