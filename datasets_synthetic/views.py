"""What a camera sees of a marker take: bright dots on a dim face.

Pictures come from the forward camera model alone. The face is cast at half resolution, since it
only has to be there; dots are flat discs whose coverage of each pixel is counted on a grid of rays
through the exact inverse of the lens (area anti-aliasing), and which whatever stands before them
hides.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.camera import Camera
from ..core.mesh import vertex_normals
from ..core.rigid import Rigid
from ..heads.raycast import NO_HIT, RayScene
from .takes import Take

SUBSAMPLES = 6  # a side of a pixel
#: Skin this much nearer than a dot is the patch the dot is glued to, bent up around it.
STICKER_TOLERANCE_MM = 2.4
BACKGROUND, SKIN, DOT = 7.0, 46.0, 205.0  # grey levels
READ_NOISE = 0.6  # grey levels
SHOT_NOISE = 0.15  # grey levels at level 1; grows as the square root
_KEY_LIGHT = np.array([0.35, 0.55, 0.76])
_PART_ALBEDO = np.array([1.0, 1.3, 1.3, 0.3, 1.2, 1.2, 0.8])


@dataclass(frozen=True, eq=False)
class View:
    """One picture and what is true of it.

    Attributes
    ----------
    image : (h, w) uint8
    centres : (M, 2) float64, px
        Projections of the dots' centres; NaN where behind the camera.
    visible : (M,) float64
        Share of each dot's picture that is unhidden and inside; 0 for dots facing away.
    """

    image: NDArray[np.uint8]
    centres: NDArray[np.float64]
    visible: NDArray[np.float64]


class TakeCamera:
    """A camera of a take with its lens tabulated: rays through all pixel centres."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        width, height = camera.image_size
        x, y = np.meshgrid(np.arange(-1.0, width + 1), np.arange(-1.0, height + 1))
        #: (h + 2, w + 2, 2): normalised coordinates of pixels, with a border of one
        self.lens = np.ascontiguousarray(camera.undistort(np.stack([x, y], axis=-1)))
        inner = self.lens[1:-1, 1:-1]
        self.coarse = (
            inner[0::2, 0::2] + inner[1::2, 0::2] + inner[0::2, 1::2] + inner[1::2, 1::2]
        ) / 4


