"""Anthropometric measurements of a head, and what has been published of people's.

A measurement is a straight distance of two landmarks, their distance along one axis of the head
frame, or the length of a tape over the skin. Published means and standard deviations by sex and
age are in `data/measurement_norms.csv`; each row names its source.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from ..core.errors import InputError
from ..core.mesh import Mesh
from .landmarks import side_names

KINDS = ("euclid", "axis", "arc")
SEXES = ("male", "female")
_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class Measurement:
    """One measurement and how it is taken.

    Attributes
    ----------
    name : str
    kind : str
        One of `KINDS`.
    start, end : str
        Landmarks without sides. The same landmark twice: from the right to the left one. Where
        one or both have sides, the mean of both sides is taken.
    path : str
        Of ``axis``: x, y or z. Of ``arc``: the landmark that the tape runs over, or ``level``
        for a ring at the height of `start` and `end`.
    """

    name: str
    kind: str
    start: str
    end: str
    path: str

    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The pairs of named points whose distances are averaged."""
        starts, ends = side_names(self.start), side_names(self.end)
        if self.start == self.end:
            return ((starts[0], starts[-1]),)
        n = max(len(starts), len(ends))
        return tuple((starts[i % len(starts)], ends[i % len(ends)]) for i in range(n))


@dataclass(frozen=True)
class Norm:
    """Published mean and standard deviation, mm, and where they were published."""

    mean: float
    sd: float
    source: str


def _rows(name: str) -> list[dict[str, str]]:
    text = files(__package__).joinpath("data", name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


@cache
def measurement_table() -> Mapping[str, Measurement]:
    """All measurements by name."""
    return {
        r["name"]: Measurement(r["name"], r["kind"], r["start"], r["end"], r["path"])
        for r in _rows("measurements.csv")
    }


@cache
def _norm_table() -> Mapping[tuple[str, str], list[tuple[float, Norm]]]:
    found: dict[tuple[str, str], list[tuple[float, Norm]]] = {}
    for r in _rows("measurement_norms.csv"):
        norm = Norm(float(r["mean_mm"]), float(r["sd_mm"]), r["source"])
        found.setdefault((r["name"], r["sex"]), []).append((float(r["age_years"]), norm))
    return {key: sorted(rows, key=lambda row: row[0]) for key, rows in found.items()}


def published_norm(name: str, sex: str, age_years: float) -> Norm | None:
    """What has been published of a measurement, for a sex and age.

    Parameters
    ----------
    name : str
        A measurement.
    sex : str
        ``male`` or ``female``.
    age_years : float
        Between the ages of the table the values run straight; after the oldest they stay.

    Returns
    -------
    Norm or None
        None where nothing is known: no row, or an age more than a year below the youngest.

    Raises
    ------
    ValueError
        If there is no such measurement or sex.
    """
    if name not in measurement_table() or sex not in SEXES:
        raise ValueError(f"no measurement {name} of sex {sex}")
    rows = _norm_table().get((name, sex))
    if not rows or age_years < rows[0][0] - 1:
        return None
    ages = [age for age, _ in rows]
    mean = float(np.interp(age_years, ages, [norm.mean for _, norm in rows]))
    sd = float(np.interp(age_years, ages, [norm.sd for _, norm in rows]))
    nearest = min(rows, key=lambda row: abs(row[0] - age_years))
    return Norm(mean, sd, nearest[1].source)


def straight_distances(
    measurements: tuple[Measurement, ...], positions: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Measurements of kinds ``euclid`` and ``axis``, (N,) mm, of named landmark positions."""
    found = []
    for m in measurements:
        apart = [positions[b] - positions[a] for a, b in m.pairs()]
        if m.kind == "axis":
            found.append(np.mean([abs(d[_AXES[m.path]]) for d in apart]))
        elif m.kind == "euclid":
            found.append(np.mean([np.linalg.norm(d) for d in apart]))
        else:
            raise ValueError(f"{m.name} is an arc: it needs the skin")
    return np.array(found)


def measure(mesh: Mesh, names: tuple[str, ...] | None = None) -> dict[str, float]:
    """Measure a head's mesh.

    Parameters
    ----------
    mesh : Mesh
        With landmarks; arcs run over its group ``skin``.
    names : tuple of str, optional
        Which measurements; all of `measurement_table` unless given.

    Returns
    -------
    dict from name to mm

    Raises
    ------
    InputError
        If the mesh has no landmarks, or lacks one that is needed.
    """
    if mesh.landmarks is None:
        raise InputError("the mesh has no landmarks to measure between")
    at = dict(zip(mesh.landmarks.names, mesh.landmarks.at(mesh.vertices), strict=True))
    table = measurement_table()
    found = {}
    for name in table if names is None else names:
        m = table[name]
        needed = {p for pair in m.pairs() for p in pair}
        if m.kind == "arc" and m.path != "level":
            needed.update(side_names(m.path))
        missing = sorted(needed - set(at))
        if missing:
            raise InputError(f"{name} needs the landmarks {', '.join(missing)}, which are missing")
        if m.kind == "arc":
            found[name] = _tape(mesh, m, at)
        else:
            found[name] = float(straight_distances((m,), at)[0])
    return found


def _tape(mesh: Mesh, m: Measurement, at: Mapping[str, NDArray[np.float64]]) -> float:
    """Length of a tape in the plane of a measurement: it bridges hollows, as a real one does."""
    ((a, b),) = m.pairs()
    start, along = at[a], at[b] - at[a]
    length = float(np.linalg.norm(along))
    if m.path == "level":
        normal = np.cross(along, (1.0, 0.0, 0.0))
        return float(ConvexHull(_in_plane(section(mesh, start, normal), start, normal, along)).area)
    normal = np.cross(along, at[m.path] - start)
    p = _in_plane(section(mesh, start, normal), start, normal, along)
    # between the ends and on the landmark's side: without the ears and the back of the head
    p = p[(p[:, 0] >= 0) & (p[:, 0] <= length) & (p[:, 1] >= 0)]
    hull = ConvexHull(np.concatenate([p, [(0.0, 0.0), (length, 0.0)]]))
    return float(hull.area) - length  # in a plane the hull's "area" is the length around it


def _in_plane(
    p: NDArray[np.float64],
    origin: NDArray[np.float64],
    normal: NDArray[np.float64],
    along: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Coordinates (n, 2), mm, in a plane: along a direction, and across to its side."""
    u = along / np.linalg.norm(along)
    across = np.cross(normal / np.linalg.norm(normal), u)
    return np.stack([(p - origin) @ u, (p - origin) @ across], axis=1)


def section(
    mesh: Mesh, origin: NDArray[np.float64], normal: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points (n, 3), mm, where a plane cuts the edges of the skin."""
    skin = mesh.triangles[mesh.groups["skin"]]
    height = (mesh.vertices - origin) @ normal
    edges = np.concatenate([skin[:, (0, 1)], skin[:, (1, 2)], skin[:, (2, 0)]])
    h = height[edges]
    edges, h = edges[h[:, 0] * h[:, 1] < 0], h[h[:, 0] * h[:, 1] < 0]
    share = (h[:, 0] / (h[:, 0] - h[:, 1]))[:, None]
    return np.asarray((1 - share) * mesh.vertices[edges[:, 0]] + share * mesh.vertices[edges[:, 1]])
