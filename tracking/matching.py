"""Which dots of different cameras are one marker: epipolar geometry over all views at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .triangulation import MIN_VIEWS, Points, Views, triangulate

#: A match of two views only is kept if no other match of either dot comes near this fit.
_AMBIGUITY = 3.0


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
    Hypotheses are taken in order of support, then of residual; each dot serves once. A hypothesis
    seen by two cameras only must have no rival of similar residual, since on a face full of dots
    two epipolar lines often cross by chance.

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
    hypotheses = np.where(points.used, hypotheses, -1)
    support = points.used.sum(axis=1)
    order = np.lexsort((points.residual_px, -support))
    taken = [np.zeros(len(d), bool) for d in detections]
    chosen: list[int] = []
    for h in order:
        row = hypotheses[h]
        seen = np.flatnonzero(row >= 0)
        if support[h] < MIN_VIEWS or any(taken[c][row[c]] for c in seen):
            continue
        if support[h] == MIN_VIEWS and _has_rival(h, hypotheses, points, taken):
            continue
        for c in seen:
            taken[c][row[c]] = True
        chosen.append(int(h))
    keep = np.array(chosen, dtype=np.int64)
    return hypotheses[keep], Points(
        points.positions[keep],
        points.information[keep],
        points.misfit[keep],
        points.residual_px[keep],
        points.used[keep],
    )


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


def _has_rival(
    h: np.int64, hypotheses: NDArray[np.int64], points: Points, taken: list[NDArray[np.bool_]]
) -> bool:
    """Whether another hypothesis of still free dots claims one of h's dots about as well."""
    row = hypotheses[h]
    shares = ((hypotheses == row) & (row >= 0)).any(axis=1)
    shares[h] = False
    for other in np.flatnonzero(shares):
        seen = np.flatnonzero(hypotheses[other] >= 0)
        if len(seen) < MIN_VIEWS or any(taken[c][hypotheses[other][c]] for c in seen):
            continue
        if points.residual_px[other] < _AMBIGUITY * max(points.residual_px[h], 0.1):
            return True
    return False


def _no_points(C: int) -> Points:
    return Points(
        np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0), np.zeros(0), np.zeros((0, C), bool)
    )
