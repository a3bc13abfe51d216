"""Head motion and FAPs of markers whose motion is known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.core.errors import InputError
from facewright.core.markers import MarkerSet
from facewright.core.mpeg4 import Fapu, fap_by_name, fap_table
from facewright.core.trajectories import Trajectories
from facewright.heads.marker_sets import ready_marker_set
from facewright.tracking.face_variation import template_positions
from facewright.tracking.performance import (
    WORLD_AXES_WITHIN_RAD,
    TrackedPerformance,
    analyse,
)

Floats = NDArray[np.float64]
FAPU = Fapu(irisd=9.0, es=61.0, ens=52.0, mns=17.0, mw=47.0)
N_FRAMES = 40
SLOW_HZ = 20.0


@pytest.fixture(scope="module")
def marker_set() -> MarkerSet:
    return replace(ready_marker_set(), fapu=FAPU)


@pytest.fixture(scope="module")
def neutral(marker_set: MarkerSet) -> Floats:
    return template_positions(marker_set)


def draw_motion(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Rotations and translations of the head; the first is the identity."""
    angles = np.cumsum(rng.normal(0, 0.04, size=(n, 3)), axis=0)
    shifts = np.cumsum(rng.normal(0, 4.0, size=(n, 3)), axis=0)
    R = Rotation.from_euler("YXZ", angles - angles[0]).as_matrix()
    return np.asarray(R), shifts - shifts[0]


def draw_displacements(rng: np.random.Generator, marker_set: MarkerSet, n: int) -> Floats:
    """(T, M, 3) mm, head frame; none in the first frame, none of the head's markers."""
    d = rng.normal(0, 3.0, size=(n, len(marker_set.markers), 3))
    d[0] = 0
    d[:, [m.is_rigid for m in marker_set.markers]] = 0
    return d


def performed(
    marker_set: MarkerSet, p: Floats, R: Floats, t: Floats, *, rate_hz: float = SLOW_HZ
) -> Trajectories:
    """Markers at head-frame places p, (T, M, 3), carried by R, t to the world."""
    world = np.einsum("tij,tmj->tmi", R, p) + t[:, None]
    return Trajectories(np.arange(len(p)) / rate_hz, marker_set.labels, world)


def fap_by_hand(name: str, moved: Floats, fapu: Fapu) -> Floats:
    """Displacement (T, 3) along the axis that the table names, over the unit it names."""
    row = fap_by_name()[name]
    sign, axis = row.axis[0], row.axis[1]
    unit = {"IRISD": fapu.irisd, "ES": fapu.es, "ENS": fapu.ens, "MNS": fapu.mns, "MW": fapu.mw}
    value = moved[:, "xyz".index(axis)] * (1 if sign == "+" else -1)
    return np.asarray(value * 1024 / unit[row.fapu])


def assert_faps_are(
    found: TrackedPerformance, marker_set: MarkerSet, d: Floats, *, atol: float
) -> int:
    """Every FAP of a point that a marker shows; how many there are."""
    by_point = marker_set.label_by_feature_point
    n = 0
    for fap in fap_table():
        if not fap.feature_points or len(fap.axis) != 2 or fap.feature_points[0] not in by_point:
            continue
        moved = d[:, marker_set.labels.index(by_point[fap.feature_points[0]])]
        np.testing.assert_allclose(
            found.faps[fap.name], fap_by_hand(fap.name, moved, found.fapu), atol=atol
        )
        n += 1
    return n


def test_faps_and_head_motion_are_exact_where_markers_are(
    marker_set: MarkerSet, neutral: Floats
) -> None:
    rng = np.random.default_rng(1)
    R, t = draw_motion(rng, N_FRAMES)
    d = draw_displacements(rng, marker_set, N_FRAMES)

    found = analyse(performed(marker_set, neutral + d, R, t), marker_set, point_offsets=False)

    assert found.neutral.axes == "world"
    assert found.neutral.frames.tolist() == [0]
    assert found.fapu_source == "measured"
    assert found.fapu == FAPU
    # units of 1/1024 of a face's distance: 1e-9 mm are about 1e-8 of a unit
    assert assert_faps_are(found, marker_set, d, atol=1e-8) > 30
    np.testing.assert_allclose(found.head_motion.rotation, R, atol=1e-12)
    carried = found.head_motion.world_from_head(found.neutral.positions)
    np.testing.assert_allclose(
        carried, np.einsum("tij,mj->tmi", R, neutral) + t[:, None], atol=1e-9
    )
    assert found.head_motion_linear is not None
    np.testing.assert_allclose(found.head_motion_linear.rotation, R, atol=1e-12)


