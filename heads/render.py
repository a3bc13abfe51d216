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
from numba import njit
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.camera import Camera
from ..core.errors import InputError
from ..core.rigid import Rigid
from .appearance import linear_from_srgb
from .head import Head
from .raycast import NO_HIT, RayScene

Floats = NDArray[np.float32]

#: Part codes of the shading loop.
_SKIN, _EYE, _EYE_LEFT, _LASH, _TEETH, _TONGUE = range(6)
_CODE = {
    "eye_right": _EYE,
    "eye_left": _EYE_LEFT,
    "lashes": _LASH,
    "teeth_upper": _TEETH,
    "teeth_lower": _TEETH,
    "tongue": _TONGUE,
}
#: Lights of the stage: towards them (x left of the subject, y up, z out of the face), and colour.
_KEY_TO = np.array([-0.52, 0.55, 0.80])
_KEY_SPREAD, _KEY_RAYS = 0.30, 10
_RIM_SPREAD, _RIM_RAYS = 0.25, 4
_KEY_COLOUR = np.array([1.00, 0.92, 0.83]) * 2.75
_FILL_TO = np.array([0.85, 0.10, 0.75])
_FILL_COLOUR = np.array([0.80, 0.90, 1.00]) * 0.36
_RIM_TO = np.array([0.80, 0.45, -0.75])
_RIM_COLOUR = np.array([0.85, 0.93, 1.00]) * 1.5
_SKY_COLOUR = np.array([0.94, 0.97, 1.03]) * 0.37
_GROUND_COLOUR = np.array([1.0, 0.86, 0.78]) * 0.18
_SKY_RAYS, _SKY_REACH_MM = 20, 70.0
_EYE_RAYS, _EYE_REACH_MM = 14, 14.0
_OFFSET_MM = 0.25  # rays for shadows start this far off the surface
_LASH_LAYERS = 3
_EXPOSURE = 1.0
_SHOULDER = 0.5  # of white: light above is compressed
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
        self._part = np.full(len(self._triangles), _SKIN, dtype=np.uint8)
        for name, code in _CODE.items():
            if name in mesh.groups and (looks.eye is not None or code > _EYE_LEFT):
                self._part[mesh.groups[name]] = code
        if looks.details is None:
            self._part[self._part >= _LASH] = _SKIN
        self._skin = _pyramid(looks.skin)
        rough = np.full((4, 4), 128, np.uint8) if looks.roughness is None else looks.roughness
        self._roughness = np.ascontiguousarray(rough)
        self._eye = np.ascontiguousarray(looks.skin if looks.eye is None else looks.eye)
        self._details = (
            np.zeros((4, 4, 4), np.uint8)
            if looks.details is None
            else np.ascontiguousarray(looks.details)
        )
        turn = np.eye(3) if stage is None else stage.rotation
        self._lights = np.stack(
            [turn @ (v / np.linalg.norm(v)) for v in (_KEY_TO, _FILL_TO, _RIM_TO, np.eye(3)[1])]
        ).astype(np.float32)
        self._key_rays = _cone(self._lights[0], _KEY_SPREAD, _KEY_RAYS)
        self._rim_rays = _cone(self._lights[2], _RIM_SPREAD, _RIM_RAYS)
        self._sky_rays = _sphere(_SKY_RAYS * 2)
        self._eye_fronts = {
            code: _front_rows(self._triangles, self._uv_triangles, self._uv, self._part == code)
            for code in (_EYE, _EYE_LEFT)
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
        return _encode((np.clip(light, 0.05, None) ** 1.6)[..., None] * colour.astype(np.float32))

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
        normals = _normals(local, self._triangles)
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
            self._eye, self._details, _LINEAR, self._lights, n, light, cover,
        )  # fmt: skip
        _in_threads(_shade, arguments, y1 - y0)
        behind = linear_from_srgb(picture[y0:y1, x0:x1]).astype(np.float32)
        seen = cover > 0
        mixed = light[seen] + (1 - cover[seen])[:, None] * behind[seen]
        picture[y0:y1, x0:x1][seen] = _encode(mixed)
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
            rows = rows[self._part[triangle[rows]] == _LASH]
            if not len(rows):
                break
            alpha = self._lash_alpha(triangle[rows], weights[rows])
            hidden[rows] += (1 - hidden[rows]) * alpha
            start = usable[rows] * (t[rows] + 0.02)[:, None]
            further, triangle[rows], weights[rows] = scene.cast(start, usable[rows])
            t[rows] += 0.02 + further
        rows = np.flatnonzero(triangle != NO_HIT)
        last = rows[self._part[triangle[rows]] == _LASH]
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
        rows = np.unique(self._triangles[hit & (self._part != _EYE) & (self._part != _EYE_LEFT)])
        lamps, sky = np.ones((len(local), 2), np.float32), np.ones(len(local), np.float32)
        start, n = local[rows] + _OFFSET_MM * normals[rows], normals[rows]
        for lamp, rays in enumerate((self._key_rays, self._rim_rays)):
            facing = n @ rays.T > -0.25
            blocked = _blocked(scene, start, rays, facing, np.inf)
            lamps[rows, lamp] = 1 - blocked.sum(axis=1) / np.maximum(facing.sum(axis=1), 1)
        cosine = np.clip(n @ self._sky_rays.T, 0, None)
        blocked = _blocked(scene, start, self._sky_rays, cosine > 0.05, _SKY_REACH_MM)
        sky[rows] = 1 - (blocked * cosine).sum(axis=1) / np.maximum(cosine.sum(axis=1), 1e-6)
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
        on_eye = (part == _EYE) | (part == _EYE_LEFT)
        rows = rows[0][on_eye], rows[1][on_eye]
        if not len(rows[0]):
            return found
        w = weights[rows]
        corners = local[self._triangles[triangle[rows]]]
        b = np.stack([1 - w.sum(axis=1), w[:, 0], w[:, 1]], axis=1)
        place = np.einsum("nc,ncx->nx", b, corners)
        out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
        rays = _cone(self._lights[0] + 0.64 * self._lights[3], 0.95, _EYE_RAYS)
        start = (place + 0.1 * out).astype(np.float32)
        facing = np.ones((len(start), len(rays)), bool)
        blocked = _blocked(scene, start, rays, facing, _EYE_REACH_MM)
        found[rows] = 1 - blocked.mean(axis=1)
        return found

    def _eye_axes(self, local: Floats) -> Floats:
        """Where the right and the left eye look, (2, 3) unit vectors."""
        found = np.zeros((2, 3), np.float32)
        for code, (ball, front) in self._eye_fronts.items():
            centre = (local[ball].min(axis=0) + local[ball].max(axis=0)) / 2
            axis = local[front].mean(axis=0) - centre
            found[code - _EYE] = axis / np.linalg.norm(axis)
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


