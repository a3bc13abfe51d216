"""The tree of nodes in a .glb file: where each mesh stands and how it moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..rigid import quaternion_from_rotation, rotation_from_quaternion
from .glb_document import GlbDocument, Object
from .gltf_animation import Animation
from .gltf_scene import ROOT_NAME
from .gltf_skin import Binding, whole_bindings
from .gltf_write import PIVOT_KEY

_MM_PER_METRE = 1000.0
_IDENTITY = np.eye(4)
_MAX_DEPTH = 1000
#: A part's motion may differ from a rotation by single precision, no more.
_RIGID_TOLERANCE = 1e-4
#: A joint at its pivot and the inverse bind matrix cancel to single precision.
_ROUNDING_MM = 1e-4


@dataclass(frozen=True)
class PlacedMesh:
    """A mesh node and the nodes from the root down to it, itself included.

    Of a mesh that one joint carries, the nodes down to that joint, and how it is bound to it.
    """

    node: int
    chain: tuple[int, ...]
    binding: Binding | None = None


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a part's vertices go, (4, 4) mm, and its motion and joint as in `GltfPart`."""

    head_from_mesh: NDArray[np.float64]
    pivot: NDArray[np.float64]
    rotation: NDArray[np.float64] | None
    translation: NDArray[np.float64] | None
    joint: str | None = None


