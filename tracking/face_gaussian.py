"""The Gaussian of a face's markers: where each must be if the others are where they are.

A frame of M markers in the head frame is ``neutral + Bᵀc + own``: K modes with coefficients of
unit variance, and noise of each marker's own (`core.person.Person`). The head's pose, known up to
a small error, joins the modes: six (seven with scale) linearised columns of wide variance. All
that is asked of 3M × 3M covariances is got from K × K ones (Woodbury's identity), for many frames
at a time, whatever markers each of them lacks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.person import Person
from .weighted_fit import fit_frames, to_head

Floats = NDArray[np.float64]

#: Of the pose that is linearised over, about a first fit.
_TURN_SD_RAD, _SHIFT_SD_MM = 0.15, 20.0
_LOG_2_PI = float(np.log(2 * np.pi))
_BATCH = 512  # frames of linear algebra at a time: memory stays small in long chunks


@dataclass(frozen=True, eq=False)
class Prediction:
    """Where markers are expected from the others: each is left out of its own prediction.

    Attributes
    ----------
    mean : (T, M, 3) float64, mm, head frame
    covariance : (T, M, 3, 3) float64, mm²
        Of where the marker will be seen, its own noise included.
    fit : (T, M, 3) float64, mm, head frame
        Where the Gaussian sees the markers from all of them.
    cost : (T,) float64
        Negative log density of the frame.
    """

    mean: Floats
    covariance: Floats
    fit: Floats
    cost: Floats


class FaceGaussian:
    """A person's markers with the pose's uncertainty.

    Parameters
    ----------
    person : Person
    """

    def __init__(self, person: Person) -> None:
        self.person = person
        p = person.neutral - person.neutral.mean(axis=0)
        axes = np.eye(3)
        turns = _TURN_SD_RAD * np.cross(axes[:, None], p[None])
        shifts = _SHIFT_SD_MM * np.broadcast_to(axes[:, None], turns.shape)
        scale = [person.log_scale_sd * p[None]] if person.log_scale_sd else []
        self.modes = np.concatenate([person.modes, turns, shifts, *scale])
        self.n_shape = len(person.modes)
        self._information = person.noise_mm**-2.0
        self._log_noise = 6.0 * np.log(person.noise_mm) / 2 + 1.5 * _LOG_2_PI  # of 3 numbers
        # (M, K²): what each marker adds to the K × K system
        outer = np.einsum("kmx,lmx->mkl", self.modes, self.modes)
        self._outer = outer.reshape(len(p), -1) * self._information[:, None]

    def predict(self, q: Floats, used: NDArray[np.bool_] | None = None) -> Prediction:
        """Leave-one-out predictions of frames in the head frame.

        Parameters
        ----------
        q : (T, M, 3) float64, mm, head frame
            NaN where not seen.
        used : (T, M) bool, optional
            Points to learn from; by default all that are seen. The others are predicted from
            these.
        """
        parts = [
            self._predict(q[i : i + _BATCH], None if used is None else used[i : i + _BATCH])
            for i in range(0, max(len(q), 1), _BATCH)
        ]
        return Prediction(
            *(np.concatenate([getattr(p, n) for p in parts]) for n in Prediction.__annotations__)
        )

    def _predict(self, q: Floats, used: NDArray[np.bool_] | None) -> Prediction:
        C, c, d, w = self._solve(q, used)
        fit = np.einsum("tk,kmx->tmx", c, self.modes)
        CB = np.einsum("tkl,lmx->tmkx", C, self.modes, optimize=True)
        spread = np.einsum("kmx,tmky->tmxy", self.modes, CB, optimize=True)
        eye = np.eye(3)
        noise = self.person.noise_mm[:, None, None] ** 2 * eye
        # P = Σ⁻¹; (P d) and the diagonal blocks of P, of the points that are used
        Pd = w[..., None] * (d - fit)
        P = w[..., None, None] * eye - w[..., None, None] ** 2 * spread
        is_used = w > 0
        left_out = np.linalg.inv(np.where(is_used[..., None, None], P, eye))
        covariance = np.where(is_used[..., None, None], left_out, spread + noise)
        off = np.einsum("tmxy,tmy->tmx", left_out, Pd)
        expected = np.where(is_used[..., None], d - off, fit)
        log_det = -np.linalg.slogdet(C)[1]
        cost = 0.5 * ((d * Pd).sum(axis=(1, 2)) + log_det) + is_used @ self._log_noise
        neutral = self.person.neutral
        return Prediction(neutral + expected, covariance, neutral + fit, cost)

    def _solve(
        self, q: Floats, used: NDArray[np.bool_] | None
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Covariance and mean of the coefficients; displacements and information of the points."""
        is_used = ~np.isnan(q[..., 0])
        if used is not None:
            is_used &= used
        w = is_used * self._information
        d = np.where(is_used[..., None], q - self.person.neutral, 0.0)
        K = len(self.modes)
        A = np.eye(K) + (is_used @ self._outer).reshape(-1, K, K)
        C = np.linalg.inv(A)
        c = np.einsum("tkl,tl->tk", C, np.einsum("kmx,tmx->tk", self.modes, w[..., None] * d))
        return C, c, d, w

    def soft_fit(self, q: Floats, precision: Floats) -> tuple[Floats, Floats]:
        """Fit one frame whose points are uncertain.

        Parameters
        ----------
        q : (M, 3) float64, mm, head frame
        precision : (M,) float64, mm⁻²
            Of each point, besides the marker's own noise; 0 for none.

        Returns
        -------
        (M, 3) float64, mm
            The fit; and the same without the pose's part of it.
        """
        w = 1.0 / (self.person.noise_mm**2 + 1.0 / np.maximum(precision, 1e-9))
        flat = self.modes.reshape(len(self.modes), -1)
        weighted = flat * np.repeat(w, 3)
        A = np.eye(len(flat)) + weighted @ flat.T
        c = np.linalg.solve(A, weighted @ np.nan_to_num(q - self.person.neutral).ravel())
        whole = (c @ flat).reshape(-1, 3)
        shape = (c[: self.n_shape] @ flat[: self.n_shape]).reshape(-1, 3)
        return self.person.neutral + whole, self.person.neutral + shape

    def pose(
        self, x: Floats, used: NDArray[np.bool_] | None = None, *, rounds: int = 2
    ) -> tuple[Floats, Floats]:
        """Where the head is in each frame: rotations (T, 3, 3) and translations (T, 3).

        The rigid fit of the face as its modes deform it, in turns with the modes' fit; NaN where
        fewer than three points are seen.

        Parameters
        ----------
        x : (T, M, 3) float64, mm, world frame
        used : (T, M) bool, optional
        """
        if used is not None:
            x = np.where(used[..., None], x, np.nan)
        stiff = 1.0 / (self.person.noise_mm**2 + (self.person.modes**2).sum(axis=(0, 2)) / 3)
        R, t = fit_frames(self.person.neutral, x, stiff)
        for _ in range(rounds):
            shape = self._shapes(to_head(x, R, t))
            R, t = fit_frames(shape, x, self._information)
        return R, t

    def _shapes(self, q: Floats) -> Floats:
        parts = []
        for i in range(0, max(len(q), 1), _BATCH):
            _, c, _, _ = self._solve(q[i : i + _BATCH], None)
            shape = np.einsum("tk,kmx->tmx", c[:, : self.n_shape], self.modes[: self.n_shape])
            parts.append(self.person.neutral + shape)
        return np.concatenate(parts)


def gaussian_cost(off: Floats, covariance: Floats) -> Floats:
    """Negative log density of offsets (..., 3) under covariances (..., 3, 3)."""
    return np.asarray(
        0.5 * (distance2(off, covariance) + np.linalg.slogdet(covariance)[1] + 3 * _LOG_2_PI)
    )


def distance2(off: Floats, covariance: Floats) -> Floats:
    """Squared Mahalanobis distance of offsets (..., 3) under covariances (..., 3, 3)."""
    return np.asarray((off * np.linalg.solve(covariance, off[..., None])[..., 0]).sum(axis=-1))
