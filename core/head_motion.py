"""Rigid motion of the head, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import readonly
from .rigid import rotation_from_quaternion
from .time_base import checked_times, uniform_rate_hz


@dataclass(frozen=True, eq=False)
class HeadMotion:
    """Where the head is: ``p_world = R p_head + t`` at each time.

    Head frame: x to the subject's left, y up, z out of the face.

    Attributes
    ----------
    time_s : (T,) float64, s
    quaternion : (T, 4) float64, w x y z
        Unit length; NaN where the motion could not be found.
    translation : (T, 3) float64, mm, world frame
    covariance : (T, 6, 6) float64, or None
        Of the errors (φ, d): φ, rad, about the world's axes, ``R_true ≈ exp([φ]×) R``; d, mm, of
        the translation. NaN where the motion is.
    """

    time_s: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    translation: NDArray[np.float64]
    covariance: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        times = checked_times(self.time_s)
        n = len(times)
        q = readonly(self.quaternion, (n, 4), "quaternion")
        with np.errstate(invalid="ignore"):
            q = q / np.linalg.norm(q, axis=1, keepdims=True)
        object.__setattr__(self, "time_s", times)
        object.__setattr__(self, "quaternion", readonly(q, (n, 4), "quaternion"))
        t = readonly(self.translation, (n, 3), "translation")
        object.__setattr__(self, "translation", t)
        if self.covariance is not None:
            C = readonly(self.covariance, (n, 6, 6), "covariance")
            object.__setattr__(self, "covariance", C)

    @property
    def rate_hz(self) -> float | None:
        """Frames per second where the times are uniform, else None."""
        return uniform_rate_hz(self.time_s)

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(T, 3, 3) float64: world from head."""
        return rotation_from_quaternion(self.quaternion)

    def world_from_head(self, points: ArrayLike) -> NDArray[np.float64]:
        """Carry head-frame points, (T, M, 3), or (M, 3) for all times, to the world: (T, M, 3)."""
        p = np.asarray(points, dtype=np.float64)
        if p.ndim not in (2, 3) or p.shape[-1] != 3:
            raise ValueError(f"points must have shape (M, 3) or (T, M, 3), got {p.shape}")
        if p.ndim == 2:
            p = np.broadcast_to(p, (len(self.time_s), *p.shape))
        return np.asarray(np.einsum("tij,tmj->tmi", self.rotation, p) + self.translation[:, None])

    def head_from_world(self, points: ArrayLike) -> NDArray[np.float64]:
        """Carry world points, (T, M, 3), to the head frame."""
        p = np.asarray(points, dtype=np.float64) - self.translation[:, None]
        return np.asarray(np.einsum("tji,tmj->tmi", self.rotation, p))
