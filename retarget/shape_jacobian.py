"""What a head's shapes do to its FAPs, and which of them FAPs cannot tell."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.errors import InputError
from ..core.mpeg4 import ANGLE_UNIT_RAD, Fap, fap_by_name, fap_table
from ..heads.head import Head
from .shape_names import ShapeNames, other_side_of, understand_shapes

Floats = NDArray[np.float64]

#: Weights that people act with are about so large (root mean square of those not 0).
WEIGHT_SD = 0.3
#: An eye turns so far under an ``eyeLook`` shape that leaves the eyeball alone.
_USUAL_LOOK_RAD = float(np.deg2rad(30.0))
_LEAST_LOOK_RAD = float(np.deg2rad(2.0))
#: FAPs of what the shapes do not do: eyeballs come forward, pupils, tongue's roll, head.
_NOT_OF_SHAPES = frozenset((1, 2, 27, 28, 29, 30, 47, 48, 49, 50))
_TONGUE = frozenset((43, 44, 45, 46))
#: A FAP that no shape moves by this much, mm, is left out.
_NOTHING_MM = 1e-3
#: A head with so many of ARKit's shapes is driven by them, and its poses stay out of it.
_ENOUGH_SHAPES = 20
#: Never both: one does the opposite of the other. Stems stand for both sides.
_OPPOSITES = (("eyeLookUp", "eyeLookDown"), ("eyeLookIn", "eyeLookOut"))
#: A weight that stays unsure by more than this is said to be unobservable: a third of `WEIGHT_SD`.
UNSURE = 0.1


@dataclass(frozen=True, eq=False)
class ShapeJacobian:
    """FAPs as linear functions of a head's weights.

    Attributes
    ----------
    head : Head
    names : ShapeNames
        Of all shapes of the head.
    shapes : tuple of str, length K
        Those that are solved for, as the head calls them.
    correctives : tuple of str, length C
        Those that come with products of others.
    faps : tuple of Fap, length F
    unit_mm : (F,) float64, mm
        Of a FAP's value 1; of angles: on the eyeball.
    mm : (F, K) float64, mm
        Displacement along each FAP at weight 1.
    corrective_mm : (F, C) float64, mm
    """

    head: Head
    names: ShapeNames
    shapes: tuple[str, ...]
    correctives: tuple[str, ...]
    faps: tuple[Fap, ...]
    unit_mm: Floats
    mm: Floats
    corrective_mm: Floats

    def __post_init__(self) -> None:
        n, k, c = len(self.faps), len(self.shapes), len(self.correctives)
        object.__setattr__(self, "unit_mm", readonly(self.unit_mm, (n,), "unit_mm"))
        object.__setattr__(self, "mm", readonly(self.mm, (n, k), "mm"))
        moved = readonly(self.corrective_mm, (n, c), "corrective_mm")
        object.__setattr__(self, "corrective_mm", moved)

    def arkit(self, shape: str) -> str | None:
        """The ARKit shape that one of `shapes` is, or is a side of; None for poses."""
        meaning = self.names.meanings[shape]
        return next(iter(meaning.amounts)) if meaning.kind in ("arkit", "side") else None

    def closes_eye(self, shape: str) -> bool:
        """Whether one of `shapes` is a blink."""
        return any(n.startswith("eyeBlink") for n in self.names.meanings[shape].amounts)

    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Columns of left shapes and of the same on the right."""
        place = {(self.arkit(s), self.names.meanings[s].side): i for i, s in enumerate(self.shapes)}
        found = []
        for (name, side), i in place.items():
            if name is None or side != "left":
                continue
            is_half = self.names.meanings[self.shapes[i]].kind == "side"
            other = place.get((name if is_half else other_side_of(name), "right"))
            if other is not None:
                found.append((i, other))
        return tuple(found)

    def products(self, weights: Floats) -> Floats:
        """Weights of the correctives, (T, C), from those of the shapes, (T, K)."""
        found = np.ones((len(weights), len(self.correctives)))
        for c, shape in enumerate(self.correctives):
            for name in self.names.meanings[shape].amounts:
                columns = [i for i, s in enumerate(self.shapes) if self.arkit(s) == name]
                found[:, c] *= weights[:, columns].mean(axis=1) if columns else 0.0
        return found

    def weight_sd(self, noise_mm: float | Floats) -> Floats:
        """How unsure weights are that are found from noisy FAPs, (K,).

        The standard deviation of a weight after the FAPs are known, where weights are spread by
        `WEIGHT_SD` before, and of opposite shapes (a look up and a look down) one is not in play.
        """
        noise = np.broadcast_to(np.asarray(noise_mm, dtype=np.float64), (len(self.faps),))
        whitened = self.mm / np.maximum(noise, 1e-9)[:, None]
        found = np.zeros(len(self.shapes))
        index = {self.arkit(s): i for i, s in enumerate(self.shapes)}
        for first in (0, 1):
            absent = {
                index[f"{pair[1 - first]}{side}"]
                for pair in _OPPOSITES
                for side in ("Left", "Right")
                if {f"{stem}{side}" for stem in pair} <= set(index)
            }
            kept = np.array([i for i in range(len(self.shapes)) if i not in absent], dtype=np.intp)
            A = whitened[:, kept]
            C = np.linalg.inv(A.T @ A + np.eye(len(kept)) / WEIGHT_SD**2)
            found[kept] = np.maximum(found[kept], np.sqrt(np.diag(C)))
        return found


