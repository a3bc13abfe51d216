"""Names for tracked markers: the constellation of the neutral face, then re-acquisition."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from ..core.arrays import readonly
from ..core.errors import InputError
from ..core.markers import MarkerSet
from ..core.trajectories import Trajectories
from ..heads.identity import Identity, make_head
from ..heads.marker_sets import glue_markers
from .rigid_fit import fit_rigid, fit_similarity

_N_STARTS = 120  # rotations tried; the farthest turn from the nearest is then about 30°
_ITERATIONS = 12
_AFFINE_ROUNDS = 4
_MISSING_MM = 18.0  # what it costs to leave a marker unmatched, mm of distance
_MISSING_REFINED_MM = 28.0  # the same once most are named: long chins stand farther off
#: The fit must be this good on average, after an affine adaptation to the person.
MAX_MEAN_DISTANCE_MM = 9.0
_SCALES = (0.6, 1.6)  # of a face against the average one
_NEUTRAL_WINDOW = 10  # frames; the face is still around the neutral one
_SAME_PLACE_MM = 3.0  # no two markers of a still face are this close
_REACQUIRE_MM = 6.0
MIN_LABELLED = 6


@dataclass(frozen=True, eq=False)
class Labelling:
    """Which track is which marker at the neutral frame.

    Attributes
    ----------
    track_of_label : mapping from label to index of the track
    mean_distance_mm : float
        Between the neutral markers and the template adapted to them.
    scale : float
        Of the person against the average head.
    world_from_template : (3, 3), (3,)
        Rotation and translation of the average head to the neutral markers.
    """

    track_of_label: dict[str, int]
    mean_distance_mm: float
    scale: float
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]


@cache
def template_positions(marker_set: MarkerSet) -> NDArray[np.float64]:
    """Where a set's markers sit on the average head, (M, 3) mm, head frame; read-only."""
    head = make_head(Identity("average"))
    return readonly(
        glue_markers(head, marker_set).at(head.mesh.vertices), (None, 3), "template positions"
    )


def label_constellation(points: NDArray[np.float64], marker_set: MarkerSet) -> Labelling:
    """Name the markers of one instant, whatever the head's place, turn and size.

    The average head's markers are laid over the points from 120 rotations spread over all of
    SO(3); from each, assignment (Hungarian, leaving a marker out costs 18 mm, at last 28) and
    similarity fit alternate. The best result is refined with an affine fit, which takes up most
    of what makes this person's face unlike the average one. Mirror images are excluded
    throughout.

    Parameters
    ----------
    points : (N, 3) float64, mm
        Without NaN.
    marker_set : MarkerSet

    Raises
    ------
    InputError
        If fewer than 6 points are given, or the best fit is no face.
    """
    if len(points) < MIN_LABELLED:
        raise InputError(
            f"{len(points)} markers are visible in the neutral frame: at least {MIN_LABELLED} are "
            f"needed to tell which is which of {len(marker_set.markers)}"
        )
    template = template_positions(marker_set)
    best: tuple[float, NDArray[np.int64], NDArray[np.int64]] | None = None
    for R0 in _spread_rotations(_N_STARTS):
        rows, columns, cost = _align(template, points, R0)
        if best is None or cost < best[0]:
            best = (cost, rows, columns)
    assert best is not None
    _, rows, columns = best
    rows, columns, distance = _refine(template, points, rows, columns)
    mean = float(distance.mean()) if len(distance) else np.inf
    fits = len(rows) >= MIN_LABELLED and mean <= MAX_MEAN_DISTANCE_MM
    if fits:
        s, R, t = fit_similarity(template[rows], points[columns])
        fits = _SCALES[0] <= s <= _SCALES[1]  # False for NaN: points in one place or on a line
    if not fits:
        raise InputError(
            f"the markers of the neutral frame do not look like marker set {marker_set.name}: "
            f"{len(rows)} of {len(marker_set.markers)} fit, {mean:.1f} mm off on average"
        )
    labels = {marker_set.labels[m]: int(n) for m, n in zip(rows, columns, strict=True)}
    return Labelling(labels, mean, s, R, t)


