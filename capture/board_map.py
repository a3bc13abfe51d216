"""How a board lies in a picture: a homography, and what the lens does to it, as one smooth map."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: Terms of the lens's polynomial and the points each degree asks for: well over its terms.
_DEGREES = ((3, 24), (2, 12), (0, 4))


@dataclass(frozen=True, eq=False)
class BoardMap:
    """From the board's plane to pixels: a homography plus a polynomial of low degree.

    Attributes
    ----------
    homography : (3, 3) float64
        Pixels from mm.
    middle : (2,) float64, mm
    size : float, mm
        Polynomials are in (p - middle) / size.
    degree : int
        0: no polynomial.
    bend : (K, 2) float64, px
    """

    homography: Floats
    middle: Floats
    size: float
    degree: int
    bend: Floats

    @classmethod
    def fit(cls, points: Floats, pixels: Floats, *, most_degree: int = 3) -> BoardMap | None:
        """Through points (N, 2) mm and their pixels (N, 2), least squares.

        None where they do not determine a homography.
        """
        n = len(points)
        if n < 4:
            return None
        H, _ = cv2.findHomography(points, pixels)
        if H is None or not np.isfinite(H).all() or abs(np.linalg.det(H)) < 1e-12:
            return None
        low, high = points.min(axis=0), points.max(axis=0)
        middle, size = (low + high) / 2, float((high - low).max()) / 2
        lines = min(len(np.unique(np.round((points[:, i] - low[i]) / size, 3))) for i in (0, 1))
        degree = next(
            d for d, least in _DEGREES if d <= most_degree and n >= least and (lines > d or d == 0)
        )
        flat = cls(H, middle, size, 0, np.zeros((0, 2)))
        if degree == 0:
            return flat
        terms = _terms((points - middle) / size, degree)
        bend = np.asarray(np.linalg.lstsq(terms, pixels - flat(points), rcond=None)[0], np.float64)
        return cls(H, middle, size, degree, bend)

    def __call__(self, points: Floats) -> Floats:
        """Pixels of points of the board, (..., 2) mm → (..., 2) px."""
        p = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1) @ self.homography.T
        found = p[..., :2] / p[..., 2:]
        if self.degree:
            found = found + _terms((points - self.middle) / self.size, self.degree) @ self.bend
        return np.asarray(found)

    def axes(self, points: Floats, step: float) -> tuple[Floats, Floats, Floats, Floats]:
        """What one step along the board's x and y is in the picture, and how lines along them bend.

        Parameters
        ----------
        points : (N, 2) float, mm
        step : float, mm

        Returns
        -------
        along_x, along_y : (N, 2) float64, px
        bend_x, bend_y : (N,) float64, 1/px
            Curvature of the lines along x and y, positive towards a quarter turn clockwise as one
            looks at the picture.
        """
        h = 0.25 * step
        here = self(points)
        found, bends = [], []
        for way in np.eye(2):
            after, before = self(points + h * way), self(points - h * way)
            slope, second = (after - before) / (2 * h), (after + before - 2 * here) / h**2
            found.append(slope * step)
            length2 = (slope**2).sum(axis=1)
            cross = slope[:, 0] * second[:, 1] - slope[:, 1] * second[:, 0]
            bends.append(cross / length2**1.5)
        return found[0], found[1], bends[0], bends[1]


def _terms(q: Floats, degree: int) -> Floats:
    """Monomials up to a degree, (..., K)."""
    x, y = q[..., 0], q[..., 1]
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.stack([x**i * y**j for i, j in powers], axis=-1)
