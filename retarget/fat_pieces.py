"""A curve through space as few straight pieces within an error bound."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..core.fat import FapTable
from .limits import FapRange

Floats = NDArray[np.float64]

_SAMPLES = 24  # on either side of 0, at first
_ROUNDS = 5  # of halving where the curve bends
#: Of the bound, that pieces may use at samples: the rest is for what lies between them.
_USED = 0.85
#: Vertices that move less than this part of the bound are left out.
_LEFT_OUT = 0.1


def few_pieces(
    fap: str, curve: Callable[[Floats], Floats], within: FapRange, max_error_mm: float
) -> FapTable | None:
    """The table of one FAP.

    Parameters
    ----------
    fap : str
    curve : callable
        Values (T,) of the FAP → displacements (T, V, 3) float64, mm.
    within : FapRange
    max_error_mm : float

    Returns
    -------
    FapTable or None
        None if nothing moves by more than what is left out.
    """
    ends = [np.linspace(0.0, end, _SAMPLES + 1)[1:] for end in (within.low, within.high) if end]
    values = np.sort(np.concatenate([np.zeros(1), *ends]))
    moved = curve(values)
    vertices = np.flatnonzero(np.linalg.norm(moved, axis=2).max(axis=0) > _LEFT_OUT * max_error_mm)
    if not len(vertices):
        return None
    values, moved = _refined(curve, vertices, values, moved[:, vertices], max_error_mm)
    zero = int(np.flatnonzero(values == 0.0)[0])
    assert np.abs(moved[zero]).max() < 1e-6, "rest is rest"
    moved[zero] = 0.0  # to the last bit
    above = _knots(values[zero:], moved[zero:], max_error_mm)
    below = _knots(values[zero::-1], moved[zero::-1], max_error_mm)
    rows = sorted({*(zero + k for k in above), *(zero - k for k in below)})
    return FapTable(fap, values[rows], vertices.astype(np.int32), moved[rows].astype(np.float32))


def _refined(
    curve: Callable[[Floats], Floats],
    vertices: NDArray[np.int64],
    values: Floats,
    moved: Floats,
    max_error_mm: float,
) -> tuple[Floats, Floats]:
    """More samples where straight lines between samples could miss the curve."""
    for _ in range(_ROUNDS):
        bend = np.zeros(len(values))
        bend[1:-1] = [
            np.linalg.norm(moved[i] - _between(values[i - 1 : i + 2], moved[i - 1], moved[i + 1]),
                           axis=1).max()
            for i in range(1, len(values) - 1)
        ]  # fmt: skip
        beside = np.maximum(bend[:-1], bend[1:]) > (1 - _USED) * max_error_mm
        middles = (values[:-1] + values[1:])[beside] / 2
        if not len(middles):
            break
        values = np.concatenate([values, middles])
        moved = np.concatenate([moved, curve(middles)[:, vertices]])
        order = np.argsort(values)
        values, moved = values[order], moved[order]
    return values, moved


def _between(values: Floats, before: Floats, after: Floats) -> Floats:
    """The middle of three values on the line from the first to the last."""
    s = (values[1] - values[0]) / (values[2] - values[0])
    return np.asarray((1 - s) * before + s * after)


def _knots(values: Floats, moved: Floats, max_error_mm: float) -> list[int]:
    """Rows of the knots, the first and the last among them: each piece as long as it may be."""
    rows, last = [0], len(values) - 1
    while rows[-1] < last:
        start = rows[-1]
        good, bad = start + 1, last + 1  # one step is always good; the search doubles, then halves
        while good + 1 < bad:
            end = min(2 * good - start, last) if bad > last else (good + bad) // 2
            if end == good:
                break
            if _off(values, moved, start, end) <= _USED * max_error_mm:
                good = end
            else:
                bad = end
        rows.append(good)
    return rows


def _off(values: Floats, moved: Floats, start: int, end: int) -> float:
    """How far samples are from the line between two of them, mm."""
    s = (values[start + 1 : end] - values[start]) / (values[end] - values[start])
    line = moved[start] + s[:, None, None] * (moved[end] - moved[start])
    return float(np.linalg.norm(moved[start + 1 : end] - line, axis=2).max())
