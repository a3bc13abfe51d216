"""A few loose strands that hang from the hairline into the face and hide a little of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .bust import vertex_albedo
from .head import Head
from .raycast import RayScene

Floats = NDArray[np.float64]

_N_POINTS = 14  # along a strand
_WIDTH_MM = 1.5  # of a lock at its root; it ends in a point
_LIFT_MM = 3.5  # off the skin


@dataclass(frozen=True, eq=False)
class HairStrands:
    """Locks as narrow ribbons, fixed to the head at rest.

    Attributes
    ----------
    vertices : (V, 3) float64, mm, head frame
    triangles : (F, 3) int32
    colour : (V, 3) float64, linear
    roots : (V,) int64
        Vertex of the head that each moves with.
    sway : (V,) float64
        How much it does: 1 at the root, less below.
    rest : (V_head, 3) float64, mm
    """

    vertices: Floats
    triangles: NDArray[np.int32]
    colour: Floats
    roots: NDArray[np.int64]
    sway: Floats
    rest: Floats

    def at(self, head_vertices: Floats) -> Floats:
        """The strands on a moved face, (V, 3) mm, head frame."""
        moved = head_vertices[self.roots] - self.rest[self.roots]
        return np.asarray(self.vertices + self.sway[:, None] * moved)


def loose_strands(
    rng: np.random.Generator, head: Head, *, n_locks: int | None = None
) -> HairStrands:
    """Draw locks that fall from one side of the forehead over brow and eye.

    Parameters
    ----------
    rng : numpy Generator
    head : Head
    n_locks : int, optional
        50 to 90 if left out.
    """
    rest = np.asarray(head.mesh.vertices)
    skin = np.asarray(head.mesh.triangles)[np.asarray(head.mesh.groups["skin"])]
    scene = RayScene(rest, skin)
    top = head.points["11.1"]  # where forehead and hair meet
    side = float(rng.choice((-1.0, 1.0)))
    count = int(rng.integers(50, 91)) if n_locks is None else n_locks
    albedo = vertex_albedo(head)
    hair = _hair_colour(albedo, rest, top)
    parts, faces, colours = [], [], []
    reach_mm = float(rng.uniform(60, 105))
    parting = side * float(rng.uniform(5, 20))
    for lock in range(count):
        path = _lock(rng, scene, top, side, parting, reach_mm)
        normals = _outward(scene, path)
        ribbon = _ribbon(path, normals, _WIDTH_MM * float(rng.uniform(0.45, 1.2)))
        parts.append(ribbon)
        faces.append(_strip() + lock * 2 * _N_POINTS)
        shade = hair * np.exp(rng.normal(0, 0.16))
        colours.append(np.tile(shade, (2 * _N_POINTS, 1)))
    vertices = np.concatenate(parts)
    first = np.repeat(np.arange(count) * 2 * _N_POINTS, 2 * _N_POINTS)
    _, triangle, _ = scene.closest(vertices[first])
    along = np.tile(np.repeat(np.linspace(0, 1, _N_POINTS), 2), count)
    return HairStrands(
        vertices,
        np.concatenate(faces).astype(np.int32),
        np.clip(np.concatenate(colours), 0.003, 0.95),
        skin[triangle][:, 0].astype(np.int64),
        1 - along,
        rest,
    )


def _hair_colour(albedo: Floats, rest: Floats, top: Floats) -> Floats:
    """Of the painted scalp above the hairline."""
    scalp = (rest[:, 1] > top[1] + 25) & (rest[:, 2] < top[2] - 20)
    return np.asarray(np.quantile(albedo[scalp], 0.35, axis=0)) if scalp.any() else np.full(3, 0.03)


def _lock(
    rng: np.random.Generator,
    scene: RayScene,
    top: Floats,
    side: float,
    parting: float,
    reach_mm: float,
) -> Floats:
    """A lock's middle line, (n, 3) mm: from the hairline aside and down, off the skin."""
    s = np.linspace(0, 1, _N_POINTS)
    spread = float(rng.beta(1.3, 1.8))
    x = parting + side * 34 * s**0.8 + side * (46 * spread - 16)
    x = x + rng.normal(0, 1.6) + rng.normal(0, 3.5) * s**2
    fall = reach_mm * float(rng.uniform(0.6, 1.0))
    y = top[1] + 20 + rng.normal(0, 3) - fall * s**1.25
    # where the skin is, seen from before
    origin = np.stack([x, y, np.full_like(x, 400.0)], axis=1)
    t, _, _ = scene.cast(origin, np.tile([0.0, 0.0, -1.0], (len(s), 1)))
    z = np.where(np.isfinite(t), 400.0 - t, top[2])
    # hair does not follow the eye's hollow: it hangs from the brow
    hull = np.maximum.accumulate(z)
    z = z + 0.75 * np.maximum(hull - z, 0)
    lift = _LIFT_MM * (0.5 + 3 * np.sin(np.pi * np.minimum(s * 1.15, 1)) ** 2)
    z = z + lift * float(rng.uniform(0.6, 1.4))
    path = np.stack([x, y, z], axis=1)
    for _ in range(3):
        path[1:-1] = 0.5 * path[1:-1] + 0.25 * (path[:-2] + path[2:])
    return path


def _outward(scene: RayScene, path: Floats) -> Floats:
    """Directions from the skin to a path, (n, 3)."""
    at, _, _ = scene.closest(path)
    off = path - at
    return np.asarray(off / (np.linalg.norm(off, axis=1, keepdims=True) + 1e-9))


def _ribbon(path: Floats, normals: Floats, width_mm: float) -> Floats:
    """A flat ribbon that lies over the skin and narrows to a point, (2 n, 3)."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True) + 1e-9
    across = np.cross(along, normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True) + 1e-9
    s = np.linspace(0, 1, len(path))[:, None]
    half = 0.5 * width_mm * np.sqrt(1 - s**3) + 0.08
    return np.asarray(np.stack([path - half * across, path + half * across], axis=1).reshape(-1, 3))


def _strip() -> NDArray[np.int64]:
    i = 2 * np.arange(_N_POINTS - 1)
    return np.concatenate(
        [np.stack([i, i + 1, i + 2], axis=1), np.stack([i + 1, i + 3, i + 2], axis=1)]
    )
