"""The frame in which a face's markers move least, found from the markers alone.

For models of how markers move together it matters that the head's motion is gone, not where the
head is: no marker set is needed, and no marker has to be on the skull. Markers that keep their
distances count most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .rigid_fit import fit_rigid

_ROUNDS = 8
_LEAST_SPREAD_MM = 0.2  # no marker counts more than one that moves this much
_MIN_MARKERS = 3


@dataclass(frozen=True, eq=False)
class FaceFrame:
    """Markers with the head's motion taken away: ``p_world = R p_face + t``.

    Attributes
    ----------
    rotation : (T, 3, 3) float64
        NaN where fewer than three markers were seen.
    translation : (T, 3) float64, mm
    positions : (T, M, 3) float64, mm, face frame
        NaN where missing.
    bridged : (T, M, 3) float64, mm, face frame
        The same, gaps bridged by straight lines and held at the ends; NaN for markers never seen.
    rest : (M, 3) float64, mm, face frame
        Median places.
    spread : (M,) float64, mm
        RMS distance from them.
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    positions: NDArray[np.float64]
    bridged: NDArray[np.float64]
    rest: NDArray[np.float64]
    spread: NDArray[np.float64]


def face_frame(
    positions: NDArray[np.float64],
    rest: NDArray[np.float64] | None = None,
    spread: NDArray[np.float64] | None = None,
) -> FaceFrame | None:
    """Take the head's motion away; None where no three markers are seen together.

    A marker that is missing for a while must not move the frame by its absence: once the motion is
    known, gaps are bridged in the face frame, and the motion is found anew with the bridges.

    Parameters
    ----------
    positions : (T, M, 3) float64, mm, world frame
        NaN where missing.
    rest, spread : (M, 3), (M,) float64, mm, optional
        Of a face seen before, to come out in the same frame; NaN for markers not seen then.
    """
    seen = ~np.isnan(positions[..., 0])
    if rest is None or spread is None or (~np.isnan(rest[:, 0])).sum() < _MIN_MARKERS:
        n_seen = seen.sum(axis=1)
        if not len(n_seen) or n_seen.max() < _MIN_MARKERS:
            return None
        rest, spread = _rest_of(positions, np.array(positions[n_seen.argmax()]))
    weights = 1 / (np.nan_to_num(spread, nan=np.inf) ** 2 + _LEAST_SPREAD_MM**2)
    R, t = fit_rigid(rest, positions, weights)
    if np.isnan(R).all():
        return None
    bridged = _bridged(_to_face(positions, R, t))
    world = np.einsum("tij,tmj->tmi", R, bridged) + t[:, None]
    R, t = fit_rigid(rest, np.where(seen[..., None], positions, world), weights)
    in_face = _to_face(positions, R, t)
    new_rest, new_spread = _middle(in_face)
    rest = np.where(np.isnan(rest), new_rest, rest)
    spread = np.where(np.isnan(spread), new_spread, spread)
    return FaceFrame(R, t, in_face, _bridged(in_face), rest, spread)


def _rest_of(
    positions: NDArray[np.float64], rest: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Median places and spread, each round counting markers by their spread in the last one."""
    weights = np.ones(len(rest))
    for _ in range(_ROUNDS):
        in_face = _to_face(positions, *fit_rigid(rest, positions, weights))
        rest, spread = _middle(in_face)
        weights = 1 / (np.nan_to_num(spread, nan=np.inf) ** 2 + _LEAST_SPREAD_MM**2)
    return rest, spread


def _middle(in_face: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Median place and RMS distance from it of each marker; NaN for those never seen."""
    rest = np.full(in_face.shape[1:], np.nan)
    spread = np.full(in_face.shape[1], np.nan)
    for m in range(in_face.shape[1]):
        p = in_face[~np.isnan(in_face[:, m, 0]), m]
        if len(p):
            rest[m] = np.median(p, axis=0)
            spread[m] = np.sqrt(((p - rest[m]) ** 2).sum(axis=1).mean())
    return rest, spread


def _to_face(
    positions: NDArray[np.float64], R: NDArray[np.float64], t: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.asarray(np.einsum("tji,tmj->tmi", R, positions - t[:, None]))


def _bridged(in_face: NDArray[np.float64]) -> NDArray[np.float64]:
    found = np.array(in_face)
    frames = np.arange(len(found))
    for m in range(found.shape[1]):
        known = ~np.isnan(found[:, m, 0])
        if known.any() and not known.all():
            for axis in range(3):
                found[~known, m, axis] = np.interp(
                    frames[~known], frames[known], found[known, m, axis]
                )
    return found