def shape_jacobian(head: Head) -> ShapeJacobian:
    """Differentiate a head's FAPs by its shapes' weights.

    ARKit's shapes and halves of them are used; poses (VRM's vowels and moods) only where there are
    few of these.

    Raises
    ------
    InputError
        If the head has no shapes, none with a name that says something, or none that moves a
        feature point.
    """
    names, used, correctives = _used_shapes(head)
    faps = [fap for fap in fap_table() if fap.number not in _NOT_OF_SHAPES]
    faps = [f for f in faps if f.is_rotation or set(f.feature_points) & set(head.points)]
    rows = {name: head.shape_names.index(name) for name in (*used, *correctives)}
    moved = _point_displacements(head, list(rows.values()))
    table = np.stack([_row(head, f, tuple(rows), moved) for f in faps])
    mine = np.abs(table).max(axis=1, initial=0.0) > _NOTHING_MM
    if not mine.any():
        raise InputError(f"the shapes of head {head.name} move none of its feature points")
    faps = [f for f, keep in zip(faps, mine, strict=True) if keep]
    table = table[mine]
    unit_mm = np.array([_unit_mm(head, f) for f in faps])
    k = len(used)
    return ShapeJacobian(
        head, names, used, correctives, tuple(faps), unit_mm, table[:, :k], table[:, k:]
    )


def unobservable_shapes(head: Head, *, noise_mm: float = 0.001) -> tuple[str, ...]:
    """Shapes whose weights FAPs cannot tell: what they move, others of the head move as well.

    From the null space of the Jacobian: weights along it may change without a change of any FAP.
    By noise of 0.001 mm, which is next to nothing, the strict null space is meant; integer FAPs
    are rounded by some 0.01 mm.

    Parameters
    ----------
    head : Head
    noise_mm : float, mm
        Root mean square error of a FAP.

    Returns
    -------
    tuple of str
        As the head calls them: those whose weight stays unsure by more than `UNSURE`.

    Raises
    ------
    InputError
        As `shape_jacobian`.
    """
    jacobian = shape_jacobian(head)
    unsure = jacobian.weight_sd(noise_mm) > UNSURE
    return tuple(name for name, is_so in zip(jacobian.shapes, unsure, strict=True) if is_so)


def _used_shapes(head: Head) -> tuple[ShapeNames, tuple[str, ...], tuple[str, ...]]:
    if head.shapes is None or not head.shape_names:
        raise InputError(
            f"head {head.name} has no shapes: drive it by its feature points (--drive points)"
        )
    names = understand_shapes(head.shape_names)
    single = tuple(n for n, m in names.meanings.items() if m.kind in ("arkit", "side"))
    poses = tuple(n for n, m in names.meanings.items() if m.kind == "pose")
    used = single if len(single) >= _ENOUGH_SHAPES else (*single, *poses)
    if not used:
        raise InputError(
            f"head {head.name} has {len(head.shape_names)} shapes, but no name says what they are: "
            f"{names.unknown_text()[:200]}. Name them as ARKit does (jawOpen, eyeBlinkLeft ...), "
            "or drive the head by its feature points (--drive points)"
        )
    correctives = tuple(
        n
        for n, m in names.meanings.items()
        if m.kind == "corrective" and all(names.of_arkit(part) for part in m.amounts)
    )
    return names, used, correctives


