"""Taking the photographs of a session: from light to the numbers of a JPEG.

A picture is made in strips of rows, so that memory does not grow with its size by more than a
few copies. The curve is a camera's own: sensor noise first, then white balance, then the shoulder
and sRGB (`sensor.develop` has one power for all and no white balance).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..core.camera import Camera
from ..core.rigid import Rigid
from ..heads.bust import make_bust
from ..heads.layers import ExtraMesh, Layers, film_curve
from ..heads.raycast import NO_HIT
from ..heads.render import HeadRenderer
from ..heads.srgb import srgb_from_linear
from .backgrounds import Room
from .focus_blur import blur_by_depth
from .lens_light import apply_lens_light
from .optics import Optics
from .photos import PhotoSession, PhotoShot

Floats = NDArray[np.float32]

_STRIP_ROWS = 320
_LARGE_PX = 1600
_N_LEVELS = 16384  # of linear light
_FACE_LIGHT = 0.24  # linear luminance at which meters put a face
_SHIRTS = ((70, 80, 100), (120, 50, 50), (60, 90, 78), (196, 194, 188), (48, 48, 54), (146, 128, 100))  # fmt: skip  # noqa: E501


class Photographer:
    """Takes the pictures of a session.

    Parameters
    ----------
    session : PhotoSession
    """

    def __init__(self, session: PhotoSession) -> None:
        self.session = session
        rng = np.random.default_rng([session.seed, 82])
        shirt = _SHIRTS[int(rng.integers(len(_SHIRTS)))]
        bust = make_bust(
            session.head, shirt=shirt, broadness=float(rng.uniform(0.2, 0.9)), seed=session.seed
        )
        vertices = bust.at(np.asarray(session.head.mesh.vertices), Rigid.identity())
        self.bust = ExtraMesh(vertices, bust.triangles, bust.colour.astype(np.float32))
        self._room = Room("clutter", session.seed)

    def take(self, shot: PhotoShot) -> NDArray[np.uint8]:
        """One photograph, held upright: (h, w, 3) uint8, sRGB."""
        light, face = self._light(shot)
        exposure = 1.0
        if not self.session.settings.uniform:
            exposure = _FACE_LIGHT / max(face, 1e-4) * 2**shot.exposure_stops
        light = apply_lens_light(light, shot.optics, shot.camera)
        return _developed(light, shot, exposure, curved=not self.session.settings.uniform)

    def _light(self, shot: PhotoShot) -> tuple[Floats, float]:
        """The picture in linear light, before the lens's own losses; and the face's luminance."""
        c, s = np.cos(shot.stage_yaw_rad), np.sin(shot.stage_yaw_rad)
        stage = Rigid.from_rotation([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        head = self.session.head
        renderer = HeadRenderer(head, quick=True, lights=shot.lights, stage=stage)
        found = _seen(self._room, shot)
        vertices = np.asarray(head.mesh.vertices)
        all_vertices = np.concatenate([vertices, self.bust.vertices])
        triangles = np.concatenate(
            [head.mesh.triangles, self.bust.triangles + np.int32(len(vertices))]
        )
        z = shot.camera.camera_from_world.apply(all_vertices)[:, 2].astype(np.float32)
        reach = _reach_px(z, shot.optics, shot.camera.focal_px)
        on_skin = np.zeros(len(head.mesh.triangles) + 1, bool)
        on_skin[head.mesh.groups["skin"]] = True
        metered = [0.0, 0.0]
        for strip, first, rows in _strips(shot.camera, reach):
            layers = renderer.render_layers(vertices, strip, extra=(self.bust,))
            if not layers.light.size:
                continue
            is_skin = on_skin[np.minimum(layers.triangle, len(on_skin) - 1)]
            metered[0] += float((layers.light[is_skin] @ (0.2126, 0.7152, 0.0722)).sum())
            metered[1] += float(is_skin.sum())
            layers = _whole(layers, strip.image_size)
            depth = _depth(layers, triangles, z)
            light, cover = blur_by_depth(
                layers.light, layers.cover, depth, shot.optics, shot.camera.focal_px
            )
            own = slice(rows.start - first, rows.stop - first)
            behind = found[rows]
            behind *= (1 - cover[own])[..., None]
            behind += light[own]
        return found, metered[0] / max(metered[1], 1.0)


def _seen(room: Room, shot: PhotoShot) -> Floats:
    """The room behind, far out of focus: of large pictures, every other pixel will do."""
    import cv2

    camera = shot.camera
    width, height = camera.image_size
    if max(width, height) < _LARGE_PX or width % 2 or height % 2:
        return np.array(room.seen_by(camera, shot.optics))
    K = camera.matrix.copy()
    K[:2] /= 2
    K[:2, 2] -= 0.25  # pixel centres: (x + 0.5) / 2 - 0.5
    size = width // 2, height // 2
    half = Camera(size, K, camera.camera_from_world, camera.distortion_model, camera.distortion)
    return np.asarray(cv2.resize(room.seen_by(half, shot.optics), (width, height)))


def _strips(camera: Camera, reach: int) -> Iterator[tuple[Camera, int, slice]]:
    """Cameras of strips of the picture with `reach` rows more on either side, their first row,
    and the picture's rows that they are for."""
    width, height = camera.image_size
    for start in range(0, height, _STRIP_ROWS):
        stop = min(start + _STRIP_ROWS, height)
        first, last = max(start - reach, 0), min(stop + reach, height)
        K = camera.matrix.copy()
        K[1, 2] -= first
        strip = Camera(
            (width, last - first),
            K,
            camera.camera_from_world,
            camera.distortion_model,
            camera.distortion,
        )
        yield strip, first, slice(start, stop)


