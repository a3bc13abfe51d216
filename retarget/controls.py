"""The control points of a head: which feature points steer its skin, on which axes, and how.

The MPEG-4 points alone do not suffice for a good picture. Where they leave wide gaps, auxiliary
points are placed here by geometry: along the edges of the lids (so that the lids meet along their
whole length), in the mouth's cavity (so that it opens with the jaw), and in a ring on scalp, neck
and ears that stays where it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.mesh import SurfacePoints, vertex_normals
from ..heads.head import Head
from ..heads.raycast import NO_HIT, RayScene
from .deformer import Constraint
from .lid_points import LidPoint, place_lid_points
from .surface_weights import surface_distances

#: Feature points of the skin by axis (x, y, z). F: moved by its FAP. J: carried by the jaw bone
#: (F on the chin: by its FAP where given, else by the bone). L: on the lid's sphere. S: still.
#: C: completed from its neighbours, as `COMPLETIONS` says. -: an ordinary vertex on that axis.
#: Points that are not named are ordinary throughout.
SKIN_CONTROLS = {
    "2.1": "FFF",  # FAPs 15, 3, 14
    "2.2": "-FF",  # 4, 17
    "2.3": "-FF",  # 5, 16
    "2.4": "FFC",  # 6, 12
    "2.5": "FFC",
    "2.6": "CFC",  # 8
    "2.7": "CFC",
    "2.8": "CFC",  # 10
    "2.9": "CFC",
    "2.10": "JFJ",  # 18
    "2.11": "JJJ",
    "2.12": "JJJ",
    "2.13": "SSS",
    "2.14": "SSS",
    "3.1": "SFL",  # 19
    "3.2": "SFL",
    "3.3": "SFL",  # 21
    "3.4": "SFL",
    "3.7": "SSS",  # corners of the eyes
    "3.8": "SSS",
    "3.11": "SSS",
    "3.12": "SSS",
    "4.1": "FFS",  # 37, 31
    "4.2": "FFS",
    "4.3": "-FS",  # 33
    "4.4": "-FS",
    "4.5": "SFS",  # 35
    "4.6": "SFS",
    "5.1": "F-S",  # 39
    "5.2": "F-S",
    "5.3": "SFS",  # 41
    "5.4": "SFS",
    "8.1": "-FC",  # 51
    "8.2": "-FC",  # 52
    "8.3": "FFC",  # 53, 59
    "8.4": "FFC",
    "8.5": "CFC",  # 55
    "8.6": "CFC",
    "8.7": "CFC",  # 57
    "8.8": "CFC",
    "9.1": "F-S",  # 61
    "9.2": "F-S",
    "9.3": "FFS",  # 64, 63
    "9.4": "--S",
    "9.5": "--S",
    "9.6": "SSS",  # bridge of the nose
    "9.7": "SSS",
    "9.12": "SSS",
    "9.13": "SSS",
    "9.14": "SSS",
    "9.15": "SSS",
    "10.1": "SFS",  # 65
    "10.2": "SFS",
    "10.3": "FSS",  # 67
    "10.4": "FSS",
    "10.5": "SSS",
    "10.6": "SSS",
    "11.1": "SSS",
    "11.2": "SSS",
    "11.3": "SSS",
    "11.4": "SSS",
    "11.6": "SSS",
}
#: MPEG-4 gives no FAP for these components, yet the lips are one band of flesh. (point, axis):
#: ((source, its axis, share), ...). Points that the standard defines as midpoints stay half-way
#: sideways; the lips come forward as a whole when their middles are pushed (FAPs 16, 17); the
#: corners go back round the teeth as the mouth widens.
COMPLETIONS: dict[tuple[str, int], tuple[tuple[str, int, float], ...]] = {
    ("2.6", 0): (("2.4", 0, 0.5),),
    ("2.7", 0): (("2.5", 0, 0.5),),
    ("2.8", 0): (("2.4", 0, 0.5),),
    ("2.9", 0): (("2.5", 0, 0.5),),
    ("8.5", 0): (("8.3", 0, 0.5),),
    ("8.6", 0): (("8.4", 0, 0.5),),
    ("8.7", 0): (("8.3", 0, 0.5),),
    ("8.8", 0): (("8.4", 0, 0.5),),
    ("2.6", 2): (("2.2", 2, 0.75), ("2.4", 0, -0.1)),
    ("2.7", 2): (("2.2", 2, 0.75), ("2.5", 0, 0.1)),
    ("2.8", 2): (("2.3", 2, 0.75), ("2.4", 0, -0.1)),
    ("2.9", 2): (("2.3", 2, 0.75), ("2.5", 0, 0.1)),
    ("8.1", 2): (("2.2", 2, 0.8),),
    ("8.2", 2): (("2.3", 2, 0.8),),
    ("8.5", 2): (("2.2", 2, 0.6), ("8.3", 0, -0.1)),
    ("8.6", 2): (("2.2", 2, 0.6), ("8.4", 0, 0.1)),
    ("8.7", 2): (("2.3", 2, 0.6), ("8.3", 0, -0.1)),
    ("8.8", 2): (("2.3", 2, 0.6), ("8.4", 0, 0.1)),
    ("2.4", 2): (("2.2", 2, 0.15), ("2.3", 2, 0.15), ("2.4", 0, -0.35)),
    ("2.5", 2): (("2.2", 2, 0.15), ("2.3", 2, 0.15), ("2.5", 0, 0.35)),
    ("8.3", 2): (("2.2", 2, 0.15), ("2.3", 2, 0.15), ("8.3", 0, -0.35)),
    ("8.4", 2): (("2.2", 2, 0.15), ("2.3", 2, 0.15), ("8.4", 0, 0.35)),
}
#: Feature points of the tongue, in the same letters.
TONGUE_CONTROLS = {"6.1": "FFF", "6.2": "-F-"}  # FAPs 43 to 45, and 46

#: How far the skin's motion reaches beyond the points that move, on a head of average size.
RING_MM = 46.0
RING_SPACING_MM = 24.0
_RING_WIDTH_MM = 14.0
CAVITY_SPACING_MM = 11.0
_CAVITY_FROM_LIPS_MM = 9.0
AVERAGE_EYE_SEPARATION_MM = 61.5
_COUNTS = 0.02  # a corner with a smaller weight does not hold a point


@dataclass(frozen=True, eq=False)
class Controls:
    """Control points and what moves them.

    Attributes
    ----------
    points : SurfacePoints
        Feature points by id; auxiliary ones by names with a letter: ``lid.…``, ``mouth.…``,
        ``ring.…``.
    letters : mapping from name to three letters, as in `SKIN_CONTROLS`
    lids : tuple of LidPoint
        What each auxiliary lid point does.
    """

    points: SurfacePoints
    letters: dict[str, str]
    lids: tuple[LidPoint, ...]

    @property
    def constraints(self) -> dict[str, Constraint]:
        """The axes on which each is a control point, as `FeaturePointDeformer` takes them."""
        return {n: (w[0] != "-", w[1] != "-", w[2] != "-") for n, w in self.letters.items()}

    @property
    def still(self) -> tuple[str, ...]:
        """Those that never move."""
        return tuple(n for n, word in self.letters.items() if set(word) <= {"S", "-"})


def place_controls(head: Head) -> Controls:
    """The control points of a head's skin.

    Raises
    ------
    InputError
        If the head lacks a skin, or all feature points that FAPs move.
    """
    if "skin" not in head.mesh.groups:
        raise InputError(f"head {head.name} has no group of triangles named skin")
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    letters = {n: w for n, w in SKIN_CONTROLS.items() if n in head.feature_points.names}
    if not {"2.1", "2.2", "2.3", "8.3", "8.4"} <= set(letters):
        raise InputError(
            f"head {head.name} cannot be driven: it needs at least the feature points 2.1 (chin), "
            "2.2, 2.3 (lips), 8.3 and 8.4 (corners of the mouth)"
        )
    lids = place_lid_points(head, skin)
    letters.update({lid.name: "LLL" for lid in lids})
    placed = joined_points(
        head.feature_points.select(tuple(n for n in letters if n in SKIN_CONTROLS)),
        (lid.point for lid in lids),
    )
    cavity = mouth_cavity(head, skin)
    mouth, mouth_letters = _mouth_points(head, skin, cavity)
    ring = _ring_points(head, skin, placed, letters, cavity)
    letters.update(mouth_letters)
    letters.update({name: "SSS" for name in ring.names})
    points = _uncrowded(joined_points(placed, (mouth, ring)))
    return Controls(
        points,
        {n: word for n, word in letters.items() if n in points.names},
        tuple(lid for lid in lids if lid.name in points.names),
    )


def _uncrowded(points: SurfacePoints) -> SurfacePoints:
    """Without auxiliary points whose triangle has a corner in common with another point's.

    On a coarse mesh two points on the same vertices cannot both be where they should.
    """
    own = [i for i, name in enumerate(points.names) if name in SKIN_CONTROLS]
    taken = set(points.corners[own].ravel().tolist())
    kept = list(own)
    for i, name in enumerate(points.names):
        corners = set(points.corners[i][points.barycentric[i] > _COUNTS].tolist())
        if name not in SKIN_CONTROLS and not corners & taken:
            kept.append(i)
            taken |= corners
    return points.select(tuple(points.names[i] for i in kept))


def joined_points(first: SurfacePoints, more: Iterable[SurfacePoints]) -> SurfacePoints:
    """Points one after the other."""
    parts = [first, *more]
    return SurfacePoints(
        tuple(n for p in parts for n in p.names),
        np.concatenate([p.corners for p in parts]),
        np.concatenate([p.barycentric for p in parts]),
    )


def size_of(head: Head) -> float:
    """A head's size relative to the average."""
    return head.fapu.es / AVERAGE_EYE_SEPARATION_MM


