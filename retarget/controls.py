"""The control points of a head: which feature points steer its skin, on which axes, and how.

The MPEG-4 points alone do not suffice for a good picture. Where they leave wide gaps, auxiliary
points are placed here by geometry: along the edges of the lids (so that the lids meet along their
whole length), in the mouth's cavity (so that it opens with the jaw), and in a ring on scalp, neck
and ears that stays where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..core.errors import InputError
from ..core.mesh import SurfacePoints
from ..heads.head import Head
from .auxiliary_points import AuxiliaryModel, place_auxiliary_points
from .boundary_points import (
    REACH_MM,
    joined_points,
    mouth_cavity,
    mouth_points,
    ring_points,
    size_of,
)
from .deformer import Constraint
from .lid_points import LidPoint, place_lid_points

__all__ = [
    "COMPLETIONS",
    "LEAST_LID_SHARE",
    "REACH_MM",
    "SKIN_CONTROLS",
    "TONGUE_CONTROLS",
    "Controls",
    "joined_points",
    "place_controls",
    "size_of",
]

#: Feature points of the skin by axis (x, y, z). F: moved by its FAP. J: carried by the jaw bone
#: (F on the chin: by its FAP where given, else by the bone). L: on the lid's sphere. S: still.
#: C: completed from its neighbours, as `COMPLETIONS` says. -: an ordinary vertex on that axis.
#: Points that are not named are ordinary throughout. A, in `Controls.letters` alone: found from
#: what FAPs say (`auxiliary_points`).
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
TONGUE_CONTROLS = {"6.1": "FFF", "6.2": "SFS"}  # FAPs 43 to 45, and 46

#: Lid points that make less of the edge's motion give way to auxiliary points, which know of brows.
LEAST_LID_SHARE = 0.5
_COUNTS = 0.02  # a corner with a smaller weight does not hold a point


@dataclass(frozen=True, eq=False)
class Controls:
    """Control points and what moves them.

    Attributes
    ----------
    points : SurfacePoints
        Feature points by id; auxiliary ones by names with a letter: ``lid.…``, ``aux.…``,
        ``mouth.…``, ``ring.…``.
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


def place_controls(head: Head, auxiliary: AuxiliaryModel | None = None) -> Controls:
    """The control points of a head's skin.

    Parameters
    ----------
    head : Head
    auxiliary : AuxiliaryModel or None
        Whose points are added, and which then says what no FAP does.

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
    if auxiliary is not None:
        lids = tuple(lid for lid in lids if lid.share > LEAST_LID_SHARE)
    letters.update({lid.name: "LLL" for lid in lids})
    placed = joined_points(
        head.feature_points.select(tuple(n for n in letters if n in SKIN_CONTROLS)),
        (lid.point for lid in lids),
    )
    if auxiliary is not None:
        added = place_auxiliary_points(head, auxiliary)
        placed = joined_points(placed, (added,))
        letters.update({name: "AAA" for name in added.names})
        for name, axis in auxiliary.outputs:
            if name in letters:
                letters[name] = letters[name][:axis] + "A" + letters[name][axis + 1 :]
    cavity = mouth_cavity(head, skin)
    mouth, mouth_letters = mouth_points(head, skin, cavity)
    ring = ring_points(head, skin, placed, letters, cavity)
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
