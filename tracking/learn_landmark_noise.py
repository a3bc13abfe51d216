"""Learns the landmarks' measurement model (`landmark_noise`) from samples whose truth is known.

Samples come from ``benchmarks/learn_landmark_noise.py``. Components of the expression are the
principal ones of the feature points' displacements; bias and gain follow by regression of each
landmark on view and expression, with the true displacement of its place on the template as what
the gain is expected to be; covariances are those of what is left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.mpeg4 import fap_table
from ..heads.place_face_landmarks import template_face_landmarks
from ..heads.template import load_template, template_feature_points
from .face_fit import landmark_shapes
from .landmark_noise import N_PRODUCTS, N_VIEW_TERMS, LandmarkModel, upright, view_terms

Floats = NDArray[np.float64]
Sample = Mapping[str, NDArray[Any]]
#: Feature points that no camera sees move, or that do not.
_UNSEEN_GROUPS = ("6.", "7.", "10.", "11.", "9.8", "9.9", "9.10", "9.11")
EYE_MM = 12.0  # radius of an eyeball: turns a gaze into mm
N_COMPONENTS, N_MODES, N_PERSON_MODES = 40, 60, 12
#: How far a gain is expected to be off the true displacement: a share, and mm a component.
_GAIN_SHARE, _GAIN_MM = 0.35, 0.1
_BIAS_SD_MM = 6.0
_NOISE_MM = 1.0
_WEIGHT_RIDGE = 0.02
_FORM_MM = 0.7  # of people's places that the components do not make
_ROUNDS, _FOLDS = 2, 3
#: What errors of points have in common was learnt from few people, and says too surely what they do
#: not have in common: of each point's error this share is taken to be its own, of the modes that.
#: Chosen by the FAPs of ten takes.
_OWN_SHARE, _MODE_SHARE = 1.0, 0.85


@dataclass(frozen=True, eq=False)
class Samples:
    """All people's samples in one table; `person` numbers their owners."""

    person: NDArray[np.int64]
    is_neutral: NDArray[np.bool_]
    rotation: Floats
    translation: Floats
    xy: Floats  # (N, n, 2) ideal coordinates
    rest: Floats  # (N, n, 3)
    moved: Floats  # (N, n, 3) true displacement
    points: Floats  # (N, P, 3) displacement
    gaze: Floats
    weights: Floats
    scores: Floats


def used_points() -> tuple[str, ...]:
    """Feature points that FAPs move and a camera sees, without ears, tongue and teeth."""
    found = {p for fap in fap_table() for p in fap.feature_points if fap.direction is not None}
    known = set(template_feature_points().names)
    return tuple(sorted(p for p in found & known if not p.startswith(_UNSEEN_GROUPS)))


def joined(people: Sequence[Sample], side_px: int) -> Samples:
    """People's samples as `draw_person` makes them, in one table."""
    numbers = np.array([int(n) for n in template_face_landmarks().names])
    chosen = [template_feature_points().names.index(p) for p in used_points()]
    columns: dict[str, list[NDArray[Any]]] = {}
    for i, p in enumerate(people):
        n = len(p["weights"])
        px = np.asarray(p["landmarks_px"])[:, numbers] - (side_px - 1) / 2
        rest_points, rest = np.asarray(p["rest_points"]), np.asarray(p["rest_marks"])
        here = {
            "person": np.full(n, i), "is_neutral": p["is_neutral"], "rotation": p["rotation"],
            "translation": p["translation"], "xy": px / np.asarray(p["focal_px"])[:, None, None],
            "rest": np.broadcast_to(rest, (n, *rest.shape)), "moved": np.asarray(p["marks"]) - rest,
            "points": (np.asarray(p["points"]) - rest_points)[:, chosen], "gaze": p["gaze"],
            "weights": p["weights"], "scores": p["scores"],
        }  # fmt: skip
        for name, value in here.items():
            columns.setdefault(name, []).append(value)
    return Samples(**{name: np.concatenate(v) for name, v in columns.items()})


