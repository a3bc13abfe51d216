"""An acoustic-tube voice: plane waves in a row of short cylinders from the glottis to the lips.

The tract is cut into sections as long as sound travels in one sample; where areas differ, waves
are scattered; at the lips a piston in a wall radiates; the nose is a side branch behind the velum.

References
----------
Kelly & Lochbaum, Speech synthesis, Proc. 4th ICA, 1962.
Flanagan, Speech Analysis, Synthesis and Perception, 2nd ed., 1972, section 3.3: the radiation load.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import resample_poly

from ..core.arrays import readonly
from .voice_source import FRAME_RATE_HZ, SOURCE_RATE_HZ, GlottalSource
from .voice_talkers import SOUND_MM_PER_S

#: Waves move one section a sample at this rate.
TUBE_RATE_HZ = 96_000
SECTION_MM = SOUND_MM_PER_S / TUBE_RATE_HZ
#: An area that counts as shut.
SHUT_MM2 = 3.0

#: Share of a wave that the (nearly) shut glottis sends back.
GLOTTIS_REFLECTION = 0.92
#: Damping of a wide section as the bandwidth that it alone would give; narrow ones damp more.
_WALL_LOSS_HZ = 25.0
_WALL_LOSS_AREA_MM2 = 300.0
_MAX_WALL_LOSS_HZ = 400.0
_MIN_AREA_MM2 = 0.5

_NOSE_MM = 110.0
_VELUM_AT = 0.5  # of the way to the lips
#: Areas along the nose, evenly spaced from behind the velum to the nostrils (our choice).
_NOSE_AREAS_MM2 = (150.0, 300.0, 450.0, 400.0, 250.0, 120.0)
_VELUM_AREA_MM2 = 120.0  # fully open
_NOSE_LOSS_HZ = 120.0  # hairy and wet
_STEPS_PER_AREA = 12  # samples for which areas stay the same

_MAX_BANDWIDTH_HZ = 1200.0  # what is broader is no resonance
_SEARCH_HZ = np.arange(60.0, 7000.0, 40.0)
_SEARCH_HALF_WIDTHS_HZ = (0.0, 80.0, 250.0)


@dataclass(frozen=True, eq=False)
class TubeSound:
    """Sound of a moving tube.

    Attributes
    ----------
    samples : (n,) float64
        At `SOURCE_RATE_HZ`, not yet scaled to [-1, 1].
    formants_hz, bandwidths_hz : (T, 4) float64, Hz
        Resonances of the tract from glottis to lips with the velum shut; NaN while it is closed.
    """

    samples: NDArray[np.float64]
    formants_hz: NDArray[np.float64]
    bandwidths_hz: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "samples", readonly(self.samples, (None,), "samples"))
        for name in ("formants_hz", "bandwidths_hz"):
            object.__setattr__(self, name, readonly(getattr(self, name), (None, 4), name))


def n_sections(tract_mm: float) -> int:
    """How many sections a tract of a length has: the nearest whole number."""
    return round(tract_mm / SECTION_MM)


def reflection_coefficients(areas_mm2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of pressure waves on their way to the lips, (..., N - 1) for (..., N) areas.

    ``r[k] = (A[k] - A[k + 1]) / (A[k] + A[k + 1])``.
    """
    return np.asarray(
        (areas_mm2[..., :-1] - areas_mm2[..., 1:]) / (areas_mm2[..., :-1] + areas_mm2[..., 1:])
    )


