"""Points from several views, by minimised reprojection error, with covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.camera import Camera

MIN_VIEWS = 2
MAX_SUBSET_VIEWS = 8  # up to here every subset of disagreeing views is tried
_STEPS = 5


@dataclass(frozen=True, eq=False)
class Views:
    """Cameras in the form that the solver wants: ideal pinholes, lens removed.

    Attributes
    ----------
    matrices : (C, 3, 4) float64
        Normalised projection: camera from world.
    focal_px : (C,) float64
        Turns normalised residuals into pixels.
    cameras : tuple of Camera
    """

    matrices: NDArray[np.float64]
    focal_px: NDArray[np.float64]
    cameras: tuple[Camera, ...]

    @classmethod
    def of(cls, cameras: Sequence[Camera]) -> Views:
        """From calibrated cameras."""
        return cls(
            np.stack([c.camera_from_world.matrix[:3] for c in cameras]),
            np.array([c.focal_px for c in cameras]),
            tuple(cameras),
        )

    def normalised(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where ideal pinholes see world points: (N, 3) mm to (N, C, 2); NaN behind a camera."""
        q = np.einsum("cij,nj->nci", self.matrices[:, :, :3], points) + self.matrices[:, :, 3]
        depth = np.where(q[..., 2:] > 0, q[..., 2:], np.nan)
        return np.asarray(q[..., :2] / depth)

    def depths(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of world points along the optical axes: (N, 3) mm to (N, C) mm."""
        return np.asarray(points @ self.matrices[:, 2, :3].T + self.matrices[:, 2, 3])


@dataclass(frozen=True, eq=False)
class Points:
    """Triangulated points.

    Attributes
    ----------
    positions : (N, 3) float64, mm, world frame
        NaN where fewer than two views agree.
    information : (N, 3, 3) float64, mm⁻²
        JᵀJ of the reprojection errors over their standard deviations; its inverse is the
        covariance if those are right.
    misfit : (N,) float64
        Sum of squares of the errors over their standard deviations.
    residual_px : (N,) float64
        RMS over the views used, sqrt(mean(du² + dv²)).
    used : (N, C) bool
        Views that agree.
    """

    positions: NDArray[np.float64]
    information: NDArray[np.float64]
    misfit: NDArray[np.float64]
    residual_px: NDArray[np.float64]
    used: NDArray[np.bool_]

    def select(self, rows: NDArray[Any]) -> Points:
        """Some of the points, by index or mask."""
        return Points(
            self.positions[rows],
            self.information[rows],
            self.misfit[rows],
            self.residual_px[rows],
            self.used[rows],
        )

    def replace(self, rows: NDArray[np.int64], others: Points) -> Points:
        """The points with those of some rows exchanged."""
        found = []
        for name in ("positions", "information", "misfit", "residual_px", "used"):
            values = getattr(self, name).copy()
            values[rows] = getattr(others, name)
            found.append(values)
        return Points(*found)


def joined_points(parts: Sequence[Points]) -> Points:
    """Points of several sets, one after another."""
    names = ("positions", "information", "misfit", "residual_px", "used")
    return Points(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))


def triangulate(
    views: Views,
    normalised: NDArray[np.float64],
    sd_px: NDArray[np.float64] | None = None,
    *,
    tolerance_px: float = 1.0,
) -> Points:
    """Triangulate points, leaving out views that disagree.

    Parameters
    ----------
    views : Views
    normalised : (N, C, 2) float64
        Undistorted normalised coordinates (`Camera.undistort`); NaN where unseen.
    sd_px : (N, C) float64, optional
        How sure each is; 1 by default. Views are weighted by the inverse square, so that the
        solution follows the sure ones and the others are found out by their errors.
    tolerance_px : float
        Views that cannot be brought together within this reprojection error are parted: the
        largest set that agrees is kept, and of equally large ones the one whose dots are surest
        (two half hidden dots may agree as well as two whole ones). NaN if no two views agree.

    Notes
    -----
    Start: the point nearest to all rays. Then Gauss-Newton on the reprojection error (Hartley &
    Zisserman 2004, section 12.3, for any number of views).
    """
    sd = np.ones(normalised.shape[:2]) if sd_px is None else sd_px
    p, info, misfit, rms, used = _triangulate(
        views.matrices, views.focal_px, np.ascontiguousarray(normalised), sd, tolerance_px
    )
    return Points(p, info, misfit, rms, used)


@njit(cache=True, nogil=True)
def _triangulate(P, focal, xy, sd, tolerance):  # type: ignore[no-untyped-def]
    N, C = xy.shape[:2]
    positions = np.full((N, 3), np.nan)
    information = np.full((N, 3, 3), np.nan)
    misfit, residual = np.full(N, np.nan), np.full(N, np.nan)
    used = np.zeros((N, C), np.bool_)
    for n in range(N):
        seen = np.isfinite(xy[n, :, 0]) & np.isfinite(sd[n])
        while seen.sum() > MAX_SUBSET_VIEWS:  # too many subsets: the worst go one by one
            X, JtJ, worst, largest, chi2 = _fit(P, focal, xy[n], sd[n], seen)
            if worst < 0 or largest <= tolerance * tolerance:
                break
            seen[worst] = False
        cameras = np.flatnonzero(seen)
        count = len(cameras)
        for size in range(count, MIN_VIEWS - 1, -1):
            best = np.inf
            for mask in range(1 << min(count, MAX_SUBSET_VIEWS + 1)):
                subset = np.zeros(C, np.bool_)
                unsure = 0.0
                for k in range(count):
                    if (mask >> k) & 1 or size == count:
                        subset[cameras[k]] = True
                        unsure += sd[n, cameras[k]] ** 2
                if subset.sum() != size or unsure >= best:
                    continue
                X, JtJ, worst, largest, chi2 = _fit(P, focal, xy[n], sd[n], subset)
                if worst >= 0 and largest <= tolerance * tolerance:
                    best = unsure
                    positions[n], information[n], misfit[n], used[n] = X, JtJ, chi2, subset
                if size == count:
                    break
            if best < np.inf:
                break
        if used[n].any():
            squares = 0.0
            for c in range(C):
                if used[n, c]:
                    squares += _error2(P, focal, xy[n], positions[n], c)
            residual[n] = np.sqrt(squares / used[n].sum())
    return positions, information, misfit, residual, used


@njit(cache=True, nogil=True)
def _error2(P, focal, xy, X, c):  # type: ignore[no-untyped-def]
    """Squared reprojection error in one view, px²; inf behind the camera."""
    qx = P[c, 0, 0] * X[0] + P[c, 0, 1] * X[1] + P[c, 0, 2] * X[2] + P[c, 0, 3]
    qy = P[c, 1, 0] * X[0] + P[c, 1, 1] * X[1] + P[c, 1, 2] * X[2] + P[c, 1, 3]
    qz = P[c, 2, 0] * X[0] + P[c, 2, 1] * X[1] + P[c, 2, 2] * X[2] + P[c, 2, 3]
    if qz <= 0:
        return np.inf
    du = (qx / qz - xy[c, 0]) * focal[c]
    dv = (qy / qz - xy[c, 1]) * focal[c]
    return du * du + dv * dv


@njit(cache=True, nogil=True)
def _fit(P, focal, xy, sd, used):  # type: ignore[no-untyped-def]
    """Position, JᵀJ, the worst view (−1 if there is no solution), its squared error, misfit."""
    X, JtJ, good = _solve(P, focal, xy, sd, used)
    worst, largest, chi2 = -1, np.inf, 0.0
    if good:
        for c in range(len(used)):
            if used[c]:
                error = _error2(P, focal, xy, X, c)
                chi2 += error / sd[c] ** 2
                if worst < 0 or error > largest:
                    worst, largest = c, error
    return X, JtJ, worst, largest, chi2


@njit(cache=True, nogil=True)
def _solve(P, focal, xy, sd, used):  # type: ignore[no-untyped-def]
    """Position and JᵀJ (pixels), and whether it is well determined."""
    A, g = np.zeros((3, 3)), np.zeros(3)
    d, origin, row = np.zeros(3), np.zeros(3), np.zeros(3)
    for c in range(len(used)):
        if used[c]:
            length2 = 0.0
            for i in range(3):
                d[i] = P[c, 0, i] * xy[c, 0] + P[c, 1, i] * xy[c, 1] + P[c, 2, i]
                origin[i] = -(
                    P[c, 0, i] * P[c, 0, 3] + P[c, 1, i] * P[c, 1, 3] + P[c, 2, i] * P[c, 2, 3]
                )
                length2 += d[i] * d[i]
            weight = 1 / sd[c] ** 2
            for i in range(3):
                for j in range(3):
                    m = ((1.0 if i == j else 0.0) - d[i] * d[j] / length2) * weight
                    A[i, j] += m
                    g[i] += m * origin[j]
    X = np.zeros(3)
    if not _divide(A, g, X, 1e-9):  # parallel rays
        return X, A, False
    step = np.zeros(3)
    for _ in range(_STEPS):
        A[:] = 0.0
        g[:] = 0.0
        for c in range(len(used)):
            if used[c]:
                qx = P[c, 0, 0] * X[0] + P[c, 0, 1] * X[1] + P[c, 0, 2] * X[2] + P[c, 0, 3]
                qy = P[c, 1, 0] * X[0] + P[c, 1, 1] * X[1] + P[c, 1, 2] * X[2] + P[c, 1, 3]
                qz = P[c, 2, 0] * X[0] + P[c, 2, 1] * X[1] + P[c, 2, 2] * X[2] + P[c, 2, 3]
                if qz <= 0:
                    return X, A, False
                scale = focal[c] / sd[c]
                for k in range(2):
                    place = (qx if k == 0 else qy) / qz
                    off = (place - xy[c, k]) * scale
                    for i in range(3):
                        row[i] = (P[c, k, i] - place * P[c, 2, i]) * scale / qz
                    for i in range(3):
                        g[i] += row[i] * off
                        for j in range(3):
                            A[i, j] += row[i] * row[j]
        if not _divide(A, g, step, 1e-12):
            return X, A, False
        length2 = 0.0
        for i in range(3):
            X[i] -= step[i]
            length2 += step[i] * step[i]
        if length2 < 1e-18:
            break
    return X, A, True


@njit(cache=True, nogil=True)
def _divide(A, b, x, limit):  # type: ignore[no-untyped-def]
    """Solve A x = b for a symmetric 3 × 3 A; False if its determinant says it is singular."""
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[1, 2]
    c01 = A[0, 2] * A[1, 2] - A[0, 1] * A[2, 2]
    c02 = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
    det = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    trace = A[0, 0] + A[1, 1] + A[2, 2]
    if not abs(det) >= limit * trace**3:
        return False
    c11 = A[0, 0] * A[2, 2] - A[0, 2] * A[0, 2]
    c12 = A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]
    c22 = A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1]
    x[0] = (c00 * b[0] + c01 * b[1] + c02 * b[2]) / det
    x[1] = (c01 * b[0] + c11 * b[1] + c12 * b[2]) / det
    x[2] = (c02 * b[0] + c12 * b[1] + c22 * b[2]) / det
    return True
