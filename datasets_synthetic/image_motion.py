"""Motion blur and rolling shutter: one rendered instant, spread over the exposure by its flow.

A picture's row y gathers light from t + readout (y / (h − 1) − 1/2) − exposure/2 to the same
+ exposure/2. What is seen is rendered once, at t. Every vertex is projected at the ends of the
whole span too; each pixel's place is a parabola through the three, and the picture is gathered
back along it (fixed point in the pixel's own row time). Exact for surfaces up to the parabola's
error; what comes from behind an edge within the exposure is taken from beside it.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.camera import Camera
from ..heads.raycast import NO_HIT
from .optics import Optics

Floats = NDArray[np.float32]

_STILL_PX = 0.02  # motion below this is none
_STEP_PX = 0.9  # of the line integral
_MOST_STEPS = 32
_FIXED_POINT_STEPS = 2  # for each step of the integral, which starts where the last one ended


@dataclass(frozen=True, eq=False)
class Flow:
    """Where the pixels of a picture go over a frame: x + velocity s + bend s², s in −1..1.

    Attributes
    ----------
    velocity, bend : (h, w, 2) float32, px
        Over half the span; beyond the silhouette that of the nearest pixel within.
    near : (h, w) bool
        Where something may come within the span; elsewhere the flow means nothing.
    half_span_s : float
        Time of s = 1.
    """

    velocity: Floats
    bend: Floats
    near: NDArray[np.bool_]
    half_span_s: float

    @property
    def reach_px(self) -> float:
        """The longest way a pixel goes from its place at s = 0, along either axis."""
        return _reach(self.velocity, self.bend)


def _reach(velocity: Floats, bend: Floats) -> float:
    if not velocity.size:
        return 0.0
    return float(np.abs(velocity).max() + np.abs(bend).max())


def half_span_s(optics: Optics) -> float:
    """From a frame's time to the end of its last row's exposure."""
    return (optics.readout_s + optics.exposure_s) / 2


def pixel_flow(
    triangle: NDArray[np.uint32],
    weights: Floats,
    triangles: NDArray[np.int32],
    before: NDArray[np.float64],
    now: NDArray[np.float64],
    after: NDArray[np.float64],
    half_span: float,
) -> Flow:
    """The flow of rendered pixels.

    Parameters
    ----------
    triangle : (h, w) uint32, or NO_HIT
    weights : (h, w, 2) float32
        Barycentric weights of the second and third corner.
    triangles : (F, 3) int32
    before, now, after : (V, 2) float64, px
        Projected vertices at −`half_span`, 0 and +`half_span`; NaN counts as still.
    half_span : float, s
    """
    velocity = np.nan_to_num((after - before) / 2).astype(np.float32)
    bend = np.nan_to_num((after + before) / 2 - now).astype(np.float32)
    flow_v = np.zeros((*triangle.shape, 2), np.float32)
    flow_b = np.zeros((*triangle.shape, 2), np.float32)
    tri = np.ascontiguousarray(triangles, dtype=np.int32)
    in_threads(_spread, (triangle, weights, tri, velocity, bend, flow_v, flow_b), triangle.shape[0])
    reach = 1.5 * _reach(velocity, bend) + 3
    near = _fill_outside(triangle != NO_HIT, reach, flow_v, flow_b)
    return Flow(flow_v, flow_b, near, half_span)


def _fill_outside(known: NDArray[np.bool_], reach: float, *fields: Floats) -> NDArray[np.bool_]:
    """Give pixels outside, within reach, the nearest known pixel's values; return which are."""
    if not known.any() or known.all():
        return known
    distance, label = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    near = distance <= reach
    index = np.zeros(int(label.max()) + 1, np.int64)
    flat = np.flatnonzero(known)
    index[label.ravel()[flat]] = flat
    outside = np.flatnonzero(near & ~known)
    nearest = index[label.ravel()[outside]]
    for field in fields:
        values = field.reshape(-1, field.shape[-1])
        values[outside] = values[nearest]
    return np.asarray(near)


