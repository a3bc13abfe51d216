"""How synthetic faces move: sculpted shapes with a jaw, eyes, lids and lips of their own."""

from __future__ import annotations

from collections.abc import Mapping

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.errors import InputError
from ..core.rigid import Rigid
from ..heads.head import Head
from ..heads.template import load_template
from .jaw_motion import JAW_SHAPES, JawMotion, add_jaw, jaw_skin, smooth_min
from .lid_motion import BROW_SQUINTS, CHEEK_SQUINTS, LidMotion, LidWeights
from .lip_motion import LipMotion

Floats = NDArray[np.float64]
SIDES = ("right", "left")
#: Where skin that moves ends, on the template: from whole to nothing upwards, and backwards above
#: the ears.
_CROWN_MM, _ABOVE_EARS_MM, _TEMPLE_MM = (58.0, 78.0), (5.0, 20.0), (-38.0, -12.0)
#: Gaze at weight 1, rad.
LOOK_SIDE_RAD, LOOK_UP_RAD, LOOK_DOWN_RAD = np.deg2rad((35.0, 25.0, 30.0))
#: Shapes that press the lips together; each side of a pair asks for half.
CLOSING_GESTURES: Mapping[str, tuple[str, ...]] = {
    "press": ("mouthPressLeft", "mouthPressRight"),
    "roll": ("mouthRollLower", "mouthRollUpper"),
    "smile": ("mouthSmileLeft", "mouthSmileRight"),
    "dimple": ("mouthDimpleLeft", "mouthDimpleRight"),
    "frown": ("mouthFrownLeft", "mouthFrownRight"),
    "stretch": ("mouthStretchLeft", "mouthStretchRight"),
    "shrug": ("mouthShrugLower", "mouthShrugUpper"),
    "left": ("mouthLeft",),
    "right": ("mouthRight",),
    "pucker": ("mouthPucker",),
    "puff": ("cheekPuff",),
}


def _loose_skin(on_template: Floats) -> Floats:
    """How far the skin moves over the skull, (V,): 1 on the face, 0 on crown and upper temples.

    The sculpted brows reach up there and shift it by some tenths of a millimetre, against what
    muscles do: nothing pulls there.
    """

    def fade(value: Floats, low: float, high: float) -> Floats:
        s = np.clip((value - low) / (high - low), 0, 1)
        return np.asarray(s * s * (3 - 2 * s))

    _, y, z = on_template.T
    crown = 1 - fade(y, *_CROWN_MM)
    temple = 1 - fade(y, *_ABOVE_EARS_MM) * (1 - fade(z, *_TEMPLE_MM))
    return np.asarray(crown * temple)


