"""The bright spots of a take's cameras at some moments, and how they are matched."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError
from .options import note
from .progress import Ticks

if TYPE_CHECKING:
    from ..capture.spot_matching import SpotFrame
    from ..core.rig import Rig
    from ..tracking.blobs import Blobs

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SpotMoments:
    """Frames of several cameras that belong together.

    Attributes
    ----------
    frames : tuple of SpotFrame
        Named after the first camera's frames.
    time_s : (T,) float64, s
        Of the first camera.
    """

    frames: tuple[SpotFrame, ...]
    time_s: Floats


def match_by_views(
    rig: Rig, centres: Sequence[Floats], sd_px: Sequence[Floats], tolerance_px: float
) -> NDArray[np.int64]:
    """`tracking.matching.match_views` as `capture.spot_matching` wants it."""
    from ..tracking.matching import match_views
    from ..tracking.triangulation import Views

    cameras = [rig[n] for n in rig]
    normalised = [c.undistort(p) for c, p in zip(cameras, centres, strict=True)]
    rows, _ = match_views(Views.of(cameras), normalised, sd_px, tolerance_px=tolerance_px)
    return rows


def spots_of_videos(
    videos: Mapping[str, Path],
    rig: Rig,
    *,
    max_frames: int,
    span_s: tuple[float, float] | None = None,
    level: float | None = None,
) -> SpotMoments:
    """The spots of all cameras at moments evenly spread over a take.

    Parameters
    ----------
    videos : mapping from camera to Path
        Of the rig's cameras, begun together.
    rig : Rig
    max_frames : int
    span_s : (first, last), s, optional
        The part of the take to look at.
    level : float, optional
        As in `tracking.videos.track_videos`.

    Raises
    ------
    InputError
        If rates differ, or no frames of all cameras belong together.
    FileFormatError
        If a file is no video or damaged, or its pictures are not its camera's.
    """
    from ..capture.frame_stamps import match_frames, read_frame_stamps
    from ..capture.spot_matching import SpotFrame

    stamps = {n: read_frame_stamps(path) for n, path in videos.items()}
    match = match_frames(stamps)
    for told in (match.note, match.warning):
        if told:
            note(told)
    if match.beat_s is None:
        raise InputError(
            "the frames of these videos come at uneven times: markers need frames that were taken "
            "together"
        )
    slots = {n: np.rint(t / match.beat_s[n]).astype(np.int64) for n, t in stamps.items()}
    shared = slots[next(iter(slots))]
    for other in slots.values():
        shared = np.intersect1d(shared, other)
    first = next(iter(videos))
    at_s = shared * match.beat_s[first]
    if span_s is not None:
        shared = shared[(at_s >= span_s[0]) & (at_s <= span_s[1])]
    if not len(shared):
        raise InputError("the videos have no frames in common in the part that was asked for")
    picks = np.linspace(0, len(shared) - 1, min(max_frames, len(shared))).round().astype(int)
    chosen = shared[picks]
    found = {}
    for name, path in videos.items():
        wanted = set(np.flatnonzero(np.isin(slots[name], chosen)).tolist())
        with Ticks(len(stamps[name]), f"looking for markers in {name}") as tick:
            found[name] = _blobs_of(path, rig[name].image_size, wanted, level, tick)
    frames = tuple(
        SpotFrame(
            f"frame {int(np.searchsorted(slots[first], slot))}",
            tuple(found[n][i].centres for n in videos),
            tuple(found[n][i].sd_px for n in videos),
        )
        for i, slot in enumerate(chosen)
    )
    return SpotMoments(frames, chosen * match.beat_s[first])


def _blobs_of(
    path: Path, size: tuple[int, int], wanted: set[int], level: float | None, tick: Ticks
) -> list[Blobs]:
    """Spots of the wanted frames, in order."""
    from ..core.video import read_frames
    from ..tracking.blobs import BlobSettings, find_blobs, find_level

    found = []
    with closing(read_frames(path, gray=True)) as frames:
        for frame in frames:
            tick()
            here = frame.image.shape[1], frame.image.shape[0]
            if here != size:
                expected = f"{size[0]}x{size[1]} as in the camera rig"
                raise FileFormatError(path, "picture size", expected, f"{here[0]}x{here[1]}")
            try:
                if level is None:
                    level = find_level(frame.image)
                if frame.index in wanted:
                    found.append(find_blobs(frame.image, BlobSettings(level)))
            except InputError as error:
                raise InputError(f"{path}, frame {frame.index}: {error}") from error
            if len(found) == len(wanted):
                break
    return found
