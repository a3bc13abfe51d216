"""Which frames of several videos belong together, by the time stamps that their files hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError
from ..core.video import open_container, probe_video

Floats = NDArray[np.float64]
#: Rates that differ by no more than these shares are the same; the second for uneven stamps.
_SAME_RATE, _SAME_UNEVEN_RATE = 0.01, 0.15
#: Stamps this far off an even beat at most, in beats, lie on it; Matroska rounds to 1 ms.
_ON_BEAT, _ROUNDED_S = 0.1, 1.1e-3


@dataclass(frozen=True, eq=False)
class FrameMatch:
    """How the frames of several videos that began together belong together.

    Attributes
    ----------
    beat_s : mapping from camera to float, or None
        Time from one beat to the next: frames of the same beat, counted from the first, belong
        together. None where frames come at uneven times: then only their times tell.
    note : str
        How they are matched where not simply by number; else empty.
    warning : str
        What may be wrong with that; or empty.
    """

    beat_s: Mapping[str, float] | None
    note: str = ""
    warning: str = ""


def read_frame_stamps(path: Path) -> Floats:
    """When the frames of a video are shown, (T,) float64, s, from the first; nothing is decoded.

    A file that holds no times has them by its rate.

    Raises
    ------
    FileFormatError
        If it is no video, is cut off, or has neither times nor a rate.
    OSError
        If it cannot be read.
    """
    import av

    rate_hz = probe_video(path).rate_hz  # refuses what is no video, and what is damaged at once
    with open_container(path) as container:
        cover = av.stream.Disposition.attached_pic
        stream = next(s for s in container.streams.video if not s.disposition & cover)
        is_avi = container.format.name == "avi"  # knows the order of decoding only
        # an AVI counts frames that were dropped in recording
        promised = 0 if is_avi else int(stream.frames)
        stamps: list[float] = []
        n_packets, problem = 0, ""
        try:
            for packet in container.demux(stream):
                if packet.is_corrupt:  # one that the file's end cuts short
                    break
                if packet.size:
                    n_packets += 1
                if packet.size and not packet.is_discard:
                    at = packet.dts if is_avi else packet.pts
                    stamps.append(np.nan if at is None else float(at * stream.time_base))
        except av.FFmpegError as error:
            problem = f"damaged data ({error.strerror or error})"
        if n_packets < promised:
            problem = problem or "the end of the file"
    if problem:
        expected = f"{promised} frames" if promised else "more frames"
        raise FileFormatError(path, f"frame {n_packets}", expected, problem)
    times = np.sort(np.array(stamps))
    if not np.isfinite(times).all():
        if not rate_hz > 0:
            raise FileFormatError(path, "file", "time stamps or a rate", "neither")
        return np.asarray(np.arange(len(times)) / rate_hz)
    return np.asarray(times - times[0])


def match_frames(stamps: Mapping[str, Floats]) -> FrameMatch:
    """Which frames belong together in videos whose first frames were taken at the same moment.

    Even stamps number the frames; even ones with gaps say which frames are missing; of uneven ones
    the times alone count.

    Parameters
    ----------
    stamps : mapping from camera to (T,) float64, s

    Raises
    ------
    InputError
        If a video has fewer than two frames, or the rates differ.
    """
    for name, t in stamps.items():
        if len(t) < 2:
            raise InputError(f"{name} has {len(t)} frame: a video of two or more is needed")
    beats = {name: _beat(t) for name, t in stamps.items()}
    first = next(iter(stamps))
    on_beat = {name: _slots(t, beats[name]) for name, t in stamps.items()}
    odd = [name for name, slots in on_beat.items() if slots is None]
    for name, beat in beats.items():
        if abs(beat / beats[first] - 1) > (_SAME_UNEVEN_RATE if odd else _SAME_RATE):
            raise InputError(
                f"{name} has {1 / beat:.2f} frames a second, {first} {1 / beats[first]:.2f}: "
                "bring them into step with --sync motion, sound or flash"
            )
    if odd:
        note = (
            f"the frames of {', '.join(odd)} come at uneven times: views are matched by the time "
            "stamps, counted from each video's first frame, and interpolated between frames"
        )
        return FrameMatch(None, note)
    slots = {name: s for name, s in on_beat.items() if s is not None}
    return FrameMatch(beats, _missing(slots), _unequal(slots))


def _beat(t: Floats) -> float:
    """The usual time between frames, from all of them."""
    steps = np.diff(t)
    usual = float(np.median(steps))
    whole = np.maximum(np.rint(steps / usual), 1)
    return float((t[-1] - t[0]) / whole.sum())


def _slots(t: Floats, beat: float) -> NDArray[np.int64] | None:
    """The beat of each frame, or None if the frames do not keep to one."""
    slots = np.rint(t / beat).astype(np.int64)
    off = np.abs(t - slots * beat).max()
    if off > max(_ON_BEAT * beat, _ROUNDED_S) or (np.diff(slots) < 1).any():
        return None
    return slots


def _lacking(slots: Mapping[str, NDArray[np.int64]]) -> dict[str, int]:
    return {name: int(s[-1]) + 1 - len(s) for name, s in slots.items()}


def _missing(slots: Mapping[str, NDArray[np.int64]]) -> str:
    lacking = _lacking(slots)
    gaps = [f"{name} {n} of {int(slots[name][-1]) + 1}" for name, n in lacking.items() if n]
    if not gaps:
        return ""
    return (
        f"frames are missing ({', '.join(gaps)}): frames of the same time stamp, counted from each "
        "video's first, are taken together, not those of the same number"
    )


def _unequal(slots: Mapping[str, NDArray[np.int64]]) -> str:
    counts = {name: len(s) for name, s in slots.items()}
    if any(_lacking(slots).values()) or max(counts.values()) - min(counts.values()) <= 1:
        return ""
    told = ", ".join(f"{name} {n}" for name, n in counts.items())
    return (
        f"the videos have different numbers of frames ({told}) without a gap in their time stamps: "
        "frames of the same number are taken together; if a camera lost some in between, or they "
        "began apart, use --sync motion"
    )
