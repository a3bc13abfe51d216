"""When a flash began, from how bright frames are: no surer than the frames allow.

The light is taken to rise at once and to die away exponentially. A frame sees its mean over the
frame's exposure, so a flash that begins while the shutter is closed is only bracketed by two
exposures; one that begins within an exposure is found from how much of it the frame caught.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.errors import InputError

Floats = NDArray[np.float64]
_RISE = 4.0  # a flash stands out by this many robust deviations of the steps between frames
_BEFORE, _AFTER = 8, 14  # frames that are looked at
_ROWS = 96
_STARTS, _DECAYS = 61, 31
_ROUNDS = 16
_UNLIKELY = 30.0  # of χ² above the best: not looked at any more
#: No real flash follows the model better than to this share of its strength.
_MODEL_SHARE = 2e-3


@dataclass(frozen=True, eq=False)
class Flash:
    """What the frames of one camera tell of one flash.

    Attributes
    ----------
    time_s, sd_s : float, s
        Mean and standard deviation of when it may have begun.
    earliest_s, latest_s : float, s
        Between them it began, as good as surely.
    start_s, decay_s : (S,), (D,) float64, s
        A grid of beginnings and of the time in which the light falls to 1/e.
    misfit : (S, D) float64
        χ² above the best, for each.
    strength : (S, D) float64
        The flash's light when it began, over the light before.
    strength_sd : (S, D) float64
    """

    time_s: float
    sd_s: float
    earliest_s: float
    latest_s: float
    start_s: Floats
    decay_s: Floats
    misfit: Floats
    strength: Floats
    strength_sd: Floats


def find_flash(
    time_s: ArrayLike,
    brightness: ArrayLike,
    exposure_s: float = 0.0,
    *,
    row_delay_s: ArrayLike | None = None,
) -> tuple[float, float]:
    """When the clearest flash began, and the standard deviation: see `find_flashes`."""
    found = find_flashes(time_s, brightness, exposure_s, row_delay_s=row_delay_s, most=1)[0]
    return found.time_s, found.sd_s


def find_flashes(
    time_s: ArrayLike,
    brightness: ArrayLike,
    exposure_s: float = 0.0,
    *,
    row_delay_s: ArrayLike | None = None,
    most: int = 20,
) -> tuple[Flash, ...]:
    """When flashes began, from the mean brightness of frames or of their rows.

    Beginning, decay and the strengths are fitted to the frames around each jump; the beginnings
    that fit within the noise give the answer: their mean, and their standard deviation.

    Parameters
    ----------
    time_s : (T,) float, s
        Of the middles of exposures.
    brightness : (T,) or (T, H) float
        Of frames, or of the H rows of each: linear in light.
    exposure_s : float, s
    row_delay_s : (H,) float, s, optional
        When each row is exposed, against its frame's time: a rolling shutter. Rows that are
        exposed at different times narrow down when the flash began.
    most : int
        How many flashes are looked for: those that rise most.

    Returns
    -------
    tuple of Flash, in the order of time

    Raises
    ------
    InputError
        If nothing stands out.
    """
    t, rows = np.asarray(time_s, dtype=float), np.asarray(brightness, dtype=float)
    delay = np.zeros(1) if row_delay_s is None else np.asarray(row_delay_s, dtype=float)
    if row_delay_s is None:
        rows = rows[:, None] if rows.ndim == 1 else rows.mean(axis=1, keepdims=True)
    if t.ndim != 1 or rows.shape != (len(t), len(delay)):
        raise ValueError(
            f"expected a brightness for each of {len(t)} frames and {len(delay)} rows, "
            f"got {rows.shape}"
        )
    if not (np.isfinite(t).all() and np.isfinite(rows).all() and np.isfinite(delay).all()):
        raise InputError("times and brightness must be finite numbers")
    if len(t) < 4:
        raise InputError(f"no flash can be told in {len(t)} frames: give at least 4")
    jumps = _jumps(rows.mean(axis=1), most)
    # single rows: the mean of several would smear what each saw at its own time
    taken = np.unique(np.linspace(0, len(delay) - 1, min(len(delay), _ROWS)).round().astype(int))
    return tuple(_fitted(t, rows[:, taken], delay[taken], exposure_s, first) for first in jumps)


def _jumps(y: Floats, most: int) -> list[int]:
    """The frames at which the largest rises end, none in the afterglow of a larger one."""
    jump = np.diff(y)
    spread = 1.4826 * float(np.median(np.abs(jump - np.median(jump)))) + 1e-9 * np.ptp(y)
    limit = max(_RISE * spread, 0.0)
    found: list[int] = []
    for i in np.argsort(-jump):
        if jump[i] <= limit or len(found) == most:
            break
        if all(not -3 <= i + 1 - other <= _AFTER for other in found):
            found.append(int(i) + 1)
    if not found:
        raise InputError("no flash: no frame is much brighter than the one before it")
    return sorted(found)


def _fitted(t: Floats, rows: Floats, delay: Floats, exposure: float, first: int) -> Flash:
    """One flash, whose largest rise ends at frame `first`."""
    low, high = max(0, first - _BEFORE), min(len(t), first + _AFTER)
    step = float(np.median(np.diff(t)))
    seen = rows[low:high]
    at = t[low:high, None] + delay
    # it may have begun in the frame before the largest rise, or late in that frame's last row
    reach = step + exposure / 2
    starts = t[first] + np.array([delay.min() - reach - step, delay.max() + reach])
    decays = np.log(np.array([0.05, 50.0]) * step)
    for _ in range(_ROUNDS):
        start = np.linspace(float(starts[0]), float(starts[1]), _STARTS)
        decay = np.exp(np.linspace(float(decays[0]), float(decays[1]), _DECAYS))
        misfit, gain, gain_var = _misfit(at, seen, start, decay, exposure)
        old = starts, decays
        starts = _narrowed(start, misfit.min(axis=1))
        decays = _narrowed(np.log(decay), misfit.min(axis=0))
        if np.ptp(starts) > 0.7 * np.ptp(old[0]) and np.ptp(decays) > 0.7 * np.ptp(old[1]):
            break
    weight = np.exp(-misfit / 2).sum(axis=1)
    weight /= weight.sum()
    mean = float(weight @ start)
    cell = start[1] - start[0]
    sd = float(np.sqrt(weight @ (start - mean) ** 2 + cell**2 / 12))
    held = start[misfit.min(axis=1) <= _UNLIKELY]
    return Flash(
        mean, sd, float(held[0] - cell), float(held[-1] + cell), start, decay, misfit, gain,
        np.sqrt(gain_var),
    )  # fmt: skip


def _narrowed(grid: Floats, misfit: Floats) -> Floats:
    """The ends of the likely part of an even grid, one step wider.

    Never less than its better third: a coarse grid may step over a narrow best.
    """
    limit = max(_UNLIKELY, float(np.sort(misfit)[len(grid) // 3]))
    held, step = grid[misfit <= limit], grid[1] - grid[0]
    return np.array([max(held[0] - step, grid[0]), min(held[-1] + step, grid[-1])])


def _misfit(
    at: Floats, seen: Floats, start: Floats, decay: Floats, exposure: float
) -> tuple[Floats, Floats, Floats]:
    """χ² above the best for all beginnings and decays, the strength, and its variance.

    The light before and the strength of each row are linear, and solved for on the way.
    """
    # noise grows with the light, at most in proportion: a bright frame counts for less
    level = np.maximum(seen, 0.05 * seen.max())
    w = (level.min(axis=0) / level) ** 2
    share = w / w.sum(axis=0)
    mean = (share * seen).sum(axis=0)
    centred = seen - mean
    total = (w * centred**2).sum(axis=0)
    shape = len(start), len(decay)
    cost, strength, strength_var = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for i, begin in enumerate(start):
        glow = _afterglow(at - begin, decay[:, None, None], exposure)  # (D, T, H)
        middle = (share * glow).sum(axis=1)
        size = (w * (glow - middle[:, None]) ** 2).sum(axis=1) + 1e-12
        gain = np.maximum((w * glow * centred).sum(axis=1) / size, 0.0)
        cost[i] = (total - gain**2 * size).sum(axis=1)
        base = np.maximum(mean - gain * middle, 1e-12)
        weight = base**2 * size  # of each row's strength: its variance is 1 / (base² size)
        strength[i] = (weight * gain / base).sum(axis=1) / weight.sum(axis=1)
        strength_var[i] = 1 / weight.sum(axis=1)
    best = float(cost.min())
    freedom = max(seen.size - 2 * seen.shape[1] - 2, 1)
    risen = float((np.sqrt(w) * np.abs(centred)).max())
    variance = max(best / freedom, (_MODEL_SHARE * risen) ** 2, 1e-300)
    return (cost - best) / variance, strength, strength_var * variance


def _afterglow(late: Floats, decay: Floats, exposure: float) -> Floats:
    """Mean of exp(−s/decay), s > 0, over exposures whose middles lie `late` after the start."""
    if exposure <= 1e-9:
        return np.where(late >= 0, np.exp(-np.maximum(late, 0.0) / decay), 0.0)
    opened = np.maximum(late - exposure / 2, 0.0)
    closed = np.maximum(late + exposure / 2, 0.0)
    light = decay * (np.exp(-opened / decay) - np.exp(-closed / decay))
    return np.asarray(light / exposure)
