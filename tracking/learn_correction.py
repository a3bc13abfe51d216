"""Learns the correction of expressions that single pictures tell (`landmark_noise`).

Landmarks do not follow a face quite linearly, what is unsure is found too small, and what the
model leaves of the landmarks is not all noise. All that is regular: ridge regression of what is
true on what was found, with the products of the largest components and the largest patterns of
what is left, over the samples of ``benchmarks/learn_landmark_noise.py``, each solved as a picture
of a clip is solved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .face_fit import fit_face
from .face_pose import FaceSolver, FaceState, View
from .face_views import start_state
from .landmark_noise import LandmarkModel, correction_terms
from .learn_landmark_noise import EYE_MM, Samples

Floats = NDArray[np.float64]
_JITTER = 3e-4  # of ideal coordinates: what single frames have of their own
_RIDGE, N_PATTERNS = 1000.0, 40
#: Shapes mixed by chance are no expressions that people make: they count half.
_MIXED_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class _Found:
    """A person's expressions as found and true (N, K), what is left of the landmarks (N, n, 2),
    and errors of turns over their sd (N, 3)."""

    found: Floats
    true: Floats
    left: Floats
    turns: Floats


def with_correction(
    model: LandmarkModel, people: Sequence[Samples], n_neutral: int, n_acting: int
) -> LandmarkModel:
    """The model with its correction and the doubt about poses.

    Parameters
    ----------
    model : LandmarkModel
    people : sequence of Samples, one person each
        `n_neutral` neutral ones first, then `n_acting` of a performance, then mixed ones.
    """
    each = [_solved(model, person) for person in people]
    found, true, left = (
        np.concatenate([getattr(e, name) for e in each]) for name in ("found", "true", "left")
    )
    row = np.concatenate([np.arange(len(e.found)) for e in each])
    weight = np.where((row >= n_neutral) & (row < n_neutral + n_acting), 1.0, _MIXED_SHARE)
    patterns = _patterns(left, weight)
    X = correction_terms(found, left, patterns)
    size = X.std(axis=0)
    A = X / size
    H = (A * weight[:, None]).T @ A + _RIDGE * np.eye(A.shape[1])
    B = np.linalg.solve(H, (A * weight[:, None]).T @ (true - found)) / size[:, None]
    doubt = float(np.sqrt((np.concatenate([e.turns for e in each]) ** 2).mean()))
    return replace(model, patterns=patterns, correction=B, pose_doubt=doubt)


def _patterns(left: Floats, weight: Floats) -> Floats:
    flat = left.reshape(len(left), -1) * np.sqrt(weight)[:, None]
    rows = np.linalg.svd(flat, full_matrices=False)[2][:N_PATTERNS]
    return np.asarray(rows.reshape(-1, *left.shape[1:]))


def _solved(model: LandmarkModel, s: Samples) -> _Found:
    """A person analysed picture by picture."""
    sd = np.full(s.xy.shape[1], _JITTER)
    views = [View(xy, sd, np.eye(3), np.zeros(3)) for xy in s.xy]
    rest = np.flatnonzero(s.is_neutral)
    starts = [start_state(model, views[i]) for i in rest]
    face = fit_face(
        model, [[views[i]] for i in rest], [(x.rotation, x.translation) for x in starts],
        focal_px=1.0,
    )  # fmt: skip
    solver = FaceSolver(model, face.landmarks)
    states = [solver.solve([view], start_state(model, view)) for view in views]
    c = np.stack([state.expression for state in states])
    left = np.stack([state.left for state in states])
    reach = [np.linalg.norm(p - p.mean(axis=0)) for p in (face.landmarks, s.rest[0])]
    return _Found(
        c - c[rest].mean(axis=0),
        _expressions(model, s.points * reach[0] / reach[1], s.gaze),
        left - left[rest].mean(axis=0),
        _turn_errors(states, s.rotation, rest),
    )


def _expressions(model: LandmarkModel, points: Floats, gaze: Floats) -> Floats:
    """c (N, K) of true displacements and gazes."""
    K, N = model.n_components, len(points)
    what = np.concatenate([model.points.reshape(K, -1), EYE_MM * model.gaze.reshape(K, -1)], axis=1)
    true = np.concatenate([points.reshape(N, -1), EYE_MM * gaze.reshape(N, -1)], axis=1)
    return np.asarray(true @ np.linalg.pinv(what))


def _turn_errors(states: list[FaceState], R: Floats, rest: NDArray[np.int64]) -> Floats:
    """Errors of turns relative to the neutral pictures, about the head's axes, over stated ones."""
    found = np.stack([state.rotation for state in states])
    off = Rotation.from_matrix(np.swapaxes(found, 1, 2) @ R).as_rotvec()
    stated = np.stack([F.T @ s.covariance[:3, :3] @ F for F, s in zip(found, states, strict=True)])
    return np.asarray(
        (off - off[rest].mean(axis=0)) / np.sqrt(np.diagonal(stated, axis1=1, axis2=2))
    )
