"""Which frames of a video of a board are worth calibrating with."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.boards import Board
from ..core.errors import InputError
from ..core.video import Frame, read_frames
from .board_detection import Detection, detect_board
from .board_map import BoardMap

Floats = NDArray[np.float64]
#: Frames looked at for each second: a board in a hand moves about its own blur in between.
_LOOKS_PER_S = 8.0
#: A frame is tried if it is at least this sharp, of the sharpest of late (by its gradients).
_SHARP_SHARE = 0.6
_FADES = 0.97  # of that memory, per frame
_POOL = 5  # candidates kept, for each view wanted
#: A view is blurred, if it is this many times as blurred as the sharper half, and so much more.
_BLUR_TIMES, _BLUR_PX = 1.6, 0.4
#: Views less apart than this (`_pose_signs`) are near duplicates: about 4 % of the picture, or
#: some 5° of tilt.
_ALIKE = 0.08


@dataclass(frozen=True, eq=False)
class _Candidate:
    detection: Detection
    signs: Floats


def choose_frames(
    video_path: Path,
    board: Board,
    *,
    max_views: int = 30,
    on_frame: Callable[[int], None] | None = None,
) -> list[Detection]:
    """Choose frames of a video that show a board sharply and in many different ways.

    One pass; memory does not grow with the length. Of the frames that are sharp for this video a
    few each second are searched; those blurred by motion and near duplicates are left out; of
    the rest those are taken that are farthest apart in place, size and tilt.

    Parameters
    ----------
    video_path : Path
    board : Board
    max_views : int
    on_frame : callable, optional
        Told the index of every frame read.

    Returns
    -------
    list of Detection
        Each with a view, by frame; named ``frame 123``. Empty if no frame shows the board.

    Raises
    ------
    FileFormatError
        If the video cannot be read to its end.
    InputError
        If fewer than one view is asked for.
    """
    if max_views < 1:
        raise InputError(f"at least one view must be chosen, got {max_views}")
    pool: list[_Candidate] = []
    looked_s, sharpest = -np.inf, 0.0
    with closing(read_frames(video_path, gray=True)) as frames:
        for frame in frames:
            if on_frame is not None:
                on_frame(frame.index)
            sharpness = _gradients(frame.image)
            sharpest = max(sharpest * _FADES, sharpness)
            is_due = frame.time_s >= looked_s + 1 / _LOOKS_PER_S
            if not is_due or sharpness < _SHARP_SHARE * sharpest:
                continue
            looked_s = frame.time_s
            candidate = _candidate(frame, board)
            if candidate is not None:
                pool.append(candidate)
                if len(pool) > 2 * _POOL * max_views:
                    pool = _spread(_without_blur(pool), _POOL * max_views)
    chosen = _spread(_without_blur(pool), max_views)
    return sorted((c.detection for c in chosen), key=lambda d: int(d.name.split()[1]))


def _candidate(frame: Frame, board: Board) -> _Candidate | None:
    # the decoder's memory is not ours: nothing of the picture is kept
    image = np.ascontiguousarray(frame.image)
    found = detect_board(image, board, name=f"frame {frame.index}", thorough=False)
    if found.view is None:
        return None
    h, w = frame.image.shape
    signs = _pose_signs(found, board, (w, h))
    return None if signs is None else _Candidate(found, signs)


def _gradients(image: NDArray[np.uint8]) -> float:
    """How steep the steepest places of a picture are, grey levels per pixel."""
    small = image[:: max(1, image.shape[0] // 480)]  # rows may be left out, columns not
    steps = cv2.absdiff(small[:, 1:], small[:, :-1])
    return float(np.percentile(steps, 99))


def _pose_signs(found: Detection, board: Board, image_size: tuple[int, int]) -> Floats | None:
    """Where the board is, how large and how tilted it looks, (6,), alike in weight."""
    assert found.view is not None
    fitted = BoardMap.fit(found.view.points[:, :2], found.view.pixels, most_degree=0)
    if fitted is None:
        return None
    low, high = (f(board.object_points()[:, :2], axis=0) for f in (np.min, np.max))
    quad = fitted(np.array([low, [high[0], low[1]], high, [low[0], high[1]]]))
    top, right, bottom, left = np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1)
    w, h = image_size
    middle = quad.mean(axis=0) / np.hypot(w, h)
    wide, tall = (top + bottom) / (high[0] - low[0]), (left + right) / (high[1] - low[1])
    return np.array([
        2 * middle[0], 2 * middle[1], 0.3 * np.log2(wide * tall),
        # opposite sides look unlike, and the sheet foreshortened, by tilt
        np.log(top / bottom), np.log(left / right), 0.7 * np.log(wide / tall),
    ])  # fmt: skip


def _without_blur(pool: list[_Candidate]) -> list[_Candidate]:
    if not pool:
        return pool
    blur = np.array([c.detection.sharpness_px for c in pool])
    usual = float(np.percentile(blur, 25))
    limit = max(_BLUR_TIMES * usual, usual + _BLUR_PX)
    return [c for c, b in zip(pool, blur, strict=True) if b <= limit]


def _spread(pool: list[_Candidate], most: int) -> list[_Candidate]:
    """At most so many of the pool, each as far as possible from those before it."""
    if not pool:
        return pool
    signs = np.array([c.signs for c in pool])
    # among views about as far away, the sharper one
    worth = 1 / np.array([1 + c.detection.sharpness_px for c in pool])
    first = int(np.argmin(np.linalg.norm(signs - np.median(signs, axis=0), axis=1)))
    chosen = [first]
    apart = np.linalg.norm(signs - signs[first], axis=1)
    while len(chosen) < most:
        apart[chosen] = 0.0
        best = int(np.argmax(np.where(apart > _ALIKE, apart * worth, 0.0)))
        if apart[best] <= _ALIKE:
            break
        chosen.append(best)
        apart = np.minimum(apart, np.linalg.norm(signs - signs[best], axis=1))
    return [pool[i] for i in chosen]
