"""Faces in pictures, with their landmarks: detector and landmark network together.

::

    finder = FaceFinder()
    for face in finder.find(picture):
        print(face.box, face.landmarks_px[NAMED_LANDMARKS["nose_tip"]])
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from .face_detector import FaceDetector, covered
from .face_landmarks import N_LANDMARKS, FaceLandmarker, FaceRegion
from .face_network import FaceWeights, checked_picture, read_face_weights
from .face_scores import ExpressionScorer

#: Logit of the landmark network above which there is a face.
MIN_PRESENCE = 0.0
#: Where the detector doubts, the landmark network must be surer: clouds of noise that both took for
#: faces had scores up to 0.58 with presences up to 8; faces have more of one or the other.
_DOUBTFUL_SCORE = 0.65
_MIN_DOUBTFUL_PRESENCE = 10.0
#: What is less sure may be a face that lies on its side or stands on its head: such faces
#: taken for upright had up to 16, those seen right 13 to 28.
_SURE_PRESENCE = 18.0
_SAME_FACE_SHARE = 0.5
_TURNED_SMALLEST = 0.085  # of the picture: turned faces are looked for without tiles


@dataclass(frozen=True, eq=False)
class FoundFace:
    """A face in a picture.

    Attributes
    ----------
    box : (4,) float64, px
        x0, y0, x1, y1 of the landmarks.
    score : float
        The detector's, 0 to 1; NaN for a face that was followed and not detected again.
    landmarks_px : (478, 3) float64, px
        x, y in the picture; z depth in about the same unit, negative towards the camera. Which is
        which: `NAMED_LANDMARKS`.
    presence : float
        The landmark network's logit of this being a face: above 0; faces seen well have 13 to 23.
    """

    box: NDArray[np.float64]
    score: float
    landmarks_px: NDArray[np.float64]
    presence: float

    def __post_init__(self) -> None:
        landmarks = readonly(self.landmarks_px, (N_LANDMARKS, 3), "landmarks_px")
        object.__setattr__(self, "landmarks_px", landmarks)
        object.__setattr__(self, "box", readonly(self.box, (4,), "box"))

    @property
    def size_px(self) -> float:
        """The larger side of the box."""
        return float(max(self.box[2] - self.box[0], self.box[3] - self.box[1]))

    @property
    def region(self) -> FaceRegion:
        """Where to look for the face in the next frame."""
        return FaceRegion.of_landmarks(self.landmarks_px)


class FaceFinder:
    """Finds faces; one for each thread.

    Parameters
    ----------
    weights : FaceWeights, optional
        Else those of the installed packages.
    smallest : float
        How much of the picture's larger side the smallest face fills; faces that lie on their
        side or stand on their head are looked for down to 0.085.
    passes : int
        How often the landmark network looks, each time where it saw the face before. The second
        look makes the result independent of the detector's box.

    Raises
    ------
    InputError
        If the networks are not installed; the message says how to install them.
    """

    def __init__(
        self, weights: FaceWeights | None = None, *, smallest: float = 0.05, passes: int = 2
    ) -> None:
        if not 0 < smallest <= 1:
            raise ValueError(f"smallest must lie above 0 and at most at 1, got {smallest}")
        if passes < 1:
            raise ValueError(f"passes must be at least 1, got {passes}")
        known = read_face_weights() if weights is None else weights
        self._detector = FaceDetector(known)
        self._landmarker = FaceLandmarker(known)
        self._scorer = ExpressionScorer(known)
        self._smallest = smallest
        self._passes = passes

    def find(self, image: NDArray[np.uint8]) -> tuple[FoundFace, ...]:
        """All faces in a picture, the largest first.

        Parameters
        ----------
        image : (h, w, 3) uint8, RGB

        Raises
        ------
        ValueError
            If the picture is not RGB.
        """
        picture = checked_picture(image)
        found = self._find_turned(picture, 0, self._smallest)
        if not found or min(face.presence for face in found) < _SURE_PRESENCE:
            smallest = max(self._smallest, _TURNED_SMALLEST)
            for quarter_turns in (1, 2, 3):
                found += self._find_turned(picture, quarter_turns, smallest)
        return _each_once(found)

    def _find_turned(
        self, picture: NDArray[np.uint8], quarter_turns: int, smallest: float
    ) -> list[FoundFace]:
        """Faces, some perhaps twice, that are more or less upright once the picture is turned."""
        detections = self._detector.detect(picture, smallest=smallest, quarter_turns=quarter_turns)
        looks = (
            self._look(picture, FaceRegion.of_detection(seen), seen.score, self._passes)
            for seen in detections
        )
        return [face for face in looks if face is not None and _is_believed(face)]

    def follow(self, image: NDArray[np.uint8], region: FaceRegion) -> FoundFace | None:
        """The face that was in `region` in the frame before; None if it is no longer there."""
        return self._look(checked_picture(image), region, np.nan, 1)

    def scores(self, face: FoundFace) -> NDArray[np.float64]:
        """How much of each ARKit expression the face shows, (52,), 0 to 1: `SCORE_NAMES`."""
        return self._scorer.scores(face.landmarks_px)

    def _look(
        self, picture: NDArray[np.uint8], region: FaceRegion, score: float, passes: int
    ) -> FoundFace | None:
        for _ in range(passes):
            landmarks, presence = self._landmarker.landmarks(picture, region)
            if presence <= MIN_PRESENCE:
                return None
            region = FaceRegion.of_landmarks(landmarks)
        xy = landmarks[:, :2]
        box = np.concatenate([xy.min(axis=0), xy.max(axis=0)])
        return FoundFace(box, score, landmarks, presence)


class FaceTracker:
    """Follows one face through a video: looks where it was, and everywhere if it is gone.

    Parameters
    ----------
    finder : FaceFinder
    """

    def __init__(self, finder: FaceFinder) -> None:
        self._finder = finder
        self._region: FaceRegion | None = None

    def follow(self, image: NDArray[np.uint8]) -> FoundFace | None:
        """The face in the next frame, (h, w, 3) uint8 RGB; None where there is none.

        A face that is found anew is the largest one; `score` tells when that happened (it is NaN
        while a face is followed).
        """
        face = None
        if self._region is not None:
            face = self._finder.follow(image, self._region)
        if face is None:
            face = next(iter(self._finder.find(image)), None)
        self._region = None if face is None else face.region
        return face

    def forget(self) -> None:
        """Look everywhere in the next frame: after a cut, say."""
        self._region = None


def _is_believed(face: FoundFace) -> bool:
    return face.score >= _DOUBTFUL_SCORE or face.presence > _MIN_DOUBTFUL_PRESENCE


def _each_once(faces: list[FoundFace]) -> tuple[FoundFace, ...]:
    """The largest face first; of those that lie on each other the one that is surest."""
    kept: list[FoundFace] = []
    for face in sorted(faces, key=lambda face: -face.presence):
        boxes = np.array([other.box for other in kept]).reshape(-1, 4)
        if not (covered(face.box, boxes) > _SAME_FACE_SHARE).any():
            kept.append(face)
    return tuple(sorted(kept, key=lambda face: -face.size_px))