def _cone(axis: NDArray[Any], spread: float, count: int) -> Floats:
    """Directions about an axis within `spread` rad, evenly (sunflower), (count, 3)."""
    w = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    u = np.cross(w, np.eye(3)[np.argmin(np.abs(w))])
    u /= np.linalg.norm(u)
    i = np.arange(count)
    radius = np.tan(spread) * np.sqrt((i + 0.5) / count)
    turn = i * np.pi * (3 - np.sqrt(5))
    d = w + radius[:, None] * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * np.cross(w, u))
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True), dtype=np.float32)


def _sphere(count: int) -> Floats:
    """Evenly spread directions (Fibonacci), (count, 3)."""
    i = np.arange(count)
    z = 1 - (2 * i + 1) / count
    turn = i * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1).astype(np.float32)


def _blocked(
    scene: RayScene, start: Floats, rays: Floats, wanted: NDArray[np.bool_], reach_mm: float
) -> Floats:
    """How much each ray (N, M) is blocked: 1 near, falling to 0 at the reach."""
    found = np.zeros(wanted.shape, np.float32)
    row, ray = np.nonzero(wanted)
    if not len(row):
        return found
    t, *_ = scene.cast(start[row], rays[ray])
    if np.isinf(reach_mm):
        found[row, ray] = np.isfinite(t)
    else:
        found[row, ray] = np.clip(1 - np.minimum(t, reach_mm) / reach_mm, 0, 1) ** 0.8
    return found


