"""How the lips of a synthetic face touch, press and part."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache

import numba
import numpy as np
from numpy.typing import NDArray

from ..core.rigid import Rigid
from ..heads.head import Head
from ..heads.skin_loops import skin_quads
from ..heads.template import load_template

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Places across the mouth at which the lips' distance is measured.
N_STATIONS = 41
_RINGS = 15  # on either side of the seam that the lips' contact moves
_FLAT_RINGS = 8  # of them, move as one
_CONTACT_RINGS = 9  # on either side, may touch
_BETWEEN = 3  # points an edge along the profile
#: Profiles are beads of this radius for measuring; a soft minimum of this width.
_BEAD_MM, _SOFT_MIN_MM = 0.7, 0.03
#: Parting begins slowly over this opening; contact over this depth.
PARTING_MM = 1.2
CONTACT_SOFT_MM = 0.15
_STICKING = 4.0
_EARLY = 4
#: Lips that lie one before the other overlap by this much more than at rest, at most.
_DEEPEST_MM = 1.0
#: Neutral lips may overlap by more than this; closing gestures of this total weight undo it.
_TOUCH_MM, _MENDING = 0.05, 0.3
_PASSES = 4  # columns lean, and teeth push: what is left is moved again
_CORNER_SHARE = 0.01  # of the width, where contact fades out
_OVERLAP_MM = 0.2  # that closing gestures aim for, before contact stops them
_TEETH_MM, _TEETH_SOFT_MM, _EDGE_SOFT_MM = 0.4, 0.3, 1.5


@dataclass(frozen=True, eq=False)
class LipLayout:
    """The lips as a grid: rings along the mouth, columns across the lips.

    Attributes
    ----------
    upper, lower : (29 or so, n) int64
        Vertices; row `_RINGS` is the seam, before it the inner side. Columns run from the right
        corner to the left one.
    upper_place, lower_place : (n,) float64
        Where columns stand, in units of stations.
    fade : (rings,) float64
        How much of a contact displacement each ring takes.
    """

    upper: Ints
    lower: Ints
    upper_place: Floats
    lower_place: Floats
    fade: Floats


@cache
def lip_layout() -> LipLayout:
    """Find the lips' rings on the template (about 0.1 s, once a process)."""
    template = load_template()
    v, quads = template.vertices, skin_quads()
    seam, inner = _seam(v)
    seam = np.roll(seam, -int(np.argmin(v[seam, 0])))
    steps, place = quads.beside_loop(seam, inner)
    rings = np.arange(-_RINGS, _RINGS + 1)
    grid = np.full((len(rings), len(seam)), -1, dtype=np.int64)
    for i, ring in enumerate(rings):
        rows = np.flatnonzero(steps == ring)
        grid[i, place[rows]] = rows
    assert (grid >= 0).all(), "the template's lips are not rings"
    left = int(np.argmax(v[seam, 0]))
    one, two = grid[:, : left + 1], np.roll(grid[:, ::-1], 1, axis=1)[:, : len(seam) - left + 1]
    upper, lower = (one, two) if v[one[_RINGS], 1].mean() > v[two[_RINGS], 1].mean() else (two, one)
    outwards = np.abs(rings) - _FLAT_RINGS
    t = np.clip(1 - outwards / (_RINGS + 1 - _FLAT_RINGS), 0, 1)
    return LipLayout(
        upper,
        lower,
        _places(v[upper[_RINGS], 0]),
        _places(v[lower[_RINGS], 0]),
        t * t * (3 - 2 * t),
    )


def _seam(v: Floats) -> tuple[Ints, int]:
    """The ring on which the lips are nearest each other at the middle, and a vertex inside."""
    quads = skin_quads()
    rows = np.unique(quads.quads)
    middle = rows[(np.abs(v[rows, 0]) < 0.01) & (np.abs(v[rows, 1] + 67) < 8) & (v[rows, 2] > 10)]
    best, nearest = None, np.inf
    for start in middle:
        ahead = max(quads.neighbours(int(start)), key=lambda n: abs(float(v[n, 0])))
        loop = quads.closed_loop(int(start), ahead)
        if loop is None:
            continue
        others = [n for n in loop if n != start and abs(v[n, 0]) < 0.01]
        if len(others) == 1 and np.linalg.norm(v[start] - v[others[0]]) < nearest:
            best, nearest = loop, float(np.linalg.norm(v[start] - v[others[0]]))
    assert best is not None, "the template has no ring about the mouth"
    inside = middle[np.argmin(v[middle, 2])]
    return best, int(inside)


