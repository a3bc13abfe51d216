"""Finds the landmark network's 478 points on the template; writes `data/face_landmarks.csv`.

Run by the project when the template or the network changes: ``python -m
facewright.heads.place_face_landmarks``. Several people are drawn and looked at as any mesh is
(`own_views`), so that what the network does to all faces alike is in the table too and cancels
out when another mesh is aligned by it. A point's place is the mean over the people, on the
template. Those that lie on the outline, or where few of the people show them, are left out.
"""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.mesh import SurfacePoints
from .face_finder import FaceFinder
from .face_landmarks import N_LANDMARKS
from .identity import make_head, random_identity
from .own_views import find_face_on_mesh
from .raycast import RayScene
from .template import load_template

_SEEDS = range(900, 908)
_FEWEST_PEOPLE = 6
_LARGEST_SPREAD_MM = 4.0
_TABLE = "face_landmarks.csv"


@cache
def template_face_landmarks() -> SurfacePoints:
    """The network's landmarks on the template; names are their numbers, ``"0"`` to ``"477"``."""
    text = files(__package__).joinpath("data", _TABLE).read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    corners = np.array([[int(r[f"corner{i}"]) for i in range(3)] for r in rows], dtype=np.int32)
    b = np.array([[float(r[f"weight{i}"]) for i in range(3)] for r in rows])
    return SurfacePoints(tuple(r["number"] for r in rows), corners, b / b.sum(axis=1)[:, None])


def place(seeds: range = _SEEDS) -> NDArray[np.float64]:
    """The points on the template, (478, 3) mm; NaN for those that are left out."""
    template, finder = load_template(), FaceFinder()
    found = np.full((len(seeds), N_LANDMARKS, 3), np.nan)
    for i, seed in enumerate(seeds):
        person = random_identity(np.random.default_rng(seed), f"person {seed}")
        head = make_head(person, texture_px=256)
        face = find_face_on_mesh(head.mesh.vertices, head.mesh.triangles, finder)
        known = np.isfinite(face.points).all(axis=1)
        scene = RayScene(head.mesh.vertices, head.mesh.triangles)
        _, triangle, b = scene.closest(face.points[known])
        corners = template.vertices[head.mesh.triangles[triangle]]
        found[i, known] = np.einsum("nc,ncx->nx", b, corners)
    n_seen = np.isfinite(found[..., 0]).sum(axis=0)
    kept = n_seen >= min(_FEWEST_PEOPLE, len(seeds))
    mean = np.full((N_LANDMARKS, 3), np.nan)
    mean[kept] = np.nanmean(found[:, kept], axis=0)
    spread = np.full(N_LANDMARKS, np.inf)
    off = np.linalg.norm(found[:, kept] - mean[kept], axis=2)
    spread[kept] = np.sqrt(np.nanmean(off**2, axis=0))
    mean[spread > _LARGEST_SPREAD_MM] = np.nan
    return mean


def write(path: Path, points: NDArray[np.float64]) -> None:
    """Write the table: the nearest triangle to each place."""
    template = load_template()
    groups = template.groups()
    on = np.concatenate([groups[n] for n in ("skin", "eye_right", "eye_left")])
    triangles = template.triangles[on]
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        header = [*(f"corner{i}" for i in range(3)), *(f"weight{i}" for i in range(3))]
        writer.writerow(["number", *header])
        numbers = np.flatnonzero(np.isfinite(points).all(axis=1))
        _, triangle, b = RayScene(template.vertices, triangles).closest(points[numbers])
        for number, row, weights in zip(numbers, triangle, np.clip(b, 0, 1), strict=True):
            writer.writerow([number, *triangles[row], *(f"{x:.5f}" for x in weights)])


if __name__ == "__main__":
    write(Path(__file__).parent / "data" / _TABLE, place())