def mouth_cavity(head: Head, skin: NDArray[np.int32]) -> NDArray[np.int64]:
    """Vertices of the skin that line the mouth inside; none if the head has no cavity.

    They lie in a box behind the lips, and the way along their normal is barred by skin.
    """
    p, s, v = head.points, size_of(head), head.mesh.vertices
    if not {"2.2", "2.3", "8.3", "8.4"} <= set(p):
        return np.zeros(0, dtype=np.int64)
    lips = (p["2.2"] + p["2.3"]) / 2
    half = (p["8.3"][0] - p["8.4"][0]) / 2
    used = np.unique(skin)
    q = v[used] - lips
    box = (np.abs(q[:, 0]) < 1.4 * half) & (np.abs(q[:, 1]) < 28 * s)
    box &= (q[:, 2] < -4 * s) & (q[:, 2] > -75 * s)
    candidates = used[box]
    if not len(candidates):
        return np.zeros(0, dtype=np.int64)
    normals = vertex_normals(v, skin)[candidates]
    t, hit, _ = RayScene(v, skin).cast(v[candidates] + 0.05 * normals, normals)
    inside = (hit != NO_HIT) & (t < 45 * s)
    return np.asarray(candidates[inside], dtype=np.int64)


def _mouth_points(
    head: Head, skin: NDArray[np.int32], cavity: NDArray[np.int64]
) -> tuple[SurfacePoints, dict[str, str]]:
    """Points in the mouth: below the line of the lips carried by the jaw, above it still."""
    v, s = head.mesh.vertices, size_of(head)
    near = ("2.2", "2.3", "2.4", "2.5", "2.6", "2.7", "2.8", "2.9")
    lip_points = head.feature_points.select(tuple(n for n in near if n in head.points))
    if not len(cavity) or not len(lip_points):
        return SurfacePoints((), np.zeros((0, 3), np.int32), np.zeros((0, 3))), {}
    from_lips = surface_distances(v, skin, lip_points).to_vertices.min(axis=0)
    inside = cavity[from_lips[cavity] > _CAVITY_FROM_LIPS_MM * s]
    chosen = _spaced(v, inside, CAVITY_SPACING_MM * s)
    line = (head.points["2.2"][1] + head.points["2.3"][1]) / 2
    letters = {f"mouth.{i}": "JJJ" if v[c, 1] < line else "SSS" for i, c in enumerate(chosen)}
    return _at_vertices(tuple(letters), chosen, skin), letters