def _places(x: Floats) -> Floats:
    """Columns' places in units of stations; stations are denser towards the corners."""
    share = np.clip((x - x[0]) / (x[-1] - x[0]), 0, 1)
    share = np.maximum.accumulate(share)
    return np.asarray(np.arccos(1 - 2 * share) / np.pi * (N_STATIONS - 1))


class LipMotion:
    """Contact of the lips of one head.

    At each station across the mouth two heights are measured: v, by which the lips part as seen
    from in front, and p ≥ v, by which the upper could be lowered before it touches the lower (a
    soft minimum over points of their profiles; overlapping lips may lie one before the other).
    Closing gestures first lower v to where it is at rest or below 0. Then the lips are moved,
    half each, as

        v ← φ(v − v₀⁺) + v₀⁺,   φ(g) = g − 4 D t² (1 − t)², t = g / D in [0, 1], D = 1.2 mm
        v ← v + ψ(min(v₀, −0.2 mm) − 1 mm − v)
        p ← p + ψ(f − p),   ψ(n) = 0 below 0, n² / 2d to d = 0.15 mm, n − d / 2 above

    (₀ at rest; f is min(p₀, 0), or at least −0.05 mm while gestures close the lips), all C1:
    lips part first where they are drawn apart most, and lips that are pressed stop at each
    other. Then they are held before the front teeth.

    Parameters
    ----------
    head : Head
        Of the built-in topology.
    """

    def __init__(self, head: Head) -> None:
        rest = np.array(head.mesh.vertices)
        self._layout = lip_layout()
        self._rest_opening, self._rest_room = self.heights(rest)
        self._teeth = [_Teeth(rest[head.part_vertices(p)]) for p in ("teeth_upper", "teeth_lower")]
        grids = self._layout.upper, self._layout.lower
        self._slack = [t.slack(rest[rows]) for t, rows in zip(self._teeth, grids, strict=True)]
        self._calls: dict[str, Floats] = {}

    def heights(self, vertices: Floats) -> Floats:
        """v and p of the class's equations, (2, N_STATIONS) mm."""
        layout = self._layout
        found = np.empty((2, N_STATIONS))
        _measure(
            vertices, layout.upper, layout.lower, layout.upper_place, layout.lower_place, found
        )
        return found

    def calibrate(self, name: str, faces: Iterable[tuple[float, Floats]]) -> None:
        """Learn by how much a gesture that must close the lips misses it.

        Parameters
        ----------
        name : str
            Of the gesture, for `touch`.
        faces : iterable of (amount, vertices)
            The face without contact at amounts of the gesture in (0, 1].
        """
        aim = np.minimum(self._rest_opening, -_OVERLAP_MM)
        missed = np.zeros(N_STATIONS)
        for amount, vertices in faces:
            missed = np.maximum(missed, (self.heights(vertices)[0] - aim) / _asked(amount))
        self._calls[name] = _blurred(missed)

    def touch(self, out: Floats, closing: Mapping[str, float], mandible: Rigid) -> None:
        """Bring the lips of `out`, (V, 3) mm, to touch, and hold them before the teeth.

        Parameters
        ----------
        out : (V, 3) float64, mm
        closing : mapping from a calibrated gesture's name to its weight
        mandible : Rigid
        """
        asked = np.zeros(N_STATIONS)
        for name, weight in closing.items():
            asked += _asked(weight) * self._calls[name]
        opening, room = self.heights(out)
        slit = np.maximum(self._rest_opening, 0)
        wanted = parted(opening - asked - slit) + slit
        shift = wanted - opening
        lowest = np.minimum(self._rest_opening, -_OVERLAP_MM) - _DEEPEST_MM
        shift = shift + stopped(lowest - opening - shift)
        shift = shift + stopped(self._floor(sum(closing.values())) - room - shift)
        layout, window = self._layout, _window()
        shift *= window
        aim = room + shift
        upper, lower = self._teeth
        for _ in range(_PASSES):
            _spread(
                out, layout.upper, layout.lower, layout.upper_place, layout.lower_place,
                layout.fade, shift,
            )  # fmt: skip
            upper.hold(out, layout.upper, self._slack[0], Rigid.identity())
            lower.hold(out, layout.lower, self._slack[1], mandible)
            shift = window * (aim - self.heights(out)[1])

    def _floor(self, closing: float) -> Floats:
        """The least p: that of the neutral face, which gestures that close the lips mend."""
        t = min(closing / _MENDING, 1.0)
        rest = np.minimum(self._rest_room, 0)
        return np.asarray(rest + t * t * (3 - 2 * t) * (np.maximum(rest, -_TOUCH_MM) - rest))


