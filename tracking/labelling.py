"""Names for tracked markers: the constellation of the neutral face, then the face in motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.markers import MarkerSet
from ..core.person import Person
from ..core.trajectories import Source, Trajectories
from .constellation import Constellation, find_constellation
from .face_variation import anyone
from .face_variation import template_positions as template_positions
from .person_model import meet
from .rigid_fit import fit_similarity
from .track_labels import TrackLabels, label_over_time
from .track_pieces import NOBODY

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_NEUTRAL_WINDOW = 10  # frames; the face is still around the neutral one
_SAME_PLACE_MM = 3.0  # no two markers of a still face are this close
_N_TRIES = 6  # frames at which a person who is known is looked for
_SHORTEST_REPAIR = 2  # frames


@dataclass(frozen=True, eq=False)
class Labelling:
    """Which track is which marker at the neutral frame.

    Attributes
    ----------
    track_of_label : mapping from label to index of the track
        Of the names that are certain.
    mean_distance_mm : float
        Between the neutral markers and the average head's, laid over them.
    scale : float
        Of the person against the average head.
    rotation : (3, 3); translation : (3,)
        ``x = scale · rotation · p + translation`` of the average head to the neutral markers.
    refused : tuple of str
        Labels whose marker could not be told for certain.
    """

    track_of_label: dict[str, int]
    mean_distance_mm: float
    scale: float
    rotation: Floats
    translation: Floats
    refused: tuple[str, ...] = ()


@dataclass(frozen=True)
class Repair:
    """What was put right in the tracks.

    Attributes
    ----------
    kind : str
        ``"cut"``: a track went from one marker to another; ``"rejected"``: samples that fit no
        marker, or not certainly, are not delivered (two or more in a row); ``"ghost"``: a track
        that is nobody's at all.
    track : str
        Name of the track.
    first_frame, last_frame : int
        Of a cut, where the old name ends and the new one begins; of what is rejected, its span.
    before, after : str
        Labels of both sides of a cut; "" where the track is nobody's there.
    """

    kind: str
    track: str
    first_frame: int
    last_frame: int
    before: str = ""
    after: str = ""


@dataclass(frozen=True, eq=False)
class Labelled:
    """Tracks with the names of a marker set.

    Attributes
    ----------
    trajectories : Trajectories
        One a label, in the set's order; missing where the marker was not seen, or not for certain.
    person : Person
        Whose face it is: hand it in again for the next chunk or take.
    labelling : Labelling
        Of the frame that names spread from.
    repairs : tuple of Repair
        In order of time.
    """

    trajectories: Trajectories
    person: Person
    labelling: Labelling
    repairs: tuple[Repair, ...]


def label_constellation(points: Floats, marker_set: MarkerSet) -> Labelling:
    """Name the markers of a face at rest, whatever its place, turn, size and owner.

    Names that are not certain are left out (`constellation.find_constellation`).

    Parameters
    ----------
    points : (N, 3) float64, mm
        Without NaN; may hold points that are nobody's.
    marker_set : MarkerSet

    Raises
    ------
    InputError
        If fewer than 6 points are given, or they are no face.
    """
    found = find_constellation(points, anyone(marker_set, at_rest=True))
    return _labelling(points, found, marker_set)


def _labelling(points: Floats, found: Constellation, marker_set: MarkerSet) -> Labelling:
    rows = np.flatnonzero(found.point_of_label >= 0)
    template = template_positions(marker_set)[rows]
    at = points[found.point_of_label[rows]]
    s, R, t = fit_similarity(template, at)
    distance = np.linalg.norm(s * template @ R.T + t - at, axis=1).mean()
    labels = marker_set.labels
    return Labelling(
        {labels[m]: int(found.point_of_label[m]) for m in rows},
        float(distance),
        s,
        R,
        t,
        tuple(labels[m] for m in np.flatnonzero(found.refused >= 0)),
    )


def label_tracks(
    tracks: Trajectories,
    marker_set: MarkerSet,
    *,
    neutral_frame: int = 0,
    person: Person | None = None,
) -> Labelled:
    """Give unlabelled tracks the names of a marker set.

    Without a person, tracks alive at the neutral frame, or within 10 frames of it, are named by
    their constellation. With one, the frame that shows most markers is named as this person's.
    Names spread from there over the take: whose a sample is, the other markers tell, by the
    Gaussian of the face (`face_gaussian`), which is learnt on the way. Tracks that go from marker
    to marker are cut; what fits no marker, or more than one, is not delivered.

    Parameters
    ----------
    tracks : Trajectories
        Unlabelled.
    marker_set : MarkerSet
    neutral_frame : int
        At which the face is at rest; not used with a person.
    person : Person, optional
        Of another chunk or take, with the same markers glued to the same places.

    Raises
    ------
    InputError
        As `label_constellation`; if the neutral frame is outside the take, or the person wore
        another set.
    """
    T = len(tracks.time_s)
    if not 0 <= neutral_frame < T:
        raise InputError(f"the neutral frame {neutral_frame} is outside the take of {T} frames")
    is_stranger = person is None
    if person is None:
        frame = neutral_frame
        labelling, first, person = _meet(tracks, marker_set, frame)
    else:
        person.check_wears(marker_set)
        person = person.select(marker_set.labels)
        labelling, first, frame = _recognise(tracks, marker_set, person)
    labels = label_over_time(np.asarray(tracks.positions), frame, first, person)
    named = _merge(tracks, labels.label, marker_set.labels)
    met = labels.person
    if is_stranger:
        met = _with_late_names(met, named, labelling, frame)
    return Labelled(
        named,
        met,
        labelling,
        _repairs(tracks, labels, marker_set.labels),
    )


def _meet(
    tracks: Trajectories, marker_set: MarkerSet, frame: int
) -> tuple[Labelling, Ints, Person]:
    """Name the face at rest; tracks' labels there, (K,), and the person."""
    seen = ~np.isnan(tracks.positions[..., 0])
    nearest = _nearest_frames(seen, frame)
    is_near = np.abs(nearest - frame) <= _NEUTRAL_WINDOW
    alive = np.flatnonzero(is_near & seen[nearest, np.arange(len(nearest))])
    alive = _without_pieces(tracks.positions, nearest, alive, frame)
    points = tracks.positions[nearest[alive], alive]
    labelling = label_constellation(points, marker_set)
    at = np.full((len(marker_set.labels), 3), np.nan)
    first = np.full(len(tracks.names), NOBODY, dtype=np.int64)
    for label, i in labelling.track_of_label.items():
        m = marker_set.labels.index(label)
        at[m] = points[i]
        first[alive[i]] = m
    person = meet((at - labelling.translation) @ labelling.rotation, marker_set, labelling.scale)
    return _of_tracks(labelling, alive), first, person


