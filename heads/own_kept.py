"""Heads from files that we wrote ourselves (`head_file`): read again, and nothing is guessed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..core.mesh import Mesh
from .head import Head
from .head_facts import HeadFacts
from .own_looks import own_appearance
from .own_mesh import OwnMesh, with_own_vertices
from .own_points import INNER_POINTS, points_on_parts
from .skin_surface import Surface
from .template import template_feature_points

Floats = NDArray[np.float64]

#: Points that lie further than this from the surface are of another one.
_ON_SURFACE_MM = 0.5


def kept_head(mesh: OwnMesh, given: Mapping[str, Floats]) -> Head | None:
    """The head of a file that says all of it; None where the meshes are not those that it means.

    Parameters
    ----------
    mesh : OwnMesh
        With `facts`; mm, head frame.
    given : mapping from feature point or landmark to (3,) mm, head frame
        Corrected places: they count before the file's.
    """
    facts = mesh.facts
    if facts is None:
        return None
    groups = {
        label: np.flatnonzero(mesh.label_of_triangle == i).astype(np.int32)
        for i, label in enumerate(mesh.labels)
    }
    mesh, _ = with_own_vertices(mesh, groups)  # reading joins what touches
    if "skin" not in groups or len(facts.region_bits) != len(groups["skin"]):
        return None
    skin = Surface(mesh.vertices, mesh.triangles[groups["skin"]])
    if not _lie_on(facts, mesh, groups, skin):
        return None
    corrected = {**facts.points, **{n: p for n, p in given.items() if _has_part(n, groups)}}
    landmarks = {n: given.get(n, p) for n, p in facts.landmarks.items()}
    looks, uv, uv_triangles = own_appearance(mesh, mesh.vertices, groups, facts.eyes)
    marks = None
    if landmarks:
        marks = skin.points_at(tuple(landmarks), np.array(list(landmarks.values())))
    return Head(
        name=facts.name,
        mesh=Mesh(mesh.vertices, mesh.triangles, uv, uv_triangles, groups, marks),
        feature_points=points_on_parts(skin, mesh.vertices, mesh.triangles, groups, corrected),
        eyes=facts.eyes,
        jaw_pivot=facts.jaw_pivot,
        neck_pivot=given.get("7.1", facts.neck_pivot),
        appearance=looks,
        shape_names=mesh.shape_names,
        shapes=mesh.shapes,
        regions={
            name: groups["skin"][(facts.region_bits >> np.uint64(number)) % np.uint64(2) == 1]
            for number, name in enumerate(facts.regions)
        },
    )


def _has_part(name: str, groups: Mapping[str, NDArray[np.int32]]) -> bool:
    """Whether a name is that of a feature point which has something to lie on."""
    part = INNER_POINTS.get(name, "skin")
    known = name in template_feature_points().names
    return known and (part in groups or part.startswith("eye_"))


def _lie_on(
    facts: HeadFacts,
    mesh: OwnMesh,
    groups: Mapping[str, NDArray[np.int32]],
    skin: Surface,
) -> bool:
    """Whether the feature points are still where the meshes are."""
    if not facts.points:
        return False
    placed = points_on_parts(skin, mesh.vertices, mesh.triangles, groups, facts.points)
    there = placed.at(mesh.vertices)
    wanted = np.array([facts.points[name] for name in placed.names])
    off = np.linalg.norm(there - wanted, axis=1)
    return len(placed) == len(facts.points) and bool((off < _ON_SURFACE_MM).all())
