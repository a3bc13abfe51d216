"""A hand before a face: it wipes, scratches the nose, or holds the chin, and never enters the skin.

The hand is MakeHuman's (CC0, `data/hand.npz`) in one of a few stored poses. Its way is scripted in
the head's frame; at every instant it is pushed out along the gesture's own direction until it only
touches.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from ..core.mesh import vertex_normals
from ..core.rigid import Rigid
from ..heads.bust import vertex_albedo
from ..heads.head import Head
from ..heads.mesh_cut import boundary_loops, cut_surface, hemmed, without_unused
from ..heads.raycast import RayScene
from ..heads.srgb import linear_from_srgb
from ..heads.subdivision import triangles_of_quads

Floats = NDArray[np.float64]

GESTURES = ("wipe", "scratch", "chin")
_CLEARANCE_MM = 0.6  # between hand and skin when they touch
_FROM_FAR_MM = 400.0  # rays that feel for the skin start this far out
_FACE_BACK_MM = -75.0  # the skin behind this (z at rest) is out of reach
_RISE_S = 0.55
_ARM_MM, _ARM_RINGS, _ARM_WIDENS = 380.0, 6, 1.25  # the arm goes on below what is stored
_CUFF_MM = -75.0  # a long sleeve ends here, y in the hand's frame
_CLOTH_OUT_MM = 4.5
#: Where the hand rests, in the frame of the sitting person, for a right hand.
_REST_AT = np.array([-165.0, -470.0, 170.0])
#: What touches, in the hand's frame: the palm; the tip of the index finger; the knuckles.
_PALM, _TIP, _KNUCKLES = (
    np.array([5.0, 65.0, 28.0]),
    np.array([22.0, 172.0, 26.0]),
    np.array([4.0, 106.0, 20.0]),
)


@dataclass(frozen=True, eq=False)
class _Hand:
    """The stored hand with its arm made longer."""

    poses: dict[str, Floats]
    triangles: NDArray[np.int32]


@cache
def _hand() -> _Hand:
    with (
        as_file(files(__package__).joinpath("data", "hand.npz")) as path,
        np.load(path, allow_pickle=False) as z,
    ):
        data = {name: z[name] for name in z.files}
    triangles = triangles_of_quads(data["quads"])
    ring = _elbow_ring(triangles, data["poses"][0])
    n, m = len(data["forearm"]), len(ring)
    rows = np.concatenate([ring[None], n + np.arange(_ARM_RINGS * m).reshape(-1, m)])
    a, b = rows[:-1], rows[1:]
    a1, b1 = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    more = np.concatenate(
        [np.stack([a1, a, b], -1).reshape(-1, 3), np.stack([a1, b, b1], -1).reshape(-1, 3)]
    )
    poses = {}
    for name, v in zip(data["pose_names"], data["poses"].astype(np.float64), strict=True):
        end = v[ring]
        middle = end.mean(axis=0)
        steps = np.arange(1, _ARM_RINGS + 1) / _ARM_RINGS
        wider = 1 + (_ARM_WIDENS - 1) * steps
        further = middle + (end - middle) * wider[:, None, None]
        further[..., 1] = middle[1] - _ARM_MM * steps[:, None]
        poses[str(name)] = np.concatenate([v, further.reshape(-1, 3)])
    return _Hand(poses, np.concatenate([triangles, more]).astype(np.int32))


def _elbow_ring(triangles: NDArray[np.int32], v: NDArray[np.float32]) -> NDArray[np.int64]:
    """The open end at the elbow, in order."""
    return min(boundary_loops(triangles), key=lambda r: float(v[r, 1].mean()))


@dataclass(frozen=True, eq=False)
class HandGesture:
    """A hand that again and again does one thing.

    Attributes
    ----------
    gesture : str
        One of `GESTURES`.
    left : bool
        The person's left hand.
    start_s, hold_s, period_s : float
        When it first leaves its rest, how long it stays at the face, and from start to start.
    triangles : (F, 3) int32
    colour : (V, 3) float64, linear
    """

    gesture: str
    left: bool
    start_s: float
    hold_s: float
    period_s: float
    triangles: NDArray[np.int32]
    colour: Floats
    _vertices: Floats  # (V, 3), mm, hand frame
    _anchor: Floats
    _targets: Floats  # (K, 3) mm, head frame: the way over the face
    _turns: Rotation  # (K,) head from hand
    _outward: Floats  # (3,), head frame
    _face: NDArray[np.int32]  # (n, 3) triangles that can be touched

    def presence(self, time_s: float) -> float:
        """How far the hand has come from its rest to the face, 0 to 1."""
        t = (time_s - self.start_s) % self.period_s if time_s >= self.start_s else -1.0
        up = _ease(t / _RISE_S)
        return up - _ease((t - _RISE_S - self.hold_s) / _RISE_S)

    def at(
        self,
        time_s: float,
        head_vertices: Floats,
        world_from_head: Rigid,
        *,
        world_from_body: Rigid | None = None,
    ) -> Floats:
        """The hand at a time.

        Parameters
        ----------
        time_s : float
        head_vertices : (V_head, 3) float, mm, head frame
        world_from_head : Rigid
        world_from_body : Rigid, optional
            Where the person sits: `world_from_head` of the head at rest.

        Returns
        -------
        (V, 3) float64, mm, world frame
            At least 0.6 mm before the face's skin, along the gesture's direction.
        """
        seat = Rigid.identity() if world_from_body is None else world_from_body
        head_from_seat = world_from_head.inverse() @ seat
        near = self.presence(time_s)
        turn, anchor = self._on_face(time_s)
        side = np.array([-1.0 if self.left else 1.0, 1, 1])
        rest_turn = Rotation.from_matrix(head_from_seat.rotation) * _turn(
            np.array([0.35 * side[0], 0.75, 0.45]), np.array([0.0, 0.4, -1.0])
        )
        rest_anchor = head_from_seat.apply(_REST_AT * side)
        pair = Rotation.concatenate([rest_turn, turn])
        turned = Slerp([0.0, 1.0], pair)([near])[0]
        place = rest_anchor + near * (anchor - rest_anchor)
        place = place + 4 * near * (1 - near) * 45.0 * self._outward
        v = turned.apply(self._vertices - self._anchor) + place
        if near > 0:
            v = v + self._push_mm(v, head_vertices) * self._outward
        return world_from_head.apply(v)

    def _on_face(self, time_s: float) -> tuple[Rotation, Floats]:
        """Orientation and place of the anchor on its way over the face, head frame."""
        t = (time_s - self.start_s) % self.period_s - _RISE_S
        u = float(np.clip(t / self.hold_s, 0, 1))
        if self.gesture == "scratch":
            place = 0.5 - 0.5 * np.cos(2 * np.pi * 3.1 * u * self.hold_s)
        elif self.gesture == "wipe":
            place = _ease(u)
        else:
            place = 0.5 - 0.5 * np.cos(2 * np.pi * 0.21 * u * self.hold_s)
        knots = np.linspace(0, 1, len(self._targets))
        anchor = np.array([np.interp(place, knots, self._targets[:, a]) for a in range(3)])
        return Slerp(knots, self._turns)([place])[0], anchor

    def _push_mm(self, v: Floats, head_vertices: Floats) -> float:
        """How far to go out along `_outward` so that no vertex lies below the skin."""
        scene = RayScene(head_vertices, self._face)
        start = v + _FROM_FAR_MM * self._outward
        t, _, _ = scene.cast(start, np.tile(-self._outward, (len(v), 1)))
        deepest = _FROM_FAR_MM - float(t.min())
        return max(deepest + _CLEARANCE_MM, 0.0) if np.isfinite(deepest) else 0.0


def random_gesture(
    rng: np.random.Generator,
    head: Head,
    *,
    gesture: str | None = None,
    sleeve: tuple[float, float, float] | None = None,
) -> HandGesture:
    """Draw a hand and what it does.

    Parameters
    ----------
    rng : numpy Generator
    head : Head
        Whose face is touched, and whose skin is shown.
    gesture : str, optional
        One of `GESTURES`; drawn if left out.
    sleeve : sRGB triple 0 to 255, optional
        Colour of a long sleeve; bare without.
    """
    drawn = str(rng.choice(GESTURES)) if gesture is None else gesture
    if drawn not in GESTURES:
        raise ValueError(f"gesture must be one of {', '.join(GESTURES)}, not {drawn!r}")
    left = bool(rng.random() < 0.4)
    start_s, hold_s = float(rng.uniform(0.2, 0.8)), float(rng.uniform(0.8, 1.6))
    if drawn == "chin":
        hold_s *= 1.8
    pause_s = float(rng.uniform(1.0, 3.0))
    hand = _hand()
    pose = {"wipe": "flat", "scratch": "pointing", "chin": "fist"}[drawn]
    mirror = np.array([-1.0 if left else 1.0, 1, 1])
    size = 0.94 * float(head.eyes["left"].centre[0]) / 30.78
    vertices = hand.poses[pose] * mirror * size
    triangles = hand.triangles[:, ::-1] if left else hand.triangles
    colour = _skin_colour(head, hand)
    if sleeve is not None:
        vertices, triangles, colour = _sleeved(vertices, triangles, colour, sleeve)
    anchor = {"wipe": _PALM, "scratch": _TIP, "chin": _KNUCKLES}[drawn] * mirror * size
    targets, turns, outward = _script(drawn, head, left)
    rest = np.asarray(head.mesh.vertices)
    skin = np.asarray(head.mesh.triangles)[np.asarray(head.mesh.groups["skin"])]
    face = skin[(rest[skin][..., 2] > _FACE_BACK_MM).all(axis=1)]
    return HandGesture(
        drawn,
        left,
        start_s,
        hold_s,
        2 * _RISE_S + hold_s + pause_s,
        np.ascontiguousarray(triangles),
        colour,
        vertices,
        anchor,
        targets,
        turns,
        outward,
        np.ascontiguousarray(face),
    )


def _script(gesture: str, head: Head, left: bool) -> tuple[Floats, Rotation, Floats]:
    """Places on the face, orientations there (head from hand), and the way out of the skin."""
    p = head.points
    side = 1.0 if left else -1.0  # of the face that the hand comes from; x is the subject's left
    flip = np.array([-side, 1.0, 1.0])  # scripts below are for a right hand
    if gesture == "wipe":
        nose = p["9.3"]
        mouth = (p["2.2"] + p["2.3"]) / 2
        targets = np.array([mouth + (-62, 4, -30), mouth + (-8, 10, 0), nose + (40, 6, -14)])
        aims = [((0.25, 0.95, 0.0), (0.55, 0.0, -0.85)), ((0.65, 0.75, 0.0), (0.0, 0.0, -1.0))]
        aims.append(((0.85, 0.5, -0.1), (-0.45, 0.0, -0.9)))
        outward = np.array([0.0, 0.0, 1.0])
    elif gesture == "scratch":
        nose = p["9.3"]
        targets = np.array([nose + (-19, 12, -14), nose + (-14, 28, -12)])
        aims = [((0.30, 0.85, -0.25), (0.25, 0.15, -0.95))] * 2
        outward = np.array([-0.2, 0.0, 0.98])
    else:
        chin = p["2.1"]
        targets = np.array([chin + (-6, -14, -4), chin + (-4, -14, -4)])
        aims = [((0.25, 0.93, -0.25), (0.2, -0.2, -0.95)), ((0.2, 0.95, -0.22), (0.2, -0.2, -0.95))]
        outward = np.array([0.0, -0.85, 0.53])
    if left:
        targets = (targets - (p["9.3"][0], 0, 0)) * (-1, 1, 1) + (p["9.3"][0], 0, 0)
    turns = Rotation.concatenate([_turn(np.array(y) * flip, np.array(z) * flip) for y, z in aims])
    outward = outward * flip
    return targets, turns, outward / np.linalg.norm(outward)


def _turn(fingers: Floats, palm: Floats) -> Rotation:
    """The rotation that points the fingers (hand's y) and the palm (hand's z) as told."""
    y = fingers / np.linalg.norm(fingers)
    z = palm - (palm @ y) * y
    z /= np.linalg.norm(z)
    return Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=1))


def _sleeved(
    v: Floats, triangles: NDArray[np.int32], colour: Floats, sleeve: tuple[float, float, float]
) -> tuple[Floats, NDArray[np.int32], Floats]:
    """Put a sleeve around the arm: its surface, wider, cut and hemmed at the wrist."""
    cut = cut_surface(v, triangles, _CUFF_MM - v[:, 1], v[:, 1])
    wide = cut.vertices + _CLOTH_OUT_MM * vertex_normals(cut.vertices, cut.triangles)
    faces = cut.triangles
    for loop in cut.loops:
        wide, faces = hemmed(wide, faces, loop)
    wide, faces = without_unused(wide, faces)
    cloth = linear_from_srgb(np.array(sleeve, dtype=np.float64)).astype(np.float64)
    return (
        np.concatenate([v, wide]),
        np.concatenate([triangles, faces + len(v)]).astype(np.int32),
        np.concatenate([colour, np.tile(np.clip(cloth, 0.004, 0.95), (len(wide), 1))]),
    )


def _skin_colour(head: Head, hand: _Hand) -> Floats:
    """The colour of the person's own forehead, paler in the palm, redder at the fingers."""
    albedo = vertex_albedo(head)
    rest = np.asarray(head.mesh.vertices)
    near = np.linalg.norm(rest - head.points["11.1"] + (0, 25, 0), axis=1) < 30
    skin = np.median(albedo[near], axis=0) if near.any() else np.median(albedo, axis=0)
    v = hand.poses["flat"]
    warm = np.clip((v[:, 1] - 20) / 150, 0, 1)[:, None]
    palm = np.clip(0.5 + v[:, 2:3] / 60, 0, 1)
    found = skin * (0.93 + 0.10 * palm) * (1 + warm * np.array([0.03, -0.06, -0.05]))
    return np.asarray(np.clip(found, 0.004, 0.95))


def _ease(s: float) -> float:
    s = float(np.clip(s, 0, 1))
    return s**3 * (10 + s * (6 * s - 15))