def _with_late_names(
    person: Person, named: Trajectories, labelling: Labelling, frame: int
) -> Person:
    """The face at rest, with markers that were seen there but got their names only later."""
    near = slice(max(0, frame - _NEUTRAL_WINDOW), frame + _NEUTRAL_WINDOW + 1)
    p = named.positions[near]
    neutral = np.array(person.neutral)
    for m, label in enumerate(person.labels):
        seen = np.flatnonzero(~np.isnan(p[:, m, 0]))
        if label in labelling.track_of_label or not len(seen):
            continue
        nearest = seen[np.abs(seen + near.start - frame).argmin()]
        neutral[m] = (p[nearest, m] - labelling.translation) @ labelling.rotation
    return replace(person, neutral=neutral)


def _recognise(
    tracks: Trajectories, marker_set: MarkerSet, person: Person
) -> tuple[Labelling, Ints, int]:
    """Name the frame that shows a person best; tracks' labels there, and which frame."""
    n_seen = (~np.isnan(tracks.positions[..., 0])).sum(axis=1)
    tried = _full_frames(n_seen)
    for i, frame in enumerate(tried):
        here = np.flatnonzero(~np.isnan(tracks.positions[frame, :, 0]))
        points = tracks.positions[frame, here]
        try:
            found = find_constellation(points, person)
            labelling = _labelling(points, found, marker_set)
        except InputError:
            if i + 1 == len(tried):
                raise
            continue
        first = np.full(len(tracks.names), NOBODY, dtype=np.int64)
        for m in np.flatnonzero(found.point_of_label >= 0):
            first[here[found.point_of_label[m]]] = m
        return _of_tracks(labelling, here), first, frame
    raise AssertionError("at least one frame was tried")


