"""What another maker's head looks like: its pictures and colours in one atlas, its eyes painted.

Our heads have one picture for the skin, one for the eyes, one for the rest. Files have any number:
all go into one picture, a tile each. Eyes without a picture of their own are painted.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from .appearance import Appearance
from .appearance_traits import AppearanceTraits
from .eye_paint import paint_eye
from .head import Eye
from .own_mesh import Look, OwnMesh, shells
from .texture_layout import EYE_FRONT_RAD, EYE_FRONT_SHARE

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]

#: Lashes below the eye without a picture: dark strips there look like bruises.
_LOWER_LASHES = "lower lashes"
#: sRGB of parts that a file gives neither colour nor picture.
_PLAIN = {
    "skin": (206, 163, 138),
    "eye_right": (226, 220, 212),
    "eye_left": (226, 220, 212),
    "lashes": (96, 68, 56),
    "teeth_upper": (226, 218, 200),
    "teeth_lower": (226, 218, 200),
    "tongue": (176, 96, 90),
    "other": (150, 140, 132),
    _LOWER_LASHES: (190, 150, 128),
}
_SMALL_PX, _ONLY_PX, _TILE_PX = 16, 2048, 1024
_INSET = 0.5  # texels from a tile's edge that no coordinate goes beyond
_EYE_SEED = 1
_BELOW_MM = 3.0
_DARKER = 0.94


def own_appearance(
    mesh: OwnMesh,
    vertices: Floats,
    groups: Mapping[str, NDArray[np.int32]],
    eyes: Mapping[str, Eye],
) -> tuple[Appearance, Floats, NDArray[np.int32]]:
    """Textures of a head, and coordinates that lay them on.

    Parameters
    ----------
    mesh : OwnMesh
        Its triangles, labels, looks and coordinates.
    vertices : (V, 3) float64, mm, head frame
        Of these triangles.
    groups : mapping from part to triangle indices
    eyes : mapping from side to Eye

    Returns
    -------
    Appearance
    (U, 2) float64, (F, 3) int32
        Texture coordinates, origin at the bottom left, and the triangles' corners among them.
    """
    looks, tile_of = _tiles(mesh, _part_of(mesh, vertices, groups, eyes))
    atlas, boxes = _atlas(looks)
    corner_uv = _corner_uv(mesh, tile_of, looks, boxes, atlas.shape)
    painted = None
    if _eyes_are_plain(mesh, groups):
        painted = paint_eye(AppearanceTraits(), np.random.default_rng(_EYE_SEED))
        for side, eye in eyes.items():
            if f"eye_{side}" in groups:
                ball = groups[f"eye_{side}"]
                corner_uv[ball] = _eye_uv(vertices[mesh.triangles[ball]], eye)
    both, inverse = np.unique(corner_uv @ np.array([1.0, 1j]), return_inverse=True)
    uv = np.stack([both.real, both.imag], axis=1)
    return Appearance(atlas, eye=painted), uv, inverse.reshape(-1, 3).astype(np.int32)


def _part_of(
    mesh: OwnMesh,
    vertices: Floats,
    groups: Mapping[str, NDArray[np.int32]],
    eyes: Mapping[str, Eye],
) -> NDArray[np.int64]:
    """(F,): which row of `_PLAIN` each triangle belongs to."""
    parts = tuple(_PLAIN)
    found = np.full(len(mesh.triangles), parts.index("other"))
    for name, rows in groups.items():
        found[rows] = parts.index(name)
    found[_lower_lashes(mesh, vertices, groups, eyes)] = parts.index(_LOWER_LASHES)
    return found


def _tiles(mesh: OwnMesh, part_of: NDArray[np.int64]) -> tuple[list[Look], NDArray[np.int64]]:
    """Looks that differ, and which of them each triangle has."""
    parts, n_labels = tuple(_PLAIN), max(len(mesh.labels), 1)
    kinds, kind_of = np.unique(part_of * n_labels + mesh.label_of_triangle, return_inverse=True)
    of_kind = [_look(mesh, parts[k // n_labels], k % n_labels) for k in kinds.tolist()]
    skin = of_kind[int(np.argmax(kinds // n_labels == parts.index("skin")))]
    for i, number in enumerate((kinds // n_labels).tolist()):
        if parts[number] == _LOWER_LASHES and of_kind[i].picture is None:
            of_kind[i] = _as_skin(skin)
    keys = [(look.colour, id(look.picture)) for look in of_kind]
    first = {key: i for i, key in reversed(list(enumerate(keys)))}
    chosen = sorted(first.values())
    tile = np.array([chosen.index(first[key]) for key in keys])
    return [of_kind[i] for i in chosen], tile[kind_of.reshape(-1)]


def _lower_lashes(
    mesh: OwnMesh,
    vertices: Floats,
    groups: Mapping[str, NDArray[np.int32]],
    eyes: Mapping[str, Eye],
) -> NDArray[np.int32]:
    """Triangles of the shells of lashes whose middle is below the eyes."""
    none = np.zeros(0, np.int32)
    if "lashes" not in groups or not eyes:
        return none
    rows = groups["lashes"]
    below = [none]
    for shell in shells(mesh.triangles[rows], len(vertices)):
        y = vertices[mesh.triangles[rows[shell]]][..., 1]
        if (y.min() + y.max()) / 2 < min(eye.centre[1] for eye in eyes.values()) - _BELOW_MM:
            below.append(rows[shell])
    return np.concatenate(below)


def _as_skin(skin: Look) -> Look:
    """A plain look a little darker than the skin."""
    colour = np.array(skin.colour, dtype=np.float64)
    if skin.picture is not None:
        colour = colour / 255 * skin.picture.reshape(-1, 3).mean(axis=0)
    r, g, b = (round(_DARKER * float(c)) for c in colour)
    return Look((r, g, b))


def _look(mesh: OwnMesh, part: str, label: int) -> Look:
    """What a label's triangles of a part look like; files without any colours get plain ones."""
    given = mesh.looks.get(mesh.labels[label]) if mesh.labels else None
    told = {look.colour for look in mesh.looks.values()} if mesh.looks else set()
    has_pictures = any(look.picture is not None for look in mesh.looks.values())
    says_nothing = given is None or (
        given.picture is None and (len(told) < 2 or given.colour == (255, 255, 255))
    )
    if says_nothing and (part != "skin" or given is None or has_pictures):
        return Look(_PLAIN[part])
    assert given is not None
    return (
        given
        if given.colour != (255, 255, 255) or given.picture is not None
        else Look(_PLAIN[part])
    )


