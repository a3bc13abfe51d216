"""Whose a track's samples are, over time: synthetic faces whose tracks are spoilt on purpose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.core.errors import InputError
from facewright.core.markers import MarkerSet
from facewright.core.trajectories import Trajectories
from facewright.datasets_synthetic.sightings import (
    MarkerMotion,
    Sightings,
    Trouble,
    marker_motion,
    sight_markers,
)
from facewright.datasets_synthetic.takes import Take
from facewright.heads.marker_sets import ready_marker_set
from facewright.tracking.labelling import Labelled, label_tracks
from facewright.tracking.tracker import FrameDots, follow_markers

Floats = NDArray[np.float64]
SAME_MM = 2.5


@pytest.fixture(scope="module")
def marker_set() -> MarkerSet:
    return ready_marker_set()


@pytest.fixture(scope="module")
def take(make_plain_take: Callable[..., Take]) -> Take:
    """Three seconds at 60 Hz: rest, then a hurried medley."""
    return make_plain_take(61, seconds=3.0, **{"actor.head": "average"})


@pytest.fixture(scope="module")
def motion(take: Take) -> MarkerMotion:
    return marker_motion(take)


@pytest.fixture(scope="module")
def other_take(make_plain_take: Callable[..., Take]) -> Take:
    """The same actor, with the same markers, another day."""
    return make_plain_take(62, seconds=2.0, **{"actor.head": "average"})


def tracks_of(p: Floats, time_s: Floats, rng: np.random.Generator) -> Trajectories:
    """Tracks (T, K, 3) in random order, with noise of 0.1 mm, as a tracker would have them."""
    p = p[:, rng.permutation(p.shape[1])] + rng.normal(0, 0.1, (p.shape[0], p.shape[1], 3))
    p = p[:, ~np.isnan(p[..., 0]).all(axis=0)]
    names = tuple(f"m{i:03d}" for i in range(p.shape[1]))
    covariances = np.where(np.isnan(p)[..., None], np.nan, 0.01 * np.eye(3))
    return Trajectories(time_s, names, p, covariances)


def count(found: Labelled, truth: Floats) -> tuple[int, int]:
    """Samples that are delivered right, and wrong."""
    p = found.trajectories.positions
    there = ~np.isnan(p[..., 0])
    off = np.linalg.norm(p - truth, axis=2)
    return int((there & (off < SAME_MM)).sum()), int((there & ~(off < SAME_MM)).sum())


def pairs_of(truth: Floats, n: int, rng: np.random.Generator) -> list[tuple[int, int, int]]:
    """(frame, marker, its nearest neighbour): the closest meetings first, then any."""
    T, M = truth.shape[:2]
    found = []
    for a in range(M):
        d = np.linalg.norm(truth[20:-10] - truth[20:-10, a : a + 1], axis=2)
        d[:, a] = np.inf
        f, b = np.unravel_index(int(d.argmin()), d.shape)
        found.append((float(d.min()), int(f) + 20, a, int(b)))
    closest = sorted(found)[: n // 2]
    drawn = [found[i] for i in rng.permutation(M)[: n - len(closest)]]
    at_random = [(0.0, int(rng.integers(20, T - 10)), a, b) for _, _, a, b in drawn]
    return [(f, a, b) for _, f, a, b in closest + at_random]


@pytest.mark.parametrize("seed", [0, 1])
def test_swaps_are_undone_and_reported(
    motion: MarkerMotion, marker_set: MarkerSet, seed: int
) -> None:
    """Ten times two neighbours' tracks change places for good."""
    rng = np.random.default_rng(seed)
    truth = motion.markers
    p = np.array(truth)
    row = np.arange(p.shape[1])  # which row holds which marker, as time goes on
    for f, a, b in sorted(pairs_of(truth, 10, rng)):
        p[f:, [row[a], row[b]]] = p[f:, [row[b], row[a]]]
        row[[a, b]] = row[[b, a]]

    found = label_tracks(tracks_of(p, motion.time_s, rng), marker_set)

    right, wrong = count(found, truth)
    assert wrong == 0
    assert right >= 0.99 * truth.shape[0] * truth.shape[1]
    cuts = [r for r in found.repairs if r.kind == "cut"]
    assert 12 <= len(cuts) <= 24, "ten swaps of two tracks each; some undo each other"
    assert all(r.before in marker_set.labels and r.after in marker_set.labels for r in cuts)
    assert all(r.before != r.after and r.first_frame < r.last_frame for r in cuts)


