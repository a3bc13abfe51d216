"""What a .glb file of ours holds: parts with blendshapes under one moving head."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import readonly
from ..mesh import Mesh, vertex_normals
from ..rigid import rotation_from_quaternion
from ..time_base import checked_times

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
#: Name of the node that carries the head's motion and all parts; as a joint: the head's.
ROOT_NAME = "head"
_WHITE = (1.0, 1.0, 1.0, 1.0)
#: Lengths this near to 1 are left alone, so that what was stored in single precision stays as is.
_UNIT = 1e-6
#: A pivot that moves less than this, mm, stays: single precision at a metre is 6e-5.
_STILL_MM = 1e-4


@dataclass(frozen=True, eq=False)
class MorphTarget:
    """One blendshape: where the vertices it moves go at weight 1.

    Attributes
    ----------
    name : str
    rows : (n,) int32
        Vertices that move, strictly increasing; may be empty.
    offsets : (n, 3) float64, mm
    normal_offsets : (n, 3) float64 or None
        What is added to the unit normals.
    """

    name: str
    rows: NDArray[np.int32]
    offsets: NDArray[np.float64]
    normal_offsets: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        rows = readonly(self.rows, (None,), "rows", np.int32)
        if len(rows) and (rows[0] < 0 or not (np.diff(rows) > 0).all()):
            raise ValueError(f"rows of {self.name} must be 0 or more and strictly increasing")
        shape = (len(rows), 3)
        object.__setattr__(self, "rows", rows)
        object.__setattr__(self, "offsets", _finite(self.offsets, shape, f"{self.name}: offsets"))
        if self.normal_offsets is not None:
            normals = _finite(self.normal_offsets, shape, f"{self.name}: normal_offsets")
            object.__setattr__(self, "normal_offsets", normals)


@dataclass(frozen=True, eq=False)
class GltfPart:
    """One mesh with its material, its blendshapes and its motion relative to the head.

    A vertex is found at ``pivot + translation + R(rotation) (vertex - pivot)`` in the head's frame.

    Attributes
    ----------
    name : str
    vertices : (V, 3) float64, mm, head frame
    triangles : (F, 3) int32
        Counter-clockwise seen from outside.
    normals : (V, 3) float64
        Made unit length; (0, 0, 1) where zero was given (a vertex without triangles).
    uv : (V, 2) float64 or None
        Origin at the bottom left, as in `Mesh`; the file's is at the top left.
    base_color : (4,) float64
        Linear red, green, blue, alpha in 0..1; multiplies the texture.
    texture_png : bytes or None
        Needs `uv`.
    normal_png : bytes or None
        Tangent-space normal map, green up; needs `uv`.
    roughness_png : bytes or None
        Roughness in the green channel, metalness (0) in the blue; multiplied by `roughness`. Needs
        `uv`.
    roughness : float, 0..1
    double_sided : bool
    targets : tuple of MorphTarget
        Names differ; all have normal offsets or none has.
    weights : (T, n_targets) float64 or None
        None: at rest (zero) throughout.
    rotation : (T, 4) float64, w x y z, or None
        Made unit length, and continuous in sign.
    translation : (T, 3) float64, mm, or None
    pivot : (3,) float64, mm, head frame
    joint : str or None
        Bind the part to a joint of this name, which makes its motion; parts of one joint have the
        same. ``"head"``: the head's own joint, for parts without a motion. None: the part's own
        node moves.
    """

    name: str
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64] | None = None
    base_color: NDArray[np.float64] = field(default_factory=lambda: np.array(_WHITE))
    texture_png: bytes | None = None
    normal_png: bytes | None = None
    roughness_png: bytes | None = None
    roughness: float = 0.6
    double_sided: bool = False
    targets: tuple[MorphTarget, ...] = ()
    weights: NDArray[np.float64] | None = None
    rotation: NDArray[np.float64] | None = None
    translation: NDArray[np.float64] | None = None
    pivot: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    joint: str | None = None

    def __post_init__(self) -> None:
        vertices = _finite(self.vertices, (None, 3), "vertices")
        n = len(vertices)
        triangles = readonly(self.triangles, (None, 3), "triangles", np.int32)
        if not n or not len(triangles):
            raise ValueError(f"part {self.name} has no vertices or no triangles")
        if triangles.min() < 0 or triangles.max() >= n:
            raise ValueError(f"triangles of {self.name} must lie in 0..{n - 1}")
        color = _finite(self.base_color, (4,), "base_color")
        if color.min() < 0 or color.max() > 1 or not 0 <= self.roughness <= 1:
            raise ValueError("base_color and roughness must lie in 0..1")
        checked = {
            "vertices": vertices,
            "triangles": triangles,
            "normals": readonly(unit_normals(_finite(self.normals, (n, 3), "normals")), (n, 3), ""),
            "uv": None if self.uv is None else _finite(self.uv, (n, 2), "uv"),
            "base_color": color,
            "targets": tuple(self.targets),
            "pivot": _finite(self.pivot, (3,), "pivot"),
            **_motion(self.rotation, self.translation),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        is_moved = self.rotation is not None or self.translation is not None
        if self.joint is not None and (not self.joint or (self.joint == ROOT_NAME and is_moved)):
            raise ValueError(f"part {self.name} moves by itself: it needs a joint of its own")
        self._check_textures()
        self._check_targets()

    def _check_textures(self) -> None:
        for kind in ("texture_png", "normal_png", "roughness_png"):
            data = getattr(self, kind)
            if data is None:
                continue
            if self.uv is None:
                raise ValueError(f"part {self.name} has a texture but no uv")
            if not data.startswith(PNG_SIGNATURE):
                raise ValueError(f"{kind} of {self.name} is not a PNG file")

    def _check_targets(self) -> None:
        names = [target.name for target in self.targets]
        if len(set(names)) != len(names):
            raise ValueError(f"blendshape names of {self.name} must differ")
        if len({target.normal_offsets is None for target in self.targets}) > 1:
            raise ValueError(f"all blendshapes of {self.name} have normal offsets, or none has")
        for target in self.targets:
            if len(target.rows) and target.rows[-1] >= len(self.vertices):
                raise ValueError(f"blendshape {target.name} moves vertex {target.rows[-1]}")
        if self.weights is not None:
            if not self.targets:
                raise ValueError(f"part {self.name} has weights but no targets")
            weights = _finite(self.weights, (None, len(names)), "weights")
            object.__setattr__(self, "weights", weights)


@dataclass(frozen=True, eq=False)
class GltfScene:
    """A head that moves.

    Attributes
    ----------
    name : str
    parts : tuple of GltfPart
        At least one; names differ.
    time_s : (T,) float64, s
        Times of all animated values, from the first frame: a first time other than 0 is subtracted.
        Empty: a scene that does not move.
    root_rotation : (T, 4) float64, w x y z, world from head, or None
    root_translation : (T, 3) float64, mm, world frame, or None
    extras : mapping from str to str
        Whatever should travel with the file.
    root_pivot : (3,) float64, mm, head frame
        Where the head's node stands, such as the neck's pivot. It changes no motion, only how the
        file says it: about a pivot that stays, by rotation alone.
    """

    name: str
    parts: tuple[GltfPart, ...]
    time_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    root_rotation: NDArray[np.float64] | None = None
    root_translation: NDArray[np.float64] | None = None
    extras: Mapping[str, str] = field(default_factory=dict)
    root_pivot: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        parts = tuple(self.parts)
        names = [part.name for part in parts]
        if not parts or len(set(names)) != len(names):
            raise ValueError("a scene needs at least one part, and their names must differ")
        times = checked_times(self.time_s)
        times = checked_times(times - times[:1]) if len(times) else times
        root = _motion(self.root_rotation, self.root_translation)
        animated = {"root_rotation": root["rotation"], "root_translation": root["translation"]}
        for name, value in animated.items():
            object.__setattr__(self, name, value)
        for part in parts:
            for what in ("weights", "rotation", "translation"):
                animated[f"{what} of {part.name}"] = getattr(part, what)
        for what, value in animated.items():
            if value is not None and (len(value) != len(times) or not len(times)):
                raise ValueError(f"{what} has {len(value)} frames, time_s {len(times)}")
        _check_joints(parts)
        object.__setattr__(self, "parts", parts)
        object.__setattr__(self, "time_s", times)
        object.__setattr__(self, "extras", MappingProxyType(dict(self.extras)))
        object.__setattr__(self, "root_pivot", _finite(self.root_pivot, (3,), "root_pivot"))

    def root_places(self) -> NDArray[np.float64] | None:
        """Where `root_pivot` goes in the world, (T, 3) mm; None if it stays where it is."""
        pivot, found = self.root_pivot, self.root_translation
        if self.root_rotation is not None and pivot.any():
            turned = rotation_from_quaternion(self.root_rotation) @ pivot
            found = turned if found is None else turned + found
            stays = np.abs(found - pivot).max(initial=0.0) < _STILL_MM
            return None if stays else found
        return None if found is None else found + pivot


def unweld(mesh: Mesh) -> tuple[NDArray[np.int32], GltfPart]:
    """A mesh as a part, its vertices doubled where texture seams run.

    Returns
    -------
    rows : (V,) int32
        The mesh's vertex that each vertex of the part is a copy of: blendshapes and normals go
        through it (``offsets[rows]``).
    part : GltfPart
        Named "mesh", with normals that are smooth across the seams; see `dataclasses.replace`.
    """
    normals = vertex_normals(mesh.vertices, mesh.triangles)
    if mesh.uv is None or mesh.uv_triangles is None:
        rows = np.arange(len(mesh.vertices), dtype=np.int32)
        return rows, GltfPart("mesh", mesh.vertices, mesh.triangles, normals)
    corners = np.stack([mesh.triangles.ravel(), mesh.uv_triangles.ravel()], axis=1)
    pairs, corner_to_pair = np.unique(corners, axis=0, return_inverse=True)
    rows = np.asarray(pairs[:, 0], dtype=np.int32)
    triangles = corner_to_pair.reshape(-1, 3).astype(np.int32)
    uv = mesh.uv[pairs[:, 1]]
    return rows, GltfPart("mesh", mesh.vertices[rows], triangles, normals[rows], uv)


def _check_joints(parts: tuple[GltfPart, ...]) -> None:
    """Parts of one joint must move alike."""
    first: dict[str, GltfPart] = {}
    for part in parts:
        if part.joint is None or part.joint == ROOT_NAME:
            continue
        other = first.setdefault(part.joint, part)
        for what in ("pivot", "rotation", "translation"):
            a, b = getattr(part, what), getattr(other, what)
            if (a is None) != (b is None) or (a is not None and not np.array_equal(a, b)):
                raise ValueError(
                    f"{other.name} and {part.name} share joint {part.joint}: one {what}"
                )


def unit_normals(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of (V, 3) at unit length; (0, 0, 1) for rows without a length."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    has_length = length > 1e-12
    unit = np.divide(normals, length, out=np.zeros_like(normals), where=has_length)
    unit = np.where(np.abs(length - 1) < _UNIT, normals, unit)
    return np.where(has_length, unit, (0.0, 0.0, 1.0))


def _motion(
    rotation: ArrayLike | None, translation: ArrayLike | None
) -> dict[str, NDArray[np.float64] | None]:
    return {
        "rotation": None if rotation is None else _continuous(rotation),
        "translation": (
            None if translation is None else _finite(translation, (None, 3), "translation")
        ),
    }


def _continuous(quaternions: ArrayLike) -> NDArray[np.float64]:
    """Unit quaternions, each with the sign that is nearer to the one before."""
    q = _finite(quaternions, (None, 4), "rotation")
    length = np.linalg.norm(q, axis=1, keepdims=True)
    if (length < 1e-6).any():
        raise ValueError("rotation must hold quaternions with a length above 0")
    q = np.where(np.abs(length - 1) < _UNIT, q, q / length)
    turns = np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    sign = np.concatenate([np.ones(min(1, len(q))), np.cumprod(turns)])
    return readonly(q * sign[:, None], (None, 4), "rotation")


def _finite(value: ArrayLike, shape: tuple[int | None, ...], name: str) -> NDArray[np.float64]:
    array: NDArray[np.float64] = readonly(value, shape, name)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite: fill or cut what is missing before the export")
    return array
