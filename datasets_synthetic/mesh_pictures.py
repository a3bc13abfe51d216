"""Meshes in the picture: drawn dimly with a depth buffer, and as what hides a place behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_CELL_PX = 8


@dataclass(frozen=True, eq=False)
class SeenMesh:
    """A mesh as one camera sees it.

    Attributes
    ----------
    pixels : (V, 2) float64, px
        NaN for vertices behind the camera, whose triangles are left out.
    depth : (V,) float64, mm
    triangles : (F, 3) int32
    is_closed : bool
        Only the outer sides of its triangles can be seen.
    """

    pixels: Floats
    depth: Floats
    triangles: NDArray[np.int32]
    is_closed: bool = True

    def within(self, left: int, top: int, shrink: int) -> SeenMesh:
        """The same in a picture whose top-left pixel is another, and whose pixels are larger.

        Parameters
        ----------
        left, top : int, px
            The pixel that becomes a part of (0, 0).
        shrink : int
            Pixels across one of the new picture.
        """
        corner = np.array([left, top]) - 0.5
        return replace(self, pixels=(self.pixels - corner) / shrink - 0.5)


def draw_mesh(
    picture: NDArray[np.float32],
    depth: NDArray[np.float32],
    mesh: SeenMesh,
    light: NDArray[np.float32],
) -> None:
    """Draw a mesh into a picture, nearest first.

    Parameters
    ----------
    picture : (h, w) float32, linear light
        Changed where the mesh is nearer than `depth`.
    depth : (h, w) float32, mm
        Changed likewise.
    mesh : SeenMesh
    light : (V,) float32
        Of the vertices; interpolated between them.
    """
    _draw(picture, depth, mesh.pixels, mesh.depth, mesh.triangles, light, not mesh.is_closed)


def hidden_places(
    meshes: Sequence[tuple[SeenMesh, Floats | float]],
    pixels: Floats,
    depth: Floats,
) -> NDArray[np.bool_]:
    """Which places a mesh hides from the camera.

    Parameters
    ----------
    meshes : sequence of (SeenMesh, tolerance)
        Tolerance in mm, a number or (K,): what lies less than this before a place (in depth) does
        not hide it.
    pixels : (K, 2) float64, px
    depth : (K,) float64, mm

    Returns
    -------
    (K,) bool
        False for places without a pixel.
    """
    hidden = np.zeros(len(pixels), bool)
    known = np.asarray(np.isfinite(pixels).all(axis=1))
    if not known.any():
        return hidden
    low = pixels[known].min(axis=0)
    cells = np.where(known[:, None], (pixels - low) // _CELL_PX, -1).astype(np.int64)
    shape = cells.max(axis=0) + 1
    needed = np.zeros((shape[1], shape[0]), bool)
    needed[cells[known, 1], cells[known, 0]] = True
    for mesh, tolerance in meshes:
        if not len(mesh.triangles):
            continue
        starts, items = _cells(mesh.pixels, mesh.triangles, needed, low[0], low[1])
        limit = depth - np.broadcast_to(np.asarray(tolerance, dtype=np.float64), depth.shape)
        _hide(
            hidden, pixels, limit, cells, mesh.pixels, mesh.depth, mesh.triangles, starts, items,
            needed.shape[1],
        )  # fmt: skip
    return hidden


def mesh_over_boxes(mesh: SeenMesh, low: Floats, high: Floats) -> NDArray[np.bool_]:
    """Which boxes in the picture a mesh may cover a part of.

    Parameters
    ----------
    mesh : SeenMesh
    low, high : (M, 2) float64, px
        Corners of the boxes.
    """
    found = np.zeros(len(low), np.bool_)
    _over_boxes(found, mesh.pixels, mesh.triangles, low, high)
    return found


def lambert(
    vertices: Floats, triangles: NDArray[np.int32], albedo: NDArray[np.float32], light: Floats
) -> NDArray[np.float32]:
    """Light from vertices under one far lamp and a quarter of it from everywhere, (V,).

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    triangles : (F, 3) int32
    albedo : (V,) float32
    light : (3,) float64
        Unit vector towards the lamp.
    """
    found = np.empty(len(vertices), np.float32)
    _lambert(vertices, triangles, albedo, light, found)
    return found


@njit(cache=True, nogil=True)
def _lambert(vertices, triangles, albedo, light, found):  # type: ignore[no-untyped-def]
    normals = np.zeros((len(vertices), 3))
    for f in range(len(triangles)):
        i, j, k = triangles[f]
        ax, ay, az = vertices[j] - vertices[i]
        bx, by, bz = vertices[k] - vertices[i]
        n0, n1, n2 = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        for corner in triangles[f]:
            normals[corner, 0] += n0
            normals[corner, 1] += n1
            normals[corner, 2] += n2
    for v in range(len(vertices)):
        n = normals[v]
        length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) + 1e-12
        cosine = (n[0] * light[0] + n[1] * light[1] + n[2] * light[2]) / length
        found[v] = albedo[v] * (0.25 + 0.75 * max(0.0, cosine))


@njit(cache=True, nogil=True)
def _draw(  # type: ignore[no-untyped-def]
    picture, buffer, pixels, depth, triangles, light, both_sides
):
    h, w = picture.shape
    for f in range(len(triangles)):
        i, j, k = triangles[f]
        x0, y0, x1, y1 = pixels[i, 0], pixels[i, 1], pixels[j, 0], pixels[j, 1]
        x2, y2 = pixels[k, 0], pixels[k, 1]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        # what faces the camera turns the other way, since rows grow downwards; NaN is neither
        if not (area < 0 or (both_sides and area > 0)):
            continue
        left = max(0, int(np.ceil(min(x0, x1, x2))))
        right = min(w - 1, int(np.floor(max(x0, x1, x2))))
        top = max(0, int(np.ceil(min(y0, y1, y2))))
        bottom = min(h - 1, int(np.floor(max(y0, y1, y2))))
        if left > right or top > bottom:
            continue
        # weights are linear in the picture for 1 / depth; for light that small matter is let go
        inverse = 1.0 / area
        p0, p1, p2 = 1 / depth[i], 1 / depth[j], 1 / depth[k]
        l0, l1, l2 = light[i], light[j], light[k]
        b1x, b1y = (y2 - y0) * inverse, -(x2 - x0) * inverse
        b2x, b2y = -(y1 - y0) * inverse, (x1 - x0) * inverse
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                b1 = (x - x0) * b1x + (y - y0) * b1y
                b2 = (x - x0) * b2x + (y - y0) * b2y
                if b1 < 0 or b2 < 0 or b1 + b2 > 1:
                    continue
                b0 = 1 - b1 - b2
                z = np.float32(1 / (b0 * p0 + b1 * p1 + b2 * p2))
                if z < buffer[y, x]:
                    buffer[y, x] = z
                    picture[y, x] = b0 * l0 + b1 * l1 + b2 * l2


@njit(cache=True, nogil=True)
def _over_boxes(found, pixels, triangles, low, high):  # type: ignore[no-untyped-def]
    for f in range(len(triangles)):
        i, j, k = triangles[f]
        x0 = min(pixels[i, 0], pixels[j, 0], pixels[k, 0])
        x1 = max(pixels[i, 0], pixels[j, 0], pixels[k, 0])
        y0 = min(pixels[i, 1], pixels[j, 1], pixels[k, 1])
        y1 = max(pixels[i, 1], pixels[j, 1], pixels[k, 1])
        for m in range(len(low)):
            if x0 < high[m, 0] and x1 > low[m, 0] and y0 < high[m, 1] and y1 > low[m, 1]:
                found[m] = True


@njit(cache=True, nogil=True)
def _cells(pixels, triangles, needed, left, top):  # type: ignore[no-untyped-def]
    """Triangles over each needed cell of a grid, as lists one after another."""
    rows, columns = needed.shape
    counts = np.zeros(rows * columns + 1, np.int64)
    items = np.empty(0, np.int32)
    for turn in range(2):
        for f in range(len(triangles)):
            i, j, k = triangles[f]
            x0 = min(pixels[i, 0], pixels[j, 0], pixels[k, 0]) - left
            x1 = max(pixels[i, 0], pixels[j, 0], pixels[k, 0]) - left
            y0 = min(pixels[i, 1], pixels[j, 1], pixels[k, 1]) - top
            y1 = max(pixels[i, 1], pixels[j, 1], pixels[k, 1]) - top
            if not (x1 >= 0 and y1 >= 0 and np.isfinite(x0 + x1 + y0 + y1)):
                continue
            if x0 >= columns * _CELL_PX or y0 >= rows * _CELL_PX:
                continue
            for r in range(max(0, int(y0) // _CELL_PX), min(rows, int(y1) // _CELL_PX + 1)):
                for c in range(max(0, int(x0) // _CELL_PX), min(columns, int(x1) // _CELL_PX + 1)):
                    if not needed[r, c]:
                        continue
                    cell = r * columns + c
                    if turn == 0:
                        counts[cell + 1] += 1
                    else:
                        items[counts[cell]] = f
                        counts[cell] += 1
        if turn == 0:
            counts = np.cumsum(counts)
            items = np.empty(counts[-1], np.int32)
    # the second turn moved each start to its end
    starts = np.zeros_like(counts)
    starts[1:] = counts[:-1]
    return starts, items


@njit(cache=True, nogil=True)
def _hide(  # type: ignore[no-untyped-def]
    hidden, places, limit, cells, pixels, depth, triangles, starts, items, columns
):
    for s in range(len(places)):
        if hidden[s] or cells[s, 0] < 0:
            continue
        x, y = places[s]
        cell = cells[s, 1] * columns + cells[s, 0]
        for t in range(starts[cell], starts[cell + 1]):
            i, j, k = triangles[items[t]]
            x0, y0 = pixels[i, 0] - x, pixels[i, 1] - y
            x1, y1 = pixels[j, 0] - x, pixels[j, 1] - y
            x2, y2 = pixels[k, 0] - x, pixels[k, 1] - y
            a, b, c = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
            if (a < 0 or b < 0 or c < 0) and (a > 0 or b > 0 or c > 0):
                continue
            area = a + b + c
            if area == 0:
                continue
            z = area / (a / depth[i] + b / depth[j] + c / depth[k])
            if z < limit[s]:
                hidden[s] = True
                break