def tube_response(
    areas_mm2: NDArray[np.float64],
    frequency_hz: NDArray[np.float64],
    *,
    lossless: bool = False,
) -> NDArray[np.complex128]:
    """Flow at the lips for a wave of 1 from the glottis, at some frequencies, (F,) complex.

    Parameters
    ----------
    areas_mm2 : (N,) float, mm²
        From glottis to lips, one a section of `SECTION_MM`.
    lossless : bool
        No damping, a hard glottis and an ideally open end instead of radiation.
    """
    areas = np.maximum(np.asarray(areas_mm2, np.float64), _MIN_AREA_MM2)
    f = np.asarray(frequency_hz, np.complex128)
    d = _denominators(areas, f, lossless)
    z = np.exp(-2j * np.pi * f / TUBE_RATE_HZ)
    # the way from the glottis to the lips takes N samples, and each section damps
    gain = np.prod(1 + reflection_coefficients(areas)) * np.prod(_damping(areas, lossless))
    return np.asarray(
        areas[-1] * gain * z ** len(areas) * (1 - _lip_reflection(areas[-1], z, lossless)) / d
    )


def tube_formants(
    areas_mm2: NDArray[np.float64], count: int = 4, *, lossless: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The lowest resonances of a tube and their bandwidths, each (count,) float64, Hz.

    They are the poles of its own transfer function, lips' radiation, losses and sampling included;
    NaN where there are fewer below 7 kHz.
    """
    areas = np.maximum(np.asarray(areas_mm2, np.float64), _MIN_AREA_MM2)
    found = _poles(areas, _SEARCH_HZ, count, lossless)
    return found[:, 0], found[:, 1]


def tube_voice(
    areas_mm2: NDArray[np.float64],
    source: GlottalSource,
    frication: NDArray[np.float64],
    noise_section: NDArray[np.int64],
    velum: NDArray[np.float64],
    rng: np.random.Generator,
) -> TubeSound:
    """Blow a glottal source through a tube that moves.

    Parameters
    ----------
    areas_mm2 : (T, N) float, mm²
        One row a millisecond.
    source : GlottalSource
        As long as the areas.
    frication, velum : (T,) float
        Amplitude of the noise at the constriction; how open the nose is, 0 to 1.
    noise_section : (T,) int
        Where that noise arises.
    """
    up = TUBE_RATE_HZ // SOURCE_RATE_HZ
    noise = rng.standard_normal(len(source.pulses))
    areas = np.maximum(np.asarray(areas_mm2, np.float64), _MIN_AREA_MM2)
    nose = np.interp(
        np.linspace(0, len(_NOSE_AREAS_MM2) - 1, round(_NOSE_MM / SECTION_MM)),
        np.arange(len(_NOSE_AREAS_MM2)),
        _NOSE_AREAS_MM2,
    )
    raw = _run(
        areas,
        resample_poly(source.pulses + source.breath, up, 1),
        resample_poly(noise, up, 1),
        frication,
        noise_section,
        velum,
        nose,
        TUBE_RATE_HZ // FRAME_RATE_HZ,
    )
    formants, bandwidths = formant_tracks(areas)
    return TubeSound(resample_poly(raw, 1, up), formants, bandwidths)


def formant_tracks(
    areas_mm2: NDArray[np.float64], every: int = 5
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`tube_formants` of every 5th row of (T, N) areas, linear between; NaN while shut."""
    T = len(areas_mm2)
    rows = np.unique(np.append(np.arange(0, T, every), T - 1))
    found = np.stack([_poles(areas_mm2[i], _SEARCH_HZ, 4, False) for i in rows])
    found[areas_mm2[rows].min(axis=1) <= SHUT_MM2] = np.nan
    tracks = np.empty((T, 4, 2))
    for k in range(4):
        for j in range(2):
            tracks[:, k, j] = np.interp(np.arange(T), rows, found[:, k, j])
    tracks[areas_mm2.min(axis=1) <= SHUT_MM2] = np.nan
    return tracks[..., 0], tracks[..., 1]


@njit(cache=True, nogil=True)
def _damping(areas, lossless):  # type: ignore[no-untyped-def]
    """What a wave keeps of its height on its way through each section."""
    if lossless:
        return np.ones(len(areas))
    loss_hz = np.minimum(_WALL_LOSS_HZ * np.sqrt(_WALL_LOSS_AREA_MM2 / areas), _MAX_WALL_LOSS_HZ)
    return np.exp(-np.pi * loss_hz / TUBE_RATE_HZ)


@njit(cache=True, nogil=True)
def _radiation(area):  # type: ignore[no-untyped-def]
    """n0, n1, d0, d1 of the reflection (n0 + n1 z) / (d0 + d1 z) at an opening, z one sample.

    Flanagan's load, R parallel to L in units of the tube's own impedance, by the bilinear rule.
    """
    resistance = 128 / (9 * np.pi**2)
    radius = np.sqrt(area / np.pi)
    k = 2 * TUBE_RATE_HZ * 8 * radius / (3 * np.pi * SOUND_MM_PER_S)
    both, less = k * resistance, resistance
    return both - less - k, -both - less + k, both + less + k, -both + less - k


@njit(cache=True, nogil=True)
def _lip_reflection(area, z, lossless):  # type: ignore[no-untyped-def]
    if lossless:
        return -1 + 0 * z
    n0, n1, d0, d1 = _radiation(area)
    return (n0 + n1 * z) / (d0 + d1 * z)


@njit(cache=True, nogil=True)
def _denominator(areas, damping, frequency, lossless):  # type: ignore[no-untyped-def]
    """What the glottis must send per unit of wave at the lips; zero at the resonances.

    The delay to the lips and the junctions' gains are taken out: they are never zero.
    """
    z = np.exp(-2j * np.pi * frequency / TUBE_RATE_HZ)
    n = len(areas)
    f = 1.0 + 0j
    b = _lip_reflection(areas[-1], z, lossless)
    z2 = z * z
    b = b * z2 * damping[-1] ** 2
    for k in range(n - 2, -1, -1):
        r = (areas[k] - areas[k + 1]) / (areas[k] + areas[k + 1])
        f, b = f + r * b, (r * f + b) * z2 * damping[k] ** 2
    back = 1.0 if lossless else GLOTTIS_REFLECTION
    return f - back * b


@njit(cache=True, nogil=True)
def _denominators(areas, frequency, lossless):  # type: ignore[no-untyped-def]
    damping = _damping(areas, lossless)
    out = np.empty(len(frequency), np.complex128)
    for i in range(len(frequency)):
        out[i] = _denominator(areas, damping, frequency[i], lossless)
    return out


@njit(cache=True, nogil=True)
def _poles(areas, grid, count, lossless):  # type: ignore[no-untyped-def]
    """The first zeros of the denominator, (count, 2): frequency and bandwidth.

    Dips of its size are looked for along lines of three bandwidths, since a broad resonance beside
    a sharp one makes none at real frequencies, and refined by the secant rule.
    """
    damping = _damping(areas, lossless)
    found = np.empty((3 * len(grid), 2))
    n_found = 0
    for half_width in _SEARCH_HALF_WIDTHS_HZ:
        before2, before1 = np.inf, np.inf
        for i in range(len(grid)):
            f = grid[i] + 1j * half_width
            now = abs(_denominator(areas, damping, f, lossless))
            if before1 < before2 and before1 <= now:
                x = _refined(areas, damping, grid[i - 1] + 1j * half_width, lossless)
                is_sharp = -1e-6 < x.imag < _MAX_BANDWIDTH_HZ / 2
                is_new = is_sharp and x.real > 30
                for k in range(n_found):
                    is_new &= abs(found[k, 0] - x.real) + abs(found[k, 1] - 2 * x.imag) > 0.5
                if is_new:
                    found[n_found, 0], found[n_found, 1] = x.real, max(2 * x.imag, 0.0)
                    n_found += 1
            before2, before1 = before1, now
    out = np.full((count, 2), np.nan)
    order = np.argsort(found[:n_found, 0])[:count]
    for k in range(len(order)):
        out[k] = found[order[k]]
    return out


@njit(cache=True, nogil=True)
def _refined(areas, damping, start, lossless):  # type: ignore[no-untyped-def]
    """The zero of the denominator next to `start`, by the secant rule in the complex plane."""
    x0, x1 = start, start + 3 + 5j
    y0 = _denominator(areas, damping, x0, lossless)
    for _ in range(25):
        y1 = _denominator(areas, damping, x1, lossless)
        if abs(y1 - y0) < 1e-14:
            break
        x0, x1, y0 = x1, x1 - y1 * (x1 - x0) / (y1 - y0), y1
        if abs(x1 - x0) < 1e-8:
            break
    return x1


@njit(cache=True, nogil=True)
def _run(areas, drive, noise, frication, noise_section, velum, nose, per_frame):  # type: ignore[no-untyped-def]
    n_frames, n = areas.shape
    m = len(nose)
    at_velum = int(n * _VELUM_AT)
    f, b, nf, nb = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    g, h, ng, nh = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)  # the nose's
    r, area = np.zeros(n), np.zeros(n)
    nose_r = (nose[:-1] - nose[1:]) / (nose[:-1] + nose[1:])
    nose_keep = np.exp(-np.pi * _NOSE_LOSS_HZ / TUBE_RATE_HZ)
    e0, e1, q0, q1 = _radiation(nose[-1])
    lip_x = lip_y = tip_x = tip_y = 0.0
    out = np.empty(n_frames * per_frame)
    keep = np.ones(n)
    n0 = n1 = d0 = d1 = 1.0
    opening = loud = 0.0
    for i in range(n_frames * per_frame):
        if i % _STEPS_PER_AREA == 0:
            frame, part = i // per_frame, (i % per_frame) / per_frame
            following = min(frame + 1, n_frames - 1)
            for k in range(n):
                area[k] = areas[frame, k] + part * (areas[following, k] - areas[frame, k])
            for k in range(n - 1):
                r[k] = (area[k] - area[k + 1]) / (area[k] + area[k + 1])
            keep[:] = _damping(area, False)
            n0, n1, d0, d1 = _radiation(area[-1])
            opening = velum[frame] + part * (velum[following] - velum[frame])
            opening *= _VELUM_AREA_MM2
            loud = frication[frame] + part * (frication[following] - frication[frame])
            section = noise_section[frame]
        for k in range(n - 1):
            nf[k + 1] = ((1 + r[k]) * f[k] - r[k] * b[k + 1]) * keep[k + 1]
            nb[k] = (r[k] * f[k] + (1 - r[k]) * b[k + 1]) * keep[k]
        if opening > 0.01:  # three ways meet at the velum
            k = at_velum
            total = area[k] + area[k + 1] + opening
            p = 2 * (area[k] * f[k] + area[k + 1] * b[k + 1] + opening * h[0]) / total
            nf[k + 1] = (p - b[k + 1]) * keep[k + 1]
            nb[k] = (p - f[k]) * keep[k]
            ng[0] = (p - h[0]) * nose_keep
        else:
            ng[0] = h[0] * nose_keep
        for k in range(m - 1):
            ng[k + 1] = ((1 + nose_r[k]) * g[k] - nose_r[k] * h[k + 1]) * nose_keep
            nh[k] = (nose_r[k] * g[k] + (1 - nose_r[k]) * h[k + 1]) * nose_keep
        nf[0] = (GLOTTIS_REFLECTION * b[0] + drive[i]) * keep[0]
        lip_y = (n0 * f[-1] + n1 * lip_x - d1 * lip_y) / d0
        lip_x = f[-1]
        tip_y = (e0 * g[-1] + e1 * tip_x - q1 * tip_y) / q0
        tip_x = g[-1]
        nb[-1], nh[-1] = lip_y * keep[-1], tip_y * nose_keep
        nf[section] += loud * noise[i]
        out[i] = area[-1] * (lip_x - lip_y) + nose[-1] * (tip_x - tip_y)
        f, nf = nf, f
        b, nb = nb, b
        g, ng = ng, g
        h, nh = nh, h
    return out