def test_the_heads_turns_are_faps_48_to_50(marker_set: MarkerSet, neutral: Floats) -> None:
    rng = np.random.default_rng(2)
    R, t = draw_motion(rng, N_FRAMES)

    found = analyse(performed(marker_set, np.tile(neutral, (N_FRAMES, 1, 1)), R, t), marker_set)

    yaw, pitch, roll = Rotation.from_matrix(R).as_euler("YXZ").T
    for name, angle in (("head_pitch", pitch), ("head_yaw", yaw), ("head_roll", roll)):
        number = fap_by_name()[name].number
        assert 48 <= number <= 50
        np.testing.assert_allclose(found.faps[name] * 1e-5, angle, atol=1e-12)


def test_the_inner_lips_follow_the_outer_ones(marker_set: MarkerSet, neutral: Floats) -> None:
    rng = np.random.default_rng(3)
    R, t = draw_motion(rng, N_FRAMES)
    d = draw_displacements(rng, marker_set, N_FRAMES)

    found = analyse(performed(marker_set, neutral + d, R, t), marker_set, point_offsets=False)

    # inner lip, outer lip: Kshirsagar et al. 2000, section 4
    pairs = {"2.2": "8.1", "2.3": "8.2", "2.4": "8.3", "2.5": "8.4"}
    pairs |= {"2.6": "8.5", "2.7": "8.6", "2.8": "8.7", "2.9": "8.8"}
    names = {
        fap.name: pairs[fap.feature_points[0]]
        for fap in fap_table()
        if fap.feature_points and fap.feature_points[0] in pairs and len(fap.axis) == 2
    }
    assert set(found.approximated) == set(names)
    for name, outer in names.items():
        moved = d[:, marker_set.labels.index(marker_set.label_by_feature_point[outer])]
        np.testing.assert_allclose(found.faps[name], fap_by_hand(name, moved, FAPU), atol=1e-8)


def test_unseen_markers_leave_their_faps_unset(marker_set: MarkerSet, neutral: Floats) -> None:
    rng = np.random.default_rng(4)
    R, t = draw_motion(rng, N_FRAMES)
    d = draw_displacements(rng, marker_set, N_FRAMES)
    given = performed(marker_set, neutral + d, R, t)
    p = np.array(given.positions)
    chin, nose = (marker_set.labels.index(n) for n in ("chin_bottom", "nose_tip"))
    p[10:15, chin] = np.nan
    p[:, nose] = np.nan

    found = analyse(Trajectories(given.time_s, given.names, p), marker_set)

    unset = np.flatnonzero(np.isnan(found.faps["open_jaw"]))
    assert unset.tolist() == [10, 11, 12, 13, 14]
    assert not any(
        "9.3" in fap.feature_points for fap in fap_table() if fap.name in found.faps.channels
    )
    others = [n for n in found.faps.channels if fap_by_name()[n].feature_points[:1] != ("2.1",)]
    assert found.faps.is_set is not None
    assert all(not np.isnan(found.faps[n]).any() for n in others)


def test_a_lost_head_marker_is_replaced_by_the_quiet_face(
    marker_set: MarkerSet, neutral: Floats
) -> None:
    R, t = draw_motion(np.random.default_rng(4), N_FRAMES)
    given = performed(marker_set, np.tile(neutral, (N_FRAMES, 1, 1)), R, t)
    p = np.array(given.positions)
    p[7, marker_set.labels.index("head_l")] = np.nan

    found = analyse(Trajectories(given.time_s, given.names, p), marker_set)

    np.testing.assert_allclose(found.head_motion.rotation, R, atol=1e-9)
    assert not np.isnan(found.faps.values).any()


