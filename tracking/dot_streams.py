"""The dots of all cameras, instant by instant, while videos are decoded.

Each camera is decoded and searched in a thread of its own, a bounded number of frames ahead.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Event

import numpy as np

from ..core.errors import InputError
from ..core.video import Frame, read_frames
from .blobs import Blobs, BlobSettings, find_blobs
from .tracker import FrameDots
from .video_clocks import Beat, VideoClocks

_QUEUE = 32  # frames a camera may run ahead; memory stays constant in the length of the take


@dataclass(frozen=True, eq=False)
class _Dots:
    beat: int
    stamp_s: float
    blobs: Blobs


@dataclass(eq=False)
class _Reel:
    """One camera's dots as they come."""

    name: str
    queue: Queue[_Dots | None]
    job: Future[None]
    head: _Dots | None = None
    ended: bool = False

    def fill(self) -> None:
        """Have the next dots at hand, unless there are none."""
        if self.head is None and not self.ended:
            self.head = _get(self.queue, self.job)
            if self.head is None:
                self.ended = True
                self.job.result()  # raises what broke the search

    def take(self, beat: int) -> tuple[Blobs | None, float]:
        """The dots of a beat and their frame's stamp; None and NaN if the camera lost it."""
        if self.head is None or self.head.beat != beat:
            return None, np.nan
        found, self.head = self.head, None
        return found.blobs, found.stamp_s


def stream_dots(
    paths: Mapping[str, Path],
    clocks: VideoClocks,
    settings: Mapping[str, BlobSettings],
    *,
    first_beat: int = 0,
    starts: Mapping[str, tuple[int, float]] | None = None,
) -> Generator[FrameDots, None, None]:
    """The dots of every instant from a beat on, until fewer than two cameras go on.

    A camera that lost a frame, or has ended, has no dots then.

    Parameters
    ----------
    paths : mapping from camera to Path
        In the order of the rig.
    clocks : VideoClocks
    settings : mapping from camera to BlobSettings
    first_beat : int
        Where to begin.
    starts : mapping from camera to (beat, stamp), optional
        For each camera a beat before that, and the stamp of its frame: what lies before is not
        decoded. By default all is, from the first frame.

    Raises
    ------
    FileFormatError, OSError, InputError
        Where a file is broken, or has more spots than a marker take can have.
    """
    with ExitStack() as stack:
        stop = Event()
        pool = stack.enter_context(ThreadPoolExecutor(len(paths)))
        stack.callback(stop.set)
        reels = []
        for name, path in paths.items():
            queue: Queue[_Dots | None] = Queue(_QUEUE)
            start = (starts or {}).get(name, (0, 0.0))
            beat = Beat(str(path), clocks.interval_s[name], start)
            job = pool.submit(
                _search, path, beat, start[1], settings[name], first_beat, queue, stop
            )
            reels.append(_Reel(name, queue, job))
        yield from _in_step(reels, clocks.rate_hz, first_beat)


def _in_step(
    reels: list[_Reel], rate_hz: float, first_beat: int
) -> Generator[FrameDots, None, None]:
    nothing = (np.zeros((0, 2)), np.zeros(0))
    beat = first_beat
    while True:
        for reel in reels:
            reel.fill()
        if sum(not reel.ended for reel in reels) < 2:
            return
        found = [reel.take(beat) for reel in reels]
        yield FrameDots(
            beat / rate_hz,
            tuple(nothing[0] if b is None else b.centres for b, _ in found),
            tuple(nothing[1] if b is None else b.sd_px for b, _ in found),
            tuple(stamp_s for _, stamp_s in found),
        )
        beat += 1


def _search(
    path: Path,
    beat: Beat,
    from_s: float,
    settings: BlobSettings,
    first_beat: int,
    queue: Queue[_Dots | None],
    stop: Event,
) -> None:
    """Decode one video and put its dots into the queue; None at the end or after an error."""
    try:
        gray = not settings.needs_colour
        with closing(read_frames(path, gray=gray, threads=1, from_s=from_s)) as frames:
            for frame in frames:
                number = beat.number(frame.time_s)
                if number < first_beat:
                    continue
                blobs = _blobs_of(path, frame, number, settings)
                if not _put(queue, _Dots(number, frame.time_s, blobs), stop):
                    return
    finally:
        _put(queue, None, stop)


def _blobs_of(path: Path, frame: Frame, number: int, settings: BlobSettings) -> Blobs:
    try:
        return find_blobs(frame.image, settings)
    except InputError as error:
        raise InputError(f"{path}, frame {number}: {error}") from error


def _put(queue: Queue[_Dots | None], item: _Dots | None, stop: Event) -> bool:
    while not stop.is_set():
        try:
            queue.put(item, timeout=0.1)
        except Full:
            continue
        return True
    return False


def _get(queue: Queue[_Dots | None], job: Future[None]) -> _Dots | None:
    """The next item; None too if the job died without a word."""
    while True:
        try:
            return queue.get(timeout=0.2)
        except Empty:
            if job.done() and queue.empty():
                return None
