"""Animated heads as glTF scenes."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..core.formats.gltf import GltfPart, GltfScene, MorphTarget, unweld
from ..core.formats.gltf_scene import ROOT_NAME
from ..core.mesh import Mesh, vertex_normals
from ..heads.appearance import Appearance
from ..heads.bones import make_bones
from ..heads.head import Head
from .animation import HeadAnimation
from .morph_curves import STILL_MM, MotionCurves, frame_curves, motion_curves

__all__ = ["MotionCurves", "animation_glb", "bones_glb", "frame_curves", "motion_curves"]

#: Linear colours of parts that have no texture coordinates.
_PLAIN = {
    "eye_right": (0.85, 0.85, 0.85, 1.0),
    "eye_left": (0.85, 0.85, 0.85, 1.0),
    "lashes": (0.01, 0.008, 0.006, 1.0),
    "teeth_upper": (0.75, 0.70, 0.60, 1.0),
    "teeth_lower": (0.75, 0.70, 0.60, 1.0),
    "tongue": (0.45, 0.12, 0.11, 1.0),
}
_ROUGHNESS = {"skin": 0.55, "eye_right": 0.12, "eye_left": 0.12, "lashes": 0.9}
_MOUTH_ROUGHNESS = 0.3
_BONE, _BONE_ROUGHNESS = (0.72, 0.66, 0.54, 1.0), 0.7
#: Joints of parts that move rigidly; where parts of one joint move differently, the later ones get
#: their own, named after the part.
JOINTS = {
    "teeth_lower": "jaw",
    "tongue": "jaw",
    "eye_left": "eye_left",
    "eye_right": "eye_right",
}


def animation_glb(
    head: Head,
    animation: HeadAnimation,
    *,
    name: str,
    texture_px: int | None = 1024,
    curves: MotionCurves | None = None,
    skeleton: bool = True,
) -> GltfScene:
    """An animated head as a glTF scene, for `core.formats.gltf.write_glb`.

    Vertices are linear in the points' displacements, so blendshapes give exactly what
    `HeadAnimation.vertices` gives, to the file's single precision: about 2e-5 mm. Normals are
    linear only nearly. Skin, lashes and what bends the tongue are blendshapes; eyes, lower teeth
    and tongue turn as their joints do (`JOINTS`), and the head's motion is the root joint's: no
    motion is made twice.

    Parameters
    ----------
    head : Head
    animation : HeadAnimation
        Of this head.
    name : str
    texture_px : int or None
        Textures larger than this are made smaller; None keeps them.
    curves : MotionCurves or None
        `frame_curves` for vertex animation; None: `motion_curves`.
    skeleton : bool
        Bind the parts to joints of a skin. False: parts that turn are nodes that turn.

    Raises
    ------
    ValueError
        If the animation is another head's.
    """
    if animation.head is not head:
        raise ValueError("the animation is of another head")
    curves = motion_curves(animation) if curves is None else curves
    offsets = (animation.deformer.matrix @ curves.amounts).tocsc()
    parts = tuple(
        _part(animation, part, curves, offsets, texture_px)
        for part in head.mesh.groups
        if len(head.mesh.groups[part])
    )
    if skeleton:
        parts = tuple(_jointed(part, animation) for part in parts)
    motion = animation.motion
    turned = (
        np.abs(motion.quaternion[:, 1:]).max() > 1e-9 or np.abs(motion.translation).max() > 1e-9
    )
    return GltfScene(
        name,
        parts,
        animation.time_s,
        root_rotation=motion.quaternion if turned else None,
        root_translation=motion.translation if turned else None,
        extras={"head": head.name},
        root_pivot=head.neck_pivot if skeleton else np.zeros(3),
    )


def _jointed(part: GltfPart, animation: HeadAnimation) -> GltfPart:
    """The part bound to its joint: its own where others of the joint move differently."""
    joint = joint_of(animation, part.name)
    return replace(part, joint=ROOT_NAME if joint is None else joint)


def joint_of(animation: HeadAnimation, part: str) -> str | None:
    """Name of the joint that turns a part; None for parts that go with the head."""
    if part not in animation.parts:
        return None
    joint = JOINTS.get(part, part)
    first = next(name for name in animation.parts if JOINTS.get(name, name) == joint)
    a, b = animation.parts[first], animation.parts[part]
    alike = all(
        np.array_equal(x, y)
        for x, y in (
            (a.pivot, b.pivot), (a.rotation, b.rotation), (a.translation, b.translation),
        )
    )  # fmt: skip
    return joint if alike else part


def bones_glb(head: Head) -> GltfScene:
    """A head's skull and mandible, at rest, as a glTF scene."""
    bones = make_bones(head)
    parts = []
    for name, mesh in (("skull", bones.skull), ("mandible", bones.mandible)):
        normals = vertex_normals(mesh.vertices, mesh.triangles)
        parts.append(
            GltfPart(
                name, mesh.vertices, mesh.triangles, normals,
                base_color=np.array(_BONE), roughness=_BONE_ROUGHNESS,
            )
        )  # fmt: skip
    return GltfScene(f"bones of {head.name}", tuple(parts), np.zeros(1), extras={"head": head.name})


