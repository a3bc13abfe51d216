"""Least squares over cameras and poses: the one solver that every calibration stands on.

A point of target l at X (target frame) is seen by camera c at

    u = project(intrinsics_c, R_c (R_l X + t_l) + t_c) + noise.

Targets are boards, wands, a set of known points (Tsai's) or, with only their translation free,
single points of unknown place. Global parameters are the cameras' intrinsics and poses; targets
couple only through them and are eliminated (Schur complement), so that a calibration of a
thousand views costs a thousand small inverses. Rotations change by exp(δ) R, from the left.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.arrays import readonly
from .projection import N_INTRINSICS, project_one

Floats = NDArray[np.float64]
#: Huber's loss turns linear beyond this many standard deviations.
HUBER_SD = 1.5
_MAX_STEPS = 200
_TOLERANCE = 1e-12  # of the cost, relative
#: Eigenvalues of a unit-diagonal information below this are rounding.
_UNDETERMINED = 1e-14


@dataclass(frozen=True, eq=False)
class BundleCamera:
    """A camera to be estimated.

    Attributes
    ----------
    intrinsics : (16,) float64
        As in `projection`.
    model : int
    free : (16, K) float64
        How each estimated parameter moves the intrinsics.
    rotation, translation : (3, 3), (3,) float64
        Camera from world, mm.
    pose_is_free : bool
    """

    intrinsics: Floats
    model: int
    free: Floats
    rotation: Floats
    translation: Floats
    pose_is_free: bool


@dataclass(frozen=True, eq=False)
class BundleData:
    """What was seen, sorted by target.

    Attributes
    ----------
    camera, target : (N,) int64
    points : (N, 3) float64, mm, target frame
    pixels : (N, 2) float64, px
    sd_px : (N,) float64
        Standard deviation of each coordinate.
    """

    camera: NDArray[np.int64]
    target: NDArray[np.int64]
    points: Floats
    pixels: Floats
    sd_px: Floats

    def __post_init__(self) -> None:
        n = len(self.camera)
        order = np.argsort(self.target, kind="stable")
        for name, shape, kind in (
            ("camera", (n,), np.int64), ("target", (n,), np.int64), ("points", (n, 3), np.float64),
            ("pixels", (n, 2), np.float64), ("sd_px", (n,), np.float64),
        ):  # fmt: skip
            value = np.asarray(getattr(self, name))
            if value.shape != shape:
                raise ValueError(f"{name} must have shape {shape}, got {value.shape}")
            object.__setattr__(self, name, readonly(value[order], shape, name, kind))


@dataclass(frozen=True, eq=False)
class Bundle:
    """A solution.

    Attributes
    ----------
    cameras : tuple of BundleCamera
    target_rotation, target_translation : (L, 3, 3), (L, 3) float64
        World from target, mm.
    data : BundleData
    residuals : (N, 2) float64, px
        Seen minus projected.
    weights : (N,) float64
        What a robust loss left of each observation, 0 to 1.
    cost : float
        Sum of the (robust) squares of residuals over their standard deviations.
    n_parameters : int
    information : (G, G) float64
        Of the global parameters, targets eliminated; its inverse is their covariance for the
        given `sd_px`.
    target_information : (L, T, T) float64
        Of the T free parameters of each target, for fixed globals.
    mixed_information : (L, G, T) float64
    target_free : (6,) bool
        Which of a target's δrotation and translation were estimated.
    converged : bool
    n_steps : int
    """

    cameras: tuple[BundleCamera, ...]
    target_rotation: Floats
    target_translation: Floats
    data: BundleData
    residuals: Floats
    weights: Floats
    cost: float
    n_parameters: int
    information: Floats
    target_information: Floats
    mixed_information: Floats
    target_free: NDArray[np.bool_]
    converged: bool
    n_steps: int

    @property
    def rms_px(self) -> float:
        """Root of the mean squared distance, over all points."""
        return float(np.sqrt((self.residuals**2).sum(axis=1).mean()))

    @property
    def variance_factor(self) -> float:
        """Estimated variance over the given one: χ² per degree of freedom; NaN without any."""
        freedom = 2 * len(self.residuals) - self.n_parameters
        return self.cost / freedom if freedom > 0 else float("nan")

    @property
    def full_information(self) -> Floats:
        """Of globals and all targets' parameters, (G + L T, G + L T); for small problems."""
        n_targets, n_global, n_free = self.mixed_information.shape
        size = n_global + n_targets * n_free
        found = np.zeros((size, size))
        eliminated = np.zeros((n_global, n_global))
        for k in range(n_targets):
            rows = slice(n_global + k * n_free, n_global + (k + 1) * n_free)
            H, M = self.target_information[k], self.mixed_information[k]
            found[rows, rows], found[:n_global, rows], found[rows, :n_global] = H, M, M.T
            eliminated += M @ np.linalg.pinv(H, hermitian=True) @ M.T
        found[:n_global, :n_global] = self.information + eliminated
        return found

    def columns(self, camera: int) -> tuple[slice, slice]:
        """Where a camera's intrinsics and pose (δrotation, then translation) stand in G."""
        start = sum(_width(c) for c in self.cameras[:camera])
        k = self.cameras[camera].free.shape[1]
        end = start + _width(self.cameras[camera])
        return slice(start, start + k), slice(start + k, end)


