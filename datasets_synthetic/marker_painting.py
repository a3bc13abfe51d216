"""Markers painted into a picture: exact shares of pixels, and tiles where a part is hidden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.camera import Camera
from .coverage import paint_polygons, polygon_moments
from .discs import Course, Discs, exposure_instants, join_courses, pictured, pixels_of, rim
from .lens_light import kept_light, kept_light_slope
from .mesh_pictures import SeenMesh, hidden_places, mesh_over_boxes
from .optics import Optics
from .shots import Shot

Floats = NDArray[np.float64]

_STEP_PX = 0.4  # of a marker's way between two instants of an exposure
_LEAST_INSTANTS, _MOST_INSTANTS = 6, 48
# a marker's tiles: rings and sectors of its disc, and how it is probed before it is cut to tiles
_RINGS, _SECTORS = 8, 32
_UNSEEN, _WHOLE, _PARTLY = 0, 1, 2
_PROBE_RADII, _PROBE_COUNTS = (0.0, 0.55, 0.98), (1, 8, 14)


@dataclass(frozen=True, eq=False)
class Shining:
    """What shines, in one camera's frame.

    Attributes
    ----------
    discs : Discs, M of them
    light : (M,) float64
        Linear, in this camera.
    tolerance_mm : (M,) float64
        What of the actor lies less than this before one does not hide it.
    """

    discs: Discs
    light: Floats
    tolerance_mm: Floats


def join_shining(parts: list[Shining]) -> Shining:
    """Several, one after another; none for an empty list."""
    if not parts:
        none = Course.still(np.zeros((0, 3)))
        return Shining(Discs(none, none, np.zeros(0), np.zeros(0, bool)), np.zeros(0), np.zeros(0))
    discs = [part.discs for part in parts]
    return Shining(
        Discs(
            join_courses([d.centres for d in discs]),
            join_courses([d.normals for d in discs]),
            np.concatenate([d.radius_mm for d in discs]),
            np.concatenate([d.is_sphere for d in discs]),
        ),
        np.concatenate([part.light for part in parts]),
        np.concatenate([part.tolerance_mm for part in parts]),
    )


def paint_shining(
    level: NDArray[np.float32],
    bare: NDArray[np.float32],
    shot: Shot,
    shining: Shining,
    meshes: list[SeenMesh],
) -> tuple[Floats, Floats]:
    """Paint what shines.

    Parameters
    ----------
    level : (h, w) float32
        Changed.
    bare : (h, w) float32
        The picture without markers.
    shot : Shot
    shining : Shining
    meshes : list of SeenMesh
        What may hide it: the shot's, in the middle of the rows' exposure.

    Returns
    -------
    (M, 2) float64, px
        Centroids of the pictures if nothing hid them; NaN for what cannot be seen whole.
    (M,) float64
        Shares that are unhidden and inside.
    """
    discs, optics = shining.discs, shot.optics
    outlines, visible = np.full((len(discs), 2), np.nan), np.zeros(len(discs))
    instants = exposure_instants(optics.exposure_s, _instants(shot, discs))
    polygons, _ = pictured(shot.camera, optics, discs, rim(), instants)
    whole = np.isfinite(polygons).all(axis=(1, 2, 3)) & (discs.facing() > 0)
    which = np.flatnonzero(whole)
    if not len(which):
        return outlines, visible
    hiding = [(mesh, shining.tolerance_mm * float(mesh.is_closed)) for mesh in meshes]
    shown = _Shown(shot, discs, polygons, instants, hiding, _near(discs, polygons, which))
    looks = _looks(shown, which)
    free = np.ones_like(bare)
    distance = np.linalg.norm(discs.centres.middle[which], axis=1)
    for i in np.argsort(distance, kind="stable"):
        m, look = which[i], looks[i]
        moments = polygon_moments(polygons[m])
        depth = float(discs.centres.middle[m, 2])
        defocus_px = optics.blur_diameter_px(depth, shot.camera.focal_px)
        outlines[m] = _centroid(moments, optics, shot.camera, defocus_px)
        if look == _UNSEEN:
            continue
        pieces, weights = polygons[m], np.ones(len(instants))
        if look == _PARTLY:
            pieces, weights = _unhidden(shown, int(m))
        painted = paint_polygons(
            level, bare, free, pieces, weights / len(instants), shining.light[m],
            psf_px=optics.psf_px, defocus_px=defocus_px,
        )  # fmt: skip
        visible[m] = min(painted / moments[0], 1.0) if look == _PARTLY else 1.0
    return outlines, visible


@dataclass(frozen=True, eq=False)
class _Shown:
    """Markers in the picture: outlines (M, N, P, 2) px at the instants, and what may hide them."""

    shot: Shot
    discs: Discs
    polygons: Floats
    instants: Floats
    hiding: list[tuple[SeenMesh, Floats]]
    near: dict[int, list[int]]


def _instants(shot: Shot, discs: Discs) -> int:
    """Instants of the exposure that leave no gaps in the streak of the fastest marker."""
    exposure_s = shot.optics.exposure_s
    if exposure_s == 0 or discs.centres.is_still or not len(discs):
        return 1
    ends = [pixels_of(shot.camera, discs.centres.at(s * exposure_s)) for s in (-0.5, 0, 0.5)]
    way = np.linalg.norm(ends[1] - ends[0], axis=1) + np.linalg.norm(ends[2] - ends[1], axis=1)
    longest = float(np.nanmax(way)) if np.isfinite(way).any() else 0.0
    return int(np.clip(np.ceil(longest / _STEP_PX), _LEAST_INSTANTS, _MOST_INSTANTS))


def _centroid(moments: Floats, optics: Optics, camera: Camera, defocus_px: float) -> Floats:
    """Centroid of a marker's light: vignetting pulls it to where more light is kept."""
    centre = moments[1:3]
    if not optics.vignetting:
        return np.asarray(centre)
    # variance of the pixel's square, the lens's blur and the circle of confusion
    blur = 1 / 12 + optics.psf_px**2 + defocus_px**2 / 16
    spread = np.array([[moments[3] + blur, moments[4]], [moments[4], moments[5] + blur]])
    slope = kept_light_slope(optics, camera, centre)
    return np.asarray(centre + spread @ slope / kept_light(optics, camera, centre))