def test_a_track_that_goes_over_to_a_neighbour_is_cut_there(
    motion: MarkerMotion, marker_set: MarkerSet
) -> None:
    """The lower lid's marker is lost; its track goes on with the upper lid's, whose own ends."""
    upper, lower = (marker_set.labels.index(f"lid_{n}_l") for n in ("upper", "lower"))
    truth = np.array(motion.markers)
    d = np.linalg.norm(truth[:, upper] - truth[:, lower], axis=1)
    f = 20 + int(d[20:-30].argmin())
    p = np.array(truth)
    p[f:, lower] = truth[f:, upper]
    p[f:, upper] = np.nan
    truth[f:, lower] = np.nan

    found = label_tracks(tracks_of(p, motion.time_s, np.random.default_rng(2)), marker_set)

    seen = ~np.isnan(truth[..., 0])
    right, wrong = count(found, truth)
    assert wrong == 0
    assert right >= seen.sum() - 12, "beside the cut, lids that touch may be refused"
    (cut,) = (r for r in found.repairs if r.kind == "cut")
    assert (cut.before, cut.after) == ("lid_lower_l", "lid_upper_l")
    assert cut.first_frame <= f + 1
    assert cut.last_frame >= f - 1


def test_a_track_that_slides_over_to_a_neighbour_is_cut_in_between(
    motion: MarkerMotion, marker_set: MarkerSet
) -> None:
    """Within eight frames and without a jump, from the cheek to the cheekbone."""
    a, b = (marker_set.labels.index(n) for n in ("cheek_l", "cheekbone_l"))
    truth = np.array(motion.markers)
    share = np.clip((np.arange(len(truth)) - 90) / 8, 0, 1)[:, None]
    p = np.array(truth)
    p[:, a] = (1 - share) * truth[:, a] + share * truth[:, b]
    p[90:, b] = np.nan
    truth[91:, a] = np.nan
    truth[90:98, b] = np.nan

    found = label_tracks(tracks_of(p, motion.time_s, np.random.default_rng(12)), marker_set)

    right, wrong = count(found, np.where(np.isnan(truth), motion.markers, truth))
    assert wrong <= 3, "the first steps are within what a cheek does by itself"
    assert right >= (~np.isnan(truth[..., 0])).sum() - 12
    (cut,) = (r for r in found.repairs if r.kind == "cut")
    assert (cut.before, cut.after) == ("cheek_l", "cheekbone_l")
    assert 88 <= cut.first_frame < cut.last_frame <= 100


def test_a_hand_hides_half_the_face_for_a_second(
    motion: MarkerMotion, marker_set: MarkerSet
) -> None:
    """Everything below the eyes is lost at once, and comes back at once, elsewhere by then."""
    truth = np.array(motion.markers)
    below = truth[0, :, 1] < truth[0, marker_set.labels.index("nose_tip"), 1] + 5
    assert below.sum() >= 12
    truth[70:130, below] = np.nan
    late = np.full_like(truth[:, below], np.nan)
    late[130:] = truth[130:, below]
    p = np.concatenate([truth, late], axis=1)
    p[130:, np.flatnonzero(below)] = np.nan

    found = label_tracks(tracks_of(p, motion.time_s, np.random.default_rng(3)), marker_set)

    right, wrong = count(found, truth)
    assert wrong == 0
    assert right >= 0.995 * (~np.isnan(truth[..., 0])).sum()


def test_a_face_that_was_lost_altogether_is_found_again(
    motion: MarkerMotion, marker_set: MarkerSet
) -> None:
    truth = np.array(motion.markers)
    truth[80:110] = np.nan
    before, after = truth.copy(), truth.copy()
    before[80:], after[:110] = np.nan, np.nan
    p = np.concatenate([before, after], axis=1)

    found = label_tracks(tracks_of(p, motion.time_s, np.random.default_rng(4)), marker_set)

    right, wrong = count(found, truth)
    assert wrong == 0
    assert right >= 0.99 * (~np.isnan(truth[..., 0])).sum()


def test_a_marker_not_seen_at_rest_gets_its_name_later(
    motion: MarkerMotion, marker_set: MarkerSet
) -> None:
    truth = np.array(motion.markers)
    late = [marker_set.labels.index(n) for n in ("chin_boss", "brow_mid_r", "cheek_l")]
    truth[:40, late] = np.nan

    found = label_tracks(tracks_of(truth, motion.time_s, np.random.default_rng(5)), marker_set)

    right, wrong = count(found, truth)
    assert wrong == 0
    assert right >= 0.99 * (~np.isnan(truth[..., 0])).sum()
    assert not {marker_set.labels[m] for m in late} & set(found.labelling.track_of_label)
    assert found.person.is_known.all()
    rest = motion.markers[0]
    rest = rest - rest.mean(axis=0)
    placed = found.person.neutral - found.person.neutral.mean(axis=0)
    off = np.linalg.norm(placed - rest, axis=1)
    assert off[late].max() < 3.0, "they were never seen at rest"
    assert np.delete(off, late).max() < 1.0


