"""Points from several views, by minimised reprojection error, with covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.camera import Camera

MIN_VIEWS = 2
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
        A view whose reprojection error exceeds this is left out, the worst one first, as long as
        more than two are left; a point whose two last views disagree by more is NaN.

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
    error = np.empty(C)
    for n in range(N):
        for c in range(C):
            used[n, c] = np.isfinite(xy[n, c, 0]) and np.isfinite(sd[n, c])
        while used[n].sum() >= MIN_VIEWS:
            X, JtJ, good = _solve(P, focal, xy[n], sd[n], used[n])
            if not good:
                used[n] = False
                break
            worst, total, chi2 = -1, 0.0, 0.0
            for c in range(C):
                if used[n, c]:
                    q = np.ascontiguousarray(P[c, :, :3]) @ X + P[c, :, 3]
                    du = (q[0] / q[2] - xy[n, c, 0]) * focal[c]
                    dv = (q[1] / q[2] - xy[n, c, 1]) * focal[c]
                    error[c] = du * du + dv * dv if q[2] > 0 else np.inf
                    total += error[c]
                    chi2 += error[c] / sd[n, c] ** 2
                    if worst < 0 or error[c] > error[worst]:
                        worst = c
            if error[worst] <= tolerance * tolerance:
                positions[n], information[n], misfit[n] = X, JtJ, chi2
                residual[n] = np.sqrt(total / used[n].sum())
                break
            if used[n].sum() == MIN_VIEWS:
                used[n] = False
                break
            used[n, worst] = False
        else:
            used[n] = False
    return positions, information, misfit, residual, used


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
