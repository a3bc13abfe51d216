"""From light to numbers: what a sensor makes of a picture."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .optics import Sensor

_BITS = 16  # of a random number; 2^16 equally likely values stand for the normal distribution
_LOWEST = -0.25  # of saturation: noise goes below no light
_STEPS = 65536  # of the curve, from _LOWEST to 1


def develop(
    light: NDArray[np.float32], sensor: Sensor, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """The numbers of a picture.

    ``level = black + (255 - black) (gain · light + noise)^(1 / gamma)``, clipped to 0..255. Noise
    is normal with the variance of shot and read noise, independent in every number: with s =
    gain · light, the variance of s is s / full_well + (read_noise / full_well)².
    (That shot noise is Poisson's shows only below some 20 electrons.)

    Parameters
    ----------
    light : (h, w) or (h, w, 3) float32, linear
    sensor : Sensor
    rng : numpy Generator
        One number is drawn from it; none is if the sensor has no noise.

    Returns
    -------
    uint8, shaped as `light`
    """
    values = np.ascontiguousarray(light, dtype=np.float32)
    shot = np.float32(1 / sensor.full_well_e)
    # without full well there is no scale of electrons, and no noise
    read = np.float32((sensor.read_noise_e / sensor.full_well_e) ** 2)
    out = np.empty(values.shape, np.uint8)
    rows, numbers = values.reshape(len(values), -1), out.reshape(len(values), -1)
    gain = np.float32(sensor.gain)
    noisy = bool(shot > 0 or read > 0)
    seed = np.uint64(rng.integers(2**63)) if noisy else np.uint64(0)
    if sensor.gamma == 1:
        black = np.float32(sensor.black_level)
        _develop_linear(rows, numbers, gain, shot, read, noisy, seed, _normal_table(), black)
    else:
        curve = _curve(sensor.gamma, sensor.black_level)
        _develop_curved(rows, numbers, gain, shot, read, noisy, seed, _normal_table(), curve)
    return out


@lru_cache(maxsize=1)
def _normal_table() -> NDArray[np.float32]:
    """Middles of equally likely slices of the normal distribution, of variance 1."""
    from scipy.special import ndtri

    z = ndtri((np.arange(2**_BITS) + 0.5) / 2**_BITS)
    table = np.asarray(z / np.sqrt((z**2).mean()), dtype=np.float32)
    table.flags.writeable = False
    return table


@lru_cache(maxsize=8)
def _curve(gamma: float, black: float) -> NDArray[np.uint8]:
    """Numbers of `_STEPS` amounts of light; below none, the curve is mirrored."""
    s = _LOWEST + (1 - _LOWEST) * (np.arange(_STEPS) / (_STEPS - 1))
    level = black + (255 - black) * np.sign(s) * np.abs(s) ** (1 / gamma)
    table = np.clip(np.rint(level), 0, 255).astype(np.uint8)
    table.flags.writeable = False
    return table


@njit(cache=True, nogil=True, inline="always")
def _mixed(z):  # type: ignore[no-untyped-def]
    """Steele, Lea & Flood 2014: the output function of SplitMix64."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(cache=True, nogil=True, inline="always")
def _fill(noise, state, normal):  # type: ignore[no-untyped-def]
    """A row of standard normal numbers, four from each state; returns the last state."""
    mask = np.uint64(0xFFFF)
    for x in range(0, len(noise) - 4, 4):
        state += np.uint64(0x9E3779B97F4A7C15)
        bits = _mixed(state)
        noise[x] = normal[bits & mask]
        noise[x + 1] = normal[(bits >> np.uint64(16)) & mask]
        noise[x + 2] = normal[(bits >> np.uint64(32)) & mask]
        noise[x + 3] = normal[bits >> np.uint64(48)]
    return state


@njit(cache=True, nogil=True)
def _develop_linear(  # type: ignore[no-untyped-def]
    light, out, gain, shot, read, noisy, seed, normal, black
):
    h, w = light.shape
    span = np.float32(255) - black
    base = black + np.float32(0.5)
    top = np.float32(255)
    state = seed
    noise = np.zeros(w + 4, np.float32)
    for y in range(h):
        if noisy:
            state = _fill(noise, state, normal)
        for x in range(w):
            s = gain * light[y, x]
            s = max(s, np.float32(0))
            s += np.sqrt(shot * s + read) * noise[x]
            level = min(max(base + span * s, np.float32(0)), top)
            out[y, x] = np.uint8(level)


@njit(cache=True, nogil=True)
def _develop_curved(  # type: ignore[no-untyped-def]
    light, out, gain, shot, read, noisy, seed, normal, curve
):
    h, w = light.shape
    scale = np.float32((_STEPS - 1) / (1 - _LOWEST))
    base = np.float32(-_LOWEST * (_STEPS - 1) / (1 - _LOWEST) + 0.5)
    last = np.float32(_STEPS - 1)
    state = seed
    noise = np.zeros(w + 4, np.float32)
    for y in range(h):
        if noisy:
            state = _fill(noise, state, normal)
        for x in range(w):
            s = gain * light[y, x]
            s = max(s, np.float32(0))
            s += np.sqrt(shot * s + read) * noise[x]
            out[y, x] = curve[int(min(max(base + scale * s, np.float32(0)), last))]