def _in_threads(function: Any, arguments: tuple[Any, ...], n_rows: int) -> None:
    """Call a compiled loop over rows, which lets go of the interpreter, on all cores."""
    cores = min(os.cpu_count() or 1, 8)
    bounds = np.linspace(0, n_rows, 4 * cores + 1).astype(int)
    with ThreadPoolExecutor(cores) as pool:
        jobs = [pool.submit(function, *(*arguments, a, b)) for a, b in pairwise(bounds)]
        for job in jobs:
            job.result()


_LINEAR = linear_from_srgb(np.arange(256)).astype(np.float32)
_GRID = np.arange(8192) / 8191
_SRGB = np.rint(
    255 * np.where(_GRID <= 0.0031308, _GRID * 12.92, 1.055 * _GRID ** (1 / 2.4) - 0.055)
).astype(np.uint8)


def _encode(light: Floats) -> NDArray[np.uint8]:
    """sRGB of linear light 0 to 1."""
    return np.asarray(_SRGB[np.clip(light * 8191 + 0.5, 0, 8191).astype(np.int32)])


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


@njit(cache=True)
def _normals(v, triangles):  # type: ignore[no-untyped-def]
    """Area-weighted unit normals (V, 3)."""
    n = np.zeros_like(v)
    for f in range(len(triangles)):
        a, b, c = triangles[f]
        e0, e1, e2 = v[b, 0] - v[a, 0], v[b, 1] - v[a, 1], v[b, 2] - v[a, 2]
        g0, g1, g2 = v[c, 0] - v[a, 0], v[c, 1] - v[a, 1], v[c, 2] - v[a, 2]
        x, y, z = e1 * g2 - e2 * g1, e2 * g0 - e0 * g2, e0 * g1 - e1 * g0
        for k in (a, b, c):
            n[k, 0] += x
            n[k, 1] += y
            n[k, 2] += z
    for i in range(len(n)):
        length = np.sqrt(n[i, 0] ** 2 + n[i, 1] ** 2 + n[i, 2] ** 2)
        if length > 0:
            n[i] /= length
    return n


@njit(cache=True, nogil=True, inline="always")
def _texel(picture, linear, u, v, out):  # type: ignore[no-untyped-def]
    """Bilinear lookup in linear light; v counts from the bottom."""
    height, width = picture.shape[0], picture.shape[1]
    x = min(max(u * width - 0.5, 0.0), width - 1.001)
    y = min(max((1 - v) * height - 0.5, 0.0), height - 1.001)
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    for c in range(3):
        top = linear[picture[j, i, c]] * (1 - fx) + linear[picture[j, i + 1, c]] * fx
        low = linear[picture[j + 1, i, c]] * (1 - fx) + linear[picture[j + 1, i + 1, c]] * fx
        out[c] = top * (1 - fy) + low * fy


@njit(cache=True, nogil=True, inline="always")
def _highlight(n, view, light, roughness, f0):  # type: ignore[no-untyped-def]
    """Cook-Torrance with GGX (Walter et al. 2007), times the cosine to the light."""
    nl = n[0] * light[0] + n[1] * light[1] + n[2] * light[2]
    nv = n[0] * view[0] + n[1] * view[1] + n[2] * view[2]
    if nl <= 0 or nv <= 0:
        return 0.0
    h0, h1, h2 = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    length = np.sqrt(h0 * h0 + h1 * h1 + h2 * h2)
    nh = (n[0] * h0 + n[1] * h1 + n[2] * h2) / length
    vh = (view[0] * h0 + view[1] * h1 + view[2] * h2) / length
    a2 = roughness**4
    d = nh * nh * (a2 - 1) + 1
    k = 0.5 * roughness * roughness
    shadow = 1 / ((nl * (1 - k) + k) * (nv * (1 - k) + k) * 4)
    fresnel = f0 + (1 - f0) * (1 - vh) ** 5
    return a2 / (np.pi * d * d) * shadow * fresnel * nl


@njit(cache=True, nogil=True, inline="always")
def _window(n, view, light):  # type: ignore[no-untyped-def]
    """How much of a round soft box about `light` the mirror `n` shows, 0 to 1."""
    nv = n[0] * view[0] + n[1] * view[1] + n[2] * view[2]
    seen = 0.0
    for k in range(3):
        seen += (2 * nv * n[k] - view[k]) * light[k]
    return min(max((seen - 0.955) / 0.02, 0.0), 1.0)