def test_frames_that_do_not_tell_where_the_head_is_are_left_unset(
    marker_set: MarkerSet, neutral: Floats
) -> None:
    rng = np.random.default_rng(4)
    R, t = draw_motion(rng, N_FRAMES)
    given = performed(marker_set, neutral + draw_displacements(rng, marker_set, N_FRAMES), R, t)
    p = np.array(given.positions)
    p[7, marker_set.labels.index("head_l")] = np.nan  # and the face moves by millimetres
    p[9, 2:] = np.nan

    found = analyse(Trajectories(given.time_s, given.names, p), marker_set)

    lost = np.isnan(found.head_motion.quaternion).any(axis=1)
    assert np.flatnonzero(lost).tolist() == [7, 9]
    assert np.isnan(found.faps.values[[7, 9]]).all()
    assert not np.isnan(np.delete(found.faps.values, [7, 9], axis=0)).any()


@pytest.mark.parametrize("yaw_deg", [0.0, 15.0, 30.0, 120.0])
def test_axes_are_the_worlds_up_to_20_degrees_and_the_faces_beyond(
    marker_set: MarkerSet, neutral: Floats, yaw_deg: float
) -> None:
    rng = np.random.default_rng(5)
    R, t = draw_motion(rng, N_FRAMES)
    d = draw_displacements(rng, marker_set, N_FRAMES)
    Q = Rotation.from_euler("y", yaw_deg, degrees=True).as_matrix()
    world = performed(marker_set, neutral + d, R, t).positions @ Q.T + (100.0, 50, -70)
    given = Trajectories(np.arange(N_FRAMES) / SLOW_HZ, marker_set.labels, world)

    auto = analyse(given, marker_set, point_offsets=False)
    face = analyse(given, marker_set, axes="face", point_offsets=False)
    in_world = analyse(given, marker_set, axes="world", point_offsets=False)

    expected = "world" if np.deg2rad(yaw_deg) <= WORLD_AXES_WITHIN_RAD else "face"
    assert auto.neutral.axes == expected
    assert auto.neutral.face_angle_rad == pytest.approx(np.deg2rad(yaw_deg), abs=1e-6)
    # in the face's own axes the FAPs do not know where the world's axes are
    assert_faps_are(face, marker_set, d, atol=1e-6)
    assert_faps_are(in_world, marker_set, d @ Q.T, atol=1e-6)
    np.testing.assert_allclose(face.neutral.positions, neutral, atol=1e-8)
    yaw = Rotation.from_matrix(R).as_euler("YXZ")[:, 0]
    np.testing.assert_allclose(face.faps["head_yaw"] * 1e-5, yaw, atol=1e-7)
    np.testing.assert_allclose(auto.faps.values, (in_world if yaw_deg < 20 else face).faps.values)


def test_a_still_head_is_not_changed_by_smoothing(marker_set: MarkerSet, neutral: Floats) -> None:
    d = draw_displacements(np.random.default_rng(6), marker_set, N_FRAMES)
    R, t = np.tile(np.eye(3), (N_FRAMES, 1, 1)), np.zeros((N_FRAMES, 3))

    given = performed(marker_set, neutral + d, R, t, rate_hz=60.0)
    found = analyse(given, marker_set, point_offsets=False)

    assert_faps_are(found, marker_set, d, atol=1e-8)


def test_smoothing_takes_most_noise_from_a_still_head(
    marker_set: MarkerSet, neutral: Floats
) -> None:
    rng = np.random.default_rng(7)
    n = 240
    p = np.tile(neutral, (n, 1, 1))
    R = np.tile(np.eye(3), (n, 1, 1))
    noisy = performed(marker_set, p, R, np.zeros((n, 3)), rate_hz=60.0)
    noisy = Trajectories(
        noisy.time_s, noisy.names, noisy.positions + rng.normal(0, 0.05, size=p.shape)
    )

    found = analyse(noisy, marker_set)

    def turned(rotation: Floats) -> float:
        angles = Rotation.from_matrix(rotation).magnitude()
        return float(np.sqrt((angles**2).mean()))

    assert found.head_motion_linear is not None
    assert turned(found.head_motion.rotation) < 0.5 * turned(found.head_motion_linear.rotation)
    assert len(found.neutral.frames) == 15  # averaged: the face is still


