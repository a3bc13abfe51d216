"""Turn, shift and change of size at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Similarity:
    """A turn, a shift and a change of size: ``scale * rotation @ p + translation``."""

    scale: float
    rotation: Floats
    translation: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotation", readonly(self.rotation, (3, 3), "rotation"))
        object.__setattr__(self, "translation", readonly(self.translation, (3,), "translation"))

    def apply(self, points: Floats) -> Floats:
        """Points (..., 3) moved."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def after(self, first: Similarity) -> Similarity:
        """Another one first, then this."""
        return Similarity(
            self.scale * first.scale, self.rotation @ first.rotation, self.apply(first.translation)
        )

    def inverse(self) -> Similarity:
        """The way back."""
        back = self.rotation.T
        return Similarity(1 / self.scale, back, -back @ self.translation / self.scale)

    @classmethod
    def between(cls, source: Floats, target: Floats) -> Similarity:
        """The one that takes points nearest to others in the sense of least squares.

        Parameters
        ----------
        source, target : (n, 3) float64
            At least three, not on one line.

        Raises
        ------
        InputError
            If they are too few, or lie on one line or in one place.

        References
        ----------
        S. Umeyama: Least-squares estimation of transformation parameters between two point
        patterns, 1991, eqs. 40 to 43.
        """
        if len(source) < 3:
            raise InputError(
                f"at least 3 points are needed to lay the head straight, got {len(source)}"
            )
        a, b = source.mean(axis=0), target.mean(axis=0)
        p, q = source - a, target - b
        U, d, Vt = np.linalg.svd(q.T @ p / len(p))
        for name, values in (("known", p), ("given", q)):
            spread = np.linalg.svd(values, compute_uv=False)
            if spread[1] < 0.05 * spread[0]:
                raise InputError(
                    f"the {name} points lie on one line: give points that span the face, such as "
                    "the corners of the eyes, the tip of the nose and the corners of the mouth"
                )
        sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
        R = U @ np.diag(sign) @ Vt
        scale = float((d * sign).sum() / (p**2).sum(axis=1).mean())
        return cls(scale, R, b - scale * R @ a)
