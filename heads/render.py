"""Pictures of a head without a window or a graphics card: rays, lights, skin that looks like skin.

Rays are cast with Open3D; shading is one compiled loop. Light that reaches a place (soft shadow of
the key light, openness to the sky) is traced per vertex of what is seen and, on the eyes, per
sample: it moves with lids, lips and jaw. Everything is deterministic.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rigid import Rigid
from .head import Head
from .raycast import NO_HIT, RayScene
from .shading import (
    EYE,
    EYE_LEFT,
    LASH,
    LINEAR_OF_SRGB,
    SKIN,
    TEETH,
    TONGUE,
    shade_rows,
    vertex_normals,
)
from .srgb import linear_from_srgb, srgb_from_linear
from .stage_lights import StageLights

Floats = NDArray[np.float32]

#: Part codes of the shading loop; all else is skin.
_CODE = {
    "eye_right": EYE,
    "eye_left": EYE_LEFT,
    "lashes": LASH,
    "teeth_upper": TEETH,
    "teeth_lower": TEETH,
    "tongue": TONGUE,
}
_LASH_LAYERS = 3
_OUTPUT_LEVELS = 8192  # of linear light
_PORTRAIT_DISTANCE_MM = 1400.0
_BACKGROUND = (74, 82, 92)


class HeadRenderer:
    """Draws one head under any shape and camera.

    Parameters
    ----------
    head : Head
    background : sRGB triple 0 to 255, or (h, w, 3) uint8
        A colour is laid out as a soft studio backdrop; a picture is used as it is.
    supersample : int
        Rays along each side of a pixel.
    stage : Rigid
        World from stage: the lights stand still in the world; the key light comes from the
        subject's right, above, when the face looks along the stage's z axis.
    """

    def __init__(
        self,
        head: Head,
        *,
        background: tuple[float, float, float] | NDArray[np.uint8] = _BACKGROUND,
        supersample: int = 2,
        stage: Rigid | None = None,
    ) -> None:
        if supersample < 1:
            raise ValueError(f"supersample must be at least 1, got {supersample}")
        self.head = head
        self.supersample = supersample
        self._background = background
        mesh, looks = head.mesh, head.appearance
        self._triangles = np.ascontiguousarray(mesh.triangles, dtype=np.int32)
        uv = mesh.uv if looks.uv is None else looks.uv
        if uv is None or mesh.uv_triangles is None:
            uv, uv_triangles = np.full((1, 2), 0.5), np.zeros_like(self._triangles)
        else:
            uv_triangles = np.asarray(mesh.uv_triangles)
        if uv_triangles.size and uv_triangles.max() >= len(uv):
            raise InputError(f"head {head.name}: its appearance's uv do not fit its mesh")
        self._uv = np.ascontiguousarray(uv, dtype=np.float32)
        self._uv_triangles = np.ascontiguousarray(uv_triangles, dtype=np.int32)
        self._part = np.full(len(self._triangles), SKIN, dtype=np.uint8)
        for name, code in _CODE.items():
            if name in mesh.groups and (looks.eye is not None or code > EYE_LEFT):
                self._part[mesh.groups[name]] = code
        if looks.details is None:
            self._part[self._part >= LASH] = SKIN
        self._skin = _pyramid(looks.skin)
        rough = np.full((4, 4), 128, np.uint8) if looks.roughness is None else looks.roughness
        self._roughness = np.ascontiguousarray(rough)
        self._eye = np.ascontiguousarray(looks.skin if looks.eye is None else looks.eye)
        self._details = (
            np.zeros((4, 4, 4), np.uint8)
            if looks.details is None
            else np.ascontiguousarray(looks.details)
        )
        self._lights = StageLights(np.eye(3) if stage is None else stage.rotation)
        self._eye_fronts = {
            code: _front_rows(self._triangles, self._uv_triangles, self._uv, self._part == code)
            for code in (EYE, EYE_LEFT)
            if (self._part == code).any()
        }
        self._rays: dict[int, tuple[Camera, Floats]] = {}

    def backdrop(self, size: tuple[int, int]) -> NDArray[np.uint8]:
        """What stands behind the head, (h, w, 3) uint8, for a picture of (width, height)."""
        if isinstance(self._background, np.ndarray):
            wanted = (size[1], size[0], 3)
            return readonly(self._background, wanted, "background", np.uint8)
        width, height = size
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        scale = max(width, height)
        off = np.hypot((x - 0.5 * width) / scale, (y - 0.40 * height) / scale)
        light = 1.18 - 1.05 * off**1.4 - 0.22 * np.clip(y / height - 0.6, 0, 1)
        colour = linear_from_srgb(np.array(self._background))
        light = (np.clip(light, 0.05, None) ** 1.6)[..., None] * colour.astype(np.float32)
        return srgb_from_linear(light, n_levels=_OUTPUT_LEVELS)

    def render(
        self,
        vertices: NDArray[np.float64],
        camera: Camera,
        world_from_head: Rigid | None = None,
    ) -> NDArray[np.uint8]:
        """Draw the head.

        Parameters
        ----------
        vertices : (V, 3) float, mm
            In the head frame if `world_from_head` is given, else in the world frame.
        camera : Camera
        world_from_head : Rigid, optional

        Returns
        -------
        (h, w, 3) uint8, sRGB
            Pixels that the head does not touch are those of `backdrop`.

        Raises
        ------
        ValueError
            If `vertices` are not the head's number of finite points.
        """
        v = readonly(vertices, self.head.mesh.vertices.shape, "vertices")
        if not np.isfinite(v).all():
            raise ValueError("vertices must be finite")
        if world_from_head is not None:
            v = world_from_head.apply(v)
        picture = self.backdrop(camera.image_size).copy()
        box = _box(v, camera)
        if box is None:
            return picture
        x0, y0, x1, y1 = box
        # origin at the camera: single precision keeps its digits for the head
        local = (v - camera.position).astype(np.float32)
        directions = self._directions(camera, box)
        scene = RayScene(local, self._triangles)
        triangle, weights, lash = self._cast(scene, directions)
        normals = vertex_normals(local, self._triangles)
        lamps, sky = self._vertex_light(scene, local, normals, triangle)
        eye_light = self._eye_light(scene, local, directions, triangle, weights)
        axes = self._eye_axes(local)
        pixels_per_mm = camera.focal_px / max(float(np.median(local @ _forward(camera))), 1.0)
        level = self._level(pixels_per_mm)
        n = self.supersample
        light = np.empty((y1 - y0, x1 - x0, 3), np.float32)
        cover = np.empty((y1 - y0, x1 - x0), np.float32)
        arguments = (
            triangle, weights, lash, directions, self._triangles, self._uv_triangles, self._uv,
            self._part, normals, lamps, sky, eye_light, axes, self._skin[level], self._roughness,
            self._eye, self._details, LINEAR_OF_SRGB, self._lights.directions, n, light, cover,
        )  # fmt: skip
        _in_threads(shade_rows, arguments, y1 - y0)
        behind = linear_from_srgb(picture[y0:y1, x0:x1]).astype(np.float32)
        seen = cover > 0
        mixed = light[seen] + (1 - cover[seen])[:, None] * behind[seen]
        picture[y0:y1, x0:x1][seen] = srgb_from_linear(mixed, n_levels=_OUTPUT_LEVELS)
        return picture

    def _directions(self, camera: Camera, box: tuple[int, int, int, int]) -> Floats:
        """Unit directions (rows, columns, n²·3 packed) of all samples in a box of pixels."""
        cached = self._rays.get(id(camera))
        if cached is None:
            if len(self._rays) >= 8:
                self._rays.clear()
            cached = camera, _all_rays(camera, self.supersample)
            self._rays[id(camera)] = cached
        x0, y0, x1, y1 = (self.supersample * c for c in box)
        return np.ascontiguousarray(cached[1][y0:y1, x0:x1])

    def _cast(
        self, scene: RayScene, directions: Floats
    ) -> tuple[NDArray[np.uint32], Floats, Floats]:
        """First hit of every sample that is no lash, and how much of it lashes hide."""
        shape = directions.shape[:2]
        flat = directions.reshape(-1, 3)
        known = np.asarray(np.isfinite(flat).all(axis=1))  # not where the lens folds
        usable = flat.copy()
        usable[~known] = (0, 0, 1)
        t, triangle, weights = scene.cast(np.zeros(3), usable)
        triangle, weights, t = triangle.copy(), weights.copy(), t.copy()
        triangle[~known] = NO_HIT
        hidden = np.zeros(len(flat), np.float32)
        for _ in range(_LASH_LAYERS):
            rows = np.flatnonzero(triangle != NO_HIT)
            rows = rows[self._part[triangle[rows]] == LASH]
            if not len(rows):
                break
            alpha = self._lash_alpha(triangle[rows], weights[rows])
            hidden[rows] += (1 - hidden[rows]) * alpha
            start = usable[rows] * (t[rows] + 0.02)[:, None]
            further, triangle[rows], weights[rows] = scene.cast(start, usable[rows])
            t[rows] += 0.02 + further
        rows = np.flatnonzero(triangle != NO_HIT)
        last = rows[self._part[triangle[rows]] == LASH]
        triangle[last] = NO_HIT
        return triangle.reshape(shape), weights.reshape(*shape, 2), hidden.reshape(shape)

    def _lash_alpha(self, triangle: NDArray[np.uint32], weights: Floats) -> Floats:
        corners = self._uv[self._uv_triangles[triangle]]
        b = np.stack([1 - weights.sum(axis=1), weights[:, 0], weights[:, 1]], axis=1)
        uv = np.einsum("nc,ncx->nx", b, corners)
        height, width = self._details.shape[:2]
        column = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
        row = np.clip(((1 - uv[:, 1]) * height).astype(int), 0, height - 1)
        return np.asarray(self._details[row, column, 3] / 255, dtype=np.float32)

    def _vertex_light(
        self, scene: RayScene, local: Floats, normals: Floats, triangle: NDArray[np.uint32]
    ) -> tuple[Floats, Floats]:
        """Shares of key and rim light (V, 2) and sky (V,) that reach each vertex that is seen."""
        hit = np.zeros(len(self._triangles), bool)
        hit[triangle[triangle != NO_HIT]] = True
        rows = np.unique(self._triangles[hit & (self._part != EYE) & (self._part != EYE_LEFT)])
        lamps, sky = np.ones((len(local), 2), np.float32), np.ones(len(local), np.float32)
        lamps[rows], sky[rows] = self._lights.reaching(scene, local[rows], normals[rows])
        return lamps, sky

    def _eye_light(
        self,
        scene: RayScene,
        local: Floats,
        directions: Floats,
        triangle: NDArray[np.uint32],
        weights: Floats,
    ) -> Floats:
        """Openness of the eyeballs' samples to the light, dimmed near the lids."""
        found = np.ones(triangle.shape, np.float32)
        rows = np.nonzero(triangle != NO_HIT)
        part = self._part[triangle[rows]]
        on_eye = (part == EYE) | (part == EYE_LEFT)
        rows = rows[0][on_eye], rows[1][on_eye]
        if not len(rows[0]):
            return found
        w = weights[rows]
        corners = local[self._triangles[triangle[rows]]]
        b = np.stack([1 - w.sum(axis=1), w[:, 0], w[:, 1]], axis=1)
        place = np.einsum("nc,ncx->nx", b, corners)
        out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
        found[rows] = self._lights.reaching_eyes(scene, place, out)
        return found

    def _eye_axes(self, local: Floats) -> Floats:
        """Where the right and the left eye look, (2, 3) unit vectors."""
        found = np.zeros((2, 3), np.float32)
        for code, (ball, front) in self._eye_fronts.items():
            centre = (local[ball].min(axis=0) + local[ball].max(axis=0)) / 2
            axis = local[front].mean(axis=0) - centre
            found[code - EYE] = axis / np.linalg.norm(axis)
        return found

    def _level(self, pixels_per_mm: float) -> int:
        """Of the skin's pyramid: about one texel a sample on the face."""
        texels_per_mm = 4.4 * self._skin[0].shape[0] / 2048
        ratio = texels_per_mm / (pixels_per_mm * self.supersample)
        return int(np.clip(round(np.log2(max(ratio, 1e-3)) - 0.25), 0, len(self._skin) - 1))


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


