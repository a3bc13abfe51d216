"""Motion of the skull from markers that are not quite rigid.

Foreheads move, caps slip, and cameras are noisy. Each marker's *wobble*, how far it strays from
its place on the skull, is estimated from the take itself, and a marker counts by it. Quiet markers
of the face (often those of the nose's bridge and the temples) join where they wobble about as
little as those meant to be rigid. A marker that strays far in some frames counts less there
(Student's t). What is white noise of the cameras is then smoothed away (`motion_smoother`); what
is wobble stays, since it cannot be told from motion, and is stated in the covariance.

The neutral frame defines where markers belong: their wobble there is part of the definition.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.head_motion import HeadMotion
from ..core.rigid import quaternion_from_rotation, rotation_from_quaternion
from .motion_smoother import SmoothedCurves, smooth_curves
from .rigid_fit import Floats, fit_rigid

_ROUNDS = 6
_FREEDOM = 4.0  # of Student's t: a marker three wobbles off counts 60 % less
_PRIOR_FRAMES = 10.0  # how many frames the common wobble counts for against a marker's own
_LEAST_FREEDOM = 0.1  # of 3: markers that the fit follows further do not tell their wobble
_QUIET = 3.0  # a face marker joins if it wobbles at most this many times what rigid ones do
_LEAST_MM = 1e-9
_CHUNK = 4096
_TINY = 1e-300
#: Where the stated error is larger, the motion counts as unknown: FAPs would be of no use.
MAX_ANGLE_SD_RAD, MAX_PLACE_SD_MM = float(np.deg2rad(1.0)), 2.0


@dataclass(frozen=True, eq=False)
class SkullMotion:
    """Head motion, and what it was made from.

    Attributes
    ----------
    motion : HeadMotion
        Smoothed, with covariance.
    unsmoothed : HeadMotion
        Frame by frame.
    used : (M,) bool
        Markers that it was made from.
    wobble_mm : (M,) float64
        RMS a coordinate by which each marker strays from its place on the skull, noise included;
        NaN for those never seen. For face markers this is their expression.
    """

    motion: HeadMotion
    unsmoothed: HeadMotion
    used: NDArray[np.bool_]
    wobble_mm: Floats


def estimate_skull_motion(
    time_s: Floats,
    positions: Floats,
    neutral: Floats,
    is_rigid: NDArray[np.bool_],
    covariances: Floats | None = None,
    *,
    smooth: bool = True,
) -> SkullMotion:
    """Where the head is in each frame.

    Parameters
    ----------
    time_s : (T,) float64, s
    positions : (T, M, 3) float64, mm, world frame
        NaN where missing.
    neutral : (M, 3) float64, mm, head frame
        Where the markers belong; NaN for those unknown.
    is_rigid : (M,) bool
        Meant to move with the skull; three or more.
    covariances : (T, M, 3, 3) float64, mm², optional
        Of the positions. Without them all samples count alike, and what is noise and what is
        wobble is told by smoothness alone.
    smooth : bool

    Returns
    -------
    SkullMotion
        NaN in frames whose markers do not tell the motion to 1° and 2 mm of standard deviation.
    """
    is_rigid = is_rigid & ~np.isnan(neutral[:, 0])
    noise = _noise_variance(positions, covariances)
    weights = np.where(is_rigid, 1.0, 0.0)
    R, t = fit_rigid(neutral, positions, weights)
    variance = _rigid_variances(positions, neutral, R, t, is_rigid, np.ones(len(neutral)))
    used = is_rigid
    for chosen in range(2):  # first by themselves, then with those that prove as quiet
        if chosen:
            used = is_rigid | _quiet_markers(positions, neutral, R, t, is_rigid, variance)
        for _ in range(_ROUNDS):
            weights = _weights(positions, neutral, R, t, variance, noise, used)
            R, t = fit_rigid(neutral, positions, weights)
            variance = _rigid_variances(positions, neutral, R, t, used, variance)
    strays = _stray_squares(positions, neutral, R, t)
    variance = np.where(used, variance, _mean_known(strays) / 3)
    R, t = _with_the_face(R, t, positions, neutral, variance)
    weights = _weights(positions, neutral, R, t, variance, noise, _used_where(R, positions, used))
    pivot = np.average(neutral[used], axis=0, weights=1 / variance[used])
    all_noise, wobble_only = _error_covariances(weights, positions, neutral, pivot, variance, noise)
    middle = np.einsum("tij,j->ti", R, pivot) + t
    unsure = all_noise + wobble_only
    unsmoothed = _motion(time_s, R, middle, pivot, unsure)
    motion = unsmoothed
    if smooth:
        motion = _smoothed(unsmoothed, middle, pivot, all_noise, wobble_only, covariances is None)
    return SkullMotion(motion, unsmoothed, used, np.sqrt(variance))


def _noise_variance(positions: Floats, covariances: Floats | None) -> Floats:
    """(T, M) mm² a coordinate; 0 where nothing is known of it."""
    if covariances is None:
        return np.zeros(positions.shape[:2])
    return np.asarray(np.nan_to_num(np.trace(covariances, axis1=2, axis2=3) / 3))


def _stray_squares(positions: Floats, neutral: Floats, R: Floats, t: Floats) -> Floats:
    """(T, M) mm²: squared distance of each marker from its place on the skull."""
    place = np.einsum("tij,mj->tmi", R, neutral) + t[:, None]
    return np.asarray(((positions - place) ** 2).sum(axis=2))


def _mean_known(values: Floats) -> Floats:
    """Mean over the first axis without NaN; NaN where there is nothing."""
    known = ~np.isnan(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(known, values, 0).sum(axis=0) / known.sum(axis=0))


def _rigid_variances(
    positions: Floats,
    neutral: Floats,
    R: Floats,
    t: Floats,
    used: NDArray[np.bool_],
    weighted_by: Floats,
) -> Floats:
    """Each used marker's variance, mm² a coordinate; infinite for others.

    A marker's residual is smaller than its wobble, since the fit follows it: by its share in the
    fit (its leverage), of which a marker has up to 3. What is left of few markers is little, so
    each counts for some frames of what all have in common: their median, or three's mean.
    """
    strays = _stray_squares(positions, neutral, R, t)
    leverage = _leverages(neutral, ~np.isnan(strays), np.where(used, 1 / weighted_by, 0.0))
    known = ~np.isnan(strays) & ~np.isnan(leverage) & used
    total = np.where(known, strays, 0.0).sum(axis=0)
    freedom = np.where(known, 3 - leverage, 0.0).sum(axis=0)
    told = used & (freedom > _LEAST_FREEDOM * known.sum(axis=0)) & (freedom > 0)
    pooled = total.sum() / max(freedom.sum(), 1e-9)
    common = float(np.median(total[told] / freedom[told])) if told.sum() > 3 else pooled
    own = (total + _PRIOR_FRAMES * common) / (freedom + _PRIOR_FRAMES)
    return np.where(used, np.maximum(own, _LEAST_MM**2), np.inf)


def _leverages(neutral: Floats, seen: NDArray[np.bool_], weights: Floats) -> Floats:
    """(T, M): how far each marker's own position decides its fitted one, 0 to 3.

    It hangs only on which markers are seen; few such patterns occur.
    """
    patterns, which = np.unique(seen & (weights > 0), axis=0, return_inverse=True)
    found = np.full(patterns.shape, np.nan)
    for i, pattern in enumerate(patterns):
        if pattern.sum() < 3:
            continue
        w = np.where(pattern, weights, 0.0)
        J = _jacobians(neutral - np.average(neutral[pattern], axis=0, weights=w[pattern]))
        J = np.where(pattern[:, None, None], J, 0.0)
        inverse = np.linalg.pinv(np.einsum("m,mki,mkj->ij", w, J, J), hermitian=True)
        found[i] = np.einsum("m,mki,ij,mkj->m", w, J, inverse, J)
    return np.asarray(found[which.reshape(-1)])


def _jacobians(arms: Floats) -> Floats:
    """d(point)/d(φ, d), (..., 3, 6), for points at arms (..., 3) from the pivot."""
    x, y, z = np.moveaxis(arms, -1, 0)
    zero = np.zeros_like(x)
    # φ × arm = −[arm]× φ
    turn = np.stack(
        [
            np.stack([zero, z, -y], axis=-1),
            np.stack([-z, zero, x], axis=-1),
            np.stack([y, -x, zero], axis=-1),
        ],
        axis=-2,
    )
    shift = np.broadcast_to(np.eye(3), turn.shape)
    return np.concatenate([turn, shift], axis=-1)


def _quiet_markers(
    positions: Floats,
    neutral: Floats,
    R: Floats,
    t: Floats,
    is_rigid: NDArray[np.bool_],
    variance: Floats,
) -> NDArray[np.bool_]:
    """Face markers that stray no more from the skull than the rigid ones do from each other."""
    common = float(np.median(variance[is_rigid]))
    strays = _mean_known(_stray_squares(positions, neutral, R, t)) / 3
    return ~is_rigid & np.nan_to_num(strays <= _QUIET**2 * common, nan=False)


def _weights(
    positions: Floats,
    neutral: Floats,
    R: Floats,
    t: Floats,
    variance: Floats,
    noise: Floats,
    used: NDArray[np.bool_],
) -> Floats:
    """(T, M), 1/mm²: by wobble, by the sample's own noise, and by how far it strays."""
    usual = _mean_known(np.where(np.isnan(positions[..., 0]), np.nan, noise))
    wobble = np.maximum(variance - np.nan_to_num(usual), 0.1 * variance)
    total = np.where(used, wobble + noise, np.inf)
    strays = np.nan_to_num(_stray_squares(positions, neutral, R, t))
    return np.asarray((_FREEDOM + 3) / (_FREEDOM + strays / total) / total)


