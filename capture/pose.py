"""Where a calibrated camera stands, from a few known points, of which some may be wrong."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, islice
from math import comb

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.arrays import readonly
from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rigid import Rigid
from .agreement import agreeing_points
from .bundle import Bundle, BundleCamera, BundleData, covariance_of, rotations, solve_bundle
from .projection import N_INTRINSICS, intrinsics_of

Floats = NDArray[np.float64]
MIN_POINTS = 4
_MAX_TRIPLES = 200
_MIN_SD_PX = 1e-9


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """A camera's pose and how sure it is.

    Attributes
    ----------
    camera_from_world : Rigid, mm
    covariance : (6, 6) float64
        Of δrotation (rad, camera axes; R = exp(δ) R_found) and translation (mm).
    residuals : (N, 2) float64, px
        Seen minus projected, of all points.
    is_used : (N,) bool
        False for the points that were found wrong.
    sd_px : float
        Standard deviation of a coordinate: as given, or as found from the used points.
    rms_px, rms_used_px : float
        Over all points, and over those used.
    """

    camera_from_world: Rigid
    covariance: Floats
    residuals: Floats
    is_used: NDArray[np.bool_]
    sd_px: float
    rms_px: float
    rms_used_px: float


def estimate_pose(
    points: ArrayLike,
    pixels: ArrayLike,
    camera: Camera,
    *,
    sd_px: float | None = None,
    rng: np.random.Generator | None = None,
) -> PoseEstimate:
    """Pose of a camera of known intrinsics, by least squares over the points that fit.

    Starts come from triples of points (P3P); the one under which most points agree (least median
    of squares) is refined, and points are kept or thrown out by their size against the noise.

    Parameters
    ----------
    points : (N, 3) float, mm, world frame
    pixels : (N, 2) float, px
    camera : Camera
        Its pose does not matter.
    sd_px : float, optional
        Standard deviation of the marking; found from the points if not given.
    rng : numpy Generator, optional
        Draws triples where there are too many to try all.

    Raises
    ------
    InputError
        If there are fewer than 4 points, they are collinear, or no pose has them in front.
    """
    X, uv = checked_points(points, pixels, MIN_POINTS)
    if is_collinear(X):
        raise InputError("the points lie on one line: the pose about it cannot be known")
    rng = rng or np.random.default_rng(0)
    ideal = camera.undistort(uv)
    if not np.isfinite(ideal).all():
        raise InputError("some pixels lie where the lens model cannot be inverted")
    start = _best_start(X, uv, ideal, camera, rng)
    if start is None:
        raise InputError(
            "no camera pose has the points in front of it: are pixels and points paired?"
        )
    fit, used = _refined(X, uv, camera, *start, sd_px)
    residuals = uv - Camera(
        camera.image_size,
        camera.matrix,
        Rigid.from_rotation(fit.target_rotation[0], fit.target_translation[0]),
        camera.distortion_model,
        camera.distortion,
    ).project(X)
    sd = sd_px if sd_px is not None else max(np.sqrt(fit.variance_factor), _MIN_SD_PX)
    if not np.isfinite(sd):
        raise InputError("3 points fix a pose but leave nothing to judge it by: give at least 4")
    information = _pose_information(fit)
    squares = (residuals**2).sum(axis=1)
    return PoseEstimate(
        Rigid.from_rotation(fit.target_rotation[0], fit.target_translation[0]),
        readonly(covariance_of(information) * sd**2, (6, 6), "covariance"),
        readonly(residuals, (len(X), 2), "residuals"),
        readonly(used, (len(X),), "is_used", np.bool_),
        float(sd),
        float(np.sqrt(squares.mean())),
        float(np.sqrt(squares[used].mean())),
    )


def checked_points(points: ArrayLike, pixels: ArrayLike, least: int) -> tuple[Floats, Floats]:
    """Points (N, 3) and pixels (N, 2) as arrays; InputError if there are too few, or not finite."""
    X, uv = np.asarray(points, dtype=np.float64), np.asarray(pixels, dtype=np.float64)
    if X.ndim != 2 or X.shape[1:] != (3,) or uv.shape != (len(X), 2):
        raise ValueError(f"expected points (N, 3) and pixels (N, 2), got {X.shape} and {uv.shape}")
    if not (np.isfinite(X).all() and np.isfinite(uv).all()):
        raise InputError("points and pixels must be finite numbers")
    if len(X) < least:
        raise InputError(f"expected at least {least} points, got {len(X)}")
    return X, uv


def is_collinear(points: Floats) -> bool:
    """Whether points lie on a line, to 1e-4 of their extent."""
    s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(s[1] <= 1e-4 * max(s[0], 1e-300))


def pose_bundle(
    X: Floats, uv: Floats, camera: Camera, R: Floats, t: Floats, *, robust: bool = False
) -> Bundle:
    """Least squares of the pose alone: the points are the one target."""
    row, model = intrinsics_of(camera)
    fixed = BundleCamera(
        row, model, np.zeros((N_INTRINSICS, 0)), np.eye(3), np.zeros(3), pose_is_free=False
    )
    n = len(X)
    zeros = np.zeros(n, dtype=np.int64)
    data = BundleData(zeros, zeros, X, uv, np.ones(n))
    return solve_bundle([fixed], R[None], t[None], data, robust=robust)


def _best_start(
    X: Floats, uv: Floats, ideal: Floats, camera: Camera, rng: np.random.Generator
) -> tuple[Floats, Floats] | None:
    """The P3P pose of some triple with the least middle-ranked error."""
    turns: list[Floats] = []
    shifts: list[Floats] = []
    for triple in _triples(len(X), rng):
        rows = list(triple)
        if not is_collinear(X[rows]):
            _, r, s = cv2.solveP3P(X[rows], ideal[rows], np.eye(3), None, cv2.SOLVEPNP_P3P)
            turns += r
            shifts += s
    if not turns:
        return None
    R = rotations(np.stack([r.ravel() for r in turns]))
    t = np.stack([s.ravel() for s in shifts])
    p = X @ np.swapaxes(R, 1, 2) + t[:, None]
    in_front = p[..., 2] > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        off = camera.pixel_from_normalised(camera.distort(p[..., :2] / p[..., 2:])) - uv
    squares = np.where(in_front, np.nan_to_num((off**2).sum(axis=2), nan=np.inf), np.inf)
    score = np.partition(squares, _agreeing(len(X)) - 1, axis=1)[:, _agreeing(len(X)) - 1]
    best = int(np.argmin(score))
    return (R[best], t[best]) if np.isfinite(score[best]) else None


def _agreeing(n: int) -> int:
    """How many of n points must agree: the three that fix a pose, and half of the others."""
    return min(n, (n + 4) // 2)


def _triples(n: int, rng: np.random.Generator) -> list[tuple[int, ...]]:
    if comb(n, 3) <= _MAX_TRIPLES:
        return list(combinations(range(n), 3))
    drawn = (tuple(sorted(rng.choice(n, 3, replace=False))) for _ in range(_MAX_TRIPLES))
    return list(islice(drawn, _MAX_TRIPLES))


def _refined(
    X: Floats, uv: Floats, camera: Camera, R: Floats, t: Floats, sd_px: float | None
) -> tuple[Bundle, NDArray[np.bool_]]:
    """Least squares over the points that agree; the set is grown from the best half."""
    n = len(X)
    squares = ((_projected(X, camera, R, t) - uv) ** 2).sum(axis=1)
    used = squares <= np.sort(squares)[_agreeing(n) - 1]
    fit = pose_bundle(X[used], uv[used], camera, R, t)
    for _ in range(10):
        R, t = fit.target_rotation[0], fit.target_translation[0]
        off = uv - _projected(X, camera, R, t)
        J = pose_jacobian(X, camera, R, t)
        now = agreeing_points(off, J, used, sd_px, least=MIN_POINTS)
        if (now == used).all():
            break
        used = now
        fit = pose_bundle(X[used], uv[used], camera, R, t)
    return fit, used


def _projected(X: Floats, camera: Camera, R: Floats, t: Floats) -> Floats:
    p = X @ R.T + t
    with np.errstate(divide="ignore", invalid="ignore"):
        found = camera.pixel_from_normalised(camera.distort(p[:, :2] / p[:, 2:]))
    return np.where((p[:, 2] > 0)[:, None], np.nan_to_num(found, nan=1e6), 1e6)


def pose_jacobian(X: Floats, camera: Camera, R: Floats, t: Floats) -> Floats:
    """Derivatives of pixels by δrotation and translation, (N, 2, 6)."""
    from .projection import project_one

    row, model = intrinsics_of(camera)
    found = np.zeros((len(X), 2, 6))
    uv, J_row, J_point = np.zeros(2), np.zeros((2, 16)), np.zeros((2, 3))
    for i, turned in enumerate(X @ R.T):
        if project_one(row, model, *(turned + t), uv, J_row, J_point):
            found[i, :, :3] = np.cross(turned, J_point)
            found[i, :, 3:] = J_point
    return found


def _pose_information(fit: Bundle) -> Floats:
    """(6, 6) information of the one target, for a noise of 1 px."""
    camera = fit.cameras[0]
    J = _bundle_pose_jacobian(fit, camera)
    return np.asarray(np.einsum("nai,naj->ij", J, J))


def _bundle_pose_jacobian(fit: Bundle, camera: BundleCamera) -> Floats:
    from .projection import camera_of

    pinhole = camera_of(camera.intrinsics, camera.model, (1, 1), Rigid.identity())
    return pose_jacobian(
        fit.data.points, pinhole, fit.target_rotation[0], fit.target_translation[0]
    )
