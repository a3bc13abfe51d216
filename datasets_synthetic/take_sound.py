"""What the cameras hear: voice and claps through the air, each camera on its own clock."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import NDArray

from ..core.audio import Audio
from .clocks import CameraClock

RATE_HZ = 48000
SPEED_OF_SOUND_MM_PER_S = 343_000.0
REFERENCE_MM = 750.0  # at this distance a source is as loud as it was made
_CLAP_S = 0.06
_CLAP_LEVEL = 0.6
_ROOM_NOISE = 3e-4
_HALF_TAPS = 24
_BLOCK = 1 << 16


@dataclass(frozen=True)
class Clap:
    """A hand clap: when it sounds, world time, and the seed of its noise."""

    time_s: float
    seed: int


class Source:
    """Sound in the world as it leaves its place, sample by sample at `RATE_HZ` from time 0.

    Parameters
    ----------
    place : (3,) float64, mm, world frame
    samples : function from (first, last) sample to (last − first,) float
    """

    def __init__(
        self,
        place: NDArray[np.float64],
        samples: Callable[[int, int], NDArray[np.float64]],
    ) -> None:
        self.place = np.asarray(place, dtype=np.float64)
        self.samples = samples

    def delay_s(self, listener: NDArray[np.float64]) -> float:
        """How long sound travels to a place."""
        return float(np.linalg.norm(listener - self.place)) / SPEED_OF_SOUND_MM_PER_S


def clap_source(place: NDArray[np.float64], claps: tuple[Clap, ...]) -> Source:
    """Claps: noise with a sharp start that dies away in some milliseconds.

    A clap starts exactly at its time rounded to a sample.
    """
    sounds = [(round(c.time_s * RATE_HZ), _clap(c.seed)) for c in claps]

    def samples(first: int, last: int) -> NDArray[np.float64]:
        found = np.zeros(last - first)
        for start, sound in sounds:
            low, high = max(first, start), min(last, start + len(sound))
            if low < high:
                found[low - first : high - first] += sound[low - start : high - start]
        return found

    return Source(place, samples)


def _clap(seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    t = np.arange(round(_CLAP_S * RATE_HZ)) / RATE_HZ
    noise = rng.standard_normal(len(t))
    early = noise * np.exp(-t / 0.0025)
    room = np.roll(noise, 311) * np.exp(-t / 0.018) * 0.12 * (t > 0.004)
    sound = early + room
    return np.asarray(_CLAP_LEVEL * sound / np.abs(sound).max())


def scene_source(
    place: NDArray[np.float64], sound_of: Callable[[int], Audio | None], scene_s: float
) -> Source:
    """The sound of scenes, one after another, each starting with its scene."""
    kept: OrderedDict[int, NDArray[np.float64]] = OrderedDict()
    per_scene = round(scene_s * RATE_HZ)

    def scene(k: int) -> NDArray[np.float64]:
        if k not in kept:
            kept[k] = _at_rate(sound_of(k))[:per_scene]
            if len(kept) > 2:
                kept.popitem(last=False)
        return kept[k]

    def samples(first: int, last: int) -> NDArray[np.float64]:
        found = np.zeros(last - first)
        for k in range(max(0, first // per_scene), max(0, (last - 1) // per_scene) + 1):
            start = k * per_scene
            sound = scene(k)
            low, high = max(first, start), min(last, start + len(sound))
            if low < high:
                found[low - first : high - first] = sound[low - start : high - start]
        return found

    return Source(place, samples)


def _at_rate(sound: Audio | None) -> NDArray[np.float64]:
    if sound is None:
        return np.zeros(0)
    from scipy.signal import resample_poly

    common = gcd(RATE_HZ, sound.rate_hz)
    return np.asarray(
        resample_poly(sound.samples.astype(float), RATE_HZ // common, sound.rate_hz // common)
    )


class HeardSound:
    """What one microphone records, computed piece by piece as it is asked for.

    Sample n is taken at n / `rate_hz` on the microphone's clock. Sound arrives after its way
    through the air, weaker with distance; between the sources' samples it follows a windowed
    sinc.

    Attributes
    ----------
    rate_hz : int
    """

    rate_hz = RATE_HZ

    def __init__(
        self,
        sources: tuple[Source, ...],
        place: NDArray[np.float64],
        clock: CameraClock,
        *,
        seconds: float,
        noise_seed: int,
        noise: float = _ROOM_NOISE,
    ) -> None:
        self._sources = [
            (s, s.delay_s(place), REFERENCE_MM / max(1.0, float(np.linalg.norm(place - s.place))))
            for s in sources
        ]
        self._clock = clock
        self._n = round(seconds * RATE_HZ)
        self._noise, self._noise_seed = noise, noise_seed

    @property
    def samples(self) -> HeardSound:
        """Itself: sliced, it gives samples."""
        return self

    def __len__(self) -> int:
        return self._n

    def __getitem__(self, wanted: slice) -> NDArray[np.float32]:
        first, last, step = wanted.indices(self._n)
        if step != 1:
            raise ValueError("sound is read in one piece after another")
        time_s = np.asarray(self._clock.world_s(np.arange(first, last) / RATE_HZ))
        found = self._hiss(first, last)
        for source, delay_s, gain in self._sources:
            if last > first:
                found += gain * _interpolated(source, (time_s - delay_s) * RATE_HZ)
        return np.clip(found, -1, 1).astype(np.float32)

    def _hiss(self, first: int, last: int) -> NDArray[np.float64]:
        """Noise that does not depend on the pieces it is read in."""
        found = np.zeros(last - first)
        if not self._noise or last <= first:
            return found
        for block in range(first // _BLOCK, (last - 1) // _BLOCK + 1):
            rng = np.random.default_rng([self._noise_seed, block])
            hiss = rng.standard_normal(_BLOCK)
            low, high = max(first, block * _BLOCK), min(last, (block + 1) * _BLOCK)
            found[low - first : high - first] = hiss[low - block * _BLOCK : high - block * _BLOCK]
        return found * self._noise


def _interpolated(source: Source, place: NDArray[np.float64]) -> NDArray[np.float64]:
    """A source between its samples: sinc under a Hann window of 2 × 24 samples."""
    base = np.floor(place).astype(np.int64)
    first, last = int(base[0]) - _HALF_TAPS, int(base[-1]) + _HALF_TAPS + 2
    sound = source.samples(first, last)
    if not sound.any():
        return np.zeros(len(place))
    found = np.zeros(len(place))
    off = place - base
    for k in range(-_HALF_TAPS + 1, _HALF_TAPS + 1):
        x = off - k
        window = 0.5 + 0.5 * np.cos(np.pi * x / _HALF_TAPS)
        found += np.sinc(x) * window * sound[base + k - first]
    return found


def record(sources: tuple[Source, ...], seconds: float) -> HeardSound:
    """The studio's own recording: next to the sources, on the world's clock, without noise."""
    place = np.mean([s.place for s in sources], axis=0)
    near = tuple(Source(place, s.samples) for s in sources)
    return _Studio(near, place, CameraClock(), seconds=seconds, noise_seed=0, noise=0.0)


class _Studio(HeardSound):
    """No distance, no delay."""

    def __getitem__(self, wanted: slice) -> NDArray[np.float32]:
        first, last, _ = wanted.indices(len(self))
        found = sum((s.samples(first, last) for s, *_ in self._sources), np.zeros(last - first))
        return np.clip(found, -1, 1).astype(np.float32)
