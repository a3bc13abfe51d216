"""The camera: pinhole, lens distortion, pose."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import readonly
from .rigid import Rigid

#: Number of coefficients each distortion model accepts.
DISTORTION_MODELS: dict[str, tuple[int, ...]] = {
    "none": (0,),
    "opencv": (0, 5, 8, 12),
    "tsai": (1,),
}
_NEWTON_STEPS = 50
_NEWTON_TOLERANCE = 1e-14  # normalised coordinates


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated camera: pinhole with lens distortion, and its pose.

    Axes: x right, y down, z forward. The centre of the top-left pixel is (0, 0).

    Attributes
    ----------
    image_size : (width, height) int, px
    matrix : (3, 3) float64, px
        Intrinsics ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]``.
    camera_from_world : Rigid, mm
    distortion_model : str
        ``"none"``; ``"opencv"`` with 0, 5 (k1 k2 p1 p2 k3), 8 (… k4 k5 k6) or 12 (… s1 s2 s3 s4)
        coefficients as in OpenCV's documentation of ``projectPoints``; or ``"tsai"`` with [κ1],
        dimensionless: ``p_undistorted = p_distorted (1 + κ1 ‖p_distorted‖²)`` (Tsai 1987, eq. 5,
        his κ1 in mm⁻² times f² in mm²).
    distortion : (n,) float64
    """

    image_size: tuple[int, int]
    matrix: NDArray[np.float64]
    camera_from_world: Rigid = field(default_factory=Rigid.identity)
    distortion_model: str = "none"
    distortion: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        width, height = (int(n) for n in self.image_size)
        if width < 1 or height < 1:
            raise ValueError(f"image_size must be at least 1x1, got {width}x{height}")
        object.__setattr__(self, "image_size", (width, height))
        K = readonly(self.matrix, (3, 3), "matrix")
        if not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
            raise ValueError("matrix must be finite with positive focal lengths")
        if K[1, 0] or np.any(K[2] != (0, 0, 1)):
            raise ValueError("matrix must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]]")
        object.__setattr__(self, "matrix", K)
        object.__setattr__(self, "distortion", readonly(self.distortion, (None,), "distortion"))
        counts = DISTORTION_MODELS.get(self.distortion_model)
        if counts is None:
            known = ", ".join(DISTORTION_MODELS)
            raise ValueError(
                f"distortion_model must be one of {known}, not {self.distortion_model}"
            )
        if len(self.distortion) not in counts:
            raise ValueError(
                f"distortion model {self.distortion_model} takes {' or '.join(map(str, counts))} "
                f"coefficients, got {len(self.distortion)}"
            )
        if not np.isfinite(self.distortion).all():
            raise ValueError("distortion must be finite")

    @property
    def position(self) -> NDArray[np.float64]:
        """(3,) float64, mm, world frame: the centre of projection."""
        return self.camera_from_world.inverse().translation

    @property
    def focal_px(self) -> float:
        """The geometric mean of fx and fy."""
        return float(np.sqrt(self.matrix[0, 0] * self.matrix[1, 1]))

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Project world points into the image.

        Parameters
        ----------
        points : (..., 3) float, mm, world frame

        Returns
        -------
        (..., 2) float64, px
            NaN where a point is not in front of the camera, or so far off the axis that the
            distortion model folds back there. Points outside the picture are returned.

        Raises
        ------
        ValueError
            If the last axis of `points` is not 3 long.

        References
        ----------
        Hartley & Zisserman, Multiple View Geometry, 2nd ed., eq. 6.8.
        """
        p = self.camera_from_world.apply(points)
        depth = np.where(p[..., 2] > 0, p[..., 2], np.nan)
        return self.pixel_from_normalised(self.distort(p[..., :2] / depth[..., None]))

    def ray(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Unit directions, world frame, of the rays from `position` through pixels.

        Parameters
        ----------
        pixels : (..., 2) float, px

        Returns
        -------
        (..., 3) float64
        """
        xy = self.undistort(pixels)
        d = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        d = d @ self.camera_from_world.rotation
        return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))

    def undistort(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Ideal normalised image coordinates of distorted pixels.

        Parameters
        ----------
        pixels : (..., 2) float, px

        Returns
        -------
        (..., 2) float64, dimensionless
            x/z and y/z in the camera frame; NaN where the distortion cannot be inverted.
        """
        pix = np.asarray(pixels, dtype=np.float64)
        if pix.shape[-1:] != (2,):
            raise ValueError(f"pixels must have shape (..., 2), got {pix.shape}")
        K = self.matrix
        y = (pix[..., 1] - K[1, 2]) / K[1, 1]
        x = (pix[..., 0] - K[0, 2] - K[0, 1] * y) / K[0, 0]
        distorted = np.stack([x, y], axis=-1)
        if self.distortion_model == "tsai":
            r2 = (distorted**2).sum(axis=-1, keepdims=True)
            return np.asarray(distorted * (1 + self.distortion[0] * r2))
        if not len(self.distortion):
            return distorted
        return _invert(self.distort, distorted)

    def pixel_from_normalised(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Pixels of (already distorted) normalised coordinates, both (..., 2)."""
        p = np.asarray(xy, dtype=np.float64)
        return p @ self.matrix[:2, :2].T + self.matrix[:2, 2]

    def distort(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Distorted normalised coordinates of ideal ones, both (..., 2), dimensionless.

        NaN beyond the radius at which the model's radial part stops growing: what lies outside
        would fold back into the picture.
        """
        p = np.asarray(xy, dtype=np.float64)
        if self.distortion_model == "tsai":
            return _tsai_distort(p, float(self.distortion[0]))
        if not len(self.distortion):
            return p
        k = np.zeros(12)
        k[: len(self.distortion)] = self.distortion
        x, y = p[..., 0], p[..., 1]
        r2 = x * x + y * y
        top = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        bottom = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
        radial = np.where(r2 < self._fold_radius2(), top / bottom, np.nan)
        r4 = r2 * r2
        found_x = x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x) + k[8] * r2 + k[9] * r4
        found_y = y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y + k[10] * r2 + k[11] * r4
        return np.stack([found_x, found_y], axis=-1)

    def _fold_radius2(self) -> float:
        """Square of the radius at which r ↦ r (1+k1r²+…)/(1+k4r²+…) stops growing (or inf)."""
        cached = self.__dict__.get("_fold")
        if cached is not None:
            return float(cached)
        k = np.zeros(8)
        k[: min(8, len(self.distortion))] = self.distortion[:8]
        top = np.polynomial.Polynomial([1, k[0], k[1], k[4]])  # in s = r²
        bottom = np.polynomial.Polynomial([1, k[5], k[6], k[7]])
        s = np.polynomial.Polynomial([0, 1])
        slope = top * bottom + 2 * s * (top.deriv() * bottom - top * bottom.deriv())
        roots = np.concatenate([slope.roots(), bottom.roots()])
        real = roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)].real
        found = float(real.min()) if len(real) else np.inf
        object.__setattr__(self, "_fold", found)
        return found


def _tsai_distort(p: NDArray[np.float64], kappa: float) -> NDArray[np.float64]:
    """Solve r_u = r_d (1 + κ r_d²) for r_d by Newton's method; NaN where no root grows."""
    r_u = np.linalg.norm(p, axis=-1)
    if kappa < 0:  # the largest r_u that has a solution lies where the slope is zero
        r_u = np.where(r_u < 2 / 3 / np.sqrt(-3 * kappa), r_u, np.nan)
    r_d = np.minimum(r_u, 1 / np.sqrt(-3 * kappa) if kappa < 0 else r_u)
    for _ in range(_NEWTON_STEPS):
        slope = 1 + 3 * kappa * r_d**2
        step = (r_d * (1 + kappa * r_d**2) - r_u) / np.where(slope > 1e-12, slope, 1e-12)
        r_d = r_d - step
        if not np.any(np.abs(step) > _NEWTON_TOLERANCE):
            break
    ratio = np.divide(r_d, r_u, out=np.ones_like(r_u), where=r_u != 0)
    return np.asarray(p * ratio[..., None])


def _invert(distort: object, target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Newton's method with a numerical Jacobian on a smooth map of the plane."""
    assert callable(distort)
    shape = target.shape
    goal = target.reshape(-1, 2)
    p = goal.copy()
    h = 1e-7
    for _ in range(_NEWTON_STEPS):
        here = distort(p)
        off = here - goal
        J = np.stack([(distort(p + (h, 0)) - here) / h, (distort(p + (0, h)) - here) / h], axis=-1)
        det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
        det = np.where(np.abs(det) > 1e-9, det, np.nan)
        step = np.stack(
            [
                (J[:, 1, 1] * off[:, 0] - J[:, 0, 1] * off[:, 1]) / det,
                (J[:, 0, 0] * off[:, 1] - J[:, 1, 0] * off[:, 0]) / det,
            ],
            axis=-1,
        )
        p = p - step
        if not np.any(np.abs(step) > _NEWTON_TOLERANCE * 10):
            break
    solved = (np.abs(distort(p) - goal) < 1e-9).all(axis=1)
    return np.where(solved[:, None], p, np.nan).reshape(shape)
