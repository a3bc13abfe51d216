"""Boards of dots in a picture. A dot's outline is fitted, and the bias of its perspective undone.

The picture of a disc is, but for the lens, an ellipse; its centre is not the picture of the disc's
centre, for the nearer half looks larger. How far they are apart follows from how the board lies,
which follows from the dots: a few rounds settle it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..core.boards import Board
from .board_map import BoardMap
from .board_sighting import NotSeen, Sighting, unusable
from .chessboard_detection import smallest_step
from .grid_order import in_order, look_alikes, preferred, put_in_order

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
_SEARCH_PX = 1600
_ROUNDS = 4
_N = 8  # cx, cy, three of the ellipse's matrix, blur, background, dot
_STEPS = 30
_REACH = 1.45  # of the window, in the dot's radii: dots of 0.3 leave 1.67 to the middle between
_LEAST_RADIUS_PX = 1.5
_MOST_MISFIT, _LEAST_CONTRAST = 0.35, 6.0
_LEAST_WHOLE = 0.9
_RINGS, _SPOKES = 6, 24
#: Dark is what lies this many grey levels below the mean of a block, of these shares of the
#: picture's shorter side.
_BLOCKS, _BELOW_MEAN = (0.4, 0.15, 0.06), 6
_LEAST_AREA = 10.0
_LEAST_OF_CONTRAST = 0.45
Place = tuple[int, int]
_FOUR_WAYS = [(1, 0), (-1, 0), (0, 1), (0, -1)]
_MOST_GROWTH = 60
_NEAR_PLACE = 0.35  # of a step, from where a dot is expected
_LEAST_LINE = 0.5  # of a line's places, before it belongs to the board
_MOST_COUNTED = 400


def find_circles(image: Image, board: Board) -> Sighting | NotSeen:
    """Find a board of dark dots and measure the pictures of their middles.

    Parameters
    ----------
    image : (h, w) uint8
    board : Board
        Of kind circles.

    Returns
    -------
    Sighting or NotSeen
    """
    points = board.object_points()[:, :2]
    blobs = _blobs(image, len(points))
    rough = _rough(board, blobs)
    if rough is None:
        return _not_found(image, board, blobs)
    ordered, changed = put_in_order(points, rough, _nearest(board))
    if ordered is None:
        whole = _grid_of_all(blobs)
        if whole is not None:
            return NotSeen(_not_asked(board, *whole))
        return NotSeen("mis-ordered: dots were found, but no order makes them this board")
    if BoardMap.fit(points, ordered) is None or not in_order(points, ordered, _nearest(board)):
        return NotSeen("mis-ordered: the dots found do not lie as on a flat board")
    columns, rows = _size_shown(board, ordered, blobs)
    if (columns, rows) != (board.columns, board.rows):
        whole = _grid_of_all(blobs)
        return NotSeen(_not_asked(board, *(whole or (columns, rows, board.asymmetric))))
    order = preferred(board, look_alikes(board), ordered)
    notes = ["the detector's order was wrong and was put right"] * changed
    return _measured(image, board, ordered[order], notes)


def _nearest(board: Board) -> float:
    """Distance of a dot to its nearest neighbour, mm."""
    return board.square_mm * (math.sqrt(2) if board.asymmetric else 1.0)


def _reduced(image: Image) -> tuple[Image, float]:
    factor = min(1.0, _SEARCH_PX / max(image.shape))
    if factor == 1:
        return image, 1.0
    size = round(image.shape[1] * factor), round(image.shape[0] * factor)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8), factor


def _blobs(image: Image, total: int) -> Floats:
    """x, y, diameter of dark ellipses on something evenly brighter, (M, 3) px."""
    small, factor = _reduced(image)
    smooth = cv2.GaussianBlur(small, (3, 3), 0)
    found: list[Floats] = []
    for share in _BLOCKS:
        block = max(int(min(small.shape) * share), 3) | 1
        dark = cv2.adaptiveThreshold(
            smooth, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, block, _BELOW_MEAN
        )
        outlines, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        for outline in outlines:
            blob = _ellipse(small, outline)
            if blob is not None and all(np.hypot(*(blob - o)[:2]) > 0.3 * o[2] for o in found):
                found.append(blob)
    flat = np.array(found).reshape(-1, 4)
    if len(flat):
        # clutter may outnumber the dots, but is fainter: half of the dots say what is usual
        usual = np.sort(flat[:, 3])[-min(len(flat), max(total // 2, 1))]
        flat = flat[flat[:, 3] > _LEAST_OF_CONTRAST * usual]
    return np.column_stack([(flat[:, :2] + 0.5) / factor - 0.5, flat[:, 2] / factor])


def _ellipse(image: Image, outline: NDArray[np.int32]) -> Floats | None:
    """x, y, diameter and contrast of an outline, (4,); None if it is no dark ellipse."""
    m = cv2.moments(outline)
    area = m["m00"]
    if len(outline) < 8 or not _LEAST_AREA < area < 0.02 * image.size:
        return None
    centre = np.array([m["m10"], m["m01"]]) / area
    spread = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / area
    minor, major = np.linalg.eigvalsh(spread)
    # an ellipse has the area 4 pi sqrt(det of its second moments)
    if minor < 0.03 * major or not 0.85 < area / (4 * np.pi * np.sqrt(minor * major)) < 1.1:
        return None
    turn = np.arange(16) * (2 * np.pi / 16)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rim = circle @ (2 * np.linalg.cholesky(spread)).T
    rim *= 1.15 + 1.5 / np.linalg.norm(rim, axis=1, keepdims=True)
    h, w = image.shape
    x, y = np.rint(centre + rim).astype(int).clip(0, (w - 1, h - 1)).T
    level = float(image[round(float(centre[1])), round(float(centre[0]))])
    contrast = float(np.percentile(image[y, x], 20)) - level
    if contrast < _LEAST_CONTRAST:
        return None
    return np.array([*centre, 2 * np.sqrt(area / np.pi), contrast])


def _rough(board: Board, blobs: Floats) -> Floats | None:
    """Centres of blobs that make the board's grid, in OpenCV's order."""
    layout = cv2.CALIB_CB_ASYMMETRIC_GRID if board.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    if not len(blobs):
        return None
    size, parameters = (board.columns, board.rows), cv2.CirclesGridFinderParameters()
    near_in_size = np.abs(np.log(blobs[:, 2] / np.median(blobs[:, 2]))) < 0.7
    for some in (blobs, blobs[near_in_size]):
        if len(some) < board.columns * board.rows:
            continue
        candidates = some[:, None, :2].astype(np.float32)
        for how in (cv2.CALIB_CB_CLUSTERING, 0):
            found, centres = cv2.findCirclesGrid(candidates, size, layout | how, None, parameters)
            if found:
                return np.asarray(centres.reshape(-1, 2), dtype=np.float64)
    return None


def _lattice(columns: int, rows: int, asymmetric: bool) -> Floats:
    """Whole-numbered places of dots, row by row, (N, 2); neighbours are 1 or (1, 1) apart."""
    row, column = np.mgrid[0:rows, 0:columns].reshape(2, -1)
    return np.stack([2 * column + row % 2 if asymmetric else column, row], axis=1).astype(float)


def _size_shown(board: Board, ordered: Floats, blobs: Floats) -> tuple[int, int]:
    """Columns and rows of the dots in the picture, the board's included.

    Parameters
    ----------
    ordered : (N, 2) float64, px
        In the order of the board's points.
    blobs : (M, 3) float64, px
    """
    steps = [(1, 1), (1, -1), (-1, 1), (-1, -1)] if board.asymmetric else _FOUR_WAYS
    at = _lattice(board.columns, board.rows, board.asymmetric)
    known = {(int(x), int(y)): p for (x, y), p in zip(at, ordered, strict=True)}
    tree = cKDTree(blobs[:, :2])
    for _ in range(_MOST_GROWTH):
        near = {(x + dx, y + dy) for x, y in known for dx, dy in steps} - known.keys()
        # far from what is known a polynomial runs wild
        fitted = BoardMap.fit(np.array([*known], float), np.array([*known.values()]), most_degree=0)
        if fitted is None or not near:
            break
        places = np.array([*near], float)
        along_x, along_y, _, _ = fitted.axes(places, 1.0)
        size = np.minimum(np.linalg.norm(along_x, axis=1), np.linalg.norm(along_y, axis=1))
        distance, which = tree.query(fitted(places))
        is_there = distance < _NEAR_PLACE * size
        lines = _lines_that_go_on([*near], is_there, known)
        if not lines:
            break
        known |= {p: blobs[w, :2] for p, w, there in zip(near, which, is_there, strict=True)
                  if there and p in lines}  # fmt: skip
    x, y = np.array([*known]).T
    columns = int(np.ptp(x)) + 1
    return (columns + 1) // 2 if board.asymmetric else columns, int(np.ptp(y)) + 1


def _lines_that_go_on(
    near: list[Place], is_there: NDArray[np.bool_], known: Mapping[Place, Floats]
) -> set[Place]:
    """Of places beside a grid those in rows or columns of which half the dots are there."""
    x, y = np.array([*known]).T
    found: set[Place] = set()
    for axis, values in ((0, (x.min() - 1, x.max() + 1)), (1, (y.min() - 1, y.max() + 1))):
        for value in values:
            line = [i for i, place in enumerate(near) if place[axis] == value]
            if line and is_there[line].mean() >= _LEAST_LINE:
                found |= {near[i] for i in line}
    return found


def _not_asked(board: Board, columns: int, rows: int, asymmetric: bool) -> str:
    """What to say of a grid of dots that is not the board's."""
    kinds = (":asymmetric" * asymmetric, ":asymmetric" * board.asymmetric)
    if kinds[0] == kinds[1]:
        kinds = ("", "")
    return (
        f"wrong size: the picture shows {columns}x{rows}{kinds[0]} dots, "
        f"not {board.columns}x{board.rows}{kinds[1]}"
    )


