"""A chunk of frames in the head frame, and where each marker must be if the others are right."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..core.person import Person
from .face_gaussian import FaceGaussian, Prediction, distance2, gaussian_cost
from .weighted_fit import to_head

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Squared Mahalanobis distance from where the others say, up to which a sample is believed.
_TRUSTED2 = 16.0
_TRUST_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class FaceView:
    """All tracks in the head frame, and where labels are expected there.

    Attributes
    ----------
    tracks : (T, K, 3) float64, mm, head frame
    labelled : (T, M, 3) float64, mm, head frame
        By label; NaN where no track has it.
    trusted : (T, M, 3)
        The same without what does not agree with the others.
    prediction : Prediction
    """

    tracks: Floats
    labelled: Floats
    trusted: Floats
    prediction: Prediction

    @cached_property
    def information(self) -> Floats:
        """(T, M, 3, 3) float64, mm⁻²: inverse covariances of the prediction."""
        return np.asarray(np.linalg.inv(self.prediction.covariance), dtype=np.float64)

    @cached_property
    def log_det(self) -> Floats:
        """(T, M): what each label's spread costs, the same at any distance."""
        log_det = np.linalg.slogdet(self.prediction.covariance)[1]
        return np.asarray(log_det + 3 * np.log(2 * np.pi), dtype=np.float64)

    def own_costs(self, frames: Ints, track: int | Ints, labels: int | Ints) -> Floats:
        """(n,) negative log densities of tracks' samples as given labels."""
        off = self.tracks[frames, track] - self.prediction.mean[frames, labels]
        return gaussian_cost(off, self.prediction.covariance[frames, labels])


def by_label(x: Floats, label: Ints, n_labels: int) -> Floats:
    """(T, M, 3) positions by label."""
    found = np.full((len(x), n_labels, 3), np.nan)
    t, k = np.nonzero((label >= 0) & ~np.isnan(x[..., 0]))
    found[t, label[t, k]] = x[t, k]
    return found


def look(x: Floats, label: Ints, person: Person) -> FaceView:
    """Pose and predictions of each frame, without samples that do not fit in."""
    gaussian = FaceGaussian(person)
    at = by_label(x, label, len(person.labels))
    used = ~np.isnan(at[..., 0])
    for _ in range(_TRUST_ROUNDS):
        R, t = gaussian.pose(at, used)
        q = to_head(at, R, t)
        prediction = gaussian.predict(q, used)
        far = distances2(q, prediction)
        worst = np.where(used, far, 0.0).max(axis=1, keepdims=True)
        # the worst drag others along: only they are left out at a time
        out = used & (far > _TRUSTED2) & (far > 0.5 * worst)
        back = ~used & (far <= _TRUSTED2)
        if not (out.any() or back.any()):
            break
        used = (used & ~out) | back
    q = to_head(at, R, t)
    prediction = gaussian.predict(q, used)
    trusted = np.where(used[..., None], q, np.nan)
    return FaceView(to_head(x, R, t), q, trusted, prediction)


def distances2(q: Floats, prediction: Prediction) -> Floats:
    """(T, M) squared Mahalanobis distances from where the others say; NaN where not seen."""
    far = distance2(np.nan_to_num(q - prediction.mean), prediction.covariance)
    return np.where(np.isnan(q[..., 0]), np.nan, far)


def costs_as_labels(view: FaceView, frames: Ints | slice, points: Floats) -> Floats:
    """(n, M) negative log densities of one point a frame, (n, 3), as each label.

    NaN where a point is.
    """
    off = points[:, None] - view.prediction.mean[frames]
    information = view.information[frames]
    far = (off * np.einsum("nmxy,nmy->nmx", information, off)).sum(axis=-1)
    return np.asarray(0.5 * (far + view.log_det[frames]))
