"""Smooth functions of the place to paint with: noise, steps and blobs."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .appearance_traits import Rgb

Floats = NDArray[np.float32]


def noise_at(places: Floats, wavelength_mm: float | Rgb, seed: int) -> Floats:
    """Smooth noise in about ±1 at (N, 3) places, mm; a wavelength for all axes or for each."""
    waves = np.broadcast_to(np.asarray(wavelength_mm, dtype=np.float32), (3,)).copy()
    found = np.empty(len(places), dtype=np.float32)
    half = len(places) // 2
    with ThreadPoolExecutor(2) as pool:  # numba's own threads may warn about what is installed
        parts = (slice(0, half), slice(half, None))
        jobs = [
            pool.submit(_fill_noise, places[part], waves, seed % 2**20, found[part])
            for part in parts
        ]
    for job in jobs:
        job.result()  # raises what went wrong in it
    return found


@njit(cache=True)
def _hashed(x, y, z, seed):  # type: ignore[no-untyped-def]
    """A number in [0, 1) for a lattice point."""
    h = np.uint32(x * 374761393 + y * 668265263 + z * 2147483647 + seed * 1274126177)
    h = np.uint32((h ^ (h >> np.uint32(13))) * np.uint32(1274126177))
    h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(2246822519))
    return np.float32(h ^ (h >> np.uint32(15))) * np.float32(2.3283064e-10)


@njit(cache=True, nogil=True)
def _fill_noise(places, wavelength, seed, found):  # type: ignore[no-untyped-def]
    """Smooth value noise in about ±1 at (N, 3) places; `wavelength` (3,) per axis."""
    for n in range(len(places)):
        x = places[n, 0] / wavelength[0] + 1000.0
        y = places[n, 1] / wavelength[1] + 1000.0
        z = places[n, 2] / wavelength[2] + 1000.0
        i, j, k = int(x), int(y), int(z)
        u, v, w = x - i, y - j, z - k
        u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
        total = 0.0
        for c in range(8):
            di, dj, dk = c & 1, (c >> 1) & 1, c >> 2
            share = (u if di else 1 - u) * (v if dj else 1 - v) * (w if dk else 1 - w)
            total += share * _hashed(i + di, j + dj, k + dk, seed)
        found[n] = (total - 0.5) * 3.0


def smooth_step(low: float, high: float, x: NDArray[Any]) -> NDArray[Any]:
    """0 below `low` to 1 above `high`, smoothly (either order)."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def blob(p: Floats, centre: Rgb, radius: float | Rgb, *, mirrored: bool = True) -> NDArray[Any]:
    """A Gaussian about a place and, unless not mirrored, its mirror image."""
    q = p.copy()
    if mirrored:
        q[:, 0] = np.abs(q[:, 0])
    d = (q - np.asarray(centre, np.float32)) / np.asarray(radius, np.float32)
    return np.asarray(np.exp(-(d * d).sum(axis=1)))
