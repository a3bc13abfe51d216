"""An ordinary video and the face that was followed in it, as panels of a preview."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.video import read_frames
from ..tracking.landmark_regions import CLOSED_CONTOURS, CONTOURS
from ..tracking.landmark_tracks import LandmarkSource, LandmarkTracks
from .preview import CAPTION, MAX_RATE_HZ, PANEL, captioned, marker_colour

_MARGIN = 1.5  # of the landmarks' box: the head is larger than its face
_DIM = 0.6
_WORDS = {
    LandmarkSource.MISSING: "no face",
    LandmarkSource.NETWORK: "measured",
    LandmarkSource.FOLLOWED: "followed by flow",
    LandmarkSource.BRIDGED: "bridged",
}
_IRISES = ((468, 469), (473, 474))  # middle, and a point of the rim


def panel_times(tracks: LandmarkTracks) -> NDArray[np.float64]:
    """When panels are shown, (n,) s: evenly, as often as frames come but not above 30 a second."""
    time_s = tracks.time_s
    usual = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1 / MAX_RATE_HZ
    step_s = max(usual, 1 / MAX_RATE_HZ)
    return np.asarray(time_s[0] + step_s * np.arange(int((time_s[-1] - time_s[0]) / step_s) + 1))


def landmark_panels(
    video: Path, tracks: LandmarkTracks, times_s: NDArray[np.float64]
) -> Iterator[tuple[int, NDArray[np.uint8], NDArray[np.uint8]]]:
    """For every time the nearest frame: its number, the source panel and the landmarks panel."""
    middles = (tracks.time_s[1:] + tracks.time_s[:-1]) / 2
    shown = np.searchsorted(middles, times_s)
    A = _affine(tracks)
    size = (PANEL[0], PANEL[1] - CAPTION)
    with closing(read_frames(video)) as frames:
        for frame in frames:
            count = int((shown == frame.index).sum())
            if not count:
                continue
            source = np.asarray(
                cv2.warpAffine(frame.image, A, size, flags=cv2.INTER_AREA), dtype=np.uint8
            )
            followed = (source * _DIM).astype(np.uint8)
            _draw_face(followed, tracks.points_px[frame.index] @ A[:, :2].T + A[:, 2])
            word = _WORDS[LandmarkSource(int(tracks.source[frame.index]))]
            for _ in range(count):
                yield (
                    frame.index,
                    captioned(source, f"{video.name}  {frame.time_s:6.3f} s"),
                    captioned(followed, f"face: {word}"),
                )


def _affine(tracks: LandmarkTracks) -> NDArray[np.float64]:
    """Source pixels to panel pixels, (2, 3): the face's whole way is in it."""
    points = tracks.points_px.reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    width, height = PANEL[0], PANEL[1] - CAPTION
    span = max(float((high - low)[1]), float((high - low)[0]) * height / width) * _MARGIN
    x, y = (low + high) / 2 - np.array([span * width / height, span]) / 2
    s = height / span
    return np.array([[s, 0, -s * x], [0, s, -s * y]])


def _draw_face(panel: NDArray[np.uint8], points: NDArray[np.float64]) -> None:
    for name, rows in CONTOURS.items():
        path = points[list(rows)]
        colour = marker_colour(name)
        is_there = np.isfinite(path).all(axis=1)
        ends = np.rint(path[is_there] * 16).astype(np.int32)
        if not is_there.all():  # points that were marked by hand, say
            for x, y in ends.tolist():
                cv2.circle(panel, (x, y), 3 * 16, colour, -1, cv2.LINE_AA, 4)
            continue
        cv2.polylines(panel, [ends], name in CLOSED_CONTOURS, colour, 1, cv2.LINE_AA, 4)
    for middle, rim in _IRISES:
        if np.isfinite(points[[middle, rim]]).all():
            radius = float(np.linalg.norm(points[rim] - points[middle]))
            at = tuple(int(v) for v in np.rint(points[middle] * 16))
            cv2.circle(panel, at, round(radius * 16), (96, 190, 255), 1, cv2.LINE_AA, 4)
