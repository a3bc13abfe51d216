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
    q = np.ascontiguousarray(P[c, :, :3]) @ X + P[c, :, 3]
    if q[2] <= 0:
        return np.inf
    du = (q[0] / q[2] - xy[c, 0]) * focal[c]
    dv = (q[1] / q[2] - xy[c, 1]) * focal[c]
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
    A, b = np.zeros((3, 3)), np.zeros(3)
    for c in range(len(used)):
        if used[c]:
            R = np.ascontiguousarray(P[c, :, :3])
            d = R.T.copy() @ np.array([xy[c, 0], xy[c, 1], 1.0])
            d /= np.sqrt((d * d).sum())
            origin = -(R.T.copy() @ np.ascontiguousarray(P[c, :, 3]))
            M = np.eye(3) - np.outer(d, d)
            A += M / sd[c] ** 2
            b += M @ origin / sd[c] ** 2
    if abs(np.linalg.det(A)) < 1e-9 * np.trace(A) ** 3:  # parallel rays
        return b, A, False
    X = np.linalg.solve(A, b)
    JtJ = np.zeros((3, 3))
    for _ in range(_STEPS):
        JtJ = np.zeros((3, 3))
        g = np.zeros(3)
        for c in range(len(used)):
            if used[c]:
                R = np.ascontiguousarray(P[c, :, :3])
                q = R @ X + P[c, :, 3]
                if q[2] <= 0:
                    return X, JtJ, False
                u, v = q[0] / q[2], q[1] / q[2]
                ju = (R[0] - u * R[2]) * (focal[c] / q[2] / sd[c])
                jv = (R[1] - v * R[2]) * (focal[c] / q[2] / sd[c])
                du, dv = (u - xy[c, 0]) * focal[c], (v - xy[c, 1]) * focal[c]
                du, dv = du / sd[c], dv / sd[c]
                JtJ += np.outer(ju, ju) + np.outer(jv, jv)
                g += ju * du + jv * dv
        if abs(np.linalg.det(JtJ)) < 1e-12 * np.trace(JtJ) ** 3:
            return X, JtJ, False
        step = np.linalg.solve(JtJ, g)
        X = X - step
        if (step * step).sum() < 1e-18:
            break
    return X, JtJ, True
