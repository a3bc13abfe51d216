"""Network, flow and template joined over time, each by how far it is to be trusted.

A landmark's place x moves by what flow says, give or take flow's own error; the network sees x
plus a lean b that changes slowly, plus jitter; a template sees x. ::

    x(t+1) = x(t) + flow + w        w ~ q(t)
    b(t+1) = ρ b(t) + v             b ~ lean²
    network = x + b + n             n ~ jitter²
    template = x + m                m ~ as the registration says

Because flow carries the motion, jitter can be averaged over many frames without lag. Where a
region does something that flow cannot see (a lid comes down), the network's step and flow's
differ by more than jitter can, at many points at once: there w is as large as they differ, and the
network is followed. Kalman 1960; Rauch, Tung & Striebel 1965.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..heads.face_landmarks import N_LANDMARKS
from .landmark_regions import IS_EYE, IS_INNER_LIP, QUICK_REGIONS

Floats = NDArray[np.float64]

# All in px of the rectified face, which fills 205 px; measured on plain renders.
_JITTER = 0.15
_LEAN, _LEAN_LIPS, _LEAN_EYE = 0.7, 0.9, 0.4
_LEAN_S = 0.5
#: What template and network get wrong for long together: it is stated, but cannot be filtered.
_LASTING, _LASTING_LIPS, _LASTING_EYE = 0.27, 0.3, 0.5
_UNSEEN_STEP = 1.0  # of a point that flow has lost
_GATE = 3.0  # deviations of a step beyond which flow and network disagree
_VAGUE = 1e4
_MIN_FOR_OFFSET = 5
_FRAMES_AT_ONCE = 3000  # of all landmarks: longer takes are filtered some landmarks at a time


@dataclass(frozen=True, eq=False)
class LandmarkMeasurements:
    """What was seen of the landmarks in one shot.

    Attributes
    ----------
    time_s : (T,) float64, s
    unit_px : (T,) float64
        Pixels of the picture in one of the rectified face.
    network : (T, N, 2) float64, px
        NaN where the network saw no face.
    step : (T, N, 2) float64, px
        How far each point went since the frame before, by flow; row 0 is not used.
    step_sd : (T, N) float64, px
        Infinite where flow has lost it: the step is then that of the whole face.
    template : (T, N, 2) float64, px
        Where the reference frame's patch was found; NaN where it was not.
    template_sd : (T, N) float64, px
    trust : (T,) float64
        What the network's deviations are multiplied by: 1 where it is sure.
    """

    time_s: Floats
    unit_px: Floats
    network: Floats
    step: Floats
    step_sd: Floats
    template: Floats
    template_sd: Floats
    trust: Floats


def filter_landmarks(seen: LandmarkMeasurements) -> tuple[Floats, Floats]:
    """The most likely course of the landmarks.

    Parameters
    ----------
    seen : LandmarkMeasurements

    Returns
    -------
    points : (T, N, 2) float64, px
    sd : (T, N) float64, px
    """
    unit = seen.unit_px[:, None]
    lean = _by_region(_LEAN, _LEAN_LIPS, _LEAN_EYE) * unit
    lasting = _by_region(_LASTING, _LASTING_LIPS, _LASTING_EYE)
    jitter = _JITTER * unit * seen.trust[:, None]
    rho = np.exp(-np.diff(seen.time_s, prepend=seen.time_s[0]) / _LEAN_S)
    q = _step_variances(seen, 2 * jitter**2 + 2 * (1 - rho[:, None]) * lean**2)
    template, m = _gated_template(seen, lean)
    T, N = q.shape
    x, p = np.empty((T, N, 2)), np.empty((T, N))
    for rows in np.array_split(np.arange(N), 1 + T // _FRAMES_AT_ONCE):  # landmarks are apart
        part = replace(seen, network=seen.network[:, rows], step=seen.step[:, rows])
        given = (a[:, rows] for a in (template, m, q, lean**2, np.broadcast_to(jitter**2, (T, N))))
        x[:, rows], p[:, rows] = _smoothed(part, *given, rho=rho)
    return x, np.sqrt(p + (lasting * unit) ** 2)


def _by_region(skin: float, lips: float, eye: float) -> Floats:
    """(478,): one value each; inner lips count with the eyes, since no template holds them."""
    values = np.full(N_LANDMARKS, skin)
    for name, points in QUICK_REGIONS.items():
        if name.startswith("lip"):
            values[list(points)] = lips
    values[IS_EYE | IS_INNER_LIP] = eye
    return values


def _step_variances(seen: LandmarkMeasurements, network: Floats) -> Floats:
    """Variance of each step's error: flow's own, or what region and network show it to be.

    `network` (T, N) px² is that of the network's own steps.
    """
    q = np.minimum(seen.step_sd, _UNSEEN_STEP * seen.unit_px[:, None]) ** 2
    miss = np.diff(seen.network, axis=0, prepend=seen.network[:1]) - seen.step
    miss[0] = 0.0
    squares = (miss**2).sum(axis=2) / 2
    usual = network + q
    with np.errstate(invalid="ignore"):
        beyond = np.where(squares > _GATE**2 * usual, squares, 0.0)
        for points in QUICK_REGIONS.values():
            rows = list(points)
            shared = squares[:, rows].mean(axis=1) - 2 * usual[:, rows].mean(axis=1)
            beyond[:, rows] = np.fmax(beyond[:, rows], shared[:, None])
    return np.asarray(q + np.fmax(beyond, 0.0))


def _gated_template(seen: LandmarkMeasurements, lean: Floats) -> tuple[Floats, Floats]:
    """Registered places less each point's mean lean, where they are believed, and variances."""
    y = seen.template.copy()
    y[:, IS_EYE | IS_INNER_LIP] = np.nan  # these change their looks: only the network knows them
    known = np.isfinite(y[..., 0]) & np.isfinite(seen.network[..., 0])
    apart = np.where(known[..., None], seen.network - y, np.nan)
    offset = np.zeros(y.shape[1:])
    often = known.sum(axis=0) >= _MIN_FOR_OFFSET
    offset[often] = np.nanmedian(apart[:, often], axis=0)
    y += offset
    miss = np.linalg.norm(apart - offset, axis=2)
    m = seen.template_sd**2
    is_off = ~(miss < _GATE * np.sqrt(lean**2 + m)) | ~known
    y[is_off] = np.nan
    return y, np.where(is_off, np.inf, m)


