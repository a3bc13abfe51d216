"""Boards in pictures: every point measured, and every failure told in words."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.boards import Board
from .board_sighting import NotSeen, Sighting
from .chessboard_detection import find_chessboard
from .grid_order import look_alikes
from .lens import BoardView

_MIN_SIDE_PX = 32
#: How reasons begin where nothing of a board was seen: the negative is then tried.
_NOTHING = "no board"


@dataclass(frozen=True, eq=False)
class Detection:
    """What became of one picture.

    Attributes
    ----------
    name : str
    view : BoardView or None
        The points found, in the order of `Board.object_points`; what is covered is left out.
    reason : str or None
        Why there is no view, for a user to read.
    sharpness_px : float, px
        Standard deviation of the blur of edges, the worse of their directions; NaN where no edge
        was measured. Good pictures have 0.5 to 1.
    sd_px : float, px
        Standard deviation of a point's coordinate as the fit to the picture states it (RMS over
        the points); NaN without a view.
    step_px : float, px
        The smallest square, or distance of dots; NaN without a view.
    details : tuple of str
        What is worth knowing of a view that was found.
    """

    name: str
    view: BoardView | None
    reason: str | None
    sharpness_px: float = float("nan")
    sd_px: float = float("nan")
    step_px: float = float("nan")
    details: tuple[str, ...] = ()


def detect_board(
    image: NDArray[np.uint8], board: Board, *, name: str = "", thorough: bool = True
) -> Detection:
    """Find a board in a picture and measure its points.

    Corners are fitted (`corner_refinement`), dots too, with the bias of their perspective taken
    off (`circle_detection`). Boards that look alike when turned get the turn that is nearest to
    upright; `flip_view` gives the other.

    Parameters
    ----------
    image : (h, w) or (h, w, 3) uint8
        Grey or RGB.
    board : Board
    name : str
        For messages and for the view.
    thorough : bool
        Search again where the first search fails, and find out why it failed. Without it a
        chessboard takes some 30 ms a picture, or less where there is none.

    Returns
    -------
    Detection

    Raises
    ------
    ValueError
        If `image` has another shape or type.
    """
    gray = _gray(image)
    if min(gray.shape) < _MIN_SIDE_PX:
        h, w = gray.shape
        return Detection(name, None, f"too small: the picture has {w}x{h} px")
    found = _found(gray, board, thorough)
    if isinstance(found, NotSeen):
        return Detection(name, None, found.reason, found.blur_px)
    return Detection(
        name,
        BoardView(name, found.points, found.pixels),
        None,
        found.blur_px,
        float(np.sqrt((found.sd_px**2).mean())),
        found.step_px,
        found.notes,
    )


def flip_view(view: BoardView, board: Board) -> BoardView:
    """The same picture with the board taken to be held the other way round.

    For boards that look the same after half a turn: which way they were held cannot be seen, and
    two cameras may have decided differently.

    Raises
    ------
    ValueError
        If the board's looks tell how it was held, or the view has points that are not the board's.
    """
    points = board.object_points()
    half = points[0] + points[-1]
    orders = [o for o in look_alikes(board) if np.allclose(points[o], half - points)]
    if not orders:
        raise ValueError(f"{board} does not look the same after half a turn")
    apart = np.abs(points[None] - view.points[:, None]).max(axis=2)
    if len(view.points) and apart.min(axis=1).max() > 1e-6 * board.square_mm:
        raise ValueError(f"view {view.name} has points that {board} has not")
    to = orders[0][apart.argmin(axis=1)]
    order = np.argsort(to)
    return replace(view, points=points[to[order]], pixels=view.pixels[order])


def _gray(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    picture = np.asarray(image)
    is_gray = picture.ndim == 2
    if picture.dtype != np.uint8 or not (is_gray or (picture.ndim == 3 and picture.shape[2] == 3)):
        raise ValueError(
            f"image must be (h, w) or (h, w, 3) uint8, got {picture.shape} {picture.dtype}"
        )
    if 0 in picture.shape:
        raise ValueError(f"image must not be empty, got {picture.shape}")
    if is_gray:
        return np.ascontiguousarray(picture)
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY), np.uint8)


def _found(gray: NDArray[np.uint8], board: Board, thorough: bool) -> Sighting | NotSeen:
    """In the picture, or failing that in its negative."""
    if board.kind == "charuco":
        from .charuco_detection import find_charuco

        return find_charuco(gray, board)
    found = _dark_on_bright(gray, board, thorough)
    if thorough and isinstance(found, NotSeen) and found.reason.startswith(_NOTHING):
        negative = _dark_on_bright(np.asarray(255 - gray, np.uint8), board, thorough)
        if isinstance(negative, Sighting):
            note = "the contrast is inverted: white was found where the board has black"
            return replace(negative, notes=(*negative.notes, note))
    return found


def _dark_on_bright(gray: NDArray[np.uint8], board: Board, thorough: bool) -> Sighting | NotSeen:
    if board.kind == "circles":
        from .circle_detection import find_circles

        return find_circles(gray, board)
    return find_chessboard(gray, board, thorough=thorough)
