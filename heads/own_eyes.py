"""The eyes of a head from a file: measured, or put in where it has holes for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .head import Eye
from .own_edges import eye_shows
from .own_mesh import OwnMesh
from .own_shells import fitted_eye
from .skin_surface import Surface
from .subdivision import icosphere
from .template import load_template, template_feature_points
from .template_warp import LaidTemplate

_BALL_STEPS = 4
_BALL_BEHIND_MM = 0.4


def with_eyes(
    mesh: OwnMesh, groups: dict[str, NDArray[np.int32]], laid: LaidTemplate
) -> tuple[OwnMesh, dict[str, NDArray[np.int32]], dict[str, Eye], tuple[str, ...]]:
    """Eyes measured; eyeballs put in where a mesh has holes for eyes and no eyes."""
    eyes: dict[str, Eye] = {}
    notes = []
    for side in ("right", "left"):
        part = f"eye_{side}"
        rows = groups.get(part)
        eye = None if rows is None else fitted_eye(mesh.vertices, mesh.triangles, rows)
        if rows is not None and eye is None:
            notes.append(f"the {side} eye is no ball: it turns about the place ours would have")
        eyes[side] = _eye_of_template(laid, side) if eye is None else eye
        skin = Surface(mesh.vertices, mesh.triangles[groups["skin"]])
        if rows is None and eye_shows(skin, laid, side):
            eyes[side] = _behind_lids(eyes[side], laid, side)
            mesh, groups = _with_ball(mesh, groups, part, eyes[side])
            notes.append(f"it has no {side} eyeball behind its lids: one is put in")
    return mesh, groups, eyes, tuple(notes)


def _eye_of_template(laid: LaidTemplate, side: str) -> Eye:
    p = laid.vertices[load_template().vertices_of(f"eye_{side}")]
    centre = (p.min(axis=0) + p.max(axis=0)) / 2
    return Eye(centre, float(np.median(np.linalg.norm(p - centre, axis=1))))


def _behind_lids(eye: Eye, laid: LaidTemplate, side: str) -> Eye:
    """The eye shifted in depth so that the edges of the lids lie just before it."""
    names = ("3.1", "3.3") if side == "left" else ("3.2", "3.4")
    at = laid.at(template_feature_points().select(names))
    shifts = []
    for p in at.values():
        across = p[:2] - eye.centre[:2]
        inside = (eye.radius + _BALL_BEHIND_MM) ** 2 - across @ across
        if inside > 0:
            shifts.append(p[2] - np.sqrt(inside) - eye.centre[2])
    shift = float(np.mean(shifts)) if shifts else 0.0
    return Eye(eye.centre + (0.0, 0.0, shift), eye.radius)


def _with_ball(
    mesh: OwnMesh, groups: dict[str, NDArray[np.int32]], part: str, eye: Eye
) -> tuple[OwnMesh, dict[str, NDArray[np.int32]]]:
    directions, triangles = icosphere(_BALL_STEPS)
    n_vertices, n_triangles = len(mesh.vertices), len(mesh.triangles)
    shapes = mesh.shapes
    if shapes is not None:
        still = np.zeros((len(shapes), len(directions), 3), np.float32)
        shapes = np.concatenate([shapes, still], axis=1)
    uv_triangles = mesh.uv_triangles
    if uv_triangles is not None:
        uv_triangles = np.concatenate([uv_triangles, np.zeros_like(triangles)])
    added = replace(
        mesh,
        vertices=np.concatenate([mesh.vertices, eye.centre + eye.radius * directions]),
        triangles=np.concatenate([mesh.triangles, triangles + n_vertices]),
        labels=(*mesh.labels, part),
        label_of_triangle=np.concatenate(
            [mesh.label_of_triangle, np.full(len(triangles), len(mesh.labels), np.int32)]
        ),
        uv_triangles=uv_triangles,
        shapes=shapes,
    )
    rows = np.arange(n_triangles, n_triangles + len(triangles), dtype=np.int32)
    return added, {**groups, part: rows}
