"""A head and what stands beside it at one moment: the scene for rays, and the light on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .head_surface import HeadSurface
from .layers import ExtraMesh
from .light_rays import LightRays
from .raycast import NO_HIT, RayScene
from .shading import EXTRA, EYE, EYE_LEFT, LASH, vertex_normals

Floats = NDArray[np.float32]

_LASH_LAYERS = 3
_BEHIND_MM = 0.02  # rays go on this far behind a lash


@dataclass(frozen=True, eq=False)
class Hits:
    """What rays meet first that is no lash.

    Attributes
    ----------
    triangle : (N,) uint32, or `NO_HIT`
    weights : (N, 2) float32
    hidden : (N,) float32
        How much of it lashes hide.
    distance_mm : (N,) float32
    """

    triangle: NDArray[np.uint32]
    weights: Floats
    hidden: Floats
    distance_mm: Floats


class PosedHead:
    """The scene of one moment; the light is traced where it is asked for, and kept.

    Parameters
    ----------
    surface : HeadSurface
    vertices : (V, 3) float64, mm, world frame
    extra : sequence of (mesh, its vertices in the world frame)
    lights : LightRays

    Attributes
    ----------
    origin : (3,) float64, mm, world frame
        Of the coordinates within: near the head, so that single precision keeps its digits.
    triangles : (F + extra, 3) int32
    part : (F + extra,) uint8
    places, normals : (V + extra, 3) float32
    colours : (extra, 3) float32
    roughness : (extra triangles,) float32
    lamps, sky, through
        Light that reaches the vertices, as of `LightRays`.
    axes : (2, 3) float32
        Where the right and the left eye look.
    """

    def __init__(
        self,
        surface: HeadSurface,
        vertices: NDArray[np.float64],
        extra: Sequence[tuple[ExtraMesh, NDArray[np.float64]]],
        lights: LightRays,
    ) -> None:
        self._surface, self._lights = surface, lights
        self._given = vertices, tuple(extra)
        self.origin = vertices.mean(axis=0)
        parts = [(vertices, surface.triangles), *((v, m.triangles) for m, v in extra)]
        local = [(v - self.origin).astype(np.float32) for v, _ in parts]
        first = np.cumsum([0, *(len(v) for v in local)])
        self.places = np.concatenate(local)
        self.triangles = np.concatenate(
            [t + np.int32(start) for (_, t), start in zip(parts, first, strict=False)]
        )
        self.normals = vertex_normals(self.places, self.triangles)
        n_extra = len(self.triangles) - len(surface.triangles)
        self.part = np.concatenate([surface.part, np.full(n_extra, EXTRA, np.uint8)])
        none = np.zeros((0, 3), np.float32)
        self.colours = np.concatenate([none, *(m.colour for m, _ in extra)])
        self.roughness = np.concatenate(
            [none[:, 0], *(np.full(len(m.triangles), m.roughness, np.float32) for m, _ in extra)]
        )
        self.axes = self._eye_axes()
        count = len(self.places)
        self.lamps = np.ones((count, 2), np.float32)
        self.sky = np.ones(count, np.float32)
        self.through = np.zeros((count, 3), np.float32)
        self._lit = np.zeros(count, bool)
        self._scene = RayScene(self.places, self.triangles)

    def shows(
        self, vertices: NDArray[np.float64], extra: Sequence[tuple[ExtraMesh, NDArray[np.float64]]]
    ) -> bool:
        """Whether it was made of these vertices and extra meshes."""
        mine, others = self._given
        return (
            np.array_equal(mine, vertices)
            and len(extra) == len(others)
            and all(
                a is b and np.array_equal(v, w)
                for (a, v), (b, w) in zip(extra, others, strict=True)
            )
        )

    def cast(self, start: Floats, directions: Floats) -> Hits:
        """First hits of rays (N, 3) from one place (3,), mm from `origin`."""
        t, triangle, weights = self._scene.cast(start, directions)
        triangle, weights, t = triangle.copy(), weights.copy(), t.copy()
        hidden = np.zeros(len(directions), np.float32)
        rows = self._on_lashes(triangle, np.arange(len(triangle)))
        for _ in range(_LASH_LAYERS):
            if not len(rows):
                break
            alpha = self._surface.lash_alpha(triangle[rows], weights[rows])
            hidden[rows] += (1 - hidden[rows]) * alpha
            t[rows] += _BEHIND_MM
            begin = start + directions[rows] * t[rows, None]
            further, triangle[rows], weights[rows] = self._scene.cast(begin, directions[rows])
            t[rows] += further
            rows = self._on_lashes(triangle, rows)
        triangle[rows] = NO_HIT
        return Hits(triangle, weights, hidden, t)

    def _on_lashes(
        self, triangle: NDArray[np.uint32], rows: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        rows = rows[triangle[rows] != NO_HIT]
        return np.asarray(rows[self.part[triangle[rows]] == LASH])

    def light_up(self, triangle: NDArray[np.uint32]) -> None:
        """Trace the light to the vertices of triangles (N,) that have none yet."""
        hit = np.zeros(len(self.triangles), bool)
        hit[triangle[triangle != NO_HIT]] = True
        seen = np.zeros(len(self.places), bool)
        seen[self.triangles[hit & (self.part != EYE) & (self.part != EYE_LEFT)]] = True
        rows = np.flatnonzero(seen & ~self._lit)
        if not len(rows):
            return
        places, normals = self.places[rows], self.normals[rows]
        self.lamps[rows], self.sky[rows] = self._lights.reaching(self._scene, places, normals)
        thin = rows[rows < len(self._surface.thickness_mm)]
        thin = thin[np.isfinite(self._surface.thickness_mm[thin])]
        self.through[thin] = self._lights.through(
            self._scene, self.places[thin], self.normals[thin], self._surface.thickness_mm[thin]
        )
        self._lit[rows] = True

    def light_at(self, hits: Hits) -> Floats:
        """Light that is traced for each sample, (N,): 1 where that of the vertices is enough.

        Openness of the eyeballs to the light; shadows of a sharp key light.
        """
        found = np.ones(len(hits.triangle), np.float32)
        rows = np.flatnonzero(hits.triangle != NO_HIT)
        part = self.part[hits.triangle[rows]]
        on_eye = (part == EYE) | (part == EYE_LEFT)
        eyes, others = rows[on_eye], rows[~on_eye]
        if len(eyes):
            places, _ = self._places(hits, eyes)
            corners = self.places[self.triangles[hits.triangle[eyes]]]
            out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
            found[eyes] = self._lights.reaching_eyes(self._scene, places, out)
        if self._lights.is_sharp and len(others):
            places, normals = self._places(hits, others)
            found[others] = self._lights.reaching_sharply(self._scene, places, normals)
        return found

    def _places(self, hits: Hits, rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Places and smooth normals (N, 3) of hits."""
        w = hits.weights[rows]
        b = np.stack([1 - w.sum(axis=1), w[:, 0], w[:, 1]], axis=1)
        corners = self.triangles[hits.triangle[rows]]
        return (
            np.einsum("nc,ncx->nx", b, self.places[corners]),
            np.einsum("nc,ncx->nx", b, self.normals[corners]),
        )

    def _eye_axes(self) -> Floats:
        found = np.zeros((2, 3), np.float32)
        for code, (ball, front) in self._surface.eye_fronts.items():
            p = self.places[ball]
            axis = self.places[front].mean(axis=0) - (p.min(axis=0) + p.max(axis=0)) / 2
            found[code - EYE] = axis / np.linalg.norm(axis)
        return found
