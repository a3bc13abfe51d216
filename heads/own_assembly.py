"""A head of its pieces: looks, landmarks, joints and regions, carried over from the template."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..core.mesh import Mesh, SurfacePoints
from .head import Eye, Head
from .identity import joints
from .landmarks import template_landmarks
from .own_looks import own_appearance
from .own_mesh import OwnMesh
from .own_points import near_surface
from .raycast import RayScene
from .regions import REGIONS, template_regions
from .skin_surface import Surface
from .template import load_template
from .template_warp import LaidTemplate

Floats = NDArray[np.float64]

_REGION_NEAR_MM = 12.0


def assembled(
    mesh: OwnMesh,
    name: str,
    groups: Mapping[str, NDArray[np.int32]],
    eyes: Mapping[str, Eye],
    laid: LaidTemplate,
    points: SurfacePoints,
    size: float,
) -> Head:
    """A `Head` of its pieces; `size` is that of the template laid on, relative to ours."""
    looks, uv, uv_triangles = own_appearance(mesh, mesh.vertices, groups, eyes)
    skin = Surface(mesh.vertices, mesh.triangles[groups["skin"]])
    marks = near_surface(skin, laid.at(template_landmarks()))
    jaw, neck = joints(laid.vertices, size)
    return Head(
        name=name,
        mesh=Mesh(
            mesh.vertices,
            mesh.triangles,
            uv,
            uv_triangles,
            groups,
            skin.points_at(tuple(marks), np.array(list(marks.values()))),
        ),
        feature_points=points,
        eyes=eyes,
        jaw_pivot=jaw,
        neck_pivot=neck,
        appearance=looks,
        shape_names=mesh.shape_names,
        shapes=mesh.shapes,
        regions=_regions(mesh, groups["skin"], laid),
    )


def _regions(
    mesh: OwnMesh, skin: NDArray[np.int32], laid: LaidTemplate
) -> dict[str, NDArray[np.int32]]:
    """The template's regions on the skin: each triangle has that of the template beside it."""
    template = load_template()
    of_template = np.full(len(template.triangles), -1)
    regions = template_regions()
    for i, name in enumerate(REGIONS):
        of_template[regions[name]] = i
    chosen = np.flatnonzero(of_template >= 0)
    middles = mesh.vertices[mesh.triangles[skin]].mean(axis=1)
    scene = RayScene(laid.vertices, template.triangles[chosen])
    at, triangle, _ = scene.closest(middles)
    region = of_template[chosen[triangle]]
    region[np.linalg.norm(at - middles, axis=1) > _REGION_NEAR_MM] = -1
    found = {name: skin[region == i] for i, name in enumerate(REGIONS)}
    return {name: rows for name, rows in found.items() if len(rows)}
