"""Named regions of the skin of the built-in heads.

Every triangle of the skin is in exactly one region of `REGIONS`; `RED_LIPS` are parts of the lips'
regions. Regions are drawn on the template and hold for every head that shares its triangles.
Heights, depths and outlines below are millimetres on the template, x as its distance from the
mid-line: a smooth face has no edges there, and these lines are the project's choice.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from .landmarks import template_landmarks
from .template import Template, load_template, template_feature_points

_BOTH = ("brow", "lids", "orbit", "socket", "temple", "cheek", "jaw", "ear")
_MIDDLE = (
    "forehead", "scalp", "nose", "upper_lip", "lower_lip", "chin", "neck", "inner_mouth",
)  # fmt: skip
#: Regions that part the skin. ``orbit``: around the lids to the rim of the bone. ``socket``:
#: behind the lids, out of sight. ``upper_lip`` and ``lower_lip``: red lip and the skin up to the
#: nose and down to the fold above the chin.
REGIONS = (*_MIDDLE, *(f"{name}_{side}" for name in _BOTH for side in "lr"))
RED_LIPS = ("upper_lip_red", "lower_lip_red")

_HALF_BROW_MM = 6.0
_NOSE = ((-1, 8), (7, 6), (9, -4), (12, -22), (19, -33), (20, -45), (10, -50.5), (-1, -51.5))
_ORBIT_CENTRE, _ORBIT_RADII = (31.0, 0.0), (20.0, 15.0)
#: From the nose's wing round the corner of the mouth to the fold above the chin.
_MOUTH = ((-1, -49), (20, -45), (30, -58), (33, -68), (28, -79), (18, -84), (-1, -86))
_CHIN_HALF_MM = 24.0
#: Depth → height of the hair line, the jaw's lower border, and the border of cheek and jaw.
_HAIR_LINE = ((-165, -45), (-110, -45), (-92, -30), (-62, 4), (-45, 14), (-28, 32), (-12, 50),
              (0, 62), (16, 70), (40, 72))  # fmt: skip
_JAW_BORDER = ((-165, -30), (-75, -44), (-60, -52), (-50, -70), (-38, -86), (18, -109), (30, -112))
_CHEEK_BORDER = ((-60, -50), (-30, -60), (10, -74), (30, -76))
_BEHIND_EAR_MM = -76.0
_TEMPLE_OUT_MM, _TEMPLE_LOW_MM, _FOREHEAD_LOW_MM = 53.0, -10.0, 9.0


@cache
def template_regions() -> Mapping[str, NDArray[np.int32]]:
    """Triangle indices of each region of `REGIONS` and `RED_LIPS` on the template."""
    template = load_template()
    skin = template.groups()["skin"]
    name = _region_of_triangles(template, skin)
    found = {region: skin[name == region] for region in REGIONS}
    red = _mask(template, skin, "lips") > 0.5
    for region, whole in zip(RED_LIPS, ("upper_lip", "lower_lip"), strict=True):
        found[region] = skin[red & (name == whole)]
    for rows in found.values():
        rows.flags.writeable = False
    return MappingProxyType(found)


def _mask(template: Template, rows: NDArray[np.int32], name: str) -> NDArray[np.float64]:
    return np.asarray(template.masks[name][template.uv_triangles[rows]].mean(axis=1))


def _region_of_triangles(template: Template, rows: NDArray[np.int32]) -> NDArray[np.str_]:
    """The region of each triangle; later rules give way to earlier ones."""
    p = template.vertices[template.triangles[rows]].mean(axis=1)
    out, y, z = np.abs(p[:, 0]), p[:, 1], p[:, 2]
    side = np.where(p[:, 0] > 0, "_l", "_r")
    uv = template.uv[template.uv_triangles[rows]].mean(axis=1)
    front = z > -30.0
    flat = np.stack([out, y], axis=1)
    hair, jaw, cheek = (
        np.interp(z, *np.transpose(line)) for line in (_HAIR_LINE, _JAW_BORDER, _CHEEK_BORDER)
    )
    seam = template_feature_points().select(("2.2", "2.3")).at(template.vertices)[:, 1].mean()
    fold = template_landmarks().select(("sl",)).at(template.vertices)[0, 1]
    mouth = (front & _within(flat, _MOUTH)) | (_mask(template, rows, "lips") > 0.5)
    orbit = np.hypot(*((flat - _ORBIT_CENTRE) / _ORBIT_RADII).T) < 1
    rules = (
        ("socket", (uv[:, 0] < 0.2) & (uv[:, 1] < 0.7)),  # MakeHuman's own islands
        ("inner_mouth", (uv[:, 1] < 0.16) & (uv[:, 0] > 0.7)),
        ("ear", _mask(template, rows, "ears") > 0.25),
        ("lids", _mask(template, rows, "eyelids") > 0.5),
        ("brow", front & (_brow_distance(template, p) < _HALF_BROW_MM)),
        ("nose", (z > 15.0) & _within(flat, _NOSE)),
        ("upper_lip", mouth & (y > seam)),
        ("lower_lip", mouth),
        ("scalp", y > hair),
        ("orbit", front & orbit),
        ("neck", (y < jaw) | (z < _BEHIND_EAR_MM)),
        ("temple", (y > _TEMPLE_LOW_MM) & (out > _TEMPLE_OUT_MM)),
        ("forehead", y > _FOREHEAD_LOW_MM),
        ("chin", (y < fold) & (out < _CHIN_HALF_MM)),
        ("jaw", y < cheek),
        ("cheek", np.ones(len(p), bool)),
    )
    word = np.select([where for _, where in rules], [name for name, _ in rules], "")
    return np.where(np.isin(word, _BOTH), np.char.add(word, side), word)


def _within(p: NDArray[np.float64], outline: tuple[tuple[float, float], ...]) -> NDArray[np.bool_]:
    """Whether points (n, 2) lie within a closed outline: an odd number of edges to their right."""
    a = np.array(outline)
    b = np.roll(a, -1, axis=0)
    x, y = p[:, :1], p[:, 1:]
    spans = (a[:, 1] > y) != (b[:, 1] > y)
    rise = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
    right_of = a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0]) > x
    return np.asarray((spans & right_of).sum(axis=1) % 2 == 1)


def _brow_distance(template: Template, p: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance, mm, of points from the line through the brow's feature points, seen in front."""
    line = template_feature_points().select(("4.1", "4.3", "4.5")).at(template.vertices)[:, :2]
    dense = np.stack([np.interp(np.linspace(0, 2, 41), (0, 1, 2), line[:, i]) for i in (0, 1)], 1)
    flat = np.stack([np.abs(p[:, 0]), p[:, 1]], axis=1)
    return np.asarray(np.linalg.norm(flat[:, None] - dense, axis=2).min(axis=1))