class NodeTree:
    """The default scene's nodes.

    Attributes
    ----------
    placed : list of PlacedMesh
        In the order of the file's tree.
    animation : Animation
        Of the nodes on the way to a mesh.
    root_pivot : (3,) float64, mm
        Where the moving root stands in the head's frame.
    """

    def __init__(self, document: GlbDocument) -> None:
        self._file = document
        self._joint_parents: dict[int, int] | None = None
        placed, roots = self._walk()
        self.placed = self._bound(placed)
        if any(mesh.binding for mesh in self.placed):  # skinned meshes are roots themselves
            roots = sorted({mesh.chain[0] for mesh in self.placed})
        used = {i for mesh in self.placed for i in (*mesh.chain, mesh.node)}
        self.animation = Animation.read(document, used)
        self.root_pivot = np.zeros(3)
        self._root = self._moving_root(roots)
        if self._root is not None:
            self.root_pivot = self._pivot(self._root)

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

    def _bound(self, placed: list[PlacedMesh]) -> list[PlacedMesh]:
        """Meshes that one joint carries, with the way to that joint."""
        bindings = whole_bindings(self._file, [mesh.node for mesh in placed])
        return [
            PlacedMesh(mesh.node, self.joint_chain(bindings[mesh.node].joint), bindings[mesh.node])
            if mesh.node in bindings
            else mesh
            for mesh in placed
        ]

    def _children(self, index: int) -> Sequence[int]:
        where = f"node {index}"
        children = self._file.array(self._file.item("nodes", index, where), "children", where)
        for child in children:
            self._file.item("nodes", child, where)
        return children

    def _moving_root(self, roots: Sequence[int]) -> int | None:
        """The one node that carries all and moves rigidly, or could: it stands at its pivot."""
        if len(roots) != 1:
            return None
        root = roots[0]
        if "mesh" in self._file.item("nodes", root, "scene") or not self._is_rigid(root):
            return None
        if not self.animation.moves(root):
            rotation, place = self._rest(root)
            stands = np.allclose(place, self._pivot(root), rtol=0, atol=_ROUNDING_MM)
            if not place.any() or not stands or not np.array_equal(rotation, (1, 0, 0, 0)):
                return None
        return root

    def _pivot(self, index: int) -> NDArray[np.float64]:
        """A node's pivot in the head's frame, as our files say it, mm; zero in others."""
        where = f"node {index}, extras"
        return self._file.numbers(self._extras(index), PIVOT_KEY, where, (0, 0, 0))

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
            is_root = index == self._root
            matrix = matrix @ (_shift(self.root_pivot) if is_root else self._local(index, animated))
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
        if not self.root_pivot.any():
            if translation is None and still.any():
                translation = np.tile(still, (self.n_frames, 1))
            return rotation, translation
        return rotation, self._shift_beside_turns(
            rotation, still if translation is None else translation
        )

    def _shift_beside_turns(
        self, rotation: NDArray[np.float64] | None, places: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Translations of the head, (T, 3) mm, from where its pivot goes."""
        turned = self.root_pivot
        if rotation is not None:
            turned = rotation_from_quaternion(rotation) @ self.root_pivot
        found = np.broadcast_to(places - turned, (self.n_frames, 3))
        return None if np.abs(found).max(initial=0.0) < _ROUNDING_MM else found

    @property
    def n_frames(self) -> int:
        """Times at which anything is animated."""
        return len(self.animation.time_s)

    def placement(self, placed: PlacedMesh) -> Placement:
        """How the vertices of a node come into the head's frame and how they move in it."""
        index, binding = placed.chain[-1], placed.binding
        if binding is not None and index == self._root:
            matrix = _snapped(_shift(self.root_pivot) @ binding.joint_from_mesh)
            return Placement(matrix, np.zeros(3), None, None, ROOT_NAME)
        node = self._file.item("nodes", index, "scene")
        is_direct = (
            self._is_rigid(index)
            and np.array_equal(
                self.head_from(placed.chain[:-1], animated=True), _shift(self.root_pivot)
            )
            and (self.animation.moves(index) or PIVOT_KEY in self._extras(index))
        )
        if binding is not None:
            return self._carried(placed, binding, is_direct)
        if "skin" in node:
            return Placement(_IDENTITY, np.zeros(3), None, None)
        if is_direct:
            return self._direct(index)
        return self._composed(self.head_from(placed.chain, animated=True), index)

    def _carried(self, placed: PlacedMesh, binding: Binding, is_direct: bool) -> Placement:
        """A mesh that goes with one joint."""
        joint = placed.chain[-1]
        name = self._file.name_of(self._file.item("nodes", joint, "skin"), "")
        if is_direct:
            found = self._direct(joint)
            is_ours = PIVOT_KEY in self._extras(joint) and name != ROOT_NAME
        else:
            moved = self.head_from(placed.chain, animated=True) @ binding.joint_from_mesh
            found = self._composed(moved, placed.node)
            is_ours = len(placed.chain) == 1 and name == ROOT_NAME and found.rotation is None
            return replace(found, joint=name if is_ours else None)
        head_from_mesh = _snapped(found.head_from_mesh @ binding.joint_from_mesh)
        return replace(
            found, head_from_mesh=head_from_mesh, joint=name if is_ours and name else None
        )

    def _extras(self, index: int) -> Object:
        node = self._file.item("nodes", index, "scene")
        extras = node.get("extras")
        return extras if isinstance(extras, dict) else {}

    def _direct(self, index: int) -> Placement:
        """A rigid child of the head, kept as it is: our own files."""
        still_rotation, still = self._rest(index)
        rotation = self.animation.rotation(index)
        translation = self.animation.translation(index)
        still = still + self.root_pivot
        if translation is not None:
            translation = translation + self.root_pivot
        pivot = self._file.numbers(
            self._extras(index), PIVOT_KEY, f"node {index}, extras", tuple(still)
        )
        if translation is None:  # then the node stands at its pivot
            pivot = pivot if np.allclose(pivot, still, rtol=1e-6, atol=_ROUNDING_MM) else still
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
            return Placement(_snapped(head_from_node), np.zeros(3), None, None)
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


def _shift(by: NDArray[np.float64]) -> NDArray[np.float64]:
    """A (4, 4) translation."""
    found = _IDENTITY.copy()
    found[:3, 3] = by
    return found


def _snapped(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The identity where a matrix is that but for single precision."""
    return _IDENTITY if np.allclose(matrix, _IDENTITY, rtol=0, atol=_ROUNDING_MM) else matrix