def _full_frames(n_seen: Ints) -> list[int]:
    """Frames that show many markers, spread over the take, the fullest first."""
    found: list[int] = []
    apart = max(1, len(n_seen) // (2 * _N_TRIES))
    for frame in np.argsort(-n_seen, kind="stable"):
        if all(abs(int(frame) - f) >= apart for f in found):
            found.append(int(frame))
        if len(found) == _N_TRIES:
            break
    return found


def _of_tracks(labelling: Labelling, tracks: Ints) -> Labelling:
    """The same with indices of tracks for those of points."""
    owners = {label: int(tracks[i]) for label, i in labelling.track_of_label.items()}
    return Labelling(
        owners,
        labelling.mean_distance_mm,
        labelling.scale,
        labelling.rotation,
        labelling.translation,
        labelling.refused,
    )


def _nearest_frames(seen: NDArray[np.bool_], frame: int) -> Ints:
    """For each track, (K,), its frame nearest to one; any frame if it is never seen."""
    distance = np.where(seen, np.abs(np.arange(len(seen)) - frame)[:, None], len(seen))
    return np.asarray(distance.argmin(axis=0))


def _without_pieces(positions: Floats, nearest: Ints, alive: Ints, frame: int) -> Ints:
    """Of several tracks in one place, pieces of one marker's, the one nearest to the frame."""
    kept: list[int] = []
    for m in sorted(alive, key=lambda m: abs(int(nearest[m]) - frame)):
        here = positions[nearest[m], m]
        if all(np.linalg.norm(positions[nearest[k], k] - here) >= _SAME_PLACE_MM for k in kept):
            kept.append(int(m))
    return np.array(sorted(kept), dtype=np.int64)


def _merge(tracks: Trajectories, label: Ints, labels: tuple[str, ...]) -> Trajectories:
    """One trajectory a label, in the set's order; all NaN where a marker was never seen."""
    T, M = len(tracks.time_s), len(labels)
    t, k = np.nonzero(label >= 0)
    m = label[t, k]

    def placed(values: NDArray[Any], empty: float) -> NDArray[Any]:
        found = np.full((T, M, *values.shape[2:]), empty, dtype=values.dtype)
        found[t, m] = values[t, k]
        return found

    given: dict[str, Any] = {
        "positions": placed(tracks.positions, np.nan),
        "source": placed(tracks.source, Source.MISSING),
    }
    if tracks.covariances is not None:
        given["covariances"] = placed(tracks.covariances, np.nan)
    if tracks.residual_px is not None:
        given["residual_px"] = placed(tracks.residual_px, np.nan)
    if tracks.n_views is not None:
        given["n_views"] = placed(tracks.n_views, 0)
    return Trajectories(tracks.time_s, labels, **given)


def _repairs(
    tracks: Trajectories, found: TrackLabels, labels: tuple[str, ...]
) -> tuple[Repair, ...]:
    """Where a track changes its name, and where it loses it."""
    repairs: list[Repair] = []
    for k, name in enumerate(tracks.names):
        frames = np.flatnonzero(~np.isnan(tracks.positions[:, k, 0]))
        own = found.label[frames, k]
        if not len(frames):
            continue
        if not (own >= 0).any():
            repairs.append(Repair("ghost", name, int(frames[0]), int(frames[-1])))
            continue
        before, ended = "", 0
        for run in np.split(np.arange(len(own)), np.flatnonzero(np.diff(own)) + 1):
            first, last = int(frames[run[0]]), int(frames[run[-1]])
            if own[run[0]] < 0:
                if len(run) >= _SHORTEST_REPAIR:
                    repairs.append(Repair("rejected", name, first, last, before))
                continue
            label = labels[own[run[0]]]
            if before not in ("", label):
                repairs.append(Repair("cut", name, ended, first, before, label))
            before, ended = label, last
    return tuple(sorted(repairs, key=lambda r: (r.first_frame, r.track)))
