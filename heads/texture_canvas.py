"""A texture as a list of places on the skin, and back: what painters paint on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from .template import Template
from .texture_layout import appearance_uv

Floats = NDArray[np.float32]

_WIDEST_TEXEL_MM = 2.0  # at 2048 texels; places further apart lie on two islands


@dataclass(frozen=True, eq=False)
class Canvas:
    """A square picture over the skin's coordinates.

    Attributes
    ----------
    texels : (N,) int64, flat indices that skin covers
    places : (N, 3) float32, mm on the template
    masks : mapping from name to (N,) float32
        Those of the template, if asked for.
    nearest : (size²,) int64
        Row of `texels` nearest to every texel, to fill what skin does not cover.
    texel_mm : (size, size, 2) float32, mm
        How far apart places are from column to column and from row to row; inf at seams.
    """

    size: int
    texels: NDArray[np.int64]
    places: Floats
    masks: Mapping[str, Floats]
    nearest: NDArray[np.int64]
    texel_mm: Floats

    def filled(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values (N, ...) as a picture (size, size, ...) without holes."""
        return values[self.nearest].reshape(self.size, self.size, *values.shape[1:])


@lru_cache(maxsize=4)
def make_canvas(template: Template, size: int, *, with_masks: bool = False) -> Canvas:
    """A canvas of `size` texels a side (the last few are kept); masks only where asked for."""
    rows = template.groups()["skin"]
    uv = appearance_uv(template)
    at = np.stack([uv[:, 0] * size - 0.5, (1 - uv[:, 1]) * size - 0.5], axis=1)
    uv_triangles = template.uv_triangles[rows]
    triangle, weights = _rasterised(at, uv_triangles, size)
    texels = np.flatnonzero(triangle.ravel() >= 0)
    hit, b = triangle.ravel()[texels], weights.reshape(-1, 3)[texels]
    corners = template.vertices[template.triangles[rows]].astype(np.float32)[hit]
    places = np.einsum("nc,ncx->nx", b, corners)
    masks = {}
    if with_masks:
        for name, mask in template.masks.items():
            masks[name] = np.einsum("nc,nc->n", b, mask.astype(np.float32)[uv_triangles[hit]])
    empty = (triangle < 0).astype(np.uint8)
    _, labels = cv2.distanceTransformWithLabels(
        empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    row_of_label = np.zeros(labels.max() + 1, dtype=np.int64)
    row_of_label[labels.ravel()[texels]] = np.arange(len(texels))
    nearest = row_of_label[labels.ravel()]
    texel_mm = _texel_mm(places, texels, size)
    return Canvas(size, texels, places, masks, nearest, texel_mm)


def _texel_mm(places: Floats, texels: NDArray[np.int64], size: int) -> Floats:
    flat = np.full((size * size, 3), np.nan, np.float32)
    flat[texels] = places
    picture = flat.reshape(size, size, 3)
    found = np.full((size, size, 2), np.inf, np.float32)
    found[:, 1:-1, 0] = np.linalg.norm(picture[:, 2:] - picture[:, :-2], axis=2) / 2
    found[1:-1, :, 1] = np.linalg.norm(picture[2:] - picture[:-2], axis=2) / 2
    found[~((found > 0) & (found < _WIDEST_TEXEL_MM * 2048 / size))] = np.inf
    return found


@njit(cache=True)
def _rasterised(at, triangles, size):  # type: ignore[no-untyped-def]
    """Triangle (−1: none) and barycentric weights at the middle of every texel."""
    found = np.full((size, size), -1, np.int32)
    weights = np.zeros((size, size, 3), np.float32)
    for f in range(len(triangles)):
        a, b, c = at[triangles[f, 0]], at[triangles[f, 1]], at[triangles[f, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if area == 0.0:
            continue
        x0 = max(0, int(np.ceil(min(a[0], b[0], c[0]))))
        x1 = min(size - 1, int(np.floor(max(a[0], b[0], c[0]))))
        y0 = max(0, int(np.ceil(min(a[1], b[1], c[1]))))
        y1 = min(size - 1, int(np.floor(max(a[1], b[1], c[1]))))
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                wb = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
                wc = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
                if wb >= -1e-6 and wc >= -1e-6 and wb + wc <= 1 + 1e-6:
                    found[y, x] = f
                    weights[y, x, 0] = 1 - wb - wc
                    weights[y, x, 1] = wb
                    weights[y, x, 2] = wc
    return found, weights


def sample_bilinear(picture: NDArray[np.uint8] | Floats, x: Floats, y: Floats) -> Floats:
    """Bilinear values; in rows of 4096, which OpenCV's remap can take."""
    n = len(x)
    padded = np.zeros((2, -(-n // 4096) * 4096), dtype=np.float32)
    padded[:, :n] = x, y
    grid = padded.reshape(2, -1, 4096)
    values = cv2.remap(picture, grid[0], grid[1], cv2.INTER_LINEAR).ravel()[:n]
    return np.asarray(values, dtype=np.float32)
