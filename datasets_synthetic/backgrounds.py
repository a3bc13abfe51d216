"""Rooms behind a person: walls, windows, shelves, pictures and plants, painted by chance.

A room is a box around the person. Each wall is a painted canvas; a camera sees the walls that its
rays meet, so that all cameras of a rig see one room, with the right parallax. Everything is far out
of focus, which is why flat paint does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.camera import Camera
from .furniture import (
    PX_PER_MM,
    canvas_of,
    furnish,
    lit,
    paint_floor,
    paint_skirting,
    random_hue,
)
from .optics import Optics

Floats = NDArray[np.float32]
Kind = Literal["clutter", "studio"]

_GRID_PX = 8  # rays are inverted on a grid this wide and interpolated
_PAINT_BLUR_MM = 7.0  # takes the edge off the brush
_PSF_PX = 0.6


@dataclass(frozen=True, eq=False)
class Wall:
    """A painted rectangle.

    Attributes
    ----------
    corner : (3,) float64, mm, room frame
        Of the canvas's top left.
    right, down : (3,) float64
        Unit vectors along the canvas.
    size_mm : (float, float)
        Width and height.
    paint : (h, w, 3) float32, linear
    """

    corner: NDArray[np.float64]
    right: NDArray[np.float64]
    down: NDArray[np.float64]
    size_mm: tuple[float, float]
    paint: Floats


class Room:
    """A room around a person.

    Parameters
    ----------
    kind : "clutter" or "studio"
    seed : int
        The same seed paints the same room.

    Attributes
    ----------
    walls : tuple of Wall
        Facing inwards. Room frame: the world's, with the person's eyes at the origin, +z where
        the person looks.
    """

    def __init__(self, kind: Kind, seed: int) -> None:
        if kind not in ("clutter", "studio"):
            raise ValueError(f'a room must be "clutter" or "studio", not {kind!r}')
        rng = np.random.default_rng([seed, 40])
        self.kind = kind
        self.walls = _studio_walls(rng) if kind == "studio" else _cluttered_walls(rng)

    def seen_by(self, camera: Camera, optics: Optics) -> Floats:
        """What a camera sees of the room.

        Parameters
        ----------
        camera : Camera
            Inside the room or out of it: walls are seen from within only.
        optics : Optics
            Its focus blurs the walls by their distance.

        Returns
        -------
        (h, w, 3) float32, linear
        """
        width, height = camera.image_size
        d = _ray_grid(camera)
        found = np.zeros((height, width, 3), np.float32)
        depth = np.full((height, width), np.inf, np.float32)
        forward = camera.camera_from_world.rotation[2]
        for wall in self.walls:
            normal = np.cross(wall.right, wall.down)  # away from the room
            height_mm = float((wall.corner - camera.position) @ normal)
            slope = d @ normal.astype(np.float32)
            if height_mm <= 0:
                continue
            t = np.where(slope > 1e-6, height_mm / np.maximum(slope, 1e-6), np.inf)
            t = t.astype(np.float32)
            start = camera.position - wall.corner
            with np.errstate(invalid="ignore"):
                x = t * (d @ wall.right.astype(np.float32)) + np.float32(start @ wall.right)
                y = t * (d @ wall.down.astype(np.float32)) + np.float32(start @ wall.down)
                there = (x >= 0) & (y >= 0) & (x <= wall.size_mm[0]) & (y <= wall.size_mm[1])
                there &= t < depth
            if not there.any():
                continue
            px = np.where(there, x * PX_PER_MM - 0.5, -9).astype(np.float32)
            py = np.where(there, y * PX_PER_MM - 0.5, -9).astype(np.float32)
            picture = cv2.remap(
                wall.paint, px, py, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            found[there] = picture[there]
            depth[there] = (t * (d @ forward.astype(np.float32)))[there]
        return _out_of_focus(found, depth, optics, camera.focal_px)


def _ray_grid(camera: Camera) -> Floats:
    """Directions (h, w, 3) of all pixels, interpolated from a grid."""
    width, height = camera.image_size
    nx, ny = -(-width // _GRID_PX) + 1, -(-height // _GRID_PX) + 1
    x, y = np.arange(nx) * float(_GRID_PX), np.arange(ny) * float(_GRID_PX)
    coarse = camera.ray(np.stack(np.meshgrid(x, y), axis=-1))
    # where a lens folds, beyond the picture's corners at most, the neighbour serves
    coarse = np.where(np.isfinite(coarse), coarse, camera.camera_from_world.rotation[2])
    mx, my = np.meshgrid(
        np.arange(width, dtype=np.float32) / _GRID_PX,
        np.arange(height, dtype=np.float32) / _GRID_PX,
    )
    return np.asarray(
        cv2.remap(
            coarse.astype(np.float32), mx, my, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
        )
    )


def _out_of_focus(light: Floats, depth: Floats, optics: Optics, focal_px: float) -> Floats:
    """Blur by the circle of confusion at the walls' median distance (discs keep their rims)."""
    known = np.isfinite(depth)
    if known.any():
        diameter = optics.blur_diameter_px(float(np.median(depth[known])), focal_px)
        if diameter > 1.5:
            radius = int(np.ceil(diameter / 2)) + 1
            y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
            disc = np.clip(diameter / 2 + 0.5 - np.hypot(x, y), 0, 1).astype(np.float32)
            light = cv2.filter2D(light, -1, disc / disc.sum(), borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.GaussianBlur(light, (0, 0), _PSF_PX), dtype=np.float32)