def learn(samples: Samples) -> LandmarkModel:
    """The model of some people's samples, without a correction (`learn_correction`)."""
    s = samples
    c, points, gaze = _components(s)
    shown = np.asarray(np.linalg.lstsq(c, s.moved.reshape(len(c), -1), rcond=None)[0], np.float64)
    expected = shown.reshape(len(points), *s.moved.shape[1:])
    slope, seen = equations(s.rotation, s.translation, s.xy, s.rest)
    terms = view_terms(-np.einsum("tji,tj->ti", s.rotation, s.translation))
    bias, gain, offset, _ = _fitted(s, slope, seen, c, terms, expected)
    left = _left_of_others(s, slope, seen, c, terms, expected)
    sd, modes = _low_rank(left.reshape(len(left), -1), N_MODES)
    person_sd, person_modes = _low_rank(offset.reshape(len(offset), -1), N_PERSON_MODES)
    n, people = len(expected[0]), _people(s)
    A, rest_cov = _ridge(s.weights, c)
    base = np.stack([s.scores[s.is_neutral & (s.person == i)].mean(axis=0) for i in s.person])
    G, score_cov = _ridge(s.weights, s.scores - base)
    return LandmarkModel(
        numbers=np.array([int(x) for x in template_face_landmarks().names]),
        bias=bias, gain=gain, sd=sd.reshape(n, 2), modes=modes.reshape(-1, n, 2),
        person_sd=person_sd.reshape(n, 2), person_modes=person_modes.reshape(-1, n, 2),
        point_names=used_points(), points=points, gaze=gaze,
        weight_names=load_template().arkit_names, weights_to_c=A, c_of_weights_cov=rest_cov,
        score_gain=G, score_cov=score_cov, people_mean=people[0], people_sd=people[1],
        patterns=np.zeros((0, n, 2)),
        correction=np.zeros((len(points) + N_PRODUCTS, len(points))), pose_doubt=1.0,
    )  # fmt: skip


def _fitted(
    s: Samples, slope: Floats, seen: Floats, c: Floats, terms: Floats, expected: Floats,
    rows: NDArray[np.bool_] | None = None,
) -> tuple[Floats, Floats, Floats, Floats]:  # fmt: skip
    """Bias, gain, offsets of each person (n, 2), and what is left, from some rows."""
    chosen = np.ones(len(c), bool) if rows is None else rows
    offset = np.zeros((int(s.person.max()) + 1, *seen.shape[1:]))
    for _ in range(_ROUNDS):
        y = (seen - offset[s.person])[chosen]
        bias, gain = _regressed(slope[chosen], y, c[chosen], terms[chosen], expected)
        left = seen - np.einsum("tnax,knx,tk->tna", slope, gain, c, optimize=True)
        left -= np.einsum("tf,fna->tna", terms, bias)
        offset = np.stack(
            [left[s.is_neutral & (s.person == i)].mean(axis=0) for i in range(len(offset))]
        )
        offset -= offset[np.unique(s.person[chosen])].mean(axis=0)
    return bias, gain, offset, left - offset[s.person]


def _left_of_others(
    s: Samples, slope: Floats, seen: Floats, c: Floats, terms: Floats, expected: Floats
) -> Floats:
    """What is left of people whom the regression did not see."""
    found = np.zeros_like(seen)
    for fold in range(_FOLDS):
        out = s.person % _FOLDS == fold
        *_, left = _fitted(s, slope, seen, c, terms, expected, ~out)
        found[out] = left[out]
    return found


def _people(s: Samples) -> tuple[Floats, Floats]:
    """Mean and standard deviation among people of the amounts of `heads.face_model` (S,)."""
    mean, modes = landmark_shapes()
    first = [int(np.argmax(s.person == i)) for i in range(int(s.person.max()) + 1)]
    X = modes.reshape(len(modes), -1).T
    H = X.T @ X / _FORM_MM**2 + np.eye(len(modes))
    off = (s.rest[first] - mean).reshape(len(first), -1)
    amounts = np.linalg.solve(H, X.T @ off.T / _FORM_MM**2).T
    n = len(first)
    # few people tell a spread badly: as if they were joined by ten of the model's own
    spread = (n * amounts.var(axis=0) + 10.0) / (n + 10.0)
    return np.asarray(amounts.mean(axis=0), np.float64), np.asarray(np.sqrt(spread), np.float64)


