"""Least squares for curves that have bounds and are smooth in time.

Minimises over x (T, K), with 0 ≤ x ≤ u,

    Σ_t [ ½ xₜᵀ G xₜ − pₜᵀ xₜ ] + ½ s Σ_t ‖D₂ x‖²ₜ

where D₂ is the second difference. All frames are solved together, so that smoothness has no lag.
The method is a primal-dual active set (Hintermüller, Ito & Kunisch 2002, The primal-dual active set
strategy as a semismooth Newton method): which values stand at a bound is guessed, the others solve
one banded system, and the guess is mended by the signs of values and multipliers, until it holds.
Then the minimum is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from ..core.arrays import readonly

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Frames solved at once, and those shared with the windows on both sides. What lies further away
#: than the overlap has no measurable influence; see the test.
WINDOW, OVERLAP = 480, 40
_MOST_ROUNDS = 200
_PATIENCE = 3  # rounds without progress
_WRONG = 1e-9  # of the scale: signs below this are rounding error
_UNEASY = 10.0  # times that: derivatives of free values that are not 0
_BARELY = 1e4  # the same where no step leads further down
_LEAST_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class PathSolution:
    """What was found.

    Attributes
    ----------
    values : (T, K) float64
        Exactly 0 or the upper bound where a bound holds.
    n_rounds : int
        The most rounds that a window took.
    converged : bool
        False: some values are not at the minimum, but all are within their bounds.
    """

    values: Floats
    n_rounds: int
    converged: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", readonly(self.values, (None, None), "values"))


def second_differences(time_s: Floats) -> Floats:
    """Rows of D₂ for frames at any times, (T − 2, 3): (1, −2, 1) where they are uniform."""
    h = np.diff(time_s)
    if len(h) < 2:
        return np.zeros((0, 3))
    before, after = h[:-1], h[1:]
    scale = np.median(h) ** 2 * 2 / (before + after)
    return np.stack([scale / before, -scale * (1 / before + 1 / after), scale / after], axis=1)


def solve_paths(
    gram: Floats, pull: Floats, upper: Floats, differences: Floats, smooth: float
) -> PathSolution:
    """Minimise the sum above.

    Parameters
    ----------
    gram : (K, K) float64
        G, positive definite.
    pull : (T, K) float64
        p.
    upper : (T, K) float64
        u ≥ 0; values with bound 0 stay 0.
    differences : (T − 2, 3) float64
        D₂, as `second_differences` makes it.
    smooth : float
        s ≥ 0.

    Raises
    ------
    ValueError
        If shapes do not fit, something is not finite, or a bound is negative.
    """
    _check(gram, pull, upper, differences, smooth)
    n_frames = len(pull)
    found = np.zeros_like(pull)
    n_rounds, converged = 0, True
    for start in range(0, n_frames, WINDOW):
        a, b = max(start - OVERLAP, 0), min(start + WINDOW + OVERLAP, n_frames)
        rows = differences[a : max(b - 2, a)]
        values, rounds, done = _solve_window(
            gram, pull[a:b], upper[a:b], _penalty_bands(rows, b - a, smooth)
        )
        end = min(start + WINDOW, n_frames)
        found[start:end] = values[start - a : end - a]
        n_rounds, converged = max(n_rounds, rounds), converged and done
    return PathSolution(found, n_rounds, converged)


def _check(gram: Floats, pull: Floats, upper: Floats, differences: Floats, smooth: float) -> None:
    n_frames, n = pull.shape
    wanted = {"gram": (gram, (n, n)), "upper": (upper, (n_frames, n))}
    wanted["differences"] = (differences, (max(n_frames - 2, 0), 3))
    for name, (value, shape) in wanted.items():
        if value.shape != shape:
            raise ValueError(f"{name} must have shape {shape}, got {value.shape}")
    if not all(np.isfinite(value).all() for value in (gram, pull, upper, differences)):
        raise ValueError("gram, pull, upper and differences must be finite")
    if (upper.size and upper.min() < 0) or smooth < 0:
        raise ValueError("upper bounds and smooth must not be negative")


def _penalty_bands(rows: Floats, n_frames: int, smooth: float) -> Floats:
    """s D₂ᵀ D₂ as (3, T): diagonal, first and second off-diagonal (entry t: with t + 1, t + 2)."""
    bands = np.zeros((3, n_frames))
    n = len(rows)
    for i in range(3):
        for j in range(i, 3):
            bands[j - i, i : i + n] += smooth * rows[:, i] * rows[:, j]
    return bands


def _solve_window(
    gram: Floats, pull: Floats, upper: Floats, bands: Floats
) -> tuple[Floats, int, bool]:
    first = np.linalg.solve(gram, pull.T).T  # without bounds and smoothness
    # -1 at 0, 1 at the upper bound, 0 free
    state = np.where((upper > 0) & (first > 0), 0, -1).astype(np.int8)
    tiny = _WRONG * max(float(np.abs(pull).max(initial=0.0)), 1e-300)
    fewest, left = np.inf, _PATIENCE
    x = np.zeros_like(pull)
    for n_rounds in range(1, _MOST_ROUNDS + 1):
        x = _with_free_solved(gram, pull, upper, bands, state)
        slope = _slopes(gram, pull, bands, x)
        below, above = (state == 0) & (x < -_WRONG), (state == 0) & (x > upper + _WRONG)
        pressed = (upper > 0) & (state * slope > tiny)
        n_wrong = int(below.sum() + above.sum() + pressed.sum())
        if not n_wrong:
            return np.clip(x, 0.0, upper), n_rounds, True
        left = _PATIENCE if n_wrong < fewest else left - 1
        fewest = min(fewest, n_wrong)
        if left < 0:
            break
        state[pressed] = 0
        state[below], state[above] = -1, 1
    return _descended(gram, pull, upper, bands, np.clip(x, 0.0, upper), n_rounds)


def _descended(
    gram: Floats, pull: Floats, upper: Floats, bands: Floats, x: Floats, n_rounds: int
) -> tuple[Floats, int, bool]:
    """The minimum from a start within the bounds, by steps that never climb.

    Guesses that go round in circles end here: a projected Newton method (Bertsekas 1982, Projected
    Newton methods for optimization problems with simple constraints).
    """
    tiny = _WRONG * max(float(np.abs(pull).max(initial=0.0)), 1e-300)
    slope = _slopes(gram, pull, bands, x)
    for _ in range(n_rounds, _MOST_ROUNDS):
        n_rounds += 1
        low, high = (x <= 0) & (slope >= 0), (x >= upper) & (slope <= 0)
        state = np.where(low, -1, np.where(high & (upper > 0), 1, 0)).astype(np.int8)
        if np.abs(slope[state == 0]).max(initial=0.0) <= _UNEASY * tiny:
            return x, n_rounds, True
        aim = _with_free_solved(gram, pull, upper, bands, state)
        before, share = float((x * (slope - pull)).sum()), 1.0
        while True:
            there = np.clip(x + share * (aim - x), 0.0, upper)
            its_slope = _slopes(gram, pull, bands, there)
            if float((there * (its_slope - pull)).sum()) < before:
                break
            share /= 2
            if share < _LEAST_STEP:  # rounding error is all that is left
                return x, n_rounds, bool(np.abs(slope[state == 0]).max() <= _BARELY * tiny)
        x, slope = there, its_slope
    return x, n_rounds, False


def _slopes(gram: Floats, pull: Floats, bands: Floats, x: Floats) -> Floats:
    """Derivatives of the sum, (T, K)."""
    found = x @ gram - pull + bands[0][:, None] * x
    for k in (1, 2):
        if len(x) > k:
            between = bands[k][:-k, None]
            found[:-k] += between * x[k:]
            found[k:] += between * x[:-k]
    return np.asarray(found)


def _with_free_solved(
    gram: Floats, pull: Floats, upper: Floats, bands: Floats, state: NDArray[np.int8]
) -> Floats:
    """x with bound values at their bounds, and the free ones where the derivatives are 0."""
    x = np.where(state > 0, upper, 0.0)
    free = state == 0
    if not free.any():
        return x
    right = -_slopes(gram, pull, bands, x)[free]
    counts = free.sum(axis=1)
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    frame, column = np.nonzero(free)
    last = first[np.minimum(np.arange(len(x)) + 3, len(x))]
    width = int((last - first[:-1]).max()) if bands[1:].any() else int(counts.max())
    matrix = np.zeros((width, len(right)))
    _fill(matrix, gram, bands, first, frame.astype(np.int64), column.astype(np.int64))
    x[free] = solveh_banded(matrix, right, lower=True, overwrite_ab=True, check_finite=False)
    return x


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _fill(
    matrix: Floats, gram: Floats, bands: Floats, first: Ints, frame: Ints, column: Ints
) -> None:
    """The free rows and columns of the Hessian in LAPACK's lower banded form."""
    for j in range(len(frame)):
        t = frame[j]
        for i in range(j, first[t + 1]):
            matrix[i - j, j] = gram[column[i], column[j]]
        matrix[0, j] += bands[0, t]
        for ahead in range(1, 3):
            if t + ahead >= bands.shape[1] or bands[ahead, t] == 0.0:
                continue
            for i in range(first[t + ahead], first[t + ahead + 1]):
                if column[i] == column[j]:
                    matrix[i - j, j] = bands[ahead, t]
                    break
