"""How the eyelids of a synthetic face slide over the eyeballs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from ..heads.head import Head
from ..heads.skin_loops import skin_quads
from ..heads.template import load_template

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Where the rims meet, from the lower (0) to the upper one (1): the upper lid does most of the way.
MEET = 0.14
#: Share of the opening that eyeWide = 1 raises the upper and lowers the lower rim by.
WIDE_UPPER, WIDE_LOWER = 0.30, 0.08
#: Share of the opening that a full squint lowers the upper and raises the lower rim by.
SQUINT_UPPER, SQUINT_LOWER = 0.22, 0.38
#: How far cheekSquint and browDown squint the eye too.
CHEEK_SQUINTS, BROW_SQUINTS = 0.30, 0.15
#: Lids follow the eye's pitch by these shares.
FOLLOW_UPPER, FOLLOW_LOWER = 0.55, 0.30
#: The least distance from the globe of skin that slides over it, at the rim and this many rings
#: away from it, where the lid is as thick as its edge is deep.
_SLIDING_MM, _LID_MM, _LID_RINGS = 0.35, 2.3, 8.0
_SOFT_MM = 0.2
_SLIDES_RAD = np.deg2rad(8.0)
_MARGIN_RINGS = 6  # of the lid's edge face, from the rim inwards
_LOWER_FADE_RINGS, _SOCKET_FADE_RINGS = 16.0, 6.0
_SEARCH_MM = 0.7
_MEET_SAMPLES, _MEET_BLUR_MM = 200, 0.8


@dataclass(frozen=True, eq=False)
class LidLayout:
    """One eye's lids on the template.

    Attributes
    ----------
    upper, lower : (n,) int64
        Vertices of the rim from the inner to the outer corner, corners included in both.
    rows : (K,) int64
        Vertices that the lids move: skin, socket and lashes.
    sign : (K,) float64
        1 upper lid, −1 lower.
    share : (K,) float64 in [0, 1]
        Of the rim's turn.
    margin : (K,) float64 in [0, 1]
        1 on the edge face of the lid, which lies flat on the other lid when closed.
    least : (K,) float64, mm
        How far above the globe skin that slides over it stays.
    outside : (K,) float64
        1 where the skin covers the globe, 0 in the socket, on lashes and on the edge's inside.
    """

    upper: Ints
    lower: Ints
    rows: Ints
    sign: Floats
    share: Floats
    margin: Floats
    least: Floats
    outside: Floats


@cache
def lid_layout(side: str) -> LidLayout:
    """Find rim and lids of the ``right`` or ``left`` eye (about 0.2 s, once a process)."""
    template = load_template()
    v, quads = template.vertices, skin_quads()
    ball = v[template.vertices_of(f"eye_{side}")]
    centre = (ball.min(axis=0) + ball.max(axis=0)) / 2
    p = v - centre
    angle = np.arctan2(p[:, 1], p[:, 2])
    skin = template.vertices_of("skin")
    rim = _rim(skin, p, angle)
    outward = np.sign(centre[0])
    ends = np.argmin(outward * v[rim, 0]), np.argmax(outward * v[rim, 0])
    turned = np.roll(rim, -int(ends[0]))
    split = (int(ends[1]) - int(ends[0])) % len(rim)
    one, two = turned[: split + 1], np.roll(turned[::-1], 1)[: len(rim) - split + 1]
    upper, lower = (one, two) if p[one, 1].mean() > p[two, 1].mean() else (two, one)
    socket = skin[np.argmin(np.linalg.norm(p[skin] - (0, 0, -14.0), axis=1))]
    steps, place = quads.beside_loop(rim, int(socket))
    is_upper = np.isin(rim, upper) & ~np.isin(rim, lower)
    corner = np.isin(rim, upper) & np.isin(rim, lower)
    sign = np.where(is_upper[place], 1.0, -1.0)
    at_corner = corner[place]
    sign[at_corner] = np.where(angle[at_corner] > angle[rim[place[at_corner]]], 1.0, -1.0)
    share = _share(side, sign, steps, place, rim, p, angle)
    lashes = template.vertices_of("lashes")
    lashes = lashes[outward * v[lashes, 0] > 0]
    share[lashes], sign[lashes] = 1.0, 1.0
    margin = np.clip((-steps <= _MARGIN_RINGS) & (steps <= 0), 0, 1).astype(np.float64)
    margin[steps < -_MARGIN_RINGS] = np.clip(
        1 + (steps[steps < -_MARGIN_RINGS] + _MARGIN_RINGS) / _SOCKET_FADE_RINGS, 0, 1
    )
    margin[lashes] = 0.0
    outside = (steps >= -2).astype(np.float64)
    outside[lashes] = 0.0
    least = _SLIDING_MM + (_LID_MM - _SLIDING_MM) * np.clip(steps / _LID_RINGS, 0, 1)
    rows = np.flatnonzero(share > 1e-3)
    kept = (a[rows] for a in (sign, share, margin, least, outside))
    return LidLayout(upper, lower, rows, *kept)


def _rim(skin: Ints, p: Floats, angle: Floats) -> Ints:
    """The closed loop of skin edges about the eye with the narrowest opening at the middle."""
    near = skin[(np.abs(p[skin, 0]) < _SEARCH_MM) & (p[skin, 2] > 12) & (p[skin, 1] > 0)]
    best, narrowest = None, np.inf
    for start in near[np.abs(p[near, 1]) < 9]:
        ahead = max(skin_quads().neighbours(int(start)), key=lambda n: abs(p[n, 0] - p[start, 0]))
        loop = skin_quads().closed_loop(int(start), ahead)
        if loop is None or np.linalg.norm(p[start]) < 15.5:
            continue
        below = loop[p[loop, 1] < 0]
        facing = below[np.argmin(np.abs(p[below, 0] - p[start, 0]))]
        if angle[start] - angle[facing] < narrowest:
            best, narrowest = loop, angle[start] - angle[facing]
    assert best is not None, "the template has no rim about the eye"
    return best


def _share(
    side: str,
    sign: Floats,
    steps: Floats,
    place: Ints,
    rim: Ints,
    p: Floats,
    angle: Floats,
) -> Floats:
    """Which part of the rim's turn each vertex takes; of the upper lid as sculpted."""
    template = load_template()
    blink = template.arkit[template.arkit_names.index(f"eyeBlink{side.title()}")]
    q = p + blink
    turn = np.arctan2(q[:, 1], q[:, 2]) - angle
    turn[np.abs(turn) > np.pi] = 0.0  # behind the axis
    full = np.abs(turn[rim]).max()
    local = np.maximum(np.abs(turn[rim[place]]), 0.35 * full)
    sculpted = np.clip(np.abs(turn) / local, 0, 1)
    fade_out = np.clip(1 - steps / _LOWER_FADE_RINGS, 0, 1)
    fade_in = np.clip(1 + (steps + _MARGIN_RINGS) / _SOCKET_FADE_RINGS, 0, 1)
    lower = np.where(steps >= 0, fade_out**2 * (3 - 2 * fade_out), fade_in**2 * (3 - 2 * fade_in))
    found = np.where(sign > 0, sculpted, lower)
    found[(steps <= 1) & (steps >= -_MARGIN_RINGS)] = 1.0
    found[~np.isfinite(steps)] = 0.0
    return np.asarray(found)