def _spread_rotations(n: int) -> NDArray[np.float64]:
    """Super-Fibonacci spirals (Alexa 2022): n rotations evenly over SO(3)."""
    s = np.arange(n) + 0.5
    r, q = np.sqrt(s / n), np.sqrt(1 - s / n)
    a, b = 2 * np.pi * s / np.sqrt(2.0), 2 * np.pi * s / 1.533751168755204288118041
    quaternions = np.stack([r * np.sin(a), r * np.cos(a), q * np.sin(b), q * np.cos(b)], axis=1)
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def _assign(
    template: NDArray[np.float64], points: NDArray[np.float64], missing_mm: float = _MISSING_MM
) -> tuple[NDArray[np.int64], NDArray[np.int64], float]:
    """Best pairs; pairs farther apart than the price of a missing marker are dropped."""
    d = np.linalg.norm(template[:, None] - points[None], axis=2)
    capped = np.minimum(d, missing_mm)
    rows, columns = linear_sum_assignment(capped)
    near = d[rows, columns] < missing_mm
    return rows[near], columns[near], float(capped[rows, columns].sum())


def _align(
    template: NDArray[np.float64], points: NDArray[np.float64], R: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], float]:
    size = [np.sqrt(((x - x.mean(axis=0)) ** 2).sum(axis=1).mean()) for x in (template, points)]
    s = size[1] / size[0]
    t = points.mean(axis=0) - s * R @ template.mean(axis=0)
    rows, columns, cost = _assign(s * template @ R.T + t, points)
    for _ in range(_ITERATIONS):
        if len(rows) < 4:
            break
        s, R, t = fit_similarity(template[rows], points[columns])
        if np.isnan(R).any():  # the pairs lie on a line
            break
        s = float(np.clip(s, 0.7, 1.4))
        t = points[columns].mean(axis=0) - s * R @ template[rows].mean(axis=0)
        new_rows, new_columns, new_cost = _assign(s * template @ R.T + t, points)
        if new_cost >= cost - 1e-9:
            break
        rows, columns, cost = new_rows, new_columns, new_cost
    return rows, columns, cost


