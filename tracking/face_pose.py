"""Where a face is and what it does, in one picture or several of one instant.

Pose and expression are found together: the most likely ones under the measurement model
(`landmark_noise`), by Gauss-Newton steps with Student's t as the noise of single points, so that
points under a hand do not count. The errors that points have in common enter by their covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from ..core.arrays import readonly
from ..heads.place_face_landmarks import template_face_landmarks
from ..heads.template import load_template
from .landmark_noise import LandmarkModel, upright, view_terms

Floats = NDArray[np.float64]
#: Degrees of freedom of the noise of single points.
_STUDENT = 6.0
_MOST_STEPS = 30
#: A step that moves points and components less is the last: the next one is far smaller.
_DONE_MM = 0.15
#: A landmark whose skin faces the camera by less than this cosine is not quite seen; by how much
#: it is off when it is seen from the side.
_GRAZING, _HIDDEN_MM = 0.5, 3.0
#: Faces turned this far were learnt from; beyond it several cameras' views fade.
_LEARNT_RAD, _FADES_RAD = np.deg2rad((35.0, 10.0))


@dataclass(frozen=True, eq=False)
class View:
    """What one camera sees at one instant.

    Attributes
    ----------
    xy : (n, 2) float64
        Ideal coordinates of the model's landmarks; NaN where unknown.
    sd : (n,) float64
        Of their own errors, same unit.
    rotation, translation : (3, 3), (3,) mm
        Camera from world.
    irises : (2, 2) float64 or None
        Ideal coordinates of the right and the left iris as measured; NaN where unseen, None where
        not looked for.
    offsets : (n, 2) float64, mm, or None
        By which this camera sees the person's landmarks beside what the model says, picture turned
        upright (`with_own_offsets`).
    """

    xy: Floats
    sd: Floats
    rotation: Floats
    translation: Floats
    irises: Floats | None = None
    offsets: Floats | None = None


@dataclass(frozen=True, eq=False)
class FaceState:
    """A face at one instant.

    Attributes
    ----------
    rotation, translation : (3, 3), (3,) float64, mm
        World from head.
    expression : (K,) float64
        c of the model.
    covariance : (6 + K, 6 + K) float64
        Of errors: turn about the world's axes, rad; shift, mm; c.
    misfit : float
        Mean square of the landmarks' whitened residuals; about 1 if the model holds.
    left : (n, 2) float64, mm, picture turned upright
        What the model leaves of the landmarks, the mean of the views; 0 where unknown.
    """

    rotation: Floats
    translation: Floats
    expression: Floats
    covariance: Floats
    misfit: float
    left: Floats

    def __post_init__(self) -> None:
        K = len(self.expression)
        shapes: dict[str, tuple[int | None, ...]] = {
            "rotation": (3, 3), "translation": (3,), "expression": (K,),
        }  # fmt: skip
        shapes |= {"covariance": (6 + K, 6 + K), "left": (None, 2)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))


class FaceSolver:
    """Finds the state of one person's face.

    Parameters
    ----------
    model : LandmarkModel
    rest : (n, 3) float64, mm, head frame
        The person's landmarks at rest, their own offsets included.
    """

    def __init__(self, model: LandmarkModel, rest: Floats) -> None:
        self._model, self._rest = model, readonly(rest, (len(model.numbers), 3), "rest")
        self._gain = np.ascontiguousarray(model.gain.reshape(model.n_components, -1).T)
        self._modes = np.ascontiguousarray(model.modes.reshape(len(model.modes), -1).T)

    def solve(self, views: list[View], start: FaceState) -> FaceState:
        """The most likely state near a start.

        Parameters
        ----------
        views : list of View
            With at least one known landmark.
        start : FaceState
        """
        R, t, c = start.rotation.copy(), start.translation.copy(), start.expression.copy()
        K = len(c)
        for _ in range(_MOST_STEPS):
            moved = self._rest + (self._gain @ c).reshape(-1, 3)
            H = np.zeros((6 + K, 6 + K))
            H[6:, 6:] = np.eye(K)
            pull = np.concatenate([np.zeros(6), -c])
            misfit, left = [], np.zeros_like(self._rest[:, :2])
            for view in views:
                its_H, its_pull, off, its_left = self._normal(view, R, t, moved)
                share = view_trust(view, R, t) if len(views) > 1 else 1.0
                H += share * its_H
                pull += share * its_pull
                misfit.append(off)
                left += its_left / len(views)
            d = cho_solve(cho_factor(H), pull)
            turn = Rotation.from_rotvec(d[:3]).as_matrix()
            R, t, c = turn @ R, t + d[3:6], c + d[6:]
            moves = 80 * np.abs(d[:3]).max() + np.abs(d[6:]).max()
            if moves < _DONE_MM:
                break
        C = np.asarray(np.linalg.inv(H), np.float64)
        return FaceState(R, t, c, C, float(np.mean(misfit)), left)

    def _normal(
        self, view: View, R: Floats, t: Floats, moved: Floats
    ) -> tuple[Floats, Floats, float, Floats]:
        """Normal equations (6 + K) of one picture, its misfit, and what is left (n, 2)."""
        m = self._model
        known, left, slope, out, depth = self._residuals(view, R, t, moved)
        J = self._jacobian(slope, view.rotation, R, out)
        own = m.sd**2 + ((view.sd * depth) ** 2)[:, None]
        own = own + _turned_away(view.rotation @ R, out, t, view)[:, None]
        own = np.where(known[:, None], own, np.inf).ravel()
        return *self._whitened(J, left.ravel(), own), left

    def left_over(self, view: View, state: FaceState) -> Floats:
        """What the model leaves of one picture's landmarks, (n, 2) mm, picture turned upright;
        0 where unknown."""
        moved = self._rest + (self._gain @ state.expression).reshape(-1, 3)
        return self._residuals(view, state.rotation, state.translation, moved)[1]

    def _residuals(
        self, view: View, R: Floats, t: Floats, moved: Floats
    ) -> tuple[NDArray[np.bool_], Floats, Floats, Floats, Floats]:
        """Which are known (n,), what is left (n, 2), its slopes (n, 2, 3), landmarks from the
        head's origin (n, 3) and their depths (n,), in the camera's axes."""
        known = ~np.isnan(view.xy[:, 0])
        RC = view.rotation @ R
        tC = view.rotation @ t + view.translation
        out = moved @ RC.T
        P = out + tC
        Q = upright(RC)
        xy = np.where(known[:, None], view.xy, 0.0)
        slope = Q @ np.concatenate(
            [np.broadcast_to(np.eye(2), (len(P), 2, 2)), -xy[..., None]], axis=2
        )
        bias = np.tensordot(view_terms(-RC.T @ tC), self._model.bias, 1)
        left = (xy * P[:, 2:] - P[:, :2]) @ Q.T - bias
        if view.offsets is not None:
            left = left - view.offsets
        return known, np.where(known[:, None], left, 0.0), slope, out, P[:, 2]

    def _jacobian(self, slope: Floats, world: Floats, R: Floats, out: Floats) -> Floats:
        """Of -left: (2n, 6 + K)."""
        n = len(slope)
        in_world = slope @ world  # of shifts in the world's axes
        arm = out @ world  # R moved, world axes
        turns = np.cross(arm[:, None, :], in_world)  # slope (ω × arm) = (arm × slope)ᵀ ω
        in_head = (in_world @ R)[:, :, :, None]
        gain = self._gain.reshape(n, 3, -1)
        follows = in_head[:, :, 0] * gain[:, None, 0]
        follows += in_head[:, :, 1] * gain[:, None, 1]
        follows += in_head[:, :, 2] * gain[:, None, 2]
        return np.concatenate([turns, in_world, follows], axis=2).reshape(2 * n, -1)

    def _whitened(self, J: Floats, r: Floats, own: Floats) -> tuple[Floats, Floats, float]:
        """JᵀR⁻¹J, JᵀR⁻¹r of R = diag(own) + modes modesᵀ, points that stray counting less."""
        w = np.where(np.isinf(own), 0.0, 1.0 / own)
        strays = (r**2 * w).reshape(-1, 2).sum(axis=1)
        # far from the solution all points stray: what counts is which stray more than most
        strays /= max(1.0, float(np.median(strays[w[::2] > 0])))
        w = w * np.repeat((_STUDENT + 2) / (_STUDENT + strays), 2)
        root = np.sqrt(w)[:, None]
        Jw, Uw, rw = J * root, self._modes * root, r * root[:, 0]
        S = cho_factor(np.eye(Uw.shape[1]) + Uw.T @ Uw)
        JU, rU = Jw.T @ Uw, Uw.T @ rw
        H = Jw.T @ Jw - JU @ cho_solve(S, JU.T)
        pull = Jw.T @ rw - JU @ cho_solve(S, rU)
        misfit = (rw @ rw - rU @ cho_solve(S, rU)) / max(1, int((w > 0).sum()))
        return H, pull, float(misfit)


def _turned_away(RC: Floats, out: Floats, t: Floats, view: View) -> Floats:
    """What landmarks (n,) that the camera cannot see are off besides, as variances, mm²."""
    P = out + (view.rotation @ t + view.translation)
    facing = -np.einsum("nx,nx->n", _normals() @ RC.T, P) / np.linalg.norm(P, axis=1)
    return np.asarray((_HIDDEN_MM * np.clip((_GRAZING - facing) / _GRAZING, 0, None)) ** 2)


@cache
def _normals() -> Floats:
    """Of the template's skin at its landmarks, (n, 3), outwards."""
    a, b, c = np.moveaxis(load_template().vertices[template_face_landmarks().corners], 1, 0)
    across = np.cross(b - a, c - a)
    return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))


