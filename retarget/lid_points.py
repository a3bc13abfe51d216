"""Points along the edges of the eyelids and on the skin above and below them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.mesh import SurfacePoints
from ..heads.head import Eye, Head
from ..heads.raycast import RayScene

#: Columns at these parts of the half width of the opening, from its middle.
COLUMNS = (-0.88, -0.65, -0.35, 0.35, 0.65, 0.88)
_ROW_COLUMNS = (-0.65, 0.0, 0.65)
#: Rows beside the edge: height over half the opening's width (upper lid, then lower), and the
#: part of the edge's motion that the skin there makes.
UPPER_ROWS = ((0.3, 0.72), (0.6, 0.34))
LOWER_ROWS = ((0.3, 0.55),)
_SCAN_MM = 0.05
#: Lid points lie this far from the visible edge of the opening.
EDGE_MM = 0.3
#: At full closure the edges overlap by this much, so that no light comes through.
PRESS_MM = 0.08


@dataclass(frozen=True, eq=False)
class LidPoint:
    """One auxiliary point of a lid.

    Attributes
    ----------
    name : str
        ``lid.SIDE.upper.…``
    point : SurfacePoints
        One point.
    side : str
        ``"left"`` or ``"right"``.
    upper : bool
    gap_mm : float
        What there is to close in its column.
    share : float
        The part of the edge's motion that it makes.
    """

    name: str
    point: SurfacePoints
    side: str
    upper: bool
    gap_mm: float
    share: float


def lid_opening(
    head: Head, skin: NDArray[np.int32], side: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Between which heights the eyeball shows, seen from the front.

    Returns
    -------
    x : (n,) float64, mm
        Columns in which it shows; empty if the head has no such eyeball.
    heights : (n, 2) float64, mm
        Upper and lower end.
    """
    nothing = np.zeros(0), np.zeros((0, 2))
    part = f"eye_{side}"
    if side not in head.eyes or part not in head.mesh.groups:
        return nothing
    eye = head.eyes[side]
    eyeball = head.mesh.triangles[head.mesh.groups[part]]
    xs = np.arange(-1.35, 1.36, 0.025) * eye.radius + eye.centre[0]
    ys = np.arange(0.9 * eye.radius, -0.9 * eye.radius, -_SCAN_MM) + eye.centre[1]
    x, y = np.meshgrid(xs, ys, indexing="ij")
    origins = np.stack([x.ravel(), y.ravel(), np.full(x.size, eye.centre[2] + 200.0)], axis=1)
    ahead = np.tile([0.0, 0.0, -1.0], (len(origins), 1))
    v = head.mesh.vertices
    t_skin, *_ = RayScene(v, skin).cast(origins, ahead)
    t_eye, *_ = RayScene(v, eyeball).cast(origins, ahead)
    shows = (t_eye < t_skin).reshape(x.shape)
    open_ = shows.any(axis=1)
    if open_.sum() < 4:
        return nothing
    first = np.argmax(shows[open_], axis=1)
    last = len(ys) - 1 - np.argmax(shows[open_][:, ::-1], axis=1)
    return xs[open_], np.stack([ys[first], ys[last]], axis=1)


def place_lid_points(head: Head, skin: NDArray[np.int32]) -> tuple[LidPoint, ...]:
    """Auxiliary lid points of both eyes; none for an eye that does not show."""
    found = []
    scene = RayScene(head.mesh.vertices, skin)
    for side in ("right", "left"):
        xs, heights = lid_opening(head, skin, side)
        if len(xs):
            found += _points_of_eye(scene, skin, head.eyes[side], side, xs, heights)
    return tuple(found)


def _points_of_eye(
    scene: RayScene,
    skin: NDArray[np.int32],
    eye: Eye,
    side: str,
    xs: NDArray[np.float64],
    heights: NDArray[np.float64],
) -> list[LidPoint]:
    middle, half = (xs[0] + xs[-1]) / 2, (xs[-1] - xs[0]) / 2
    found = []
    for upper, rows in ((True, UPPER_ROWS), (False, LOWER_ROWS)):
        up, lid = (1.0, "upper") if upper else (-1.0, "lower")
        for rise, share, columns in ((0.0, 1.0, COLUMNS), *((r, m, _ROW_COLUMNS) for r, m in rows)):
            for u in columns:
                x = middle + u * half
                top, bottom = (float(np.interp(x, xs, heights[:, i])) for i in (0, 1))
                y = (top if upper else bottom) + up * (EDGE_MM + rise * half)
                point = _seen_from_front(scene, skin, f"lid.{side}.{lid}.{rise}.{u}", x, y, eye)
                found.append(LidPoint(point.names[0], point, side, upper, top - bottom, share))
    return found


def _seen_from_front(
    scene: RayScene, skin: NDArray[np.int32], name: str, x: float, y: float, eye: Eye
) -> SurfacePoints:
    origin = np.array([[x, y, eye.centre[2] + 200.0]])
    _, triangle, uv = scene.cast(origin, np.array([[0.0, 0.0, -1.0]]))
    b = uv.astype(np.float64)[0]
    weights = np.array([[1 - b.sum(), *b]])
    return SurfacePoints((name,), skin[triangle.astype(np.int64)], weights)
