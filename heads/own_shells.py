"""Which shell of a mesh is skin, eye, lash, tooth, gum or tongue.

Told by the names that the file gives, and by size, place and symmetry where these say nothing or
something that cannot be. Places are compared with those of the template, which must already lie
near the head.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .face_model import face_model
from .head import Eye
from .own_mesh import shells
from .template import load_template, template_feature_points

Floats = NDArray[np.float64]
Triangles = NDArray[np.int32]

#: What names mean, the first that fits; words of English, German, French and Japanese rigs.
_WORDS = (
    ("lashes", r"lash|wimper|cils|tear|lacrimal|caruncle|occlusion|まつげ|睫"),
    ("other", r"brow|hair|beard|mustache|stubble|augenbraue|sourcil|glass|hat|cloth|shirt|眉|髪"),
    ("tongue", r"tongue|zunge|langue|舌"),
    ("teeth", r"teeth|tooth|gum|denture|z[aä]hn|dent|gencive|歯"),
    ("eye", r"eye(?!.?(brow|lid|lash|liner|socket))|iris|pupil|sclera|cornea|augapfel|oeil|目|瞳"),
    ("skin", r"skin|face|head|body|kopf|gesicht|haut|visage|t[eê]te|顔"),
)
#: Eyeballs of heads, mm.
_EYE_RADIUS_MM = (7.0, 19.0)
_EYE_NEAR_MM, _EYE_LARGEST_MM = 12.0, 38.0
_ROUND = (0.62, 1.6)  # width over height of an eye's layers; lashes and tear lines are wider
_LASH_NEAR_MM = 26.0
_MOUTH_LARGEST_MM = 100.0
#: Half the width that a tongue fills and an arch of teeth leaves free, of the whole; and how much.
_MIDDLE, _TONGUE_SHARE = 0.35, 0.12
_ARCH_TALL_MM = 24.0
#: What reaches further than this above and below the lips, and is wider than any tongue (46 mm
#: where arches are 61), is the lining of the whole mouth.
_LINING_MM, _LINING_WIDE_MM = 14.0, 52.0


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Where the parts of a head are to be expected, mm.

    Attributes
    ----------
    eyes : mapping from ``"right"``, ``"left"`` to (3,) float64
    mouth : (3,) float64
        Between the lips, in the middle.
    corners : (2, 3) float64
        Of the mouth, right and left.
    face : (n, 3) float64
        Places all over the face's skin.
    """

    eyes: Mapping[str, Floats]
    mouth: Floats
    corners: Floats
    face: Floats


@cache
def expected_on_template() -> Landmarks:
    """Where the template has its parts."""
    return expected_on(load_template().vertices)


def expected_on(vertices: Floats) -> Landmarks:
    """Where a head in the template's topology, (V, 3) mm, has its parts."""
    model = face_model()
    points = template_feature_points()
    at = dict(zip(points.names, points.at(vertices), strict=True))
    return Landmarks(
        {side: _middle(vertices, f"eye_{side}") for side in ("right", "left")},
        (at["2.2"] + at["2.3"]) / 2,
        np.stack([at["8.4"], at["8.3"]]),
        vertices[model.rows[model.weight >= 1.0]][::20],
    )


def _middle(vertices: Floats, part: str) -> Floats:
    p = vertices[load_template().vertices_of(part)]
    return np.asarray((p.min(axis=0) + p.max(axis=0)) / 2)


def meaning_of(label: str) -> str:
    """``"eye"``, ``"teeth"``, ``"tongue"``, ``"lashes"``, ``"skin"``, ``"other"``, or nothing."""
    for meaning, pattern in _WORDS:
        if re.search(pattern, label, re.IGNORECASE):
            return meaning
    return ""