def _with_the_face(
    R: Floats, t: Floats, positions: Floats, neutral: Floats, variance: Floats
) -> tuple[Floats, Floats]:
    """Frames without enough rigid markers take all the face's, each by how much it moves."""
    lost = np.isnan(R[:, 0, 0])
    if lost.any():
        weights = np.nan_to_num(1 / variance, nan=0.0, posinf=0.0)
        R, t = R.copy(), t.copy()
        R[lost], t[lost] = fit_rigid(neutral, positions[lost], weights)
    return R, t


def _used_where(R: Floats, positions: Floats, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(T, M): all markers where the used ones do not suffice."""
    few = (~np.isnan(positions[:, used, 0])).sum(axis=1) < 3
    return np.where(few[:, None], True, used)


def _slices(n: int) -> Iterator[slice]:
    for first in range(0, n, _CHUNK):
        yield slice(first, min(first + _CHUNK, n))


def _error_covariances(
    weights: Floats,
    positions: Floats,
    neutral: Floats,
    pivot: Floats,
    variance: Floats,
    noise: Floats,
) -> tuple[Floats, Floats]:
    """Of (φ, d of the pivot), head frame, (T, 6, 6): from the samples' noise and from wobble."""
    seen = ~np.isnan(positions[..., 0]) & ~np.isnan(neutral[:, 0])
    J = _jacobians(np.nan_to_num(neutral - pivot))
    usual = np.nan_to_num(_mean_known(np.where(seen, noise, np.nan)))
    wobble = np.maximum(np.nan_to_num(variance) - usual, 0.0)
    of_noise = np.full((len(positions), 6, 6), np.nan)
    of_wobble = np.full_like(of_noise, np.nan)
    for rows in _slices(len(positions)):
        w = np.where(seen[rows], weights[rows], 0.0)
        enough = (w > 0).sum(axis=1) >= 3
        H = np.einsum("tm,mki,mkj->tij", w, J, J, optimize=True)
        inverse = np.linalg.pinv(H, hermitian=True)
        for out, v in ((of_noise, noise[rows]), (of_wobble, np.broadcast_to(wobble, w.shape))):
            middle = np.einsum("tm,mki,mkj->tij", w * w * v, J, J, optimize=True)
            out[rows] = np.where(enough[:, None, None], inverse @ middle @ inverse, np.nan)
    return of_noise, of_wobble


def _motion(
    time_s: Floats, R: Floats, middle: Floats, pivot: Floats, in_head: Floats
) -> HeadMotion:
    """From the pivot's places and the errors' covariance there to the head's origin."""
    shift = middle - np.einsum("tij,j->ti", R, pivot)
    turn = np.zeros((len(R), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = R
    C = turn @ in_head @ np.swapaxes(turn, 1, 2)
    angle_sd = np.sqrt(np.trace(C[:, :3, :3], axis1=1, axis2=2))
    place_sd = np.sqrt(np.trace(C[:, 3:, 3:], axis1=1, axis2=2))
    known = (angle_sd <= MAX_ANGLE_SD_RAD) & (place_sd <= MAX_PLACE_SD_MM)
    known &= ~np.isnan(R[:, 0, 0])
    to_origin = np.broadcast_to(np.eye(6), C.shape).copy()
    # d_origin = d_pivot − φ × (R pivot)
    to_origin[:, 3:, :3] = -_jacobians(np.einsum("tij,j->ti", R, pivot))[..., :3]
    C = to_origin @ C @ np.swapaxes(to_origin, 1, 2)
    q = np.where(known[:, None], quaternion_from_rotation(R), np.nan)
    shift = np.where(known[:, None], shift, np.nan)
    return HeadMotion(time_s, q, shift, np.where(known[:, None, None], C, np.nan))


def _smoothed(
    raw: HeadMotion,
    middle: Floats,
    pivot: Floats,
    of_noise: Floats,
    of_wobble: Floats,
    noise_unknown: bool,
) -> HeadMotion:
    """Smooth rotation and pivot, each as far as its noise asks."""
    total = of_noise + of_wobble
    known = ~np.isnan(raw.quaternion[:, 0])
    q = _continuous(np.array(raw.quaternion))
    place = np.where(known[:, None], middle, np.nan)
    turns = _smooth_part(raw.time_s, q, total[:, :3, :3], 0.25)
    places = _smooth_part(raw.time_s, place, total[:, 3:, 3:], 1.0)
    found_q = np.where(known[:, None], turns.values, np.nan)
    R = rotation_from_quaternion(found_q)
    parts = ((slice(0, 3), turns, 0.25), (slice(3, 6), places, 1.0))
    left, white = np.ones((len(q), 6)), np.ones(6)
    for rows, part, scale in parts:
        left[:, rows] = _share_left(part, total[:, rows, rows], scale)[:, None]
        white[rows] = np.sqrt(part.noise)
    if noise_unknown:  # smoothness told how much of the whole is white
        of_noise = total * white[:, None] * white
        lasting = np.sqrt(1 - white**2)
        of_wobble = total * lasting[:, None] * lasting
    C = of_noise * left[:, :, None] * left[:, None, :] + of_wobble
    return _motion(raw.time_s, R, np.where(known[:, None], places.values, np.nan), pivot, C)


def _smooth_part(
    time_s: Floats, values: Floats, covariance: Floats, scale: float
) -> SmoothedCurves:
    """Curves whose errors are these, times a scale; a quaternion's turn by half an angle."""
    variance = np.nan_to_num(scale * np.trace(covariance, axis1=1, axis2=2) / 3)
    variances = np.repeat(np.maximum(variance, _TINY)[:, None], values.shape[1], axis=1)
    return smooth_curves(time_s, values, variances, most_noise=1.0)


def _share_left(part: SmoothedCurves, covariance: Floats, scale: float) -> Floats:
    """(T,): the share of the white noise's standard deviation that smoothing left."""
    before = scale * np.trace(covariance, axis1=1, axis2=2) / 3 * part.noise
    with np.errstate(invalid="ignore", divide="ignore"):
        left = part.variances.mean(axis=1) / before
    return np.asarray(np.sqrt(np.clip(np.nan_to_num(left, nan=1.0, posinf=1.0), 0.0, 1.0)))


def _continuous(q: Floats) -> Floats:
    """The signs of quaternions that change least from known frame to known frame."""
    last: Floats | None = None
    for i in np.flatnonzero(~np.isnan(q[:, 0])):
        if last is not None and q[i] @ last < 0:
            q[i] = -q[i]
        last = q[i]
    return q
