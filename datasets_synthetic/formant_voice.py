"""A source-filter voice: glottal pulses through a cascade of resonators, noise beside it.

References
----------
Klatt, Software for a cascade/parallel formant synthesizer, JASA 67(3), 1980.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .voice_phones import phone_kinds
from .voice_source import FRAME_RATE_HZ, SOURCE_RATE_HZ, GlottalSource
from .voice_talkers import Talker
from .voice_tracks import Timeline, VoiceTracks

_NASAL_POLE_HZ = 270.0
_NASAL_ZERO_HZ = 450.0
_NASAL_BW_HZ = 100.0
_TOP_HZ = 0.95 * SOURCE_RATE_HZ / 2
_NOISE_COLUMNS = 7  # frequency, bandwidth, amplitude, twice; unfiltered


def formant_voice(
    talker: Talker, tracks: VoiceTracks, source: GlottalSource, rng: np.random.Generator
) -> NDArray[np.float64]:
    """What the talker says, (n,) float64 at `SOURCE_RATE_HZ`, not yet scaled to [-1, 1].

    The formants that sound are exactly `tracks.formants_hz` with `tracks.bandwidths_hz` at each
    millisecond, linear between; above F4 there are fixed ones, c / 2L apart.
    """
    noise = rng.standard_normal(len(source.pulses))
    return np.asarray(
        _synthesise(
            source.pulses + source.breath,
            noise,
            tracks.formants_hz,
            tracks.bandwidths_hz,
            higher_formants(talker, tracks.formants_hz[:, 3].max()),
            tracks.velum,
            tracks.frication,
            noise_filters(talker, tracks),
            SOURCE_RATE_HZ // FRAME_RATE_HZ,
        ),
        dtype=np.float64,
    )


def higher_formants(talker: Talker, above_hz: float) -> NDArray[np.float64]:
    """Frequencies and bandwidths of the formants above the highest F4, (K, 2) Hz."""
    f = above_hz + talker.formant_spacing_hz * np.arange(1, 16)
    f = f[f < _TOP_HZ]
    return np.column_stack([f, 0.06 * f])  # bandwidths grow with frequency: 6 %


def noise_filters(talker: Talker, tracks: VoiceTracks) -> NDArray[np.float64]:
    """The colour of the noise at the constriction, (T, 7): that of the latest consonant.

    A velar burst sits on the second formant, wherever the neighbouring vowel puts it.
    """
    timeline: Timeline = tracks.timeline
    found = np.zeros((timeline.n_frames, _NOISE_COLUMNS))
    for i, p in enumerate(timeline.script.phones):
        kind = phone_kinds()[p.phone]
        if kind.frication == 0:
            continue
        start = timeline.edges_ms[i]
        f1, f2 = kind.noise1_hz * talker.scale, kind.noise2_hz * talker.scale
        if kind.place == "velar":
            f1 = tracks.formants_hz[timeline.release_ms[i], 1] * 1.05
        row = (f1, kind.noise1_bw, kind.noise1, f2, kind.noise2_bw, kind.noise2, kind.bypass)
        found[start:] = row
        found[start:, [0, 3]] = np.minimum(found[start:, [0, 3]], _TOP_HZ)
    return found


@njit(cache=True, nogil=True)
def _pole_pair(f, bw, rate):  # type: ignore[no-untyped-def]
    """y = a x + b y1 + c y2 with unit gain at 0 Hz (Klatt 1980, eqs. 1 and 2)."""
    c = -np.exp(-2 * np.pi * bw / rate)
    b = 2 * np.exp(-np.pi * bw / rate) * np.cos(2 * np.pi * f / rate)
    return 1 - b - c, b, c


@njit(cache=True, nogil=True)
def _synthesise(drive, noise, formants, bandwidths, higher, velum, frication, filters, per_frame):  # type: ignore[no-untyped-def]
    rate = per_frame * 1000.0
    n_frames, n_low = formants.shape
    n_poles = n_low + len(higher) + 1  # the last is the nasal one
    a, b, c = np.zeros(n_poles), np.zeros(n_poles), np.zeros(n_poles)
    y1, y2 = np.zeros(n_poles), np.zeros(n_poles)
    for k in range(len(higher)):
        a[n_low + k], b[n_low + k], c[n_low + k] = _pole_pair(higher[k, 0], higher[k, 1], rate)
    a[-1], b[-1], c[-1] = _pole_pair(_NASAL_POLE_HZ, _NASAL_BW_HZ, rate)
    x1 = x2 = 0.0  # of the nasal zero
    w1 = w2 = 0.0  # of the noise
    p1, p2 = np.zeros(2), np.zeros(2)
    out = np.empty(n_frames * per_frame)
    for frame in range(n_frames):
        following = min(frame + 1, n_frames - 1)
        for k in range(n_low):
            f = 0.5 * (formants[frame, k] + formants[following, k])
            bw = 0.5 * (bandwidths[frame, k] + bandwidths[following, k])
            a[k], b[k], c[k] = _pole_pair(f, bw, rate)
        zero = _NASAL_POLE_HZ + velum[frame] * (_NASAL_ZERO_HZ - _NASAL_POLE_HZ)
        za, zb, zc = _pole_pair(zero, _NASAL_BW_HZ, rate)
        for s in range(per_frame):
            i = frame * per_frame + s
            x = drive[i]
            v = (x - zb * x1 - zc * x2) / za
            x2, x1 = x1, x
            for k in range(n_poles - 1, -1, -1):  # the high ones first: they ring least
                y = a[k] * v + b[k] * y1[k] + c[k] * y2[k]
                y2[k], y1[k] = y1[k], y
                v = y
            part = s / per_frame
            loud = frication[frame] + part * (frication[following] - frication[frame])
            w = noise[i] * loud
            v += filters[frame, 6] * w
            for k in range(2):
                f, bw, gain = (
                    filters[frame, 3 * k],
                    filters[frame, 3 * k + 1],
                    filters[frame, 3 * k + 2],
                )
                if gain > 0:
                    _, fb, fc = _pole_pair(f, bw, rate)
                    # zeros at 0 Hz and at half the rate; unit gain at the peak
                    y = 0.5 * (1 + fc) * (w - w2) + fb * p1[k] + fc * p2[k]
                    p2[k], p1[k] = p1[k], y
                    v += gain * y
            w2, w1 = w1, w
            out[i] = v
    return out