def sort_shells(
    vertices: Floats,
    triangles: Triangles,
    labels: tuple[str, ...],
    label_of_triangle: NDArray[np.int32],
    expected: Landmarks,
) -> dict[str, NDArray[np.int32]]:
    """Triangle indices of the parts: those of `Head.mesh`, and ``other``.

    Parameters
    ----------
    vertices : (V, 3) float64, mm, head frame
    triangles : (F, 3) int32
    labels, label_of_triangle
        As of `OwnMesh`.
    expected : Landmarks

    Returns
    -------
    mapping from part to (n,) int32
        Always with ``skin``; the others where the mesh has them.
    """
    found: dict[str, list[NDArray[np.int32]]] = {}
    all_shells = shells(triangles, len(vertices))
    skin = _skin_shell(vertices, triangles, all_shells, expected.face)
    in_mouth: list[NDArray[np.int32]] = []
    for i, rows in enumerate(all_shells):
        if i == skin:
            found["skin"] = [rows]
            continue
        p = vertices[np.unique(triangles[rows])]
        word = meaning_of(_most_common(labels, label_of_triangle[rows]))
        part = _part_near_eyes(p, word, expected) or _part_in_mouth(p, word, expected)
        if part == "teeth":
            in_mouth.append(rows)
        else:
            found.setdefault(part or "other", []).append(rows)
    for rows, part in _upper_and_lower(vertices, triangles, in_mouth, float(expected.mouth[1])):
        found.setdefault(part, []).append(rows)
    return {part: np.sort(np.concatenate(rows)) for part, rows in found.items()}


def skin_triangles(vertices: Floats, triangles: Triangles, face: Floats) -> NDArray[np.int32]:
    """The triangles of the shell that places (n, 3) all over the face are nearest to."""
    all_shells = shells(triangles, len(vertices))
    return np.sort(all_shells[_skin_shell(vertices, triangles, all_shells, face)])


def _skin_shell(
    v: Floats, triangles: Triangles, all_shells: list[NDArray[np.int32]], face: Floats
) -> int:
    """The shell that most places of the face are nearest to; small ones do not count."""
    shell_of_vertex = np.full(len(v), -1)
    for i, rows in enumerate(all_shells):
        shell_of_vertex[triangles[rows].ravel()] = i
    known = np.flatnonzero(shell_of_vertex >= 0)
    _, nearest = cKDTree(v[known]).query(face)
    votes = np.bincount(shell_of_vertex[known[nearest]], minlength=len(all_shells))
    return int(np.argmax(votes))


def _most_common(labels: tuple[str, ...], numbers: NDArray[np.int32]) -> str:
    return labels[int(np.argmax(np.bincount(numbers)))] if labels else ""


def _part_near_eyes(p: Floats, word: str, expected: Landmarks) -> str:
    low, high = p.min(axis=0), p.max(axis=0)
    centre, size = (low + high) / 2, high - low
    for side, eye in expected.eyes.items():
        off = np.abs(centre - eye)
        near = off[0] < _EYE_NEAR_MM and off[1] < _EYE_NEAR_MM and off[2] < 1.6 * _EYE_NEAR_MM
        is_round = _ROUND[0] < size[0] / max(size[1], 1e-6) < _ROUND[1]
        if near and size.max() < _EYE_LARGEST_MM and word not in ("lashes", "other", "skin"):
            if is_round:
                return f"eye_{side}"
            return "lashes"
        if word == "lashes" and off.max() < _LASH_NEAR_MM:
            return "lashes"
    between = np.abs(centre - np.mean(list(expected.eyes.values()), axis=0))
    if word == "lashes" and (between < (_LASH_NEAR_MM, _LASH_NEAR_MM, 2 * _LASH_NEAR_MM)).all():
        return "lashes"  # both sides in one shell
    return ""