class FaceMotion:
    """Moves a built-in head under ARKit weights, as real faces move.

    With rest vertices x, sculpted offsets Δ, shares s of the mandible's rigid motion J
    (`JawMotion`) and weights w,

        x' = x + Σ wᵢ Δᵢ + [J(s; open, forward, left) − x] − m [J(s; c) − x]

    where Δ of the jaw's shapes is what is left of them beside the motion they were sculpted with,
    and c is the smooth minimum of ``jawOpen`` and ``mouthClose``: the latter takes opening back, by
    a share m, as far as it goes. Then the lips touch (`LipMotion`), the eyeballs turn about their
    centres, and the lids slide over them (`LidMotion`). Lower teeth and tongue are rigid with the
    mandible, but for ``tongueOut``. All is C1 in the weights, and exactly x where they are 0.

    Parameters
    ----------
    head : Head
        Of the built-in topology, with its sculpted shapes.

    Raises
    ------
    InputError
        If the head is not a built-in one.
    """

    def __init__(self, head: Head) -> None:
        template = load_template()
        if head.shapes is None or not np.array_equal(head.mesh.triangles, template.triangles):
            raise InputError(
                f"head {head.name} cannot act: its mesh is not that of the built-in heads "
                "(make it with heads.identity.make_head)"
            )
        missing = [n for n in template.arkit_names if n not in head.shape_names]
        if missing:
            raise InputError(f"head {head.name} cannot act: it lacks the shape {missing[0]}")
        self.head = head
        self._rest = np.array(head.mesh.vertices)
        self._jaw = JawMotion(head)
        self._skin = jaw_skin()
        self._index = {n: i for i, n in enumerate(head.shape_names)}
        self._lower = np.concatenate([head.part_vertices(p) for p in ("teeth_lower", "tongue")])
        self._balls = {side: head.part_vertices(f"eye_{side}") for side in SIDES}
        self._lids = {side: LidMotion(head, side) for side in SIDES}
        self._shapes = _SparseShapes(self._linear_shapes())
        self._lips = LipMotion(head)
        self._calibrate_lips()

    def _linear_shapes(self) -> Floats:
        """What is left of the sculpted shapes, (N, V, 3) mm, in the head's order."""
        assert self.head.shapes is not None
        found = np.array(self.head.shapes, dtype=np.float64)
        template = load_template()
        sculpted = template.arkit[template.arkit_names.index("jawOpen")]
        opens = found[self._index["jawOpen"]]
        size = float(np.linalg.norm(opens) / np.linalg.norm(sculpted))  # of a child, below 1
        for i, name in enumerate(JAW_SHAPES):
            found[self._index[name]] = size * self._skin.residual[i]
        for part in ("teeth_upper", "teeth_lower", "eye_right", "eye_left"):
            found[:, self.head.part_vertices(part)] = 0.0
        for name, row in self._index.items():
            if name.startswith(("eyeBlink", "eyeWide", "eyeLook")):
                found[row] = 0.0
        for lids in self._lids.values():  # lids move over the globe alone
            h = lids.layout.share
            found[:, lids.rows] *= (1 - h * h * (3 - 2 * h))[:, None]
        return found * _loose_skin(template.vertices)[:, None]

    def vertices(self, weights: ArrayLike, *, gaze: ArrayLike | None = None) -> Floats:
        """The face under weights.

        Parameters
        ----------
        weights : (N,) float, in [0, 1]
            Of the head's shapes, in the order of ``head.shape_names``.
        gaze : (2, 2) float, rad, optional
            Where the eyes look, in place of the eyeLook weights: rows right, left; columns yaw
            (positive to the subject's left) and pitch (positive down).

        Returns
        -------
        (V, 3) float64, mm, head frame
        """
        w = self._checked(weights)
        looks = self.gaze(w) if gaze is None else np.asarray(gaze, dtype=np.float64)
        if looks.shape != (2, 2) or not np.isfinite(looks).all():
            raise ValueError(f"gaze must be (2, 2) finite angles, got {looks.shape}")
        found = self._without_contact(w)
        self._lips.touch(found, self._closing(w), self.jaw_pose(w))
        for side, ball in self._balls.items():
            pose = self._eye_pose(side, looks[SIDES.index(side)])
            lid_weights = self._lid_weights(side, w, float(looks[SIDES.index(side), 1]))
            self._lids[side].move(found, lid_weights, pose.rotation)
            found[ball] = pose.apply(self._rest[ball])
        return found

    def jaw_pose(self, weights: ArrayLike) -> Rigid:
        """The mandible's motion from rest, head frame."""
        return self._jaw.pose(*self._jaw_weights(self._checked(weights)))

    def gaze(self, weights: ArrayLike) -> Floats:
        """Angles of the eyes, (2, 2) rad: rows right, left; columns yaw (left) and pitch (down)."""
        w = self._checked(weights)
        found = np.empty((2, 2))
        for row, side in enumerate(("Right", "Left")):
            inward, out, up, down = (
                w[self._index[f"eyeLook{d}{side}"]] for d in ("In", "Out", "Up", "Down")
            )
            to_left = (inward - out) if side == "Right" else (out - inward)
            found[row] = LOOK_SIDE_RAD * to_left, LOOK_DOWN_RAD * down - LOOK_UP_RAD * up
        return found

    def rigid_parts(
        self, weights: ArrayLike, *, gaze: ArrayLike | None = None
    ) -> Mapping[str, Rigid]:
        """Motions from rest of ``mandible``, ``eye_right`` and ``eye_left``, head frame."""
        looks = self.gaze(weights) if gaze is None else np.asarray(gaze, dtype=np.float64)
        eyes = {f"eye_{s}": self._eye_pose(s, looks[i]) for i, s in enumerate(SIDES)}
        return {"mandible": self.jaw_pose(weights), **eyes}

    def _checked(self, weights: ArrayLike) -> Floats:
        w = np.asarray(weights, dtype=np.float64)
        if w.shape != (len(self.head.shape_names),):
            raise ValueError(f"weights must have shape ({len(self._index)},), got {w.shape}")
        if not np.isfinite(w).all():
            name = self.head.shape_names[int(np.flatnonzero(~np.isfinite(w))[0])]
            raise ValueError(f"weights must be finite, {name} is not")
        return w

    def _jaw_weights(self, w: Floats) -> tuple[float, float, float]:
        opening, forward, left, right = (float(w[self._index[n]]) for n in JAW_SHAPES[:4])
        return opening, forward, left - right

    def _without_contact(self, w: Floats) -> Floats:
        found = self._rest.copy()
        self._move_jaw(found, w)
        return found

    def _move_jaw(self, found: Floats, w: Floats) -> None:
        opening, forward, left = self._jaw_weights(w)
        close = self._mouth_close(w)
        linear = w.copy()
        linear[self._index["mouthClose"]] = close
        self._shapes.add(found, linear)
        motion = self._jaw.angles_and_glide(opening, forward, left)
        closed = self._jaw.angles_and_glide(close, 0.0, 0.0)
        skin = self._skin
        add_jaw(
            found, self._rest, skin.rows, skin.share, skin.closing, self._jaw.pivot, motion, closed
        )
        pose = self._jaw.pose(opening, forward, left)
        lower = self._lower
        out = found[lower] - self._rest[lower]
        found[lower] = pose.apply(self._rest[lower] + out)

    def _lid_weights(self, side: str, w: Floats, pitch: float) -> LidWeights:
        def of(shape: str) -> float:
            return float(w[self._index[f"{shape}{side.title()}"]])

        cheek, brow = CHEEK_SQUINTS * of("cheekSquint"), BROW_SQUINTS * of("browDown")
        squint = 1 - (1 - of("eyeSquint")) * (1 - cheek) * (1 - brow)
        return LidWeights(of("eyeBlink"), squint, of("eyeWide"), pitch)

    def _calibrate_lips(self) -> None:
        for name, shapes in CLOSING_GESTURES.items():
            faces = []
            for amount in (0.3, 0.6, 1.0):
                w = np.zeros(len(self._index))
                w[[self._index[n] for n in shapes]] = amount
                faces.append((amount, self._without_contact(w)))
            self._lips.calibrate(name, faces)
        faces = []
        for amount in (0.1, 0.25, 0.5, 0.75, 1.0):
            w = np.zeros(len(self._index))
            w[[self._index[n] for n in ("jawOpen", "mouthClose")]] = amount
            faces.append((self._mouth_close(w), self._without_contact(w)))
        self._lips.calibrate("mouthClose", faces)

    def _closing(self, w: Floats) -> dict[str, float]:
        found = {"mouthClose": self._mouth_close(w)}
        for name, shapes in CLOSING_GESTURES.items():
            found[name] = float(np.mean([w[self._index[n]] for n in shapes]))
        return found

    def _mouth_close(self, w: Floats) -> float:
        opening, close = (float(w[self._index[n]]) for n in ("jawOpen", "mouthClose"))
        return smooth_min(opening, close)

    def _eye_pose(self, side: str, looks: Floats) -> Rigid:
        yaw, pitch = looks  # R = Ry(yaw) Rx(pitch)
        c, s, C, S = np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
        R = np.array([[C, S * s, S * c], [0, c, -s], [-S, C * s, C * c]])
        centre = self.head.eyes[side].centre
        return Rigid.from_rotation(R, centre - R @ centre)


