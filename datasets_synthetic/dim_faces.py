"""The dim face behind the markers, and the hand before them: at half resolution, since they only
have to be there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .discs import exposure_instants
from .mesh_pictures import SeenMesh, draw_mesh
from .shots import Shot

_SHRINK = 2  # drawn pixels are this many wide
_STEP_PX, _MOST_TIMES = 2.5, 6
_MARGIN_PX = 12
_EDGE_PX = 1.0  # standard deviation that softens edges


def draw_dimly(
    backdrop: NDArray[np.float32],
    shot: Shot,
    meshes: list[SeenMesh],
    shades: list[NDArray[np.float32]],
) -> NDArray[np.float32]:
    """Meshes before a backdrop: as many times as their way in an exposure asks for."""
    import cv2

    found = backdrop.copy()
    window = _window(shot, meshes)
    if window is None:
        return found
    left, top, across, down = window
    exposure_s = shot.optics.exposure_s
    streak_px = _streak_px(meshes, shot.meshes(exposure_s / 2)) if exposure_s else 0.0
    n = int(np.clip(np.ceil(streak_px / _STEP_PX), 1, _MOST_TIMES))
    light = np.zeros((down, across), np.float32)
    # what is seen of the backdrop; so that its own detail is not drawn at half resolution
    open_share = np.zeros_like(light)
    for late_s in exposure_instants(exposure_s, n):
        if n > 1:
            meshes = shot.meshes(late_s)
        once, buffer = np.zeros_like(light), np.full_like(light, np.inf)
        for mesh, shade in zip(meshes, shades, strict=True):
            draw_mesh(once, buffer, mesh.within(left, top, _SHRINK), shade)
        light += once
        open_share += np.isinf(buffer)
    size = across * _SHRINK, down * _SHRINK
    sd_px = _softness_px(shot, meshes[0]) / _SHRINK
    height, width = backdrop.shape
    rows, columns = slice(top, min(top + size[1], height)), slice(left, min(left + size[0], width))
    light, open_share = (
        cv2.resize(
            cv2.GaussianBlur(part / np.float32(n), (0, 0), sd_px, borderType=cv2.BORDER_REPLICATE),
            size,
        )[: rows.stop - top, : columns.stop - left]
        for part in (light, open_share)
    )
    found[rows, columns] = light + open_share * backdrop[rows, columns]
    return found


def _softness_px(shot: Shot, mesh: SeenMesh) -> float:
    """Standard deviation of what softens a mesh's picture."""
    depth = float(np.median(mesh.depth))
    blur_px = shot.optics.blur_diameter_px(depth, shot.camera.focal_px) if depth > 0 else 0.0
    # a disc of diameter d has standard deviation d / 4
    return float(np.sqrt(_EDGE_PX**2 + shot.optics.psf_px**2 + (blur_px / 4) ** 2))


def _window(shot: Shot, meshes: list[SeenMesh]) -> tuple[int, int, int, int] | None:
    """Where the meshes are: left, top, px; width and height, in drawn pixels; room for motion."""
    width, height = shot.camera.image_size
    known = [m.pixels[np.isfinite(m.pixels).all(axis=1)] for m in meshes]
    known = [p for p in known if len(p)]
    if not known:
        return None
    low = np.min([p.min(axis=0) for p in known], axis=0) - _MARGIN_PX
    high = np.max([p.max(axis=0) for p in known], axis=0) + _MARGIN_PX + 1
    x0, y0 = np.clip(low, 0, (width, height)).astype(int) // _SHRINK * _SHRINK
    x1, y1 = np.clip(high, 0, (width, height)).astype(int)
    if x1 <= x0 or y1 <= y0:
        return None
    return int(x0), int(y0), int(-((x0 - x1) // _SHRINK)), int(-((y0 - y1) // _SHRINK))


def _streak_px(middle: list[SeenMesh], end: list[SeenMesh]) -> float:
    """How far meshes move in an exposure, the 99th percentile, px."""
    far = [np.linalg.norm(e.pixels - m.pixels, axis=1) for m, e in zip(middle, end, strict=True)]
    ways = [2 * float(np.nanpercentile(d, 99)) for d in far if np.isfinite(d).any()]
    return max(ways, default=0.0)
