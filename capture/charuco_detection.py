"""ChArUco boards in a picture: markers say which corner is which, corners are then measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.boards import Board
from ..core.errors import InputError
from .board_map import BoardMap
from .board_sighting import NotSeen, Sighting, unusable
from .chessboard_detection import clear, fit_saddles, smallest_step
from .grid_order import parity

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
_MIN_MARKERS, _MIN_CORNERS = 2, 6
#: Markers fit a board if their corners lie this near to a homography, in marker sides.
_MOST_OFF = 0.2
#: Share of the markers that must fit; some may be read wrongly or belong to something else.
_LEAST_FIT = 0.7
#: A corner is looked for within this many squares of a marker that was read.
_NEAR = 0.95
#: The same for markers beyond the asked board, where its map is extended: so many times that.
_MOST_BEYOND = 3.0
_MARKER_SIZE_OFF = 0.08
_MOST_COLUMNS = 30
#: Dictionaries tried, when that of the board is not in the picture, from common to rare.
_OTHERS = tuple(
    [f"DICT_{bits}X{bits}_1000" for bits in (4, 5, 6, 7)]
    + ["DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_36h11", "DICT_APRILTAG_16h5"]
)


def find_charuco(image: Image, board: Board) -> Sighting | NotSeen:
    """Find a ChArUco board, or what can be seen of it, and measure its corners.

    Parameters
    ----------
    image : (h, w) uint8
    board : Board
        Of kind charuco.

    Returns
    -------
    Sighting or NotSeen
    """
    assert board.dictionary is not None
    seen, ids = _markers(image, board.dictionary)
    if len(ids) < _MIN_MARKERS:
        return _without_markers(image, board, len(ids))
    board_map = _placed(board, seen, ids)
    if board_map is None:
        return _not_this_layout(board, seen, ids)
    rows = _rows_shown(board, board_map, seen, ids)
    if rows > board.rows:
        return NotSeen(
            f"wrong size: the picture shows {rows} rows or more of {board.columns} squares, "
            f"not {board.columns}x{board.rows}"
        )
    found = _corners(image, board, board_map, seen, ids)
    if isinstance(found, Sighting) and rows < board.rows:
        return replace(found, notes=(*found.notes, *_absent_rows(image, board, board_map, rows)))
    return found


def _markers(
    image: Image, dictionary: str, *, inverted: bool = False
) -> tuple[Floats, NDArray[np.intp]]:
    """Corners (M, 4, 2) px and ids (M,) of markers, each id once."""
    settings = cv2.aruco.DetectorParameters()
    settings.detectInvertedMarker = inverted
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    corners, ids, _ = cv2.aruco.ArucoDetector(known, settings).detectMarkers(image)
    if ids is None or not len(ids):
        return np.zeros((0, 4, 2)), np.zeros(0, int)
    flat = np.asarray(ids).ravel()
    values, counts = np.unique(flat, return_counts=True)
    once = np.isin(flat, values[counts == 1])
    return np.array(corners, dtype=np.float64).reshape(-1, 4, 2)[once], flat[once]


def _layout(board: Board) -> Floats:
    """Corners of the board's markers by id, (K, 4, 2) mm."""
    assert board.dictionary is not None and board.marker_mm is not None
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    made = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square_mm, board.marker_mm, known
    )
    made.setLegacyPattern(board.legacy)
    return np.array(made.getObjPoints(), dtype=np.float64)[:, :, :2]


