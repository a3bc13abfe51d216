"""Where named points lie on a model's surface, for a page to show."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..core.formats.glb_document import GlbDocument
from ..core.formats.gltf_write import PIVOT_KEY

if TYPE_CHECKING:
    from ..heads.head import Head

_MM_PER_METRE = 1000.0
#: A vertex of the file and one of the head that lie this near to each other are the same.
_SAME_MM = 0.05


def feature_point_places(glb: bytes, head: Head) -> dict[str, str]:
    """Feature points of a head on a model that we made of it.

    Parameters
    ----------
    glb : bytes
        A .glb file whose meshes hold the head's own vertices at rest.
    head : Head

    Returns
    -------
    dict from a feature point's id to its place
        As model-viewer's ``data-surface``. Points whose corners the model does not have are left
        out: it is empty for another head's model.
    """
    meshes = _rest_meshes(GlbDocument("the model", glb))
    trees = {index: cKDTree(vertices) for index, vertices in meshes.items()}
    found = {}
    points = head.feature_points
    for name, corners, shares in zip(points.names, points.corners, points.barycentric, strict=True):
        place = _place(trees, head.mesh.vertices[corners], shares)
        if place is not None:
            found[name] = place
    return found


def ball_places(glb: bytes, names: Collection[str]) -> dict[str, str]:
    """The middles of a model's balls, each a mesh named as in `names`.

    A middle is half-way between a vertex and the one opposite to it; a triangle of these two faces
    nowhere, so that the viewer never takes the point to be behind.
    """
    document = GlbDocument("the model", glb)
    meshes = document.array(document.root, "meshes", "document")
    vertices = _rest_meshes(document)
    found = {}
    for i, mesh in enumerate(meshes):
        name = document.name_of(mesh, f"mesh {i}")
        if name in names and i in vertices:
            opposite = int(np.linalg.norm(vertices[i] - vertices[i][0], axis=1).argmax())
            found[name] = f"{i} 0 0 {opposite} {opposite} 0.5 0.25 0.25"
    return found


def head_of(glb: bytes) -> str | None:
    """The name of the head that a model of ours was made of; None where it does not say."""
    document = GlbDocument("the model", glb)
    if not document.array(document.root, "scenes", "document"):
        return None
    scene = document.item("scenes", document.root.get("scene", 0), "document")
    extras = scene.get("extras")
    name = extras.get("head") if isinstance(extras, dict) else None
    return name if isinstance(name, str) else None


def _place(
    trees: Mapping[int, cKDTree], corners: NDArray[np.float64], shares: NDArray[np.float64]
) -> str | None:
    """Mesh, primitive, vertices and barycentric coordinates of a point, as text."""
    for index, tree in trees.items():
        distance, rows = tree.query(corners)
        if (distance < _SAME_MM).all():
            vertices = " ".join(str(int(row)) for row in rows)
            return f"{index} 0 {vertices} " + " ".join(f"{share:.4f}" for share in shares)
    return None


def _rest_meshes(document: GlbDocument) -> dict[int, NDArray[np.float64]]:
    """Vertices of each mesh at rest in the head's frame, mm: of its first primitive."""
    found = {}
    for i, node in enumerate(document.array(document.root, "nodes", "document")):
        if not isinstance(node, dict) or "mesh" not in node:
            continue
        where = f"node {i}"
        mesh = document.item("meshes", node["mesh"], where)
        primitives = document.array(mesh, "primitives", where)
        if not primitives:
            continue
        attributes = document.member(primitives[0], "attributes", where)
        metres = document.accessor(attributes.get("POSITION"), ("VEC3",), where)
        found[int(node["mesh"])] = metres * _MM_PER_METRE + _pivot(document, node, where)
    return found


def _pivot(document: GlbDocument, node: dict[str, object], where: str) -> NDArray[np.float64]:
    """What a part's vertices are stored relative to, mm; zero for skinned parts."""
    extras = node.get("extras")
    if "skin" in node or not isinstance(extras, dict):
        return np.zeros(3)
    return np.asarray(document.numbers(extras, PIVOT_KEY, where, (0.0, 0.0, 0.0)))
