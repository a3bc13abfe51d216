"""What a search for a board in a picture brings home, whatever is printed on the board."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly

#: Squares, or distances of dots, below this many pixels are too small to be measured.
LEAST_STEP_PX = 6.0
#: Blur (standard deviation) above this share of a square lets opposite edges run into each other.
MOST_BLUR = 0.2


@dataclass(frozen=True, eq=False)
class Sighting:
    """A board's points in a picture.

    Attributes
    ----------
    points : (N, 3) float64, mm, board frame
    pixels : (N, 2) float64, px
    sd_px : (N,) float64, px
        Standard deviation of a coordinate, as the fit to the picture states it.
    blur_px : float, px
        Standard deviation of the blur of edges, in the direction where it is worse.
    step_px : float, px
        The smallest square, or distance of dots.
    notes : tuple of str
        What a user may want to know: corners that are covered, an order that was put right.
    """

    points: NDArray[np.float64]
    pixels: NDArray[np.float64]
    sd_px: NDArray[np.float64]
    blur_px: float
    step_px: float
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(np.asarray(self.points))
        object.__setattr__(self, "points", readonly(self.points, (n, 3), "points"))
        object.__setattr__(self, "pixels", readonly(self.pixels, (n, 2), "pixels"))
        object.__setattr__(self, "sd_px", readonly(self.sd_px, (n,), "sd_px"))


@dataclass(frozen=True)
class NotSeen:
    """Why there is no sighting, for a user to read."""

    reason: str
    blur_px: float = float("nan")


def unusable(step_px: float, blur_px: float, what: str = "squares") -> NotSeen | None:
    """Why points so close together, or so blurred, cannot be used; None if they can."""
    if step_px < LEAST_STEP_PX:
        return NotSeen(
            f"too small: {what} of {step_px:.1f} px, {LEAST_STEP_PX:.0f} px are needed; "
            "bring the board nearer",
            blur_px,
        )
    if blur_px > MOST_BLUR * step_px:
        return NotSeen(
            f"blurred: edges are spread by {blur_px:.1f} px (standard deviation) where {what} "
            f"are {step_px:.0f} px; hold the board still and in focus",
            blur_px,
        )
    return None
