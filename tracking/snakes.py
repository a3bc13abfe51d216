"""Snakes: contours that settle on edges of a picture, held together by tension and rigidity.

The energy is that of the tutorial "Facial Modeling and Animation" (Eurographics 2002, Terzopoulos,
performance-driven animation)::

    E(c) = ∫ ρ [τ |c_s|² + (1 - τ) |c_ss|²] + P(c) ds        γ ċ + δE = 0

with c(s) the contour, P low on what it is to find. Time is discretised semi-implicitly, as Kass,
Witkin & Terzopoulos 1988 do: what holds the contour together is taken at the new time, P at the
old one, so that steps may be long.

Where the landmark network is there, its contours after flow and filter lie nearer to lips and lids
than snakes started from them (on plain renders 1.6 px against 1.9 px of a face of 256 px), so they
are not part of `track_landmarks`. They serve contours that were drawn by hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SnakeSettings:
    """How a snake behaves.

    Attributes
    ----------
    stiffness : float
        ρ, in units of the potential for each px² of bend or stretch.
    tension : float
        τ, 0 to 1: the share of tension; the rest is rigidity.
    friction : float
        γ over the time step: higher moves less at a time.
    n_steps : int
    most_px : float
        Nowhere does the contour go farther than this from where it began.
    """

    stiffness: float = 0.3
    tension: float = 0.2
    friction: float = 0.5
    n_steps: int = 40
    most_px: float = 6.0

    def __post_init__(self) -> None:
        if not 0 <= self.tension <= 1:
            raise ValueError(f"tension must lie between 0 and 1, got {self.tension}")
        if not (self.stiffness >= 0 and self.friction > 0 and self.most_px > 0):
            raise ValueError("stiffness must be 0 or more, friction and most_px above 0")


def relax_snake(
    contour: Floats,
    potential: NDArray[np.float32],
    *,
    is_closed: bool,
    settings: SnakeSettings | None = None,
    rest: Floats | None = None,
) -> Floats:
    """Let a contour settle.

    Parameters
    ----------
    contour : (n, 2) float64, px
        x, y; about evenly spaced, at least 5.
    potential : (h, w) float32
        Low where the contour belongs; its gradient pulls. Beyond the edge it is that of the edge.
    is_closed : bool
        Else both ends are free.
    settings : SnakeSettings, optional
    rest : (n, 2) float64, px, optional
        The shape that costs nothing. Without it, as in the tutorial, that is a point (under
        tension) or a straight line (under rigidity), and snakes cut corners; with it they keep the
        shape they are given. (Ours, not the tutorial's: c - rest takes the place of c.)

    Returns
    -------
    (n, 2) float64, px
    """
    how = SnakeSettings() if settings is None else settings
    start = np.array(contour, dtype=np.float64)
    if start.ndim != 2 or start.shape[1:] != (2,) or len(start) < 5:
        raise ValueError(f"contour must have shape (5 or more, 2), got {start.shape}")
    A = stiffness_matrix(len(start), is_closed=is_closed, settings=how)
    step = np.linalg.inv(A + how.friction * np.eye(len(start)))
    pull = np.stack([cv2.Sobel(potential, cv2.CV_32F, *d, scale=1 / 8) for d in ((1, 0), (0, 1))])
    held = np.zeros_like(start) if rest is None else A @ rest
    c = start.copy()
    for _ in range(how.n_steps):
        c = step @ (how.friction * c - _sampled(pull, c) + held)
        off = c - start
        far = np.linalg.norm(off, axis=1, keepdims=True)
        c = start + off * np.minimum(1.0, how.most_px / np.maximum(far, 1e-9))
    return c


def stiffness_matrix(n: int, *, is_closed: bool, settings: SnakeSettings) -> Floats:
    """(n, n): half of δE's first part is this times the contour; symmetric, no negative values."""
    first = np.roll(np.eye(n), 1, axis=1) - np.eye(n)
    second = np.roll(np.eye(n), 1, axis=1) + np.roll(np.eye(n), -1, axis=1) - 2 * np.eye(n)
    if not is_closed:
        first, second = first[:-1], second[1:-1]
    bend = settings.tension * first.T @ first + (1 - settings.tension) * second.T @ second
    return np.asarray(2 * settings.stiffness * bend)


def snake_energy(
    contour: Floats,
    potential: NDArray[np.float32],
    *,
    is_closed: bool,
    settings: SnakeSettings | None = None,
    rest: Floats | None = None,
) -> float:
    """E of a contour: what `relax_snake` makes small."""
    how = SnakeSettings() if settings is None else settings
    A = stiffness_matrix(len(contour), is_closed=is_closed, settings=how)
    d = contour if rest is None else contour - rest
    return float(0.5 * np.sum(d * (A @ d)) + _sampled(potential[None], contour).sum())


def lip_potential(rgb: NDArray[np.uint8], *, blur_px: float = 1.5) -> NDArray[np.float32]:
    """Low on the edges of lips, (h, w), 0 to -1: the slope of the pseudo-hue R / (R + G).

    Lips differ from the skin around them by their blood more than by their brightness, and
    pseudo-hue does not see shadows (Hurlbert & Poggio 1988).
    """
    red, green = rgb[..., 0].astype(np.float32), rgb[..., 1].astype(np.float32)
    return _edge_potential(red / (red + green + 8.0), blur_px)


def edge_potential(gray: NDArray[np.uint8], *, blur_px: float = 1.5) -> NDArray[np.float32]:
    """Low on edges of brightness, (h, w), 0 to -1: for lids and brows."""
    return _edge_potential(gray.astype(np.float32), blur_px)


def _edge_potential(values: NDArray[np.float32], blur_px: float) -> NDArray[np.float32]:
    soft = cv2.GaussianBlur(values, (0, 0), blur_px)
    slope = np.hypot(cv2.Sobel(soft, cv2.CV_32F, 1, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 1))
    strong = float(np.quantile(slope, 0.98))
    return np.asarray(-np.minimum(slope / max(strong, 1e-6), 1.0), dtype=np.float32)


def _sampled(maps: NDArray[np.float32], points: Floats) -> Floats:
    """Values (n, k) of maps (k, h, w) at points (n, 2) px."""
    x, y = (points[:, i].astype(np.float32) for i in (0, 1))
    values = [
        cv2.remap(m, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).ravel() for m in maps
    ]
    return np.stack(values, axis=1).astype(np.float64)
