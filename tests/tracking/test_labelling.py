"""Which marker is which, on faces of thirty strangers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.core.errors import InputError
from facewright.core.markers import MarkerSet
from facewright.core.trajectories import Trajectories
from facewright.datasets_synthetic.takes import Take, take_truth
from facewright.heads.head import Head
from facewright.heads.marker_sets import glue_markers, ready_marker_set
from facewright.tracking.labelling import label_constellation, label_tracks, template_positions

Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def marker_set() -> MarkerSet:
    return ready_marker_set()


@pytest.fixture(scope="module")
def faces(people: tuple[Head, ...], marker_set: MarkerSet) -> list[Floats]:
    """Neutral markers of each person, (30, 3) mm, head frame."""
    return [glue_markers(head, marker_set).at(head.mesh.vertices) for head in people]


def turn(rng: np.random.Generator, *, upright: bool) -> Floats:
    drawn = Rotation.from_rotvec(rng.normal(0, 0.2, 3)) if upright else Rotation.random(rng=rng)
    return np.asarray(drawn.as_matrix())


def count(
    rng: np.random.Generator,
    face: Floats,
    marker_set: MarkerSet,
    *,
    upright: bool,
    n_missing: int = 0,
    n_ghosts: int = 0,
) -> tuple[int, int]:
    """Right and wrong labels of a face somewhere in space, its points in any order."""
    keep = rng.permutation(len(face))[n_missing:]
    ghosts = rng.uniform(face.min(axis=0), face.max(axis=0), size=(n_ghosts, 3))
    points = np.concatenate([face[keep], ghosts])
    own = np.concatenate([keep, np.full(n_ghosts, -1)])
    order = rng.permutation(len(points))
    scale, shift = rng.uniform(0.9, 1.1), rng.normal(0, 200, 3)
    placed = scale * points[order] @ turn(rng, upright=upright).T + shift
    found = label_constellation(placed, marker_set).track_of_label
    right = sum(own[order][i] == marker_set.labels.index(n) for n, i in found.items())
    return right, len(found) - right


@pytest.mark.parametrize("upright", [True, False])
def test_all_markers_of_all_faces_are_named_right(
    faces: list[Floats], marker_set: MarkerSet, upright: bool
) -> None:
    rng = np.random.default_rng(1)

    results = [count(rng, face, marker_set, upright=upright) for face in faces[:20]]

    assert results == [(30, 0)] * 20


@pytest.mark.parametrize("upright", [True, False])
def test_missing_markers_do_not_mix_up_the_others(
    faces: list[Floats], marker_set: MarkerSet, upright: bool
) -> None:
    """Nothing is named wrong; at most one of them in ten faces is refused."""
    rng = np.random.default_rng(2)

    results = [
        count(rng, face, marker_set, upright=upright, n_missing=n)
        for n, face in zip([1, 2] * 6, faces[10:22], strict=True)
    ]

    assert sum(wrong for _, wrong in results) == 0
    assert sum(right for right, _ in results) >= 6 * (29 + 28) - 2


def test_ghosts_among_the_markers_take_no_name(faces: list[Floats], marker_set: MarkerSet) -> None:
    """Beside the place of a missing marker a ghost could; then the name is mostly refused."""
    rng = np.random.default_rng(3)

    ghosts = [count(rng, face, marker_set, upright=False, n_ghosts=3) for face in faces[:15]]
    both = [
        count(rng, face, marker_set, upright=False, n_missing=3, n_ghosts=3) for face in faces[15:]
    ]

    assert sum(wrong for _, wrong in ghosts) == 0
    assert sum(right for right, _ in ghosts) >= 0.98 * 15 * 30
    assert sum(wrong for _, wrong in both) <= 1
    assert sum(right for right, _ in both) >= 0.98 * 15 * 27


@pytest.mark.parametrize(("glue_mm", "share"), [(2.0, 0.98), (3.0, 0.95)])
def test_markers_glued_aside_are_named_or_refused(
    faces: list[Floats], marker_set: MarkerSet, glue_mm: float, share: float
) -> None:
    """Nobody glues to the millimetre."""
    rng = np.random.default_rng(4)

    results = [
        count(rng, face + rng.normal(0, glue_mm, face.shape), marker_set, upright=False)
        for face in faces[:15]
    ]

    right, wrong = np.sum(results, axis=0)
    assert wrong == 0
    assert right >= share * 15 * 30


def test_a_name_that_two_points_might_have_is_refused(marker_set: MarkerSet) -> None:
    """Two points at equal distances from where the marker belongs: neither is it for certain."""
    template = np.array(template_positions(marker_set))
    m = marker_set.labels.index("cheek_l")
    out = template[m] / np.linalg.norm(template[m])
    points = np.concatenate([np.delete(template, m, axis=0), [template[m] + 3 * out]])
    points = np.concatenate([points, [template[m] - 3 * out]])

    found = label_constellation(points, marker_set)

    assert "cheek_l" not in found.track_of_label
    assert found.refused == ("cheek_l",)
    assert len(found.track_of_label) == 29


def test_the_fit_tells_scale_turn_and_place(faces: list[Floats], marker_set: MarkerSet) -> None:
    template = template_positions(marker_set)
    R = turn(np.random.default_rng(0), upright=False)

    found = label_constellation(1.07 * template @ R.T + (10, 20, 900), marker_set)

    assert found.scale == pytest.approx(1.07, abs=1e-9)
    np.testing.assert_allclose(found.rotation, R, atol=1e-9)
    np.testing.assert_allclose(found.translation, (10, 20, 900), atol=1e-6)
    assert found.mean_distance_mm < 1e-6
    assert found.refused == ()
    assert label_constellation(faces[0], marker_set).mean_distance_mm > 0.5


def test_a_mirrored_face_gets_left_and_right_exchanged(
    faces: list[Floats], marker_set: MarkerSet
) -> None:
    """A mirrored face is a face again; what was on its left is on its right."""
    labels = marker_set.labels
    swap = {"_l": "_r", "_r": "_l"}
    mirrored = [
        labels.index(label[:-2] + swap[label[-2:]]) if label[-2:] in swap else i
        for i, label in enumerate(labels)
    ]
    rng = np.random.default_rng(0)
    for face in faces[:5]:
        placed = face * (-1, 1, 1) @ turn(rng, upright=False).T

        found = label_constellation(placed, marker_set)

        assert found.track_of_label == dict(zip(labels, mirrored, strict=True))
        assert np.linalg.det(found.rotation) == pytest.approx(1)


def test_too_few_points_are_refused(marker_set: MarkerSet) -> None:
    with pytest.raises(InputError, match=r"5 markers are visible .* at least 6 .* of 30"):
        label_constellation(template_positions(marker_set)[:5], marker_set)


@pytest.mark.parametrize(
    "what", ["cloud", "dense cloud", "grid", "line", "one place", "ten times as large"]
)
def test_what_is_no_face_is_refused(marker_set: MarkerSet, what: str) -> None:
    rng = np.random.default_rng(0)
    points = {
        "cloud": rng.uniform(-300, 300, size=(30, 3)),
        "dense cloud": rng.uniform(-70, 70, size=(30, 3)),
        "grid": np.stack(np.meshgrid(np.arange(6) * 20.0, np.arange(5) * 25.0, [0.0]), -1),
        "line": np.linspace(-80, 80, 30)[:, None] * np.array([0.2, 1.0, 0.3]),
        "one place": np.full((10, 3), 7.0),
        "ten times as large": 10 * template_positions(marker_set),
    }[what].reshape(-1, 3)

    with pytest.raises(InputError, match="do not look like marker set kshirsagar"):
        label_constellation(points, marker_set)


def test_of_two_faces_one_is_named_and_the_other_left_alone(
    faces: list[Floats], marker_set: MarkerSet
) -> None:
    both = np.concatenate([faces[0], faces[1] @ turn(np.random.default_rng(0), upright=True)])
    both[30:] += (400, 20, -30)

    found = label_constellation(both, marker_set).track_of_label

    rows = np.array([found[label] for label in marker_set.labels])
    assert (rows == np.arange(30)).all() or (rows == np.arange(30) + 30).all()


# ------------------------------------------------------------------------------- over a take


@pytest.fixture(scope="module")
def true_positions(short_take: Take) -> Floats:
    return take_truth(short_take).marker_positions


def tracks_of(
    take: Take, true: Floats, pieces: list[tuple[int, int, int]], ghosts: tuple[Floats, ...] = ()
) -> Trajectories:
    """Unlabelled tracks: (marker, first, end) each, in random order, then ghosts' (T, 3)."""
    p = np.full((len(true), len(pieces) + len(ghosts), 3), np.nan)
    for row, (marker, first, end) in enumerate(pieces):
        p[first:end, row] = true[first:end, marker]
    for i, ghost in enumerate(ghosts):
        p[:, len(pieces) + i] = ghost
    p = p[:, np.random.default_rng(5).permutation(p.shape[1])]
    seen = ~np.isnan(p[..., 0])
    covariances = np.where(seen[..., None, None], 0.01 * np.eye(3), np.nan)
    names = tuple(f"m{i:03d}" for i in range(p.shape[1]))
    residual = np.where(seen, 0.1, np.nan)
    return Trajectories(
        take.time_s,
        names,
        p,
        covariances,
        residual_px=residual,
        n_views=np.where(seen, 4, 0).astype(np.int32),
    )


