"""Gaps in trajectories: short ones from the marker's own curve, longer ones from the others.

Every filled sample is flagged (`Source.INTERPOLATED`, `Source.RECONSTRUCTED`) and carries a
covariance: how far such fillings were off in stretches of the same length that were seen. It holds
on average over the take; where a face moves more than it usually does, fillings are worse.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ..core.trajectories import Source, Trajectories
from .face_frame import FaceFrame, face_frame
from .gap_regression import Floats, Run, fit_gap

DEFAULT_MAX_CUBIC_S = 0.1  # speech turns round in less than twice that
DEFAULT_MAX_GAP_S = 3.0  # measured up to 2 s; beyond, others tell less and less
DEFAULT_KEPT_S = 60.0
_SUPPORT = 8  # samples on each side that shape a cubic
_TRIALS = 60  # seen stretches that a cubic's error is measured on
_MIN_TRIALS = 5


@dataclass(frozen=True, eq=False)
class SeenFace:
    """What has been seen of a face's motion, for filling gaps in what comes next.

    Attributes
    ----------
    names : tuple of str, length M
    rest : (M, 3) float64, mm, face frame
        Usual places; NaN for markers never seen.
    spread : (M,) float64, mm
        How far markers go from there, RMS.
    runs : tuple of Run
        In order of time; filled samples count as not known.
    """

    names: tuple[str, ...]
    rest: Floats
    spread: Floats
    runs: tuple[Run, ...]

    @property
    def seconds(self) -> float:
        """How much was kept."""
        return float(sum(run.time_s[-1] - run.time_s[0] for run in self.runs))


def fill_gaps(
    trajectories: Trajectories,
    *,
    max_gap_s: float = DEFAULT_MAX_GAP_S,
    max_cubic_s: float = DEFAULT_MAX_CUBIC_S,
    seen: SeenFace | None = None,
) -> Trajectories:
    """Fill gaps up to a length; flag what was filled and state its error.

    Gaps up to `max_cubic_s` take cubic splines through the marker's own samples. Longer ones are
    reconstructed from the other markers (`gap_regression`), those that were seen throughout, and
    tied to the marker's own samples on both sides; several markers may be missing at once. Gaps
    at the ends of the take, longer ones, and those for which too little was seen to learn from
    stay NaN: nothing is extrapolated.

    Parameters
    ----------
    trajectories : Trajectories
    max_gap_s : float
        Longest gap, from the last sample before to the first after it.
    max_cubic_s : float
        Longest gap filled by a cubic.
    seen : SeenFace, optional
        What earlier parts of the take showed of the same markers (`learn_face`): of a long take,
        worked in chunks, each chunk learns from those before.
    """
    found = _fill_by_cubics(trajectories, min(max_cubic_s, max_gap_s))
    if max_gap_s <= max_cubic_s or not found.is_missing.any():
        return found
    return _fill_from_others(found, max_gap_s, seen)


def learn_face(
    trajectories: Trajectories, seen: SeenFace | None = None, *, keep_s: float = DEFAULT_KEPT_S
) -> SeenFace | None:
    """Add a take, or a chunk of one, to what has been seen of a face.

    Parameters
    ----------
    trajectories : Trajectories
        Filled samples in it are not learnt from.
    seen : SeenFace, optional
        What was seen before, of the same markers.
    keep_s : float
        How much is kept: the latest. Memory stays bounded.

    Returns
    -------
    SeenFace or None
        None where nothing can be learnt: no three markers seen together.

    Raises
    ------
    ValueError
        If the markers are not those seen before.
    """
    _check_names(trajectories, seen)
    measured = np.where(trajectories.is_measured[..., None], trajectories.positions, np.nan)
    frame = _frame(measured, seen)
    if frame is None:
        return seen
    runs = [*(seen.runs if seen else ()), *_runs(trajectories.time_s, frame)]
    kept: list[Run] = []
    left = keep_s
    for run in reversed(runs):
        if left <= 0:
            break
        late = run.time_s >= run.time_s[-1] - left
        kept.insert(0, Run(run.time_s[late], run.bridged[late], run.known[late]))
        left -= float(run.time_s[-1] - run.time_s[0])
    return SeenFace(trajectories.names, frame.rest, frame.spread, tuple(kept))


def _check_names(trajectories: Trajectories, seen: SeenFace | None) -> None:
    if seen is not None and seen.names != trajectories.names:
        raise ValueError("the markers seen before must have the same names, in the same order")


def _frame(positions: Floats, seen: SeenFace | None) -> FaceFrame | None:
    return face_frame(positions, seen.rest if seen else None, seen.spread if seen else None)


def _runs(time_s: Floats, frame: FaceFrame) -> Iterator[Run]:
    """Pieces with known head motion; a marker never seen in one rests at its usual place."""
    known_motion = ~np.isnan(frame.rotation[:, 0, 0])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known_motion.astype(int), [0]])))
    rest = np.nan_to_num(frame.rest)
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        p = frame.bridged[first:end]
        known = ~np.isnan(frame.positions[first:end, :, 0])
        yield Run(time_s[first:end], np.where(np.isnan(p), rest, p), known)


# ------------------------------------------------------------------------------------- short


def _gaps(known: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Half-open ranges of unknown frames between known ones."""
    frames = np.flatnonzero(known)
    return [(a + 1, b) for a, b in pairwise(frames.tolist()) if b > a + 1]


