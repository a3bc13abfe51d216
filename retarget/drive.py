"""From FAPs to a head that moves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.head_motion import HeadMotion
from ..core.mpeg4 import ANGLE_UNIT_RAD, Fap, fap_by_name, fap_table, rotation_of_faps
from ..core.rigid import quaternion_from_rotation
from ..heads.head import Head
from ..heads.raycast import RayScene
from .animation import HeadAnimation, PartMotion
from .controls import COMPLETIONS, TONGUE_CONTROLS, Controls, joined_points, place_controls, size_of
from .deformer import FeaturePointDeformer
from .fap_rules import complete_faps
from .jaw import CHIN, jaw_motion
from .lid_points import PRESS_MM, lid_opening

#: Share of the distance to the nearest point over which the weights are smoothed.
SMOOTHING = 0.5
#: Lips may be pressed together this far, mm; what exceeds it is taken back from both.
LIP_PRESS_MM = 0.5
#: Upper and lower point of each pair on the inner contour of the lips.
LIP_MEETINGS = (("2.2", "2.3"), ("2.6", "2.8"), ("2.7", "2.9"))
#: Lids: edge points of the middle, and the FAPs that move them.
_LIDS = {
    "left": ("3.1", "3.3", "close_t_l_eyelid", "close_b_l_eyelid"),
    "right": ("3.2", "3.4", "close_t_r_eyelid", "close_b_r_eyelid"),
}
#: A lid opens at most this much of its gap beyond rest.
_WIDEST = 0.7
#: Skin this near to points on a lid's edge carries lashes.
_LASH_ROOT_MM = 2.5

Faps = Mapping[str, NDArray[np.float64]]


class HeadDrive:
    """Moves a head by FAPs.

    The skin follows its control points (`controls.SKIN_CONTROLS`) through a
    `FeaturePointDeformer`; lashes go with the nearest skin; the tongue bends by FAPs 43 to 46.
    Eyes turn by FAPs 23 to 26 and shift by 27 and 28; jaw, lower teeth and tongue by 3, 14, 15;
    the head by 48 to 50. Not moved: pupils' size (29, 30), the rolling of the tongue (47),
    visemes and expressions (1, 2).

    Parameters
    ----------
    head : Head
    smoothing : float
        See `FeaturePointDeformer`; 0 for the weights of the paper.
    fade : bool

    Raises
    ------
    InputError
        If the head lacks a skin or the feature points.
    """

    def __init__(self, head: Head, *, smoothing: float = SMOOTHING, fade: bool = True) -> None:
        self.head = head
        self.controls = place_controls(head)
        skin = head.mesh.triangles[head.mesh.groups["skin"]]
        on_skin = FeaturePointDeformer(
            head.mesh.vertices,
            skin,
            self.controls.points,
            self.controls.constraints,
            still=self.controls.still,
            fade=fade,
            smoothing=smoothing,
        )
        self.deformer = _with_lashes_and_tongue(head, skin, on_skin, self.controls)
        self._gap_mm = {side: _middle_gap(head, skin, side) for side in _LIDS}

    def feature_point_displacements(self, clip: Clip) -> NDArray[np.float64]:
        """Displacements of the deformer's points, (T, N, 3) float64, mm, head frame.

        A feature point's component along a FAP's direction is the FAP's value times its unit,
        except where a limit is met: lids and lips stop where they meet, the jaw does not close
        beyond rest. FAPs that are not given follow `complete_faps`.

        Raises
        ------
        InputError
            If the clip holds no FAP.
        """
        return self._displacements(complete_faps(clip), len(clip.time_s))

    def animate(self, clip: Clip, motion: HeadMotion | None = None) -> HeadAnimation:
        """The head moving as a clip says.

        Parameters
        ----------
        clip : Clip
            Of FAPs.
        motion : HeadMotion or None
            World from head, at the clip's times; None: FAPs 48 to 50 about the neck's pivot.

        Raises
        ------
        InputError
            If the clip holds no FAP, or the motion has other times or gaps.
        """
        faps, n = complete_faps(clip), len(clip.time_s)
        if motion is None:
            motion = self._motion(faps, clip.time_s)
        _check_motion(motion, clip)
        return HeadAnimation(
            self.head,
            self.deformer,
            clip.time_s,
            self._displacements(faps, n),
            self._parts(faps, n),
            motion,
        )

    def _displacements(self, faps: Faps, n: int) -> NDArray[np.float64]:
        points = self.deformer.points
        found = np.zeros((n, len(points), 3))
        for fap in fap_table():
            direction = fap.direction
            if direction is None or fap.name not in faps:
                continue
            for name in fap.feature_points:
                if name in points.names:
                    along = faps[fap.name] * self.head.fapu.unit(fap)
                    found[:, points.index(name)] += along[:, None] * direction
        self._carry_with_jaw(found, faps, n)
        self._meet_lids(found, faps)
        self._meet_lips(found)
        self._complete(found)
        return found

    def _carry_with_jaw(self, found: NDArray[np.float64], faps: Faps, n: int) -> None:
        jaw = jaw_motion(self.head, faps, n)
        rest = self.deformer.points.at(self.head.mesh.vertices)
        letters = self.controls.letters
        chin_lift = np.zeros(n)
        if CHIN in letters and _says_something(faps, "depress_chin"):
            i = self.deformer.points.index(CHIN)
            chin_lift = found[:, i, 1] - jaw.displacement(rest[i])[:, 1]
        for i, name in enumerate(self.deformer.points.names):
            word = letters.get(name, "")
            if name == "2.1":
                found[:, i] = jaw.displacement(rest[i])
            elif "J" in word:
                found[:, i] = jaw.displacement(rest[i])
                share = {CHIN: 1.0, "2.11": 0.5, "2.12": 0.5}.get(name, 0.0)
                found[:, i, 1] += share * chin_lift

    def _meet_lids(self, found: NDArray[np.float64], faps: Faps) -> None:
        index = self.deformer.points.index
        for side, (top, bottom, close_top, close_bottom) in _LIDS.items():
            gap = self._gap_mm[side]
            if side not in self.head.eyes or not {top, bottom} <= set(self.controls.letters):
                continue
            down, up = (self._mm(faps, name, len(found)) for name in (close_top, close_bottom))
            if gap is None:  # no eyeball shows: nothing to slide on
                continue
            gap += PRESS_MM
            down, up = (np.maximum(a, -_WIDEST * gap) for a in (down, up))
            excess = np.maximum(down + up - gap, 0.0)
            closing = np.maximum(down, 0) + np.maximum(up, 0) + 1e-12
            down, up = (a - excess * np.maximum(a, 0) / closing for a in (down, up))
            self._slide(found, index(top), side, -down)
            self._slide(found, index(bottom), side, up)
            for lid in self.controls.lids:
                if lid.side == side:
                    part = -down / gap if lid.upper else up / gap
                    rise = part * (lid.gap_mm + PRESS_MM) * lid.share
                    self._slide(found, index(lid.name), side, rise)

    def _slide(
        self, found: NDArray[np.float64], i: int, side: str, rise_mm: NDArray[np.float64]
    ) -> None:
        """Move a point up, on the sphere about the eye's centre that it lies on at rest."""
        p = self.deformer.points.at(self.head.mesh.vertices)[i] - self.head.eyes[side].centre
        squared = p @ p - p[0] ** 2 - (p[1] + rise_mm) ** 2
        found[:, i, 1] = rise_mm
        found[:, i, 2] = np.sqrt(np.maximum(squared, 0.0)) - max(p[2], 0.0)

    def _meet_lips(self, found: NDArray[np.float64]) -> None:
        names = self.deformer.points.names
        for upper, lower in LIP_MEETINGS:
            if upper in names and lower in names:
                u, l = names.index(upper), names.index(lower)
                excess = np.maximum(found[:, l, 1] - found[:, u, 1] - LIP_PRESS_MM, 0.0)
                found[:, u, 1] += excess / 2
                found[:, l, 1] -= excess / 2

    def _complete(self, found: NDArray[np.float64]) -> None:
        names = self.deformer.points.names
        for (name, axis), sources in COMPLETIONS.items():
            if name in names:
                found[:, names.index(name), axis] = sum(
                    share * found[:, names.index(source), its]
                    for source, its, share in sources
                    if source in names
                )

    def _mm(self, faps: Faps, name: str, n: int) -> NDArray[np.float64]:
        fap: Fap = fap_by_name()[name]
        return faps[name] * self.head.fapu.unit(fap) if name in faps else np.zeros(n)

    def _parts(self, faps: Faps, n: int) -> dict[str, PartMotion]:
        found: dict[str, PartMotion] = {}
        jaw = jaw_motion(self.head, faps, n)
        for part in ("teeth_lower", "tongue"):
            if part in self.head.mesh.groups:
                found[part] = jaw
        for side, eye in self.head.eyes.items():
            if f"eye_{side}" not in self.head.mesh.groups:
                continue
            s, rest = side[0], np.zeros(n)
            turns = np.stack(
                [faps.get(f"{turn}_{s}_eyeball", rest) for turn in ("yaw", "pitch")], axis=1
            )
            rotation = Rotation.from_euler("YX", turns * ANGLE_UNIT_RAD)  # Ry(yaw) Rx(pitch)
            shift = np.zeros((n, 3))
            shift[:, 2] = self._mm(faps, f"thrust_{s}_eyeball", n)
            quaternion = rotation.as_quat(scalar_first=True)
            found[f"eye_{side}"] = PartMotion(eye.centre, quaternion, shift)
        return found

    def _motion(self, faps: Faps, time_s: NDArray[np.float64]) -> HeadMotion:
        rest = np.zeros(len(time_s))
        turns = [faps.get(f"head_{turn}", rest) for turn in ("pitch", "yaw", "roll")]
        rotation = rotation_of_faps(np.stack(turns, axis=1))
        pivot = self.head.neck_pivot
        return HeadMotion(time_s, quaternion_from_rotation(rotation), pivot - rotation @ pivot)


