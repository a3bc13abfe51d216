"""Getting to know a person: from one look at the face at rest, then from how it moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..core.markers import MarkerSet
from ..core.person import Person
from .face_gaussian import FaceGaussian
from .face_variation import anyone, expression_covariance, low_rank

Floats = NDArray[np.float64]

_OWN_MM = 0.6  # what a marker does by itself on a face that is known: skin, measurement
_REST_MM = 0.8  # a face at rest is not quite at rest
#: What is believed of expressions before any is seen counts as so many frames.
_PRIOR_FRAMES = 250
_MOST_FRAMES = 4000  # what was learnt long ago never outweighs this
_MAX_LEARNT = 900  # frames of a chunk that are used: neighbours in time tell the same
_SETTLED_FRAMES = 15  # a marker not seen at rest is placed by as many frames


def meet(q: Floats, marker_set: MarkerSet, scale: float) -> Person:
    """The person whose face at rest shows its markers at `q`.

    Markers that are not seen are placed by those that are, as people's forms go together, and
    keep the uncertainty that is left.

    Parameters
    ----------
    q : (M, 3) float64, mm, head frame
        In the set's order; NaN where a marker is not seen.
    marker_set : MarkerSet
    scale : float
        Of the face against the average one.
    """
    stranger = anyone(marker_set, at_rest=True)
    gaussian = FaceGaussian(stranger)
    predicted = gaussian.predict(q[None] / scale)
    known = ~np.isnan(q[:, 0])
    neutral = np.where(known[:, None], q, scale * predicted.mean[0])
    covariance = scale**2 * expression_covariance(marker_set)
    modes, noise = low_rank(covariance, np.hypot(_OWN_MM, _REST_MM) * np.ones(len(q)))
    # what is not known of a hidden marker's place is its own, whatever the others do
    hidden = scale**2 * np.trace(predicted.covariance[0], axis1=1, axis2=2) / 3
    noise = np.where(known, noise, np.sqrt(noise**2 + hidden))
    return Person(marker_set.name, marker_set.labels, neutral, modes, noise, known)


def learn(person: Person, q: Floats, expected: Floats) -> Person:
    """Learn from frames how a face moves.

    The second moment about the face at rest, over the frames in which each two markers are seen
    together, joins what was believed, which counts as 250 frames and those learnt from before. A
    marker that the face at rest did not show is put where the others say that it is at rest.

    Parameters
    ----------
    person : Person
    q : (T, M, 3) float64, mm, head frame
        NaN where a marker is not seen or not trusted.
    expected : (T, M, 3) float64, mm, head frame
        Where the others say that each marker is.
    """
    seen = ~np.isnan(q[..., 0])
    if not seen.any():
        return person
    n_frames = int(seen.any(axis=1).sum())
    neutral = np.array(person.neutral)
    known = np.array(person.is_known)
    for m in np.flatnonzero(~known & (seen.sum(axis=0) >= _SETTLED_FRAMES)):
        neutral[m] += np.nanmedian(q[:, m] - expected[:, m], axis=0)
        known[m] = True
    step = max(1, len(q) // _MAX_LEARNT)
    seen = seen[::step]
    off = np.where(seen[..., None], q[::step] - neutral, 0.0).reshape(len(seen), -1)
    share = seen.astype(np.float64)
    n_together = np.kron(step * (share.T @ share), np.ones((3, 3)))
    flat = person.modes.reshape(len(person.modes), -1)
    newly = known & ~person.is_known
    own = np.where(newly, _OWN_MM, person.noise_mm)
    before = flat.T @ flat + np.diag(np.repeat(own**2, 3))
    weight = _PRIOR_FRAMES + min(person.n_frames, _MOST_FRAMES)
    covariance = (weight * before + step * (off.T @ off)) / (weight + n_together)
    own = np.where(known, _OWN_MM, own)
    modes, noise = low_rank(covariance - np.diag(np.repeat(own**2, 3)), own)
    return replace(
        person,
        neutral=neutral,
        modes=modes,
        noise_mm=noise,
        is_known=known,
        n_frames=person.n_frames + n_frames,
    )
