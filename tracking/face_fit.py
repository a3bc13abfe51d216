"""A head of ours fitted to a neutral face, and the camera's focal length.

People's heads vary along the components of `heads.face_model`, each with variance 1, and in size.
The landmarks of some neutral frames, with what the network does to faces as their covariance, tell
which head is the most likely one. What they show beyond it is kept as the person's own offsets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from ..core.arrays import readonly
from ..core.mpeg4 import Fapu
from ..heads.face_model import face_model
from ..heads.head import Eye, Head
from ..heads.identity import Identity, make_head
from ..heads.place_face_landmarks import template_face_landmarks
from ..heads.template import load_template, template_feature_points
from .face_pose import View
from .landmark_noise import LandmarkModel, upright, view_terms

Floats = NDArray[np.float64]
#: People's variation beyond that is smaller than what landmarks tell.
N_SHAPES = 80
_SIZE_SD = 0.02  # beside what the components make of it
_STEPS = 12
_PLACE_SD_MM = 1e4
#: What is expected of a focal length that nobody gives: the picture's larger side times this.
USUAL_FOCAL, FOCAL_LOG_SD = 1.15, 0.35


@dataclass(frozen=True, eq=False)
class FittedFace:
    """A person's neutral face.

    Attributes
    ----------
    amounts : (S,) float64
        Of the components of `heads.face_model`, in their standard deviations.
    size : float
        Of the head relative to them.
    offsets : (n, 3) float64, mm, head frame
        By which the network sees the person's landmarks beside those of the fitted head.
    focal_px : float
        The geometric mean of fx and fy, given or estimated; `focal_sd_px` 0 if given.
    n_frames : int
        Neutral frames that it was found from.
    """

    amounts: Floats
    size: float
    offsets: Floats
    focal_px: float
    focal_sd_px: float
    n_frames: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "amounts", readonly(self.amounts, (None,), "amounts"))
        object.__setattr__(self, "offsets", readonly(self.offsets, (None, 3), "offsets"))

    @property
    def landmarks(self) -> Floats:
        """(n, 3) mm, head frame: the model's landmarks at rest as the network sees them."""
        return _shapes().landmarks(self.amounts, self.size) + self.offsets

    @property
    def feature_points(self) -> dict[str, Floats]:
        """Feature points at rest, (3,) mm each, head frame."""
        at = _shapes().feature_points(self.amounts, self.size)
        return dict(zip(template_feature_points().names, at, strict=True))

    @property
    def eyes(self) -> tuple[Eye, Eye]:
        """The right and the left eyeball."""
        shapes = _shapes()
        modes = shapes.eye_modes[: len(self.amounts)]
        right, left = self.size * (shapes.eyes + np.tensordot(self.amounts, modes, 1))
        radius = self.size * shapes.eye_radius
        return Eye(right, radius), Eye(left, radius)

    @property
    def fapu(self) -> Fapu:
        """The facial animation units of the fitted head."""
        return Fapu.from_points(self.feature_points)

    def identity(self, name: str = "fitted") -> Identity:
        """The person as weights of the template's targets."""
        model = face_model()
        weights = model.mean_targets + self.amounts @ model.targets[: len(self.amounts)]
        names = load_template().identity_names
        local = {n: float(w) for n, w in zip(names, weights, strict=True)}
        return Identity(name, local=local, size=self.size)

    def head(self, name: str = "fitted", *, texture_px: int = 512) -> Head:
        """The fitted head, to be animated."""
        return make_head(self.identity(name), texture_px=texture_px)


@dataclass(frozen=True, eq=False)
class _Shapes:
    """Landmarks and feature points of the mean person (n, 3), and of each component (S, n, 3);
    eyeballs' centres likewise (2, 3), and the mean person's radius of one, mm."""

    marks: Floats
    mark_modes: Floats
    points: Floats
    point_modes: Floats
    eyes: Floats
    eye_modes: Floats
    eye_radius: float

    def landmarks(self, amounts: Floats, size: float) -> Floats:
        modes = self.mark_modes[: len(amounts)]
        return np.asarray(size * (self.marks + np.tensordot(amounts, modes, 1)))

    def feature_points(self, amounts: Floats, size: float) -> Floats:
        modes = self.point_modes[: len(amounts)]
        return np.asarray(size * (self.points + np.tensordot(amounts, modes, 1)))