def _box_walls(
    half_width: float,
    behind: float,
    before: float,
    below: float,
    above: float,
    paint: Callable[[str, tuple[float, float]], Floats],
) -> tuple[Wall, ...]:
    """The six sides of a room whose origin is the person's head, seen from within."""
    X, Y, Z = np.eye(3)
    w, depth, h = 2 * half_width, behind + before, below + above
    sides = {  # name: corner, right, down as one sees it from inside, size
        "back": ((-half_width, above, -behind), X, -Y, (w, h)),
        "front": ((half_width, above, before), -X, -Y, (w, h)),
        "left": ((-half_width, above, before), -Z, -Y, (depth, h)),
        "right": ((half_width, above, -behind), Z, -Y, (depth, h)),
        "floor": ((-half_width, -below, -behind), X, Z, (w, depth)),
        "ceiling": ((-half_width, above, before), X, -Z, (w, depth)),
    }
    return tuple(
        Wall(np.array(corner, dtype=np.float64), right, down, size, paint(name, size))
        for name, (corner, right, down, size) in sides.items()
    )


def _studio_walls(rng: np.random.Generator) -> tuple[Wall, ...]:
    """A paper sweep in one colour with a pool of light behind the person."""
    tint = random_hue(rng, 0.25) * rng.uniform(0.10, 0.45)

    def paint(name: str, size: tuple[float, float]) -> Floats:
        canvas = canvas_of(size, tint)
        h, w = canvas.shape[:2]
        y, x = np.mgrid[0:h, 0:w].astype(np.float32)
        if name == "back":
            off = np.hypot(x - 0.5 * w, 1.2 * (y - 0.42 * h)) / (0.5 * w)
            canvas *= (0.55 + 0.9 * np.exp(-2.2 * off**2))[..., None]
        else:
            canvas *= {"floor": 0.45, "ceiling": 0.3, "front": 0.25}.get(name, 0.5)
            if name in ("left", "right"):
                near = x / w if name == "left" else 1 - x / w
                canvas *= (0.6 + 0.5 * near)[..., None]
        return canvas

    return _box_walls(2300, 2100, 3000, 1200, 1500, paint)


def _cluttered_walls(rng: np.random.Generator) -> tuple[Wall, ...]:
    """A furnished room."""
    half_width = float(rng.uniform(1500, 2400))
    behind, before = float(rng.uniform(1300, 2600)), float(rng.uniform(2200, 3000))
    below, above = 1180.0, float(rng.uniform(1250, 1500))
    base = random_hue(rng, 0.08) * rng.uniform(0.16, 0.48)
    accent = random_hue(rng, 0.3) * rng.uniform(0.08, 0.25)
    has_accent = rng.random() < 0.35
    window_side = str(rng.choice(["back", "left", "right"], p=[0.25, 0.375, 0.375]))
    floor = np.array([0.30, 0.20, 0.12]) * rng.uniform(0.4, 1.3)

    def paint(name: str, size: tuple[float, float]) -> Floats:
        own = np.random.default_rng([int(rng.integers(2**31))])
        if name == "floor":
            return paint_floor(own, size, floor)
        if name == "ceiling":
            return lit(canvas_of(size, np.array([0.62, 0.61, 0.58])), own, 0.3)
        canvas = canvas_of(size, accent if has_accent and name == "back" else base)
        canvas = lit(canvas, own, 0.35)
        paint_skirting(own, canvas)
        if name != "front":
            furnish(own, canvas, with_window=name == window_side)
        sigma = _PAINT_BLUR_MM * PX_PER_MM
        return np.asarray(cv2.GaussianBlur(canvas, (0, 0), sigma), dtype=np.float32)

    return _box_walls(half_width, behind, before, below, above, paint)
