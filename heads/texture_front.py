"""A flat sheet before the face to draw spots and lines on, laid on the skin along z."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .texture_canvas import sample_bilinear

Floats = NDArray[np.float32]

_HALF_WIDTH_MM, _TOP_MM, _BOTTOM_MM, _BACK_MM = 72.0, 78.0, -122.0, -50.0


@dataclass(frozen=True, eq=False)
class FrontSheet:
    """A picture of what lies on the face, seen along z, which is painted on in millimetres.

    Attributes
    ----------
    picture : (h, w) float32
    scale : int, px/mm
    """

    picture: Floats
    scale: int

    @classmethod
    def blank(cls, scale: int = 8) -> FrontSheet:
        """All zeros."""
        height = round((_TOP_MM - _BOTTOM_MM) * scale)
        return cls(np.zeros((height, round(2 * _HALF_WIDTH_MM * scale)), np.float32), scale)

    def spot(self, x: float, y: float, radius: float, amount: float, soft: float = 0.3) -> None:
        """Raise to `amount` within a round spot, mm, its edge `soft` radii wide."""
        s = self.scale
        reach = int(np.ceil(radius * (1 + 3 * soft) * s)) + 2
        at_x, at_y = (x + _HALF_WIDTH_MM) * s, (_TOP_MM - y) * s
        x0, y0 = max(int(at_x) - reach, 0), max(int(at_y) - reach, 0)
        part = self.picture[y0 : int(at_y) + reach, x0 : int(at_x) + reach]
        if part.size == 0:
            return
        rows, columns = np.ogrid[: part.shape[0], : part.shape[1]]
        off = np.hypot(columns + x0 + 0.5 - at_x, rows + y0 + 0.5 - at_y) / (radius * s)
        cover = 1 / (1 + np.exp(np.clip((off - 1) / (0.25 * soft), -30, 30)))
        np.maximum(part, (amount * cover).astype(np.float32), out=part)

    def line(self, points: NDArray[np.float64], width: float, amounts: NDArray[np.float64]) -> None:
        """Raise along a line (N, 2) mm, `width` wide, by amounts (N,) that may swell and fade."""
        s = self.scale
        at = np.stack([points[:, 0] + _HALF_WIDTH_MM, _TOP_MM - points[:, 1]], axis=1) * s
        reach = int(np.ceil(width * 2 * s)) + 2
        x0, y0 = np.maximum(np.floor(at.min(axis=0)).astype(int) - reach, 0)
        x1, y1 = np.maximum(np.ceil(at.max(axis=0)).astype(int) + reach, 0)
        part = self.picture[y0:y1, x0:x1]
        if part.size == 0:
            return
        drawn = np.zeros(part.shape, np.float32)
        fixed = np.rint((at - (x0, y0)) * 16).astype(np.int32)
        for a, b, amount in zip(fixed[:-1], fixed[1:], amounts[:-1], strict=True):
            one = float(amount)
            if one > 0:
                cv2.line(drawn, a.tolist(), b.tolist(), one, max(1, round(width * s * 0.5)), 8, 4)
        drawn = cv2.GaussianBlur(drawn, (0, 0), 0.42 * width * s)
        np.maximum(part, drawn, out=part)

    def laid_on(self, places: Floats) -> Floats:
        """Values (N,) at places (N, 3) mm on the template; 0 off the face."""
        found = np.zeros(len(places), np.float32)
        p = places
        near = (p[:, 2] > _BACK_MM) & (np.abs(p[:, 0]) < _HALF_WIDTH_MM - 1)
        rows = np.flatnonzero(near & (p[:, 1] < _TOP_MM - 1) & (p[:, 1] > _BOTTOM_MM + 1))
        q = p[rows]
        x, y = (q[:, 0] + _HALF_WIDTH_MM) * self.scale, (_TOP_MM - q[:, 1]) * self.scale
        found[rows] = sample_bilinear(self.picture, x - np.float32(0.5), y - np.float32(0.5))
        return found
