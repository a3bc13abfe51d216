"""A mesh in the head's frame: its unit, its axes, its pose, its outside."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from .own_mesh import OwnMesh
from .own_shells import expected_on_template
from .raycast import RayScene
from .similarity import Similarity
from .template_warp import LaidTemplate

Floats = NDArray[np.float64]

#: Units that meshes are made in, mm.
UNITS = {"millimetres": 1.0, "centimetres": 10.0, "decimetres": 100.0, "metres": 1000.0,
         "inches": 25.4}  # fmt: skip
#: A head this much larger or smaller than ours (as a factor) is still taken for one in that unit.
_SIZE_RANGE = 1.45
#: A head turned less than this from its file's axes keeps them at first; then it is set straight.
_STRAIGHT_RAD = 0.3
_STRAIGHT_ENOUGH_RAD = 0.025
_BODY_BELOW_MM, _BUST_BELOW_MM = -650.0, -330.0


def in_head_axes(
    mesh: OwnMesh, template_from_file: Similarity
) -> tuple[OwnMesh, float, Floats, tuple[str, ...]]:
    """The mesh in mm and the head's axes (the origin is still the file's), unit, turn, notes."""
    notes = []
    scale = template_from_file.scale
    word, unit = min(UNITS.items(), key=lambda u: abs(np.log(scale / u[1])))
    if abs(np.log(scale / unit)) > np.log(_SIZE_RANGE):
        unit = scale
        notes.append("its size is that of no head in a usual unit: it is scaled to an average one")
    elif word != "millimetres":
        notes.append(f"its numbers are taken for {word}, by the size of the face")
    axes = _nearest_axes(template_from_file.rotation)
    off = axes @ template_from_file.rotation.T
    if np.arccos(np.clip((np.trace(off) - 1) / 2, -1, 1)) > _STRAIGHT_RAD:
        axes = template_from_file.rotation
        notes.append("the head is turned against its file's axes: it is turned to the front")
    elif not np.allclose(axes, np.eye(3)):
        notes.append(f"{_axis_word(axes[1])} is up and the face looks along {_axis_word(axes[2])}")
    moved = Similarity(unit, axes, np.zeros(3))
    whole = turned_mesh(mesh, moved)
    eyes_y = float((axes @ (_eyes_in_file(template_from_file)))[1] * unit)
    whole, note = _without_body(whole, eyes_y)
    return whole, unit, axes, (*notes, *note)


def turned_mesh(mesh: OwnMesh, moved: Similarity) -> OwnMesh:
    """A mesh and its shapes moved."""
    shapes = mesh.shapes
    if shapes is not None:
        linear = (moved.scale * moved.rotation.T).astype(np.float32)
        shapes = (shapes @ linear).astype(np.float32)
    return replace(mesh, vertices=moved.apply(mesh.vertices), shapes=shapes)


def straightened(
    template_from_head: Similarity, laid: LaidTemplate
) -> tuple[Similarity, tuple[str, ...]]:
    """The turn that sets a head as straight as ours; none for what is nearly so."""
    held = template_from_head.rotation.T @ laid.placed.rotation
    angle = float(np.arccos(np.clip((np.trace(held) - 1) / 2, -1, 1)))
    if angle < _STRAIGHT_ENOUGH_RAD:
        return Similarity(1.0, np.eye(3), np.zeros(3)), ()
    said = f"the head is held {np.degrees(angle):.0f} degrees off straight: it is set straight"
    return Similarity(1.0, held.T, np.zeros(3)), (said,)


def _eyes_in_file(template_from_file: Similarity) -> Floats:
    return template_from_file.inverse().apply(np.zeros(3))


def _nearest_axes(rotation: Floats) -> Floats:
    """The turn by right angles that is nearest to a rotation."""
    best = np.eye(3)
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[np.arange(3), order] = signs
            if np.linalg.det(turn) > 0 and (turn * rotation).sum() > (best * rotation).sum():
                best = turn
    return best


def _axis_word(row: Floats) -> str:
    axis = int(np.argmax(np.abs(row)))
    return f"{'+' if row[axis] > 0 else '-'}{'XYZ'[axis]}"


def _without_body(mesh: OwnMesh, eyes_y: float) -> tuple[OwnMesh, tuple[str, ...]]:
    """A whole body cut off below the shoulders."""
    y = mesh.vertices[:, 1] - eyes_y
    if y.min() > _BODY_BELOW_MM:
        return mesh, ()
    keep = (y[mesh.triangles] > _BUST_BELOW_MM).any(axis=1)
    used, compact = np.unique(mesh.triangles[keep], return_inverse=True)
    cut = replace(
        mesh,
        vertices=mesh.vertices[used],
        triangles=compact.reshape(-1, 3).astype(np.int32),
        label_of_triangle=mesh.label_of_triangle[keep],
        uv_triangles=None if mesh.uv_triangles is None else mesh.uv_triangles[keep],
        shapes=None if mesh.shapes is None else mesh.shapes[:, used],
    )
    return cut, ("the file holds a whole body: it is cut off below the shoulders",)


def facing_out(mesh: OwnMesh, near: Floats) -> tuple[OwnMesh, tuple[str, ...]]:
    """The mesh with triangles that are counter-clockwise from outside, as rays from the front see.

    `near` are its vertices about where the template is.
    """
    scene = RayScene(near, mesh.triangles)
    face = expected_on_template().face
    origins = face * (1, 1, 0) + (0, 0, 400.0)
    _, triangle, _ = scene.cast(origins, np.tile([0.0, 0.0, -1.0], (len(face), 1)))
    hit = triangle < len(mesh.triangles)
    corners = near[mesh.triangles[triangle[hit]]]
    ahead = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0
    if not hit.any() or ahead.mean() > 0.5:
        return mesh, ()
    flipped = replace(
        mesh,
        triangles=mesh.triangles[:, ::-1],
        uv_triangles=None if mesh.uv_triangles is None else mesh.uv_triangles[:, ::-1],
    )
    return flipped, ("its triangles are inside out: they are turned over",)
