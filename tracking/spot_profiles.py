"""How the light of a spot falls off: discs seen through a blur, from Gaussian to sharp.

A uniform disc of radius R seen through a Gaussian blur of standard deviation τ has the variance
``v = R²/4 + τ²`` along each axis. With lengths measured in √v only one number is left, the disc's
share ``(R²/4) / v`` of the variance: 0 is a Gaussian, 1 a disc with a hard edge. Its *sharpness*
u, ``1 - (1 - u)² = share``, changes the profile evenly. A slanted disc, a smear of motion or an
ellipse is the same profile after a linear map of the plane.

The value at distance ρ from the middle is the chance that a normal deviate around it falls into
the disc: ``P(R²/τ²)`` of the noncentral chi-square distribution with 2 degrees of freedom and
noncentrality ρ²/τ².
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

#: Rows of the table: sharpness k / SHARPNESS_STEPS.
SHARPNESS_STEPS, N_SHARPNESS = 48, 46
#: Columns: squared distance, in variances, k / Q_STEPS; nothing of a spot lies beyond Q_MAX.
Q_STEPS, Q_MAX = 16, 20
#: What is tabulated: the value (1 in the middle of a Gaussian and of a wide disc alike), its slope
#: by q, and by sharpness.
VALUE, SLOPE, BY_SHARPNESS = 0, 1, 2


@lru_cache(maxsize=1)
def profile_table() -> NDArray[np.float32]:
    """Profiles, ``(N_SHARPNESS, 3, Q_MAX · Q_STEPS + 2) float32``; read-only.

    Each is 1 in its middle. The middle axis is value, slope by q and slope by sharpness.
    """
    q = np.arange(Q_MAX * Q_STEPS + 2) / Q_STEPS
    step = 1e-3
    table = np.empty((N_SHARPNESS, 3, len(q)), np.float32)
    for row in range(N_SHARPNESS):
        s = row / SHARPNESS_STEPS
        table[row, VALUE] = profile(q, s)
        low, high = np.maximum(q - step, 0), q + step
        table[row, SLOPE] = (profile(high, s) - profile(low, s)) / (high - low)
        less, more = max(s - 0.02, 0.0), min(s + 0.02, 0.95)
        table[row, BY_SHARPNESS] = (profile(q, more) - profile(q, less)) / (more - less)
    table[:, :, -2:] = 0  # where what lies beyond the table is looked up
    table.flags.writeable = False
    return table


def profile(q: NDArray[np.float64], sharpness: float) -> NDArray[np.float64]:
    """Light at squared distance `q` (in variances) from the middle, over that in the middle."""
    from scipy.special import chndtr

    blur2 = (1 - sharpness) ** 2
    rim2 = 4 * (1 - blur2)
    if rim2 < 0.01 * blur2:  # the disc is so small against the blur that only the blur is seen
        return np.asarray(np.exp(-q / 2))
    inside = chndtr(rim2 / blur2, 2.0, np.append(q, 0.0) / blur2)
    return np.asarray(inside[:-1] / inside[-1])
