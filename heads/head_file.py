"""Heads written as .glb files that can be read again exactly: `own_kept` is the other half.

Meshes, textures and shapes are plain glTF, at rest; what else makes them a head is in the scene's
extras (`head_facts`).
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.formats.gltf import GltfPart, GltfScene, MorphTarget, unweld
from ..core.mesh import Mesh
from .appearance import png_bytes
from .head import Head
from .head_facts import FACTS_KEY, HeadFacts, facts_text

#: Roughness of parts; the inside of the mouth is wet.
_ROUGHNESS = {"skin": 0.55, "eye_right": 0.12, "eye_left": 0.12, "lashes": 0.9, "other": 0.7}
_MOUTH_ROUGHNESS = 0.3
_STILL_MM = 1e-6


def head_scene(head: Head, *, lips_part: bool, texture_px: int | None = None) -> GltfScene:
    """A head at rest with its shapes as a glTF scene, for `core.formats.gltf.write_glb`.

    Parameters
    ----------
    head : Head
    lips_part : bool
        Whether its mesh has a slit between the lips.
    texture_px : int, optional
        Larger textures are made this large.
    """
    pictures: dict[int, bytes] = {}  # parts share textures
    parts = []
    for part in head.mesh.groups:
        if len(head.mesh.groups[part]):
            texture = head.appearance.texture_of(part)
            if id(texture) not in pictures:
                pictures[id(texture)] = png_bytes(_shrunk(texture, texture_px))
            parts.append(_part(head, part, pictures[id(texture)]))
    facts = facts_of(head, lips_part=lips_part)
    return GltfScene(
        head.name,
        tuple(parts),
        np.zeros(1),
        extras={"head": head.name, FACTS_KEY: facts_text(facts)},
    )


def facts_of(head: Head, *, lips_part: bool) -> HeadFacts:
    """What is known of a head besides its meshes."""
    at = head.feature_points.at(head.mesh.vertices)
    marks = head.mesh.landmarks
    landmarks = {}
    if marks is not None:
        landmarks = dict(zip(marks.names, marks.at(head.mesh.vertices), strict=True))
    skin = head.mesh.groups["skin"]
    bits = np.zeros(len(head.mesh.triangles), np.uint64)
    for number, rows in enumerate(head.regions.values()):
        bits[rows] |= np.uint64(1 << number)
    return HeadFacts(
        head.name,
        dict(zip(head.feature_points.names, at, strict=True)),
        landmarks,
        head.eyes,
        head.jaw_pivot,
        head.neck_pivot,
        lips_part,
        tuple(head.regions),
        bits[skin],
    )


def _part(head: Head, part: str, picture: bytes) -> GltfPart:
    mesh, triangles = head.mesh, head.mesh.triangles[head.mesh.groups[part]]
    used, inverse = np.unique(triangles, return_inverse=True)
    local = inverse.reshape(-1, 3).astype(np.int32)
    uv = mesh.uv if head.appearance.uv is None else head.appearance.uv
    alone = Mesh(mesh.vertices[used], local)
    if uv is not None and mesh.uv_triangles is not None:
        alone = replace(alone, uv=uv, uv_triangles=mesh.uv_triangles[mesh.groups[part]])
    rows, plain = unweld(alone)
    return replace(
        plain,
        name=part,
        texture_png=None if plain.uv is None else picture,
        roughness=_ROUGHNESS.get(part, _MOUTH_ROUGHNESS),
        double_sided=part in ("lashes", "other"),
        targets=_targets(head, used[rows]),
    )


def _targets(head: Head, rows: NDArray[np.int32]) -> tuple[MorphTarget, ...]:
    """Those of the head's shapes that move any of these vertices."""
    found = []
    if head.shapes is None:
        return ()
    for name, shape in zip(head.shape_names, head.shapes, strict=True):
        moved = shape[rows].astype(np.float64)
        touched = np.flatnonzero(np.abs(moved).max(axis=1) > _STILL_MM).astype(np.int32)
        if len(touched):
            found.append(MorphTarget(name, touched, moved[touched]))
    return tuple(found)


def _shrunk(picture: NDArray[np.uint8], largest_px: int | None) -> NDArray[np.uint8]:
    height, width = picture.shape[:2]
    if largest_px is None or max(height, width) <= largest_px:
        return picture
    scale = largest_px / max(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
