"""What the pictures or videos of a take show of the board, for `facewright calibrate rig`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import InputError
from .options import note
from .progress import Ticks, progress
from .rig_clocks import Step, clocks_by_motion, clocks_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..capture.board_detection import Detection
    from ..capture.board_video import TimedDetections
    from ..capture.calibration_take import TakeCamera
    from ..capture.lens import BoardView, RejectedView
    from ..capture.synchronise import ClockFit
    from ..core.boards import Board
    from ..core.camera import Camera

_LOOKS_PER_S = 8.0
#: Frames that a moment lies between are looked at: those within so many frames of it.
_NEAR_FRAMES = 1.05


@dataclass(frozen=True, eq=False)
class Sightings:
    """What a take shows of the board.

    Attributes
    ----------
    image_sizes : mapping from camera to (width, height), px
    views : mapping from camera to its views
        Views of the same name were taken at the same moment.
    rejected : tuple of RejectedView
        Named CAMERA/VIEW.
    clocks : mapping from camera to ClockFit
        Against the first camera; empty if nothing was synchronised.
    videos : mapping from camera to Path
        Empty where there are pictures.
    looks : mapping from camera to TimedDetections
        At the frames of videos that were looked at.
    notes, warnings : tuple of str
    """

    image_sizes: Mapping[str, tuple[int, int]]
    views: Mapping[str, list[BoardView]]
    rejected: tuple[RejectedView, ...] = ()
    clocks: Mapping[str, ClockFit] = field(default_factory=dict)
    videos: Mapping[str, Path] = field(default_factory=dict)
    looks: Mapping[str, TimedDetections] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def collect(
    cameras: Sequence[TakeCamera],
    pattern: Board,
    step: Step,
    *,
    max_views: int,
    known: Mapping[str, Camera] | None = None,
) -> Sightings:
    """Find the board in everything that the cameras recorded; `known` are lenses.

    Raises
    ------
    InputError
        If pictures of one camera differ in size, or videos cannot be brought into step.
    FileFormatError
        If a file is no picture or no video.
    """
    from ..core.video import probe_video

    videos = {c.name: c.video for c in cameras if c.video is not None}
    if not videos:
        return _of_pictures(cameras, pattern, step)
    for path in videos.values():
        probe_video(path)  # what is no video is told before the first is searched
    if step.by == "none":
        return _of_videos_in_step(videos, pattern, max_views)
    if step.by == "motion":
        looks = {name: search(name, path, pattern) for name, path in videos.items()}
        clocks = clocks_by_motion(looks, pattern, step.max_offset_s, known or {})
        first = next(iter(looks.values()))
        stride = _stride(first.frame_s)
        return _at_moments(videos, looks, clocks, _moments(first)[::stride], pattern, max_views)
    clocks = clocks_of(videos, step)
    return _of_videos_with_clocks(videos, clocks, pattern, max_views)


def _of_pictures(cameras: Sequence[TakeCamera], pattern: Board, step: Step) -> Sightings:
    from ..capture.calibration_take import detect_in_pictures, views_of_pictures

    if step.by != "none":
        raise InputError(f"--sync {step.by} needs videos: pictures of the same name go together")
    sizes, found = {}, {}
    for camera in cameras:
        shown = progress(camera.pictures, len(camera.pictures), f"searching {camera.name}")
        try:
            # cam1/007.png belongs to cam0/007.jpg
            sizes[camera.name], found[camera.name] = detect_in_pictures(
                shown, pattern, names=lambda path: path.stem
            )
        except InputError as error:
            raise InputError(f"{camera.name}: {error}") from error
    return Sightings(sizes, views_of_pictures(found), _unseen(found))


def _unseen(found: Mapping[str, Sequence[Detection]]) -> tuple[RejectedView, ...]:
    from ..capture.lens import RejectedView

    return tuple(
        RejectedView(f"{camera}/{d.name}", d.reason or "no board")
        for camera, seen in found.items()
        for d in seen
        if d.view is None
    )


def _of_videos_in_step(videos: Mapping[str, Path], pattern: Board, max_views: int) -> Sightings:
    """Videos that began together, as they say themselves."""
    from dataclasses import replace

    from ..capture.frame_stamps import match_frames, read_frame_stamps

    match = match_frames({name: read_frame_stamps(path) for name, path in videos.items()})
    if match.note:
        note(match.note)
    if match.beat_s is None:
        seen = _of_videos_with_clocks(videos, {}, pattern, max_views)
    else:
        seen = _of_videos_on_beat(videos, match.beat_s, pattern, max_views)
    return replace(
        seen,
        notes=tuple(filter(None, [match.note])),
        warnings=tuple(filter(None, [match.warning])),
    )


def _of_videos_on_beat(
    videos: Mapping[str, Path], beat_s: Mapping[str, float], pattern: Board, max_views: int
) -> Sightings:
    """Frames of the same beat belong together."""
    from ..capture.board_video import views_of_frames

    looks = {}
    stride = _stride(next(iter(beat_s.values())))
    for name, path in videos.items():
        looks[name] = search(
            name,
            path,
            pattern,
            is_wanted=lambda number, _: number % stride == 0,
            number_of=_beat_number(beat_s[name]),
        )
    views = views_of_frames(looks, max_views=max_views)
    return Sightings(_sizes(looks), views, videos=videos, looks=looks)


def _beat_number(beat_s: float) -> Callable[[int, float], int]:
    return lambda _, time_s: round(time_s / beat_s)


def _of_videos_with_clocks(
    videos: Mapping[str, Path], clocks: Mapping[str, ClockFit], pattern: Board, max_views: int
) -> Sightings:
    """Looks at some frames of the first, and at those of the others that were taken then."""
    import numpy as np

    from ..capture.frame_stamps import read_frame_stamps

    first, *others = videos
    frame_s = {n: float(np.median(np.diff(read_frame_stamps(p)))) for n, p in videos.items()}
    stride = _stride(frame_s[first])
    looks = {first: search(first, videos[first], pattern, is_wanted=lambda n, _: n % stride == 0)}
    moments = _moments(looks[first])
    for name in others:
        times = np.array([t for _, t in moments])
        wanted = clocks[name].other_s(times) if name in clocks else times
        is_near = _near(wanted, _NEAR_FRAMES * frame_s[name])
        looks[name] = search(name, videos[name], pattern, is_wanted=is_near)
    return _at_moments(videos, looks, clocks, moments, pattern, max_views)


def _near(wanted_s: NDArray[np.float64], within_s: float) -> Callable[[int, float], bool]:
    return lambda _, time_s: bool(abs(wanted_s - time_s).min() <= within_s)


def _at_moments(
    videos: Mapping[str, Path],
    looks: Mapping[str, TimedDetections],
    clocks: Mapping[str, ClockFit],
    moments: Sequence[tuple[str, float]],
    pattern: Board,
    max_views: int,
) -> Sightings:
    from ..capture.board_video import views_at_moments

    views = views_at_moments(looks, clocks, moments, pattern, max_views=max_views)
    return Sightings(_sizes(looks), views, clocks=clocks, videos=videos, looks=looks)


def search(
    name: str,
    path: Path,
    pattern: Board,
    *,
    is_wanted: Callable[[int, float], bool] | None = None,
    number_of: Callable[[int, float], int] | None = None,
    until_s: float = float("inf"),
    label: str = "searching",
) -> TimedDetections:
    """`detect_in_video` with its progress shown."""
    from ..capture.board_video import detect_in_video
    from ..core.video import probe_video

    info = probe_video(path)
    n = info.n_frames
    if n is not None and until_s < float("inf"):
        n = min(n, round(until_s * info.rate_hz) + 1)
    with Ticks(n, f"{label} {name}") as tick:
        return detect_in_video(
            path, pattern, is_wanted=is_wanted, number_of=number_of, until_s=until_s, on_frame=tick
        )


def _stride(frame_s: float) -> int:
    return max(1, round(1 / (frame_s * _LOOKS_PER_S)))


def _moments(seen: TimedDetections) -> list[tuple[str, float]]:
    return [(d.name, float(t)) for d, t in zip(seen.detections, seen.time_s, strict=True)]


def _sizes(seen: Mapping[str, TimedDetections]) -> dict[str, tuple[int, int]]:
    return {name: found.image_size for name, found in seen.items()}
