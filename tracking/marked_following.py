"""Follows marked points through a video, forwards and backwards, without any network."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.video import Frame, read_frames
from ..heads.face_landmarks import N_LANDMARKS
from .face_rectify import SIDE_PX, RectifiedFrame, even_picture
from .flow_tracks import flow_sd, follow_points
from .landmark_tracks import LandmarkSource, LandmarkTracks
from .manual_points import MarkedPoints
from .templates import FaceTemplate, template_sd

Floats = NDArray[np.float64]
Gray = NDArray[np.uint8]

_SHARE = 0.6  # of the rectified picture that the marked points fill
_LOST_SD = 4.0  # px of the rectified face: beyond that a point is not known any more
_FEWEST = 3  # points that tell how the face moved
_MOST_BEFORE = 600  # frames before the marked one; they are kept in memory
_WIDE_LEVELS = 3  # of the pyramid: the face's own motion is not yet known
_INLIER_PX = 4.0


def follow_marked_points(video: Path | Sequence[Frame], marked: MarkedPoints) -> LandmarkTracks:
    """Landmarks of a face whose points were marked in one frame.

    Parameters
    ----------
    video : Path or sequence of Frame, RGB or gray
    marked : MarkedPoints

    Returns
    -------
    LandmarkTracks
        The marked points only; NaN where one is lost. Presence is NaN; there are no scores.

    Raises
    ------
    InputError
        If the marked frame is not in the video, too late in it, or a point outside the picture.
    FileFormatError, OSError
        If the file cannot be read.
    """
    if marked.frame > _MOST_BEFORE:
        raise InputError(
            f"frame {marked.frame} is marked: mark one of the first {_MOST_BEFORE}, or cut the clip"
        )
    time_s: list[float] = []
    early: list[Gray] = []
    courses: list[tuple[Floats, Floats]] = []
    follower: _Follower | None = None
    size = (1, 1)
    frames = read_frames(video, gray=True) if isinstance(video, Path) else _grays(video)
    with closing(frames):
        for number, frame in enumerate(frames):
            time_s.append(frame.time_s)
            size = frame.image.shape[1], frame.image.shape[0]
            if number < marked.frame:
                early.append(np.array(frame.image))
            elif follower is None:
                _check_inside(marked, size)
                follower = _Follower(marked.points_px, frame.image)
                courses = _backwards(marked.points_px, frame.image, early)
                courses.append(follower.now())
            else:
                courses.append(follower.step(frame.image))
    if follower is None:
        raise InputError(f"frame {marked.frame} is marked, but the video has {len(time_s)} frames")
    return _tracks(np.array(time_s), courses, marked, size)


def _grays(video: Iterable[Frame]) -> Generator[Frame, None, None]:
    for frame in video:
        if frame.image.ndim == 3:
            gray = np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
            yield Frame(frame.index, frame.time_s, gray)
        else:
            yield frame


def _check_inside(marked: MarkedPoints, size: tuple[int, int]) -> None:
    outside = (marked.points_px < -0.5) | (marked.points_px > np.array(size) - 0.5)
    if outside.any():
        row = int(np.flatnonzero(outside.any(axis=1))[0])
        x, y = marked.points_px[row]
        raise InputError(
            f"point {marked.landmarks[row]} at ({x:g}, {y:g}) lies outside the picture of "
            f"{size[0]}x{size[1]} px"
        )


def _backwards(points: Floats, image: Gray, early: list[Gray]) -> list[tuple[Floats, Floats]]:
    follower = _Follower(points, image)
    return [follower.step(gray) for gray in reversed(early)][::-1]


@dataclass(eq=False)
class _Pose:
    """The last frame: its picture, where the face lay, and its points in it."""

    image: Gray
    frame: RectifiedFrame


class _Follower:
    """Points from frame to frame: each place is flow's, put right wherever the template is found.

    The state is a place and its variance for each point (a Kalman filter without velocity), in px
    of the rectified face.
    """

    def __init__(self, points: Floats, image: Gray) -> None:
        low, high = points.min(axis=0), points.max(axis=0)
        scale = _SHARE * SIDE_PX / max(float((high - low).max()), 1.0)
        shift = (SIDE_PX - 1) / 2 - scale * (low + high) / 2
        frame = RectifiedFrame(np.column_stack([scale * np.eye(2), shift]))
        self._places = frame.inwards(points)
        self._template = FaceTemplate(even_picture(image, frame), self._places)
        self._last = _Pose(image.copy(), frame)
        self._x, self._variance = np.array(points), np.full(len(points), 1e-4)

    def now(self) -> tuple[Floats, Floats]:
        """Points (n, 2) px and standard deviations (n,) px; NaN where a point is lost."""
        unit = self._last.frame.unit_px
        sd = np.sqrt(self._variance)
        lost = ~(sd < _LOST_SD)
        points = np.where(lost[:, None], np.nan, self._x)
        return points, np.where(lost, np.nan, np.maximum(sd, 0.05) * unit)

    def step(self, image: Gray) -> tuple[Floats, Floats]:
        """Follow the points into the next frame, (h, w) uint8."""
        last = self._last
        start = last.frame.inwards(self._x)
        before, after = even_picture(last.image, last.frame), even_picture(image, last.frame)
        found = follow_points(before, after, start, start, levels=_WIDE_LEVELS)
        sd = flow_sd(found)
        frame = self._moved(last.frame.outwards(found.places), sd)
        predicted = frame.outwards(start) if frame is not last.frame else self._x
        is_held = np.isfinite(sd) & (sd < _LOST_SD)
        self._x = np.where(is_held[:, None], last.frame.outwards(found.places), predicted)
        self._variance = self._variance + np.where(is_held, sd, _LOST_SD) ** 2
        self._correct(image, frame)
        self._last = _Pose(image.copy(), frame)
        return self.now()

    def _moved(self, points: Floats, sd: Floats) -> RectifiedFrame:
        """Where the face lies now, from points (n, 2) px that were followed well."""
        good = np.flatnonzero((np.sqrt(self._variance) < _LOST_SD) & (sd < 1.0))
        if len(good) < _FEWEST:
            return self._last.frame
        unit = self._last.frame.unit_px
        M, _ = cv2.estimateAffinePartial2D(
            points[good], self._places[good], ransacReprojThreshold=_INLIER_PX
        )
        if M is None or not 0.7 < unit * np.hypot(M[0, 0], M[1, 0]) < 1.4:
            return self._last.frame
        return RectifiedFrame(M)

    def _correct(self, image: Gray, frame: RectifiedFrame) -> None:
        """Put right the points whose patches of the marked frame are found."""
        is_lost = ~(np.sqrt(self._variance) < _LOST_SD)
        guess = np.where(is_lost[:, None], self._places, frame.inwards(self._x))
        found = self._template.register(even_picture(image, frame), guess)
        r = template_sd(found) ** 2
        miss = np.linalg.norm(found.places - guess, axis=1)
        is_it = np.isfinite(r) & (miss < 3 * np.sqrt(self._variance + r) + 1.0)
        gain = np.where(is_it, self._variance / (self._variance + np.nan_to_num(r, nan=1.0)), 0.0)
        target = np.where(is_it[:, None], frame.outwards(found.places), self._x)
        self._x = self._x + gain[:, None] * (target - self._x)
        self._variance = (1 - gain) * self._variance


def _tracks(
    time_s: Floats,
    courses: list[tuple[Floats, Floats]],
    marked: MarkedPoints,
    size: tuple[int, int],
) -> LandmarkTracks:
    T, rows = len(time_s), list(marked.landmarks)
    points, sd = np.full((T, N_LANDMARKS, 2), np.nan), np.full((T, N_LANDMARKS), np.nan)
    points[:, rows] = np.stack([p for p, _ in courses])
    sd[:, rows] = np.stack([s for _, s in courses])
    is_known = np.isfinite(sd).any(axis=1)
    source = np.where(is_known, LandmarkSource.FOLLOWED, LandmarkSource.MISSING)
    lost = int((np.isnan(sd[:, rows])).sum())
    notes = [
        f"{len(rows)} marked points were followed from frame {marked.frame}, without a network"
    ]
    if lost:
        notes.append(f"points are lost in {100 * lost / (T * len(rows)):.1f} % of their frames")
    return LandmarkTracks(
        time_s, points, sd, np.full(T, np.nan), source.astype(np.int64), size, notes=tuple(notes)
    )