def _part(
    animation: HeadAnimation,
    part: str,
    curves: MotionCurves,
    offsets: sparse.csc_matrix,
    texture_px: int | None,
) -> GltfPart:
    rows, plain = _unwelded(animation.head, part)
    dressed = _dressed(animation.head, part, plain, texture_px)
    targets, weights = [], []
    for k, curve in enumerate(curves.names):
        moved = offsets[:, [k]].toarray().reshape(-1, 3)
        target = _target(curve, plain, rows, moved[rows])
        if target is not None:
            targets.append(target)
            weights.append(curves.weights[:, k])
    rigid = animation.parts.get(part)
    return replace(
        dressed,
        targets=tuple(targets),
        weights=np.stack(weights, axis=1) if targets else None,
        rotation=None if rigid is None else rigid.rotation,
        translation=None if rigid is None else rigid.translation,
        pivot=np.zeros(3) if rigid is None else rigid.pivot,
    )


def _unwelded(head: Head, part: str) -> tuple[NDArray[np.int32], GltfPart]:
    """A part's own vertices, doubled where texture seams run: rows of the head's, and the part."""
    mesh, triangles = head.mesh, head.mesh.triangles[head.mesh.groups[part]]
    used, inverse = np.unique(triangles, return_inverse=True)
    local = inverse.reshape(-1, 3).astype(np.int32)
    uv = mesh.uv if head.appearance.uv is None else head.appearance.uv
    if uv is None or mesh.uv_triangles is None:
        alone = Mesh(mesh.vertices[used], local)
    else:
        uv_triangles = mesh.uv_triangles[mesh.groups[part]]
        alone = Mesh(mesh.vertices[used], local, uv, uv_triangles)
    rows, found = unweld(alone)
    return used[rows].astype(np.int32), found


def _target(
    name: str, part: GltfPart, rows: NDArray[np.int32], moved: NDArray[np.float64]
) -> MorphTarget | None:
    """A blendshape of a part; None if it does not touch it."""
    touched = np.flatnonzero(np.abs(moved).max(axis=1) > STILL_MM).astype(np.int32)
    if not len(touched):
        return None
    turned = _smooth_normals(part, rows, moved)[touched] - part.normals[touched]
    return MorphTarget(name, touched, moved[touched], turned)


def _smooth_normals(
    part: GltfPart, rows: NDArray[np.int32], moved: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Normals of the moved part, smooth across texture seams."""
    first, same = np.unique(rows, return_index=True, return_inverse=True)[1:]
    vertices = (part.vertices + moved)[first]
    found: NDArray[np.float64] = vertex_normals(vertices, same[part.triangles].astype(np.int32))
    return found[same]


def _dressed(head: Head, part: str, plain: GltfPart, texture_px: int | None) -> GltfPart:
    """The part with its name and material."""
    looks = head.appearance
    found = replace(
        plain,
        name=part,
        roughness=_ROUGHNESS.get(part, _MOUTH_ROUGHNESS),
        double_sided=part == "lashes",
    )
    if plain.uv is None:
        colour = _PLAIN.get(part, (*_linear_skin(looks), 1.0))
        return replace(found, base_color=np.array(colour))
    # a little transparent as a whole, so that the writer blends the texture's transparency
    alpha = 0.99 if part == "lashes" and looks.details is not None else 1.0
    found = replace(
        found,
        texture_png=_png(looks.texture_of(part), texture_px),
        base_color=np.array([1.0, 1.0, 1.0, alpha]),
    )
    if part != "skin":
        return found
    if looks.normal is not None:
        found = replace(found, normal_png=_png(looks.normal, texture_px))
    if looks.roughness is not None:
        rough = np.zeros((*looks.roughness.shape, 3), np.uint8)
        rough[..., 1] = looks.roughness
        found = replace(found, roughness_png=_png(rough, texture_px), roughness=1.0)
    return found


def _linear_skin(looks: Appearance) -> NDArray[np.float64]:
    """The skin's mean colour, linear (IEC 61966-2-1)."""
    c = np.asarray(looks.mean_skin()) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def _png(picture: NDArray[np.uint8], largest_px: int | None) -> bytes:
    height, width = picture.shape[:2]
    shrink = 1.0 if largest_px is None else min(1.0, largest_px / max(width, height))
    if shrink < 1:
        size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    swap = cv2.COLOR_RGBA2BGRA if picture.shape[2] == 4 else cv2.COLOR_RGB2BGR
    written, data = cv2.imencode(".png", cv2.cvtColor(picture, swap))
    assert written
    return data.tobytes()