def landmark_shapes() -> tuple[Floats, Floats]:
    """Landmarks at rest, mm, head frame: the mean person's (n, 3), by components (S, n, 3)."""
    return _shapes().marks, _shapes().mark_modes


@cache
def _shapes() -> _Shapes:
    model, template = face_model(), load_template()
    balls = [template.vertices_of(f"eye_{side}") for side in ("right", "left")]
    both = np.concatenate(balls)
    marks, points = template_face_landmarks(), template_feature_points()

    def at(amounts: Floats) -> tuple[Floats, Floats, Floats]:
        v = model.whole(amounts)
        v = v - v[both].mean(axis=0)
        # middles between their ends: vertices are denser about the pupil
        ends = [(v[b].min(axis=0) + v[b].max(axis=0)) / 2 for b in balls]
        return marks.at(v), points.at(v), np.stack(ends)

    count = min(N_SHAPES, len(model.basis))
    mean = at(np.zeros(len(model.basis)))
    modes = [at(row) for row in np.eye(len(model.basis))[:count]]
    parts = [(m, np.stack([mode[i] - m for mode in modes])) for i, m in enumerate(mean)]
    ball = model.whole(np.zeros(len(model.basis)))[balls[0]]
    radius = float(np.ptp(ball, axis=0)[:2].mean() / 2)
    return _Shapes(*parts[0], *parts[1], *parts[2], radius)


@dataclass(eq=False)
class _Guess:
    amounts: Floats
    log_size: float
    log_focal: float  # of the true focal length over that of the given coordinates
    rotations: list[Floats]
    translations: list[Floats]


def fit_face(
    model: LandmarkModel,
    frames: Sequence[Sequence[View]],
    poses: Sequence[tuple[Floats, Floats]],
    *,
    focal_px: float,
    focal_log_sd: float = 0.0,
) -> FittedFace:
    """Fit a head to neutral frames.

    Parameters
    ----------
    model : LandmarkModel
    frames : sequence of frames, each a sequence of View
        Ideal coordinates by `focal_px`.
    poses : sequence of (rotation, translation)
        World from head in each frame, about.
    focal_px : float
    focal_log_sd : float
        How unsure the focal length is; 0: it is known.
    """
    S = len(_shapes().mark_modes)
    g = _Guess(np.array(model.people_mean), 0.0, 0.0, [R for R, _ in poses], [t for _, t in poses])
    H = np.eye(S + 2)
    for _ in range(_STEPS):
        H, step = _step(model, frames, g, focal_log_sd)
        g.amounts = g.amounts + step[:S]
        g.log_size += float(step[S])
        g.log_focal += float(np.clip(step[S + 1], -0.3, 0.3))
        for i in range(len(frames)):
            at = S + 2 + 6 * i
            g.rotations[i] = Rotation.from_rotvec(step[at : at + 3]).as_matrix() @ g.rotations[i]
            g.translations[i] = g.translations[i] + step[at + 3 : at + 6]
    focal = float(focal_px * np.exp(g.log_focal))
    sd = float(np.sqrt(np.linalg.inv(H)[S + 1, S + 1])) * focal if focal_log_sd else 0.0
    size = float(np.exp(g.log_size))
    rest = _shapes().landmarks(g.amounts, size)
    offsets = _offsets(model, frames, g, rest)
    return FittedFace(g.amounts, size, offsets, focal, sd, len(frames))


def _step(
    model: LandmarkModel, frames: Sequence[Sequence[View]], g: _Guess, focal_log_sd: float
) -> tuple[Floats, Floats]:
    """Hessian and Gauss-Newton step over (amounts, log size, log focal, poses)."""
    shapes, S, n_frames = _shapes(), len(g.amounts), len(frames)
    size = float(np.exp(g.log_size))
    rest = shapes.landmarks(g.amounts, size)
    N = S + 2 + 6 * n_frames
    prior = np.concatenate([model.people_sd**-2, [_SIZE_SD**-2, 1 / max(focal_log_sd, 1e-6) ** 2]])
    H = np.diag(np.concatenate([prior, np.full(6 * n_frames, _PLACE_SD_MM**-2)]))
    pull = np.zeros(N)
    pull[: S + 2] = -prior * np.concatenate(
        [g.amounts - model.people_mean, [g.log_size, g.log_focal]]
    )
    modes = np.concatenate([size * shapes.mark_modes, rest[None]])  # by amounts and log size
    for i, views in enumerate(frames):
        at = np.r_[: S + 2, S + 2 + 6 * i : S + 8 + 6 * i]
        for view in views:
            J, r, own = _rows(model, view, g, i, rest, modes)
            its_H, its_pull = _weighed(model, J, r, own)
            H[np.ix_(at, at)] += its_H / n_frames
            pull[at] += its_pull / n_frames
    return H, cho_solve(cho_factor(H), pull)


