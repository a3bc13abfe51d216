"""When a camera exposes its frames: its own clock against the world's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class CameraClock:
    """A clock that starts late or early, and runs slow or fast.

    ``world = offset + (1 + drift) · clock``: the camera's own time is 0 at its first frame.

    Attributes
    ----------
    offset_s : float, s
        World time of the camera's first frame.
    drift : float
        1e-5 is 10 ppm: the camera's second is that much longer than the world's.
    """

    offset_s: float = 0.0
    drift: float = 0.0

    def world_s(self, clock_s: float | NDArray[np.float64]) -> float | NDArray[np.float64]:
        """World time of a time on this clock."""
        return self.offset_s + (1 + self.drift) * clock_s

    def clock_s(self, world_s: float | NDArray[np.float64]) -> float | NDArray[np.float64]:
        """This clock's time at a world time."""
        return (world_s - self.offset_s) / (1 + self.drift)


@dataclass(frozen=True, eq=False)
class FrameTimes:
    """The frames that a camera's file holds.

    Attributes
    ----------
    frame : (F,) int64
        Count of each on the camera's own regular beat; a dropped frame is missing from it.
    clock_s : (F,) float64, s
        Exposure (middle of the middle row) on the camera's clock.
    world_s : (F,) float64, s
        The same on the world's.
    stamp_s : (F,) float64, s
        What the file says.
    """

    frame: NDArray[np.int64]
    clock_s: NDArray[np.float64]
    world_s: NDArray[np.float64]
    stamp_s: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.frame)


def frame_times(
    rng: np.random.Generator,
    clock: CameraClock,
    *,
    seconds: float,
    rate_hz: float,
    dropped: float = 0.0,
    jitter: float = 0.0,
    stamps_tell: bool = True,
) -> FrameTimes:
    """When a camera's frames are taken.

    Parameters
    ----------
    rng : numpy Generator
    clock : CameraClock
    seconds, rate_hz : float
        Length and beat.
    dropped : float
        Share of the frames, never the first, that the camera loses.
    jitter : float
        Uniform irregularity of the beat, in frames (variable frame rate): 0.3 is ± 0.3 frames.
    stamps_tell : bool
        False writes regular time stamps whatever was lost, as many recorders do.
    """
    n = round(seconds * rate_hz)
    lost = rng.random(n) < dropped
    off = jitter * rng.uniform(-1, 1, size=n)
    lost[0], off[0] = False, 0.0
    kept = np.flatnonzero(~lost)
    clock_s = (kept + off[kept]) / rate_hz
    stamp_s = clock_s if stamps_tell else np.arange(len(kept)) / rate_hz
    return FrameTimes(kept, clock_s, np.asarray(clock.world_s(clock_s)), stamp_s)