def _eyes_are_plain(mesh: OwnMesh, groups: Mapping[str, NDArray[np.int32]]) -> bool:
    """Whether any layer of an eye lacks a picture: a cornea would hide the iris behind it."""
    rows = [groups[name] for name in ("eye_right", "eye_left") if name in groups]
    if not rows:
        return False
    labels = np.unique(mesh.label_of_triangle[np.concatenate(rows)])
    looks = [mesh.looks.get(mesh.labels[i]) if mesh.labels else None for i in labels]
    return any(look is None or look.picture is None for look in looks)


def _atlas(looks: list[Look]) -> tuple[Picture, list[tuple[int, int, int]]]:
    """All looks in one picture; each tile's left and top pixel and its side."""
    n_pictures = sum(look.picture is not None for look in looks)
    largest = max((max(k.picture.shape[:2]) for k in looks if k.picture is not None), default=0)
    side = min(largest, _ONLY_PX if n_pictures < 2 else _TILE_PX) if n_pictures else _SMALL_PX
    columns = int(np.ceil(np.sqrt(len(looks))))
    n_rows = -(-len(looks) // columns)
    atlas = np.zeros((n_rows * side, columns * side, 3), np.uint8)
    boxes = []
    for i, look in enumerate(looks):
        x, y = (i % columns) * side, (i // columns) * side
        if look.picture is None:
            atlas[y : y + side, x : x + side] = look.colour
        else:
            shrunk = cv2.resize(look.picture, (side, side), interpolation=cv2.INTER_AREA)
            tint = np.array(look.colour) / 255
            atlas[y : y + side, x : x + side] = (shrunk * tint).astype(np.uint8)
        boxes.append((x, y, side))
    return atlas, boxes


def _corner_uv(
    mesh: OwnMesh,
    tile_of: NDArray[np.int64],
    looks: list[Look],
    boxes: list[tuple[int, int, int]],
    shape: tuple[int, ...],
) -> Floats:
    """(F, 3, 2): each corner's place in the atlas."""
    found = np.full((len(mesh.triangles), 3, 2), 0.5)
    if mesh.uv is not None and mesh.uv_triangles is not None:
        found = mesh.uv[mesh.uv_triangles]
        found = found - np.floor(found.min(axis=1, keepdims=True) + 1e-6)  # repeated pictures
    height, width = shape[:2]
    for i, (look, (x, y, side)) in enumerate(zip(looks, boxes, strict=True)):
        rows = tile_of == i
        inside = np.clip(found[rows], 0, 1) if look.picture is not None else 0.5 + 0 * found[rows]
        texel = _INSET + inside * (side - 2 * _INSET)
        u = (x + texel[..., 0]) / width
        v = 1 - (y + side - texel[..., 1]) / height
        found[rows] = np.stack([u, v], axis=-1)
    return found


def _eye_uv(corners: Floats, eye: Eye) -> Floats:
    """(n, 3, 2): places in the painted eye, azimuthal about the eye's axis (straight ahead)."""
    d = corners - eye.centre
    d = d / np.maximum(np.linalg.norm(d, axis=-1, keepdims=True), 1e-9)
    angle = np.arccos(np.clip(d[..., 2], -1, 1))
    radius = np.interp(angle, (0, EYE_FRONT_RAD, np.pi), (0, EYE_FRONT_SHARE, 1.0)) / 2
    length = np.maximum(np.linalg.norm(d[..., :2], axis=-1), 1e-9)
    return np.asarray(0.5 + 0.98 * d[..., :2] * (radius / length)[..., None])
