"""The tree of nodes in a .glb file: where each mesh stands and how it moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..rigid import quaternion_from_rotation, rotation_from_quaternion
from .glb_document import GlbDocument, Object
from .gltf_animation import Animation
from .gltf_write import PIVOT_KEY

_MM_PER_METRE = 1000.0
_IDENTITY = np.eye(4)
_MAX_DEPTH = 1000
#: A part's motion may differ from a rotation by single precision, no more.
_RIGID_TOLERANCE = 1e-4


@dataclass(frozen=True)
class PlacedMesh:
    """A mesh node and the nodes from the root down to it, itself included."""

    node: int
    chain: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a part's vertices go, (4, 4) mm, and its motion as in `GltfPart`."""

    head_from_mesh: NDArray[np.float64]
    pivot: NDArray[np.float64]
    rotation: NDArray[np.float64] | None
    translation: NDArray[np.float64] | None


class NodeTree:
    """The default scene's nodes.

    Attributes
    ----------
    placed : list of PlacedMesh
        In the order of the file's tree.
    animation : Animation
        Of the nodes on the way to a mesh.
    """

    def __init__(self, document: GlbDocument) -> None:
        self._file = document
        self.placed, roots = self._walk()
        used = {i for placed in self.placed for i in placed.chain}
        self.animation = Animation.read(document, used)
        self._root = self._moving_root(roots)
        self._joint_parents: dict[int, int] | None = None

    def scene_object(self) -> Object:
        """The default scene; empty where the file has none."""
        if not self._file.array(self._file.root, "scenes", "document"):
            return {}
        return self._file.item("scenes", self._file.root.get("scene", 0), "document")

    def _walk(self) -> tuple[list[PlacedMesh], list[int]]:
        """The mesh nodes of the scene in the order of the file's tree, and its roots."""
        file = self._file
        nodes = file.array(file.root, "nodes", "document")
        roots = file.array(self.scene_object(), "nodes", "scene")
        if not file.array(file.root, "scenes", "document"):
            children = {c for i in range(len(nodes)) for c in self._children(i)}
            roots = [i for i in range(len(nodes)) if i not in children]
        found: list[PlacedMesh] = []
        seen: set[int] = set()
        stack: list[tuple[int, tuple[int, ...]]] = [(i, ()) for i in reversed(roots)]
        while stack:
            index, above = stack.pop()
            node = file.item("nodes", index, "scene")
            if index in seen or len(above) > _MAX_DEPTH:
                file.fail(f"node {index}", "nodes that form a tree", "a node that is met twice")
            seen.add(index)
            chain = (*above, index)
            if "mesh" in node:
                found.append(PlacedMesh(index, chain))
            stack.extend((child, chain) for child in reversed(self._children(index)))
        return found, [int(i) for i in roots]

    def _children(self, index: int) -> Sequence[int]:
        where = f"node {index}"
        children = self._file.array(self._file.item("nodes", index, where), "children", where)
        for child in children:
            self._file.item("nodes", child, where)
        return children

    def _moving_root(self, roots: Sequence[int]) -> int | None:
        """The one node that carries all and moves rigidly, if there is one."""
        if len(roots) != 1 or not self.animation.moves(roots[0]):
            return None
        node = self._file.item("nodes", roots[0], "scene")
        return None if "mesh" in node or not self._is_rigid(roots[0]) else roots[0]

    def _is_rigid(self, index: int) -> bool:
        node = self._file.item("nodes", index, "scene")
        scale = self._file.numbers(node, "scale", f"node {index}", (1, 1, 1))
        return "matrix" not in node and bool((scale == 1).all())

    def _rest(self, index: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A node's rotation (w x y z) and translation (mm) at rest."""
        node, where = self._file.item("nodes", index, "scene"), f"node {index}"
        xyzw = self._file.numbers(node, "rotation", where, (0, 0, 0, 1))
        if not np.linalg.norm(xyzw) > 1e-6:
            self._file.fail(where, "a rotation of unit length", xyzw)
        translation = self._file.numbers(node, "translation", where, (0, 0, 0))
        return np.roll(xyzw, 1), translation * _MM_PER_METRE

    def _local(self, index: int, animated: bool) -> NDArray[np.float64]:
        """parent_from_node, (4, 4) at rest or (T, 4, 4) where the node moves; mm."""
        node, where = self._file.item("nodes", index, "scene"), f"node {index}"
        if "matrix" in node:
            columns = self._file.numbers(node, "matrix", where, tuple(_IDENTITY.ravel()))
            matrix = columns.reshape(4, 4).T.copy()
            matrix[:3, 3] *= _MM_PER_METRE
            return matrix
        rotation, translation = self._rest(index)
        if animated:
            moving = self.animation.rotation(index)
            rotation = rotation if moving is None else moving
            moving = self.animation.translation(index)
            translation = translation if moving is None else moving
        scale = self._file.numbers(node, "scale", where, (1, 1, 1))
        linear = rotation_from_quaternion(rotation) * scale
        n = max(linear.size // 9, translation.size // 3)
        self._file.spend(16 * n, where)
        matrix = np.tile(_IDENTITY, (n, 1, 1))
        matrix[:, :3, :3], matrix[:, :3, 3] = linear, translation
        return matrix if animated and self.animation.moves(index) else matrix[0]

    def head_from(self, chain: Sequence[int], *, animated: bool) -> NDArray[np.float64]:
        """From the last node of a chain to what the moving root carries."""
        matrix = _IDENTITY
        for index in chain:
            if index != self._root:
                matrix = matrix @ self._local(index, animated)
        return matrix

    def root_motion(self) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
        """Rotation (T, 4) w x y z and translation (T, 3) mm of what carries all, or None."""
        if self._root is None:
            return None, None
        still_rotation, still = self._rest(self._root)
        rotation = self.animation.rotation(self._root)
        translation = self.animation.translation(self._root)
        if rotation is None and not np.array_equal(still_rotation, (1, 0, 0, 0)):
            rotation = np.tile(still_rotation, (self.n_frames, 1))
        if translation is None and still.any():
            translation = np.tile(still, (self.n_frames, 1))
        return rotation, translation

    @property
    def n_frames(self) -> int:
        """Times at which anything is animated."""
        return len(self.animation.time_s)

    def placement(self, placed: PlacedMesh) -> Placement:
        """How the vertices of a node come into the head's frame and how they move in it."""
        index = placed.node
        node = self._file.item("nodes", index, "scene")
        is_direct = (
            self._is_rigid(index)
            and np.array_equal(self.head_from(placed.chain[:-1], animated=True), _IDENTITY)
            and (self.animation.moves(index) or PIVOT_KEY in self._extras(index))
        )
        if "skin" in node:
            return Placement(_IDENTITY, np.zeros(3), None, None)
        if is_direct:
            return self._direct(index)
        return self._composed(self.head_from(placed.chain, animated=True), index)

    def _extras(self, index: int) -> Object:
        node = self._file.item("nodes", index, "scene")
        extras = node.get("extras")
        return extras if isinstance(extras, dict) else {}

    def _direct(self, index: int) -> Placement:
        """A rigid child of the head, kept as it is: our own files."""
        still_rotation, still = self._rest(index)
        rotation = self.animation.rotation(index)
        translation = self.animation.translation(index)
        pivot = self._file.numbers(
            self._extras(index), PIVOT_KEY, f"node {index}, extras", tuple(still)
        )
        if translation is None:  # then the node stands at its pivot
            pivot = pivot if np.allclose(pivot, still, rtol=1e-6, atol=1e-6) else still
        else:
            translation = translation - pivot
        matrix = _IDENTITY.copy()
        matrix[:3, 3] = pivot
        if rotation is None:
            matrix[:3, :3] = rotation_from_quaternion(still_rotation)
        return Placement(matrix, pivot, rotation, translation)

    def _composed(self, head_from_node: NDArray[np.float64], index: int) -> Placement:
        """Any chain of nodes: its first pose goes into the vertices, the rest must be rigid."""
        if head_from_node.ndim == 2:
            return Placement(head_from_node, np.zeros(3), None, None)
        first = head_from_node[0]
        if abs(np.linalg.det(first[:3, :3])) < 1e-12:
            self._file.fail(f"node {index}", "a scale above 0", "a mesh squeezed flat")
        turn = head_from_node[:, :3, :3] @ np.linalg.inv(first[:3, :3])
        off = np.abs(turn @ np.swapaxes(turn, 1, 2) - np.eye(3)).max()
        if off > _RIGID_TOLERANCE:
            self._file.fail(f"node {index}", "an animation without shear", f"{off:.2g} of it")
        moved = head_from_node[:, :3, 3]
        return Placement(first, moved[0], quaternion_from_rotation(turn), moved - moved[0])

    def joint_chain(self, joint: object) -> tuple[int, ...]:
        """The nodes from a root down to a joint."""
        self._file.item("nodes", joint, "skin")
        if self._joint_parents is None:
            n = len(self._file.array(self._file.root, "nodes", "document"))
            self._joint_parents = {c: i for i in range(n) for c in self._children(i)}
        assert isinstance(joint, int)
        chain = [joint]
        while chain[-1] in self._joint_parents:
            chain.append(self._joint_parents[chain[-1]])
            if len(chain) > _MAX_DEPTH:
                self._file.fail("skin", "nodes that form a tree", "a circle")
        return tuple(reversed(chain))