@dataclass(frozen=True)
class LidWeights:
    """What moves one eye's lids.

    Attributes
    ----------
    blink, squint, wide : float, in [0, 1]
    pitch : float, rad
        Of the eyeball, positive down.
    """

    blink: float
    squint: float
    wide: float
    pitch: float


class LidMotion:
    """The lids of one eye of a head.

    A lid vertex at angle α about the horizontal axis through the eye's centre turns by its share
    h of what its rim turns by. Of the rims' angles U(x), L(x) and opening o = U − L at rest,

        U₁ = U + 0.30 wide o − 0.55 pitch o / max o,   L₁ = L − 0.08 wide o − 0.30 pitch o / max o
        U₂ = U₁ − 0.22 squint (U₁ − L₁),               L₂ = L₁ + 0.38 squint (U₁ − L₁)
        U₃ = U₂ + blink (C − U₂),                      L₃ = L₂ + blink (C − L₂),

    with C = L + (0.14 + 0.36 (1 − o / max o)²) o, smoothed,

    so that the rims never cross, and meet on C when blink is 1 whatever the rest does. Edge
    faces turn flat onto C with blink, and the rims go to the mean of their distances from the
    axis. Where skin would come nearer to the globe, turned as it is by the gaze, than it may, it
    is lifted.

    Parameters
    ----------
    head : Head
        Of the built-in topology.
    side : str
        ``right`` or ``left``.
    """

    def __init__(self, head: Head, side: str) -> None:
        v, eye = head.mesh.vertices, head.eyes[side]
        self.layout = lid_layout(side)
        self.rows = self.layout.rows
        self._centre = np.array(eye.centre)
        ball = v[head.part_vertices(f"eye_{side}")] - self._centre
        self._inverse_squares = np.linalg.lstsq(ball**2, np.ones(len(ball)), rcond=None)[0]
        p = v[self.rows] - self._centre
        x = p[:, 0]
        upper, lower = (v[rim] - self._centre for rim in (self.layout.upper, self.layout.lower))
        self._upper, upper_far = _rim_at(upper, x)
        self._lower, lower_far = _rim_at(lower, x)
        self._lower = np.minimum(self._lower, self._upper)
        self._meet, meet_far = _closed_rim(upper, lower, x)
        own_far = np.where(self.layout.sign > 0, upper_far, lower_far)
        self._outward = self.layout.share * (meet_far - own_far)
        self._widest = float((self._upper - self._lower).max())
        R = np.linalg.norm(p, axis=1)
        globe = R / np.sqrt((p**2) @ self._inverse_squares)
        self._clearance = np.minimum(R - globe, self.layout.least)

    def move(self, out: Floats, weights: LidWeights, eye_rotation: Floats) -> None:
        """Slide the lids of `out`, (V, 3) mm, over the globe turned by (3, 3) `eye_rotation`."""
        layout = self.layout
        _slide(
            out,
            self.rows,
            self._centre,
            layout.sign,
            layout.share,
            layout.margin,
            layout.outside,
            layout.least,
            self._upper,
            self._lower,
            self._meet,
            self._widest,
            self._outward,
            self._clearance,
            self._inverse_squares,
            np.ascontiguousarray(eye_rotation),
            np.array([weights.blink, weights.squint, weights.wide, weights.pitch]),
        )