def _ring_points(
    head: Head,
    skin: NDArray[np.int32],
    placed: SurfacePoints,
    letters: dict[str, str],
    cavity: NDArray[np.int64],
) -> SurfacePoints:
    """Still points where the skin's motion ends: on scalp, temples and neck."""
    v, s = head.mesh.vertices, size_of(head)
    of_face = tuple(
        n for n in placed.names if set(letters[n]) - {"S", "-"} and not n.startswith("10.")
    )
    nearest = surface_distances(v, skin, placed.select(of_face)).to_vertices.min(axis=0)
    beyond = (nearest > RING_MM * s) & (nearest < (RING_MM + _RING_WIDTH_MM) * s)
    beyond[cavity] = False
    rows = np.flatnonzero(beyond)
    chosen = _spaced(v, rows, RING_SPACING_MM * s)
    return _at_vertices(tuple(f"ring.{i}" for i in range(len(chosen))), chosen, skin)


def _spaced(
    v: NDArray[np.float64], rows: NDArray[np.int64], spacing_mm: float
) -> NDArray[np.int64]:
    """Some of the vertices, as far from each other as possible, down to a spacing."""
    if not len(rows):
        return np.asarray(rows)
    chosen = [int(np.argmin(v[rows, 1]))]
    distance = np.linalg.norm(v[rows] - v[rows[chosen[0]]], axis=1)
    while distance.max() > spacing_mm:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(v[rows] - v[rows[chosen[-1]]], axis=1))
    return np.asarray(rows[chosen])


def _at_vertices(
    names: tuple[str, ...], vertices: NDArray[np.int64], skin: NDArray[np.int32]
) -> SurfacePoints:
    """Points at vertices, each in one of the triangles around it."""
    flat = skin.ravel()
    _, first = np.unique(flat, return_index=True)
    where = first[np.searchsorted(np.unique(flat), vertices)]
    triangles, corner = skin[where // 3], where % 3
    return SurfacePoints(names, np.asarray(triangles, dtype=np.int32), np.eye(3)[corner])