def covariance_of(information: Floats) -> Floats:
    """The inverse of an information matrix; huge, not zero, for what the data do not determine.

    A pseudo-inverse would call a combination that nothing determines certain.
    """
    if not len(information):
        return np.zeros((0, 0))
    diagonal = np.diag(information)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, max(float(diagonal.max()), 1e-300)))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    held = np.maximum(values, _UNDETERMINED)
    return np.asarray((vectors / held) @ vectors.T * np.outer(scale, scale))


@dataclass(frozen=True, eq=False)
class TargetPart:
    """What one target's observations add to the normal equations at a solution.

    Attributes
    ----------
    H : (G, G) float64
        Information of the global parameters, the target held.
    g : (G,) float64
        Half the slope of the sum of squares, downhill.
    g_target : (T,) float64
        The same by the target's free parameters.
    """

    H: Floats
    g: Floats
    g_target: Floats


def target_parts(fit: Bundle) -> Iterator[TargetPart]:
    """A solution's normal equations target by target."""
    state = _State.of(fit.cameras, fit.target_rotation, fit.target_translation)
    data, free = fit.data, fit.target_free
    ends = np.searchsorted(data.target, np.arange(len(fit.target_rotation) + 1))
    for k, (start, end) in enumerate(itertools.pairwise(ends)):
        at, zeros = slice(start, end), np.zeros(end - start, dtype=np.int64)
        # an observation that a robust loss weighs less is as one of a larger deviation
        sd = data.sd_px[at] / np.sqrt(fit.weights[at])
        _, H, g, _, g_target, _, _, _ = _accumulate(
            data.camera[at], zeros, data.points[at], data.pixels[at], sd,
            np.array([0, end - start]), state.intrinsics, state.model, state.free, state.n_free,
            state.start, state.pose_start, state.n_global, state.R, state.t,
            state.target_R[k : k + 1], state.target_t[k : k + 1], np.inf,
        )  # fmt: skip
        yield TargetPart(H, g, g_target[0, free])


