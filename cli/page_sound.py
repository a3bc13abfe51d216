"""Sound for a page: what a browser plays, and its picture."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np

from ..core.audio import Audio

#: The picture of a sound has this many columns a second: one a pixel at the widest zoom.
PEAKS_HZ = 250
#: More samples a second than any ear or browser asks for.
MAX_RATE_HZ = 48_000
_INT8_PEAK, _INT16_PEAK = 127, 32767


@dataclass(frozen=True, eq=False)
class PageSound:
    """A sound to hear, in step with the pictures: the page's clock follows it.

    Attributes
    ----------
    label : str
    audio : Audio
    start_s : float
        When on the page's time line it begins.
    is_in_video : bool
        It is the sound track of the page's first video, which plays it: only its picture is stored.
    """

    label: str
    audio: Audio
    start_s: float = 0.0
    is_in_video: bool = False


def flac_bytes(audio: Audio) -> bytes:
    """A .flac file of 16 bits: no loss that is heard, no shift in time, in all browsers."""
    import soundfile

    samples, rate_hz = audio.samples, audio.rate_hz
    if rate_hz > MAX_RATE_HZ:
        from scipy.signal import resample_poly

        step = int(np.gcd(rate_hz, MAX_RATE_HZ))
        samples = resample_poly(samples, MAX_RATE_HZ // step, rate_hz // step)
        rate_hz = MAX_RATE_HZ
    whole = np.clip(np.rint(samples * _INT16_PEAK), -_INT16_PEAK, _INT16_PEAK).astype(np.int16)
    out = io.BytesIO()
    soundfile.write(out, whole, rate_hz, format="FLAC", subtype="PCM_16")
    return out.getvalue()


def peak_bytes(audio: Audio) -> bytes:
    """Lowest and highest sample of every 1 / `PEAKS_HZ` s: pairs of int8, ±127 for ±1."""
    n = len(audio.samples)
    columns = int(np.ceil(n * PEAKS_HZ / audio.rate_hz))
    if not columns:
        return b""
    starts = np.minimum(np.arange(columns) * audio.rate_hz // PEAKS_HZ, n - 1)
    pairs = np.stack(
        [np.minimum.reduceat(audio.samples, starts), np.maximum.reduceat(audio.samples, starts)],
        axis=1,
    )
    return bytes(np.rint(pairs * _INT8_PEAK).astype(np.int8).tobytes())