def _reach_px(z: Floats, optics: Optics, focal_px: float) -> int:
    """How far light goes within the picture out of focus."""
    ends = float(z.min()), float(z.max())
    return int(np.ceil(2 * max(optics.blur_diameter_px(d, focal_px) for d in ends))) + 4


def _whole(layers: Layers, size: tuple[int, int]) -> Layers:
    """Layers over the whole of their picture."""
    x0, y0, x1, y1 = layers.box
    pad = (y0, size[1] - y1), (x0, size[0] - x1)
    return Layers(
        np.pad(layers.light, (*pad, (0, 0))),
        np.pad(layers.cover, pad),
        np.pad(layers.triangle, pad, constant_values=NO_HIT),
        np.pad(layers.weights, (*pad, (0, 0))),
        (0, 0, *size),
    )


def _depth(layers: Layers, triangles: NDArray[np.int32], z: Floats) -> Floats:
    """Depth of every pixel, (h, w) float32, mm; one for all where nothing is, in every strip."""
    found = np.full(layers.triangle.shape, np.median(z), np.float32)
    hit = layers.triangle != NO_HIT
    w = layers.weights[hit]
    corners = z[triangles[layers.triangle[hit]]]
    found[hit] = (1 - w.sum(axis=1)) * corners[:, 0] + (w * corners[:, 1:]).sum(axis=1)
    return found


def _developed(
    light: Floats, shot: PhotoShot, exposure: float, *, curved: bool
) -> NDArray[np.uint8]:
    """What the camera makes of light: noise, white balance, the film's shoulder, sRGB."""
    rng = np.random.default_rng([shot.seed, 83])
    out = np.empty(light.shape, np.uint8)
    gains = shot.white_balance.astype(np.float32)
    read2 = np.float32((shot.read_noise_e / shot.full_well_e) ** 2)
    for start in range(0, len(light), _STRIP_ROWS):
        raw = np.maximum(light[start : start + _STRIP_ROWS] * np.float32(exposure), 0)
        noise = rng.standard_normal(raw.shape, dtype=np.float32)
        raw += noise * np.sqrt(raw / np.float32(shot.full_well_e) + read2)
        raw *= gains
        shown = film_curve(raw) if curved else raw
        out[start : start + _STRIP_ROWS] = srgb_from_linear(shown, n_levels=_N_LEVELS)
    return out