def expose(
    light: Floats,
    cover: Floats,
    flow: Flow,
    optics: Optics,
    height: int,
    first_row: int,
) -> tuple[Floats, Floats]:
    """Spread one instant over a frame's rows and exposure.

    Parameters
    ----------
    light : (h, w, 3) float32, linear, premultiplied
    cover : (h, w) float32
    flow : Flow
    optics : Optics
    height : int
        Of the whole picture.
    first_row : int
        Of the picture, that `light` begins at.

    Returns
    -------
    (h, w, 3) and (h, w) float32
        Light and cover as the shutter gathers them.
    """
    if flow.half_span_s <= 0 or flow.reach_px < _STILL_PX:
        return light, cover
    rows = first_row + np.arange(light.shape[0])
    delay = optics.readout_s * (rows / max(height - 1, 1) - 0.5) / flow.half_span_s
    half_open = optics.exposure_s / 2 / flow.half_span_s
    layer = np.concatenate([light, cover[..., None]], axis=2).astype(np.float32)
    found = np.empty_like(layer)
    arguments = (
        layer, flow.velocity, flow.bend, flow.near, delay.astype(np.float32),
        np.float32(half_open), found,
    )  # fmt: skip
    in_threads(_gather, arguments, len(rows))
    return np.ascontiguousarray(found[..., :3]), np.ascontiguousarray(found[..., 3])


def row_time_points(
    camera: Camera,
    optics: Optics,
    points_at: Any,
    time_s: float,
    *,
    tolerance_px: float = 1e-4,
) -> NDArray[np.float64]:
    """Projections that agree with a rolling shutter: each point at the time of its own row.

    Parameters
    ----------
    camera : Camera
    optics : Optics
    points_at : callable from time, s, to (N, 3) float, mm, world frame
    time_s : float
        Of the frame: the middle row's.
    tolerance_px : float
        How well a point's row and its time agree.

    Returns
    -------
    (N, 2) float64, px
        NaN where not in front of the camera.
    """
    height = camera.image_size[1]
    now = camera.project(points_at(time_s))
    if optics.readout_s == 0 or not len(now):
        return now
    half = optics.readout_s / 2
    before = camera.project(points_at(time_s - half))
    after = camera.project(points_at(time_s + half))
    velocity, bend = (after - before) / 2, (after + before) / 2 - now
    found = now
    for _ in range(30):
        s = 2 * np.clip(found[:, 1] / max(height - 1, 1), 0, 1) - 1
        new = now + velocity * s[:, None] + bend * (s * s)[:, None]
        step = np.abs(new - found)
        found = new
        if not np.nanmax(step, initial=0.0) > tolerance_px / 10:
            break
    return _polished(camera, optics, points_at, time_s, found, tolerance_px)


def _polished(
    camera: Camera,
    optics: Optics,
    points_at: Any,
    time_s: float,
    guess: NDArray[np.float64],
    tolerance_px: float,
) -> NDArray[np.float64]:
    """Replace the parabola by the points' own motion at times shared by neighbouring rows."""
    height = camera.image_size[1]
    rows = np.clip(guess[:, 1], 0, height - 1)
    known = np.isfinite(rows)
    if not known.any():
        return guess
    # the motion between a few exact instants over the rows in use, as a polynomial through them
    low, high = float(rows[known].min()), float(rows[known].max())
    nodes = np.polynomial.chebyshev.chebpts1(5) * max((high - low) / 2, 1.0) + (low + high) / 2
    at = [
        camera.project(points_at(time_s + optics.row_delay_s(float(row), height))) for row in nodes
    ]
    places = np.stack(at)  # (5, N, 2)
    found = guess
    for _ in range(30):
        y = np.clip(found[:, 1], 0, height - 1)
        new = _lagrange(nodes, places, y)
        step = np.abs(new - found)
        found = new
        if not np.nanmax(step, initial=0.0) > tolerance_px / 10:
            break
    return found