def _placed(board: Board, seen: Floats, ids: NDArray[np.intp]) -> BoardMap | None:
    """Where the board lies, if most markers agree that they are its."""
    layout = _layout(board)
    known = ids < len(layout)
    if known.sum() < max(_MIN_MARKERS, _LEAST_FIT * len(ids)):
        return None
    points, pixels = layout[ids[known]], seen[known]
    H, _ = cv2.findHomography(
        points.reshape(-1, 2), pixels.reshape(-1, 2), cv2.RANSAC, _side(seen) * _MOST_OFF
    )
    if H is None or np.linalg.det(H[:2, :2]) <= 0:
        return None
    back = cv2.perspectiveTransform(points.reshape(1, -1, 2), H).reshape(pixels.shape)
    fits = np.linalg.norm(back - pixels, axis=2).max(axis=1) < 2 * _MOST_OFF * _side(seen)
    if fits.sum() < max(_MIN_MARKERS, _LEAST_FIT * len(ids)):
        return None
    return BoardMap.fit(points[fits].reshape(-1, 2), pixels[fits].reshape(-1, 2))


def _side(seen: Floats) -> float:
    """Median side of the markers, px."""
    sides = np.linalg.norm(seen - np.roll(seen, 1, axis=1), axis=2)
    return float(np.median(sides))


def _rows_shown(board: Board, board_map: BoardMap, seen: Floats, ids: NDArray[np.intp]) -> int:
    """Rows of squares down to the last marker that lies where such a board has it.

    Ids go on row by row, so a print with more rows has this board in its upper part.
    """
    most = _board_of(board, board.columns, _rows_for(board.columns, int(ids.max())), board.legacy)
    layout = _layout(board if most is None or most.rows < board.rows else most)
    known = ids < len(layout)
    off = np.linalg.norm(board_map(layout[ids[known]]) - seen[known], axis=2).max(axis=1)
    fits = off < _MOST_OFF * _MOST_BEYOND * _side(seen)
    return _rows_for(board.columns, int(ids[known][fits].max())) if fits.any() else 0


def _absent_rows(image: Image, board: Board, board_map: BoardMap, rows: int) -> tuple[str, ...]:
    """A word on last rows that should be in the picture, all of them, and are not."""
    layout = _layout(board).reshape(-1, 2)
    below = board_map(layout[layout[:, 1] > rows * board.square_mm])
    h, w = image.shape
    if not len(below) or not ((below > 0) & (below < (w - 1, h - 1))).all():
        return ()
    return (
        f"no marker below row {rows} of {board.rows} is seen, though there is room: "
        f"is it a board of {board.columns}x{rows}?",
    )


def _corners(
    image: Image, board: Board, board_map: BoardMap, seen: Floats, ids: NDArray[np.intp]
) -> Sighting | NotSeen:
    assert board.marker_mm is not None
    points = board.object_points()
    flat, step = points[:, :2], board.square_mm
    layout = _layout(board)
    read = layout[ids[ids < len(layout)]].mean(axis=1)
    # the middles of the four squares around a corner are half a square off along x and y
    apart = np.abs(flat[:, None] - read[None]).max(axis=2).min(axis=1)
    near = apart < _NEAR * step
    # blur and markers drawn a little large must not reach the window
    inset = max((step - board.marker_mm) / 2 / step - 0.02, 0.05)
    expected = board_map(flat)
    saddles = fit_saddles(image, expected, flat, step, inset=inset)
    if saddles is None or near.sum() < _MIN_CORNERS:
        return NotSeen(f"only {int(near.sum())} corners lie beside markers that can be read")
    is_clear = clear(saddles, flat, parity(board), step) & near
    n, total = int(is_clear.sum()), len(points)
    if n < _MIN_CORNERS:
        return NotSeen(f"only {n} of {total} corners are clear: {_MIN_CORNERS} are needed")
    blur = float(np.median(saddles.blur_px[is_clear].max(axis=1)))
    size = smallest_step(flat[is_clear], saddles.centres[is_clear], step)
    notes = [f"{n} of {total} corners are in the picture and clear"] * (n < total)
    found = Sighting(
        points[is_clear], saddles.centres[is_clear], saddles.sd_px[is_clear], blur, size,
        tuple(notes),
    )  # fmt: skip
    refused = unusable(size, blur)
    if refused is not None:
        return refused
    return replace(found, notes=(*found.notes, *_marker_size_notes(board, seen, ids)))


