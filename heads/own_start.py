"""Where a head is in its file: by points that a person gives, or by the face that is found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.mesh import SurfacePoints
from .face_finder import FaceFinder
from .face_landmarks import NAMED_LANDMARKS
from .face_network import INSTALL_NETWORKS, face_networks_path
from .landmarks import template_landmarks
from .own_frame import UNITS
from .own_mesh import OwnMesh
from .own_views import find_face_on_mesh
from .place_face_landmarks import template_face_landmarks
from .raycast import RayScene
from .similarity import Similarity
from .template import load_template, template_feature_points
from .template_warp import known_points

Floats = NDArray[np.float64]

_FEWEST_GIVEN = 3
_NEAR_MESH = 0.05  # of its size: how far given points may lie from it


@dataclass(frozen=True, eq=False)
class HeadStart:
    """What is known of the head's place: points of the template and theirs, template's frame."""

    template_from_file: Similarity
    landmarks: tuple[SurfacePoints, Floats] | None
    anchors: tuple[SurfacePoints, Floats] | None
    given: Mapping[str, Floats]  # the file's frame and unit
    how: str


def head_start(
    mesh: OwnMesh, name: str, points: Mapping[str, Floats] | None, finder: FaceFinder | None
) -> HeadStart:
    """Where a head is: as `points` say, (3,) each in the file's axes, else as a network sees it.

    Raises
    ------
    InputError
        As of `own_head.read_own_head`.
    """
    template = load_template().vertices
    if points is not None:
        given = in_the_files_unit(mesh, name, points)
        known, places = known_points(given, named_points())
        if len(known) < _FEWEST_GIVEN:
            raise InputError(
                f"{name}: {len(known)} points are given that we know, at least {_FEWEST_GIVEN} "
                "are needed: feature points (8.3), Farkas's landmarks (ch_l), or "
                + ", ".join(list(NAMED_LANDMARKS)[:6])
                + " and the like"
            )
        placed = Similarity.between(places, known.at(template))
        return HeadStart(placed, None, (known, placed.apply(places)), given, "given")
    if finder is None:
        finder = _finder(name)
    try:
        face = find_face_on_mesh(mesh.vertices, mesh.triangles, finder)
    except InputError as error:
        raise InputError(f"{name}: {error}; {_GIVE_POINTS}") from error
    known, places = known_points(
        {str(i): p for i, p in enumerate(face.points) if np.isfinite(p).all()},
        template_face_landmarks(),
    )
    placed = Similarity.between(places, known.at(template))
    return HeadStart(placed, (known, placed.apply(places)), None, {}, "found")


_GIVE_POINTS = (
    "give 3 to 7 points on its surface (columns name,x,y,z; names such as eye_right_outer, "
    "eye_left_outer, nose_tip, mouth_right, mouth_left, or MPEG-4's) with --points, or as "
    "NAME.points.csv beside the head"
)


def _finder(name: str) -> FaceFinder:
    if face_networks_path() is None:
        raise InputError(
            f"{name}: to find the face on a mesh the face networks must be installed "
            f"({INSTALL_NETWORKS}); or {_GIVE_POINTS}"
        )
    return FaceFinder()


@cache
def named_points() -> SurfacePoints:
    """All points of the template that have a name that users may give."""
    faces = template_face_landmarks()
    by_number = {str(number): name for name, number in NAMED_LANDMARKS.items()}
    kept = tuple(n for n in faces.names if n in by_number)
    chosen = faces.select(kept)
    plain = SurfacePoints(tuple(by_number[n] for n in kept), chosen.corners, chosen.barycentric)
    parts = (template_feature_points(), template_landmarks(), plain)
    return SurfacePoints(
        tuple(n for part in parts for n in part.names),
        np.concatenate([part.corners for part in parts]),
        np.concatenate([part.barycentric for part in parts]),
    )


def in_the_files_unit(mesh: OwnMesh, name: str, points: Mapping[str, Floats]) -> dict[str, Floats]:
    """Given points in the unit of the mesh's numbers: the one in which they lie on its surface."""
    scene = RayScene(mesh.vertices, mesh.triangles)
    surface = [n for n in points if n not in ("7.1", "11.5")]
    if not surface:
        raise InputError(f"{name}: no points of the surface are given")
    places = np.array([points[n] for n in surface])
    size = float(np.ptp(mesh.vertices, axis=0).max())
    factors = sorted({f for u in UNITS.values() for f in (u, 1 / u)}, key=lambda f: abs(np.log(f)))
    off = [
        float(np.median(np.linalg.norm(scene.closest(places * f)[0] - places * f, axis=1)))
        for f in factors
    ]
    spread = [float(np.ptp(places * f, axis=0).max()) for f in factors]
    fits = [o + (np.inf if s < 0.02 * size else 0.0) for o, s in zip(off, spread, strict=True)]
    best = int(np.argmin(fits))
    if fits[0] < 0.2 * _NEAR_MESH * size:  # in doubt as they are
        best = 0
    if not fits[best] < _NEAR_MESH * size:
        raise InputError(
            f"{name}: the given points do not lie on the mesh: they must be in the axes of its "
            "file, in its unit or millimetres"
        )
    return {n: np.asarray(p, dtype=np.float64) * factors[best] for n, p in points.items()}