def _says_something(faps: Faps, name: str) -> bool:
    """Whether a FAP is given and ever differs from 0.

    Encoders that always write all FAPs say 0 for those they know nothing about.
    """
    return name in faps and bool(faps[name].any())


def _check_motion(motion: HeadMotion, clip: Clip) -> None:
    same = motion.time_s.shape == clip.time_s.shape
    if not same or not np.allclose(motion.time_s, clip.time_s, atol=1e-3):
        raise InputError("the head's motion and the clip have other times: resample one of them")
    if not (np.isfinite(motion.quaternion).all() and np.isfinite(motion.translation).all()):
        raise InputError("the head's motion has gaps: fill them first")


def _middle_gap(head: Head, skin: NDArray[np.int32], side: str) -> float | None:
    xs, heights = lid_opening(head, skin, side)
    top = _LIDS[side][0]
    if not len(xs) or top not in head.points:
        return None
    at = head.points[top][0]
    return float(np.interp(at, xs, heights[:, 0]) - np.interp(at, xs, heights[:, 1]))


def _with_lashes_and_tongue(
    head: Head, skin: NDArray[np.int32], on_skin: FeaturePointDeformer, controls: Controls
) -> FeaturePointDeformer:
    """The skin's deformer, with lashes that follow the edge of the lid and a tongue that bends."""
    carry = _lash_rows(head, skin, controls)
    names = tuple(n for n in TONGUE_CONTROLS if n in head.feature_points.names)
    if "tongue" not in head.mesh.groups or "6.1" not in names:
        names = ()
    bend = _tongue_table(head, names)
    tables = []
    for axis, table in enumerate(on_skin.tables):
        on_axis = np.array([TONGUE_CONTROLS[n][axis] != "-" for n in names], dtype=np.float64)
        tongue = bend @ sparse.diags(on_axis) if names else bend
        tables.append(sparse.hstack([table + carry @ table, tongue]).tocsr())
    points = joined_points(on_skin.points, (head.feature_points.select(names),))
    return on_skin.joined(points, tuple(tables))


