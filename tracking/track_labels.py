"""Names of tracks over time, from the joint Gaussian of the face.

A track is not taken to be one marker for ever: trackers lose markers, and find others in their
place. What says whose a sample is are the other markers of its frame. Evidence is summed along
the track (Viterbi's algorithm over labels and none, where changing costs), so that a change of
identity is cut where the evidence turns.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ..core.errors import InputError
from ..core.person import Person
from .constellation import find_constellation
from .face_gaussian import FaceGaussian, gaussian_cost
from .face_view import look
from .label_doubts import doubtful
from .label_paths import STRAY_COST, along_tracks, without_conflicts
from .person_model import learn
from .track_pieces import NOBODY, cut_at_jumps, joined_pieces, labels_of_pieces
from .weighted_fit import to_head

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_MISSING_COST = 3.0
_ROUNDS, _LEARN_FROM = 5, 1
_MIN_VISIBLE = 5  # markers that tell the head's pose
_WAIT = (2, 6, 20, 60)  # frames of age at which a new track is asked who it is
_NEW_MARGIN = 4.0
_FULL_SEARCH_EVERY = 15  # frames, while the face is lost


@dataclass(frozen=True, eq=False)
class TrackLabels:
    """Whose each track's samples are.

    Attributes
    ----------
    label : (T, K) int64
        Index of the label; −1 where a track is nobody's, not certainly somebody's, or not seen.
    person : Person
        With what was learnt.
    """

    label: Ints
    person: Person


def label_over_time(x: Floats, start: int, first: Ints, person: Person) -> TrackLabels:
    """Name all tracks of a chunk from a frame at which some have names.

    Parameters
    ----------
    x : (T, K, 3) float64, mm, world frame
        Tracks; NaN where not seen.
    start : int
        Frame from which names spread, forwards and backwards.
    first : (K,) int64
        Labels of tracks at that frame; −1 for none.
    person : Person
    """
    pieces, of_track = cut_at_jumps(x)
    label = _spread(pieces, start, labels_of_pieces(pieces, first, of_track, start), person)
    known = person
    for round_ in range(_ROUNDS):
        view = look(pieces, label, known)
        if round_ >= _LEARN_FROM:  # names must be about right before they teach
            known = learn(person, view.trusted, view.prediction.mean)
            view = look(pieces, label, known)
        decided = without_conflicts(along_tracks(label, view), view)
        is_settled = bool((decided == label).all())
        label = decided
        if is_settled and round_ >= _LEARN_FROM:
            break
    view = look(pieces, label, known)
    label = np.where(doubtful(label, view), NOBODY, label)
    return TrackLabels(joined_pieces(label, of_track, x.shape[1]), known)


def _spread(x: Floats, start: int, first: Ints, person: Person) -> Ints:
    """Names from a frame outwards: tracks keep theirs, new ones get what is missing."""
    T = len(x)
    seen = ~np.isnan(x[..., 0])
    label = np.full(seen.shape, NOBODY, dtype=np.int64)
    gaussian = FaceGaussian(person)
    name = first.copy()
    for frames in (range(start, T), range(start, -1, -1)):
        name = _spread_one_way(x, seen, label, frames, name, gaussian)
        name = np.where(seen[start], label[start], first)
    # a track keeps the name that most of its samples got
    for k in range(x.shape[1]):
        got = label[seen[:, k], k]
        got = got[got >= 0]
        if len(got):
            label[seen[:, k], k] = np.bincount(got).argmax()
    return label


def _spread_one_way(
    x: Floats,
    seen: Bools,
    label: Ints,
    frames: Iterable[int],
    name: Ints,
    gaussian: FaceGaussian,
) -> Ints:
    name = name.copy()
    age = np.zeros(x.shape[1], dtype=np.int64)
    lost_since = 0
    for f in frames:
        here = np.flatnonzero(seen[f])
        age[here] += 1
        named = here[name[here] >= 0]
        new = here[name[here] < 0]
        if len(named) >= _MIN_VISIBLE:
            lost_since = 0
            asked = new[np.isin(age[new], _WAIT)]
            if len(asked):
                for k, m in _who_is_new(x[f], named, name, asked, gaussian):
                    name[k] = m
        else:
            if lost_since % _FULL_SEARCH_EVERY == 0 and len(here) > _MIN_VISIBLE:
                for k, m in _found_again(x[f], here, gaussian.person):
                    name[k] = m
            lost_since += 1
        label[f, here] = name[here]
    return name


def _who_is_new(
    points: Floats, named: Ints, name: Ints, asked: Ints, gaussian: FaceGaussian
) -> list[tuple[int, int]]:
    """Pairs (track, label) of tracks whose name is plain; the plainest first, then again."""
    found: list[tuple[int, int]] = []
    M = len(gaussian.person.labels)
    at = np.full((M, 3), np.nan)
    at[name[named]] = points[named]
    asked = asked.copy()
    while len(asked):
        R, t = gaussian.pose(at[None])
        if np.isnan(R).any():
            break
        q = to_head(points[None], R, t)[0]
        expected = gaussian.predict(to_head(at[None], R, t))
        missing = np.flatnonzero(np.isnan(at[:, 0]))
        if not len(missing):
            break
        off = q[asked][:, None] - expected.mean[0][missing]
        costs = gaussian_cost(off, expected.covariance[0][missing]) - STRAY_COST
        rows, columns = linear_sum_assignment(np.minimum(costs, _MISSING_COST))
        best = min(
            (
                (costs[r, c] - _second(costs, r, c), costs[r, c], r, c)
                for r, c in zip(rows, columns, strict=True)
                if costs[r, c] < _MISSING_COST - _NEW_MARGIN
            ),
            default=None,
        )
        if best is None or best[0] > -_NEW_MARGIN:
            break
        _, _, r, c = best
        at[missing[c]] = points[asked[r]]
        found.append((int(asked[r]), int(missing[c])))
        asked = np.delete(asked, r)
    return found


def _second(costs: Floats, row: int, column: int) -> float:
    """The least cost that rivals a pair: another label for the track, another track for it."""
    others = np.concatenate(
        [np.delete(costs[row], column), np.delete(costs[:, column], row), [_MISSING_COST]]
    )
    return float(others.min())


def _found_again(points: Floats, here: Ints, person: Person) -> list[tuple[int, int]]:
    """Names after the face was lost; none if it is not to be found."""
    try:
        found = find_constellation(points[here], person)
    except InputError:
        return []
    labels = np.flatnonzero(found.point_of_label >= 0)
    return [(int(here[found.point_of_label[m]]), int(m)) for m in labels]