def _point_displacements(head: Head, rows: list[int]) -> dict[str, Floats]:
    """Displacements of the surface's feature points under shapes, (len(rows), 3) mm by id."""
    assert head.shapes is not None
    points = head.feature_points
    offsets = np.asarray(head.shapes[rows][:, points.corners], dtype=np.float64)
    moved = np.einsum("nc,kncx->knx", points.barycentric, offsets)
    return {name: moved[:, i] for i, name in enumerate(points.names)}


def _row(head: Head, fap: Fap, shapes: Iterable[str], moved: dict[str, Floats]) -> Floats:
    """Displacement along a FAP at weight 1 of each shape, mm."""
    if fap.is_rotation:
        return _look_row(head, fap, tuple(shapes))
    assert fap.direction is not None
    point = next(name for name in fap.feature_points if name in moved)
    return np.asarray(moved[point] @ fap.direction)


def _look_row(head: Head, fap: Fap, shapes: tuple[str, ...]) -> Floats:
    """Turns of one eyeball about y (yaw) or x (pitch), mm on its surface."""
    side = "left" if "_l_" in fap.name else "right"
    found = np.zeros(len(shapes))
    if side not in head.eyes:
        return found
    names = understand_shapes(shapes)
    for k, shape in enumerate(shapes):
        meaning = names.meanings[shape]
        if meaning.kind == "corrective":
            continue
        usual = sum(a * _usual_look(n, fap, side) for n, a in meaning.amounts.items())
        if usual:
            turn = look_angles(head, shape, side)[0 if fap.axis.endswith("y") else 1]
            found[k] = (turn if abs(turn) > _LEAST_LOOK_RAD else usual) * head.eyes[side].radius
    return found


def _usual_look(name: str, fap: Fap, side: str) -> float:
    """What an ARKit shape turns an eye by, about the FAP's axis, if nothing else is known; rad."""
    if not name.startswith("eyeLook") or not name.endswith(side.title()):
        return 0.0
    way = name.removeprefix("eyeLook").removesuffix(side.title())
    if fap.axis.endswith("x"):
        return {"Down": _USUAL_LOOK_RAD, "Up": -_USUAL_LOOK_RAD}.get(way, 0.0)
    to_left = {"In": -1.0, "Out": 1.0}.get(way, 0.0)
    return _USUAL_LOOK_RAD * (to_left if side == "left" else -to_left)


def look_angles(head: Head, shape: str, side: str) -> tuple[float, float]:
    """Yaw and pitch by which a shape at weight 1 turns an eyeball, rad; 0, 0 if it leaves it."""
    rows = head.part_vertices(f"eye_{side}")
    if not len(rows) or head.shapes is None:
        return 0.0, 0.0
    arm = head.mesh.vertices[rows] - head.mesh.vertices[rows].mean(axis=0)
    offset = np.asarray(head.shapes[head.shape_names.index(shape), rows], dtype=np.float64)
    to = arm + offset - offset.mean(axis=0)
    U, _, Vt = np.linalg.svd(arm.T @ to)
    R = Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    return float(np.arctan2(R[0, 2], R[2, 2])), float(np.arcsin(np.clip(-R[1, 2], -1, 1)))


def _unit_mm(head: Head, fap: Fap) -> float:
    if fap.is_rotation:
        return ANGLE_UNIT_RAD * head.eyes["left" if "_l_" in fap.name else "right"].radius
    return head.fapu.unit(fap)


def rounding_mm(jacobian: ShapeJacobian) -> Floats:
    """Root mean square error of FAPs that are rounded to whole numbers, (F,) mm."""
    return np.asarray(jacobian.unit_mm / np.sqrt(12.0))


def carried_by_jaw(fap: Fap) -> bool:
    """Whether the jaw moves the FAP's point anyway, so that a value of 0 throughout, as encoders
    write that know nothing, says nothing."""
    return fap.number in _TONGUE or fap.name == fap_by_name()["depress_chin"].name