@njit(cache=True, nogil=True)
def _shade(  # type: ignore[no-untyped-def]
    triangle, weights, lash, directions, triangles, uv_triangles, uv, part, normals, lamps, sky,
    eye_light, axes, skin, roughness, eye, details, linear, lights, n_side, light_out, cover_out,
    first_row, last_row,
):  # fmt: skip
    """Light (premultiplied) and coverage of rows of pixels."""
    albedo, n = np.zeros(3, np.float32), np.zeros(3, np.float32)
    view, shine = np.zeros(3, np.float32), np.zeros(3, np.float32)
    lash_colour = np.zeros(3, np.float32)
    _texel(details[:, :, :3], linear, 0.5, 0.1, lash_colour)
    for y in range(first_row, last_row):
        for x in range(light_out.shape[1]):
            sum0, sum1, sum2, cover = 0.0, 0.0, 0.0, 0.0
            for s in range(n_side * n_side):
                j, i = y * n_side + s // n_side, x * n_side + s % n_side
                hidden = lash[j, i]
                f = triangle[j, i]
                if f == 4294967295:
                    cover += hidden
                    sum0 += hidden * lash_colour[0]
                    sum1 += hidden * lash_colour[1]
                    sum2 += hidden * lash_colour[2]
                    continue
                w1, w2 = weights[j, i, 0], weights[j, i, 1]
                w0 = 1 - w1 - w2
                a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
                ta, tb, tc = uv_triangles[f, 0], uv_triangles[f, 1], uv_triangles[f, 2]
                u = w0 * uv[ta, 0] + w1 * uv[tb, 0] + w2 * uv[tc, 0]
                v = w0 * uv[ta, 1] + w1 * uv[tb, 1] + w2 * uv[tc, 1]
                length = 0.0
                for k in range(3):
                    n[k] = w0 * normals[a, k] + w1 * normals[b, k] + w2 * normals[c, k]
                    view[k] = -directions[j, i, k]
                    length += n[k] * n[k]
                length = np.sqrt(max(length, 1e-12))
                for k in range(3):
                    n[k] /= length
                nv = n[0] * view[0] + n[1] * view[1] + n[2] * view[2]
                kind = part[f]
                # rounded barycentric weights may be just below 0, and powers are taken below
                lit = max(w0 * lamps[a, 0] + w1 * lamps[b, 0] + w2 * lamps[c, 0], 0.0)
                rim_lit = max(w0 * lamps[a, 1] + w1 * lamps[b, 1] + w2 * lamps[c, 1], 0.0)
                open_ = max(w0 * sky[a] + w1 * sky[b] + w2 * sky[c], 0.0)
                wrap_r, wrap_gb, f0, rough, gain = 0.30, 0.12, 0.028, 0.5, 1.0
                if kind == _SKIN:
                    _texel(skin, linear, u, v, albedo)
                    rx = min(int(u * roughness.shape[1]), roughness.shape[1] - 1)
                    ry = min(int((1 - v) * roughness.shape[0]), roughness.shape[0] - 1)
                    rough = roughness[max(ry, 0), max(rx, 0)] / 255.0
                    gain = 1.0 - 0.6 * max(rough - 0.6, 0.0) / 0.4
                elif kind <= _EYE_LEFT:
                    _texel(eye, linear, u, v, albedo)
                    lit = eye_light[j, i]
                    lit = 0.18 + 0.82 * lit * lit
                    open_ = lit
                    wrap_r, wrap_gb, f0, rough = 0.35, 0.30, 0.03, 0.10
                else:
                    _texel(details[:, :, :3], linear, u, v, albedo)
                    wrap_r, wrap_gb, f0, rough = 0.35, 0.25, 0.04, 0.28
                    if kind == _TEETH:
                        lit *= np.sqrt(open_)
                if nv < 0 and kind == _SKIN:  # the inside of the cut neck
                    albedo[0] *= 0.05
                    albedo[1] *= 0.05
                    albedo[2] *= 0.05
                lit_r = lit**0.75  # blood carries red light into the shadow
                nk = n[0] * lights[0, 0] + n[1] * lights[0, 1] + n[2] * lights[0, 2]
                nf = n[0] * lights[1, 0] + n[1] * lights[1, 1] + n[2] * lights[1, 2]
                nr = n[0] * lights[2, 0] + n[1] * lights[2, 1] + n[2] * lights[2, 2]
                up = n[0] * lights[3, 0] + n[1] * lights[3, 1] + n[2] * lights[3, 2]
                key_r = max(0.0, (nk + wrap_r) / (1 + wrap_r)) * lit_r
                key_g = max(0.0, (nk + wrap_gb) / (1 + wrap_gb)) * lit
                fill = max(0.0, (nf + 0.3) / 1.3) * open_
                rim = max(0.0, nr) * rim_lit * (1 - min(max(nv, 0.0), 1.0)) ** 1.5
                sky_share = 0.5 + 0.5 * up
                # light that bounces within a hollow takes the skin's colour (Jimenez et al. 2016)
                for k in range(3):
                    shade = open_
                    if kind == _SKIN or kind > _EYE_LEFT:
                        q = albedo[k]
                        bounce = ((2.0404 * q - 0.3324) * open_ - 4.7951 * q + 0.6417) * open_
                        shade = max(open_, (bounce + 2.7552 * q + 0.6903) * open_)
                    around = (
                        _SKY_COLOUR[k] * sky_share + _GROUND_COLOUR[k] * (1 - sky_share)
                    ) * shade
                    direct = _KEY_COLOUR[k] * (key_r if k == 0 else key_g)
                    direct += _FILL_COLOUR[k] * fill + _RIM_COLOUR[k] * rim
                    shine[k] = albedo[k] * (direct * 0.3183 * 1.15 + around)
                if kind in (_EYE, _EYE_LEFT):
                    # the cornea bulges: its normal turns faster than the ball's
                    axis = axes[kind - _EYE]
                    turn = 0.0
                    for k in range(3):
                        turn += n[k] * axis[k]
                    dome = min(max((turn - 0.86) / 0.06, 0.0), 1.0)
                    length = 0.0
                    for k in range(3):
                        n[k] = axis[k] + (n[k] - axis[k]) * (1 + 0.75 * dome)
                        length += n[k] * n[k]
                    for k in range(3):
                        n[k] /= np.sqrt(length)
                    glint = _window(n, view, lights[0]) * dome * lit
                    wet = _highlight(n, view, lights[0], 0.20, 0.03) * lit * (1 - dome) * 0.5
                    flare = _highlight(n, view, lights[1], 0.22, 0.03) * lit
                    for k in range(3):
                        shine[k] += 0.85 * glint + _KEY_COLOUR[k] * wet + _FILL_COLOUR[k] * flare
                else:
                    first = _highlight(n, view, lights[0], rough, f0) * lit
                    second = _highlight(n, view, lights[1], rough, f0) * open_ * open_
                    third = _highlight(n, view, lights[2], rough, f0) * rim_lit * 0.8
                    for k in range(3):
                        shine[k] += gain * (
                            _KEY_COLOUR[k] * first
                            + _FILL_COLOUR[k] * second
                            + _RIM_COLOUR[k] * third
                        )
                    edge = (1 - min(max(nv, 0.0), 1.0)) ** 4 * 0.06 * open_ * gain
                    for k in range(3):
                        shine[k] += _SKY_COLOUR[k] * edge
                for k in range(3):
                    q = shine[k] * _EXPOSURE
                    if q > _SHOULDER:  # nothing clips hard
                        q = 1 - (1 - _SHOULDER) * np.exp((_SHOULDER - q) / (1 - _SHOULDER))
                    shine[k] = q * (1 - hidden) + hidden * lash_colour[k]
                sum0 += shine[0]
                sum1 += shine[1]
                sum2 += shine[2]
                cover += 1.0
            count = n_side * n_side
            light_out[y, x, 0] = sum0 / count
            light_out[y, x, 1] = sum1 / count
            light_out[y, x, 2] = sum2 / count
            cover_out[y, x] = cover / count
