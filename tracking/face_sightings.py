"""The landmark network's view of a video: where one face is in each frame, and where cuts are."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.video import Frame
from ..heads.face_finder import FaceFinder, FoundFace
from ..heads.face_landmarks import N_LANDMARKS, FaceRegion

Floats = NDArray[np.float64]
T = TypeVar("T")

_AHEAD = 4  # frames decoded before they are asked for
_THUMB_PX = 48  # of the larger side of the small picture that cuts are seen in
_CUT_LEVELS, _CUT_TIMES = 12.0, 4.0  # mean change of a cut, and over that of the frames before it
_CUT_SHARE = 0.5  # of the pixels that change by more than that
_CUT_COLOURS = 0.25  # share of the pixels that change their colour's bin
_JUMP = 0.5  # face widths from one frame to the next: no head moves so fast
_BINS = 6  # of each colour
_BACK_PRESENCE = 5.0  # of a face that is back where it was lost
_LONGEST_WAIT = 8  # frames without a look for a face that is gone
_SAME_FACE = 1.5  # face widths that a face may move while it is out of sight


@dataclass(frozen=True, eq=False)
class FaceSightings:
    """One face through a video, by the network alone.

    Attributes
    ----------
    time_s : (T,) float64, s
    points_px : (T, 478, 2) float32, px
        NaN where there was no face.
    presence : (T,) float64
        The network's logit; NaN where there was no face.
    image_size : (int, int), px
    cuts : tuple of int
    n_faces : int
        The most that were seen at once where faces were looked for.
    """

    time_s: Floats
    points_px: NDArray[np.float32]
    presence: Floats
    image_size: tuple[int, int]
    cuts: tuple[int, ...]
    n_faces: int


def sight_face(frames: Iterable[Frame], finder: FaceFinder, *, face: int = 0) -> FaceSightings:
    """Follow one face through all frames.

    Parameters
    ----------
    frames : iterable of Frame, RGB
        Taken in a thread of its own, some frames ahead.
    finder : FaceFinder
    face : int
        Which of the first frame's faces, the largest being 0; after each cut again.
    """
    watcher, changes = _Watcher(finder, face), _CutDetector()
    time_s: list[float] = []
    points: list[NDArray[np.float32]] = []
    presence: list[float] = []
    cuts: list[int] = []
    size = (1, 1)
    for frame in ahead(iter(frames)):
        if changes.is_cut(frame.image):
            cuts.append(len(time_s))
            watcher.forget()
        seen = watcher.look(frame.image)
        if watcher.has_jumped and (not cuts or cuts[-1] != len(time_s)):
            cuts.append(len(time_s))
        size = frame.image.shape[1], frame.image.shape[0]
        time_s.append(frame.time_s)
        presence.append(np.nan if seen is None else seen.presence)
        points.append(_NOTHING if seen is None else seen.landmarks_px[:, :2].astype(np.float32))
    table = np.array(points, np.float32).reshape(-1, N_LANDMARKS, 2)
    return FaceSightings(
        np.array(time_s), table, np.array(presence), size, tuple(cuts), watcher.n_faces
    )


_NOTHING = np.full((N_LANDMARKS, 2), np.nan, np.float32)


def ahead(items: Iterator[T], count: int = _AHEAD) -> Generator[T, None, None]:
    """The items, the next few of them made in another thread meanwhile."""
    with ThreadPoolExecutor(1) as pool:
        waiting = deque(pool.submit(next, items, None) for _ in range(count))
        while (item := waiting.popleft().result()) is not None:
            waiting.append(pool.submit(next, items, None))
            yield item


class _Watcher:
    """Looks where the face was; everywhere if it is gone, the more seldom the longer it is."""

    def __init__(self, finder: FaceFinder, face: int) -> None:
        self._finder, self._face = finder, face
        self._region: FaceRegion | None = None
        self._last: FoundFace | None = None
        self._n_without = 0
        self.n_faces = 0
        self.has_jumped = False  # since the frame before

    def look(self, image: NDArray[np.uint8]) -> FoundFace | None:
        """The face in the next frame, (h, w, 3) uint8 RGB."""
        seen = None if self._region is None else self._finder.follow(image, self._region)
        if seen is not None and self._n_without and seen.presence < _BACK_PRESENCE:
            seen = None
        if seen is None and self._is_due():
            faces = self._finder.find(image)
            self.n_faces = max(self.n_faces, len(faces))
            seen = self._chosen(faces)
        last = self._last if self._n_without == 0 else None
        self.has_jumped = seen is not None and last is not None and _far(seen, last)
        self._n_without = 0 if seen is not None else self._n_without + 1
        self._region = self._region if seen is None else seen.region  # it may come back there
        self._last = seen or self._last
        return seen

    def forget(self) -> None:
        """What comes now has nothing to do with what was."""
        self._region = self._last = None
        self._n_without = 0

    def _is_due(self) -> bool:
        wait = min(self._n_without, _LONGEST_WAIT)
        return self._n_without < 2 or self._n_without % wait == 0

    def _chosen(self, faces: tuple[FoundFace, ...]) -> FoundFace | None:
        if self._last is None:
            return faces[self._face] if self._face < len(faces) else None
        centre, size = self._last.region.centre, self._last.size_px
        near = [
            (float(np.linalg.norm(f.region.centre - centre)), f)
            for f in faces
            if 0.5 < f.size_px / size < 2.0
        ]
        near = [pair for pair in near if pair[0] < _SAME_FACE * size]
        if near:
            return min(near, key=lambda pair: pair[0])[1]
        return faces[0] if len(faces) == 1 and self.n_faces == 1 else None


def _far(seen: FoundFace, last: FoundFace) -> bool:
    apart = float(np.linalg.norm(seen.region.centre - last.region.centre))
    return apart > _JUMP * last.size_px


class _CutDetector:
    """Tells frames that begin a new shot: much has changed at once, places and colours."""

    def __init__(self) -> None:
        self._before: NDArray[np.int16] | None = None
        self._usual: deque[float] = deque(maxlen=8)

    def is_cut(self, image: NDArray[np.uint8]) -> bool:
        """Whether the next frame, (h, w, 3) uint8 RGB, is the first of a shot."""
        every = max(1, max(image.shape[:2]) // _THUMB_PX)
        thumb = image[every // 2 :: every, every // 2 :: every].astype(np.int16)
        before, self._before = self._before, thumb
        if before is None:
            return False
        changes = np.abs(thumb - before).mean(axis=2)
        change = float(changes.mean())
        usual = float(np.median(self._usual)) if self._usual else 0.0
        self._usual.append(change)
        if change < max(_CUT_LEVELS, _CUT_TIMES * usual):
            return False
        if (changes > _CUT_LEVELS).mean() < _CUT_SHARE:
            return False
        if _colours_apart(thumb, before) < _CUT_COLOURS:
            return False
        self._usual.clear()
        return True


def _colours_apart(a: NDArray[np.int16], b: NDArray[np.int16]) -> float:
    """Share of the pixels that lie in another bin of colours."""

    def histogram(picture: NDArray[np.int16]) -> NDArray[np.int64]:
        bins = picture.astype(np.int64) * _BINS // 256 @ np.array([_BINS * _BINS, _BINS, 1])
        return np.bincount(bins.ravel(), minlength=_BINS**3)

    n = a.shape[0] * a.shape[1]
    return float(np.abs(histogram(a) - histogram(b)).sum() / (2 * n))