def root_of(covariance: Floats) -> Floats:
    """A matrix whose product with its transpose is the covariance.

    Entries may have very different sizes: a focal length beside a distortion.
    """
    sd = np.sqrt(np.maximum(np.diag(covariance), 0))
    scale = np.where(sd > 0, sd, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(sd[:, None] * (vectors * np.sqrt(np.maximum(values, 0))))


def _width(camera: BundleCamera) -> int:
    return int(camera.free.shape[1]) + (6 if camera.pose_is_free else 0)


def solve_bundle(
    cameras: Sequence[BundleCamera],
    target_rotation: Floats,
    target_translation: Floats,
    data: BundleData,
    *,
    target_free: Sequence[bool] = (True,) * 6,
    target_prior: Sequence[float] = (0.0,) * 6,
    robust: bool = False,
    max_steps: int = _MAX_STEPS,
) -> Bundle:
    """Levenberg-Marquardt from a start.

    Parameters
    ----------
    cameras : sequence of BundleCamera
        With their starting values.
    target_rotation, target_translation : (L, 3, 3), (L, 3) float64
        World from target at the start, mm.
    data : BundleData
    target_free : 6 bool
        Which of δrotation (world axes) and translation of targets are estimated.
    target_prior : 6 float
        Information (1/sd²) that holds each step of a target where it is: what cannot be seen,
        such as the spin of a wand about itself, needs a little.
    robust : bool
        Huber's loss instead of squares.
    max_steps : int

    Returns
    -------
    Bundle
        ``converged`` is False if it ran out of steps.
    """
    state = _State.of(cameras, target_rotation, target_translation)
    free = np.array(target_free, dtype=np.bool_)
    prior = np.where(free, np.array(target_prior, dtype=np.float64), 0.0)
    huber = HUBER_SD if robust else np.inf
    starts = np.searchsorted(data.target, np.arange(len(target_rotation) + 1))
    parts = _normal_equations(data, state, starts, prior, huber)
    damping, converged, n_steps = 1e-4, False, 0
    while n_steps < max_steps:
        n_steps += 1
        change = _solve_step(parts, free, damping)
        if change is None:
            damping *= 10
            if damping > 1e12:
                break
            continue
        trial = state.moved(*change)
        trial_parts = _normal_equations(data, trial, starts, prior, huber)
        gain = parts.cost - trial_parts.cost
        if gain >= 0:
            small = gain <= _TOLERANCE * (parts.cost + 1e-12)
            state, parts, damping = trial, trial_parts, max(damping / 8, 1e-15)
            if small:
                converged = True
                break
        else:
            # at the bottom, rounding alone may make things worse
            if -gain <= 1e-10 * (parts.cost + 1e-12) and damping > 1e-3:
                converged = True
                break
            damping *= 6
            if damping > 1e12:
                break
    return _result(cameras, state, data, parts, free, converged, n_steps)


@dataclass(frozen=True, eq=False)
class _State:
    """All that changes from step to step, as plain arrays for the compiled loop."""

    intrinsics: Floats  # (C, 16)
    model: NDArray[np.int64]
    free: Floats  # (C, 16, K) padded
    n_free: NDArray[np.int64]
    start: NDArray[np.int64]  # first column of each camera
    pose_start: NDArray[np.int64]  # -1 where fixed
    n_global: int
    R: Floats
    t: Floats
    target_R: Floats
    target_t: Floats

    @classmethod
    def of(cls, cameras: Sequence[BundleCamera], target_R: Floats, target_t: Floats) -> _State:
        widest = max(1, *(c.free.shape[1] for c in cameras))
        free = np.zeros((len(cameras), N_INTRINSICS, widest))
        for i, c in enumerate(cameras):
            free[i, :, : c.free.shape[1]] = c.free
        widths = np.array([_width(c) for c in cameras])
        start = np.concatenate([[0], np.cumsum(widths)[:-1]]).astype(np.int64)
        n_free = np.array([c.free.shape[1] for c in cameras], dtype=np.int64)
        poses = [start[i] + n_free[i] if c.pose_is_free else -1 for i, c in enumerate(cameras)]
        return cls(
            np.stack([c.intrinsics for c in cameras]).astype(np.float64),
            np.array([c.model for c in cameras], dtype=np.int64),
            free,
            n_free,
            start,
            np.array(poses, dtype=np.int64),
            int(widths.sum()),
            np.stack([c.rotation for c in cameras]).astype(np.float64),
            np.stack([c.translation for c in cameras]).astype(np.float64),
            np.ascontiguousarray(target_R, dtype=np.float64),
            np.ascontiguousarray(target_t, dtype=np.float64),
        )

    def moved(self, step: Floats, target_step: Floats) -> _State:
        intrinsics, R, t = self.intrinsics.copy(), self.R.copy(), self.t.copy()
        for c in range(len(intrinsics)):
            k = int(self.n_free[c])
            intrinsics[c] += self.free[c, :, :k] @ step[self.start[c] : self.start[c] + k]
            if self.pose_start[c] >= 0:
                d = step[self.pose_start[c] : self.pose_start[c] + 6]
                R[c] = rotations(d[:3]) @ R[c]
                t[c] += d[3:]
        return _State(
            intrinsics, self.model, self.free, self.n_free, self.start, self.pose_start,
            self.n_global, R, t,
            rotations(target_step[:, :3]) @ self.target_R, self.target_t + target_step[:, 3:],
        )  # fmt: skip


def rotations(vectors: Floats) -> Floats:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad."""
    from scipy.spatial.transform import Rotation

    v = np.asarray(vectors, dtype=np.float64)
    found = Rotation.from_rotvec(v.reshape(-1, 3)).as_matrix()
    return np.asarray(found.reshape(*v.shape[:-1], 3, 3))


@dataclass(frozen=True, eq=False)
class _Parts:
    """Normal equations in their blocks, and what they came from."""

    cost: float
    H: Floats  # (G, G)
    g: Floats  # (G,)
    H_target: Floats  # (L, 6, 6)
    g_target: Floats  # (L, 6)
    H_mixed: Floats  # (L, G, 6)
    residuals: Floats
    weights: Floats


def _normal_equations(
    data: BundleData, state: _State, starts: NDArray[np.int64], prior: Floats, huber: float
) -> _Parts:
    found = _accumulate(
        data.camera, data.target, data.points, data.pixels, data.sd_px, starts,
        state.intrinsics, state.model, state.free, state.n_free, state.start, state.pose_start,
        state.n_global, state.R, state.t, state.target_R, state.target_t, huber,
    )  # fmt: skip
    parts = _Parts(*found)
    parts.H_target[:, np.arange(6), np.arange(6)] += prior
    return parts


def _solve_step(
    parts: _Parts, free: NDArray[np.bool_], damping: float
) -> tuple[Floats, Floats] | None:
    """The damped step of globals (G,) and targets (L, 6); None if it cannot be solved."""
    n_targets = len(parts.H_target)
    step_t = np.zeros((n_targets, 6))
    H_t = parts.H_target[:, free][:, :, free]
    diagonal = np.einsum("lii->li", H_t)
    scale = np.maximum(diagonal, 1e-12)
    H_t = H_t + damping * scale[:, :, None] * np.eye(int(free.sum()))
    M, g_t = parts.H_mixed[:, :, free], parts.g_target[:, free]
    try:
        inverse = np.linalg.inv(H_t)
        H = parts.H + damping * np.diag(np.maximum(np.diag(parts.H), 1e-12))
        MI = M @ inverse
        S = H - np.tensordot(MI, M, axes=([0, 2], [0, 2]))
        step = np.linalg.solve(S, parts.g - np.einsum("lgk,lk->g", MI, g_t))
    except np.linalg.LinAlgError:
        return None
    back = g_t - np.einsum("lgk,g->lk", M, step)
    step_t[:, free] = np.einsum("lij,lj->li", inverse, back)
    if not (np.isfinite(step).all() and np.isfinite(step_t).all()):
        return None
    return step, step_t


def _result(
    cameras: Sequence[BundleCamera],
    state: _State,
    data: BundleData,
    parts: _Parts,
    free: NDArray[np.bool_],
    converged: bool,
    n_steps: int,
) -> Bundle:
    H_t = parts.H_target[:, free][:, :, free]
    M = parts.H_mixed[:, :, free]
    MI = M @ np.linalg.pinv(H_t, hermitian=True)
    eliminated = np.tensordot(MI, M, axes=([0, 2], [0, 2]))
    solved = tuple(
        BundleCamera(state.intrinsics[i], c.model, c.free, state.R[i], state.t[i], c.pose_is_free)
        for i, c in enumerate(cameras)
    )
    return Bundle(
        solved,
        state.target_R,
        state.target_t,
        data,
        parts.residuals,
        parts.weights,
        parts.cost,
        state.n_global + int(free.sum()) * len(state.target_R),
        parts.H - eliminated,
        H_t,
        M,
        free,
        converged,
        n_steps,
    )


@njit(cache=True, nogil=True)
def _accumulate(  # type: ignore[no-untyped-def]
    camera, target, points, pixels, sd, starts, intrinsics, model, free, n_free, start, pose_start,
    n_global, R, t, target_R, target_t, huber,
):  # fmt: skip
    """Normal equations J'J and J'r in blocks, with Huber weights."""
    n_targets = len(target_R)
    H, g = np.zeros((n_global, n_global)), np.zeros(n_global)
    H_target, g_target = np.zeros((n_targets, 6, 6)), np.zeros((n_targets, 6))
    H_mixed = np.zeros((n_targets, n_global, 6))
    residuals, weights = np.zeros((len(camera), 2)), np.ones(len(camera))
    uv, J_row, J_point = np.zeros(2), np.zeros((2, 16)), np.zeros((2, 3))
    widest = free.shape[2] + 6
    J, J_t = np.zeros((2, widest)), np.zeros((2, 6))
    columns = np.zeros(widest, np.int64)
    world, turned, place = np.zeros(3), np.zeros(3), np.zeros(3)
    cost = 0.0
    for n in range(len(camera)):
        c, k = camera[n], target[n]
        for i in range(3):
            turned[i] = (
                target_R[k, i, 0] * points[n, 0]
                + target_R[k, i, 1] * points[n, 1]
                + target_R[k, i, 2] * points[n, 2]
            )
            world[i] = turned[i] + target_t[k, i]
        for i in range(3):
            place[i] = R[c, i, 0] * world[0] + R[c, i, 1] * world[1] + R[c, i, 2] * world[2]
        ok = project_one(
            intrinsics[c], model[c], place[0] + t[c, 0], place[1] + t[c, 1], place[2] + t[c, 2],
            uv, J_row, J_point,
        )  # fmt: skip
        if not ok:
            cost = np.inf
            break
        width = n_free[c]
        for i in range(width):
            columns[i] = start[c] + i
            for axis in range(2):
                total = 0.0
                for m in range(16):
                    total += J_row[axis, m] * free[c, m, i]
                J[axis, i] = total
        if pose_start[c] >= 0:
            for axis in range(2):
                a, b, d = J_point[axis, 0], J_point[axis, 1], J_point[axis, 2]
                # d(exp(δ) p) = δ × p
                J[axis, width] = d * place[1] - b * place[2]
                J[axis, width + 1] = a * place[2] - d * place[0]
                J[axis, width + 2] = b * place[0] - a * place[1]
                J[axis, width + 3], J[axis, width + 4], J[axis, width + 5] = a, b, d
            for i in range(6):
                columns[width + i] = pose_start[c] + i
            width += 6
        for axis in range(2):
            a = b = d = 0.0
            for i in range(3):
                a += J_point[axis, i] * R[c, i, 0]
                b += J_point[axis, i] * R[c, i, 1]
                d += J_point[axis, i] * R[c, i, 2]
            J_t[axis, 0] = d * turned[1] - b * turned[2]
            J_t[axis, 1] = a * turned[2] - d * turned[0]
            J_t[axis, 2] = b * turned[0] - a * turned[1]
            J_t[axis, 3], J_t[axis, 4], J_t[axis, 5] = a, b, d
        rx, ry = pixels[n, 0] - uv[0], pixels[n, 1] - uv[1]
        residuals[n, 0], residuals[n, 1] = rx, ry
        z = np.sqrt(rx * rx + ry * ry) / sd[n]
        w = 1.0
        if z > huber:
            w = huber / z
            cost += 2 * huber * z - huber * huber
        else:
            cost += z * z
        weights[n] = w
        w /= sd[n] * sd[n]
        for axis in range(2):
            r = rx if axis == 0 else ry
            for i in range(width):
                ci, ji = columns[i], w * J[axis, i]
                g[ci] += ji * r
                for j in range(width):
                    H[ci, columns[j]] += ji * J[axis, j]
                for j in range(6):
                    H_mixed[k, ci, j] += ji * J_t[axis, j]
            for i in range(6):
                ji = w * J_t[axis, i]
                g_target[k, i] += ji * r
                for j in range(6):
                    H_target[k, i, j] += ji * J_t[axis, j]
    return cost, H, g, H_target, g_target, H_mixed, residuals, weights
