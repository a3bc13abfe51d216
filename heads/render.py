"""Pictures of a head without a window or a graphics card: rays, lights, skin that looks like skin.

Rays are cast with Open3D; shading is one compiled loop. Light that reaches a place (soft shadow of
the key light, openness to the sky, light through thin skin) is traced per vertex of what is seen
and, on the eyes, per sample: it moves with lids, lips and jaw. Everything is deterministic.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.camera import Camera
from ..core.rigid import Rigid
from .head import Head
from .head_surface import HeadSurface
from .layers import ExtraMesh, Layers, film_curve
from .light_rays import LightRays
from .posed_head import Hits, PosedHead
from .raycast import NO_HIT
from .sample_grid import EDGE_SAMPLES, all_directions, edge_directions, edge_pixels
from .shading import LINEAR_OF_SRGB, shade_samples, vertex_normals
from .srgb import linear_from_srgb, srgb_from_linear
from .stage_lights import StageLights

Floats = NDArray[np.float32]
Box = tuple[int, int, int, int]

_OUTPUT_LEVELS = 8192  # of linear light
_PORTRAIT_DISTANCE_MM = 1400.0
_BACKGROUND = (74, 82, 92)
_EDGE_SLOPE_PX = 6.0  # a step this many pixels deep is an edge
_N_CAMERAS_KEPT = 8


class HeadRenderer:
    """Draws one head under any shape and camera.

    Vertices drawn again, as by the cameras of a rig, reuse the light traced before.

    Parameters
    ----------
    head : Head
    background : sRGB triple 0 to 255, or (h, w, 3) uint8
        A colour is laid out as a soft studio backdrop; a picture is used as it is.
    supersample : int
        Rays along each side of a pixel.
    stage : Rigid
        World from stage: the lights stand still in the world; the key light of ``studio`` comes
        from the subject's right, above, when the face looks along the stage's z axis.
    lights : StageLights, optional
        ``StageLights.preset("studio")`` if left out.
    quick : bool
        For many frames: one ray a pixel and four where edges need them, whatever `supersample`
        says, and fewer rays to the lights.
    """

    def __init__(
        self,
        head: Head,
        *,
        background: tuple[float, float, float] | NDArray[np.uint8] = _BACKGROUND,
        supersample: int = 2,
        stage: Rigid | None = None,
        lights: StageLights | None = None,
        quick: bool = False,
    ) -> None:
        if supersample < 1:
            raise ValueError(f"supersample must be at least 1, got {supersample}")
        self.head = head
        self.supersample = 1 if quick else supersample
        self.quick = quick
        self._background = background
        rest = head.mesh.vertices.astype(np.float32)
        triangles = np.ascontiguousarray(head.mesh.triangles, dtype=np.int32)
        self._surface = HeadSurface.of(head, vertex_normals(rest, triangles))
        chosen = StageLights.preset("studio") if lights is None else lights
        self._lights = LightRays(
            chosen, np.eye(3) if stage is None else stage.rotation, quick=quick
        )
        self._rays: dict[int, tuple[Camera, Floats, NDArray[np.bool_]]] = {}
        self._posed: PosedHead | None = None
        self._backdrops: dict[tuple[int, int], NDArray[np.uint8]] = {}

    def backdrop(self, size: tuple[int, int]) -> NDArray[np.uint8]:
        """What stands behind the head, (h, w, 3) uint8, for a picture of (width, height)."""
        if isinstance(self._background, np.ndarray):
            wanted = (size[1], size[0], 3)
            return readonly(self._background, wanted, "background", np.uint8)
        if size not in self._backdrops:
            self._backdrops.clear()
            self._backdrops[size] = _studio_backdrop(self._background, size)
        return self._backdrops[size]

    def render(
        self,
        vertices: NDArray[np.float64],
        camera: Camera,
        world_from_head: Rigid | None = None,
        *,
        extra: Sequence[ExtraMesh] = (),
    ) -> NDArray[np.uint8]:
        """Draw the head before its backdrop, as a picture.

        Parameters
        ----------
        vertices, camera, world_from_head, extra
            As of `render_layers`.

        Returns
        -------
        (h, w, 3) uint8, sRGB
            Pixels that the head does not touch are those of `backdrop`.

        Raises
        ------
        ValueError
            As of `render_layers`.
        """
        layers = self.render_layers(vertices, camera, world_from_head, extra=extra)
        picture = self.backdrop(camera.image_size).copy()
        x0, y0, x1, y1 = layers.box
        part = picture[y0:y1, x0:x1]
        seen = layers.cover > 0
        cover = layers.cover[seen][:, None]
        behind = LINEAR_OF_SRGB[part[seen]]
        mixed = cover * film_curve(layers.light[seen] / cover) + (1 - cover) * behind
        part[seen] = srgb_from_linear(mixed, n_levels=_OUTPUT_LEVELS)
        return picture

    def render_layers(
        self,
        vertices: NDArray[np.float64],
        camera: Camera,
        world_from_head: Rigid | None = None,
        *,
        extra: Sequence[ExtraMesh] = (),
    ) -> Layers:
        """Draw the head in linear light, without a background.

        Parameters
        ----------
        vertices : (V, 3) float, mm
            In the head frame if `world_from_head` is given, else in the world frame.
        camera : Camera
        world_from_head : Rigid, optional
        extra : sequence of ExtraMesh
            Drawn too: they hide the head, and it them, and all cast shadows on each other.

        Returns
        -------
        Layers

        Raises
        ------
        ValueError
            If `vertices` are not the head's number of finite points, or an extra mesh in the
            head's frame comes without `world_from_head`.
        """
        v = readonly(vertices, self.head.mesh.vertices.shape, "vertices")
        if not np.isfinite(v).all():
            raise ValueError("vertices must be finite")
        if world_from_head is not None:
            v = world_from_head.apply(v)
        others = [(mesh, _in_world(mesh, world_from_head)) for mesh in extra]
        box = _box(np.concatenate([v, *(w for _, w in others)]), camera)
        if box is None:
            return Layers.empty()
        posed = self._posed
        if posed is None or not posed.shows(v, others):
            posed = self._posed = PosedHead(self._surface, v, others, self._lights)
        return self._drawn(posed, camera, box)

    def _drawn(self, posed: PosedHead, camera: Camera, box: Box) -> Layers:
        n = self.supersample
        directions, known = self._directions(camera, box)
        start = (camera.position - posed.origin).astype(np.float32)
        hits = _cast(posed, start, directions, known)
        shape = directions.shape[:2]
        flat = directions.reshape(-1, 3)
        columns = rows = np.zeros(0, np.int64)
        if self.quick:
            slope = _EDGE_SLOPE_PX / camera.focal_px
            edges = edge_pixels(
                hits.triangle.reshape(shape), posed.part, hits.distance_mm.reshape(shape),
                hits.hidden.reshape(shape), slope,
            )  # fmt: skip
            rows, columns = np.nonzero(edges)
            more, usable = edge_directions(camera, columns + box[0], rows + box[1])
            hits = _joined(hits, _cast(posed, start, more, usable))
            flat = np.concatenate([flat, more.reshape(-1, 3)])
        light, cover = self._shaded(posed, camera, hits, flat)
        count = shape[0] * shape[1]
        height, width = shape[0] // n, shape[1] // n
        mean_light = light[:count].reshape(height, n, width, n, 3).mean(axis=(1, 3))
        mean_cover = cover[:count].reshape(height, n, width, n).mean(axis=(1, 3))
        if len(rows):
            mean_light[rows, columns] = light[count:].reshape(-1, len(EDGE_SAMPLES), 3).mean(axis=1)
            mean_cover[rows, columns] = cover[count:].reshape(-1, len(EDGE_SAMPLES)).mean(axis=1)
        return Layers(
            mean_light,
            mean_cover,
            np.ascontiguousarray(hits.triangle[:count].reshape(shape)[::n, ::n]),
            np.ascontiguousarray(hits.weights[:count].reshape(*shape, 2)[::n, ::n]),
            box,
        )

    def _shaded(
        self, posed: PosedHead, camera: Camera, hits: Hits, directions: Floats
    ) -> tuple[Floats, Floats]:
        """Light (N, 3), premultiplied, and coverage (N,) of all samples."""
        posed.light_up(hits.triangle)
        light_at = posed.light_at(hits)
        depth = float(np.median(posed.places @ camera.camera_from_world.rotation[2]))
        depth += float(camera.camera_from_world.apply(posed.origin)[2])
        samples_per_mm = self.supersample * camera.focal_px / max(depth, 1.0)
        s, rays = self._surface, self._lights
        skin, roughness, normal = s.textures(samples_per_mm)
        light = np.empty((len(directions), 3), np.float32)
        cover = np.empty(len(directions), np.float32)
        arguments = (
            hits.triangle, hits.weights, hits.hidden, directions, light_at, posed.triangles,
            posed.part, posed.places, posed.normals, posed.lamps, posed.sky, posed.through,
            posed.axes, posed.colours, posed.roughness, s.uv_triangles, s.uv, skin, roughness,
            normal, s.eye, s.details, LINEAR_OF_SRGB, rays.directions, rays.colours, rays.spreads,
            light, cover,
        )  # fmt: skip
        _in_threads(shade_samples, arguments, len(directions))
        return light, cover

    def _directions(self, camera: Camera, box: Box) -> tuple[Floats, NDArray[np.bool_]]:
        """Of all samples in a box of pixels, and which of them the lens lets through."""
        cached = self._rays.get(id(camera))
        if cached is None:
            if len(self._rays) >= _N_CAMERAS_KEPT:
                self._rays.clear()
            cached = camera, *all_directions(camera, self.supersample)
            self._rays[id(camera)] = cached
        x0, y0, x1, y1 = (self.supersample * c for c in box)
        return np.ascontiguousarray(cached[1][y0:y1, x0:x1]), cached[2][y0:y1, x0:x1]


def portrait_camera(
    head: Head, size: tuple[int, int], yaw_rad: float = 0.0, pitch_rad: float = 0.0
) -> Camera:
    """A camera that frames head and neck as a portrait lens does.

    Parameters
    ----------
    head : Head
    size : (width, height) int, px
    yaw_rad : float
        Positive goes round to the subject's left.
    pitch_rad : float
        Positive looks down from above.

    Returns
    -------
    Camera
        1.4 m from the head. The crown has air above; the lower edge lies on the neck.
    """
    v = head.mesh.vertices
    low, high = v.min(axis=0), v.max(axis=0)
    width, height = size
    neck = low[1] + 0.18 * (high[1] - low[1])
    span = (high[1] - neck) * 1.10
    centre = np.array([0.0, neck + span / 2, 0.35 * (low[2] + high[2])])
    away = np.array(
        [
            np.sin(yaw_rad) * np.cos(pitch_rad),
            np.sin(pitch_rad),
            np.cos(yaw_rad) * np.cos(pitch_rad),
        ]
    )
    right = np.array([np.cos(yaw_rad), 0.0, -np.sin(yaw_rad)])
    R = np.stack([right, np.cross(-away, right), -away])
    across = v[v[:, 1] > neck] @ right
    centre += (0.5 * (across.min() + across.max()) - centre @ right) * right
    half_width = 0.56 * np.ptp(across)
    position = centre + _PORTRAIT_DISTANCE_MM * away
    focal = _PORTRAIT_DISTANCE_MM * min(height / span, width / (2 * half_width))
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    return Camera(size, K, Rigid.from_rotation(R, -R @ position))


def _studio_backdrop(
    colour: tuple[float, float, float], size: tuple[int, int]
) -> NDArray[np.uint8]:
    """A lit wall: brightest behind the head, darker to the sides and below."""
    width, height = size
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    scale = max(width, height)
    off = np.hypot((x - 0.5 * width) / scale, (y - 0.40 * height) / scale)
    light = 1.18 - 1.05 * off**1.4 - 0.22 * np.clip(y / height - 0.6, 0, 1)
    linear = linear_from_srgb(np.array(colour)).astype(np.float32)
    light = (np.clip(light, 0.05, None) ** 1.6)[..., None] * linear
    found = srgb_from_linear(light, n_levels=_OUTPUT_LEVELS)
    found.flags.writeable = False
    return found


def _in_world(mesh: ExtraMesh, world_from_head: Rigid | None) -> NDArray[np.float64]:
    if mesh.frame == "world":
        return mesh.vertices
    if world_from_head is None:
        raise ValueError("an extra mesh in the head's frame needs world_from_head")
    return np.asarray(world_from_head.apply(mesh.vertices))


def _cast(posed: PosedHead, start: Floats, directions: Floats, known: NDArray[np.bool_]) -> Hits:
    hits = posed.cast(start, directions.reshape(-1, 3))
    if not known.all():
        hits.triangle[~known.ravel()] = NO_HIT
        hits.hidden[~known.ravel()] = 0
    return hits


def _joined(a: Hits, b: Hits) -> Hits:
    return Hits(
        np.concatenate([a.triangle, b.triangle]),
        np.concatenate([a.weights, b.weights]),
        np.concatenate([a.hidden, b.hidden]),
        np.concatenate([a.distance_mm, b.distance_mm]),
    )


def _box(v: NDArray[np.float64], camera: Camera) -> Box | None:
    """Pixels x0, y0, x1, y1 (ends excluded) that hold the points; None if none is in view.

    Points that the camera cannot project (behind it, or folded by the lens) make it the whole
    picture.
    """
    width, height = camera.image_size
    at = camera.project(v)
    if np.isnan(at).any():
        known = ~np.isnan(at).any(axis=1)
        return (0, 0, width, height) if known.any() else None
    # surfaces bulge between vertices by far less than a pixel or two
    x0, y0 = np.floor(at.min(axis=0)).astype(int) - 2
    x1, y1 = np.ceil(at.max(axis=0)).astype(int) + 3
    x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1, width), min(y1, height)
    return (int(x0), int(y0), int(x1), int(y1)) if x0 < x1 and y0 < y1 else None


def _in_threads(function: Any, arguments: tuple[Any, ...], count: int) -> None:
    """Call a compiled loop over samples, which lets go of the interpreter, on all cores."""
    cores = min(os.cpu_count() or 1, 8)
    bounds = np.linspace(0, count, 4 * cores + 1).astype(int)
    with ThreadPoolExecutor(cores) as pool:
        jobs = [pool.submit(function, *(*arguments, a, b)) for a, b in pairwise(bounds)]
        for job in jobs:
            job.result()