def test_a_stray_that_a_track_catches_for_an_instant_is_not_delivered(
    motion: MarkerMotion, marker_set: MarkerSet
) -> None:
    rng = np.random.default_rng(6)
    truth = motion.markers
    p = np.array(truth)
    caught = [
        (int(f), int(m)) for f, m in zip(range(30, 170, 7), rng.integers(0, 30, 20), strict=True)
    ]
    for f, m in caught:
        way = rng.normal(size=3)
        p[f, m] += 5.0 * way / np.linalg.norm(way)

    found = label_tracks(tracks_of(p, motion.time_s, rng), marker_set)

    assert all(np.isnan(found.trajectories.positions[f, m, 0]) for f, m in caught)
    right, wrong = count(found, truth)
    assert wrong == 0
    assert right >= 0.99 * (truth.shape[0] * truth.shape[1] - len(caught))


def test_a_new_take_is_labelled_from_an_old_one(
    motion: MarkerMotion, other_take: Take, marker_set: MarkerSet
) -> None:
    """In mid-performance, without any face at rest, and with four markers fallen off."""
    rng = np.random.default_rng(7)
    person = label_tracks(tracks_of(motion.markers, motion.time_s, rng), marker_set).person
    other = marker_motion(other_take)
    truth = np.array(other.markers[60:])
    truth[:, [2, 9, 17, 24]] = np.nan

    found = label_tracks(tracks_of(truth, other.time_s[60:], rng), marker_set, person=person)

    right, wrong = count(found, truth)
    assert wrong == 0
    assert right >= 0.99 * (~np.isnan(truth[..., 0])).sum()
    assert found.person.n_frames == person.n_frames + len(truth)


def test_a_person_of_another_set_is_refused(motion: MarkerMotion, marker_set: MarkerSet) -> None:
    tracks = tracks_of(motion.markers[:30], motion.time_s[:30], np.random.default_rng(8))
    person = label_tracks(tracks, marker_set).person
    fewer = MarkerSet("fewer", marker_set.markers[3:])

    with pytest.raises(InputError, match=r"learnt with marker set kshirsagar-27\+3"):
        label_tracks(tracks, fewer, person=person)


def test_names_do_not_depend_on_the_world_or_on_the_order_of_tracks(
    motion: MarkerMotion, marker_set: MarkerSet
) -> None:
    from scipy.spatial.transform import Rotation

    truth = motion.markers[:100]
    R = Rotation.from_rotvec([0.4, -2.0, 1.1]).as_matrix()
    moved = truth @ R.T + (300.0, -100.0, 900.0)

    for p in (truth, moved):
        found = label_tracks(
            tracks_of(p, motion.time_s[:100], np.random.default_rng(9)), marker_set
        )
        right, wrong = count(found, p)
        assert wrong == 0
        assert right >= 0.995 * p.shape[0] * p.shape[1]


def test_what_is_nobodys_is_reported_as_a_ghost(
    motion: MarkerMotion, marker_set: MarkerSet
) -> None:
    """A lamp, an ear-ring that goes with the head, and a track without a sample."""
    truth = motion.markers[:60]
    lamp = np.tile([150.0, 120, -60], (60, 1, 1))
    ring = truth[:, :1] + (75.0, 20.0, -70.0)
    empty = np.full((60, 1, 3), np.nan)
    p = np.concatenate([truth, lamp, ring, empty], axis=1)
    names = (*(f"m{i}" for i in range(30)), "lamp", "ring", "empty")

    found = label_tracks(Trajectories(motion.time_s[:60], names, p), marker_set)

    np.testing.assert_array_equal(found.trajectories.positions, truth)
    assert found.trajectories.covariances is None
    assert {(r.kind, r.track, r.first_frame, r.last_frame) for r in found.repairs} == {
        ("ghost", "lamp", 0, 59),
        ("ghost", "ring", 0, 59),
    }


def followed(take: Take, sightings: Sightings, noise_px: float) -> Trajectories:
    frames = (
        FrameDots(float(t), centres, tuple(np.full(len(c), noise_px) for c in centres))
        for t, centres in zip(sightings.time_s, sightings.centres, strict=True)
    )
    return follow_markers(take.rig, frames).trajectories


def test_hands_drops_and_ghosts_leave_no_wrong_label(
    take: Take, motion: MarkerMotion, marker_set: MarkerSet
) -> None:
    """Through the real tracker: 10 % of dots and of markers dropped, two hands, stray lights."""
    trouble = Trouble(dropped=0.1, lost=0.1, n_passes=2)
    sightings = sight_markers(take, motion, trouble, rng=np.random.default_rng(10))

    found = label_tracks(followed(take, sightings, trouble.noise_px), marker_set)

    right, wrong = count(found, motion.markers)
    visible = int((sightings.n_seen() >= 2).sum())
    assert wrong == 0
    assert right >= 0.99 * visible, f"{right} of {visible}"
