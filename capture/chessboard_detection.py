"""Chessboards in a picture: found, counted, put in order, measured; or why not."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.boards import Board
from .board_map import BoardMap
from .board_sighting import NotSeen, Sighting, unusable
from .corner_refinement import Saddles, refine_saddles
from .grid_order import parity, preferred, put_in_order, turns

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
#: The search runs on a picture reduced to this; corners are then measured in the whole.
_SEARCH_PX = 1600
_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_LEAST_CONTRAST, _LEAST_SHARE = 4.0, 0.35  # grey levels; of the board's median
_MOST_MISFIT = 0.5
_MISFIT_TIMES, _LEAST_MISFIT = 3.0, 0.12  # of the other corners, before one is thought covered
_EVEN = 4.0  # grey levels of standard deviation: nothing can be told from such a picture
_MOST_SHIFT = 0.3  # of a square, from where the neighbours let a corner be expected
_LEAST_WHOLE = 0.8  # share of the corners that must be clear
_LEAST_ROUGH = 0.5  # share of a line's corners at a first, rough look
_LEAST_RIM = 0.5  # of each outermost line: where one is missing, the board is another
_MAX_LINES = 60
_LEAST_OFF_PX = 0.3  # from the place the others give: below it nothing is thought wrong
_RIMS = (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1])
_SEEDS = ((7, 5), (5, 4), (4, 4), (4, 3), (3, 3))
#: Grids of this size or larger, and how they are looked for.
_OPEN_SEEDS = (
    ((3, 3), cv2.CALIB_CB_NORMALIZE_IMAGE),
    ((4, 3), cv2.CALIB_CB_EXHAUSTIVE),
    ((5, 4), cv2.CALIB_CB_EXHAUSTIVE),
)
#: Where the grey levels of a square are looked at, of its sides.
_INSIDE = np.array([0.25, 0.5, 0.75])


def find_chessboard(image: Image, board: Board, *, thorough: bool = True) -> Sighting | NotSeen:
    """Find a chessboard and measure its inner corners.

    Parameters
    ----------
    image : (h, w) uint8
    board : Board
    thorough : bool
        Search again where the first search fails, and say what is there instead.

    Returns
    -------
    Sighting or NotSeen
    """
    why: NotSeen | None = None
    for grid in _grids_of_size(image, board, thorough):
        found = _measured(image, board, grid)
        if isinstance(found, Sighting) or not _is_vague(found):
            return found
        why = why or found
    if not thorough:
        return why or NotSeen("no board was found at first sight")
    explained = _explained(image, board)
    return why if why is not None and _is_nothing(explained) else explained


def _is_nothing(found: Sighting | NotSeen) -> bool:
    return isinstance(found, NotSeen) and found.reason.startswith("no board")


def _is_vague(found: NotSeen) -> bool:
    """Whether a detector's own mistake would explain it as well."""
    return found.reason.startswith(("mis-ordered", "only"))


