"""Rigid and similarity motions from corresponding points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError

Floats = NDArray[np.float64]

_COLLINEAR = 1e-3  # ratio of the second to the first singular value


def fit_rigid(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    weights: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weighted least-squares rotations and translations, ``target ≈ R source + t``.

    Parameters
    ----------
    source : (N, 3) float64, mm
    target : (..., N, 3) float64, mm
        Rows with NaN are left out; sets with fewer than three points, or collinear ones, give NaN.
    weights : (..., N) or (N,) float64, optional
        What each point counts, 0 or more; alike unless given.

    Returns
    -------
    (..., 3, 3) rotations and (..., 3) translations

    References
    ----------
    Umeyama 1991, eqs 34 to 42.
    """
    flat = target.reshape(-1, *target.shape[-2:])
    known = ~np.isnan(flat[..., 0]) & ~np.isnan(source[:, 0])
    w = np.ones(flat.shape[:2]) if weights is None else np.broadcast_to(weights, target.shape[:-1])
    w = np.where(known, w.reshape(known.shape), 0.0)
    p, g = np.where(known[..., None], source, 0.0), np.where(known[..., None], flat, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        w = w / w.sum(axis=1, keepdims=True)
    pc, gc = np.einsum("kn,kni->ki", w, p), np.einsum("kn,kni->ki", w, g)
    H = np.einsum("kn,kni,knj->kij", w, g - gc[:, None], p - pc[:, None], optimize=True)
    R = np.full((len(flat), 3, 3), np.nan)
    ok = ((w > 0).sum(axis=1) >= 3) & np.isfinite(H).all(axis=(1, 2))
    U, S, Vt = np.linalg.svd(H[ok])
    D = np.ones_like(S)
    D[:, 2] = np.sign(np.linalg.det(U @ Vt))
    spread = S[:, 1] > _COLLINEAR * S[:, 0]  # of points all in one place, both are 0
    R[np.flatnonzero(ok)[spread]] = ((U * D[:, None]) @ Vt)[spread]
    t = gc - np.einsum("kij,kj->ki", R, pc)
    return R.reshape((*target.shape[:-2], 3, 3)), t.reshape((*target.shape[:-2], 3))


def fit_similarity(
    source: NDArray[np.float64], target: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Least-squares ``target ≈ s R source + t`` of (N, 3) points without gaps: s, R, t."""
    R, _ = fit_rigid(source, target)
    p, g = source - source.mean(axis=0), target - target.mean(axis=0)
    s = float((g * (p @ R.T)).sum() / (p**2).sum())
    return s, R, target.mean(axis=0) - s * R @ source.mean(axis=0)


def linear_rotation(
    source: NDArray[np.float64], target: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The translation-invariant linear method for exactly three points.

    Kshirsagar, Garchery & Magnenat-Thalmann 2000, section 4.1, eqs 6 to 10: unit vectors between
    points do not feel the translation; two of them and the one orthogonal to both (their
    pseudo-correspondence) give R by a 3 × 3 linear system. R is *not* orthonormal when the points
    are noisy: that is the method's.

    Parameters
    ----------
    source : (3, 3) float64, mm
        Rows are points.
    target : (..., 3, 3) float64, mm
        NaN gives NaN.

    Returns
    -------
    (..., 3, 3) matrices and (..., 3) translations (eq. 6, mean over the points)

    Raises
    ------
    InputError
        If the source points are collinear.
    """
    m = _unit_vectors(source)
    if abs(np.linalg.det(m)) < _COLLINEAR:
        raise InputError("the three head markers lie on a line: no rotation can be found")
    m_target = _unit_vectors(target)
    # rows of m are vectors: m' = R m  ⇔  m_target = m Rᵀ
    R = np.swapaxes(np.linalg.solve(m, m_target), -1, -2)
    t = (target - np.einsum("...ij,nj->...ni", R, source)).mean(axis=-2)
    return R, t


def _unit_vectors(p: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3, 3) rows: two edges of the triangle and their normal, unit length each."""
    a, b = p[..., 1, :] - p[..., 0, :], p[..., 2, :] - p[..., 1, :]
    n = np.cross(a, b)
    rows = np.stack([a, b, n], axis=-2)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(rows / np.linalg.norm(rows, axis=-1, keepdims=True))
