"""From the video files of a take to unlabelled trajectories."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Event

import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError
from ..core.rig import Rig
from ..core.trajectories import Trajectories
from ..core.video import Frame, VideoInfo, probe_video, read_frames
from .blobs import Blobs, BlobSettings, find_blobs, find_level
from .tracker import Followed, FrameDots, TrackerSettings, follow_markers
from .triangulation import Views, triangulate

logger = logging.getLogger(__name__)

#: If fewer of a camera's dots meet another camera's, footage and rig do not belong together.
MIN_SHARE_USED = 0.6
_QUEUE = 32  # frames a camera may run ahead; memory stays constant in the length of the take
_TIME_TOLERANCE = 0.25  # of a frame: cameras are taken to be in step


@dataclass(frozen=True, eq=False)
class TrackedVideos:
    """Trajectories and how they came about.

    Attributes
    ----------
    trajectories : Trajectories
        Unlabelled.
    levels : mapping from camera to float
        Grey level above which a pixel was a dot's.
    n_dots : (T, C) int32
        Dots found in each picture.
    """

    trajectories: Trajectories
    levels: Mapping[str, float]
    n_dots: NDArray[np.int32]


def match_videos_to_rig(videos: Sequence[Path], rig: Rig) -> tuple[Rig, dict[str, Path]]:
    """Which video belongs to which camera: by file name (``cam0.mp4`` is camera ``cam0``).

    Returns the rig of the cameras that have a video, and the video of each.

    Raises
    ------
    InputError
        If a video has no camera, two are of one camera, or fewer than two are given.
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
    if len(chosen) < 2:
        raise InputError(f"tracking in space needs at least two videos, got {len(chosen)}")
    names = [n for n in rig if n in chosen]
    for name in names:
        _check_size(chosen[name], probe_video(chosen[name]), rig[name].image_size)
    _check_rates({n: probe_video(chosen[n]) for n in names})
    return Rig({n: rig[n] for n in names}), {n: chosen[n] for n in names}


def _check_size(path: Path, info: VideoInfo, size: tuple[int, int]) -> None:
    if (info.width, info.height) != size:
        expected = f"{size[0]}x{size[1]} as in the camera rig"
        raise FileFormatError(path, "picture size", expected, f"{info.width}x{info.height}")


def _check_rates(infos: Mapping[str, VideoInfo]) -> None:
    (first_name, first), *others = infos.items()
    for name, info in others:
        if abs(info.rate_hz - first.rate_hz) > 1e-3 * first.rate_hz:
            raise InputError(
                f"videos run at different rates: {first_name} at {first.rate_hz:g}, {name} at "
                f"{info.rate_hz:g} frames/s"
            )


def track_videos(
    videos: Sequence[Path],
    rig: Rig,
    *,
    level: float | None = None,
    settings: TrackerSettings | None = None,
    on_frame: Callable[[int], None] | None = None,
) -> TrackedVideos:
    """Track all markers of a take.

    Cameras are decoded and searched in threads of their own, a bounded number of frames ahead of
    the tracker. They are taken to have been started together: frame i of all videos is one
    instant.

    Parameters
    ----------
    videos : sequence of Path
        Named after the rig's cameras.
    rig : Rig
    level : float, optional
        Grey level above which a pixel is a dot's; found from each camera's first frame by default.
    settings : TrackerSettings, optional
    on_frame : callable, optional
        Told each finished frame's index.

    Raises
    ------
    InputError, FileFormatError
        Videos and rig do not fit; lengths or time stamps differ; a file is broken; no dots.
    """
    rig, paths = match_videos_to_rig(videos, rig)
    levels: dict[str, float] = {}
    n_dots: list[list[int]] = []

    def dots() -> Iterator[FrameDots]:
        with ExitStack() as stack:
            stop = Event()
            pool = stack.enter_context(ThreadPoolExecutor(len(paths)))
            stack.callback(stop.set)
            queues: list[Queue[_Dots | None]] = []
            jobs = []
            for name, path in paths.items():
                queue: Queue[_Dots | None] = Queue(_QUEUE)
                queues.append(queue)
                jobs.append(pool.submit(_search, path, name, level, levels, queue, stop))
            yield from _in_step(list(paths.values()), queues, jobs, n_dots, on_frame)

    followed = follow_markers(rig, dots(), settings)
    _check_fit(rig, followed)
    found = followed.trajectories
    logger.info("followed %d tracks over %d frames", len(found.names), len(found.time_s))
    return TrackedVideos(found, levels, np.array(n_dots, dtype=np.int32))


