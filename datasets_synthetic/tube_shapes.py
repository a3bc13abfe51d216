"""What shapes the tube: area functions of vowels, constrictions of consonants.

No measured area functions are used. A vowel's is the flattest one, written as a short cosine
series of its logarithm (after Schroeder 1967 and Mermelstein 1967), whose own resonances are the
talker's formants; it is found by least squares. Where and how narrow consonants constrict the
tract is our choice within what textbooks give.

References
----------
Schroeder, Determination of the geometry of the human vocal tract by acoustic measurements, JASA
41(4), 1967.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares

from .tube_voice import n_sections, tube_formants
from .voice_phones import PhoneKind, phone_kinds
from .voice_talkers import MEASURED_AT, Talker
from .voice_tracks import Timeline, vowel_keys

_N_COSINES = 10
_USUAL_AREA_MM2 = 300.0
_LOG_RANGE = 1.7  # areas of vowels stay within the usual one times or by exp(1.7): 55 to 1640 mm²
_FORMANT_SD = np.array([0.003, 0.003, 0.005, 0.08])  # relative; how closely each is matched
_FLATNESS_SD = 0.35
_BROAD = 0.1  # bandwidth over frequency beyond which a formant is hardly one
_FALLBACK_FORMANT_HZ = 7000.0  # of a resonance that a trial shape lacks

#: Constrictions of a place: centre and half-width as shares of the way to the lips.
_AT = {
    "labial": ((1.0, 0.035),),
    "labiodental": ((0.98, 0.03),),
    "dental": ((0.94, 0.035),),
    "alveolar": ((0.87, 0.04),),
    "postalveolar": ((0.81, 0.05),),
    "palatal": ((0.74, 0.12),),
    "velar": ((0.63, 0.06),),
    "labiovelar": ((1.0, 0.06), (0.62, 0.1)),
    "rhotic": ((0.77, 0.07), (0.3, 0.1), (1.0, 0.06)),
    "lateral": ((0.87, 0.05),),
}
#: How narrow, mm², by place for glides and by manner for the others.
_GLIDE_MM2 = {
    "palatal": (70.0,),
    "labiovelar": (45.0, 90.0),
    "rhotic": (55.0, 110.0, 140.0),
    "lateral": (60.0,),
}
_CLOSED_MM2 = 0.5
_FRICATIVE_MM2 = 14.0
_MOVE_MS = 45  # a constriction comes and goes in this time


def vowel_areas(formants_hz: NDArray[np.float64], tract_mm: float) -> NDArray[np.float64]:
    """An area function whose resonances are given formants, (N,) float64, mm².

    Parameters
    ----------
    formants_hz : (4,) float, Hz
        F4 is matched only roughly: it says more about the larynx than about the vowel.
    tract_mm : float
        Length from glottis to lips.
    """
    key = tuple(round(float(f), 3) for f in formants_hz)
    return _fitted(key, n_sections(tract_mm))


@lru_cache(maxsize=4096)
def _fitted(formants_hz: tuple[float, ...], n: int) -> NDArray[np.float64]:
    at = (np.arange(n) + 0.5) / n
    basis = np.cos(np.pi * np.outer(np.arange(1, _N_COSINES + 1), at))
    target = np.log(formants_hz)
    effort = np.arange(1, _N_COSINES + 1) ** 0.5 / _FLATNESS_SD

    def shape(a: NDArray[np.float64]) -> NDArray[np.float64]:
        bent = _LOG_RANGE * np.tanh(a @ basis / _LOG_RANGE)
        return np.asarray(_USUAL_AREA_MM2 * np.exp(bent))

    def misfit(a: NDArray[np.float64]) -> NDArray[np.float64]:
        f, bandwidth = tube_formants(shape(a))
        is_there = np.isfinite(f)
        f = np.where(is_there, f, _FALLBACK_FORMANT_HZ)
        broad = np.where(is_there, np.maximum(bandwidth / f - _BROAD, 0), 0.2) / _BROAD
        return np.concatenate([(np.log(f) - target) / _FORMANT_SD, a * effort * 0.1, broad])

    found = least_squares(misfit, np.zeros(_N_COSINES), method="lm", ftol=1e-6, xtol=1e-5)
    areas = shape(found.x)
    areas.flags.writeable = False
    return areas


def area_tracks(talker: Talker, timeline: Timeline) -> NDArray[np.float64]:
    """The talker's tract at each millisecond of a timeline, (T, N) float64, mm²."""
    logs = _vowel_logs(talker, timeline)
    n = logs.shape[1]
    at = (np.arange(n) + 0.5) / n
    for i, p in enumerate(timeline.script.phones):
        kind = phone_kinds()[p.phone]
        start, end = (int(e) for e in timeline.edges_ms[i : i + 2])
        release = int(timeline.release_ms[i])
        if kind.manner == "affricate":
            _constrict(logs, at, kind, (_CLOSED_MM2,), start, release, opens_ms=6)
            _constrict(logs, at, kind, (_FRICATIVE_MM2,), release, end)
        elif kind.place in _AT:
            narrow, opens_ms = _narrowness(kind)
            _constrict(logs, at, kind, narrow, start, release, opens_ms=opens_ms)
    return np.exp(logs)


