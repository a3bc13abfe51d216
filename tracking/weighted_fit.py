"""Rigid and similarity motions of many frames at once, with weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def fit_frames(
    source: Floats, target: Floats, weights: Floats | None = None
) -> tuple[Floats, Floats]:
    """Weighted least-squares motions ``target ≈ R source + t`` of many frames.

    Parameters
    ----------
    source : (M, 3) or (T, M, 3) float64, mm
    target : (T, M, 3) float64, mm
        Points with NaN are left out.
    weights : (T, M) or (M,) float64, optional
        0 or more.

    Returns
    -------
    (T, 3, 3) rotations and (T, 3) translations
        NaN where fewer than three points have weight.

    References
    ----------
    Umeyama 1991, eqs 34 to 42.
    """
    seen = ~np.isnan(target[..., 0])
    w = np.where(seen, 1.0 if weights is None else weights, 0.0)
    total = np.maximum(w.sum(axis=1), 1e-12)[:, None]
    x = np.where(seen[..., None], target, 0.0)
    p = np.broadcast_to(source, x.shape)
    xc = (w[..., None] * x).sum(axis=1) / total
    pc = (w[..., None] * p).sum(axis=1) / total
    H = np.einsum("tm,tmi,tmj->tij", w, x - xc[:, None], p - pc[:, None])
    U, _, Vt = np.linalg.svd(H)
    U = U.copy()
    U[..., 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    R = U @ Vt
    t = xc - np.einsum("tij,tj->ti", R, pc)
    few = (w > 0).sum(axis=1) < 3
    R[few], t[few] = np.nan, np.nan
    return R, t


def to_head(points: Floats, R: Floats, t: Floats) -> Floats:
    """Points (T, M, 3) carried back by motions: ``Rᵀ (p − t)``."""
    return np.asarray(np.einsum("tij,tmi->tmj", R, points - t[:, None]))
