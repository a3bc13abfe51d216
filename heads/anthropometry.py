"""Gives drawn people the proportions that have been measured of people.

Weights of local targets drawn by chance make faces that differ, but their distances have neither
the means nor the spread of real ones, and whatever sculpting went into the targets shows. Here the
drawn weights are moved as little as possible so that each published distance keeps its rank among
the drawn ones but takes the published mean and standard deviation of the person's sex and age
(ages 3 to 25; later the skeleton of the face hardly grows). What no distance sees stays as drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .landmarks import template_landmarks
from .measurements import SEXES, Measurement, measurement_table, published_norm
from .template import load_template

#: Distances that are fitted, and how strictly: allowed residual in published standard deviations.
#: The rest follows, or contradicts these (other people were measured).
FITTED: Mapping[str, float] = {
    "Head width": 0.33,
    "Minimum frontal width": 0.35,
    "Face width": 0.2,
    "Mandible width": 0.3,
    "Intercanthal width": 0.3,
    "Biocular width": 0.3,
    "Eye fissure length": 0.5,
    "Nose width": 0.3,
    "Subnasal width": 0.5,
    "Nasal root depth": 0.45,
    "Nose height": 0.3,
    "Nasal bridge length": 0.3,
    "Nasal tip protrusion": 0.25,
    "Ala length": 0.3,
    "Philtrum width": 0.5,
    "Philtrum length": 0.35,
    "Upper lip height": 0.35,
    "Upper vermilion height": 0.3,
    "Lower vermilion height": 0.3,
    "Cutaneous lower lip height": 0.5,
    "Mouth width": 0.3,
    "Morphological face height": 0.3,
    "Vertex to tragion": 0.4,
    "Head length": 0.3,
    "Ear length": 0.3,
    "Ear width": 0.4,
    "Mandibular arc": 0.6,
}
#: A tape is longer than the way it takes over one landmark, by so much (±1 % among people).
_TAPE_OVER_STRAIGHT = 1.06
SIZE_SD = 0.03  # of overall size, before fitting
MAX_WEIGHT = 0.85  # of a local target after fitting
_MAX_RANK = 2.6  # standard deviations from the mean that a distance comes near
_FREE_SD = 0.25  # of a weight's move while fitting
_LOG_SIZE_SD = 0.04
_ROUNDS = 6
_ANCESTRIES = ("african", "asian", "caucasian")


@dataclass(frozen=True)
class LocalPair:
    """Opposite local targets under one signed weight, on one or both sides of the face.

    Attributes
    ----------
    positive, negative : tuple of str
        Targets that a weight above, below 0 stands for: one, or those of both sides.
    sd : float
        Of the weight among drawn people; 0 where people are drawn without it.
    ease : float
        How readily fitting moves it, 1 usual; 0 not at all.
    """

    positive: tuple[str, ...]
    negative: tuple[str, ...]
    sd: float
    ease: float


@dataclass(frozen=True, eq=False)
class _Model:
    """Landmarks as a linear function of targets.

    Attributes
    ----------
    rest : (N, 3) float64, mm
    offsets : (T, N, 3) float64, mm
    start, end : (M', ) rows of landmarks of each single distance
    axis : (M',) int, −1 for straight distances
    mean_of : (M, M') float64
        Averages the sides; adds them where a tape runs over both.
    """

    rest: NDArray[np.float64]
    offsets: NDArray[np.float64]
    start: NDArray[np.int64]
    end: NDArray[np.int64]
    axis: NDArray[np.int64]
    mean_of: NDArray[np.float64]

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """The fitted distances, (M,) mm, of landmarks (N, 3)."""
        d = points[self.end] - points[self.start]
        along = np.abs(np.take_along_axis(d, np.maximum(self.axis, 0)[:, None], axis=1)[:, 0])
        single = np.where(self.axis < 0, np.linalg.norm(d, axis=1), along)
        return np.asarray(self.mean_of @ single)

    def slopes(
        self, points: NDArray[np.float64], offsets: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """How the distances change with the weights of offsets (K, N, 3): (M, K) mm."""
        d = points[self.end] - points[self.start]
        unit = d / np.linalg.norm(d, axis=1, keepdims=True)
        rows = np.flatnonzero(self.axis >= 0)
        unit[rows] = 0.0
        unit[rows, self.axis[rows]] = np.sign(d[rows, self.axis[rows]])
        change = offsets[:, self.end] - offsets[:, self.start]
        return np.asarray(self.mean_of @ np.einsum("sx,ksx->sk", unit, change))


@cache
def _model() -> _Model:
    template, marks = load_template(), template_landmarks()
    n, V = len(marks), len(template.vertices)
    pick = sparse.csr_matrix(
        (marks.barycentric.ravel(), (np.repeat(np.arange(n), 3), marks.corners.ravel())), (n, V)
    )
    offsets = [(template.identity[:, a * V : (a + 1) * V] @ pick.T).toarray() for a in range(3)]
    table = measurement_table()
    single: list[tuple[int, int, int, int]] = []
    for row, name in enumerate(FITTED):
        m: Measurement = table[name]
        axis = "xyz".index(m.path) if m.kind == "axis" else -1
        pairs = m.pairs()
        if m.kind == "arc":
            pairs = tuple((end, m.path) for end in pairs[0])
        single += [(row, marks.index(a), marks.index(b), axis) for a, b in pairs]
    rows, start, end, axes = np.array(single).T
    mean_of = (rows == np.arange(len(FITTED))[:, None]).astype(np.float64)
    mean_of /= mean_of.sum(axis=1, keepdims=True)
    for row, name in enumerate(FITTED):
        if table[name].kind == "arc":
            mean_of[row] *= 2 * _TAPE_OVER_STRAIGHT
    return _Model(pick @ template.vertices, np.stack(offsets, axis=-1), start, end, axes, mean_of)


def _target_rows(names: tuple[str, ...]) -> list[int]:
    known = load_template().identity_names
    return [known.index(name) for name in names]


@cache
def _pair_offsets(pairs: tuple[LocalPair, ...]) -> NDArray[np.float64]:
    """Landmark offsets (2, K, N, 3) of each pair's positive and negative targets, mm."""
    model = _model()
    return np.stack(
        [
            [model.offsets[_target_rows(getattr(p, side))].sum(axis=0) for p in pairs]
            for side in ("positive", "negative")
        ]
    )


def phenotype_landmarks(weights: Mapping[str, float]) -> NDArray[np.float64]:
    """Landmarks (69, 3), mm, of the template under weights of targets by name."""
    model = _model()
    rows = _target_rows(tuple(weights))
    return model.rest + np.tensordot(list(weights.values()), model.offsets[rows], axes=1)


def fit_to_norms(
    pairs: tuple[LocalPair, ...],
    drawn: NDArray[np.float64],
    *,
    weights: Mapping[str, float],
    mean_weights: Mapping[str, float],
    spread: NDArray[np.float64],
    log_size: float,
    sex: str,
    age_years: float,
) -> tuple[NDArray[np.float64], float]:
    """Move drawn weights so that the person's distances are those of people.

    Parameters
    ----------
    pairs : tuple of LocalPair, length K
    drawn : (K,) float
        Signed weights.
    weights : mapping from target to weight
        Of all targets besides the pairs': age, sex, ancestry, fullness.
    mean_weights : mapping from target to weight
        The mean of `weights` over people of this sex and age.
    spread : (69, 3, S) float, mm
        Independent directions in which `weights` spread landmarks about their mean, each of one
        standard deviation.
    log_size : float
        Drawn logarithm of overall size, standard deviation `SIZE_SD`.
    sex : str
        ``male`` or ``female``.
    age_years : float

    Returns
    -------
    (K,) float64
        Weights within ±`MAX_WEIGHT` where fitting may move a pair, else as drawn.
    float
        Overall size, relative to the template under the same weights.

    Raises
    ------
    ValueError
        If there is no such sex.
    """
    if sex not in SEXES:
        raise ValueError(f"sex must be one of {', '.join(SEXES)}, got {sex}")
    model, signed = _model(), _pair_offsets(pairs)
    norms = [published_norm(name, sex, age_years) for name in FITTED]
    known = np.array([n is not None for n in norms])
    mean = np.array([1.0 if n is None else n.mean for n in norms])
    sd = np.array([1.0 if n is None else n.sd for n in norms])
    # opposite targets are not quite opposite: E|w| of a normal weight leaves a mean offset
    sds = np.array([p.sd for p in pairs])
    offset = np.tensordot(sds / np.sqrt(2 * np.pi), signed.sum(axis=0), axes=1)
    middle = phenotype_landmarks(mean_weights) + offset
    usual = model.distances(middle)
    size = float(np.exp(np.mean(np.log(mean[known] / usual[known]))))
    base = phenotype_landmarks(weights)
    rank = _ranks(model, pairs, signed, middle, spread, base, drawn, log_size)
    target = mean + sd * _MAX_RANK * np.tanh(rank / _MAX_RANK)
    allowed = sd * np.array(list(FITTED.values()))
    use = np.flatnonzero(known)
    return _solved(model, pairs, signed, base, drawn, size * np.exp(log_size), use, target, allowed)


def _ranks(
    model: _Model,
    pairs: tuple[LocalPair, ...],
    signed: NDArray[np.float64],
    middle: NDArray[np.float64],
    spread: NDArray[np.float64],
    base: NDArray[np.float64],
    drawn: NDArray[np.float64],
    log_size: float,
) -> NDArray[np.float64]:
    """Where a drawn person's distances lie among drawn people's, in standard deviations."""
    usual = model.distances(middle)
    sds = np.array([p.sd for p in pairs])
    local = model.slopes(middle, (signed[0] - signed[1]) / 2) * sds
    others = model.slopes(middle, np.moveaxis(spread, -1, 0))
    variance = (local**2).sum(axis=1) + (others**2).sum(axis=1) + (SIZE_SD * usual) ** 2
    points = (base + _moved(signed, drawn)) * np.exp(log_size)
    return np.asarray((model.distances(points) - usual) / np.sqrt(variance))


def _moved(signed: NDArray[np.float64], w: NDArray[np.float64]) -> NDArray[np.float64]:
    up, down = np.maximum(w, 0), np.maximum(-w, 0)
    found = np.tensordot(up, signed[0], axes=1) + np.tensordot(down, signed[1], axes=1)
    return np.asarray(found)


def _solved(
    model: _Model,
    pairs: tuple[LocalPair, ...],
    signed: NDArray[np.float64],
    base: NDArray[np.float64],
    drawn: NDArray[np.float64],
    size: float,
    use: NDArray[np.int64],
    target: NDArray[np.float64],
    allowed: NDArray[np.float64],
) -> tuple[NDArray[np.float64], float]:
    """The smallest move that brings the distances to their targets (damped least squares)."""
    w, log_size = drawn.copy(), np.log(size)
    ease = np.array([p.ease for p in pairs])
    free = ease > 0
    cost = np.append(_FREE_SD * ease, _LOG_SIZE_SD)
    start = np.append(drawn, log_size)
    for _ in range(_ROUNDS):
        points = base + _moved(signed, w)
        now = np.exp(log_size) * model.distances(points)
        slope = np.where((w >= 0)[:, None, None], signed[0], -signed[1])
        J = np.exp(log_size) * model.slopes(points, slope)
        J = np.append(J, now[:, None], axis=1)[use] / allowed[use, None]
        x = np.append(w, log_size)
        moving = np.append(free, True)
        A = J[:, moving] * cost[moving]
        # distances wanted of the move from the start, not from here
        wanted = (target - now)[use] / allowed[use] + J[:, moving] @ (x - start)[moving]
        step = A.T @ np.linalg.solve(A @ A.T + np.eye(len(use)), wanted)
        x[moving] = start[moving] + cost[moving] * step
        w, log_size = x[:-1], float(x[-1])
        over = free & (np.abs(w) > MAX_WEIGHT)
        w[over] = np.clip(w[over], -MAX_WEIGHT, MAX_WEIGHT)
        start[:-1][over], free = w[over], free & ~over
    return w, float(np.exp(log_size))
