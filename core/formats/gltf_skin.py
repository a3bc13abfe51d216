"""Joints in .glb files: parts bound as a whole to one joint of a skeleton.

The skeleton is the head's node with the other joints (jaw, eyes) below it. A part's vertices stay
in the head's frame, and the inverse bind matrix of its joint takes the joint's pivot off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .glb_document import GlbDocument, Object
from .gltf_scene import ROOT_NAME, GltfPart, GltfScene

_MM_PER_METRE = 1000.0
#: Shares of one joint in a vertex this near to 1 are the whole.
_WHOLE = 1e-3


@dataclass(frozen=True, eq=False)
class Skeleton:
    """The joints of a scene.

    Attributes
    ----------
    parts : tuple of GltfPart
        For each joint below the head's a part that it moves: it has the joint's motion.
    is_used : bool
        Whether any part is bound to a joint.
    root_pivot : (3,) float64, mm, head frame
        Where the head's joint stands.
    """

    parts: tuple[GltfPart, ...]
    is_used: bool
    root_pivot: NDArray[np.float64]

    @classmethod
    def of(cls, scene: GltfScene) -> Skeleton:
        """A scene's skeleton, its joints in the order of the parts."""
        found: dict[str, GltfPart] = {}
        for part in scene.parts:
            if part.joint is not None and part.joint != ROOT_NAME:
                found.setdefault(part.joint, part)
        is_used = any(part.joint is not None for part in scene.parts)
        return cls(tuple(found.values()), is_used, scene.root_pivot)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all joints: the head's first."""
        return (ROOT_NAME, *(str(part.joint) for part in self.parts))

    def index(self, part: GltfPart) -> int | None:
        """Which joint a part is bound to; None if to none."""
        return None if part.joint is None else self.names.index(part.joint)

    def inverse_binds(self) -> NDArray[np.float64]:
        """(J, 16): what takes each joint's pivot off, columns one after the other, metres."""
        found = np.tile(np.eye(4), (len(self.names), 1, 1))
        for j, pivot in enumerate([self.root_pivot, *(part.pivot for part in self.parts)]):
            found[j, 3, :3] = -pivot / _MM_PER_METRE
        return found.reshape(-1, 16)


@dataclass(frozen=True, eq=False)
class Binding:
    """A mesh that one joint carries as a whole.

    Attributes
    ----------
    joint : int
        Its node.
    joint_from_mesh : (4, 4) float64, mm
        The inverse bind matrix.
    """

    joint: int
    joint_from_mesh: NDArray[np.float64]


def whole_bindings(file: GlbDocument, mesh_nodes: list[int]) -> dict[int, Binding]:
    """The joint of each skinned node of `mesh_nodes`.

    Empty if any of them is bound to more than one joint: then none is moved, so that parts that
    belong together do not come apart.
    """
    found: dict[int, Binding] = {}
    for node in mesh_nodes:
        if "skin" not in file.item("nodes", node, "scene"):
            continue
        bound = _binding(file, node)
        if bound is None:
            return {}
        found[node] = bound
    return found


def _binding(file: GlbDocument, node: int) -> Binding | None:
    holder = file.item("nodes", node, "scene")
    skin = file.item("skins", holder["skin"], f"node {node}")
    joints = file.array(skin, "joints", "skin")
    where = f"mesh {holder.get('mesh')}"
    mesh = file.item("meshes", holder.get("mesh"), f"node {node}")
    used: set[int] = set()
    for primitive in file.array(mesh, "primitives", where):
        if not isinstance(primitive, dict):
            return None
        joint = _only_joint(file, file.member(primitive, "attributes", where), where)
        if joint is None or joint >= len(joints):
            return None
        used.add(joint)
    if len(used) != 1:
        return None
    index = used.pop()
    file.item("nodes", joints[index], "skin")
    matrix = np.eye(4)
    if "inverseBindMatrices" in skin:
        stored = file.accessor(skin["inverseBindMatrices"], ("MAT4",), "skin", len(joints))
        matrix = stored.reshape(-1, 4, 4)[index].T.copy()
        matrix[:3, 3] *= _MM_PER_METRE
    return Binding(int(joints[index]), matrix)


def _only_joint(file: GlbDocument, attributes: Object, where: str) -> int | None:
    """The joint that has all of every vertex; None if there is none."""
    if "JOINTS_0" not in attributes or "WEIGHTS_0" not in attributes or "JOINTS_1" in attributes:
        return None
    corners = file.accessor(attributes["JOINTS_0"], ("VEC4",), where, integers=True)
    shares = file.accessor(attributes["WEIGHTS_0"], ("VEC4",), where)
    if not len(corners) or corners.shape != shares.shape or not (shares >= 0).all():
        return None
    first = int(corners[0, int(shares[0].argmax())])
    total = shares.sum(axis=1)
    of_first = np.where(corners == first, shares, 0.0).sum(axis=1)
    return first if (total > 0).all() and (of_first > (1 - _WHOLE) * total).all() else None
