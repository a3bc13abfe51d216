"""A T-shirt or a jumper: the trunk's own surface, smoothed, pushed out, creased, cut and hemmed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..core.mesh import vertex_normals
from .mesh_cut import cut_surface, hemmed, without_unused
from .srgb import linear_from_srgb

Floats = NDArray[np.float64]

_CLOTH_MM = 5.0  # between skin and shirt
COLLAR_MM, COLLAR_FRONT_MM = 9.0, 14.0  # below the head's edge: behind, and more in front
SLEEVE_MM = 165.0  # a T-shirt's, from the shoulder joint
_RIB_MM, _RIB_WIDE_MM = 1.1, 13.0  # the collar's band stands out
_CREASE_MM = 2.2
_SMOOTHING_STEPS = 14


def make_shirt(
    body: Floats,
    triangles: NDArray[np.int32],
    neighbours: sparse.csr_matrix,
    *,
    below_mm: Floats,
    arm_mm: Floats,
    neck: Floats,
    short: bool,
    seed: int,
) -> tuple[Floats, NDArray[np.int32]]:
    """Dress a trunk.

    Parameters
    ----------
    body : (V, 3) float, mm
    triangles : (F, 3) int32
    neighbours : (V, V) sparse
        The mean of each vertex's neighbours.
    below_mm : (V,) float
        Distance from the edge of the neck.
    arm_mm : (V,) float
        How far down the arm, from the shoulder joint.
    neck : (L, 3) float, mm
        The edge itself.
    short : bool
        Short sleeves.
    seed : int
        Of the creases.

    Returns
    -------
    (V', 3) float64, mm, and (F', 3) int32
    """
    v = body.copy()
    free = smooth_step((below_mm - 15) / 50)[:, None]
    for _ in range(_SMOOTHING_STEPS):
        v += 0.6 * free * (neighbours @ v - v)
    normals = vertex_normals(v, triangles)
    out = _CLOTH_MM + 3 * smooth_step((below_mm - 40) / 120) + _creases(v, seed) * free[:, 0]
    off = body - neck.mean(axis=0)
    front = np.clip(off[:, 2] / (np.linalg.norm(off, axis=1) + 1e-9), 0, 1)
    from_collar = below_mm - COLLAR_MM - COLLAR_FRONT_MM * front
    out = out + _RIB_MM * smooth_step((_RIB_WIDE_MM - from_collar) / 4)
    v = v + out[:, None] * normals
    cut = cut_surface(v, triangles, from_collar, arm_mm)
    loops = [*cut.loops]
    if short:
        cut = cut_surface(cut.vertices, cut.triangles, SLEEVE_MM - cut.values, cut.values)
        loops += cut.loops
    v, triangles = cut.vertices, cut.triangles
    for loop in loops:
        v, triangles = hemmed(v, triangles, loop)
    return without_unused(v, triangles)


def _creases(v: Floats, seed: int) -> Floats:
    """Soft creases of cloth, mm: ridged waves that bend about each other."""
    rng = np.random.default_rng([seed, 71])
    found = np.zeros(len(v))
    for scale, share in ((150.0, 1.0), (80.0, 0.7), (45.0, 0.35)):
        for _ in range(3):
            k = rng.normal(size=3) * (1.0, 0.7, 1.0) / scale * 4
            bend = rng.normal(size=3) / scale * 2
            wave = np.sin(v @ k + 1.5 * np.sin(v @ bend + rng.uniform(0, 7)) + rng.uniform(0, 7))
            found += share * (1 - np.abs(wave)) ** 2
    return np.asarray(_CREASE_MM * (found / 2.2 - 0.6))


def cloth_colour(v: Floats, shirt: tuple[float, float, float], seed: int) -> Floats:
    """Of a shirt's vertices, (V, 3) linear, a little uneven."""
    rng = np.random.default_rng([seed, 72])
    base = linear_from_srgb(np.array(shirt, dtype=np.float64)).astype(np.float64)
    uneven = 1 + 0.015 * rng.normal(size=len(v))
    return np.asarray(np.clip(base * uneven[:, None], 0.004, 0.95))


def smooth_step(s: Floats) -> Floats:
    """0 below 0, 1 above 1, 3 s² − 2 s³ between."""
    s = np.clip(s, 0, 1)
    return np.asarray(s * s * (3 - 2 * s))
