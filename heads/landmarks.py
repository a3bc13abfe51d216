"""The 42 anthropometric landmarks of Farkas on the built-in heads.

Farkas, Anthropometry of the Head and Face, 2nd ed., Raven Press 1994, names them; those of the
sides end in ``_l`` (the subject's left) and ``_r``: 15 of the middle and 27 of the sides make 69
points.
"""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files

import numpy as np

from ..core.mesh import SurfacePoints


@cache
def template_landmarks() -> SurfacePoints:
    """The landmarks on the template, from `data/farkas_landmarks.csv`.

    The table gives triangles' corners and barycentric coordinates, and tells how each was found;
    ``python -m facewright.heads.place_landmarks`` makes it. ``p_l`` and ``p_r`` lie on the
    eyeballs, all others on the skin.
    """
    text = files(__package__).joinpath("data", "farkas_landmarks.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    corners = np.array([[int(r[f"corner{i}"]) for i in range(3)] for r in rows], dtype=np.int32)
    b = np.array([[float(r[f"weight{i}"]) for i in range(3)] for r in rows])
    return SurfacePoints(tuple(r["name"] for r in rows), corners, b / b.sum(axis=1, keepdims=True))


def side_names(landmark: str) -> tuple[str, ...]:
    """The names of a landmark's points: ``("en_r", "en_l")`` of en, ``("n",)`` of n.

    Raises
    ------
    ValueError
        If there is no such landmark.
    """
    names = template_landmarks().names
    if landmark in names:
        return (landmark,)
    if f"{landmark}_l" in names:
        return f"{landmark}_r", f"{landmark}_l"
    known = sorted({n.removesuffix("_l").removesuffix("_r") for n in names})
    raise ValueError(f"no landmark {landmark}; there are {', '.join(known)}")
