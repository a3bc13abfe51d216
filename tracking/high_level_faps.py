"""FAPs 1 and 2: the mix of visemes and expressions that a face looks most like.

A frame's low-level FAPs are taken apart into the six expressions and fourteen visemes of
`heads.expressions`, as the average head shows them: non-negative least squares, a small price on
each so that few explain much, then at most two of either kind. It is a description for decoders
that know nothing else, and not a measurement: FAPs 3 to 68 say what the face did.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from ..core.clip import Clip
from ..core.mpeg4 import (
    EXPRESSION_FIELDS,
    VISEME_FIELDS,
    Fapu,
    displacement_faps,
    fap_by_name,
)
from ..heads.expressions import EXPRESSIONS, VISEMES, expression_weights, viseme_weights
from .face_units import average_head
from .filters import zero_phase
from .rigid_fit import Floats

#: ``expression.intensity`` and ``viseme.blend`` run from 0 to this.
FULL = 63
_PRICE_MM = 0.15  # for each unit of intensity: what noise looks like is not called a feeling
_LEAST = 0.08  # weaker ones are not told
_CUTOFF_HZ = 5.0  # choices must not flicker
_INTENSITIES = (0.5, 1.0)  # expressions at which are averaged: they do not grow evenly


def high_level_faps(faps: Clip, fapu: Fapu) -> Clip:
    """The channels of FAPs 1 and 2 for low-level FAPs.

    ``viseme.blend`` is the first viseme's share of 63, against the second; a viseme that fades out
    is blended with silence (0). Both are not set where no low-level displacement is.

    Parameters
    ----------
    faps : Clip
        FAPs 3 to 68, table units.
    fapu : Fapu
        Of the face that moved.

    Returns
    -------
    Clip
        Ten channels, at the same times.
    """
    names = tuple(n for n in faps.channels if n in _looks())
    unit = np.array([fapu.unit(fap_by_name()[n]) for n in names])
    seen = np.array([faps[n] for n in names]).T * unit if names else np.zeros((len(faps.time_s), 0))
    rate = faps.rate_hz
    if rate is not None and rate > 2.5 * _CUTOFF_HZ:
        seen = zero_phase(seen, rate, _CUTOFF_HZ)
    looks = np.array([_looks()[n] for n in names])  # (F, 20) mm
    values = np.full((len(seen), len(VISEME_FIELDS) + len(EXPRESSION_FIELDS)), np.nan)
    for frame, row in enumerate(seen):
        known = ~np.isnan(row)
        if known.any():
            values[frame] = _told(_mix(looks[known], row[known]))
    return Clip(faps.time_s, (*VISEME_FIELDS, *EXPRESSION_FIELDS), values)


def _mix(looks: Floats, seen: Floats) -> Floats:
    """Intensities (20,): expressions, then visemes 1 to 14; at most two of either."""
    chosen = np.arange(looks.shape[1])
    found = np.zeros(looks.shape[1])
    for _ in range(2):  # all; then the strongest two of either kind again, by themselves
        A = np.vstack([looks[:, chosen], np.full((1, len(chosen)), _PRICE_MM)])
        weights, _ = nnls(A, np.append(seen, 0.0))
        found[:] = 0.0
        found[chosen] = weights
        n = len(EXPRESSIONS)
        chosen = np.sort(
            np.concatenate([np.argsort(-found[:n])[:2], n + np.argsort(-found[n:])[:2]])
        )
    return np.minimum(found, 1.0)


def _told(mix: Floats) -> list[float]:
    """The ten fields of FAPs 1 and 2."""
    n = len(EXPRESSIONS)
    (e1, i1), (e2, i2) = _strongest(mix[:n])
    (v1, s1), (v2, s2) = _strongest(mix[n:])
    # one blend tells two visemes: beside a single one stands silence
    blend = round(FULL * s1) if v2 == 0 else round(FULL * s1 / (s1 + s2))
    visemes = [v1, v2, blend if v1 else 0, 0]
    return [*visemes, e1, round(FULL * i1), e2, round(FULL * i2), 0, 0]


def _strongest(weights: Floats) -> tuple[tuple[int, float], tuple[int, float]]:
    """Numbers (from 1; 0 for none) and weights of the two strongest."""
    order = np.argsort(-weights, kind="stable")[:2]
    found = [(int(i) + 1, float(weights[i])) if weights[i] >= _LEAST else (0, 0.0) for i in order]
    return found[0], found[1]


@cache
def _looks() -> dict[str, NDArray[np.float64]]:
    """FAP → its displacement, mm, in each expression and viseme on the average head, (20,)."""
    head = average_head()
    rest = head.feature_points.at(head.mesh.vertices)
    faces = []
    for name in EXPRESSIONS:
        shown = [
            (head.feature_points.at(head.shaped(expression_weights(name, i))) - rest) / i
            for i in _INTENSITIES
        ]
        faces.append(np.mean(shown, axis=0))
    for viseme in VISEMES[1:]:
        faces.append(head.feature_points.at(head.shaped(viseme_weights(viseme))) - rest)
    moved = np.stack(faces)
    points = {fp: moved[:, i] for i, fp in enumerate(head.feature_points.names)}
    unit = Fapu(1024.0, 1024.0, 1024.0, 1024.0, 1024.0)  # values are then mm
    return displacement_faps(points, unit)