def _part_in_mouth(p: Floats, word: str, expected: Landmarks) -> str:
    centre = (p.min(axis=0) + p.max(axis=0)) / 2
    size = np.ptp(p, axis=0)
    half = abs(expected.corners[1, 0] - expected.corners[0, 0]) / 2
    off = centre - expected.mouth
    room = 1.5 if word in ("tongue", "teeth") else 1.0  # what has a name is believed sooner
    inside = (
        abs(off[0]) < 1.4 * half
        and abs(off[1]) < 1.4 * half
        and -3.5 * room * half < off[2] < 0.4 * half
        and size.max() < room * _MOUTH_LARGEST_MM
        and p[:, 2].max() < expected.mouth[2] + 6.0
    )
    if not inside or word in ("other", "lashes"):
        return ""
    above, below = p[:, 1].max() - expected.mouth[1], expected.mouth[1] - p[:, 1].min()
    if min(above, below) > _LINING_MM and size[0] > _LINING_WIDE_MM:
        return "teeth"  # gums, tongue and all: parted by height
    if word in ("tongue", "teeth"):
        return word
    return "tongue" if _fills_the_middle(p) else "teeth"


def _fills_the_middle(p: Floats) -> bool:
    """Whether the rear half of what is seen from above has vertices in the middle."""
    x, z = p[:, 0], p[:, 2]
    wide = np.ptp(x)
    rear = z < z.min() + 0.5 * np.ptp(z)
    if wide < 15.0 or not rear.any():  # a single tooth
        return False
    middle = np.abs(x[rear] - (x.min() + x.max()) / 2) < _MIDDLE * wide / 2
    return bool(middle.mean() > _TONGUE_SHARE)


def _upper_and_lower(
    v: Floats, triangles: Triangles, parts: list[NDArray[np.int32]], seam_y: float
) -> list[tuple[NDArray[np.int32], str]]:
    """Teeth (and gums) as upper and lower ones; a shell that holds both is parted."""
    found = []
    heights = {id(rows): v[np.unique(triangles[rows])][:, 1] for rows in parts}
    middles = [float(h.mean()) for h in heights.values()]
    if middles and (max(middles) < seam_y or min(middles) > seam_y):
        spread = max(middles) - min(middles)
        seam_y = (max(middles) + min(middles)) / 2 if spread > 5.0 else seam_y
    for rows in parts:
        h = heights[id(rows)]
        if np.ptp(h) > _ARCH_TALL_MM and h.min() < seam_y - 6 and h.max() > seam_y + 6:
            above = v[triangles[rows]][:, :, 1].mean(axis=1) > seam_y
            found += [(rows[above], "teeth_upper"), (rows[~above], "teeth_lower")]
        else:
            found.append((rows, "teeth_upper" if h.mean() > seam_y else "teeth_lower"))
    return [(rows, part) for rows, part in found if len(rows)]


def fitted_eye(vertices: Floats, triangles: Triangles, rows: NDArray[np.int32]) -> Eye | None:
    """The ball that an eye's shells lie on; None if they are no part of one.

    The largest shell tells: corneas and irises lie on it or bulge from it.
    """
    parts = shells(triangles[rows], len(vertices))
    largest = max(
        (rows[part] for part in parts),
        key=lambda part: float(np.ptp(vertices[triangles[part]].reshape(-1, 3), axis=0).prod()),
    )
    p = vertices[np.unique(triangles[largest])]
    keep = np.ones(len(p), dtype=bool)
    for _ in range(4):  # least squares of |p|² = 2 p·c + (r² − |c|²), without what sticks out
        A = np.column_stack([2 * p[keep], np.ones(keep.sum())])
        solution, *_ = np.linalg.lstsq(A, (p[keep] ** 2).sum(axis=1), rcond=None)
        centre = solution[:3]
        squared = float(solution[3] + centre @ centre)
        if squared <= 0:
            return None
        radius = float(np.sqrt(squared))
        off = np.abs(np.linalg.norm(p - centre, axis=1) - radius)
        keep = off <= max(2.5 * float(np.median(off)), 0.02)
    if not _EYE_RADIUS_MM[0] < radius < _EYE_RADIUS_MM[1]:
        return None
    return Eye(np.asarray(centre), radius)