def _grids_of_size(image: Image, board: Board, thorough: bool) -> Iterator[Floats]:
    """Corners of grids of the board's size, rough, (N, 2) px; the cheapest search first."""
    size = board.columns, board.rows
    for scaled, factor in _scales(image):
        found, corners = cv2.findChessboardCorners(scaled, size, flags=_CLASSIC)
        if found:
            yield _full_size(corners, factor)
        if not thorough:
            return
    scaled, factor = next(iter(_scales(image)))
    found, corners = cv2.findChessboardCornersSB(scaled, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if found:
        yield _full_size(corners, factor)


def _scales(image: Image) -> Iterator[tuple[Image, float]]:
    """The picture at search size, then smaller (for blur), then larger (for tiny boards)."""
    longest = max(image.shape)
    first = min(1.0, _SEARCH_PX / longest)
    factors = [first, first / 2, first / 4] + [2.0] * (longest <= _SEARCH_PX / 2)
    for factor in factors:
        width, height = round(image.shape[1] * factor), round(image.shape[0] * factor)
        if min(width, height) < 32:
            continue
        way = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
        scaled = image if factor == 1 else cv2.resize(image, (width, height), interpolation=way)
        yield np.asarray(scaled, dtype=np.uint8), factor


def _full_size(corners: NDArray[np.float32], factor: float) -> Floats:
    """Pixels of the whole picture; centres of pixels are at whole numbers in both."""
    return (corners.reshape(-1, 2).astype(np.float64) + 0.5) / factor - 0.5


def _measured(image: Image, board: Board, rough: Floats) -> Sighting | NotSeen:
    """Corners in order, refined and checked."""
    points = board.object_points()[:, :2]
    ordered, changed = put_in_order(points, rough, board.square_mm)
    if ordered is None:
        return NotSeen("mis-ordered: corners were found, but no order makes them this board")
    notes = ["the detector's order was wrong and was put right"] * changed
    saddles = fit_saddles(image, ordered, points, board.square_mm)
    if saddles is None:
        return NotSeen("mis-ordered: the corners found do not lie as on a flat board")
    columns, rows = board.columns, board.rows
    whole_grid = _completed(saddles, points, board)
    larger = grown(image, whole_grid.reshape(rows, columns, 2), most_lines=1)
    if larger is None:
        return NotSeen("mis-ordered: some of the corners found are none of a chessboard")
    if larger.shape[:2] != (rows, columns):
        whole = grown(image, larger)
        return _wrong_size(image, board, larger if whole is None else whole)
    order, said = _orientation(board, ordered, saddles)
    notes += said
    return _sighting(board, _taken(saddles, order), notes)


def _completed(saddles: Saddles, points: Floats, board: Board) -> Floats:
    """Centres, those that are not clear replaced by where the others let them be expected."""
    is_clear = clear(saddles, points, parity(board), board.square_mm)
    board_map = BoardMap.fit(points[is_clear], saddles.centres[is_clear])
    if is_clear.all() or board_map is None:
        return saddles.centres
    return np.where(is_clear[:, None], saddles.centres, board_map(points))


def fit_saddles(
    image: Image, start: Floats, points: Floats, step: float, *, inset: float = 1.0
) -> Saddles | None:
    """Corners (N, 2) px of points (N, 2) mm; None where the points do not lie as on a board."""
    board_map = BoardMap.fit(points, start)
    if board_map is None:
        return None
    return refine_saddles(image, start, points, board_map, step=step, inset=inset)


def _orientation(
    board: Board, start: Floats, saddles: Saddles
) -> tuple[NDArray[np.intp], list[str]]:
    """Which turn of the board is seen, by its colours where they tell."""
    colours = parity(board)
    every = turns(board)
    fits = [
        order
        for order, sign in every
        if np.nansum(colours * np.sign(sign * saddles.contrast[order])) > 0
    ]
    if not fits:
        return preferred(board, [order for order, _ in every], start), [
            "the square beside the first corner is white"
        ]
    return preferred(board, fits, start), []


def _taken(saddles: Saddles, order: NDArray[np.intp]) -> Saddles:
    return Saddles(
        saddles.centres[order], saddles.sd_px[order], saddles.blur_px[order],
        saddles.contrast[order], saddles.misfit[order],
    )  # fmt: skip


def _sighting(board: Board, saddles: Saddles, notes: list[str]) -> Sighting | NotSeen:
    """The corners that are clear, if they are enough."""
    points = board.object_points()
    is_clear = clear(saddles, points[:, :2], parity(board), board.square_mm)
    n, total = int(is_clear.sum()), len(points)
    rims = [is_clear.reshape(board.rows, board.columns)[rim] for rim in _RIMS]
    if n < _LEAST_WHOLE * total or min(rim.mean() for rim in rims) < _LEAST_RIM:
        return NotSeen(f"only {n} of {total} corners are clear: something covers the board")
    if n < total:
        notes = [*notes, f"{total - n} of {total} corners left out: covered or unclear"]
    blur = float(np.median(saddles.blur_px[is_clear].max(axis=1)))
    step = smallest_step(points[is_clear, :2], saddles.centres[is_clear], board.square_mm)
    return unusable(step, blur) or Sighting(
        points[is_clear], saddles.centres[is_clear], saddles.sd_px[is_clear], blur, step,
        tuple(notes),
    )  # fmt: skip


def clear(saddles: Saddles, points: Floats, colours: Floats, step: float) -> NDArray[np.bool_]:
    """Which fits, (N,), are corners of the board beyond doubt: contrast, shape and place agree."""
    is_clear = np.isfinite(saddles.centres).all(axis=1) & (saddles.misfit < _MOST_MISFIT)
    if is_clear.sum() < 4:
        return is_clear
    usual = float(np.median(saddles.misfit[is_clear]))
    with np.errstate(invalid="ignore"):
        is_clear &= saddles.misfit < max(_MISFIT_TIMES * usual, _LEAST_MISFIT)
    signed = saddles.contrast * colours
    signed = signed * np.sign(np.median(signed[is_clear]))
    with np.errstate(invalid="ignore"):
        is_clear &= signed > max(_LEAST_CONTRAST, _LEAST_SHARE * float(np.median(signed[is_clear])))
    if is_clear.sum() < 4:
        return is_clear
    fitted = BoardMap.fit(points[is_clear], saddles.centres[is_clear])
    if fitted is None:
        return np.zeros_like(is_clear)
    off = np.linalg.norm(fitted(points) - saddles.centres, axis=1)
    spread = 1.4826 * float(np.median(off[is_clear]))
    size = smallest_step(points[is_clear], saddles.centres[is_clear], step)
    with np.errstate(invalid="ignore"):
        return np.asarray(is_clear & (off < max(8 * spread, min(0.1 * size, _LEAST_OFF_PX))))


def smallest_step(points: Floats, pixels: Floats, step: float) -> float:
    """The smallest picture of a square's side, px; NaN where that cannot be known."""
    fitted = BoardMap.fit(points, pixels)
    if fitted is None:
        return float("nan")
    along_x, along_y, _, _ = fitted.axes(points, step)
    return float(np.linalg.norm(np.concatenate([along_x, along_y]), axis=1).min())


# --- how large the board in the picture is --------------------------------------------------


def grown(image: Image, grid: Floats, *, most_lines: int = _MAX_LINES) -> Floats | None:
    """A grid of corners, extended by whole lines for as long as the picture goes on with them.

    Parameters
    ----------
    image : (h, w) uint8
    grid : (rows, columns, 2) float64, px
    most_lines : int
        To add at most, on each side.

    Returns
    -------
    (rows, columns, 2) float64, px, or None
        None where the given grid itself is no chessboard.
    """
    if not (np.isfinite(grid).all() and _has_squares(image, grid)):
        return None
    for _ in range(most_lines):
        before = grid.shape
        for quarter in range(4):
            # the last row of the turned grid is each side once
            turned = np.rot90(grid, quarter)
            more = _next_line(image, turned)
            if more is None:
                return None
            grid = np.rot90(more, -quarter)
        if grid.shape == before:
            break
    return grid


def _has_squares(image: Image, grid: Floats) -> bool:
    """Whether black and white squares lie between the corners (rows, columns, 2) px of a grid.

    A detector that leaves corners out can come home with a smaller grid, each corner of which is
    right. Its cells are mixtures of squares, which differ within by more than from each other.
    """
    rows, columns = grid.shape[:2]
    v, u = (a.ravel()[:, None, None, None] for a in np.meshgrid(_INSIDE, _INSIDE))
    top = (1 - u) * grid[:-1, :-1] + u * grid[:-1, 1:]
    bottom = (1 - u) * grid[1:, :-1] + u * grid[1:, 1:]
    h, w = image.shape
    x, y = np.rint((1 - v) * top + v * bottom).astype(int).clip(0, (w - 1, h - 1)).T
    levels = image[y, x].astype(np.float64).T  # (9, rows - 1, columns - 1)
    level = levels.mean(axis=0)
    sign = (-1.0) ** np.add.outer(np.arange(rows - 1), np.arange(columns - 1))
    down = np.diff(level, axis=0) * sign[:-1]
    along = np.diff(level, axis=1) * sign[:, :-1]
    steps = np.concatenate([down.ravel(), along.ravel()])
    if not len(steps):
        return True  # one square: nothing to compare it with
    return abs(float(np.median(steps))) > float(np.median(np.ptp(levels, axis=0)))


def _next_line(image: Image, grid: Floats) -> Floats | None:
    """The grid with one row more if there is one, else the grid."""
    rows, columns = grid.shape[:2]
    row, column = np.mgrid[0 : rows + 1, 0:columns].reshape(2, -1).astype(np.float64)
    points = np.stack([column, row], axis=1)
    inner = row < rows
    # far from what is known a polynomial runs wild: only the last rows, and only their bend
    near = inner & (row >= rows - 4)
    flat = grid.reshape(-1, 2)
    board_map = BoardMap.fit(points[near], flat[near[inner]], most_degree=2)
    if board_map is None:
        return None
    last, line = inner & (row == rows - 1), ~inner
    here, expected = flat[last[inner]], board_map(points[line])
    colours = (-1.0) ** (row + column)
    known = _crossing(image, here, points[last], board_map) * colours[last]
    new = _crossing(image, expected, points[line], board_map) * colours[line]
    usual = float(np.median(known))
    if abs(usual) < _LEAST_CONTRAST or (known * np.sign(usual) > 0).mean() < _LEAST_RIM:
        return None
    if (new * np.sign(usual) > _LEAST_SHARE * abs(usual)).mean() < _LEAST_ROUGH:
        return grid
    found = refine_saddles(image, expected, points[line], board_map, step=1.0)
    size = np.linalg.norm(np.diff(grid[-2:], axis=0)[0], axis=1)
    shift = np.linalg.norm(found.centres - expected, axis=1)
    with np.errstate(invalid="ignore"):
        signed = found.contrast * colours[line] * np.sign(usual)
        goes_on = (signed > _LEAST_SHARE * abs(usual)) & (found.misfit < _MOST_MISFIT)
        goes_on &= shift < _MOST_SHIFT * size
    if goes_on.mean() < _LEAST_WHOLE:
        return grid
    row_found = np.where(goes_on[:, None], found.centres, expected)
    return np.concatenate([grid, row_found[None]], axis=0)


def _crossing(image: Image, at: Floats, points: Floats, board_map: BoardMap) -> Floats:
    """Half of bright less dark from four places around each corner, as `Saddles.contrast`.

    0 where opposite squares are not alike, or lie outside the picture.
    """
    along_x, along_y, _, _ = board_map.axes(points, 0.3)
    h, w = image.shape
    levels = []
    for u, v in ((-1, -1), (1, 1), (1, -1), (-1, 1)):
        x, y = np.rint(at + u * along_x + v * along_y).astype(int).T
        inside = (x > 0) & (y > 0) & (x < w - 1) & (y < h - 1)
        x, y = x.clip(1, w - 2), y.clip(1, h - 2)
        near = [image[y + j, x + i].astype(np.float64) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        levels.append(np.where(inside, np.mean(near, axis=0), np.nan))
    same = (levels[0] + levels[1] - levels[2] - levels[3]) / 4
    unlike = np.maximum(np.abs(levels[0] - levels[1]), np.abs(levels[2] - levels[3])) / 2
    with np.errstate(invalid="ignore"):
        return np.where(unlike < np.abs(same), same, 0.0)


def _seeds(image: Image) -> Iterator[Floats]:
    """Grids of corners in the picture, (rows, columns, 2) px; the cheapest search first."""
    scales = list(_scales(image))[:2]
    for scaled, factor in scales:
        for size, how in _OPEN_SEEDS:
            flags = cv2.CALIB_CB_LARGER | how
            found, corners, meta = cv2.findChessboardCornersSBWithMeta(scaled, size, flags)
            if found and meta is not None:
                yield _full_size(corners, factor).reshape(*meta.shape, 2)
    for scaled, factor in scales:
        for columns, rows in _SEEDS:
            found, corners = cv2.findChessboardCorners(scaled, (columns, rows), flags=_CLASSIC)
            if found:
                yield _full_size(corners, factor).reshape(rows, columns, 2)


def _explained(image: Image, board: Board) -> Sighting | NotSeen:
    """From any part of a chessboard: the board after all, or what is there instead."""
    best: Floats | None = None
    for seed in _seeds(image):
        grid = grown(image, seed)
        if grid is None:
            continue
        if _same_size(grid, board):
            found = _measured(image, board, _as_board(grid, board))
            if isinstance(found, Sighting):
                return found
        is_confirmed = best is not None and grid.shape == best.shape
        if best is None or grid.size > best.size:
            best = grid
        if is_confirmed:
            break
    if best is not None:
        return _wrong_size(image, board, best)
    if float(image.std()) < _EVEN:
        return NotSeen("no board: the picture is even all over, too dark or too bright")
    return NotSeen("no board was found")


def _same_size(grid: Floats, board: Board) -> bool:
    return sorted(grid.shape[:2]) == sorted((board.rows, board.columns))


def _as_board(grid: Floats, board: Board) -> Floats:
    """Row by row, and turning as the board's axes do."""
    if grid.shape[:2] != (board.rows, board.columns):
        grid = np.rot90(grid)
    right, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if right[0] * down[1] - right[1] * down[0] < 0:
        grid = grid[::-1]
    return np.asarray(grid).reshape(-1, 2)


def _wrong_size(image: Image, board: Board, grid: Floats) -> NotSeen:
    """What to say of a grid that is not the board's."""
    shown = sorted(grid.shape[:2], reverse=True)
    wanted = sorted((board.columns, board.rows), reverse=True)
    size = f"{shown[0]}x{shown[1]}"
    asked = f"{board.columns}x{board.rows}"
    sides = _cut_sides(image, grid)
    if sides and shown[0] <= wanted[0] and shown[1] <= wanted[1]:
        return NotSeen(
            f"cut off: {size} of {asked} corners are seen, and the board goes on beyond the "
            f"picture ({', '.join(sides)})"
        )
    if [n + 1 for n in shown] == wanted:
        return NotSeen(
            f"wrong size: the picture shows {size} inner corners ({asked} squares), not {asked}; "
            f"boards are counted by inner corners: {size}"
        )
    if shown[0] <= wanted[0] and shown[1] <= wanted[1]:
        return NotSeen(
            f"only {size} of {asked} corners can be seen: another board, or something covers it"
        )
    return NotSeen(f"wrong size: the picture shows {size} inner corners, not {asked}")


def _cut_sides(image: Image, grid: Floats) -> list[str]:
    """Edges of the picture within one square of which the grid ends."""
    h, w = image.shape
    found: list[str] = []
    for quarter in range(4):
        turned = np.rot90(grid, quarter)
        beyond = turned[-1] + 1.0 * (turned[-1] - turned[-2])
        outside = {
            "left": beyond[:, 0] < 0, "right": beyond[:, 0] > w - 1,
            "top": beyond[:, 1] < 0, "bottom": beyond[:, 1] > h - 1,
        }  # fmt: skip
        found += [side for side, is_out in outside.items() if is_out.any() and side not in found]
    return found