def _grid_of_all(blobs: Floats) -> tuple[int, int, bool] | None:
    """Columns, rows and shift of the one grid that all dots of the picture make, if they do."""
    dots = _like_most(blobs)
    n = len(dots)
    if not 4 <= n <= _MOST_COUNTED:
        return None
    places = dots[:, None, :2].astype(np.float32)
    parameters = cv2.CirclesGridFinderParameters()
    for columns in range(2, n // 2 + 1):
        if n % columns:
            continue
        for asymmetric in (False, True):
            if not asymmetric and columns < n // columns:
                continue  # the same grid, turned
            layout = cv2.CALIB_CB_ASYMMETRIC_GRID if asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
            for how in (0, cv2.CALIB_CB_CLUSTERING):
                asked = columns, n // columns
                found, centres = cv2.findCirclesGrid(places, asked, layout | how, None, parameters)
                ideal = _lattice(*asked, asymmetric)
                if (
                    found
                    and put_in_order(ideal, centres.reshape(-1, 2).astype(float), 1.0)[0]
                    is not None
                ):
                    return (*asked, asymmetric)
    return None


def _not_found(image: Image, board: Board, blobs: Floats) -> NotSeen:
    if float(image.std()) < 4.0:
        return NotSeen("no board: the picture is even all over, too dark or too bright")
    total = board.columns * board.rows
    n = len(_like_most(blobs))
    if n < max(4, total // 4):
        return NotSeen("no board was found")
    h, w = image.shape
    dots = _like_most(blobs)[:, :2]
    step = float(np.median(cKDTree(dots).query(dots, k=2)[0][:, 1]))
    at_rim = (dots < step).any() or (dots > np.array([w, h]) - step).any()
    whole = _grid_of_all(blobs)
    if whole is not None and not (at_rim and n < total):
        return NotSeen(_not_asked(board, *whole))
    if n < total:
        cause = "cut off, or another board" if at_rim else "another board, or something covers it"
        size = "" if whole is None else f" ({whole[0]}x{whole[1]})"
        return NotSeen(f"{n} dots of {total} are seen{size}: {cause}")
    return NotSeen(
        f"{n} dots are seen, but not in the {board.columns}x{board.rows} order of this board: "
        "check columns, rows and :asymmetric"
    )


def _like_most(blobs: Floats) -> Floats:
    """The blobs of about the size that most have, (M', 3)."""
    if not len(blobs):
        return blobs
    size = blobs[:, 2]
    alike = [(size > 0.6 * s) & (size < 1.6 * s) for s in size]
    return np.asarray(blobs[max(alike, key=np.count_nonzero)])


def _measured(image: Image, board: Board, start: Floats, notes: list[str]) -> Sighting | NotSeen:
    points = board.object_points()
    flat = points[:, :2]
    fitted = BoardMap.fit(flat, start)
    assert fitted is not None  # it was fitted to these before
    rows = _fit_dots(image, start, flat, fitted, _nearest(board))
    with np.errstate(invalid="ignore"):
        good = (rows[:, _N + 1] < _MOST_MISFIT) & (rows[:, 6] - rows[:, 7] > _LEAST_CONTRAST)
    n, total = int(good.sum()), len(points)
    if n < max(4, _LEAST_WHOLE * total):
        return NotSeen(f"only {n} of {total} dots are clear: covered, blurred or too small")
    centres = _unbiased(flat[good], rows[good])
    blur = float(np.median(rows[good, 5]))
    step = smallest_step(flat[good], centres, board.square_mm)
    step *= math.sqrt(2) if board.asymmetric else 1.0
    notes = notes + [f"{total - n} of {total} dots left out: covered or unclear"] * (n < total)
    return unusable(step, blur, "distances of dots") or Sighting(
        points[good], centres, rows[good, _N], blur, step, tuple(notes)
    )


def _fit_dots(
    image: Image, start: Floats, points: Floats, fitted: BoardMap, nearest: float
) -> Floats:
    """(N, 10): the ellipse's parameters, the centre's standard deviation and the misfit."""
    along_x, along_y, _, _ = fitted.axes(points, nearest)
    found = np.full((len(points), _N + 2), np.nan)
    _fit_all(np.ascontiguousarray(image), np.ascontiguousarray(start), along_x, along_y, found)
    return found


def _unbiased(points: Floats, rows: Floats) -> Floats:
    """Pictures of the dots' middles, (N, 2) px, from the centres of their outlines."""
    outline = rows[:, :2]
    centres = outline
    area = np.pi / np.sqrt(rows[:, 2] * rows[:, 4] - rows[:, 3] ** 2)
    for _ in range(_ROUNDS):
        fitted = BoardMap.fit(points, centres)
        if fitted is None:
            return centres
        along_x, along_y, _, _ = fitted.axes(points, 1.0)
        scale = np.abs(along_x[:, 0] * along_y[:, 1] - along_x[:, 1] * along_y[:, 0])
        radius_mm = math.sqrt(float(np.median(area / scale)) / math.pi)
        centres = outline - _centroid_bias(fitted, points, radius_mm)
    return centres


def _centroid_bias(fitted: BoardMap, points: Floats, radius_mm: float) -> Floats:
    """How far the centroid of a disc's picture lies from the picture of its middle, (N, 2) px.

    The integral over the disc, by Gauss-Legendre in the square of the radius and evenly around.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_RINGS)
    r = radius_mm * np.sqrt((nodes + 1) / 2)
    turn = 2 * np.pi * (np.arange(_SPOKES) + 0.5) / _SPOKES
    disc = np.stack([np.outer(r, np.cos(turn)), np.outer(r, np.sin(turn))], axis=-1).reshape(-1, 2)
    weight = np.repeat(weights, _SPOKES)
    places = (points[:, None] + disc).reshape(-1, 2)
    h = 1e-3 * radius_mm
    here = fitted(places)
    by_x, by_y = (fitted(places + h * e) - fitted(places - h * e) for e in np.eye(2))
    area = np.abs(by_x[:, 0] * by_y[:, 1] - by_x[:, 1] * by_y[:, 0]).reshape(len(points), -1)
    share = area * weight
    share /= share.sum(axis=1, keepdims=True)
    centroid = (here.reshape(len(points), -1, 2) * share[..., None]).sum(axis=1)
    return np.asarray(centroid - fitted(points))


@njit(cache=True, nogil=True)
def _fit_all(image, start, along_x, along_y, found):  # type: ignore[no-untyped-def]
    for i in range(len(start)):
        _fit_one(image, start[i], along_x[i], along_y[i], found[i])


@njit(cache=True, nogil=True)
def _dot(p, x, y, grad):  # type: ignore[no-untyped-def]
    """Grey level at (x, y) from the window's centre, and its derivatives."""
    dx, dy = x - p[0], y - p[1]
    ax, ay = p[2] * dx + p[3] * dy, p[3] * dx + p[4] * dy
    rho = math.sqrt(dx * ax + dy * ay) + 1e-9  # 1 on the outline
    slope = math.hypot(ax, ay) / rho + 1e-9  # |gradient of rho|
    # distance to the outline, to first order; its own change of slope is left out of the gradient
    d = (rho - 1) / slope
    r = d / p[5]
    outside = 0.5 * (1 + math.erf(r / math.sqrt(2.0)))
    by_d = (p[6] - p[7]) * math.exp(-0.5 * r * r) / math.sqrt(2 * math.pi) / p[5]
    by_rho = by_d / slope
    grad[0], grad[1] = -by_rho * ax / rho, -by_rho * ay / rho
    grad[2] = by_rho * dx * dx / (2 * rho)
    grad[3] = by_rho * dx * dy / rho
    grad[4] = by_rho * dy * dy / (2 * rho)
    grad[5] = -by_d * r
    grad[6], grad[7] = outside, 1 - outside
    return p[7] + (p[6] - p[7]) * outside


@njit(cache=True, nogil=True)
def _equations(p, n, xs, ys, values, A, b):  # type: ignore[no-untyped-def]
    grad = np.empty(_N)
    A[:], b[:], total = 0.0, 0.0, 0.0
    for k in range(n):
        r = values[k] - _dot(p, xs[k], ys[k], grad)
        total += r * r
        for i in range(_N):
            b[i] += grad[i] * r
            for j in range(_N):
                A[i, j] += grad[i] * grad[j]
    return total


@njit(cache=True, nogil=True)
def _window(image, at, ex, ey, reach, xs, ys, values):  # type: ignore[no-untyped-def]
    """Pixels within an ellipse of `reach` steps around a place, relative to it; their number."""
    h, w = image.shape
    det = ex[0] * ey[1] - ex[1] * ey[0]
    half_x = int(np.ceil(reach * np.hypot(ex[0], ey[0])))
    half_y = int(np.ceil(reach * np.hypot(ex[1], ey[1])))
    count, missing = 0, 0
    for y in range(int(np.rint(at[1])) - half_y, int(np.rint(at[1])) + half_y + 1):
        for x in range(int(np.rint(at[0])) - half_x, int(np.rint(at[0])) + half_x + 1):
            dx, dy = x - at[0], y - at[1]
            u, v = (dx * ey[1] - dy * ey[0]) / det, (dy * ex[0] - dx * ex[1]) / det
            if u * u + v * v > reach * reach:
                continue
            if x < 0 or y < 0 or x >= w or y >= h:
                missing += 1
                continue
            if count < len(xs):
                xs[count], ys[count], values[count] = dx, dy, image[y, x]
                count += 1
    return count if missing < 0.15 * (count + missing) else -1


@njit(cache=True, nogil=True)
def _fit_one(image, start, ex, ey, found):  # type: ignore[no-untyped-def]
    room = int(4 * (np.hypot(ex[0], ey[0]) + 2) * (np.hypot(ex[1], ey[1]) + 2))
    xs, ys, values = np.empty(room), np.empty(room), np.empty(room)
    p, trial, here = np.zeros(_N), np.empty(_N), start.copy()
    A, b, A2, b2 = np.empty((_N, _N)), np.empty(_N), np.empty((_N, _N)), np.empty(_N)
    n = _window(image, here, ex, ey, 0.48, xs, ys, values)
    if n < 12:
        return
    # size from the share of dark pixels, which lies within the nearest half step
    low, high = values[:n].min(), values[:n].max()
    dark = (values[:n] < (low + high) / 2).sum() / n
    share = min(max(0.48 * math.sqrt(dark), 0.1), 0.45)  # radius, of the step
    M = np.array([[ex[0], ey[0]], [ex[1], ey[1]]]) * share
    Q = np.linalg.inv(M @ M.T)
    p[2], p[3], p[4], p[5], p[6], p[7] = Q[0, 0], Q[0, 1], Q[1, 1], 0.8, high, low
    cost = 0.0
    for _turn in range(2):
        reach = min(max(_REACH * share, share + 2.5 / np.hypot(ex[0], ex[1])), 0.5)
        n = _window(image, here, ex, ey, reach, xs, ys, values)
        if n < 12:
            return
        cost = _equations(p, n, xs, ys, values, A, b)
        damping = 1e-2
        for _ in range(_STEPS):
            lhs = A.copy()
            for i in range(_N):
                lhs[i, i] = A[i, i] * (1 + damping) + 1e-15
            trial[:] = p + np.linalg.solve(lhs, b)
            trial[5] = max(abs(trial[5]), 0.25)
            area = trial[2] * trial[4] - trial[3] * trial[3]
            if not (trial[2] > 0 and area > 0 and np.isfinite(trial.sum())):
                damping *= 10
                if damping > 1e9:
                    return
                continue
            lower = _equations(trial, n, xs, ys, values, A2, b2)
            if lower <= cost:
                moved = max(abs(trial[0] - p[0]), abs(trial[1] - p[1]))
                gain = cost - lower
                p[:], A[:], b[:], cost = trial, A2, b2, lower
                damping = max(damping * 0.2, 1e-9)
                if moved < 1e-3 and gain <= 1e-3 * cost:
                    break
            else:
                damping *= 6
                if damping > 1e9:
                    break
        here = here + p[:2]
        p[0] = p[1] = 0.0
    if p[2] * p[4] - p[3] * p[3] > 1 / _LEAST_RADIUS_PX**4:
        return
    for i in range(_N):
        A[i, i] *= 1 + 1e-10
    cov = np.linalg.inv(A)
    found[:_N] = p
    found[:2] = here
    found[_N] = math.sqrt(max(cost / max(n - _N, 1) * (cov[0, 0] + cov[1, 1]) / 2, 0.0))
    found[_N + 1] = math.sqrt(cost / n) / max(abs(p[6] - p[7]), 1e-9)