def expected_positions(true: Floats, pieces: list[tuple[int, int, int]]) -> Floats:
    found = np.full_like(true, np.nan)
    for marker, first, end in pieces:
        found[first:end, marker] = true[first:end, marker]
    return found


def test_markers_that_come_back_get_their_names_again(
    short_take: Take, true_positions: Floats
) -> None:
    """Six are lost while the head and the face move, neighbours at the same time.

    A marker back for four frames only may be refused, but is never given another's name.
    """
    T = len(true_positions)
    labels = ready_marker_set().labels
    lost = ("lip_upper_mid", "lip_upper_l", "lip_upper_r", "lid_upper_l", "lid_lower_l", "head_top")
    pieces = []
    for m, label in enumerate(labels):
        gap = [(m, 0, 20), (m, T - 4, T)] if label in lost else [(m, 0, T)]
        pieces += gap

    found = label_tracks(
        tracks_of(short_take, true_positions, pieces), ready_marker_set()
    ).trajectories

    assert found.names == labels
    expected = expected_positions(true_positions, pieces)
    seen = ~np.isnan(found.positions[..., 0])
    np.testing.assert_array_equal(found.positions[seen], expected[seen])
    assert (~np.isnan(expected[..., 0]) & ~seen).sum() <= 4
    np.testing.assert_array_equal(np.asarray(found.n_views) == 4, seen)
    assert found.residual_px is not None
    np.testing.assert_array_equal(~np.isnan(found.residual_px), seen)


