"""From the video files of a take to unlabelled trajectories."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError
from ..core.rig import Rig
from ..core.trajectories import Trajectories
from ..core.video import VideoInfo, probe_video, sample_frames
from .blobs import BlobSettings, find_blobs, find_level
from .dot_streams import stream_dots
from .footage import Footage
from .spot_settings import find_settings
from .tracker import TrackerSettings
from .triangulation import Views, triangulate
from .video_clocks import read_clocks

__all__ = [
    "TrackedVideos", "blob_settings", "match_videos_to_rig", "track_videos", "warm_up",
]  # fmt: skip

logger = logging.getLogger(__name__)

_SAMPLES = 3  # pictures of each camera that tell the level of its dots
_NOTED_FRAMES = 2
_STEADY = 0.15  # of the level: light that changes more is looked at more closely
_FEWEST_DOTS, _ALIKE, _MOSTLY = 5, 4.0, 0.75


@dataclass(frozen=True, eq=False)
class TrackedVideos:
    """Trajectories and how they came about.

    Attributes
    ----------
    trajectories : Trajectories
        Unlabelled.
    levels : mapping from camera to float
        Grey level above which a pixel was a dot's.
    n_dots : (T, C) int64
        Dots found in each picture.
    rig : Rig
        Of the cameras used; refined, if that was asked for and needed.
    notes : tuple of str
        What the user should know: lost frames, cameras that were moved.
    """

    trajectories: Trajectories
    levels: Mapping[str, float]
    n_dots: NDArray[np.int64]
    rig: Rig
    notes: tuple[str, ...] = ()


def match_videos_to_rig(
    videos: Sequence[Path], rig: Rig, *, at_least: int = 2
) -> tuple[Rig, dict[str, Path]]:
    """Which video belongs to which camera: by file name (``cam0.mp4`` is camera ``cam0``).

    Returns the rig of the cameras that have a video, and the video of each.

    Raises
    ------
    InputError
        If a video has no camera, two are of one camera, or fewer than `at_least` are given.
    FileFormatError
        If a video's picture size is not its camera's.
    """
    chosen: dict[str, Path] = {}
    for path in videos:
        if path.stem not in rig.cameras:
            raise InputError(
                f"{path}: the camera rig has no camera named {path.stem} "
                f"(it has {', '.join(rig.names)}): name videos after their cameras"
            )
        if path.stem in chosen:
            raise InputError(f"{path} and {chosen[path.stem]} are both of camera {path.stem}")
        chosen[path.stem] = path
    if len(chosen) < at_least:
        raise InputError(f"tracking in space needs at least {at_least} videos, got {len(chosen)}")
    names = [n for n in rig if n in chosen]
    for name in names:
        _check_size(chosen[name], probe_video(chosen[name]), rig[name].image_size)
    return Rig({n: rig[n] for n in names}), {n: chosen[n] for n in names}


def _check_size(path: Path, info: VideoInfo, size: tuple[int, int]) -> None:
    if (info.width, info.height) != size:
        expected = f"{size[0]}x{size[1]} as in the camera rig"
        raise FileFormatError(path, "picture size", expected, f"{info.width}x{info.height}")


def blob_settings(
    paths: Mapping[str, Path], *, level: float | None = None, colour: str | None = None
) -> dict[str, BlobSettings]:
    """What counts as a dot in each camera's video, found from pictures spread over it.

    Parameters
    ----------
    paths : mapping from camera to Path
    level : float, optional
        Take this grey level for all: bright markers.
    colour : str, optional
        Of the markers, one of `spot_settings.COLOURS`. By default bright or dark ones are looked
        for, and coloured ones where there are none.

    Raises
    ------
    InputError
        If there are no dots in most of the pictures looked at.
    """
    if level is not None:
        return {name: BlobSettings(level) for name in paths}
    with ThreadPoolExecutor(len(paths)) as pool:
        found = pool.map(lambda path: _settings_of(path, colour), paths.values())
        return dict(zip(paths, found, strict=True))


def _settings_of(path: Path, colour: str | None) -> BlobSettings:
    is_grey = colour in (None, "white", "black")
    if colour in (None, "white"):
        plain = _plain_settings(_pictures(path, gray=True))
        if plain is not None:
            return plain
    try:
        if is_grey:
            try:
                return find_settings(_pictures(path, gray=True), colour=colour)
            except InputError:
                if colour is not None:
                    raise
        return find_settings(_pictures(path, gray=False), colour=colour)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _plain_settings(pictures: Sequence[NDArray[np.uint8]]) -> BlobSettings | None:
    """At once, where there is nothing to search for: bright dots in steady light.

    None unless all pictures ask for about the same level, and show spots of one kind there.
    """
    levels = []
    for image in pictures:
        try:
            levels.append(find_level(image))
        except InputError:
            return None
    level = float(np.median(levels))
    if np.ptp(levels) > _STEADY * level:
        return None
    settings = BlobSettings(level)
    for image in pictures:
        try:
            areas = find_blobs(image, settings).areas_px
        except InputError:
            return None
        if len(areas) < _FEWEST_DOTS:
            return None
        ratio = areas / np.median(areas)
        if ((ratio < _ALIKE) & (ratio > 1 / _ALIKE)).mean() < _MOSTLY:
            return None
    return settings


def _pictures(path: Path, *, gray: bool) -> list[NDArray[np.uint8]]:
    return [picture.image for picture in sample_frames(path, _SAMPLES, gray=gray)]


def track_videos(
    videos: Sequence[Path],
    rig: Rig,
    *,
    level: float | None = None,
    colour: str | None = None,
    settings: TrackerSettings | None = None,
    rate_hz: float | None = None,
    refine_rig: bool = False,
    on_frame: Callable[[int], None] | None = None,
) -> TrackedVideos:
    """Track all markers of a take, in memory; `long_takes.track_long` does it in pieces.

    Cameras are decoded and searched in threads of their own, a bounded number of frames ahead of
    the tracker. They are taken to have been started together; from then on their time stamps tell
    which frames are one instant, so that a frame which a camera lost is a view that is missing.

    Parameters
    ----------
    videos : sequence of Path
        Named after the rig's cameras.
    rig : Rig
    level : float, optional
        Grey level above which a pixel is a dot's; found from each camera's footage by default.
    colour : str, optional
        Of the markers, as `blob_settings` says.
    settings : TrackerSettings, optional
    rate_hz : float, optional
        The rate at which the take was filmed, where files say a wrong one.
    refine_rig : bool
        Estimate cameras anew that were moved after their calibration; else they are left out.
    on_frame : callable, optional
        Told each finished frame's index.

    Raises
    ------
    InputError, FileFormatError
        Videos and rig do not fit; rates differ; a file is broken; no dots.
    """
    rig, paths = match_videos_to_rig(videos, rig)
    clocks = read_clocks(paths, rate_hz=rate_hz)
    blobs = blob_settings(paths, level=level, colour=colour)
    footage = Footage(rig, settings)
    lost = LostFrames(rig.names)
    for index, frame in enumerate(stream_dots(paths, clocks, blobs)):
        footage.step(frame)
        lost.count(~np.isnan(frame.stamps_s))
        if on_frame is not None:
            on_frame(index)
    found = footage.tracked(refine_rig=refine_rig)
    tracks = found.followed.trajectories
    logger.info("followed %d tracks over %d frames", len(tracks.names), len(tracks.time_s))
    return TrackedVideos(
        tracks,
        {name: s.level for name, s in blobs.items()},
        found.followed.n_dots,
        found.verdict.rigs[0][1] if refine_rig else rig,
        (*clocks.notes, *lost.notes(), *found.verdict.notes),
    )


class LostFrames:
    """Counts the frames that cameras lost, or ended too early for."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._seen = np.zeros(len(self._names), np.int64)
        self._last = np.zeros(len(self._names), np.int64)
        self._n = 0

    def count(self, here: NDArray[np.bool_]) -> None:
        """Take note of the next frame: (C,), which cameras have it."""
        self._n += 1
        self._seen += here
        self._last[here] = self._n

    def notes(self) -> tuple[str, ...]:
        """What is worth saying."""
        found = []
        for name, seen, last in zip(self._names, self._seen, self._last, strict=True):
            if self._n - last > _NOTED_FRAMES:
                found.append(f"{name} ends {self._n - last} frames before the others")
            if last > seen:
                found.append(f"{name} lost {last - seen} of {last} frames: they are missing views")
        return tuple(found)


def warm_up() -> None:
    """Compile the hot loops (some seconds once; kept in numba's cache beside the package)."""
    image = np.full((64, 64), 20, np.uint8)
    image[28:36, 28:36] = 220
    image.flags.writeable = False
    find_blobs(image[:, :60], BlobSettings(120.0))
    eye = np.concatenate([np.eye(3), [[0.0], [0.0], [500.0]]], axis=1)
    aside = eye.copy()
    aside[0, 3] = 50.0
    views = Views(np.stack([eye, aside]), np.ones(2), ())
    triangulate(views, np.array([[[0.0, 0.0], [0.1, 0.0]]]), np.ones((1, 2)))