class _SparseShapes:
    """Offsets of many shapes, kept by vertex and only where they are not zero."""

    def __init__(self, shapes: Floats) -> None:
        moved = (shapes != 0).any(axis=2).T  # (V, N)
        self._rows = np.flatnonzero(moved.any(axis=1))
        counts = moved[self._rows].sum(axis=1)
        self._start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        vertex, shape = np.nonzero(moved)
        self._shape = shape.astype(np.int64)
        self._offset = np.ascontiguousarray(shapes[shape, vertex])

    def add(self, out: Floats, weights: Floats) -> None:
        """Add the weighted shapes to `out`, (V, 3) mm."""
        _add_shapes(out, self._rows, self._start, self._shape, self._offset, weights)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _add_shapes(
    out: Floats,
    rows: NDArray[np.int64],
    start: NDArray[np.int64],
    shape: NDArray[np.int64],
    offset: Floats,
    weights: Floats,
) -> None:
    for i in range(len(rows)):
        x = y = z = 0.0
        for k in range(start[i], start[i + 1]):
            w = weights[shape[k]]
            x += w * offset[k, 0]
            y += w * offset[k, 1]
            z += w * offset[k, 2]
        out[rows[i], 0] += x
        out[rows[i], 1] += y
        out[rows[i], 2] += z
