"""Which frames of a take's videos are one instant, by the time stamps in the files.

Frames that a camera lost are missing from its own stamps only, so the others' frames go on without
that view. All of it works on the stamps as they come: an hour of video is never listed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.video import VideoInfo, open_container, probe_video

_LOOK_PACKETS = 400
_MAX_REORDERED = 16  # H.264's and H.265's limit
_SAME_RATE = 1e-3
_SAME_COUNT = 0.02
#: Rates that cameras have: whole numbers, and those of NTSC; a measured one this near is that.
_SNAP = 3e-4
_NTSC = 1000 / 1001
_PHASE_GAIN = 0.05  # of a stamp's offset from the beat is taken to be the clock's, not jitter
_MAX_LEAP_S = 60.0
_SOUND_DIFFERS = 0.02
_SOUND_DIFFERS_S = 0.5


@dataclass(frozen=True, eq=False)
class VideoClocks:
    """The common beat of a take's videos.

    Attributes
    ----------
    rate_hz : float
        Of the take: beat i is at ``i / rate_hz``.
    interval_s : mapping from camera to float
        From one frame to the next by the file's own stamps.
    n_beats : int or None
        How many frames there will be at most; None where files do not say.
    notes : tuple of str
        What the user should know.
    """

    rate_hz: float
    interval_s: Mapping[str, float]
    n_beats: int | None
    notes: tuple[str, ...] = ()


def read_clocks(paths: Mapping[str, Path], *, rate_hz: float | None = None) -> VideoClocks:
    """The beat of videos that were started together.

    Parameters
    ----------
    paths : mapping from camera to Path
    rate_hz : float, optional
        The true rate, where files say a wrong one: their frames are then numbered by their own
        stamps, and come at this rate.

    Raises
    ------
    InputError
        If the videos run at different rates, or one of them says a wrong one.
    FileFormatError, OSError
        If a file is no video or cannot be read.
    """
    infos = {name: probe_video(path) for name, path in paths.items()}
    interval_s = {name: _interval_s(info) for name, info in infos.items()}
    if rate_hz is None:
        _check_rates(infos, interval_s)
    first = float(np.median(list(interval_s.values())))
    counts = [
        round(info.duration_s / interval_s[name]) if np.isfinite(info.duration_s) else None
        for name, info in infos.items()
    ]
    known = [n for n in counts if n is not None]
    n_beats = max(known) if len(known) == len(counts) else None
    notes = [note for name, path in paths.items() if (note := _sound_note(name, path, infos[name]))]
    return VideoClocks(rate_hz or _usual_rate(1 / first), interval_s, n_beats, tuple(notes))


class Beat:
    """Numbers one video's frames by their stamps, as they come.

    A phase that follows the stamps slowly takes up a clock that runs a little fast or slow;
    single stamps may be off by some tenths of a frame.
    """

    def __init__(self, name: str, interval_s: float, start: tuple[int, float] = (0, 0.0)) -> None:
        """`start` is a beat and the stamp of its frame: the first, or one known from before."""
        self._name, self._interval_s = name, interval_s
        beat, self._last_s = start
        self._phase_s = self._last_s - beat * interval_s
        self._last = beat - 1

    def number(self, time_s: float) -> int:
        """The beat of the frame stamped so; greater than all before.

        Raises
        ------
        InputError
            If time leaps by more than a minute.
        """
        if time_s - self._last_s > _MAX_LEAP_S:
            raise InputError(
                f"{self._name}: its time stamps leap from {self._last_s:.3f} to {time_s:.3f} s: "
                "the recording was interrupted; cut it there and track the parts"
            )
        beat = round((time_s - self._phase_s) / self._interval_s)
        beat = max(beat, self._last + 1)
        self._phase_s += _PHASE_GAIN * (time_s - beat * self._interval_s - self._phase_s)
        self._last, self._last_s = beat, time_s
        return beat


def _interval_s(info: VideoInfo) -> float:
    """From frame to frame by the first stamps, lost frames counted; else by the file's rate."""
    stamps = _first_stamps(info.path)
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    if len(steps) < 2:
        if info.rate_hz > 0:
            return 1 / info.rate_hz
        raise InputError(f"{info.path}: has neither time stamps nor a frame rate")
    usual = float(np.median(steps))
    return float(steps.sum() / np.maximum(np.rint(steps / usual), 1).sum())


def _first_stamps(path: Path) -> NDArray[np.float64]:
    """(n,) s, in order; without decoding."""
    with open_container(path) as container:
        stream = container.streams.video[0]
        is_avi = container.format.name == "avi"  # which knows the order of decoding only
        ticks = [
            packet.dts if is_avi else packet.pts
            for packet in islice(container.demux(stream), _LOOK_PACKETS)
            if packet.size
        ]
        times = np.array([float(t * stream.time_base) for t in ticks if t is not None])
    # of pictures shown out of order, the last few lack some that come between
    n_sure = len(times) - _MAX_REORDERED if len(ticks) == _LOOK_PACKETS else len(times)
    return np.sort(times)[:n_sure]


def _usual_rate(rate_hz: float) -> float:
    for usual in (float(round(rate_hz)), round(rate_hz / _NTSC) * _NTSC):
        if usual > 0 and abs(rate_hz / usual - 1) < _SNAP:
            return usual
    return rate_hz


def _check_rates(infos: Mapping[str, VideoInfo], interval_s: Mapping[str, float]) -> None:
    rates = {name: _usual_rate(1 / s) for name, s in interval_s.items()}
    middle = float(np.median(list(rates.values())))
    odd = [name for name, rate in rates.items() if abs(rate / middle - 1) > _SAME_RATE]
    if not odd:
        return
    other = next((n for n in rates if n not in odd), next(n for n in rates if n != odd[0]))
    told = f"{odd[0]} says {rates[odd[0]]:.4g} frames/s, {other} {rates[other]:.4g}"
    counts = [info.n_frames for info in infos.values()]
    if all(counts) and max(counts) - min(counts) <= _SAME_COUNT * max(counts):  # type: ignore
        raise InputError(
            f"{told}, but both have about {counts[0]} frames: one file's frame rate is wrong; say "
            "the rate at which they were filmed (rate_hz)"
        )
    raise InputError(f"videos run at different rates: {told}: convert them to one rate first")


def _sound_note(name: str, path: Path, info: VideoInfo) -> str:
    """Said if the pictures last much longer or shorter than the sound beside them."""
    with open_container(path) as container:
        if not container.streams.audio:
            return ""
        stream = container.streams.audio[0]
        if stream.duration is None:
            return ""
        sound_s = float(stream.duration * stream.time_base)
    gap = abs(info.duration_s - sound_s)
    if not gap > max(_SOUND_DIFFERS * sound_s, _SOUND_DIFFERS_S):
        return ""
    meant = info.rate_hz * info.duration_s / sound_s if sound_s > 0 else np.nan
    return (
        f"{name}: pictures of {info.duration_s:.1f} s beside {sound_s:.1f} s of sound: if it was "
        f"filmed at {meant:.4g} frames/s, not at the {info.rate_hz:.4g} that the file says, say so "
        "(--rate)"
    )