def _asked(weight: float) -> float:
    """Closing is asked for early: lips meet long before they are pressed."""
    return 1 - (1 - min(max(weight, 0.0), 1.0)) ** _EARLY


def parted(gap: Floats) -> Floats:
    """What becomes of an opening, mm: φ of `LipMotion`."""
    t = np.clip(gap / PARTING_MM, 0, 1)
    return np.asarray(gap - _STICKING * PARTING_MM * t**2 * (1 - t) ** 2)


def stopped(depth: Floats) -> Floats:
    """ψ of `LipMotion`: what undoes a penetration, mm."""
    d = CONTACT_SOFT_MM
    n = np.maximum(depth, 0)
    return np.asarray(np.where(n < d, n * n / (2 * d), n - d / 2))


@cache
def _window() -> Floats:
    share = (1 - np.cos(np.pi * np.arange(N_STATIONS) / (N_STATIONS - 1))) / 2
    t = np.clip(np.minimum(share, 1 - share) / _CORNER_SHARE, 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def _blurred(values: Floats) -> Floats:
    """Raised to the neighbours' largest, then smoothed: nowhere too little."""
    padded = np.pad(values, 2, mode="edge")
    raised = np.max([padded[i : i + len(values)] for i in range(5)], axis=0)
    padded = np.pad(raised, 1, mode="edge")
    return np.asarray((padded[:-2] + 2 * padded[1:-1] + padded[2:]) / 4)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _profile(vertices: Floats, grid: Ints, a: int, t: float, found: Floats) -> None:
    """Points of a lip's profile between columns a and a + 1."""
    first = _RINGS - _CONTACT_RINGS
    for i in range(len(found)):
        ring, f = first + i // _BETWEEN, (i % _BETWEEN) / _BETWEEN
        for axis in range(3):
            here = (1 - t) * vertices[grid[ring, a], axis] + t * vertices[grid[ring, a + 1], axis]
            if f > 0:
                onward = (1 - t) * vertices[grid[ring + 1, a], axis]
                onward += t * vertices[grid[ring + 1, a + 1], axis]
                here = (1 - f) * here + f * onward
            found[i, axis] = here


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _measure(
    vertices: Floats,
    upper: Ints,
    lower: Ints,
    upper_place: Floats,
    lower_place: Floats,
    found: Floats,
) -> None:
    """Opening and room at every station; the lower lip's profile is taken at the upper's x."""
    n = 2 * _CONTACT_RINGS * _BETWEEN + 1
    above, below = np.empty((n, 3)), np.empty((n, 3))
    values = np.empty((n, n))
    for k in range(found.shape[1]):
        a = 0
        while a < len(upper_place) - 2 and upper_place[a + 1] < k:
            a += 1
        t = min(max((k - upper_place[a]) / (upper_place[a + 1] - upper_place[a]), 0.0), 1.0)
        _profile(vertices, upper, a, t, above)
        x = above[_CONTACT_RINGS * _BETWEEN, 0]
        a = 0
        while a < len(lower_place) - 2 and vertices[lower[_RINGS, a + 1], 0] < x:
            a += 1
        x0, x1 = vertices[lower[_RINGS, a], 0], vertices[lower[_RINGS, a + 1], 0]
        t = 0.0 if x1 <= x0 else min(max((x - x0) / (x1 - x0), 0.0), 1.0)
        _profile(vertices, lower, a, t, below)
        least, low, high = np.inf, np.inf, -np.inf
        for i in range(n):
            low, high = min(low, above[i, 1]), max(high, below[i, 1])
            for j in range(n):
                dz = above[i, 2] - below[j, 2]
                d = above[i, 1] - below[j, 1] + dz * dz / (2 * _BEAD_MM)
                values[i, j] = d
                least = min(least, d)
        total = lows = highs = 0.0
        w = _SOFT_MIN_MM
        for i in range(n):
            lows += np.exp((low - above[i, 1]) / w)
            highs += np.exp((below[i, 1] - high) / w)
            for j in range(n):
                d = values[i, j] - least
                if d < 12 * w:
                    total += np.exp(-d / w)
        found[0, k] = low - high - w * (np.log(lows) + np.log(highs))
        found[1, k] = least - w * np.log(total)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _spread(
    out: Floats,
    upper: Ints,
    lower: Ints,
    upper_place: Floats,
    lower_place: Floats,
    fade: Floats,
    shift: Floats,
) -> None:
    """Move the upper lip up and the lower down by half of the stations' shifts."""
    for half in range(2):
        grid = upper if half == 0 else lower
        place = upper_place if half == 0 else lower_place
        sign = 0.5 if half == 0 else -0.5
        for column in range(1, len(place) - 1):
            a = min(int(place[column]), len(shift) - 2)
            t = place[column] - a
            move = sign * ((1 - t) * shift[a] + t * shift[a + 1])
            for ring in range(len(fade)):
                out[grid[ring, column], 1] += move * fade[ring]


class _Teeth:
    """The front of a row of teeth, as a parabola z(x) over its foremost points."""

    def __init__(self, teeth: Floats) -> None:
        front = teeth[teeth[:, 2] > teeth[:, 2].max() - 14]
        columns = np.round(front[:, 0] / 2).astype(int)
        fore = np.array(
            [front[columns == c][front[columns == c, 2].argmax()] for c in set(columns)]
        )
        A = np.stack([np.ones(len(fore)), fore[:, 0] ** 2], axis=1)
        (self._top, self._bend), *_ = np.linalg.lstsq(A, fore[:, 2], rcond=None)
        self._half_width = float(np.abs(front[:, 0]).max())
        self._low, self._high = float(front[:, 1].min()), float(front[:, 1].max())

    def slack(self, at: Floats) -> Floats:
        """How far lips at rest stand before the teeth, at most `_TEETH_MM`; (...,) mm."""
        z = self._top + self._bend * at[..., 0] ** 2
        return np.asarray(np.minimum(at[..., 2] - z, _TEETH_MM))

    def hold(self, out: Floats, grid: Ints, slack: Floats, pose: Rigid) -> None:
        """Push lips that came too near forward."""
        R, t = pose.rotation, pose.translation
        bounds = np.array([self._top, self._bend, self._half_width, self._low, self._high])
        _hold(out, grid, slack, np.ascontiguousarray(R), np.asarray(t), bounds)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _hold(out: Floats, grid: Ints, slack: Floats, R: Floats, t: Floats, bounds: Floats) -> None:
    top, bend, half_width, low, high = bounds[0], bounds[1], bounds[2], bounds[3], bounds[4]
    for ring in range(grid.shape[0]):
        for column in range(1, grid.shape[1] - 1):
            v = grid[ring, column]
            dx, dy, dz = out[v, 0] - t[0], out[v, 1] - t[1], out[v, 2] - t[2]
            x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
            y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
            z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
            need = top + bend * x * x + slack[ring, column] - z
            if need <= 0:
                continue
            inside = min(y - low, high - y) / _EDGE_SOFT_MM + 1
            beside = (half_width - abs(x)) / _EDGE_SOFT_MM + 1
            near = min(max(inside, 0.0), 1.0) * min(max(beside, 0.0), 1.0)
            near = near * near * (3 - 2 * near)
            soft = _TEETH_SOFT_MM
            push = near * (need * need / (2 * soft) if need < soft else need - 0.5 * soft)
            for axis in range(3):
                out[v, axis] += R[axis, 2] * push