def _forward(camera: Camera) -> Floats:
    return np.asarray(camera.camera_from_world.rotation[2], dtype=np.float32)


def _box(v: NDArray[np.float64], camera: Camera) -> tuple[int, int, int, int] | None:
    """Pixels x0, y0, x1, y1 (ends excluded) that hold the head; None if it is not in view.

    Vertices that the camera cannot project (behind it, or folded by the lens) make it the whole
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
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def _all_rays(camera: Camera, n: int) -> Floats:
    """Directions (n h, n w, 3) through the samples of all pixels, world axes."""
    width, height = camera.image_size
    x = (np.arange(n * width) + 0.5) / n - 0.5
    y = (np.arange(n * height) + 0.5) / n - 0.5
    found = np.empty((n * height, n * width, 3), np.float32)
    for start in range(0, len(y), 128):  # in strips, to spare memory
        rows = slice(start, start + 128)
        grid = np.stack(np.meshgrid(x, y[rows]), axis=-1)
        found[rows] = camera.ray(grid)
    return found


def _pyramid(picture: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    levels = [np.ascontiguousarray(picture)]
    while min(levels[-1].shape[:2]) > 128:
        half = levels[-1].shape[1] // 2, levels[-1].shape[0] // 2
        levels.append(cv2.resize(levels[-1], half, interpolation=cv2.INTER_AREA))
    return levels


def _in_threads(function: Any, arguments: tuple[Any, ...], n_rows: int) -> None:
    """Call a compiled loop over rows, which lets go of the interpreter, on all cores."""
    cores = min(os.cpu_count() or 1, 8)
    bounds = np.linspace(0, n_rows, 4 * cores + 1).astype(int)
    with ThreadPoolExecutor(cores) as pool:
        jobs = [pool.submit(function, *(*arguments, a, b)) for a, b in pairwise(bounds)]
        for job in jobs:
            job.result()


def _front_rows(
    triangles: NDArray[np.int32],
    uv_triangles: NDArray[np.int32],
    uv: Floats,
    chosen: NDArray[np.bool_],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Vertices of an eyeball, and its 8 nearest to the middle of the iris."""
    rows, first = np.unique(triangles[chosen], return_index=True)
    off = np.linalg.norm(uv[uv_triangles[chosen].ravel()[first]] - 0.5, axis=1)
    return rows, rows[np.argsort(off, kind="stable")[:8]]