def equations(R: Floats, t: Floats, xy: Floats, rest: Floats) -> tuple[Floats, Floats]:
    """Linear equations of displacements d (head frame, mm): slope d = seen, in the upright picture.

    Parameters
    ----------
    R, t : (T, 3, 3), (T, 3)
        Camera from head.
    xy : (T, n, 2) ideal coordinates; rest : (T, n, 3) mm

    Returns
    -------
    (T, n, 2, 3) and (T, n, 2) mm
    """
    Q = upright(R)
    P = np.einsum("tij,tnj->tni", R, rest) + t[:, None]
    slope = R[:, None, :2] - xy[..., None] * R[:, None, 2:]
    seen = xy * P[..., 2:] - P[..., :2]
    return (
        np.einsum("tab,tnbx->tnax", Q, slope, optimize=True),
        np.einsum("tab,tnb->tna", Q, seen, optimize=True),
    )


def _components(s: Samples) -> tuple[Floats, Floats, Floats]:
    """Expressions (N, K), and what each component does to points (K, P, 3) and eyes (K, 2, 2)."""
    flat = np.concatenate(
        [s.points.reshape(len(s.points), -1), EYE_MM * s.gaze.reshape(len(s.gaze), -1)], axis=1
    )
    _, value, rows = np.linalg.svd(flat, full_matrices=False)
    K = min(N_COMPONENTS, len(rows))
    size = value[:K] / np.sqrt(len(flat))
    c = flat @ rows[:K].T / size
    what = rows[:K] * size[:, None]
    n = s.points[0].size
    return c, what[:, :n].reshape(K, -1, 3), what[:, n:].reshape(K, 2, 2) / EYE_MM


def _regressed(
    slope: Floats, seen: Floats, c: Floats, terms: Floats, expected: Floats
) -> tuple[Floats, Floats]:
    """Bias (6, n, 2) and gain (K, n, 3) of each landmark."""
    N, n, K = *seen.shape[:2], c.shape[1]
    bias, gain = np.zeros((N_VIEW_TERMS, n, 2)), np.zeros((K, n, 3))
    spread = np.sqrt((expected**2).mean(axis=2))
    views = np.einsum("tf,ab->tafb", terms, np.eye(2)).reshape(N, 2, -1)
    for i in range(n):
        follows = (slope[:, i, :, None, :] * c[:, None, :, None]).reshape(N, 2, -1)
        X = np.concatenate([follows, views], axis=2).reshape(2 * N, -1)
        known = np.concatenate([expected[:, i].ravel(), np.zeros(views.shape[2])])
        sd = np.repeat(_GAIN_SHARE * spread[:, i] + _GAIN_MM, 3)
        sd = np.concatenate([sd, np.full(views.shape[2], _BIAS_SD_MM)])
        y = seen[:, i].ravel() - X @ known
        H = X.T @ X + np.diag(_NOISE_MM**2 / sd**2)
        found = known + np.linalg.solve(H, X.T @ y)
        gain[:, i] = found[: 3 * K].reshape(K, 3)
        bias[:, i] = found[3 * K :].reshape(N_VIEW_TERMS, 2)
    return bias, gain


def _low_rank(rows: Floats, rank: int) -> tuple[Floats, Floats]:
    """Standard deviations of single columns, and modes that they share, by their size."""
    _, value, directions = np.linalg.svd(rows, full_matrices=False)
    rank = min(rank, len(directions) - 1)
    modes = directions[:rank] * (value[:rank] / np.sqrt(len(rows)))[:, None]
    own = np.sqrt((rows**2).mean(axis=0))
    return _OWN_SHARE * own, _MODE_SHARE * modes


def _ridge(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Linear map without a constant, and the covariance of what it leaves."""
    H = x.T @ x / len(x)
    damped = H + _WEIGHT_RIDGE * np.diag(np.diag(H)) + 1e-6 * np.eye(len(H))
    A = np.asarray(np.linalg.solve(damped, x.T @ y / len(x)), dtype=np.float64)
    left = y - x @ A
    return A, left.T @ left / len(left) + 1e-6 * np.eye(y.shape[1])
