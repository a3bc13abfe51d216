"""Where faces are in a picture: boxes, eyes, and little more; `face_landmarks` knows the rest.

Two networks of one make (Bazarevsky et al., BlazeFace: Sub-millisecond Neural Face Detection on
Mobile GPUs, 2019): for faces that fill an eighth of the picture or more, and for small ones. Where
the second is not installed, or faces are smaller still, the first one looks at parts of the
picture.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from .face_network import FaceWeights, Network, checked_picture

#: What the six points of a detection are; right and left are the subject's.
DETECTION_POINTS = ("eye_right", "eye_left", "nose_tip", "mouth", "ear_right", "ear_left")
MIN_SCORE = 0.5
_SAME_FACE_IOU = 0.3
_MAX_LOGIT = 80.0  # float32's exp overflows beyond
#: Share of the looked-at square that a face must fill to be found surely (measured).
_SHORT_RANGE_SHARE = 1 / 7
_FULL_RANGE_SHARE = 1 / 12
_MIN_TILE_PX = 32
#: Tiles that find faces hardly smaller than what is found already are left out.
_WORTHWHILE = 0.8
_TILE_STEP = 0.5  # of a tile's side, so that a face of half a tile lies whole in one


@dataclass(frozen=True, eq=False)
class FaceDetection:
    """A face as the detector sees it.

    Attributes
    ----------
    box : (4,) float64, px
        x0, y0, x1, y1, from the brows to the chin.
    score : float
        0 to 1.
    points : (6, 2) float64, px
        `DETECTION_POINTS`.
    """

    box: NDArray[np.float64]
    score: float
    points: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "box", readonly(self.box, (4,), "box"))
        object.__setattr__(self, "points", readonly(self.points, (6, 2), "points"))

    @property
    def size_px(self) -> float:
        """The larger side of the box."""
        return float(max(self.box[2] - self.box[0], self.box[3] - self.box[1]))


class FaceDetector:
    """Finds faces of any size in one picture; not to be shared between threads.

    Parameters
    ----------
    weights : FaceWeights
    """

    def __init__(self, weights: FaceWeights) -> None:
        self._short = _Detector.short_range(weights)
        self._full = None if weights.full_range is None else _Detector.full_range(weights)

    def detect(
        self, image: NDArray[np.uint8], *, smallest: float = 0.05, quarter_turns: int = 0
    ) -> tuple[FaceDetection, ...]:
        """Find faces, surest first.

        Parameters
        ----------
        image : (h, w, 3) uint8, RGB
        smallest : float
            How much of the picture's larger side the smallest face fills. Parts of the picture
            are looked at for small ones, which takes time; 0.15 and above looks once.
        quarter_turns : int
            How often the picture is turned to the left by 90° before it is looked at: the
            networks know faces that lean by up to about 60°. Results are in the given picture.

        Returns
        -------
        tuple of FaceDetection
            Each face once. Things that look like faces are among them: whoever needs to be sure
            asks the landmark network.
        """
        picture = np.ascontiguousarray(np.rot90(checked_picture(image), quarter_turns))
        found = self._look_everywhere(picture, smallest)
        return _merged([_turned_back(raw, picture, quarter_turns % 4) for raw in found])

    def _look_everywhere(self, picture: NDArray[np.uint8], smallest: float) -> list[_Raw]:
        found = self._short.look(picture, (0, 0))
        known_share = _SHORT_RANGE_SHARE
        if smallest < known_share and self._full is not None:
            found += self._full.look(picture, (0, 0))
            known_share = _FULL_RANGE_SHARE
        for side, share in _tile_levels(max(picture.shape[:2]), smallest):
            if share > known_share * _WORTHWHILE:
                continue
            for tile, corner in _tiles(picture, side):
                found += self._short.look(tile, corner)
        return found


@dataclass(frozen=True, eq=False)
class _Raw:
    """One anchor's answer: the box's corners, then the points, (8, 2) px."""

    score: float
    at: NDArray[np.float64]


class _Detector:
    """One of the two networks."""

    def __init__(self, network: Network, side: int, anchors: NDArray[np.float64]) -> None:
        self._network, self._side, self._anchors = network, side, anchors

    @classmethod
    def short_range(cls, weights: FaceWeights) -> _Detector:
        outputs = {"regressors": 896 * 16, "classificators": 896}
        network = Network(weights.detector, weights.source, (1, 3, 128, 128), outputs)
        anchors = np.concatenate([_anchors(128, 8, 2), _anchors(128, 16, 6)])
        return cls(network, 128, anchors)

    @classmethod
    def full_range(cls, weights: FaceWeights) -> _Detector:
        assert weights.full_range is not None
        outputs = {"reshaped_regressor_face_4": 2304 * 16, "reshaped_classifier_face_4": 2304}
        network = Network(weights.full_range, weights.source, (1, 3, 192, 192), outputs)
        return cls(network, 192, _anchors(192, 4, 1))

    def look(self, picture: NDArray[np.uint8], corner: tuple[int, int]) -> list[_Raw]:
        """Answers above `MIN_SCORE` in the coordinates of the picture that has `picture` at
        `corner`."""
        fitted, scale, pad = _letterboxed(picture, self._side)
        blob = (fitted.astype(np.float32).transpose(2, 0, 1) - 127.5) / 127.5
        values, logits = self._network.run(blob)
        scores = 1 / (1 + np.exp(-np.clip(logits, -_MAX_LOGIT, _MAX_LOGIT)))
        rows = np.flatnonzero(scores > MIN_SCORE)
        at = values.reshape(-1, 8, 2)[rows].astype(np.float64)
        centre, half = at[:, 0] + self._anchors[rows], at[:, 1] / 2
        points = at[:, 2:] + self._anchors[rows, None]
        corners = np.stack([centre - half, centre + half], axis=1)
        # from positions in the square, whose left edge is 0, to pixels, whose centres are whole
        in_picture = (np.concatenate([corners, points], axis=1) - pad) / scale - 0.5 + corner
        is_box = np.asarray((half > 0).all(axis=1))
        return [_Raw(float(scores[row]), in_picture[n]) for n, row in enumerate(rows) if is_box[n]]


def _anchors(side: int, stride: int, per_cell: int) -> NDArray[np.float64]:
    """Centres (n, 2) of the cells of a square, in its pixels from its left upper edge."""
    centres = (np.arange(side // stride) + 0.5) * stride
    grid = np.stack(np.meshgrid(centres, centres), axis=-1).reshape(-1, 2)
    return np.repeat(grid, per_cell, axis=0)


def _letterboxed(
    picture: NDArray[np.uint8], side: int
) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]:
    """The picture fitted into a square, the scale (x, y), and what was put left and above, px."""
    height, width = picture.shape[:2]
    fit = side / max(height, width)
    size = max(1, round(width * fit)), max(1, round(height * fit))
    how = cv2.INTER_AREA if fit < 1 else cv2.INTER_LINEAR
    small = cv2.resize(picture, size, interpolation=how)
    left, top = (side - size[0]) // 2, (side - size[1]) // 2
    square = np.zeros((side, side, 3), np.uint8)
    square[top : top + size[1], left : left + size[0]] = small
    return square, np.array([size[0] / width, size[1] / height]), np.array([left, top], np.float64)


def _turned_back(raw: _Raw, picture: NDArray[np.uint8], quarter_turns: int) -> _Raw:
    """An answer in the picture before it was turned to the left."""
    height, width = picture.shape[:2]
    at = raw.at
    for _ in range(quarter_turns):
        at = np.stack([height - 1 - at[:, 1], at[:, 0]], axis=1)  # one quarter to the right
        height, width = width, height
    corners = np.stack([at[:2].min(axis=0), at[:2].max(axis=0)])
    return _Raw(raw.score, np.concatenate([corners, at[2:]]))


def _tile_levels(length: int, smallest: float) -> Iterator[tuple[int, float]]:
    """Sides of ever smaller tiles, px, and the smallest face each finds as a share of `length`."""
    share = _SHORT_RANGE_SHARE
    while smallest < share:
        length, share = -(-length // 2), share / 2
        if length < _MIN_TILE_PX:
            return
        yield length, share


def _tiles(
    picture: NDArray[np.uint8], side: int
) -> Iterator[tuple[NDArray[np.uint8], tuple[int, int]]]:
    """Overlapping squares that cover the picture, each with its left upper pixel (x, y)."""
    height, width = picture.shape[:2]
    for y in _starts(height, side):
        for x in _starts(width, side):
            yield picture[y : y + side, x : x + side], (x, y)


def _starts(length: int, side: int) -> list[int]:
    """Where tiles begin along one side of the picture, evenly, the last one at its end."""
    room = max(length - side, 0)
    n = 1 + int(np.ceil(room / (side * _TILE_STEP)))
    return sorted({round(x) for x in np.linspace(0, room, n)})


def _merged(found: list[_Raw]) -> tuple[FaceDetection, ...]:
    """Each face once: answers that overlap the best one are averaged, weighted by score."""
    left = sorted(found, key=lambda raw: -raw.score)
    faces = []
    while left:
        boxes = np.array([raw.at[:2].ravel() for raw in left])
        is_same = overlap(boxes[0], boxes) > _SAME_FACE_IOU
        is_same[0] = True
        group = [raw for raw, same in zip(left, is_same, strict=True) if same]
        left = [raw for raw, same in zip(left, is_same, strict=True) if not same]
        weights = np.array([raw.score for raw in group])
        mean = np.average([raw.at for raw in group], axis=0, weights=weights)
        faces.append(FaceDetection(mean[:2].ravel(), group[0].score, mean[2:]))
    return tuple(faces)


def overlap(box: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Intersection over union of a box (4,) with boxes (n, 4), corners x0 y0 x1 y1."""
    both = _intersection(box, boxes)
    areas = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    either = (box[2:] - box[:2]).prod() + areas - both
    return np.asarray(both / np.maximum(either, 1e-9))


def covered(box: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Intersection of a box (4,) with boxes (n, 4), as a share of the smaller one."""
    areas = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    smaller = np.minimum((box[2:] - box[:2]).prod(), areas)
    return np.asarray(_intersection(box, boxes) / np.maximum(smaller, 1e-9))


def _intersection(box: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    low, high = np.maximum(box[:2], boxes[:, :2]), np.minimum(box[2:], boxes[:, 2:])
    return np.asarray(np.clip(high - low, 0, None).prod(axis=1))