def _lash_rows(head: Head, skin: NDArray[np.int32], controls: Controls) -> sparse.csr_matrix:
    """(V, V): for each lash vertex, the corners of the skin that carries it.

    That is the nearest skin along the edges of the lids, so that lashes keep their shape while
    the lid behind them stretches.
    """
    v = head.mesh.vertices
    lashes = head.part_vertices("lashes")
    if not len(lashes):
        return sparse.csr_matrix((len(v), len(v)))
    edge = [lid.point.at(v)[0] for lid in controls.lids if lid.share == 1.0]
    edge += [head.points[n] for n in ("3.1", "3.2", "3.3", "3.4") if n in head.points]
    near = skin[_closest_mm(v[skin].mean(axis=1), np.array(edge)) < _LASH_ROOT_MM * size_of(head)]
    surface = near if len(near) else skin
    _, triangle, b = RayScene(v, surface).closest(v[lashes])
    place = (np.repeat(lashes, 3), surface[triangle].ravel())
    return sparse.csr_matrix((b.ravel(), place), (len(v), len(v)))


def _closest_mm(points: NDArray[np.float64], targets: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(cKDTree(targets).query(points)[0])


def _tongue_table(head: Head, names: tuple[str, ...]) -> sparse.csr_matrix:
    """(V, n): how much of the tip's (6.1) and the body's (6.2) motion the tongue's vertices make.

    By depth alone: the root stays, the body's share has its peak at 6.2, the tip's grows on.
    """
    n_vertices = len(head.mesh.vertices)
    if not names:
        return sparse.csr_matrix((n_vertices, 0))
    rows = head.part_vertices("tongue")
    z = head.mesh.vertices[rows, 2]
    tip, root = head.points["6.1"][2], z.min()
    body = head.points["6.2"][2] if "6.2" in names else (tip + root) / 2
    to_tip = _smoothstep((z - body) / (tip - body))
    shares = {"6.1": to_tip, "6.2": _smoothstep((z - root) / (body - root)) * (1 - to_tip)}
    dense = np.zeros((n_vertices, len(names)))
    for column, name in enumerate(names):
        dense[rows, column] = shares[name]
    return sparse.csr_matrix(dense)


def _smoothstep(t: NDArray[np.float64]) -> NDArray[np.float64]:
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)
