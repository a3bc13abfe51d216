"""Whether a rolling shutter bent a board's pictures, and how far at the speed it usually had."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.boards import Board
from ..core.camera import Camera
from ..core.errors import InputError
from .board_video import TimedDetections, looks_px_s, steady_turns
from .lens import BoardView, board_pose, unusable
from .rolling_shutter import Readout, estimate_readout

Floats = NDArray[np.float64]
#: What a good corner is sure to, px: a bend of less does not matter.
MATTERS_PX = 0.1
#: Looks further apart than this say little of how fast the board went between them.
_LOOK_S = 0.3
_MOST_DEPTHS = 25


@dataclass(frozen=True)
class BoardSpeed:
    """How fast a board usually went before a camera, across its line of sight.

    Attributes
    ----------
    px_s, mm_s : float
        The median over the looks; NaN where no two looks in a row showed it.
    rows_share : float
        How much of the picture's height the board filled, median.
    """

    px_s: float
    mm_s: float
    rows_share: float


@dataclass(frozen=True)
class ShutterCheck:
    """What is known of a camera's shutter.

    Attributes
    ----------
    readout : Readout or None
    reason : str
        Why there is no readout; empty if there is one.
    speed : BoardSpeed
    bend_px, bend_mm : float
        How far the board went, at its usual speed, while the rows that it filled were read; NaN
        without a readout.
    """

    readout: Readout | None
    reason: str
    speed: BoardSpeed
    bend_px: float
    bend_mm: float

    @property
    def matters(self) -> bool:
        """Whether a rolling shutter is shown, and bends the board by more than corners are sure."""
        return bool(self.readout and self.readout.warnings and self.bend_px > MATTERS_PX)

    @property
    def warning(self) -> str:
        """What to do about it; empty if it does not matter."""
        if self.readout is None or not self.matters:
            return ""
        return (
            f"a rolling shutter: {1e3 * self.readout.readout_s:.1f} ± "
            f"{1e3 * self.readout.sd_s:.2g} ms from the first row to the last; at the board's "
            f"usual speed of {self.speed.mm_s:.0f} mm/s that bends its picture by "
            f"{self.bend_mm:.2f} mm ({self.bend_px:.1f} px), which no stated uncertainty contains: "
            "hold it still in each place, or film with a global shutter"
        )


def usual_speed(looks: TimedDetections, board: Board, camera: Camera) -> BoardSpeed:
    """How fast the board usually went, from looks at it and a camera's intrinsics."""
    px = looks_px_s(looks, board, within_s=_LOOK_S)
    views = [d.view for d in looks.detections if d.view is not None and not unusable(d.view)]
    if np.isnan(px).all() or not views:
        return BoardSpeed(float("nan"), float("nan"), float("nan"))
    px_s = float(np.nanmedian(px))
    height = max(looks.image_size[1] - 1, 1)
    share = float(np.median([np.ptp(v.pixels[:, 1]) / height for v in views]))
    few = views[:: max(1, len(views) // _MOST_DEPTHS)]
    depth_mm = float(np.median([_depth_mm(v, camera) for v in few]))
    return BoardSpeed(px_s, px_s * depth_mm / camera.focal_px, share)


def _depth_mm(view: BoardView, camera: Camera) -> float:
    R, t = board_pose(view, camera)
    return float((R @ view.points.mean(axis=0) + t)[2])


def busiest_stretches(
    looks: TimedDetections, board: Board, *, length_s: float, most: int
) -> list[tuple[float, float]]:
    """Stretches of a video in which a board that is seen all the time moves most.

    Parameters
    ----------
    looks : TimedDetections
        At some or all frames.
    board : Board
    length_s : float, s
    most : int

    Returns
    -------
    list of (start_s, end_s), in order, that do not overlap
    """
    speed = looks_px_s(looks, board, within_s=_LOOK_S)
    t = looks.time_s
    trials = []
    for i, start_s in enumerate(t):
        end = int(np.searchsorted(t, start_s + length_s - 1e-6))
        is_seen = all(d.view is not None for d in looks.detections[i:end])
        if is_seen and np.isfinite(speed[i:end]).any() and start_s + length_s <= t[-1] + 1e-6:
            trials.append((float(np.nanmean(speed[i:end])), float(start_s)))
    chosen: list[float] = []
    for _, start_s in sorted(trials, reverse=True):
        if len(chosen) < most and all(abs(start_s - other) >= length_s for other in chosen):
            chosen.append(start_s)
    return [(start_s, start_s + length_s) for start_s in sorted(chosen)]


def check_shutter(
    dense: TimedDetections, speed: BoardSpeed, board: Board, camera: Camera
) -> ShutterCheck:
    """How long a camera takes from row to row, from stretches of successive frames.

    Parameters
    ----------
    dense : TimedDetections
        Every frame of some stretches in which the board moved.
    speed : BoardSpeed
        How it usually moved.
    board : Board
    camera : Camera
        Its intrinsics.
    """
    steady = steady_turns(dense, board)
    rows = [
        (float(t), d.view)
        for t, d in zip(steady.time_s, steady.detections, strict=True)
        if d.view is not None and not unusable(d.view)
    ]
    try:
        readout = estimate_readout([t for t, _ in rows], [view for _, view in rows], camera)
    except InputError as error:
        return ShutterCheck(None, str(error), speed, float("nan"), float("nan"))
    took_s = abs(readout.readout_s) * speed.rows_share
    return ShutterCheck(readout, "", speed, took_s * speed.px_s, took_s * speed.mm_s)
