"""A wand in the videos of a take: where its balls are in each frame, and how clocks differ."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..capture.wand_track import WandTrack
from ..core.errors import FileFormatError, InputError

if TYPE_CHECKING:
    from ..capture.synchronise import ClockFit
    from ..core.camera import Camera
    from ..tracking.blobs import Blobs

Floats = NDArray[np.float64]
_LARGEST_BALL_PX = 60_000  # area: a ball of 4 % of an HD picture's width


def follow_wand(
    path: Path,
    lens: Camera,
    balls_mm: Sequence[float],
    *,
    level: float | None = None,
    on_frame: Callable[[int], None] | None = None,
) -> WandTrack:
    """Find a wand in every frame of a video.

    Parameters
    ----------
    path : Path
    lens : Camera
    balls_mm : B floats
    level : float, optional
        Grey level above which a pixel belongs to a ball. By default it is sought in each frame
        until the wand is found.
    on_frame : callable, optional
        Told each frame's index.

    Raises
    ------
    FileFormatError
        If the file is no video, is damaged, or its pictures are not of the lens's size.
    """
    from ..core.video import read_frames

    times, pixels, sds = [], [], []
    nowhere = np.full((len(balls_mm), 2), np.nan)
    with closing(read_frames(path, gray=True)) as frames:
        for frame in frames:
            size = frame.image.shape[1], frame.image.shape[0]
            if size != lens.image_size:
                expected = f"{lens.image_size[0]}x{lens.image_size[1]} as of its lens"
                raise FileFormatError(path, "picture size", expected, f"{size[0]}x{size[1]}")
            found, level = _in_picture(frame.image, lens, balls_mm, level)
            times.append(frame.time_s)
            pixels.append(nowhere if found is None else found[0])
            sds.append(nowhere[:, 0] if found is None else found[1])
            if on_frame is not None:
                on_frame(frame.index)
    return WandTrack(np.array(times), np.array(pixels), np.array(sds))


def _in_picture(
    image: NDArray[np.uint8], lens: Camera, balls_mm: Sequence[float], level: float | None
) -> tuple[tuple[Floats, Floats] | None, float | None]:
    """Centres and their deviations, and the level once it is sure."""
    from ..capture.spheres import sphere_centres
    from ..capture.wand_detection import find_wand
    from ..tracking.blobs import BlobSettings, find_blobs, find_level

    try:
        tried = find_level(image) if level is None else level
        blobs: Blobs = find_blobs(image, BlobSettings(tried, max_area_px=_LARGEST_BALL_PX))
    except InputError:  # nothing bright here, or far too much of it: no wand in this frame
        return None, level
    rows = find_wand(blobs.centres, lens, balls_mm, areas_px=blobs.areas_px)
    if rows is None:
        return None, level
    centres = sphere_centres(blobs.centres[rows], blobs.areas_px[rows], lens)
    return (centres, blobs.sd_px[rows]), tried


def wand_clocks(
    tracks: Mapping[str, WandTrack],
    lenses: Mapping[str, Camera],
    balls_mm: Sequence[float],
    max_offset_s: float,
) -> dict[str, ClockFit]:
    """Clocks against the first camera, from the wand's motion.

    Raises
    ------
    InputError
        If two cameras do not see it move for long enough at the same time.
    """
    from ..capture.wand_detection import is_symmetric
    from ..capture.wand_sync import synchronise_wand

    first, *others = tracks
    clocks = {}
    for name in others:
        # half of both must overlap, or a short stretch may fit by chance
        ends = min(tracks[first].time_s[-1], tracks[name].time_s[-1])
        most_s = min(max_offset_s, 0.5 * float(ends))
        try:
            clocks[name] = synchronise_wand(
                tracks[first], tracks[name], lenses[first], lenses[name],
                symmetric=is_symmetric(balls_mm), max_offset_s=most_s,
            )  # fmt: skip
        except InputError as error:
            raise InputError(f"{name} against {first}: {error}") from error
    return clocks