def _check_fit(rig: Rig, followed: Followed) -> None:
    """Refuse footage whose dots do not meet in space: it is not this rig's."""
    if not len(followed.trajectories.names):
        raise InputError(
            "no marker was seen by two cameras at once: are the rig and the videos of one take?"
        )
    lost = [
        f"{name} ({100 * share:.0f} %)"
        for name, share in zip(rig, followed.share_used, strict=True)
        if share < MIN_SHARE_USED
    ]
    if lost:
        raise InputError(
            f"few of the dots of {', '.join(lost)} meet those of other cameras in space: is the "
            "camera rig of this take, is each video named after its camera, has a camera moved?"
        )


@dataclass(frozen=True, eq=False)
class _Dots:
    time_s: float
    blobs: Blobs


def _search(
    path: Path,
    name: str,
    level: float | None,
    levels: dict[str, float],
    queue: Queue[_Dots | None],
    stop: Event,
) -> None:
    """Decode one video and put its dots into the queue; None at the end or after an error."""
    try:
        settings: BlobSettings | None = None if level is None else BlobSettings(level)
        with closing(read_frames(path, gray=True, threads=1)) as frames:
            for frame in frames:
                if settings is None:
                    settings = BlobSettings(_level_of(path, frame))
                levels[name] = settings.level
                blobs = _blobs_of(path, frame, settings)
                if not _put(queue, _Dots(frame.time_s, blobs), stop):
                    return
    finally:
        _put(queue, None, stop)


def _level_of(path: Path, frame: Frame) -> float:
    try:
        return find_level(frame.image)
    except InputError as error:
        raise InputError(f"{path}, frame {frame.index}: {error}") from error


def _blobs_of(path: Path, frame: Frame, settings: BlobSettings) -> Blobs:
    try:
        return find_blobs(frame.image, settings)
    except InputError as error:
        raise InputError(f"{path}, frame {frame.index}: {error}") from error


def _put(queue: Queue[_Dots | None], item: _Dots | None, stop: Event) -> bool:
    while not stop.is_set():
        try:
            queue.put(item, timeout=0.1)
        except Full:
            continue
        return True
    return False


def _in_step(
    paths: Sequence[Path],
    queues: Sequence[Queue[_Dots | None]],
    jobs: Sequence[object],
    n_dots: list[list[int]],
    on_frame: Callable[[int], None] | None,
) -> Iterator[FrameDots]:
    frame = 0
    last_time, interval = 0.0, np.inf
    while True:
        items = [_get(queue, job) for queue, job in zip(queues, jobs, strict=True)]
        for job, item in zip(jobs, items, strict=True):
            if item is None:
                job.result()  # type: ignore[attr-defined]  # raises what broke the search
        ended = [p for p, item in zip(paths, items, strict=True) if item is None]
        present = [item for item in items if item is not None]
        if len(ended) == len(paths):
            return
        if ended:
            raise InputError(
                f"videos are of unequal length: {ended[0]} ends after {frame} frames, "
                f"{next(p for p, i in zip(paths, items, strict=True) if i is not None)} goes on"
            )
        times = [item.time_s for item in present]
        if frame:
            interval = min(interval, times[0] - last_time)
        if frame and max(times) - min(times) > _TIME_TOLERANCE * interval:
            raise InputError(
                f"{paths[int(np.argmax(times))]}, frame {frame}: cameras are out of step: time "
                f"stamps from {min(times):.4f} to {max(times):.4f} s"
            )
        last_time = times[0]
        n_dots.append([len(item.blobs) for item in present])
        yield FrameDots(
            float(np.mean(times)),
            tuple(item.blobs.centres for item in present),
            tuple(item.blobs.sd_px for item in present),
        )
        if on_frame is not None:
            on_frame(frame)
        frame += 1


def _get(queue: Queue[_Dots | None], job: object) -> _Dots | None:
    """The next item; None too if the job died without a word."""
    while True:
        try:
            return queue.get(timeout=0.2)
        except Empty:
            if job.done() and queue.empty():  # type: ignore[attr-defined]
                return None


def warm_up() -> None:
    """Compile the hot loops (some seconds once; kept in numba's cache beside the package)."""
    image = np.full((64, 64), 20, np.uint8)
    image[28:36, 28:36] = 220
    image.flags.writeable = False
    blobs = find_blobs(image[:, :60], BlobSettings(120.0))
    eye = np.concatenate([np.eye(3), [[0.0], [0.0], [500.0]]], axis=1)
    aside = eye.copy()
    aside[0, 3] = 50.0
    views = Views(np.stack([eye, aside]), np.ones(2), ())
    triangulate(views, np.array([[[0.0, 0.0], [0.1, 0.0]]]), np.ones((1, 2)))
    assert len(blobs) == 1