def _refine(
    template: NDArray[np.float64],
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Adapt the template to the person (affine), assign anew."""
    for _ in range(_AFFINE_ROUNDS):
        if len(rows) < 8:
            break
        A = np.column_stack([template[rows], np.ones(len(rows))])
        M, *_ = np.linalg.lstsq(A, points[columns], rcond=None)
        warped = np.column_stack([template, np.ones(len(template))]) @ M
        rows, columns, _ = _assign(warped, points, _MISSING_REFINED_MM)
    else:
        return rows, columns, np.linalg.norm(warped[rows] - points[columns], axis=1)
    s, R, t = fit_similarity(template[rows], points[columns])
    warped = s * template @ R.T + t
    return rows, columns, np.linalg.norm(warped[rows] - points[columns], axis=1)


def label_tracks(
    tracks: Trajectories, marker_set: MarkerSet, *, neutral_frame: int = 0
) -> tuple[Trajectories, Labelling]:
    """Give unlabelled tracks the names of a marker set.

    Tracks alive at the neutral frame, or within 10 frames of it, are named by their constellation.
    A track that begins later (or ended earlier) continues a marker that is missing then: the
    head's rigid motion, from all markers named so far, carries it to the neutral head, where it
    must lie within 6 mm of the place at which a missing marker was last or next seen; the nearest
    wins. Others are left out.

    Raises
    ------
    InputError
        As `label_constellation`; or if the neutral frame is outside the take.
    """
    T = len(tracks.time_s)
    if not 0 <= neutral_frame < T:
        raise InputError(f"the neutral frame {neutral_frame} is outside the take of {T} frames")
    seen = ~np.isnan(tracks.positions[..., 0])
    nearest = _nearest_frames(seen, neutral_frame)
    alive = np.flatnonzero(np.abs(nearest - neutral_frame) <= _NEUTRAL_WINDOW)
    alive = _without_pieces(tracks.positions, nearest, alive, neutral_frame)
    labelling = label_constellation(tracks.positions[nearest[alive], alive], marker_set)
    owner = {label: [int(alive[i])] for label, i in labelling.track_of_label.items()}
    taken = {rows[0] for rows in owner.values()}
    neutral = {n: tracks.positions[nearest[rows[0]], rows[0]] for n, rows in owner.items()}
    starts = seen.argmax(axis=0)
    order = sorted(
        set(range(len(tracks.names))) - taken, key=lambda m: abs(starts[m] - neutral_frame)
    )
    for track in order:
        label = _continued_marker(tracks, seen, owner, neutral, track, marker_set)
        if label is not None:
            owner.setdefault(label, []).append(track)
    named = {label: alive[i] for label, i in labelling.track_of_label.items()}
    labelling = Labelling(
        {k: int(v) for k, v in named.items()},
        labelling.mean_distance_mm,
        labelling.scale,
        labelling.rotation,
        labelling.translation,
    )
    return _merge(tracks, owner, marker_set), labelling


def _nearest_frames(seen: NDArray[np.bool_], frame: int) -> NDArray[np.int64]:
    """For each track, (M,), its frame nearest to one; every track is seen at some time."""
    distance = np.where(seen, np.abs(np.arange(len(seen)) - frame)[:, None], len(seen))
    return np.asarray(distance.argmin(axis=0))


def _without_pieces(
    positions: NDArray[np.float64],
    nearest: NDArray[np.int64],
    alive: NDArray[np.int64],
    frame: int,
) -> NDArray[np.int64]:
    """Of several tracks in one place, pieces of one marker's, the one nearest to the frame."""
    kept: list[int] = []
    for m in sorted(alive, key=lambda m: abs(int(nearest[m]) - frame)):
        here = positions[nearest[m], m]
        if all(np.linalg.norm(positions[nearest[k], k] - here) >= _SAME_PLACE_MM for k in kept):
            kept.append(int(m))
    return np.array(sorted(kept), dtype=np.int64)


def _continued_marker(
    tracks: Trajectories,
    seen: NDArray[np.bool_],
    owner: dict[str, list[int]],
    neutral: dict[str, NDArray[np.float64]],
    track: int,
    marker_set: MarkerSet,
) -> str | None:
    """The missing marker that a track continues, if any."""
    frames = np.flatnonzero(seen[:, track])
    first, last = frames[0], frames[-1]
    best: tuple[float, str] | None = None
    for label in marker_set.labels:
        rows = owner.get(label, [])
        if any(seen[first : last + 1, r].any() for r in rows):
            continue  # it is seen elsewhere at that time
        for mine, theirs in _gap_ends(seen, rows, int(first), int(last)):
            here = _in_neutral_head(tracks, owner, neutral, mine, track)
            there = _in_neutral_head(tracks, owner, neutral, theirs[0], theirs[1])
            distance = float(np.linalg.norm(here - there))
            if distance < _REACQUIRE_MM and (best is None or distance < best[0]):
                best = (distance, label)
    return best[1] if best else None


def _gap_ends(
    seen: NDArray[np.bool_], rows: list[int], first: int, last: int
) -> list[tuple[int, tuple[int, int]]]:
    """Pairs (frame of the track, (frame, row) of the marker) on both sides of the gaps."""
    found = []
    before = [(int(np.flatnonzero(seen[:first, r])[-1]), r) for r in rows if seen[:first, r].any()]
    after = [
        (int(np.flatnonzero(seen[last + 1 :, r])[0]) + last + 1, r)
        for r in rows
        if seen[last + 1 :, r].any()
    ]
    if before:
        found.append((first, max(before)))
    if after:
        found.append((last, min(after)))
    return found


def _in_neutral_head(
    tracks: Trajectories,
    owner: dict[str, list[int]],
    neutral: dict[str, NDArray[np.float64]],
    frame: int,
    track: int,
) -> NDArray[np.float64]:
    """A track's position at a frame, carried by the head's rigid motion to the neutral head."""
    source, target = [], []
    for label, rest in neutral.items():
        for row in owner[label]:
            p = tracks.positions[frame, row]
            if not np.isnan(p[0]):
                source.append(rest)
                target.append(p)
    R, t = fit_rigid(np.array(source).reshape(-1, 3), np.array(target).reshape(-1, 3))
    return np.asarray((tracks.positions[frame, track] - t) @ R)


def _merge(
    tracks: Trajectories, owner: dict[str, list[int]], marker_set: MarkerSet
) -> Trajectories:
    """One trajectory a label, in the set's order; all NaN where a marker was never seen."""
    T, M = len(tracks.time_s), len(marker_set.labels)
    assert tracks.covariances is not None
    assert tracks.residual_px is not None
    assert tracks.n_views is not None
    positions = np.full((T, M, 3), np.nan)
    covariances = np.full((T, M, 3, 3), np.nan)
    residual, n_views = np.full((T, M), np.nan), np.zeros((T, M), np.int32)
    for m, label in enumerate(marker_set.labels):
        for row in owner.get(label, []):
            there = ~np.isnan(tracks.positions[:, row, 0])
            positions[there, m] = tracks.positions[there, row]
            covariances[there, m] = tracks.covariances[there, row]
            residual[there, m] = tracks.residual_px[there, row]
            n_views[there, m] = tracks.n_views[there, row]
    return Trajectories(
        tracks.time_s,
        marker_set.labels,
        positions,
        covariances,
        residual_px=residual,
        n_views=n_views,
    )