def noise_sections(timeline: Timeline, n: int) -> NDArray[np.int64]:
    """Just before which section noise arises at each millisecond, (T,): at the latest consonant."""
    found = np.full(timeline.n_frames, n - 1, np.int64)
    for i, p in enumerate(timeline.script.phones):
        kind = phone_kinds()[p.phone]
        if kind.frication > 0:
            centre, width = _AT[kind.place][0]
            found[timeline.edges_ms[i] :] = min(round((centre + width) * n), n - 1)
    return found


def _narrowness(kind: PhoneKind) -> tuple[tuple[float, ...], int]:
    """Areas of a consonant's constrictions, mm², and how fast they open, ms."""
    if kind.manner == "glide":
        return _GLIDE_MM2[kind.place], _MOVE_MS
    if kind.manner == "fricative":
        return (_FRICATIVE_MM2,), _MOVE_MS
    return (_CLOSED_MM2,), 25


def _vowel_logs(talker: Talker, timeline: Timeline) -> NDArray[np.float64]:
    """Logarithms of the areas as if there were vowels alone, (T, N)."""
    times, keys = [], []
    for i, p in enumerate(timeline.script.phones):
        if phone_kinds()[p.phone].is_vowel:
            start, end = timeline.edges_ms[i : i + 2]
            times += [start + a * (end - start) for a in MEASURED_AT]
            keys += [np.log(vowel_areas(f, talker.tract_mm)) for f in vowel_keys(talker, p.phone)]
    frames = np.arange(timeline.n_frames)
    if not keys:  # consonants alone: about the neutral tube
        flat = np.full(n_sections(talker.tract_mm), np.log(_USUAL_AREA_MM2))
        return np.tile(flat, (len(frames), 1))
    return np.asarray(
        PchipInterpolator(times, np.array(keys))(np.clip(frames, times[0], times[-1]))
    )


def _constrict(
    logs: NDArray[np.float64],
    at: NDArray[np.float64],
    kind: PhoneKind,
    areas_mm2: tuple[float, ...],
    start: int,
    end: int,
    *,
    opens_ms: int = _MOVE_MS,
) -> None:
    """Narrow some rows of `logs` in place; fully so from `start` to `end`, ms."""
    frames = np.arange(len(logs))
    coming = np.clip(1 - (start - frames) / _MOVE_MS, 0, 1)
    going = np.clip(1 - (frames - end + 1) / opens_ms, 0, 1)
    amount = np.minimum(coming, going)
    amount = amount**2 * (3 - 2 * amount)
    rows = np.flatnonzero(amount > 0)
    for (centre, width), area in zip(_AT[kind.place], areas_mm2, strict=True):
        near = np.exp(-0.5 * (np.maximum(np.abs(at - centre) - width / 2, 0) / width) ** 2)
        pull = amount[rows, None] * near
        narrowed = (1 - pull) * logs[rows] + pull * np.log(area)
        logs[rows] = np.minimum(logs[rows], narrowed)