def _residuals(
    model: LandmarkModel, view: View, g: _Guess, i: int, rest: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """What is left in the upright picture (n, 2) mm, and what derivatives need."""
    R, t = view.rotation @ g.rotations[i], view.rotation @ g.translations[i] + view.translation
    out = rest @ R.T
    P = out + t
    Q = upright(R)
    xy = np.nan_to_num(view.xy) * np.exp(-g.log_focal)
    bias = np.tensordot(view_terms(-R.T @ t), model.bias, 1)
    left = (xy * P[:, 2:] - P[:, :2]) @ Q.T - bias
    return left, out, P, Q, xy


def _rows(
    model: LandmarkModel, view: View, g: _Guess, i: int, rest: Floats, modes: Floats
) -> tuple[Floats, Floats, Floats]:
    """Jacobian (2n, S + 8), residuals (2n,) and own variances (2n,) of one view."""
    left, out, P, Q, xy = _residuals(model, view, g, i, rest)
    known = ~np.isnan(view.xy[:, 0])
    eye = np.broadcast_to(np.eye(2), (len(P), 2, 2))
    slope = Q @ np.concatenate([eye, -xy[..., None]], axis=2) @ view.rotation
    shaped = np.einsum("nax,xy,kny->nak", slope, g.rotations[i], modes, optimize=True)
    focal = (xy * P[:, 2:]) @ Q.T  # left falls by this with log f
    turns = np.cross((out @ view.rotation)[:, None, :], slope)
    J = np.concatenate([shaped, focal[..., None], turns, slope], axis=2).reshape(2 * len(P), -1)
    own = model.sd**2 + model.person_sd**2 + ((view.sd * P[:, 2]) ** 2)[:, None]
    own = np.where(known[:, None], own, np.inf)
    r = np.where(known[:, None], left, 0.0)
    return J, r.ravel(), own.ravel()


def _weighed(model: LandmarkModel, J: Floats, r: Floats, own: Floats) -> tuple[Floats, Floats]:
    """Normal equations under the covariance of people and frames."""
    modes = np.concatenate([model.modes, model.person_modes])
    root = np.where(np.isinf(own), 0.0, 1 / np.sqrt(own))
    U = (modes.reshape(len(modes), -1) * root).T
    Jw, rw = J * root[:, None], r * root
    S = cho_factor(np.eye(U.shape[1]) + U.T @ U)
    JU = Jw.T @ U
    return (
        Jw.T @ Jw - JU @ cho_solve(S, JU.T),
        Jw.T @ rw - JU @ cho_solve(S, U.T @ rw),
    )


def _offsets(
    model: LandmarkModel, frames: Sequence[Sequence[View]], g: _Guess, rest: Floats
) -> Floats:
    """Offsets (n, 3) mm by least squares over all frames and views; 0 where nothing is known."""
    A = np.zeros((len(rest), 3, 3))
    b = np.zeros((len(rest), 3))
    for i, views in enumerate(frames):
        for view in views:
            left, _, _, Q, xy = _residuals(model, view, g, i, rest)
            known = ~np.isnan(view.xy[:, 0])
            eye = np.broadcast_to(np.eye(2), (len(rest), 2, 2))
            slope = Q @ np.concatenate([eye, -xy[..., None]], axis=2)
            slope = slope @ (view.rotation @ g.rotations[i]) * known[:, None, None]
            A += np.einsum("nax,nay->nxy", slope, slope)
            b += np.einsum("nax,na->nx", slope, np.where(known[:, None], left, 0.0))
    total = np.trace(A, axis1=1, axis2=2)
    A += 1e-3 * np.maximum(total, 1e-9)[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(A, b[..., None])[..., 0])
