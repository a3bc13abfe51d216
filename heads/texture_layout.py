"""Where each part of the template's surface lies in the textures."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from .raycast import RayScene
from .template import Template

EYE_FRONT_RAD, EYE_FRONT_SHARE = 1.2, 0.86  # most of the eye's texture shows its front


@lru_cache(maxsize=2)
def appearance_uv(template: Template) -> NDArray[np.float64]:
    """Texture coordinates (U, 2) in [0, 1] that give the face most of the picture.

    Skin: the template's main island upright and stretched, its others in a strip below. Eyes:
    azimuthal about the axis. Teeth, tongue and lashes: stripes of the picture of details.
    """
    found = np.full_like(template.uv, 0.5)
    _lay_skin(template, found)
    for side in ("eye_right", "eye_left"):
        rows, v = _rows_of(template, side)
        found[rows] = _eye_uv(v)
    for part, low, high in (("teeth_upper", 0.77, 0.99), ("teeth_lower", 0.52, 0.74)):
        rows, v = _rows_of(template, part)
        s, t = _teeth_coordinates(v)
        found[rows] = np.stack([0.02 + 0.96 * s, low + (high - low) * t], axis=1)
    rows, v = _rows_of(template, "tongue")
    span = v.max(axis=0) - v.min(axis=0)
    along = (v - v.min(axis=0)) / span
    found[rows] = np.stack([0.02 + 0.96 * along[:, 0], 0.27 + 0.22 * along[:, 2]], axis=1)
    rows, v = _rows_of(template, "lashes")
    skin = template.triangles[template.groups()["skin"]]
    root, *_ = RayScene(template.vertices, skin).closest(v)
    length = np.linalg.norm(v - root, axis=1)
    s = (np.abs(v[:, 0]) - np.abs(v[:, 0]).min()) / np.ptp(np.abs(v[:, 0]))
    t = np.clip(length / np.percentile(length, 97), 0, 1)
    found[rows] = np.stack([0.02 + 0.96 * s, 0.02 + 0.21 * t], axis=1)
    found.flags.writeable = False
    return found


def _rows_of(template: Template, part: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Rows of uv that a part uses, and their places on the template."""
    triangles = template.groups()[part]
    rows, first = np.unique(template.uv_triangles[triangles], return_index=True)
    return rows.astype(np.int64), template.vertices[template.triangles[triangles].ravel()[first]]


def _lay_skin(template: Template, found: NDArray[np.float64]) -> None:
    rows = template.uv_triangles[template.groups()["skin"]]
    a, b = rows.ravel(), np.roll(rows, 1, axis=1).ravel()
    graph = coo_matrix((np.ones(len(a)), (a, b)), (len(found), len(found)))
    _, label = connected_components(graph, directed=False)
    names, counts = np.unique(label[np.unique(rows)], return_counts=True)
    order = names[np.argsort(-counts, kind="stable")]
    uv = template.uv
    main = label == order[0]
    found[main, 0] = 0.004 + 0.992 * _stretched(uv[main, 1], 0.483, 0.115, 1.75)
    found[main, 1] = 0.998 - 0.778 * _stretched(uv[main, 0], 0.885, 0.105, 0.9)
    # inside of the mouth, the eye sockets, the neck
    x = 0.01
    for island, width in zip(order[1:5], (0.22, 0.11, 0.11, 0.50), strict=True):
        at = label == island
        low, high = uv[at].min(axis=0), uv[at].max(axis=0)
        found[at] = (uv[at] - low) / (high - low) * (width, 0.19) + (x, 0.01)
        x += width + 0.01


def _stretched(
    x: NDArray[np.float64], centre: float, half: float, gain: float
) -> NDArray[np.float64]:
    """`x` over its range as 0 to 1, with `1 + gain` times the room around `centre`."""
    grid = np.linspace(x.min(), x.max(), 2001)
    room = np.cumsum(1 + gain * np.exp(-(((grid - centre) / half) ** 4)))
    return np.asarray(np.interp(x, grid, (room - room[0]) / (room[-1] - room[0])))


def _eye_uv(v: NDArray[np.float64]) -> NDArray[np.float64]:
    centre = (v.min(axis=0) + v.max(axis=0)) / 2
    d = (v - centre) / np.linalg.norm(v - centre, axis=1, keepdims=True)
    front = d[np.argsort(-d[:, 2])[:8]].mean(axis=0)
    front /= np.linalg.norm(front)
    right = np.cross((0.0, 1.0, 0.0), front)
    right /= np.linalg.norm(right)
    across = np.stack([d @ right, d @ np.cross(front, right)], axis=1)
    angle = np.arccos(np.clip(d @ front, -1, 1))
    radius = np.interp(angle, (0, EYE_FRONT_RAD, np.pi), (0, EYE_FRONT_SHARE, 1.0)) / 2
    length = np.linalg.norm(across, axis=1)
    return np.asarray(0.5 + 0.98 * across * (radius / np.maximum(length, 1e-9))[:, None])


def _teeth_coordinates(
    v: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place along the arch, 0 right to 1 left by length, and height, 0 low to 1 high."""
    centre_z = v[:, 2].min() + 0.25 * np.ptp(v[:, 2])
    angle = np.arctan2(v[:, 0], v[:, 2] - centre_z)
    grid = np.linspace(angle.min(), angle.max(), 33)
    near = np.abs(angle[None] - grid[:, None]) < 0.12
    radius = np.array([np.hypot(v[n, 0], v[n, 2] - centre_z).max() for n in near])
    step = np.hypot(np.diff(radius * np.sin(grid)), np.diff(radius * np.cos(grid)))
    s = np.interp(angle, grid, np.concatenate([[0], np.cumsum(step)]) / step.sum())
    low = np.interp(angle, grid, [v[n, 1].min() for n in near])
    high = np.interp(angle, grid, [v[n, 1].max() for n in near])
    return s, np.clip((v[:, 1] - low) / (high - low), 0, 1)
