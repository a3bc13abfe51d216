"""A face turned upright and brought to one size, with light and contrast evened out.

What is left between two such pictures is what the face itself did: flow has short ways to go, and
a patch of one frame is found again in another although the head has turned or the light changed.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from .landmark_regions import STEADY

Floats = NDArray[np.float64]

SIDE_PX = 256  # of the rectified picture
_FACE_SHARE = 0.8  # of the side that the face fills
_LOCAL_PX = 21  # over which light and contrast are evened out: a tenth of the face
_CONTRAST, _MIDDLE = 40.0, 128.0  # grey levels for one standard deviation, and the mean
_NOISE_LEVELS = 5.0  # grey levels: a flat patch keeps its noise small


@dataclass(frozen=True, eq=False)
class RectifiedFrame:
    """Where a face lies in a picture, as a similarity.

    Attributes
    ----------
    rectified_from_picture : (2, 3) float64
        ``p_rectified = A @ p_picture + b``, px; centres of pixels are whole numbers in both.
    """

    rectified_from_picture: Floats

    def __post_init__(self) -> None:
        M = readonly(self.rectified_from_picture, (2, 3), "rectified_from_picture")
        object.__setattr__(self, "rectified_from_picture", M)

    @property
    def unit_px(self) -> float:
        """Pixels of the picture in one of the rectified picture."""
        A = self.rectified_from_picture[:, :2]
        return float(1 / np.sqrt(A[0, 0] ** 2 + A[1, 0] ** 2))

    def inwards(self, points_px: Floats) -> Floats:
        """Rectified places of points (..., 2) px in the picture."""
        M = self.rectified_from_picture
        return np.asarray(points_px @ M[:, :2].T + M[:, 2])

    def outwards(self, points: Floats) -> Floats:
        """Places in the picture of rectified points (..., 2)."""
        M = self.rectified_from_picture
        scale = M[0, 0] ** 2 + M[1, 0] ** 2
        return np.asarray((points - M[:, 2]) @ M[:, :2] / scale)


def canonical_places(points_px: Floats) -> Floats:
    """Where a reference frame's landmarks (478, 2) px lie once rectified: upright and centred."""
    right, left = points_px[33], points_px[263]
    axis = complex(*(left - right))
    turned = (points_px[:, 0] + 1j * points_px[:, 1]) * np.conj(axis) / abs(axis)
    xy = np.column_stack([turned.real, turned.imag])
    low, high = xy.min(axis=0), xy.max(axis=0)
    scale = _FACE_SHARE * SIDE_PX / float((high - low).max())
    return np.asarray((xy - (low + high) / 2) * scale + (SIDE_PX - 1) / 2)


def rectify(points_px: Floats, places: Floats) -> RectifiedFrame:
    """The similarity that lays a frame's steady landmarks (478, 2) px on `canonical_places`."""
    steady = list(STEADY)
    a = points_px[steady, 0] + 1j * points_px[steady, 1]
    b = places[steady, 0] + 1j * places[steady, 1]
    from_, to = a - a.mean(), b - b.mean()
    turn = np.vdot(from_, to) / np.vdot(from_, from_)
    shift = b.mean() - turn * a.mean()
    rows = [[turn.real, -turn.imag, shift.real], [turn.imag, turn.real, shift.imag]]
    return RectifiedFrame(np.array(rows))


def even_picture(gray: NDArray[np.uint8], frame: RectifiedFrame) -> NDArray[np.uint8]:
    """The rectified face, (SIDE_PX, SIDE_PX) uint8, each place with about the same mean and spread.

    Parameters
    ----------
    gray : (h, w) uint8
    frame : RectifiedFrame
    """
    M, image = frame.rectified_from_picture, gray
    if frame.unit_px > 1.5:  # shrink by averaging first, or fine detail would alias
        share = 1 / frame.unit_px
        height, width = gray.shape
        size = max(1, round(width * share)), max(1, round(height * share))
        image = np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        steps = np.array([width / size[0], height / size[1]])
        M = np.column_stack([M[:, :2] * steps, M[:, 2] + M[:, :2] @ ((steps - 1) / 2)])
    flags, size = cv2.INTER_LINEAR, (SIDE_PX, SIDE_PX)
    face = cv2.warpAffine(image, M, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    window = (_LOCAL_PX, _LOCAL_PX)
    mean = cv2.blur(face.astype(np.float32), window)
    square = cv2.sqrBoxFilter(face, cv2.CV_32F, window)
    spread = cv2.sqrt(cv2.max(square - mean * mean, 0) + np.float32(_NOISE_LEVELS**2))
    even = _MIDDLE + _CONTRAST * (face - mean) / spread
    return np.asarray(np.clip(even, 0, 255).astype(np.uint8))
