"""What the landmark network makes of a face: where it puts its points, how they follow, how unsure.

In the camera's frame, a landmark of a face at rest at M (head frame, mm), whose owner moves by the
expression c (K,), is seen at the ideal coordinates xy with

    Q [xy z - XY] = β(v) + e,   (X, Y, z) = R (M + s δ + B c) + t

where Q turns the picture upright, v is the direction to the camera in the head's frame, β the
network's bias (quadratic in v), and e has a covariance of low rank plus a diagonal. δ is what the
neutral frames tell of a person. M, β, B (how far points follow, the network's gain included) and
the covariance were learnt on renders of our own people (``benchmarks/learn_landmark_noise.py``),
as the tracker shows them (`tracked_lean`); components of c are independent with variance 1 among
those performances.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly

Floats = NDArray[np.float64]
DATA = "landmark_noise.npz"
#: Terms of a bias that depends on the view: 1, v_x, v_y, v_x², v_x v_y, v_y².
N_VIEW_TERMS = 6
#: Components whose products with each other take part in the correction.
_BENT = 12
N_PRODUCTS = _BENT * (_BENT + 1) // 2


@dataclass(frozen=True, eq=False)
class LandmarkModel:
    """The measurement model of the network's landmarks.

    Attributes
    ----------
    numbers : (n,) int64
        Landmarks that are used.
    bias : (6, n, 2) float64, mm, picture turned upright
        β: coefficients of `view_terms`.
    gain : (K, n, 3) float64, mm, head frame
        B.
    sd : (n, 2) float64, mm
        Of what errors of single points have of their own.
    modes : (r, n, 2) float64, mm
        What errors of several points have in common, by its standard deviation.
    person_sd : (n, 2) float64, mm
    person_modes : (q, n, 2) float64, mm
        The same of errors that a person's face has in all frames.
    point_names : tuple of str
        Feature points that c moves.
    points : (K, P, 3) float64, mm, head frame
        How.
    gaze : (K, 2, 2) float64, rad
        How it turns the eyes: right, left; yaw to the subject's left, pitch down.
    weights_to_c : (52, K) float64
        c of ARKit weights, about; `weight_names` in their order.
    c_of_weights_cov : (K, K) float64
        Of what that leaves.
    score_gain : (52, 52) float64
        Change of the network's scores from neutral with the weights, rows weights; and
        `score_cov` (52, 52) of what that leaves.
    people_mean, people_sd : (S,) float64
        Of people's amounts of the components of `heads.face_model`.
    patterns : (L, n, 2) float64, mm, picture turned upright
        Orthonormal: the largest of what the model leaves of the landmarks.
    correction : (K + 78 + L, K) float64
        Of `expression_terms` of what one picture tells of c, and of the amounts of `patterns` in
        what is left: for landmarks do not follow quite linearly. See `corrected`.
    pose_doubt : float
        By which errors of the head's turn exceed what follows from the covariances.
    """

    numbers: NDArray[np.int64]
    bias: Floats
    gain: Floats
    sd: Floats
    modes: Floats
    person_sd: Floats
    person_modes: Floats
    point_names: tuple[str, ...]
    points: Floats
    gaze: Floats
    weight_names: tuple[str, ...]
    weights_to_c: Floats
    c_of_weights_cov: Floats
    score_gain: Floats
    score_cov: Floats
    people_mean: Floats
    people_sd: Floats
    patterns: Floats
    correction: Floats
    pose_doubt: float

    def __post_init__(self) -> None:
        n, K, P = len(self.numbers), len(self.gain), len(self.point_names)
        W = len(self.weight_names)
        shapes: dict[str, tuple[int | None, ...]] = {
            "bias": (N_VIEW_TERMS, n, 2), "gain": (K, n, 3), "sd": (n, 2), "modes": (None, n, 2),
            "person_sd": (n, 2), "person_modes": (None, n, 2), "points": (K, P, 3),
            "gaze": (K, 2, 2), "weights_to_c": (W, K), "c_of_weights_cov": (K, K),
            "score_gain": (W, None), "score_cov": (None, None),
            "people_mean": (None,), "people_sd": (None,),
            "patterns": (None, n, 2), "correction": (K + N_PRODUCTS + len(self.patterns), K),
        }  # fmt: skip
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))
        object.__setattr__(self, "numbers", readonly(self.numbers, (n,), "numbers", np.int64))

    @property
    def n_components(self) -> int:
        """K."""
        return len(self.gain)

    def corrected(self, c: Floats, left: Floats) -> Floats:
        """Expressions without what was bent, and with what points say beside them; 0 stays 0.

        Parameters
        ----------
        c : (T, K) float64
            Relative to the neutral ones.
        left : (T, n, 2) float64, mm
            What the model leaves of the landmarks (`face_pose.FaceState`), likewise.
        """
        return np.asarray(c + correction_terms(c, left, self.patterns) @ self.correction)


def correction_terms(c: Floats, left: Floats, patterns: Floats) -> Floats:
    """What is corrected by: `expression_terms` and amounts of patterns, (T, K + 78 + L)."""
    amounts = left.reshape(len(left), -1) @ patterns.reshape(len(patterns), -1).T
    return np.concatenate([expression_terms(c), amounts], axis=1)


def expression_terms(c: Floats) -> Floats:
    """c (T, K) and the products of its first 12 components, (T, K + 78)."""
    a, b = np.triu_indices(_BENT)
    return np.concatenate([c, c[:, a] * c[:, b]], axis=1)


def view_terms(direction: Floats) -> Floats:
    """Terms (..., 6) of a direction (..., 3) to the camera, head frame."""
    v = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    x, y = v[..., 0], v[..., 1]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)


def upright(rotation: Floats) -> Floats:
    """Q (..., 2, 2): turns the picture so that the head's x axis runs along its rows."""
    x, y = rotation[..., 0, 0], rotation[..., 1, 0]
    n = np.hypot(x, y)
    c, s = x / n, y / n
    return np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)


def write_landmark_model(file: Path | BinaryIO, model: LandmarkModel) -> None:
    """Write a model as ``.npz``, in half precision."""
    arrays = {}
    for name in model.__dataclass_fields__:
        value = getattr(model, name)
        if isinstance(value, tuple | float):
            arrays[name] = np.array(value)
        elif name == "numbers":
            arrays[name] = value.astype(np.int16)
        else:
            small = value.size > 1000 and not name.endswith("cov")
            arrays[name] = value.astype(np.float16 if small else np.float32)
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def read_landmark_model(file: Path | BinaryIO) -> LandmarkModel:
    """Read what `write_landmark_model` wrote."""
    with np.load(file, allow_pickle=False) as z:
        values: dict[str, Any] = {
            name: tuple(str(s) for s in z[name])
            if name.endswith("names")
            else float(z[name])
            if z[name].ndim == 0
            else z[name].astype(np.int64 if name == "numbers" else np.float64)
            for name in z.files
        }
    return LandmarkModel(**values)


@cache
def landmark_model() -> LandmarkModel:
    """The model that comes with the package."""
    with files(__package__).joinpath("data", DATA).open("rb") as stream:
        return read_landmark_model(stream)  # type: ignore[arg-type]