def _fill_by_cubics(trajectories: Trajectories, max_s: float) -> Trajectories:
    t = trajectories.time_s
    positions, covariances, source = _arrays(trajectories)
    for m in range(len(trajectories.names)):
        original = np.array(trajectories.positions[:, m])
        is_known = ~np.isnan(original[:, 0])
        known = np.flatnonzero(is_known)
        errors: dict[int, Floats] = {}
        for first, end in _gaps(is_known):
            if t[end] - t[first - 1] > max_s + 1e-9:
                continue
            at = int(np.searchsorted(known, first - 1))
            near = known[max(0, at - _SUPPORT + 1) : at + _SUPPORT + 1]
            spline = CubicSpline(t[near], original[near], bc_type="natural")
            positions[first:end, m] = spline(t[first:end])
            source[first:end, m] = Source.INTERPOLATED
            if end - first not in errors:
                errors[end - first] = _cubic_errors(original, is_known, end - first)
            covariances[first:end, m] = errors[end - first]
    return _with(trajectories, positions, covariances, source)


def _cubic_errors(p: Floats, known: NDArray[np.bool_], length: int) -> Floats:
    """Mean squared errors, (length, 3, 3) mm², of cubics over stretches that were seen.

    NaN where fewer than five such stretches exist.
    """
    knots = np.concatenate([np.arange(_SUPPORT), _SUPPORT + length + np.arange(_SUPPORT)])
    inside = _SUPPORT + np.arange(length)
    window = 2 * _SUPPORT + length
    if len(p) < window:
        return np.full((length, 3, 3), np.nan)
    n_known = np.convolve(known, np.ones(window), "valid")
    starts = np.flatnonzero(n_known >= window - 0.5)
    if len(starts) < _MIN_TRIALS:
        return np.full((length, 3, 3), np.nan)
    starts = starts[np.linspace(0, len(starts) - 1, _TRIALS).round().astype(np.int64)]
    spline = CubicSpline(knots.astype(np.float64), np.eye(len(knots)), bc_type="natural")
    weights = spline(inside)  # a natural spline is linear in its samples
    off = np.einsum("ik,nkx->nix", weights, p[starts[:, None] + knots])
    off -= p[starts[:, None] + inside]
    return np.asarray(np.einsum("nix,niy->ixy", off, off) / len(starts))


# -------------------------------------------------------------------------------------- long


def _fill_from_others(
    trajectories: Trajectories, max_gap_s: float, seen: SeenFace | None
) -> Trajectories:
    _check_names(trajectories, seen)
    frame = _frame(trajectories.positions, seen)
    if frame is None:
        return trajectories
    t = trajectories.time_s
    positions, covariances, source = _arrays(trajectories)
    learnt = list(seen.runs) if seen else []
    for run in _runs(t, frame):
        first_frame = int(np.searchsorted(t, run.time_s[0]))
        for first, end, m in _long_gaps(run, max_gap_s):
            others = _predictors(run, m, first, end)
            if not len(others):
                continue
            fit = fit_gap([*learnt, run], run, m, others, first, end, np.nan_to_num(frame.rest))
            if fit is None:
                continue
            rows = slice(first_frame + first, first_frame + end)
            R, shift = frame.rotation[rows], frame.translation[rows]
            positions[rows, m] = np.einsum("tij,tj->ti", R, fit.positions) + shift
            covariances[rows, m] = R @ fit.covariances @ np.swapaxes(R, 1, 2)
            source[rows, m] = Source.RECONSTRUCTED
    return _with(trajectories, positions, covariances, source)


def _long_gaps(run: Run, max_gap_s: float) -> list[tuple[int, int, int]]:
    """(first, end, marker) in order of length."""
    found = [
        (first, end, m)
        for m in range(run.known.shape[1])
        for first, end in _gaps(run.known[:, m])
        if run.time_s[end] - run.time_s[first - 1] <= max_gap_s + 1e-9
    ]
    return sorted(found, key=lambda gap: (gap[1] - gap[0], gap))


def _predictors(run: Run, marker: int, first: int, end: int) -> NDArray[np.int64]:
    """Other markers that were seen all through a gap and at its ends."""
    seen = np.asarray(run.known[first - 1 : end + 1].all(axis=0))
    seen[marker] = False
    return np.flatnonzero(seen)


def _arrays(trajectories: Trajectories) -> tuple[Floats, Floats, NDArray[np.uint8]]:
    p = np.array(trajectories.positions)
    C = trajectories.covariances
    covariances = np.full((*p.shape, 3), np.nan) if C is None else np.array(C)
    return p, covariances, np.array(trajectories.source)


def _with(
    trajectories: Trajectories,
    positions: Floats,
    covariances: Floats,
    source: NDArray[np.uint8],
) -> Trajectories:
    return replace(trajectories, positions=positions, covariances=covariances, source=source)