def _marker_size_notes(board: Board, seen: Floats, ids: NDArray[np.intp]) -> tuple[str, ...]:
    """Markers of another size do not spoil corners, but tell of another print."""
    assert board.marker_mm is not None
    layout = _layout(board)
    known = ids < len(layout)
    # by their middles, which stay where they are whatever the size
    middles = BoardMap.fit(layout[ids[known]].mean(axis=1), seen[known].mean(axis=1), most_degree=0)
    if middles is None:
        return ()
    ratio = _side(seen[known]) / _side(middles(layout[ids[known]]))
    if abs(ratio - 1) < _MARKER_SIZE_OFF:
        return ()
    return (
        f"markers look {ratio * board.marker_mm:.3g} mm large, not {board.marker_mm:g}, "
        "if the squares are right",
    )


# --- why not ----------------------------------------------------------------------------------


def _without_markers(image: Image, board: Board, n: int) -> NotSeen:
    assert board.dictionary is not None
    if len(_markers(image, board.dictionary, inverted=True)[1]) >= _MIN_MARKERS:
        return NotSeen(
            "inverted contrast: the markers are white on black, as in a negative; print the "
            "board dark on white"
        )
    for other in _OTHERS:
        if other.rsplit("_", 1)[0] != board.dictionary.rsplit("_", 1)[0]:
            n_other = len(_markers(image, other)[1])
            if n_other > max(3, 2 * n):
                return NotSeen(
                    f"wrong dictionary: {n_other} markers of {other} and {n} of "
                    f"{board.dictionary} are seen"
                )
    if n:
        return NotSeen(f"only {n} marker can be read: cut off, covered, too small or blurred")
    if float(image.std()) < 4.0:
        return NotSeen("no board: the picture is even all over, too dark or too bright")
    return NotSeen("no board: no marker can be read")


def _not_this_layout(board: Board, seen: Floats, ids: NDArray[np.intp]) -> NotSeen:
    """Another pattern or another size explains the markers."""
    text = f"{board.columns}x{board.rows}"
    for legacy, columns, n in _other_layouts(board, int(ids.max())):
        other = _board_of(board, columns, n, legacy)
        if other is None or _placed(other, seen, ids) is None:
            continue
        if columns == board.columns and legacy != board.legacy:
            which = "OpenCV's legacy pattern" if legacy else "the pattern since OpenCV 4.6"
            return NotSeen(
                f"legacy pattern: markers are placed as in {which}; give the board "
                f"{'with' if legacy else 'without'} :legacy"
            )
        rows = _rows_for(columns, int(ids.max()))
        return NotSeen(
            f"wrong size: markers fit a board of {columns} columns and {rows} rows or more "
            f"of squares, not {text}"
        )
    return NotSeen(f"{len(ids)} markers are seen, but not where a {text} board has them")


def _other_layouts(board: Board, largest_id: int) -> Iterator[tuple[bool, int, int]]:
    """Pattern, columns and rows that a print may have instead, the likeliest first."""
    yield not board.legacy, board.columns, board.rows
    for columns in (board.columns, *range(2, _MOST_COLUMNS)):
        # ids go row by row: how many rows there are shows only in the largest
        rows = _rows_for(columns, largest_id)
        yield board.legacy, columns, rows
        yield board.legacy, columns, rows + 1
        # the patterns differ where the number of rows is even
        yield not board.legacy, columns, rows + rows % 2


def _rows_for(columns: int, largest_id: int) -> int:
    """Rows of squares that hold an id, two squares to a marker."""
    return max(2, int(np.ceil(2 * (largest_id + 1) / columns - 1e-9)))


def _board_of(board: Board, columns: int, rows: int, legacy: bool) -> Board | None:
    try:
        return replace(board, columns=columns, rows=rows, legacy=legacy)
    except InputError:  # more markers than the dictionary has
        return None
