"""478 points on a face, by a network that looks at the part of the picture where the face is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from .face_detector import FaceDetection
from .face_network import FaceWeights, Network, checked_picture

N_LANDMARKS = 478
#: Which landmark is which place; right and left are the subject's. The network puts the inner
#: corners of the eyes about 4 % of the eyes' distance further in than a person would.
NAMED_LANDMARKS: Mapping[str, int] = MappingProxyType(
    {
        "eye_right_outer": 33,
        "eye_right_inner": 133,
        "eye_left_inner": 362,
        "eye_left_outer": 263,
        "lid_right_upper": 159,
        "lid_right_lower": 145,
        "lid_left_upper": 386,
        "lid_left_lower": 374,
        "iris_right": 468,
        "iris_left": 473,
        "nose_tip": 1,
        "mouth_right": 61,
        "mouth_left": 291,
        "lip_upper_outer": 0,
        "lip_upper_inner": 13,
        "lip_lower_inner": 14,
        "lip_lower_outer": 17,
        "chin": 152,
    }
)
_SIDE = 256  # px of the network's input
#: Of the larger side of a detection's or the landmarks' box: what the network was made for.
_MARGIN = 1.5


@dataclass(frozen=True, eq=False)
class FaceRegion:
    """A turned square that holds a face.

    Attributes
    ----------
    centre : (2,) float64, px
    side : float, px
    angle_rad : float
        From the picture's x axis to the line from the right eye to the left one, positive from x
        to y (clockwise as seen).
    """

    centre: NDArray[np.float64]
    side: float
    angle_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", readonly(self.centre, (2,), "centre"))
        if not (np.isfinite(self.centre).all() and np.isfinite(self.angle_rad)):
            raise ValueError("a region's centre and angle must be finite")
        if not 0 < self.side < np.inf:
            raise ValueError(f"a region's side must lie above 0, got {self.side}")

    @classmethod
    def of_detection(cls, detection: FaceDetection) -> FaceRegion:
        """Where the landmarks of a detected face are to be looked for."""
        right, left = detection.points[0], detection.points[1]
        centre = (detection.box[:2] + detection.box[2:]) / 2
        return cls(centre, _MARGIN * detection.size_px, _angle(right, left))

    @classmethod
    def of_landmarks(cls, landmarks: NDArray[np.float64]) -> FaceRegion:
        """Where a face is whose landmarks (478, 2 or 3) px are known: in the next frame, say."""
        xy = landmarks[:, :2]
        outer = NAMED_LANDMARKS["eye_right_outer"], NAMED_LANDMARKS["eye_left_outer"]
        angle = _angle(xy[outer[0]], xy[outer[1]])
        upright = xy @ _turn(angle)  # coordinates along and across the line of the eyes
        low, high = upright.min(axis=0), upright.max(axis=0)
        side = _MARGIN * float((high - low).max())
        return cls(_turn(angle) @ ((low + high) / 2), side, angle)

    @property
    def picture_from_square(self) -> NDArray[np.float64]:
        """(2, 3) float64: pixels of the picture from those of the network's input, continuous:
        0 is the input's left or upper edge."""
        A = _turn(self.angle_rad) * (self.side / _SIDE)
        return np.column_stack([A, self.centre - A @ np.full(2, _SIDE / 2)])


class FaceLandmarker:
    """Runs the landmark network; not to be shared between threads.

    Parameters
    ----------
    weights : FaceWeights
    """

    def __init__(self, weights: FaceWeights) -> None:
        outputs = {"Identity": N_LANDMARKS * 3, "Identity_1": 1}
        shape = (1, 3, _SIDE, _SIDE)
        self._network = Network(weights.landmarks, weights.source, shape, outputs)

    def landmarks(
        self, image: NDArray[np.uint8], region: FaceRegion
    ) -> tuple[NDArray[np.float64], float]:
        """Landmarks of the face in a region, and whether there is one.

        Parameters
        ----------
        image : (h, w, 3) uint8, RGB
        region : FaceRegion

        Returns
        -------
        landmarks : (478, 3) float64, px
            x and y in the picture; z is depth in about the same unit, from the face's middle,
            negative towards the camera. They are there whether there is a face or not.
        presence : float
            The logit of a face's being there: above 0 means yes; upright faces that are seen
            well have 13 to 23.
        """
        square = cut_out(checked_picture(image), region)
        blob = square.astype(np.float32).transpose(2, 0, 1) / np.float32(255)
        values, logit = self._network.run(blob)
        at = values.reshape(-1, 3).astype(np.float64)
        M = region.picture_from_square
        xy = at[:, :2] @ M[:, :2].T + M[:, 2]
        z = at[:, 2:] * (region.side / _SIDE)
        return np.hstack([xy, z]), float(logit[0])


def cut_out(image: NDArray[np.uint8], region: FaceRegion) -> NDArray[np.uint8]:
    """The (256, 256, 3) uint8 picture of a region: turned upright, beyond the edge its colours.

    A large face is shrunk by averaging first, so that fine hair does not alias.
    """
    M = region.picture_from_square
    # a pixel of the square has its centre half a pixel from its edge
    from_centres = np.column_stack([M[:, :2], M[:, 2] + M[:, :2] @ np.full(2, 0.5)])
    if region.side > 1.25 * _SIDE:
        image, from_centres = _shrunk(image, region, from_centres)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = (_SIDE, _SIDE)
    found = cv2.warpAffine(image, from_centres, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found)


def _shrunk(
    image: NDArray[np.uint8], region: FaceRegion, from_centres: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """The part of the picture around the region at about the square's scale, and the map to it."""
    height, width = image.shape[:2]
    reach = region.side * (abs(np.cos(region.angle_rad)) + abs(np.sin(region.angle_rad))) / 2 + 2
    low = np.floor(region.centre - reach).astype(int)
    high = np.ceil(region.centre + reach).astype(int) + 1
    x0, y0 = (int(np.clip(v, 0, n - 1)) for v, n in zip(low, (width, height), strict=True))
    x1, y1 = (
        int(np.clip(v, start + 1, n))
        for v, start, n in zip(high, (x0, y0), (width, height), strict=True)
    )
    part = image[y0:y1, x0:x1]
    shrink = _SIDE / region.side
    size = max(1, round((x1 - x0) * shrink)), max(1, round((y1 - y0) * shrink))
    small = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    scale = np.array([size[0] / (x1 - x0), size[1] / (y1 - y0)])
    A = from_centres[:, :2] * scale[:, None]
    offset = (from_centres[:, 2] + 0.5 - (x0, y0)) * scale - 0.5
    return np.asarray(small), np.column_stack([A, offset])


def _angle(right: NDArray[np.float64], left: NDArray[np.float64]) -> float:
    return float(np.arctan2(left[1] - right[1], left[0] - right[0]))


def _turn(angle_rad: float) -> NDArray[np.float64]:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]])
