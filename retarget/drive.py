"""From FAPs to a head that moves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..core.clip import Clip
from ..core.errors import InputError
from ..core.head_motion import HeadMotion
from ..core.mpeg4 import ANGLE_UNIT_RAD, Fap, fap_by_name, fap_table, rotation_of_faps
from ..core.rigid import quaternion_from_rotation
from ..heads.head import Head
from .animation import HeadAnimation, PartMotion
from .auxiliary_points import PREFIX, auxiliary_model
from .controls import (
    COMPLETIONS,
    REACH_MM,
    place_controls,
    size_of,
)
from .deformer import FeaturePointDeformer
from .fap_rules import complete_faps
from .followers import Followers
from .jaw import CHIN, jaw_motion
from .lid_meeting import LidMeeting
from .limits import HeadLimits
from .lip_meeting import LipMeeting, LipSeam
from .riders import bend_tongue, with_lashes_and_tongue

#: Share of the distance to the nearest point over which the weights are smoothed.
SMOOTHING = 0.5
#: Upper and lower point of each pair on the inner contour of the lips.
LIP_MEETINGS = (("2.2", "2.3"), ("2.6", "2.8"), ("2.7", "2.9"))
_MORE_MEETINGS = tuple((f"{PREFIX}upper_inner.{k}", f"{PREFIX}lower_inner.{k}") for k in range(4))
#: FAPs that no head shows: pupils are painted, and the tongue does not roll.
_NEVER_SHOWN = ("dilate_l_pupil", "dilate_r_pupil", "tongue_roll")

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
    weights : str
        How displacements are spread over the skin, see `FeaturePointDeformer`.
    auxiliary : bool
        Whether points between the feature points move as expressions have taught
        (`auxiliary_points`). False: by the feature points and what is added by geometry alone.
    smoothing : float
        Of Kshirsagar's weights, see `FeaturePointDeformer`; 0 for the weights of the paper.
    fade : bool

    Raises
    ------
    InputError
        If the head lacks a skin or the feature points.
    """

    def __init__(
        self,
        head: Head,
        *,
        weights: str = "kshirsagar",
        auxiliary: bool = True,
        smoothing: float = SMOOTHING,
        fade: bool = True,
    ) -> None:
        self.head = head
        model = auxiliary_model() if auxiliary else None
        self.controls = place_controls(head, model)
        skin = head.mesh.triangles[head.mesh.groups["skin"]]
        on_skin = FeaturePointDeformer(
            head.mesh.vertices,
            skin,
            self.controls.points,
            self.controls.constraints,
            still=self.controls.still,
            fade=fade,
            smoothing=smoothing,
            weights=weights,
            reach_mm=REACH_MM * size_of(head),
        )
        self.limits = HeadLimits(head)
        self._lips = LipMeeting(head, on_skin.points, LIP_MEETINGS)
        self._more_lips = LipMeeting(head, on_skin.points, _MORE_MEETINGS)
        self._lids = LidMeeting(head, self.controls, on_skin)
        self._seam = LipSeam(head, self._lids.deformer)
        on_skin = self._seam.deformer
        self.deformer = with_lashes_and_tongue(head, skin, on_skin, self.controls)
        if model is not None:
            self.deformer = self.deformer.led(Followers.of(model, self.deformer.points))

    @property
    def dead_faps(self) -> tuple[str, ...]:
        """FAPs 3 to 68 that this head does not show, by name.

        Those that no head shows, and those whose feature point or part it lacks.
        """
        return tuple(fap.name for fap in fap_table()[2:] if self._is_dead(fap))

    def _is_dead(self, fap: Fap) -> bool:
        if fap.name in _NEVER_SHOWN:
            return True
        if fap.name.endswith("_eyeball"):
            side = "left" if "_l_" in fap.name else "right"
            return side not in self.head.eyes or f"eye_{side}" not in self.head.mesh.groups
        return fap.direction is not None and not any(
            point in self.deformer.points.names for point in fap.feature_points
        )

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
        return self._displacements(self.limits.bent(complete_faps(clip)), len(clip.time_s))

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
        faps, n = self.limits.bent(complete_faps(clip)), len(clip.time_s)
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
        bend_tongue(found, self.deformer.points, self.head, faps, jaw_motion(self.head, faps, n))
        self._lids.meet(found, faps)
        self._lips.meet(found)
        self._complete(found)
        followers = self.deformer.followers
        if followers is not None:
            found.reshape(n, -1)[:, followers.rows] = 0.0
            followed = followers.follow(found)
            pressed = followed.copy()
            self._more_lips.meet(pressed)
            found += pressed - followed
        self._seam.close(found)
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