def test_the_neutral_face_is_the_mean_of_the_still_frames_only(
    marker_set: MarkerSet, neutral: Floats
) -> None:
    n = 30
    d = np.zeros((n, len(neutral), 3))
    d[:8, :, 2] = 0.08 * np.array([1, -1] * 4)[:, None]  # mm: no one holds stiller
    d[8:] = 1.0
    R = np.tile(np.eye(3), (n, 1, 1))

    found = analyse(
        performed(marker_set, neutral + d, R, np.zeros((n, 3))), marker_set, neutral_frame=3
    )

    assert found.neutral.frames.tolist() == list(range(8))
    origin = neutral - found.neutral.positions
    np.testing.assert_allclose(origin - origin[0], 0, atol=1e-9)
    np.testing.assert_allclose(origin[0], found.neutral.translation, atol=1e-9)


def test_estimated_units_are_said_to_be(neutral: Floats) -> None:
    bare = ready_marker_set()
    R, t = draw_motion(np.random.default_rng(0), 5)

    found = analyse(performed(bare, np.tile(neutral, (5, 1, 1)), R, t), bare)

    assert found.fapu_source == "estimated"
    assert found.fapu_sd_mm is not None
    assert set(found.fapu_sd_mm) == set(found.fapu.as_dict())


def test_the_order_of_the_trajectories_and_strangers_among_them_do_not_matter(
    marker_set: MarkerSet, neutral: Floats
) -> None:
    rng = np.random.default_rng(8)
    R, t = draw_motion(rng, N_FRAMES)
    given = performed(marker_set, neutral + draw_displacements(rng, marker_set, N_FRAMES), R, t)
    order = rng.permutation(len(given.names))
    names = (*(given.names[i] for i in order), "elbow")
    p = np.concatenate([given.positions[:, order], np.ones((N_FRAMES, 1, 3))], axis=1)

    mixed = analyse(Trajectories(given.time_s, names, p), marker_set)

    np.testing.assert_array_equal(mixed.faps.values, analyse(given, marker_set).faps.values)


# --------------------------------------------------------------------------------- bad input


@pytest.fixture(scope="module")
def plain(marker_set: MarkerSet, neutral: Floats) -> Trajectories:
    R, t = draw_motion(np.random.default_rng(0), 6)
    return performed(marker_set, np.tile(neutral, (6, 1, 1)), R, t)


def without(given: Trajectories, rows: list[int], frame: int) -> Trajectories:
    p = np.array(given.positions)
    p[frame, rows] = np.nan
    return Trajectories(given.time_s, given.names, p)


def test_head_markers_unseen_in_the_neutral_frame_are_named(
    marker_set: MarkerSet, plain: Trajectories
) -> None:
    given = without(plain, [marker_set.labels.index("head_l")], 2)

    with pytest.raises(InputError, match=r"head markers head_l .* neutral frame 2.*--neutral"):
        analyse(given, marker_set, neutral_frame=2)


def test_a_neutral_frame_without_face_markers_is_refused(
    marker_set: MarkerSet, plain: Trajectories
) -> None:
    face = [i for i, m in enumerate(marker_set.markers) if not m.is_rigid]

    with pytest.raises(InputError, match=r"no face markers are visible .* frame 0.*--neutral"):
        analyse(without(plain, face, 0), marker_set)


@pytest.mark.parametrize("frame", [-1, 6])
def test_a_neutral_frame_outside_the_take_is_refused(
    marker_set: MarkerSet, plain: Trajectories, frame: int
) -> None:
    with pytest.raises(InputError, match=f"neutral frame {frame} is outside the take of 6 frames"):
        analyse(plain, marker_set, neutral_frame=frame)


def test_trajectories_of_other_names_are_refused(
    marker_set: MarkerSet, plain: Trajectories
) -> None:
    names = tuple(f"m{i:03d}" for i in range(30))

    with pytest.raises(InputError, match=r"none of .* \(m000, .*is a label of marker set"):
        analyse(Trajectories(plain.time_s, names, plain.positions), marker_set)


def test_trajectories_without_a_head_marker_are_refused(
    marker_set: MarkerSet, plain: Trajectories
) -> None:
    names = tuple("hat" if n == "head_top" else n for n in plain.names)

    with pytest.raises(InputError, match="no trajectory is named head_top"):
        analyse(Trajectories(plain.time_s, names, plain.positions), marker_set)


def test_unknown_axes_are_a_wrong_call(marker_set: MarkerSet, plain: Trajectories) -> None:
    with pytest.raises(ValueError, match="axes must be"):
        analyse(plain, marker_set, axes="camera")