class TakeRenderer:
    """Films a take, frame by frame, with all its cameras."""

    def __init__(self, take: Take) -> None:
        self.take = take
        self.cameras = {name: TakeCamera(c) for name, c in take.rig.cameras.items()}
        mesh = take.head.mesh
        # lashes are thin hair, which does not hide a dot; as solid strips they would
        lashes = mesh.groups["lashes"]
        self._triangles = np.delete(mesh.triangles, lashes, axis=0)
        self._albedo = np.ones(len(mesh.triangles), np.float32)
        for i, part in enumerate(mesh.groups):
            self._albedo[mesh.groups[part]] = _PART_ALBEDO[i]
        self._albedo = np.delete(self._albedo, lashes)

    def frame(self, frame: int, rng: np.random.Generator, *, noise: bool = True) -> dict[str, View]:
        """All cameras' pictures of one frame.

        Parameters
        ----------
        frame : int
        rng : numpy Generator
            For the noise.
        noise : bool
            False leaves out shot and read noise.
        """
        take = self.take
        motion = take.head_motion
        world_from_head = Rigid(motion.quaternion[frame], motion.translation[frame])
        head_vertices = take.vertices(frame)
        triangles = take.head.mesh.triangles
        vertices = world_from_head.apply(head_vertices)
        normals = vertex_normals(vertices, triangles)
        centres, facing = take.markers(vertices, normals)
        scene = RayScene(vertices, self._triangles)
        views = {}
        for name, camera in self.cameras.items():
            level = self._skin(camera, scene, vertices, normals.astype(np.float32))
            visible = self._dots(camera, scene, level, centres, facing)
            if noise:
                _add_noise(level, rng)
            image = np.clip(np.rint(level), 0, 255).astype(np.uint8)
            views[name] = View(image, camera.camera.project(centres), visible)
        return views

    def _skin(
        self,
        view: TakeCamera,
        scene: RayScene,
        vertices: NDArray[np.float64],
        normals: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """The dim face over the dark room, (h, w) float32 grey levels."""
        camera = view.camera
        height, width = view.coarse.shape[:2]
        seen = camera.project(vertices[::7]) / 2
        x0, y0 = np.clip(np.nanmin(seen, axis=0) - 4, 0, (width, height)).astype(int)
        x1, y1 = np.clip(np.nanmax(seen, axis=0) + 4, 0, (width, height)).astype(int)
        coarse = np.full((height, width), BACKGROUND, np.float32)
        if x1 > x0 and y1 > y0:
            xy = view.coarse[y0:y1, x0:x1].reshape(-1, 2)
            d = np.column_stack([xy, np.ones(len(xy))]) @ camera.camera_from_world.rotation
            _, triangle, b = scene.cast(camera.position, d)
            patch = np.full(len(xy), BACKGROUND, np.float32)
            _shade(
                triangle, b, self._triangles, normals, self._albedo,
                _KEY_LIGHT.astype(np.float32), patch,
            )  # fmt: skip
            coarse[y0:y1, x0:x1] = patch.reshape(y1 - y0, x1 - x0)
        fine = cv2.resize(coarse, camera.image_size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(fine, dtype=np.float32)

    def _dots(
        self,
        view: TakeCamera,
        scene: RayScene,
        level: NDArray[np.float32],
        centres: NDArray[np.float64],
        normals: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Paint the dots into `level`; return the visible share of each."""
        pose = view.camera.camera_from_world
        c, n = pose.apply(centres), normals @ pose.rotation.T
        radius = self.take.dot_radius_mm
        boxes = _boxes(view.camera, centres, radius)
        rows, columns, dots, cover, depth = _cover(view.lens, c, n, radius, boxes, SUBSAMPLES)
        total = np.bincount(dots, cover, minlength=len(c))
        inside = (rows >= 0) & (rows < level.shape[0]) & (columns >= 0) & (columns < level.shape[1])
        xy = view.lens[rows + 1, columns + 1]
        d = np.column_stack([xy, np.ones(len(xy))])
        t, _, _ = scene.cast(view.camera.position, d @ pose.rotation)
        shown = inside & (t > depth - STICKER_TOLERANCE_MM)
        seen = np.bincount(dots[shown], cover[shown], minlength=len(c))
        away = -np.einsum("mx,mx->m", n, c) / np.linalg.norm(c, axis=1)
        brightness = DOT * (0.55 + 0.45 * np.clip(away, 0, 1))
        _paint(level, rows[shown], columns[shown], cover[shown], brightness[dots[shown]])
        return np.divide(seen, total, out=np.zeros(len(c)), where=total > 0)


def _boxes(
    camera: Camera, centres: NDArray[np.float64], radius: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Pixel boxes (x0, y0, x1, y1) that hold each dot with room to spare; empty if off-screen."""
    width, height = camera.image_size
    pixel = camera.project(centres)
    depth = camera.camera_from_world.apply(centres)[:, 2]
    reach = 1.2 * camera.focal_px * radius / depth + 2
    box = np.concatenate([pixel - reach[:, None], pixel + reach[:, None]], axis=1)
    box = np.where(np.isfinite(box), box, -10)
    low = np.floor(np.clip(box[:, :2], -1, (width, height))).astype(np.int64)
    high = np.ceil(np.clip(box[:, 2:], -1, (width, height))).astype(np.int64)
    return np.concatenate([low, high], axis=1)


@njit(cache=True)
def _cover(lens, centres, normals, radius, boxes, n):  # type: ignore[no-untyped-def]
    """Share of each pixel that each dot covers, by n × n rays; and the dot's depth there."""
    size = 0
    for m in range(len(boxes)):
        size += (boxes[m, 2] - boxes[m, 0] + 1) * (boxes[m, 3] - boxes[m, 1] + 1)
    rows, columns = np.empty(size, np.int64), np.empty(size, np.int64)
    dots, cover, depth = np.empty(size, np.int64), np.empty(size), np.empty(size)
    k = 0
    h, w = lens.shape[0] - 2, lens.shape[1] - 2
    for m in range(len(boxes)):
        c, q = centres[m], normals[m]
        plane = c[0] * q[0] + c[1] * q[1] + c[2] * q[2]
        if plane >= 0:  # faces away
            continue
        for y in range(max(boxes[m, 1], 0), min(boxes[m, 3] + 1, h)):
            for x in range(max(boxes[m, 0], 0), min(boxes[m, 2] + 1, w)):
                inside = 0
                for j in range(n):
                    for i in range(n):
                        # pixel (x, y) spans ± 1/2; lens has a border of one
                        fx, fy = x + 1 + (i + 0.5) / n - 0.5, y + 1 + (j + 0.5) / n - 0.5
                        x0, y0 = int(fx), int(fy)
                        ax, ay = fx - x0, fy - y0
                        u = (1 - ay) * ((1 - ax) * lens[y0, x0, 0] + ax * lens[y0, x0 + 1, 0]) + (
                            ay * ((1 - ax) * lens[y0 + 1, x0, 0] + ax * lens[y0 + 1, x0 + 1, 0])
                        )
                        v = (1 - ay) * ((1 - ax) * lens[y0, x0, 1] + ax * lens[y0, x0 + 1, 1]) + (
                            ay * ((1 - ax) * lens[y0 + 1, x0, 1] + ax * lens[y0 + 1, x0 + 1, 1])
                        )
                        t = plane / (q[0] * u + q[1] * v + q[2])
                        dx, dy, dz = t * u - c[0], t * v - c[1], t - c[2]
                        if dx * dx + dy * dy + dz * dz < radius[m] * radius[m]:
                            inside += 1
                if inside:
                    rows[k], columns[k], dots[k], cover[k] = y, x, m, inside / (n * n)
                    depth[k] = c[2]
                    k += 1
    return rows[:k], columns[:k], dots[:k], cover[:k], depth[:k]


@njit(cache=True)
def _paint(level, rows, columns, cover, brightness):  # type: ignore[no-untyped-def]
    for k in range(len(rows)):
        old = level[rows[k], columns[k]]
        level[rows[k], columns[k]] = old + cover[k] * (brightness[k] - old)


@njit(cache=True)
def _shade(triangle, b, triangles, normals, albedo, light, out):  # type: ignore[no-untyped-def]
    """Lambert with some ambient light."""
    for k in range(len(triangle)):
        f = triangle[k]
        if f == NO_HIT:
            continue
        i0, i1, i2 = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        w1, w2 = b[k, 0], b[k, 1]
        w0 = 1 - w1 - w2
        dot, length = 0.0, 0.0
        for a in range(3):
            x = w0 * normals[i0, a] + w1 * normals[i1, a] + w2 * normals[i2, a]
            dot += x * light[a]
            length += x * x
        lambert = max(0.0, dot / np.sqrt(length + 1e-12))
        out[k] = SKIN * albedo[f] * (0.25 + 0.75 * lambert)


def _add_noise(level: NDArray[np.float32], rng: np.random.Generator) -> None:
    """Shot and read noise, in place; Gaussian, with the variance of both."""
    z = rng.standard_normal(level.shape, dtype=np.float32)
    level += z * np.sqrt(np.float32(READ_NOISE**2) + np.float32(SHOT_NOISE**2) * level)