def test_a_neutral_frame_amid_the_take_names_what_was_before_and_after(
    short_take: Take, true_positions: Floats
) -> None:
    T = len(true_positions)
    pieces = [(m, 0, T) for m in range(30) if m not in (3, 9)]
    pieces += [(3, 0, 6), (3, 9, T), (9, 0, 14), (9, 22, T)]

    whole = label_tracks(
        tracks_of(short_take, true_positions, pieces), ready_marker_set(), neutral_frame=12
    )
    found, labelling = whole.trajectories, whole.labelling

    np.testing.assert_array_equal(found.positions, expected_positions(true_positions, pieces))
    assert set(labelling.track_of_label) == set(ready_marker_set().labels)


def test_a_marker_never_seen_is_nan_throughout(short_take: Take, true_positions: Floats) -> None:
    T = len(true_positions)
    pieces = [(m, 0, T) for m in range(30) if m != 7]

    whole = label_tracks(tracks_of(short_take, true_positions, pieces), ready_marker_set())
    found, labelling = whole.trajectories, whole.labelling

    np.testing.assert_array_equal(found.positions, expected_positions(true_positions, pieces))
    assert ready_marker_set().labels[7] not in labelling.track_of_label


def test_a_track_of_nothing_on_the_face_is_left_out(
    short_take: Take, true_positions: Floats
) -> None:
    T = len(true_positions)
    pieces = [(m, 0, T) for m in range(30) if m != 4] + [(4, 0, 15), (4, 22, T)]
    late = np.full((T, 3), np.nan)
    late[18:] = true_positions[18:, 4] + (15, 10, 0)  # beside the marker that is lost
    lamp = np.tile([150.0, 120, -60], (T, 1))

    found = label_tracks(
        tracks_of(short_take, true_positions, pieces, (late, lamp)), ready_marker_set()
    ).trajectories

    np.testing.assert_array_equal(found.positions, expected_positions(true_positions, pieces))


def test_a_neutral_frame_outside_the_take_is_refused(
    short_take: Take, true_positions: Floats
) -> None:
    T = len(true_positions)
    tracks = tracks_of(short_take, true_positions, [(m, 0, T) for m in range(30)])

    with pytest.raises(InputError, match=f"neutral frame {T} is outside the take of {T} frames"):
        label_tracks(tracks, ready_marker_set(), neutral_frame=T)


def test_a_neutral_face_without_markers_is_refused(
    short_take: Take, true_positions: Floats
) -> None:
    tracks = tracks_of(
        short_take, true_positions, [(m, 20, len(true_positions)) for m in range(30)]
    )

    with pytest.raises(InputError, match="0 markers are visible in the neutral frame"):
        label_tracks(tracks, ready_marker_set(), neutral_frame=2)


@pytest.mark.parametrize("lost", ["lip_upper_mid", "lid_lower_r", "chin_boss"])
def test_a_broken_track_does_not_lend_its_name_to_a_missing_neighbour(
    short_take: Take, true_positions: Floats, lost: str
) -> None:
    """Two pieces of one marker around the neutral frame, and a marker that is never seen."""
    T = len(true_positions)
    labels = ready_marker_set().labels
    rest = true_positions[0]
    m = labels.index(lost)
    distance = np.linalg.norm(rest - rest[m], axis=1)
    neighbour = int(np.argsort(distance)[1])
    pieces = [(i, 0, T) for i in range(30) if i not in (m, neighbour)]
    pieces += [(neighbour, 0, 5), (neighbour, 7, T)]

    found = label_tracks(
        tracks_of(short_take, true_positions, pieces), ready_marker_set()
    ).trajectories

    np.testing.assert_array_equal(found.positions, expected_positions(true_positions, pieces))
