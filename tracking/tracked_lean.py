"""What the tracker leaves of the landmark network's errors: samples of stills made as tracked ones.

The network's points lean: they follow the skin by less, or more, than it moves. Flow and patches
of a reference frame hold tracked points to the skin, so that of a change of the lean since the
neutral frames only a share stays, and drift is added. Both were measured, landmark by landmark, on
takes whose truth is known (``benchmarks/learn_landmark_noise.py lean``).
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.errors import FileFormatError
from ..core.files import atomic_write
from .landmark_noise import upright
from .landmark_regions import IS_EYE, IS_INNER_LIP, IS_QUICK
from .learn_landmark_noise import Samples, equations

Floats = NDArray[np.float64]
_COLUMNS = ("number", "share", "drift_mm")
#: Over how far neighbours are averaged, for single landmarks were measured on few people.
_SMOOTH_MM = 6.0
#: Drift is shared by neighbours, but for a part of its variance; less of it among neutral frames.
_DRIFT_MM, _OWN_DRIFT, _DRIFT_AT_REST = 12.0, 0.2, 0.3
_LEAST_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class TrackedLean:
    """Of each landmark in `numbers` (n,): the share of the lean that stays, and drift, mm."""

    numbers: NDArray[np.int64]
    share: Floats
    drift_mm: Floats

    def __post_init__(self) -> None:
        n = len(self.numbers)
        object.__setattr__(self, "numbers", readonly(self.numbers, (n,), "numbers", np.int64))
        for name in ("share", "drift_mm"):
            object.__setattr__(self, name, readonly(getattr(self, name), (n,), name))


def measure_lean(
    numbers: NDArray[np.int64], places: Floats, network: list[Floats], tracked: list[Floats]
) -> TrackedLean:
    """The lean that stays, from errors of some takes.

    Parameters
    ----------
    numbers : (n,) int
    places : (n, 3) float64, mm, head frame
        Of a usual face.
    network, tracked : lists of (T, n, 2) float64, mm
        Errors of each take's landmarks, less those of its neutral frames.
    """
    pairs = list(zip(network, tracked, strict=True))
    both, square, left = (
        np.mean([(one * two).mean(axis=(0, 2)) for one, two in products], axis=0)
        for products in (pairs, [(a, a) for a, _ in pairs], [(b, b) for _, b in pairs])
    )
    near = _neighbours(numbers, places)
    share = np.clip(near @ (both / square), _LEAST_SHARE, 1.0)
    drift2 = left - (both / square) ** 2 * square
    return TrackedLean(numbers, share, np.sqrt(near @ drift2))


def _neighbours(numbers: NDArray[np.int64], places: Floats) -> Floats:
    """Weights (n, n), rows adding to 1: near ones of the same kind on either side of the face."""
    kind = np.where(IS_EYE | IS_INNER_LIP, 2, np.where(IS_QUICK, 1, 0))[numbers]
    weight = np.zeros((len(numbers), len(numbers)))
    for other in (places, places * (-1, 1, 1)):
        apart = np.linalg.norm(places[:, None] - other[None], axis=2)
        weight += np.exp(-0.5 * (apart / _SMOOTH_MM) ** 2)
    weight *= kind[:, None] == kind[None]
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def as_tracked(samples: Samples, lean: TrackedLean, rng: np.random.Generator) -> Samples:
    """Samples of stills as if their landmarks had been tracked from the person's neutral ones."""
    s = samples
    _, error = equations(s.rotation, s.translation, s.xy, s.rest + s.moved)
    of_person = [
        error[s.is_neutral & (s.person == i)].mean(axis=0) for i in range(int(s.person.max()) + 1)
    ]
    at_rest = np.stack(of_person)[s.person]
    error = at_rest + lean.share[:, None] * (error - at_rest) + _drift(s, lean, rng)
    P = np.einsum("tij,tnj->tni", s.rotation, s.rest + s.moved) + s.translation[:, None]
    in_picture = np.einsum("tba,tnb->tna", upright(s.rotation), error)
    return replace(s, xy=(in_picture + P[..., :2]) / P[..., 2:])


def _drift(s: Samples, lean: TrackedLean, rng: np.random.Generator) -> Floats:
    """(N, n, 2) mm."""
    places = s.rest[0]
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    shared = (1 - _OWN_DRIFT) * np.exp(-0.5 * (apart / _DRIFT_MM) ** 2)
    root = np.linalg.cholesky(shared + _OWN_DRIFT * np.eye(len(places)))
    random = rng.normal(size=s.xy.shape)
    drift = np.einsum("ij,tja->tia", root, random, optimize=True) * lean.drift_mm[:, None]
    return np.asarray(np.where(s.is_neutral[:, None, None], _DRIFT_AT_REST * drift, drift))


def write_tracked_lean(path: Path, lean: TrackedLean) -> None:
    """Write a table as CSV."""
    with atomic_write(path) as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow(_COLUMNS)
        for number, share, drift in zip(lean.numbers, lean.share, lean.drift_mm, strict=True):
            rows.writerow([int(number), f"{share:.3f}", f"{drift:.3f}"])


def read_tracked_lean(path: Path) -> TrackedLean:
    """Read what `write_tracked_lean` wrote.

    Raises
    ------
    FileFormatError
        If it is no such table.
    """
    with open(path, encoding="utf-8", errors="replace", newline="") as stream:
        lines = list(csv.reader(stream))
    if not lines or tuple(lines[0]) != _COLUMNS:
        found = ",".join(lines[0]) if lines else "nothing"
        raise FileFormatError(path, "line 1", ",".join(_COLUMNS), found)
    rows = []
    for line, row in enumerate(lines[1:], start=2):
        try:
            number, share, drift = int(row[0]), float(row[1]), float(row[2])
        except (ValueError, IndexError):
            raise FileFormatError(path, f"line {line}", "three numbers", ",".join(row)) from None
        rows.append((number, share, drift))
    table = np.array(rows, np.float64).reshape(-1, 3)
    return TrackedLean(table[:, 0].astype(np.int64), table[:, 1], table[:, 2])
