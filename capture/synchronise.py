"""Offset and drift between recordings, from what they both heard or saw.

The model of a clock is that of the files: a moment at ``t`` on the reference's time line is at
``offset + (1 + drift) t`` on the other's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from ..core.audio import Audio
from ..core.errors import InputError
from .clock_fit import ClockFit
from .flashes import Flash, find_flash, find_flashes
from .motion_clock import synchronise_motion

__all__ = [
    "ClockFit", "Recording", "find_flash", "find_flashes", "synchronise",
    "synchronise_flash_light", "synchronise_flashes", "synchronise_motion", "synchronise_sound",
]  # fmt: skip

Floats = NDArray[np.float64]
#: Sound; or flashes; or times (T,) in s with signals (T, K) or the brightness of frames (T,).
Recording = Audio | Flash | Sequence[Flash] | tuple[ArrayLike, ArrayLike]
METHODS = ("sound", "motion", "flash", "light")
_WINDOW_S = 2.0
_RATE_HZ = 16_000
_MIN_PEAK = 6.0  # of a piece's correlation, in standard deviations of its rest
_MIN_WHOLE_PEAK = 9.0  # of the whole: unrelated noise reaches 7 among a million offsets
#: Pieces that hold the same clap err alike: no fit through them is surer than a peak's place.
_PEAK_S = 0.1 / _RATE_HZ
_MAX_DRIFT = 1e-3
_AGREE_S = 1.5e-3


def synchronise(
    reference: Recording,
    other: Recording,
    *,
    method: str | None = None,
    max_offset_s: float | None = None,
    exposure_s: float = 0.0,
) -> ClockFit:
    """How one recording's time runs against another's, from whatever both hold.

    Parameters
    ----------
    reference, other : Recording
        Both of one kind: two `Audio`, two sequences of `Flash`, or two pairs of times (T,) in s
        and signals. Signals (T, K) are a motion, brightness (T,) is one number a frame.
    method : str, optional
        ``"sound"`` (of `Audio`), ``"motion"`` (of signals), ``"flash"`` (when flashes began) or
        ``"light"`` (how far they have died away: surer, where one flash lights all that both
        see). By default sound for `Audio`, motion for signals (T, K), flash for the rest.
    max_offset_s : float, s, optional
        How far apart they may have started; by default 5 for a motion and 30 for the rest.
    exposure_s : float, s
        Of frames whose brightness is given.

    Returns
    -------
    ClockFit

    Raises
    ------
    InputError
        If they tell no offset; the message says why.
    ValueError
        If the two are not of one kind, or not of a kind that the method takes.

    See Also
    --------
    synchronise_sound, synchronise_motion, synchronise_by_flashes : with all their options.
    """
    kinds = [_kind(x) for x in (reference, other)]
    if kinds[0] != kinds[1]:
        raise ValueError(f"both recordings must be of one kind, got {kinds[0]} and {kinds[1]}")
    usual = {"sound": "sound", "signals": "motion"}.get(kinds[0], "flash")
    chosen = usual if method is None else method
    if chosen not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, not {chosen}")
    takes = {"sound": ("sound",), "motion": ("signals", "brightness")}
    if kinds[0] not in takes.get(chosen, ("flashes", "brightness")):
        raise ValueError(f"{kinds[0]} cannot be synchronised by {chosen}")
    most_s = max_offset_s if max_offset_s is not None else 5.0 if chosen == "motion" else 30.0
    if isinstance(reference, Audio) and isinstance(other, Audio):
        return synchronise_sound(reference, other, max_offset_s=most_s)
    if chosen == "motion":
        (ta, a), (tb, b) = _timed(reference), _timed(other)
        return synchronise_motion(ta, a, tb, b, max_offset_s=most_s)
    from .flash_match import synchronise_by_flashes  # which stands upon this module

    seen = [_flashes(x, exposure_s) for x in (reference, other)]
    return synchronise_by_flashes(*seen, max_offset_s=most_s, by_light=chosen == "light")


def _kind(recording: Recording) -> str:
    if isinstance(recording, Audio):
        return "sound"
    if isinstance(recording, Flash):
        return "flashes"
    if len(recording) and all(isinstance(x, Flash) for x in recording):
        return "flashes"
    times, values = (np.asarray(x) for x in _timed(recording))
    if times.ndim != 1 or values.ndim not in (1, 2) or len(values) != len(times):
        raise ValueError(
            "expected times (T,) and signals (T, K) or brightness (T,), "
            f"got {times.shape} and {values.shape}"
        )
    return "signals" if values.ndim == 2 else "brightness"


def _timed(recording: Recording) -> tuple[ArrayLike, ArrayLike]:
    if isinstance(recording, tuple) and len(recording) == 2:
        times, values = recording
        if not isinstance(times, Flash) and not isinstance(values, Flash):
            return times, values
    raise ValueError(
        "a recording is Audio, a Flash, a sequence of Flash, or a pair of times and signals"
    )


def _flashes(recording: Recording, exposure_s: float) -> tuple[Flash, ...]:
    if isinstance(recording, Flash):
        return (recording,)
    if not isinstance(recording, Audio):
        flashes = tuple(x for x in recording if isinstance(x, Flash))
        if flashes:
            return flashes
    times, brightness = _timed(recording)
    return find_flashes(times, brightness, exposure_s)


def synchronise_sound(
    reference: Audio,
    other: Audio,
    *,
    max_offset_s: float = 30.0,
    reference_delay_s: float = 0.0,
    other_delay_s: float = 0.0,
) -> ClockFit:
    """From sound that both recorded: claps, speech, anything that is not one steady tone.

    A first offset comes from the whole of both; then pieces of 2 s are compared around it by
    generalised cross-correlation with phase transform, and a line is laid through the offsets
    that agree.

    Parameters
    ----------
    reference, other : Audio
        Each from time 0 of its recording.
    max_offset_s : float
        How far apart they may have started.
    reference_delay_s, other_delay_s : float
        How long sound took to each microphone, where known (2.9 ms a metre).

    Raises
    ------
    InputError
        If one is silent, or they have no sound in common.

    References
    ----------
    Knapp & Carter 1976 (PHAT).
    """
    a, b = (_conditioned(x) for x in (reference, other))
    for name, x in (("reference", a), ("other", b)):
        if not np.abs(x).max() > 0:
            raise InputError(f"the {name} recording is silent")
    coarse, peak = _lag(a, b, round(max_offset_s * _RATE_HZ))
    if peak < _MIN_WHOLE_PEAK:
        raise InputError("the recordings have no sound in common within the largest offset")
    times, lags = _piecewise(a, b, coarse)
    if not len(times):
        times, lags = np.array([len(a) / 2 / _RATE_HZ]), np.array([coarse / _RATE_HZ])
    lags = lags - other_delay_s + reference_delay_s
    return _line(times, lags, "sound")


def synchronise_flashes(
    reference_s: Sequence[float],
    other_s: Sequence[float],
    *,
    reference_sd_s: Sequence[float] | None = None,
    other_sd_s: Sequence[float] | None = None,
) -> ClockFit:
    """From the times of flashes (or other single moments) that both recorded, in order.

    With standard deviations (of `find_flashes`) the surer flashes count for more, and the stated
    standard deviation follows from them.

    Raises
    ------
    InputError
        If there are none, or they are not as many.
    """
    a, b = np.asarray(reference_s, dtype=float), np.asarray(other_s, dtype=float)
    if len(a) != len(b) or not len(a):
        raise InputError(f"expected the same flashes in both, found {len(a)} and {len(b)}")
    sd = np.full(len(a), np.nan)
    if reference_sd_s is not None and other_sd_s is not None:
        sd = np.hypot(np.asarray(reference_sd_s), np.asarray(other_sd_s))
    if len(a) == 1:
        return ClockFit(float(b[0] - a[0]), 0.0, float(sd[0]), float("inf"), 1, 1, "flash")
    if np.isnan(sd).any():
        return _line(a, b - a, "flash")
    return _weighted_line(a, b - a, np.maximum(sd, 1e-9))


def synchronise_flash_light(
    reference: Flash, other: Flash, *, same_within: float = 0.02
) -> ClockFit:
    """From one flash that lit what both cameras see in the same proportion to the light before.

    Where a flash began while a camera's shutter was closed, its own frames do not tell when. But
    how far its light has died away by each camera's next frame tells how much later one looked
    than the other. That needs a flash that brightens both pictures alike: one that lights the
    whole room, seen by cameras with their black level taken off.

    Parameters
    ----------
    reference, other : Flash
        Of the same flash, from `find_flashes`.
    same_within : float
        Standard deviation of the ratio of the flash's strengths in the two pictures.

    Raises
    ------
    InputError
        If no beginning, decay and strength suit both.
    """
    decay = np.geomspace(
        max(reference.decay_s[0], other.decay_s[0]), min(reference.decay_s[-1], other.decay_s[-1]),
        31,
    )  # fmt: skip
    if not decay[0] <= decay[-1] * 1.0000001:
        raise InputError("the two cameras saw the flash die away differently: not the same flash?")
    weight = np.zeros((len(reference.start_s), len(other.start_s)))
    (misfit_a, log_a, var_a), (misfit_b, log_b, var_b) = (
        _at_decays(flash, decay) for flash in (reference, other)
    )
    for d in range(len(decay)):
        variance = var_a[:, d, None] + var_b[None, :, d] + same_within**2
        apart = (log_a[:, d, None] - log_b[None, :, d]) ** 2 / variance
        whole = misfit_a[:, d, None] + misfit_b[None, :, d] + apart + np.log(variance)
        weight += np.exp(-whole / 2)
    if not weight.sum() > 0:
        raise InputError("the flash is not equally strong in both: use the times alone")
    weight /= weight.sum()
    lag = other.start_s[None, :] - reference.start_s[:, None]
    offset = float((weight * lag).sum())
    cells = [float(np.diff(f.start_s[:2])[0]) for f in (reference, other)]
    variance_s = float((weight * (lag - offset) ** 2).sum()) + float(np.square(cells).sum()) / 12
    return ClockFit(offset, 0.0, float(np.sqrt(variance_s)), float("inf"), 1, 1, "flash light")


def _at_decays(flash: Flash, decay: Floats) -> tuple[Floats, Floats, Floats]:
    """Misfit, logarithm of the strength and its variance, at other decays, each (S, D)."""

    def at(values: Floats) -> Floats:
        rows = [np.interp(np.log(decay), np.log(flash.decay_s), row) for row in values]
        return np.array(rows)

    strength = np.maximum(flash.strength, 1e-9)
    return at(flash.misfit), at(np.log(strength)), at((flash.strength_sd / strength) ** 2)


def _weighted_line(times: Floats, lags: Floats, sd: Floats) -> ClockFit:
    """Offset, and drift where it is better than not, through lags of known uncertainty."""
    w = 1 / sd**2
    middle = float((w * times).sum() / w.sum())
    level = float((w * lags).sum() / w.sum())
    spread = float((w * (times - middle) ** 2).sum())
    slope = float((w * (times - middle) * lags).sum()) / spread
    slope_sd = 1 / np.sqrt(spread)
    if abs(slope) > _MAX_DRIFT or slope_sd > _MAX_DRIFT / 10:  # they say nothing of the drift
        slope, slope_sd = 0.0, np.inf
    return ClockFit(
        level - slope * middle, slope, float(1 / np.sqrt(w.sum())), float(slope_sd),
        len(times), len(times), "flash",
    )  # fmt: skip


def _conditioned(sound: Audio) -> Floats:
    """At 16 kHz, without what lies below 80 Hz."""
    from scipy.signal import butter, resample_poly, sosfiltfilt

    x = sound.samples.astype(np.float64)
    if sound.rate_hz != _RATE_HZ:
        common = int(np.gcd(_RATE_HZ, sound.rate_hz))
        x = resample_poly(x, _RATE_HZ // common, sound.rate_hz // common)
    if len(x) < 64:
        raise InputError("a recording is too short to compare")
    return np.asarray(sosfiltfilt(butter(2, 80, "highpass", fs=_RATE_HZ, output="sos"), x))


def _lag(a: Floats, b: Floats, most: int) -> tuple[float, float]:
    """Samples by which b lies after a, and how far the peak stands out, in deviations."""
    n = fft.next_fast_len(len(a) + len(b))
    cross = fft.rfft(b, n) * np.conj(fft.rfft(a, n))
    size = np.abs(cross)
    # phase transform, where there is sound at all
    cross /= size + 1e-3 * size.max() + 1e-300
    r = fft.irfft(cross, n)
    reach = min(most, len(b) - 1), min(most, len(a) - 1)
    window = np.concatenate([r[: reach[0] + 1], r[n - reach[1] :]])
    lags = np.concatenate([np.arange(reach[0] + 1), np.arange(-reach[1], 0)])
    order = np.argsort(lags)
    window, lags = window[order], lags[order]
    i = int(np.argmax(window))
    rest = 1.4826 * float(np.median(np.abs(window - np.median(window)))) + 1e-300
    return float(lags[i]) + _peak_offset(window, i), float(window[i]) / rest


def _peak_offset(r: Floats, i: int) -> float:
    """Sub-sample place of a peak by a parabola."""
    if not 0 < i < len(r) - 1:
        return 0.0
    d = r[i - 1] - 2 * r[i] + r[i + 1]
    return float(0.5 * (r[i - 1] - r[i + 1]) / d) if d < 0 else 0.0


def _piecewise(a: Floats, b: Floats, coarse: float) -> tuple[Floats, Floats]:
    """Middles of pieces of a, s, and how much later each is in b, s; only where it is sure."""
    n = round(_WINDOW_S * _RATE_HZ)
    loud = float(np.sqrt((a**2).mean()))
    times, lags = [], []
    step = max(n // 2, (len(a) - n) // 400 or 1)
    for start in range(0, max(len(a) - n // 2, 1), step):
        piece = a[start : start + n]
        slack = round(0.01 * _RATE_HZ + _MAX_DRIFT * abs(start - len(a) / 2))
        first = start + round(coarse)
        low, high = max(0, first - slack), min(len(b), first + len(piece) + slack)
        if high - low < len(piece) // 2 or np.sqrt((piece**2).mean()) < 0.1 * loud:
            continue
        lag, peak = _lag(piece, b[low:high], len(piece))
        if peak < _MIN_PEAK:
            continue
        weight_at = start + float((np.arange(len(piece)) * piece**2).sum() / (piece**2).sum())
        times.append(weight_at / _RATE_HZ)
        lags.append((lag + low - start) / _RATE_HZ)
    return np.array(times), np.array(lags)


def _line(times: Floats, lags: Floats, method: str) -> ClockFit:
    """Offset and drift through the lags that agree."""
    n = len(times)
    slope, used = 0.0, np.abs(lags - np.median(lags)) <= _AGREE_S + _MAX_DRIFT * np.ptp(times)
    if n >= 3:
        i, j = np.triu_indices(n, 1)
        apart = times[j] - times[i]
        far = apart > 0.3 * np.ptp(times)
        slope = float(np.median((lags[j] - lags[i])[far] / apart[far])) if far.any() else 0.0
        level = float(np.median(lags - slope * times))
        used = np.abs(lags - slope * times - level) <= _AGREE_S
    t, y = times[used], lags[used]
    if len(t) < 2 or np.ptp(t) == 0:
        level = float(np.median(y)) if len(y) else float(np.median(lags))
        return ClockFit(level, 0.0, float("nan"), float("inf"), max(len(t), 1), n, method)
    middle = t.mean()
    A = np.column_stack([np.ones(len(t)), t - middle])
    (level, slope), *_ = np.linalg.lstsq(A, y, rcond=None)
    off = y - A @ [level, slope]
    variance = float((off**2).sum()) / max(len(t) - 2, 1)
    covariance = np.linalg.inv(A.T @ A) * variance
    return ClockFit(
        float(level - slope * middle), float(slope),
        float(np.hypot(np.sqrt(covariance[0, 0]), _PEAK_S if method == "sound" else 0.0)),
        float(np.sqrt(covariance[1, 1])), len(t), n, method,
    )  # fmt: skip