def view_trust(view: View, R: Floats, t: Floats) -> float:
    """How much a view counts beside others: little where the face is turned further than learnt."""
    RC, tC = view.rotation @ R, view.rotation @ t + view.translation
    to_camera = -RC.T @ tC / np.linalg.norm(tC)
    angle = float(np.arccos(np.clip(to_camera[2], -1, 1)))
    return float(1 / (1 + (max(0.0, angle - _LEARNT_RAD) / _FADES_RAD) ** 2) ** 2)


def with_own_offsets(
    solver: FaceSolver,
    frames: list[list[View]],
    neutral: dict[int, FaceState],
) -> list[list[View]]:
    """Views of several cameras, each with what it shows of the neutral face beside the model.

    What the network does to a face depends on the side it sees it from; each camera has its own.

    Parameters
    ----------
    solver : FaceSolver
    frames : list of lists of View
        With their cameras' poses; views of one camera have the same.
    neutral : dict
        States of the neutral frames by their numbers.
    """
    seen: dict[bytes, list[Floats]] = {}
    for frame, state in neutral.items():
        for view in frames[frame]:
            left = solver.left_over(view, replace(state, expression=0 * state.expression))
            unknown = np.isnan(view.xy)
            seen.setdefault(camera_of(view), []).append(np.where(unknown, np.nan, left))
    own = {}
    for camera, several in seen.items():
        table = np.stack(several)
        counted = np.isfinite(table).sum(axis=0)
        own[camera] = np.nansum(table, axis=0) / np.maximum(counted, 1)
    return [[replace(v, offsets=own.get(camera_of(v))) for v in views] for views in frames]


def camera_of(view: View) -> bytes:
    """What views of one camera have in common: its pose."""
    return view.rotation.tobytes() + view.translation.tobytes()