def _lagrange(
    nodes: NDArray[np.float64], values: NDArray[np.float64], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    total = np.zeros_like(values[0])
    for i, node in enumerate(nodes):
        others = np.delete(nodes, i)
        basis = np.prod((at[:, None] - others) / (node - others), axis=1)
        total += basis[:, None] * values[i]
    return np.asarray(total)


def in_threads(function: Any, arguments: tuple[Any, ...], n_rows: int) -> None:
    """Call a compiled loop over rows, which lets go of the interpreter, on all cores."""
    cores = min(os.cpu_count() or 1, 8)
    bounds = np.linspace(0, n_rows, 4 * cores + 1).astype(int)
    with ThreadPoolExecutor(cores) as pool:
        for job in [pool.submit(function, *(*arguments, a, b)) for a, b in pairwise(bounds)]:
            job.result()


@njit(cache=True, nogil=True)
def _spread(  # type: ignore[no-untyped-def]
    triangle, weights, triangles, velocity, bend, flow_v, flow_b, first, last
):
    """Vertices' flow to pixels."""
    for y in range(first, last):
        for x in range(triangle.shape[1]):
            f = triangle[y, x]
            if f == 4294967295:
                continue
            w1, w2 = weights[y, x, 0], weights[y, x, 1]
            w0 = 1 - w1 - w2
            a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
            for k in range(2):
                flow_v[y, x, k] = w0 * velocity[a, k] + w1 * velocity[b, k] + w2 * velocity[c, k]
                flow_b[y, x, k] = w0 * bend[a, k] + w1 * bend[b, k] + w2 * bend[c, k]


@njit(cache=True, nogil=True, inline="always")
def _source(velocity, bend, x, y, s, u, v):  # type: ignore[no-untyped-def]
    """The pixel u that comes to x at s: u + velocity(u) s + bend(u) s² = x; from a guess."""
    height, width = velocity.shape[0], velocity.shape[1]
    one = np.float32(1)
    for _ in range(_FIXED_POINT_STEPS):
        i = min(max(int(np.floor(u)), 0), width - 2)
        j = min(max(int(np.floor(v)), 0), height - 2)
        fx = min(max(u - np.float32(i), np.float32(0)), one)
        fy = min(max(v - np.float32(j), np.float32(0)), one)
        w00, w01, w10, w11 = (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy
        dx = (
            w00 * (velocity[j, i, 0] + s * bend[j, i, 0])
            + w01 * (velocity[j, i + 1, 0] + s * bend[j, i + 1, 0])
            + w10 * (velocity[j + 1, i, 0] + s * bend[j + 1, i, 0])
            + w11 * (velocity[j + 1, i + 1, 0] + s * bend[j + 1, i + 1, 0])
        )
        dy = (
            w00 * (velocity[j, i, 1] + s * bend[j, i, 1])
            + w01 * (velocity[j, i + 1, 1] + s * bend[j, i + 1, 1])
            + w10 * (velocity[j + 1, i, 1] + s * bend[j + 1, i, 1])
            + w11 * (velocity[j + 1, i + 1, 1] + s * bend[j + 1, i + 1, 1])
        )
        u, v = x - s * dx, y - s * dy
    return u, v


@njit(cache=True, nogil=True)
def _gather(  # type: ignore[no-untyped-def]
    layer, velocity, bend, near, delay, half_open, out, first, last
):
    """Average the layer along each pixel's way through its row's exposure."""
    height, width = layer.shape[0], layer.shape[1]
    zero, one = np.float32(0), np.float32(1)
    for y in range(first, last):
        s0 = delay[y]
        for x in range(width):
            if not near[y, x]:
                for c in range(4):
                    out[y, x, c] = zero
                continue
            # speed along the way: velocity plus the bend's share
            sx = velocity[y, x, 0] + 2 * s0 * bend[y, x, 0]
            sy = velocity[y, x, 1] + 2 * s0 * bend[y, x, 1]
            length = 2 * half_open * np.sqrt(sx * sx + sy * sy)
            n = min(max(int(np.ceil(length / _STEP_PX)), 1), _MOST_STEPS)
            a0, a1, a2, a3 = zero, zero, zero, zero
            fx, fy = np.float32(x), np.float32(y)
            u, v = fx, fy
            for k in range(n):
                s = s0 + half_open * np.float32((2 * k + 1 - n) / n)
                u, v = _source(velocity, bend, fx, fy, s, u, v)
                # beyond the border, which is the picture's or empty, its last pixel serves
                p = min(max(u, zero), np.float32(width - 1))
                q = min(max(v, zero), np.float32(height - 1))
                i, j = min(int(p), width - 2), min(int(q), height - 2)
                gx, gy = p - np.float32(i), q - np.float32(j)
                w00, w01 = (one - gx) * (one - gy), gx * (one - gy)
                w10, w11 = (one - gx) * gy, gx * gy
                a, b = layer[j, i], layer[j, i + 1]
                c, d = layer[j + 1, i], layer[j + 1, i + 1]
                a0 += w00 * a[0] + w01 * b[0] + w10 * c[0] + w11 * d[0]
                a1 += w00 * a[1] + w01 * b[1] + w10 * c[1] + w11 * d[1]
                a2 += w00 * a[2] + w01 * b[2] + w10 * c[2] + w11 * d[2]
                a3 += w00 * a[3] + w01 * b[3] + w10 * c[3] + w11 * d[3]
            share = one / np.float32(n)
            out[y, x, 0], out[y, x, 1] = share * a0, share * a1
            out[y, x, 2], out[y, x, 3] = share * a2, share * a3