def _near(discs: Discs, polygons: Floats, which: NDArray[np.int64]) -> dict[int, list[int]]:
    """Markers that may hide each marker: nearer ones whose pictures' boxes overlap its own."""
    low, high = polygons[which].min(axis=(1, 2)), polygons[which].max(axis=(1, 2))
    overlap = ((low[:, None] < high[None]) & (low[None] < high[:, None])).all(axis=2)
    np.fill_diagonal(overlap, False)
    depth = np.linalg.norm(discs.centres.middle[which], axis=1)
    found: dict[int, list[int]] = {}
    for i, j in zip(*np.nonzero(overlap & (depth[:, None] > depth[None])), strict=True):
        found.setdefault(int(which[i]), []).append(int(which[j]))
    return found


def _probe_spots() -> Floats:
    spots = []
    for radius, count in zip(_PROBE_RADII, _PROBE_COUNTS, strict=True):
        angle = 2 * np.pi * (np.arange(count) + 0.5) / count
        spots.append(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(spots)


def _looks(shown: _Shown, which: NDArray[np.int64]) -> list[int]:
    """Whether each marker is unseen, whole, or hidden in part as far as probes tell."""
    shot, spots = shown.shot, _probe_spots()
    pixels, points = pictured(shot.camera, shot.optics, shown.discs.rows(which), spots, np.zeros(1))
    each = [(mesh, np.repeat(tolerance[which], len(spots))) for mesh, tolerance in shown.hiding]
    hidden = hidden_places(each, pixels.reshape(-1, 2), points[..., 2].ravel())
    share = hidden.reshape(len(which), -1).mean(axis=1)
    low, high = shown.polygons[which].min(axis=(1, 2)), shown.polygons[which].max(axis=(1, 2))
    end = np.array(shot.camera.image_size) - 0.5
    inside = ((low > -0.5) & (high < end)).all(axis=1)
    outside = ((high < -0.5) | (low > end)).any(axis=1)
    doubtful = ~inside | np.array([m in shown.near for m in which])
    for mesh, _ in shown.hiding:
        if not mesh.is_closed:  # thin things slip between the probes
            doubtful |= mesh_over_boxes(mesh, low, high)
    looks = np.where((share == 0) & ~doubtful, _WHOLE, _PARTLY)
    return [int(x) for x in np.where((share == 1) | outside, _UNSEEN, looks)]


def _unhidden(shown: _Shown, m: int) -> tuple[Floats, Floats]:
    """What is unhidden of a marker: polygons (K, P, 2) px of all instants; their shares (K,).

    The whole outline where nothing is hidden, else the tiles into which its disc is cut.
    """
    shot, instants = shown.shot, shown.instants
    one = shown.discs.rows(np.array([m]))
    spots = np.concatenate([r * rim(_SECTORS) for r in np.linspace(0, 1, _RINGS + 1)])
    corners, _ = pictured(shot.camera, shot.optics, one, spots, instants)
    grid = corners[0].reshape(len(instants), _RINGS + 1, _SECTORS, 2)
    grid = np.concatenate([grid, grid[:, :, :1]], axis=2)
    quads = np.stack(
        [grid[:, :-1, :-1], grid[:, :-1, 1:], grid[:, 1:, 1:], grid[:, 1:, :-1]], axis=3
    )
    # four places in each tile tell how much of it is hidden
    shift_r, shift_a = np.meshgrid((-0.25, 0.25), (-0.25, 0.25))
    r = (np.arange(_RINGS)[:, None, None] + 0.5 + shift_r.ravel()) / _RINGS
    a = 2 * np.pi * (np.arange(_SECTORS)[None, :, None] + 0.5 + shift_a.ravel()) / _SECTORS
    places = np.stack([r * np.cos(a), r * np.sin(a)], axis=-1).reshape(-1, 2)
    pixels, points = pictured(shot.camera, shot.optics, one, places, np.zeros(1))
    flat, depth = pixels.reshape(-1, 2), points[..., 2].ravel()
    each = [(mesh, float(tolerance[m])) for mesh, tolerance in shown.hiding]
    hidden = hidden_places(each, flat, depth)
    for other in shown.near.get(m, []):
        hidden |= _inside(shown.polygons[other, len(instants) // 2], flat)
    weights = 1 - hidden.reshape(_RINGS * _SECTORS, 4).mean(axis=1)
    if weights.min() == 1:
        return shown.polygons[m], np.ones(len(instants))
    kept = weights > 0
    tiles = quads.reshape(len(instants), _RINGS * _SECTORS, 4, 2)[:, kept].reshape(-1, 4, 2)
    return np.ascontiguousarray(tiles), np.tile(weights[kept], len(instants))


def _inside(polygon: Floats, points: Floats) -> NDArray[np.bool_]:
    """Which points (K, 2) lie in a convex polygon (P, 2)."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    to = points[:, None] - polygon
    side = edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0]
    return np.asarray((side >= 0).all(axis=1) | (side <= 0).all(axis=1))
