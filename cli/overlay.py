"""A camera's video with the tracked markers drawn over it, to see what tracking saw."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.camera import Camera
from ..core.trajectories import Source, Trajectories
from ..core.video import probe_video, read_frames
from ..core.video_writer import VideoWriter
from .preview import marker_colour

#: Wider pictures are made this wide.
MAX_WIDTH = 960
_DARKENED = 0.75
_SUB = 4  # bits of sub-pixel positions in OpenCV's drawing


def write_overlay(
    path: Path,
    video: Path,
    camera: Camera,
    tracks: Trajectories,
    *,
    on_frame: Callable[[int], None] | None = None,
) -> int:
    """Write the camera's pictures with every marker where the trajectories say it is.

    Discs were measured, rings interpolated, crosses reconstructed from other markers. Frames and
    samples are paired by their time stamps; frames without a sample show the picture alone.

    Parameters
    ----------
    path, video : Path
    camera : Camera
    tracks : Trajectories
    on_frame : callable, optional
        Told the number of frames written.

    Returns
    -------
    int
        Frames written.
    """
    info = probe_video(video)
    scale = min(1.0, MAX_WIDTH / info.width)
    size = (2 * round(info.width * scale / 2), 2 * round(info.height * scale / 2))
    pixels = (camera.project(tracks.positions) + 0.5) * scale - 0.5
    half = 0.5 * float(np.median(np.diff(tracks.time_s))) if len(tracks.time_s) > 1 else 0.0
    count = 0
    with (
        VideoWriter(path, size, info.rate_hz, crf=23, preset="veryfast") as out,
        closing(read_frames(video)) as frames,
    ):
        for frame in frames:
            picture = cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA)
            picture = (picture * _DARKENED).astype(np.uint8)
            row = int(np.argmin(np.abs(tracks.time_s - frame.time_s)))
            if abs(tracks.time_s[row] - frame.time_s) <= half + 1e-9:
                _draw(picture, pixels[row], tracks, row)
            out.write(picture)
            count += 1
            if on_frame is not None:
                on_frame(count)
    return count


def _draw(
    picture: NDArray[np.uint8], pixels: NDArray[np.float64], tracks: Trajectories, row: int
) -> None:
    for m, name in enumerate(tracks.names):
        if not np.isfinite(pixels[m]).all():
            continue
        colour = marker_colour(name)
        x, y = (int(v) for v in np.rint(pixels[m] * 2**_SUB))
        source = tracks.source[row, m]
        if source == Source.RECONSTRUCTED:
            at = (round(pixels[m][0]), round(pixels[m][1]))
            cv2.drawMarker(picture, at, colour, cv2.MARKER_TILTED_CROSS, 9, 1, cv2.LINE_AA)
        else:
            thick = -1 if source == Source.MEASURED else 1
            cv2.circle(picture, (x, y), 3 << _SUB, colour, thick, cv2.LINE_AA, _SUB)
        at = (round(pixels[m][0]) + 6, round(pixels[m][1]) - 4)
        cv2.putText(picture, name, at, cv2.FONT_HERSHEY_SIMPLEX, 0.33, colour, 1, cv2.LINE_AA)
