"""How much of each pixel is white board: calibration boards seen through a lens, exactly.

The pattern is never a bitmap. Each pixel's corners are carried back through the lens to the board;
where one colour fills them that is it, and where an edge passes 233 places of the pixel are looked
at, a Fibonacci lattice: an edge's place is then known to a few thousandths of a pixel, whatever
its direction.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..core.boards import Board
from ..core.camera import Camera
from ..core.rigid import Rigid

Floats = NDArray[np.float32]
_N_PLACES, _GENERATOR = 233, 144  # neighbours in Fibonacci's series
_BOW_STEPS = 12
_NOTHING, _BLACK, _WHITE = -1, 0, 1


class BoardPictures:
    """One board before one camera.

    Parameters
    ----------
    board : Board
    camera : Camera
    bow_mm : (x, y) floats, mm
        How far the middle of the board stands back from its edges, along x and along y: the
        surface is z = bow_x (1 - u²) + bow_y (1 - v²), u and v from -1 to 1 over the points.
    """

    def __init__(
        self, board: Board, camera: Camera, bow_mm: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        self.board, self.camera = board, camera
        self._bow = bow_terms(board, bow_mm)
        width, height = camera.image_size
        # one pixel more on each side, for differences
        x, y = np.meshgrid(np.arange(-1, width + 1), np.arange(-1, height + 1))
        places = camera.undistort(np.stack([x, y], axis=-1).astype(np.float64))
        self._rays = np.ascontiguousarray(places[1:-1, 1:-1])
        self._per_x = np.ascontiguousarray((places[1:-1, 2:] - places[1:-1, :-2]) / 2)
        self._per_y = np.ascontiguousarray((places[2:, 1:-1] - places[:-2, 1:-1]) / 2)
        self._lattice = _lattice()
        self._pattern = _pattern(board)

    def cover(self, world_from_board: Rigid) -> tuple[Floats, Floats]:
        """What is seen of a board at a pose.

        Returns
        -------
        sheet : (h, w) float32, 0 to 1
            The share of each pixel that the sheet fills.
        white : (h, w) float32, 0 to `sheet`
            The share that is white. The back of the sheet is white all over.
        """
        width, height = self.camera.image_size
        sheet, white = np.zeros((2, height, width), np.float32)
        pose = self.camera.camera_from_world @ world_from_board
        R, origin = pose.rotation, pose.inverse().translation
        box = self._box(world_from_board)
        if box is not None:
            _cover(
                self._rays, self._per_x, self._per_y, self._lattice, R, origin, self._bow,
                *self._pattern, np.array(box), sheet, white,
            )  # fmt: skip
        return sheet, white

    def _box(self, world_from_board: Rigid) -> tuple[int, int, int, int] | None:
        """Pixels x0, y0, x1, y1 (ends excluded) that hold the sheet."""
        width, height = self.camera.image_size
        x0, y0, x1, y1 = self.board.sheet_box
        s = np.linspace(0, 1, 33)
        xy = np.stack(np.meshgrid(x0 + (x1 - x0) * s, y0 + (y1 - y0) * s), axis=-1)
        z = bow_height(self._bow, xy)[..., None]
        at = self.camera.project(world_from_board.apply(np.concatenate([xy, z], axis=-1)))
        if not np.isfinite(at).all():
            return (0, 0, width, height)  # behind the camera, or folded by the lens
        low = np.floor(at.min(axis=(0, 1))).astype(int) - 2
        high = np.ceil(at.max(axis=(0, 1))).astype(int) + 3
        left, top = max(int(low[0]), 0), max(int(low[1]), 0)
        right, bottom = min(int(high[0]), width), min(int(high[1]), height)
        return (left, top, right, bottom) if left < right and top < bottom else None


def bow_terms(board: Board, bow_mm: tuple[float, float]) -> NDArray[np.float64]:
    """(6,): middle x, y, half width and height of the points, and the two amounts, mm."""
    points = board.object_points()[:, :2]
    low, high = points.min(axis=0), points.max(axis=0)
    return np.concatenate([(low + high) / 2, (high - low) / 2, np.asarray(bow_mm, np.float64)])


def bow_height(bow: NDArray[np.float64], xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """z of the surface at (..., 2) mm."""
    share = 1 - ((xy - bow[:2]) / bow[2:4]) ** 2
    return np.asarray(share @ bow[4:])


def _lattice() -> NDArray[np.float64]:
    """(233, 2) places of a pixel, -0.5 to 0.5."""
    k = np.arange(_N_PLACES)
    places = np.stack([k, k * _GENERATOR % _N_PLACES], axis=1) + 0.5
    return places / _N_PLACES - 0.5


def _pattern(board: Board) -> tuple[Any, ...]:
    """The board as the compiled loop wants it."""
    sheet = np.array(board.sheet_box)
    if board.kind != "circles":
        x_edges, y_edges, black = board.cells
        nothing = np.zeros(5)
        return sheet, np.array(x_edges), np.array(y_edges), np.array(black), nothing
    dots = np.array(
        [board.columns, board.rows, board.square_mm, board.asymmetric, board.dot_radius_mm],
        np.float64,
    )
    none = np.zeros(0)
    return sheet, none, none, np.zeros((0, 0), np.bool_), dots


@njit(cache=True, nogil=True, inline="always")
def _on_board(x, y, R, o, bow):  # type: ignore[no-untyped-def]
    """Where the ray through normalised (x, y) meets the surface: X, Y mm; NaN if it does not."""
    ex = R[0, 0] * x + R[1, 0] * y + R[2, 0]
    ey = R[0, 1] * x + R[1, 1] * y + R[2, 1]
    ez = R[0, 2] * x + R[1, 2] * y + R[2, 2]
    if ez == 0:
        return np.nan, np.nan
    s = -o[2] / ez
    if bow[4] != 0 or bow[5] != 0:
        for _ in range(_BOW_STEPS):
            u = (o[0] + s * ex - bow[0]) / bow[2]
            v = (o[1] + s * ey - bow[1]) / bow[3]
            s = (bow[4] * (1 - u * u) + bow[5] * (1 - v * v) - o[2]) / ez
    if not s > 0:
        return np.nan, np.nan
    return o[0] + s * ex, o[1] + s * ey


@njit(cache=True, nogil=True)
def _cell(edges, value):  # type: ignore[no-untyped-def]
    """The cell that holds a value that lies within the edges."""
    low, high = 0, len(edges) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if edges[middle] <= value:
            low = middle
        else:
            high = middle
    return low


@njit(cache=True, nogil=True)
def _nearest_dot(x, y, dots):  # type: ignore[no-untyped-def]
    """Distance to the middle of the nearest dot."""
    columns, rows, step, asymmetric = int(dots[0]), int(dots[1]), dots[2], dots[3] > 0
    best = np.inf
    middle = int(np.rint(y / step))
    for row in range(max(middle - 1, 0), min(middle + 2, rows)):
        shift = step * (row % 2) if asymmetric else 0.0
        stride = 2 * step if asymmetric else step
        column = min(max(int(np.rint((x - shift) / stride)), 0), columns - 1)
        away = np.hypot(x - shift - column * stride, y - row * step)
        best = min(best, away)
    return best


@njit(cache=True, nogil=True)
def _ink(x, y, sheet, x_edges, y_edges, black, dots):  # type: ignore[no-untyped-def]
    """What is at a place of the board."""
    if not (sheet[0] <= x < sheet[2] and sheet[1] <= y < sheet[3]):
        return _NOTHING
    if len(x_edges):
        return _BLACK if black[_cell(y_edges, y), _cell(x_edges, x)] else _WHITE
    return _BLACK if _nearest_dot(x, y, dots) < dots[4] else _WHITE


@njit(cache=True, nogil=True)
def _alike(box, sheet, x_edges, y_edges, black, dots):  # type: ignore[no-untyped-def]
    """What fills a box of the board (x0, x1, y0, y1) alone; -2 if there may be an edge in it."""
    x0, x1, y0, y1 = box
    if x1 < sheet[0] or x0 >= sheet[2] or y1 < sheet[1] or y0 >= sheet[3]:
        return _NOTHING
    if x0 < sheet[0] or x1 >= sheet[2] or y0 < sheet[1] or y1 >= sheet[3]:
        return -2
    if len(x_edges):
        i0, i1 = _cell(x_edges, x0), _cell(x_edges, x1)
        j0, j1 = _cell(y_edges, y0), _cell(y_edges, y1)
        first = black[j0, i0]
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                if black[j, i] != first:
                    return -2
        return _BLACK if first else _WHITE
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    away = _nearest_dot(x, y, dots)
    reach = np.hypot(x1 - x0, y1 - y0) / 2
    if abs(away - dots[4]) <= reach:
        return -2
    return _BLACK if away < dots[4] else _WHITE


@njit(cache=True, nogil=True)
def _cover(  # type: ignore[no-untyped-def]
    rays, per_x, per_y, lattice, R, o, bow, sheet, x_edges, y_edges, black, dots, box, out, white
):
    is_back = o[2] >= 0  # the camera is on the side that z points to
    for row in range(box[1], box[3]):
        for column in range(box[0], box[2]):
            x, y = rays[row, column]
            ax, ay = per_x[row, column]
            bx, by = per_y[row, column]
            x0, x1, y0, y1 = np.inf, -np.inf, np.inf, -np.inf
            known = True
            for corner in range(4):
                du = 0.51 if corner % 2 else -0.51
                dv = 0.51 if corner // 2 else -0.51
                X, Y = _on_board(x + ax * du + bx * dv, y + ay * du + by * dv, R, o, bow)
                if not (np.isfinite(X) and np.isfinite(Y)):
                    known = False
                    break
                x0, x1, y0, y1 = min(x0, X), max(x1, X), min(y0, Y), max(y1, Y)
            if not known:
                continue
            # a bowed surface bulges out of its corners' box by next to nothing: widen it
            wx, wy = 0.02 * (x1 - x0), 0.02 * (y1 - y0)
            found = _alike(
                (x0 - wx, x1 + wx, y0 - wy, y1 + wy), sheet, x_edges, y_edges, black, dots
            )
            if found == -2:
                n_sheet, n_white = 0, 0
                for k in range(len(lattice)):
                    du, dv = lattice[k]
                    X, Y = _on_board(x + ax * du + bx * dv, y + ay * du + by * dv, R, o, bow)
                    what = _ink(X, Y, sheet, x_edges, y_edges, black, dots)
                    n_sheet += what != _NOTHING
                    n_white += what == _WHITE or (is_back and what == _BLACK)
                out[row, column] = n_sheet / len(lattice)
                white[row, column] = n_white / len(lattice)
            elif found != _NOTHING:
                out[row, column] = 1
                white[row, column] = 1 if found == _WHITE or is_back else 0