def _smoothed(
    seen: LandmarkMeasurements,
    template: Floats,
    m: Floats,
    q: Floats,
    lean2: Floats,
    jitter2: Floats,
    *,
    rho: Floats,
) -> tuple[Floats, Floats]:
    """Forward filter and backward smoother of (x, b): (T, N, 2) places and (T, N) variances."""
    T, N = q.shape
    X, B = np.zeros((T, N, 2)), np.zeros((T, N, 2))
    early_X, early_B = X.copy(), B.copy()
    P, E = np.zeros((T, 3, N)), np.zeros((T, 3, N))
    x, b = _first_places(seen), np.zeros((N, 2))
    p = np.full(N, _VAGUE), np.zeros(N), lean2[0].copy()
    for t in range(T):
        if t:
            x, b = x + seen.step[t], rho[t] * b
            p = p[0] + q[t], rho[t] * p[1], rho[t] ** 2 * p[2] + (1 - rho[t] ** 2) * lean2[t]
        early_X[t], early_B[t], E[t] = x, b, p
        x, b, p = _updated(x, b, p, seen.network[t], jitter2[t], 1.0)
        x, b, p = _updated(x, b, p, template[t], m[t], 0.0)
        X[t], B[t], P[t] = x, b, p
    for t in range(T - 2, -1, -1):
        _step_back(t, rho[t + 1], X, B, P, early_X, early_B, E)
    return X, P[:, 0]


def _first_places(seen: LandmarkMeasurements) -> Floats:
    """Where each point is first seen, (N, 2); one that never is, is anywhere."""
    is_seen = np.isfinite(seen.network[..., 0])
    first = is_seen.argmax(axis=0)
    return np.asarray(np.nan_to_num(seen.network[first, np.arange(len(first))]))


Covariance = tuple[Floats, Floats, Floats]


def _updated(
    x: Floats, b: Floats, p: Covariance, z: Floats, r: Floats, h: float
) -> tuple[Floats, Floats, Covariance]:
    """After seeing z = x + h b with variance r; as before where z is NaN."""
    seen = np.isfinite(z[:, 0])
    hx, hb = p[0] + h * p[1], p[1] + h * p[2]
    s = hx + h * hb + np.where(seen, r, 1.0)
    kx, kb = np.where(seen, hx / s, 0.0), np.where(seen, hb / s, 0.0)
    miss = np.where(seen[:, None], z - x - h * b, 0.0)
    covariance = p[0] - kx * hx, p[1] - kx * hb, p[2] - kb * hb
    return x + kx[:, None] * miss, b + kb[:, None] * miss, covariance


def _step_back(
    t: int, rho: float, X: Floats, B: Floats, P: Floats, eX: Floats, eB: Floats, E: Floats
) -> None:
    """Improve frame t by what the frames after it showed, in place."""
    a, c, d = P[t]
    A, C, D = E[t + 1]
    det = A * D - C * C
    m00, m01, m10, m11 = a, rho * c, c, rho * d  # P Fᵀ with F = diag(1, ρ)
    g00, g01 = (m00 * D - m01 * C) / det, (m01 * A - m00 * C) / det
    g10, g11 = (m10 * D - m11 * C) / det, (m11 * A - m10 * C) / det
    dx, db = X[t + 1] - eX[t + 1], B[t + 1] - eB[t + 1]
    X[t] += g00[:, None] * dx + g01[:, None] * db
    B[t] += g10[:, None] * dx + g11[:, None] * db
    da, dc, dd = P[t + 1] - E[t + 1]
    P[t] += (
        g00 * g00 * da + 2 * g00 * g01 * dc + g01 * g01 * dd,
        g00 * g10 * da + (g00 * g11 + g01 * g10) * dc + g01 * g11 * dd,
        g10 * g10 * da + 2 * g10 * g11 * dc + g11 * g11 * dd,
    )
