"""How the jaw of a synthetic face moves, and the skin with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from ..core.rigid import Rigid
from ..heads.bones import CONDYLE_HALF_DISTANCE_MM, MANDIBLE_MM
from ..heads.head import Head
from ..heads.template import Template, load_template

Floats = NDArray[np.float64]

#: Full opening: this far between the incisors of an adult, the condyles so far down their slope.
OPEN_MM, GLIDE_MM = 42.0, 10.0
#: Slope of the joint's roof, against the horizontal.
GLIDE_SLOPE_RAD = np.deg2rad(38.0)
FORWARD_MM = np.array([0.0, -1.5, 8.3])  # of jawForward = 1, as sculpted
#: A sideways jaw turns about the condyle of the side it goes to, which itself shifts a little.
LATERAL_RAD, SHIFT_MM = np.deg2rad(4.2), 1.2
_SOFT_RAD = np.deg2rad(0.5)  # below this the balancing condyle's glide is rounded off
_OPEN_BOUNDS_RAD = (0.1, 0.8)
#: Widths of the blends of the smooth minimum of `jawOpen` and `mouthClose`.
_MIN_WIDTH = 0.03
_SMOOTHING_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class JawSkin:
    """How the template's skin takes part in the motion of the jaw; the same for all identities.

    Attributes
    ----------
    rows : (K,) int64
        Skin vertices that take part.
    share : (K,) float64 in [0, 1]
        Of the mandible's motion.
    closing : (K,) float64 in [0, 1]
        Part of it that ``mouthClose`` takes back.
    residual : (5, V, 3) float64, mm
        What the sculpted shapes hold besides: ``jawOpen``, ``jawForward``, ``jawLeft``,
        ``jawRight``, ``mouthClose``.
    """

    rows: NDArray[np.int64]
    share: Floats
    closing: Floats
    residual: Floats


JAW_SHAPES = ("jawOpen", "jawForward", "jawLeft", "jawRight", "mouthClose")


class JawMotion:
    """The mandible as one rigid body, and the skin that follows it.

    With opening a, protrusion f and sidewards motion l = left − right,

        p' = c + g + Ry(ψ) Rx(θ) (p − c),   θ = Θ a,   ψ = 4.2° l,

    where c is the middle of the hinge and g its glide: a² (2 − a) × 10 mm forward and down the
    slope of the joint, f × (0, −1.5, 8.3) mm, and for sidewards motion the glide that leaves the
    condyle of that side in place, but for a shift of 1.2 mm. Skin goes a share s of the way:
    angles s θ and s ψ, glide s g. Lengths are scaled to the head's mandible; Θ, some 20°, is such
    that the incisors are 42 mm apart at full opening.

    Parameters
    ----------
    head : Head
        With feature points 9.10 and 9.11, the edges of the incisors.

    Attributes
    ----------
    pivot : (3,) float64, mm
        Middle of the hinge axis.
    scale : float
        Of the mandible against an adult's.
    full_rad : float
        Θ.
    """

    def __init__(self, head: Head) -> None:
        self.pivot = np.array(head.jaw_pivot)
        upper, lower = head.points["9.10"], head.points["9.11"]
        self.scale = float(np.linalg.norm((lower - self.pivot)[1:])) / MANDIBLE_MM
        self.full_rad = 0.0

        def too_wide(angle: float) -> float:
            self.full_rad = angle
            return float(np.linalg.norm(self.pose(1, 0, 0).apply(lower) - upper)) - (
                OPEN_MM * self.scale
            )

        self.full_rad = float(brentq(too_wide, *_OPEN_BOUNDS_RAD, xtol=1e-10))

    def angles_and_glide(self, opening: float, forward: float, left: float) -> Floats:
        """θ, ψ (rad) and g (mm), (5,) float64."""
        theta, psi = self.full_rad * opening, LATERAL_RAD * left
        glide = GLIDE_MM * opening**2 * (2 - opening)
        g = glide * np.array([0.0, -np.sin(GLIDE_SLOPE_RAD), np.cos(GLIDE_SLOPE_RAD)])
        g = g + forward * FORWARD_MM
        # the axis of turning lies on the side the jaw goes to: the middle comes forward
        size = np.sqrt(psi**2 + _SOFT_RAD**2) - _SOFT_RAD
        g = g + np.array([SHIFT_MM * left, 0.0, CONDYLE_HALF_DISTANCE_MM * np.sin(size)])
        return np.array([theta, psi, *(self.scale * g)])

    def pose(self, opening: float, forward: float, left: float) -> Rigid:
        """The mandible's motion from rest."""
        theta, psi, *g = self.angles_and_glide(opening, forward, left)
        R = _turn(theta, psi)
        return Rigid.from_rotation(R, self.pivot + g - R @ self.pivot)


def smooth_min(a: float, b: float) -> float:
    """The smaller of two weights, C1, and exactly 0 where either is 0."""

    def blend(x: float, y: float) -> float:
        return 0.5 * (x + y + _MIN_WIDTH - float(np.hypot(x - y, _MIN_WIDTH)))

    return blend(a, b) - blend(a, 0.0) - blend(0.0, b)


