"""`facewright animate` without markers: an ordinary video of a face to an animated head."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import InputError
from .heads import find_head
from .options import note
from .progress import Ticks

if TYPE_CHECKING:
    from ..core.audio import SoundTrack
    from ..core.rig import Rig
    from ..tracking.face_analysis import FacePerformance
    from ..tracking.face_fit import FittedFace
    from ..tracking.landmark_tracks import LandmarkTracks


@dataclass(frozen=True)
class PlainOptions:
    """How a face without markers is followed and shown.

    Attributes
    ----------
    head : str
        That is animated.
    neutral : str or None
        A frame number, seconds with an s, or the file of a personal neutral face; found if None.
    face : int
        Which one is followed where there are several, the largest being 0.
    save_neutral : Path or None
        Where to keep the person's neutral face.
    points : Path or None
        Points marked in one frame, followed instead of what the networks see.
    """

    head: str
    neutral: str | None = None
    face: int = 0
    save_neutral: Path | None = None
    points: Path | None = None


@dataclass(frozen=True, eq=False)
class PlainResult:
    """What a run found; files lie in the output folder."""

    tracks: LandmarkTracks
    performance: FacePerformance
    facts: dict[str, Any]


def run_plain(
    videos: Sequence[Path], rig: Rig | None, folder: Path, how: PlainOptions
) -> PlainResult:
    """The whole way from ordinary videos to the animated head; writes all files into a folder.

    Several videos are cameras of `rig`; one may do without.
    """
    from ..core.formats.fap import write_fap
    from ..core.formats.gltf import write_glb
    from ..core.formats.live_link_csv import write_live_link_csv
    from ..retarget.drive import HeadDrive
    from ..retarget.export import animation_glb
    from ..tracking.face_analysis import analyse_face
    from ..tracking.neutral_personal import write_neutral

    videos, rig, each = _frontal_first(videos, rig, _tracks(videos, how))
    first = each[0]
    note("analysing the face")
    performance = analyse_face(each, rig=rig, neutral=_neutral(how.neutral, first))
    rate_hz = _usual_rate(first)
    write_fap(folder / "performance.fap", _evenly(performance.faps, rate_hz))
    write_live_link_csv(folder / "arkit.csv", performance.weights, rate=round(rate_hz))
    if how.save_neutral is not None:
        write_neutral(how.save_neutral, performance.face)
    note("animating the head")
    target = find_head(how.head)
    animation = HeadDrive(target).animate(performance.faps)
    write_glb(folder / "head.glb", animation_glb(target, animation, name=target.name))
    facts = _facts(each, performance, target.name)
    _show(folder, videos[0], first, performance, animation, target.name, facts)
    return PlainResult(first, performance, facts)


def _tracks(videos: Sequence[Path], how: PlainOptions) -> tuple[LandmarkTracks, ...]:
    from ..tracking.face_following import track_landmarks
    from ..tracking.manual_points import read_marked_points
    from ..tracking.marked_following import follow_marked_points

    marked = None if how.points is None else read_marked_points(how.points)
    if marked is not None and len(videos) > 1:
        raise InputError(
            f"{how.points}: points are marked in one video, and {len(videos)} are given"
        )
    found = []
    for video in videos:
        note(f"following the face in {video}")
        if marked is None:
            tracks = track_landmarks(video, face=how.face)
        else:
            tracks = follow_marked_points(video, marked)
        for line in tracks.notes:
            note(line)
        found.append(tracks)
    return tuple(found)


def _frontal_first(
    videos: Sequence[Path], rig: Rig | None, each: Sequence[LandmarkTracks]
) -> tuple[list[Path], Rig | None, list[LandmarkTracks]]:
    """The camera that sees the face most from the front leads and is shown."""
    from ..core.rig import Rig

    turned = [_turned(t) for t in each]
    order = sorted(range(len(each)), key=lambda i: turned[i])
    if rig is not None:
        names = list(rig)
        rig = Rig({names[i]: rig[names[i]] for i in order})
    return [videos[i] for i in order], rig, [each[i] for i in order]


def _turned(tracks: LandmarkTracks) -> float:
    """How far the nose's tip lies aside of the middle between the eyes, in the eyes' distance."""
    import numpy as np

    from ..heads.face_landmarks import NAMED_LANDMARKS

    names = ("eye_right_outer", "eye_left_outer", "nose_tip")
    right, left, tip = (tracks.points_px[:, NAMED_LANDMARKS[n]] for n in names)
    across = left - right
    aside = ((tip - (left + right) / 2) * across).sum(axis=1) / (across**2).sum(axis=1)
    return float(np.median(np.nan_to_num(np.abs(aside), nan=np.inf)))


def _neutral(given: str | None, tracks: LandmarkTracks) -> FittedFace | float | None:
    """A personal neutral face, or when the clip shows it, s."""
    from ..tracking.neutral_personal import read_neutral
    from .options import parse_when

    if given is None:
        return None
    if given.endswith(".npz"):
        return read_neutral(Path(given))
    frame, seconds = parse_when(given)
    if seconds is not None:
        return seconds
    if frame >= len(tracks.time_s):
        raise InputError(f"--neutral {frame}: the video has frames 0 to {len(tracks.time_s) - 1}")
    return float(tracks.time_s[frame])


def _usual_rate(tracks: LandmarkTracks) -> float:
    import numpy as np

    return 1 / float(np.median(np.diff(tracks.time_s))) if len(tracks.time_s) > 1 else 30.0


def _evenly(clip: Any, rate_hz: float) -> Any:
    """The clip at a fixed rate: `.fap` knows no time stamps; said where that changes anything."""
    import numpy as np

    if clip.rate_hz is not None:
        return clip
    time_s = clip.time_s
    note(f"frames come unevenly: performance.fap is resampled to {rate_hz:.4g} frames/s")
    n = int((time_s[-1] - time_s[0]) * rate_hz) + 1
    return clip.resample(np.minimum(time_s[0] + np.arange(n) / rate_hz, time_s[-1]))


def _facts(
    each: Sequence[LandmarkTracks], performance: FacePerformance, head: str
) -> dict[str, Any]:
    from ..tracking.landmark_tracks import LandmarkSource

    first = each[0]
    source = first.source
    return {
        "frames": len(first.time_s),
        "cameras": len(each),
        "frames_measured": int((source == LandmarkSource.NETWORK).sum()),
        "frames_followed": int((source == LandmarkSource.FOLLOWED).sum()),
        "frames_bridged": int((source == LandmarkSource.BRIDGED).sum()),
        "frames_without_face": int((source == LandmarkSource.MISSING).sum()),
        "cuts": len(first.cuts),
        "focal_px": performance.focal_px,
        "neutral_frames": [int(k) for k in performance.neutral_frames],
        "faps": len(performance.faps.channels),
        "faps_not_seen": list(performance.dead),
        "head": head,
    }


def _sound(video: Path) -> SoundTrack | None:
    from ..core.audio import read_audio
    from ..core.video import open_container

    with open_container(video) as container:
        if not container.streams.audio:
            return None
    return read_audio(video)


def _show(
    folder: Path,
    video: Path,
    tracks: LandmarkTracks,
    performance: FacePerformance,
    animation: Any,
    head: str,
    facts: dict[str, Any],
) -> None:
    import tempfile

    from .landmark_panels import landmark_panels, panel_times
    from .preview import write_previews
    from .report import write_plain_report

    times_s = panel_times(tracks)
    rate_hz = 1 / float(times_s[1] - times_s[0]) if len(times_s) > 1 else 30.0
    with tempfile.TemporaryDirectory() as scratch:
        source = Path(scratch) / "source.mp4"
        with Ticks(len(times_s), "preview") as tick:
            write_previews(
                folder / "preview.mp4", source, landmark_panels(video, tracks, times_s),
                rate_hz, animation, head, audio=_sound(video), on_frame=tick,
            )  # fmt: skip
        write_plain_report(folder, source, head, performance, facts)
