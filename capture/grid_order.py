"""Which point of a board is which: orders put right, turned boards told apart."""

from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.boards import Board
from .board_map import BoardMap

Floats = NDArray[np.float64]
#: A grid is in order if a homography explains it this well, in steps of the grid (lenses bend it).
_MOST_OFF = 0.35
_MAX_HULL = 24
#: Boards that look alike when turned by half a turn get their x axis within a quarter turn of this
#: direction: far from how boards are held, upright or on their side, so that it seldom jumps.
_PREFERRED_RAD = np.deg2rad(30.0)


def turns(board: Board) -> list[tuple[NDArray[np.intp], float]]:
    """Ways to turn a board by quarters that bring its points upon its points.

    Returns
    -------
    list of (order (N,) int, sign)
        After the turn, point ``order[i]`` lies where point i lay. The sign is -1 for quarter turns,
        which exchange x and y: the contrast of a corner then counts the other way. The first turn
        changes nothing.
    """
    p = board.object_points()[:, :2]
    middle = (p.min(axis=0) + p.max(axis=0)) / 2
    step = np.rint((p - middle) / (0.5 * board.square_mm)).astype(int)  # halves: exact integers
    index = {(int(x), int(y)): i for i, (x, y) in enumerate(step)}
    found = []
    quarters = [[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]
    for number, quarter in enumerate(quarters):
        turned = step @ np.array(quarter).T
        order = [index.get((int(x), int(y)), -1) for x, y in turned]
        if min(order) >= 0:
            found.append((np.array(order, dtype=np.intp), (-1.0) ** number))
    return found


def parity(board: Board) -> Floats:
    """(N,): +1 and -1 by turns, as on a chessboard; -1 where upper left and lower right are black.

    For boards with squares. Times the contrast of `corner_refinement.Saddles` it has one sign over
    the whole board, positive if the board is as it should be.
    """
    columns, rows = board.points_size
    row, column = np.mgrid[0:rows, 0:columns].reshape(2, -1)
    first = 1.0 if board.legacy and board.rows % 2 == 0 else -1.0
    return first * (-1.0) ** (row + column)


def look_alikes(board: Board) -> list[NDArray[np.intp]]:
    """Of `turns`, those after which the board looks the same, its colours included."""
    found = turns(board)
    if board.kind == "charuco":
        return [found[0][0]]
    if board.kind == "chessboard":
        colours = parity(board)
        return [order for order, sign in found if (sign * colours[order] == colours).all()]
    return [order for order, _ in found]


def in_order(points: Floats, pixels: Floats, step: float) -> bool:
    """Whether pixels (N, 2) can be a picture, seen from the front, of points (N, 2) mm."""
    fitted = BoardMap.fit(points, pixels, most_degree=0)
    if fitted is None:
        return False
    return _off_by_steps(fitted, points, pixels, step) < _MOST_OFF


def put_in_order(points: Floats, pixels: Floats, step: float) -> tuple[Floats | None, bool]:
    """The pixels (N, 2) in the order of points (N, 2) mm, and whether that changed anything.

    None where no order makes them a picture of the points, seen from the front.
    """
    if in_order(points, pixels, step):
        return pixels, False
    hull = cv2.convexHull(pixels.astype(np.float32), returnPoints=False).ravel()
    if not 4 <= len(hull) <= _MAX_HULL:
        return None, True
    corners = _corners(points)
    if corners is None:
        return None, True
    for quad in _largest_quads(pixels[hull]):
        for first in range(4):
            H = cv2.getPerspectiveTransform(
                np.roll(quad, -first, axis=0).astype(np.float32), corners.astype(np.float32)
            )
            back = cv2.perspectiveTransform(pixels[None].astype(np.float64), H)[0]
            order = _assign(points, back, step)
            if order is not None and in_order(points, pixels[order], step):
                return pixels[order], True
    return None, True


def preferred(board: Board, choices: list[NDArray[np.intp]], pixels: Floats) -> NDArray[np.intp]:
    """Of several orders of the same pixels the one to take, so that near views take the same."""
    way = 0.0 if len(choices) > 2 else _PREFERRED_RAD
    target = np.array([np.cos(way), np.sin(way)])
    x = board.object_points()[:, 0]
    x = x - x.mean()

    def agreement(order: NDArray[np.intp]) -> float:
        return float(x @ pixels[order] @ target)

    return max(choices, key=agreement)


def _off_by_steps(fitted: BoardMap, points: Floats, pixels: Floats, step: float) -> float:
    """Largest residual over the local step; infinite for a mirrored map."""
    along_x, along_y, _, _ = fitted.axes(points, step)
    area = along_x[:, 0] * along_y[:, 1] - along_x[:, 1] * along_y[:, 0]
    if not (area > 0).all():
        return float("inf")
    size = np.minimum(np.linalg.norm(along_x, axis=1), np.linalg.norm(along_y, axis=1))
    off = np.linalg.norm(fitted(points) - pixels, axis=1)
    return float((off / size).max())


def _corners(points: Floats) -> Floats | None:
    """Corners of a rectangular grid, in the sense in which x turns to y; None for another shape."""
    low, high = points.min(axis=0), points.max(axis=0)
    wanted = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    near = np.linalg.norm(points[None] - wanted[:, None], axis=2).min(axis=1)
    return wanted if near.max() < 1e-6 * float((high - low).max()) else None


def _largest_quads(ring: Floats, most: int = 12) -> list[Floats]:
    """Quadrangles of hull points with the largest areas, turning as x turns to y."""
    picks = np.array(list(combinations(range(len(ring)), 4)))
    quads = ring[picks]
    nexts = np.roll(quads, -1, axis=1)
    area = (quads[..., 0] * nexts[..., 1] - quads[..., 1] * nexts[..., 0]).sum(axis=1) / 2
    order = np.argsort(-np.abs(area))[:most]
    return [quads[i] if area[i] > 0 else quads[i][::-1] for i in order]


def _assign(points: Floats, back: Floats, step: float) -> NDArray[np.intp] | None:
    """For every point the index of the one place that falls to it."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(points).query(back)
    if distance.max() > 0.45 * step or len(np.unique(nearest)) != len(points):
        return None
    return np.asarray(np.argsort(nearest), dtype=np.intp)