@cache
def jaw_skin() -> JawSkin:
    """Fit the skin's shares to the sculpted shapes (about 0.2 s, once a process)."""
    template = load_template()
    v = template.vertices
    offsets = {
        n: template.arkit[template.arkit_names.index(n)].astype(np.float64) for n in JAW_SHAPES
    }
    teeth, skin = template.vertices_of("teeth_lower"), template.vertices_of("skin")
    turn, pivot_shift, pivot = _sculpted_hinge(v[teeth], offsets["jawOpen"][teeth])
    skin_opens = offsets["jawOpen"][skin]
    levels = np.linspace(0, 1, 101)
    misfit = np.empty((len(levels), len(skin)))
    for i, s in enumerate(levels):
        moved = _part_way(v[skin], s, turn, pivot, pivot_shift)
        misfit[i] = ((moved - skin_opens) ** 2).sum(axis=1)
    raw = np.zeros(len(v))
    raw[skin] = levels[misfit.argmin(axis=0)]
    share = _smoothed(template, raw)[skin]
    length = (skin_opens**2).sum(axis=1)
    back = -(offsets["mouthClose"][skin] * skin_opens).sum(axis=1)
    raw = np.zeros(len(v))
    raw[skin] = np.clip(np.divide(back, length, out=np.zeros_like(back), where=length > 1.0), 0, 1)
    closing = _smoothed(template, raw)[skin]
    rows = np.flatnonzero(share > 1e-3)
    residual = np.zeros((len(JAW_SHAPES), len(v), 3))
    # the sculpted jaw goes forward and sideways without turning
    straight = {n: offsets[n][teeth].mean(axis=0) for n in JAW_SHAPES[1:4]}
    opened = _part_way(v[skin], share[:, None], turn, pivot, pivot_shift)
    residual[0, skin] = skin_opens - opened
    for i, n in enumerate(JAW_SHAPES[1:4], start=1):
        residual[i, skin] = offsets[n][skin] - share[:, None] * straight[n]
    residual[4, skin] = offsets["mouthClose"][skin] + closing[:, None] * skin_opens
    for name in ("teeth_lower", "tongue", "teeth_upper"):
        residual[:, template.vertices_of(name)] = 0.0
    return JawSkin(skin[rows], share[rows], closing[rows], residual)


def _turn(theta: float, psi: float) -> Floats:
    """Ry(ψ) Rx(θ)."""
    c, s, C, S = np.cos(theta), np.sin(theta), np.cos(psi), np.sin(psi)
    return np.array([[C, S * s, S * c], [0, c, -s], [-S, C * s, C * c]])


def _sculpted_hinge(at: Floats, offsets: Floats) -> tuple[float, Floats, Floats]:
    """Angle, shift and pivot of the rigid motion nearest to the sculpted opening."""
    pivot = np.array([0.0, -38.0, -72.0])
    to = at + offsets
    R, _ = Rotation.align_vectors(to - to.mean(axis=0), at - at.mean(axis=0))
    angle = float(R.as_rotvec()[0])
    shift = to.mean(axis=0) - R.apply(at.mean(axis=0) - pivot) - pivot
    shift[0] = 0.0
    return angle, shift, pivot


def _part_way(
    p: Floats, share: Floats | float, angle: float, pivot: Floats, shift: Floats
) -> Floats:
    """Displacements of points that go a share of the way of a hinge motion about x."""
    s = np.broadcast_to(np.asarray(share, dtype=np.float64).reshape(-1, 1), (len(p), 1))[:, 0]
    c, d = np.cos(s * angle), np.sin(s * angle)
    r = p - pivot
    y, z = r[:, 1] * c - r[:, 2] * d, r[:, 1] * d + r[:, 2] * c
    return np.stack([r[:, 0], y, z], axis=1) - r + s[:, None] * shift


def _smoothed(template: Template, values: Floats) -> Floats:
    """Averages over neighbours, a few rounds."""
    t = template.triangles
    i = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    n = len(values)
    links = sparse.csr_matrix((np.ones(len(i)), (i[:, 0], i[:, 1])), (n, n))
    links = ((links + links.T) > 0).astype(np.float64)
    mean = sparse.diags(1 / np.maximum(np.asarray(links.sum(axis=1)).ravel(), 1)) @ links
    for _ in range(_SMOOTHING_ROUNDS):
        values = 0.5 * values + 0.5 * (mean @ values)
    return np.asarray(values)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def add_jaw(
    out: Floats,
    rest: Floats,
    rows: NDArray[np.int64],
    share: Floats,
    closing: Floats,
    pivot: Floats,
    motion: Floats,
    closed: Floats,
) -> None:
    """Move skin by its share of `motion`, less what ``mouthClose`` takes back of `closed`.

    Both are `JawMotion.angles_and_glide`; `out` and `rest` are (V, 3) mm.
    """
    for k in range(len(rows)):
        v = rows[k]
        x, y, z = rest[v, 0] - pivot[0], rest[v, 1] - pivot[1], rest[v, 2] - pivot[2]
        for part in range(2):
            m = motion if part == 0 else closed
            sign = 1.0 if part == 0 else -closing[k]
            if sign == 0.0:
                continue
            s = share[k]
            c, d = np.cos(s * m[0]), np.sin(s * m[0])
            C, S = np.cos(s * m[1]), np.sin(s * m[1])
            y1, z1 = c * y - d * z, d * y + c * z
            x2, z2 = C * x + S * z1, -S * x + C * z1
            out[v, 0] += sign * (x2 - x + s * m[2])
            out[v, 1] += sign * (y1 - y + s * m[3])
            out[v, 2] += sign * (z2 - z + s * m[4])
