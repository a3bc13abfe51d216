"""Frame rates: exact ones, clips brought to them, and sound that stays in step.

A clip's time 0 is where its sound begins. Nothing here is filtered: a clip brought to a lower rate
keeps what it shows at the frames' times.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..core.audio import Audio
from ..core.clip import HELD_PREFIXES, Clip
from ..core.errors import InputError

Floats = NDArray[np.float64]

#: Rates of film and television as people write them, and what they are exactly (SMPTE ST 12-1).
NTSC_RATES = {
    "23.976": Fraction(24000, 1001),
    "23.98": Fraction(24000, 1001),
    "29.97": Fraction(30000, 1001),
    "59.94": Fraction(60000, 1001),
    "119.88": Fraction(120000, 1001),
}
#: What `--fps` names first; any whole number up to `MAX_RATE` is taken.
USUAL_RATES = ("24", "25", "29.97", "30", "50", "59.94", "60")
MAX_RATE = 1000
#: No clip has more frames than this after resampling: a day at 60 a second.
MAX_FRAMES = 24 * 3600 * 60
#: Times of one rate may be off by this share of a frame: stamps are rounded to 1 ms or 1/90000 s.
_SAME = 1e-3
_SAME_S = 1.1e-3


def parse_rate(text: str) -> Fraction:
    """Frames a second, exactly: ``"25"``, ``"29.97"`` (30000/1001), ``"30000/1001"``.

    Raises
    ------
    InputError
        If it is no rate from 1 to 1000.

    Examples
    --------
    >>> parse_rate("29.97")
    Fraction(30000, 1001)
    """
    word = text.strip()
    if word in NTSC_RATES:
        return NTSC_RATES[word]
    if re.fullmatch(r"\d{1,4}(\.0*)?", word) or re.fullmatch(r"\d{1,6}/[1-9]\d{0,5}", word):
        rate = Fraction(word.rstrip("."))
        if 1 <= rate <= MAX_RATE:
            return rate
    raise InputError(
        f"{text} frames a second: expected one of {', '.join(USUAL_RATES)}, another whole number "
        f"from 1 to {MAX_RATE}, or a ratio like 30000/1001"
    )


def exact_rate(rate_hz: float) -> Fraction:
    """The usual rate that a measured one means: whole, or a whole one times 1000/1001."""
    for rate in (Fraction(round(rate_hz)), *NTSC_RATES.values()):
        if rate and abs(rate_hz - float(rate)) < 1e-4 * rate_hz:
            return rate
    return Fraction(rate_hz).limit_denominator(1001)


def rate_text(rate: Fraction) -> str:
    """As people write it: ``25``, ``29.97``, ``12.5``."""
    named = next((name for name, exact in NTSC_RATES.items() if exact == rate), None)
    return named or f"{float(rate):g}"


def frame_times(start_s: float, end_s: float, rate: Fraction) -> Floats:
    """Times of frames, (T,) s: frame k at start + k / rate, to the last that is not after the end.

    Each is rounded once: a thousandth of a frame is given for the rounding of the end.

    Raises
    ------
    InputError
        If there were more than `MAX_FRAMES`.
    """
    count = int(np.floor((end_s - start_s) * float(rate) + _SAME)) + 1
    if count > MAX_FRAMES:
        raise InputError(
            f"{end_s - start_s:.0f} s at {rate_text(rate)} frames a second are {count} frames, more"
            f" than {MAX_FRAMES}: cut the clip"
        )
    return np.asarray(
        start_s + np.arange(max(count, 1), dtype=np.float64) * rate.denominator / rate.numerator
    )


@dataclass(frozen=True, eq=False)
class ResampledClip:
    """A clip at a fixed rate, and how it came there.

    Attributes
    ----------
    clip : Clip
    rate : Fraction, frames a second
    interpolated : tuple of str
        Channels, of those that are ever set, that are linear between the keys.
    held : tuple of str
        Those that keep each key's value until the next: the fields of FAPs 1 and 2.
    """

    clip: Clip
    rate: Fraction
    interpolated: tuple[str, ...]
    held: tuple[str, ...]

    @property
    def is_changed(self) -> bool:
        """False where the clip had this rate, or nothing is set."""
        return bool(self.interpolated or self.held)

    def text(self) -> str:
        """What was done, in words; empty where nothing was."""
        if not self.is_changed:
            return ""
        done = []
        if self.interpolated:
            done.append(f"{len(self.interpolated)} channels linear between keys")
        if self.held:
            done.append(f"{len(self.held)} of FAPs 1 and 2 held")
        frames = len(self.clip.time_s)
        return f"resampled to {frames} frames, {rate_text(self.rate)}/s: " + ", ".join(done)


def resample_clip(clip: Clip, rate: Fraction) -> ResampledClip:
    """A clip at a fixed rate, from its own first frame on.

    Channels are linear between keys; those of FAPs 1 and 2 (what is selected, and how much of it)
    are held. What the nearest frame does not set stays not set. A clip that has this rate comes
    back with its times made exact and its values untouched.

    Raises
    ------
    InputError
        If the clip is empty, or would have too many frames.
    """
    if not len(clip.time_s):
        raise InputError("the clip has no frames")
    start_s, end_s = float(clip.time_s[0]), float(clip.time_s[-1])
    times = frame_times(start_s, end_s, rate)
    if _is_at(clip.time_s, times, rate):
        return ResampledClip(Clip(times, clip.channels, clip.values), rate, (), ())
    found = clip.resample(np.minimum(times, end_s))
    assert clip.is_set is not None
    values = np.where(clip.is_set[_nearest(clip.time_s, times)], found.values, np.nan)
    used = [c for c in clip.channels if not np.isnan(clip[c]).all()]
    held = tuple(c for c in used if c.startswith(HELD_PREFIXES))
    others = tuple(c for c in used if c not in held)
    return ResampledClip(Clip(times, clip.channels, values), rate, others, held)


def _is_at(old_s: Floats, new_s: Floats, rate: Fraction) -> bool:
    if len(old_s) != len(new_s):
        return False
    allowed_s = max(_SAME / float(rate), _SAME_S if rate < 120 else 0.0)
    return bool(np.abs(old_s - new_s).max() <= allowed_s)


def _nearest(keys_s: Floats, times_s: Floats) -> NDArray[np.intp]:
    """Index of the key nearest in time to each time."""
    after = np.clip(np.searchsorted(keys_s, times_s), 1, max(len(keys_s) - 1, 1))
    if len(keys_s) == 1:
        return np.zeros(len(times_s), dtype=np.intp)
    nearer_before = times_s - keys_s[after - 1] <= keys_s[after] - times_s
    return np.where(nearer_before, after - 1, after)


@dataclass(frozen=True, eq=False)
class FittedSound:
    """Sound that starts with a clip's first frame.

    Attributes
    ----------
    audio : Audio
    notes : tuple of str
        What was cut, added or held, in words.
    hold_s : float, s
        How long the sound goes on after the clip's last frame; 0 if it does not.
    """

    audio: Audio
    notes: tuple[str, ...]
    hold_s: float


def fit_sound(audio: Audio, start_s: float, end_s: float) -> FittedSound:
    """Sound as heard from a clip's first frame on; the clip's time 0 is where the sound begins.

    Parameters
    ----------
    audio : Audio
    start_s, end_s : float, s
        The clip's first and last time. What is heard before the start is cut off; before a start
        below 0 comes silence. Sound that ends before the clip does is followed by silence, whose
        samples are not stored.

    Raises
    ------
    InputError
        If the sound ends before the clip begins.
    """
    notes = []
    samples = audio.samples
    shift = round(start_s * audio.rate_hz)
    if shift >= len(samples):
        raise InputError(
            f"the sound lasts {audio.duration_s:.3f} s, and the clip begins only at {start_s:.3f} s"
        )
    if shift > 0:
        samples = samples[shift:]
        notes.append(f"the clip begins at {start_s:.3f} s: so does the sound")
    elif shift < 0:
        samples = np.concatenate([np.zeros(-shift, np.float32), samples])
        notes.append(f"the clip begins {-start_s:.3f} s before the sound: silence till then")
    left_s = len(samples) / audio.rate_hz - (end_s - start_s)
    if left_s > _SAME_S:
        notes.append(f"the sound goes on {left_s:.3f} s after the clip: the last pose is held")
    elif left_s < -_SAME_S:
        notes.append(f"the sound ends {-left_s:.3f} s before the clip: silence from then on")
    return FittedSound(Audio(samples, audio.rate_hz), tuple(notes), max(left_s, 0.0))
