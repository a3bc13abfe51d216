"""What views of a board have in common, and which are worth using."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .board_detection import Detection
from .lens import BoardView, RejectedView

_BLUR_TIMES, _BLUR_PX = 1.6, 0.4
#: Views whose points lie this near to each other's on average show the same pose.
_REPEATED_PX = 0.5


def common_rows(a: BoardView, b: BoardView) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows of the points that both views show, in each."""
    at = {tuple(p): i for i, p in enumerate(np.round(b.points, 6).tolist())}
    pairs = [
        (i, at[tuple(p)]) for i, p in enumerate(np.round(a.points, 6).tolist()) if tuple(p) in at
    ]
    found = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def mean_apart_px(a: BoardView, b: BoardView) -> float:
    """Mean distance of the points that both views show; infinite where there are none."""
    rows_a, rows_b = common_rows(a, b)
    if not len(rows_a):
        return float("inf")
    return float(np.linalg.norm(a.pixels[rows_a] - b.pixels[rows_b], axis=1).mean())


def without_blur(detections: Sequence[Detection]) -> list[Detection]:
    """Those with a view that is not much more blurred than the sharper ones are."""
    seen = [d for d in detections if d.view is not None]
    if not seen:
        return []
    blur = np.array([d.sharpness_px for d in seen])
    if np.isnan(blur).all():
        return seen
    usual = float(np.nanpercentile(blur, 25))
    limit = max(_BLUR_TIMES * usual, usual + _BLUR_PX)
    return [d for d, b in zip(seen, blur, strict=True) if not b > limit]


def without_repeats(views: Sequence[BoardView]) -> tuple[list[BoardView], list[RejectedView]]:
    """Views, but each way of holding the board only once.

    A picture taken twice has the same errors twice: it says nothing new of the lens, but would
    make it look surer.
    """
    kept: list[BoardView] = []
    repeated = []
    for view in views:
        same = next((k.name for k in kept if mean_apart_px(view, k) < _REPEATED_PX), None)
        if same is None:
            kept.append(view)
        else:
            reason = f"the board lies as in {same}: nothing new; move it between pictures"
            repeated.append(RejectedView(view.name, reason))
    return kept, repeated