def _rim_at(rim: Floats, x: Floats) -> tuple[Floats, Floats]:
    """Angles of a rim about the eye's horizontal axis, and distances from it, at x."""
    p = rim[np.argsort(rim[:, 0], kind="stable")]
    angle, far = np.arctan2(p[:, 1], p[:, 2]), np.hypot(p[:, 1], p[:, 2])
    return np.interp(x, p[:, 0], angle), np.interp(x, p[:, 0], far)


def _closed_rim(upper: Floats, lower: Floats, x: Floats) -> tuple[Floats, Floats]:
    """Angles and distances at x of the line on which the lids meet.

    Smooth even where the rims turn round the corners, so that both rims, whose vertices stand at
    different places, follow the same line.
    """
    both = np.concatenate([upper[:, 0], lower[:, 0]])
    grid = np.linspace(both.min(), both.max(), _MEET_SAMPLES)
    up, up_far = _rim_at(upper, grid)
    low, low_far = _rim_at(lower, grid)
    opening = up - low
    share = MEET + (0.5 - MEET) * (1 - opening / opening.max()) ** 2
    width = _MEET_BLUR_MM / (grid[1] - grid[0])
    angle = gaussian_filter1d(low + share * opening, width, mode="nearest")
    far = gaussian_filter1d(0.5 * (up_far + low_far), width, mode="nearest")
    return np.interp(x, grid, angle), np.interp(x, grid, far)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _slide(
    out: Floats,
    rows: Ints,
    centre: Floats,
    sign: Floats,
    share: Floats,
    margin: Floats,
    outside: Floats,
    least: Floats,
    upper: Floats,
    lower: Floats,
    meet: Floats,
    widest: float,
    outward: Floats,
    clearance: Floats,
    inverse_squares: Floats,
    eye: Floats,
    weights: Floats,
) -> None:
    blink, squint, wide, pitch = weights[0], weights[1], weights[2], weights[3]
    for k in range(len(rows)):
        v = rows[k]
        u, low = upper[k], lower[k]
        o = u - low
        u1 = u + WIDE_UPPER * wide * o - FOLLOW_UPPER * pitch * o / widest
        l1 = low - WIDE_LOWER * wide * o - FOLLOW_LOWER * pitch * o / widest
        u2 = u1 - SQUINT_UPPER * squint * (u1 - l1)
        l2 = l1 + SQUINT_LOWER * squint * (u1 - l1)
        rim = u if sign[k] > 0 else low
        turned = u2 + blink * (meet[k] - u2) if sign[k] > 0 else l2 + blink * (meet[k] - l2)
        x, y, z = out[v, 0] - centre[0], out[v, 1] - centre[1], out[v, 2] - centre[2]
        turn = share[k] * (turned - rim)
        if margin[k] > 0:
            turn -= margin[k] * blink * (np.arctan2(y, z) - rim)
        still = turn == 0
        c, s = np.cos(turn), np.sin(turn)
        y, z = c * y + s * z, c * z - s * y
        if blink != 0 and outward[k] != 0:
            grown = 1 + blink * outward[k] / np.sqrt(y * y + z * z)
            y *= grown
            z *= grown
            still = False
        if outside[k] > 0:
            q0 = eye[0, 0] * x + eye[1, 0] * y + eye[2, 0] * z
            q1 = eye[0, 1] * x + eye[1, 1] * y + eye[2, 1] * z
            q2 = eye[0, 2] * x + eye[1, 2] * y + eye[2, 2] * z
            r = np.sqrt(x * x + y * y + z * z)
            i = inverse_squares
            globe = r / np.sqrt(q0 * q0 * i[0] + q1 * q1 * i[1] + q2 * q2 * i[2])
            far = min(abs(turn) / _SLIDES_RAD, 1.0)
            wanted = clearance[k] + (least[k] - clearance[k]) * far * far * (3 - 2 * far)
            need = globe + wanted - r
            if need > 0:
                still = False
                lift = need * need / (2 * _SOFT_MM) if need < _SOFT_MM else need - 0.5 * _SOFT_MM
                across = np.sqrt(y * y + z * z)
                grown = 1 + lift * r / (across * across)
                y *= grown
                z *= grown
        if not still:  # a lid at rest stays where it is to the last bit
            out[v, 0] = centre[0] + x
            out[v, 1] = centre[1] + y
            out[v, 2] = centre[2] + z
