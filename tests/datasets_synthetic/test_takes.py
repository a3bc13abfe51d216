"""A take's truth, worked out again by other means."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.core.mpeg4 import fap_by_name, fap_table
from facewright.datasets_synthetic.markers_on_faces import STICKER_MM
from facewright.datasets_synthetic.performances import NEUTRAL_S
from facewright.datasets_synthetic.takes import Take, Truth, take_truth

Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def take(make_plain_take: Callable[..., Take]) -> Take:
    return make_plain_take(5, seconds=1.5, rate_hz=20.0)


@pytest.fixture(scope="module")
def truth(take: Take) -> Truth:
    return take_truth(take)


def world_vertices(take: Take, frame: int) -> Floats:
    """The actor's vertices, carried to the world by SciPy."""
    pose = take.pose(float(take.time_s[frame]))
    turn = Rotation.from_quat(pose.world_from_head.quaternion, scalar_first=True)
    return np.asarray(turn.apply(pose.vertices) + pose.world_from_head.translation)


def nearest_on_triangle(p: Floats, corners: Floats) -> Floats:
    """Nearest points of triangles (F, 3, 3) to a point, (F, 3): within, or on one of the sides."""
    a = corners
    b = np.roll(corners, -1, axis=1)
    along = b - a
    s = ((p - a) * along).sum(axis=2) / (along**2).sum(axis=2)
    on_sides = a + np.clip(s, 0, 1)[..., None] * along
    best = on_sides[np.arange(len(a)), ((on_sides - p) ** 2).sum(axis=2).argmin(axis=1)]
    n = np.cross(along[:, 0], along[:, 1])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    foot = p - ((p - a[:, 0]) * n).sum(axis=1)[:, None] * n
    inside = (np.einsum("fcx,fx->fc", np.cross(along, foot[:, None] - a), n) >= 0).all(axis=1)
    return np.asarray(np.where(inside[:, None], foot, best))


@pytest.mark.parametrize("frame", [0, 12, 29])
def test_markers_lie_a_stickers_thickness_off_the_skin(
    take: Take, truth: Truth, frame: int
) -> None:
    skin = take.head.mesh.triangles[take.head.mesh.groups["skin"]]
    corners = world_vertices(take, frame)[skin]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    distances = []
    for p in truth.marker_positions[frame]:
        nearest = nearest_on_triangle(p, corners)
        d = np.linalg.norm(nearest - p, axis=1)
        best = int(d.argmin())
        distances.append(d[best])
        assert (p - nearest[best]) @ normals[best] > 0, "outside the skin"

    assert max(distances) < STICKER_MM + 1e-5
    # in the folds of an expression the skin beside may be nearer than that below
    assert np.median(distances) > 0.97 * STICKER_MM


def test_the_first_frames_are_neutral_exactly(take: Take, truth: Truth) -> None:
    still = take.time_s <= NEUTRAL_S
    assert still.sum() >= 6
    known = ~np.isnan(truth.faps[0])
    assert (truth.faps[still][:, known] == 0).all()
    np.testing.assert_array_equal(
        truth.marker_positions[still], np.tile(truth.marker_positions[0], (still.sum(), 1, 1))
    )
    for name, p in truth.feature_points.items():
        np.testing.assert_allclose(p[still], [take.head.points[name]] * still.sum(), atol=1e-12)


def test_faps_are_the_displacements_of_feature_points_in_the_tables_units(
    take: Take, truth: Truth
) -> None:
    """From the vertices in the world, the head's motion taken out by SciPy."""
    units = take.head.fapu
    millimetres = {
        "IRISD": units.irisd, "ES": units.es, "ENS": units.ens, "MNS": units.mns, "MW": units.mw,
    }  # fmt: skip
    n_checked = 0
    for frame in (10, 17, 29):
        turn = Rotation.from_quat(truth.head_quaternion[frame], scalar_first=True)
        p = take.head.feature_points.at(world_vertices(take, frame))
        in_head = turn.inv().apply(p - truth.head_translation[frame])
        moved = dict(zip(take.head.feature_points.names, in_head, strict=True))
        for fap in fap_table():
            if len(fap.axis) != 2 or not fap.feature_points or fap.number in (27, 28):
                continue
            fp = fap.feature_points[0]
            axis = "xyz".index(fap.axis[1])
            sign = 1 if fap.axis[0] == "+" else -1
            d = moved[fp][axis] - take.head.points[fp][axis]
            expected = sign * d * 1024 / millimetres[fap.fapu]
            # the shapes are float32
            assert truth.faps[frame, fap.number - 1] == pytest.approx(expected, abs=2e-3), fap.name
            n_checked += 1
    assert n_checked >= 3 * 45


def test_the_heads_turns_are_in_the_faps(take: Take, truth: Truth) -> None:
    turn = Rotation.from_quat(truth.head_quaternion, scalar_first=True)
    yaw, pitch, roll = turn.as_euler("YXZ").T

    for name, angle in (("head_pitch", pitch), ("head_yaw", yaw), ("head_roll", roll)):
        found = truth.faps[:, fap_by_name()[name].number - 1]
        np.testing.assert_allclose(found * 1e-5, angle, atol=1e-9)
    assert np.ptp(yaw) > 0.01


def test_eyes_turn_as_their_pupils_do(make_plain_take: Callable[..., Take]) -> None:
    """Right-handed about y to the subject's left, about x downwards, seen from the eye's centre."""
    take = make_plain_take(9, seconds=2.0, rate_hz=20.0)
    truth = take_truth(take)
    n_moved = 0
    for side, yaw_fap, pitch_fap in (("left", 23, 25), ("right", 24, 26)):
        eye = take.head.eyes[side]
        chosen = take.head.feature_points.select(("3.5" if side == "left" else "3.6",))
        pupil = chosen.corners[0, chosen.barycentric[0].argmax()]  # the point is a vertex
        rest = take.head.mesh.vertices[pupil] - eye.centre
        for frame, t in enumerate(take.time_s):
            here = take.pose(float(t)).vertices[pupil] - eye.centre
            yaw, pitch = truth.faps[frame, [yaw_fap - 1, pitch_fap - 1]] * 1e-5
            expected = Rotation.from_euler("YX", [yaw, pitch]).apply(rest)
            assert np.linalg.norm(here - expected) < 0.05  # mm, of 14
            n_moved += abs(yaw) > 0.05
    assert n_moved > 10


def test_the_mandible_carries_the_lower_teeth(make_plain_take: Callable[..., Take]) -> None:
    take = make_plain_take(9, seconds=3.0, rate_hz=10.0, **{"performance.style": "speech"})
    truth = take_truth(take)
    rows = take.head.part_vertices("teeth_lower")
    rest = take.head.mesh.vertices[rows]
    opened = 0.0
    for frame, t in enumerate(take.time_s):
        turn = Rotation.from_quat(truth.jaw_quaternion[frame], scalar_first=True)
        expected = turn.apply(rest) + truth.jaw_translation[frame]
        here = take.pose(float(t)).vertices[rows]
        np.testing.assert_allclose(here, expected, atol=1e-6)
        opened = max(opened, float(np.abs(expected - rest).max()))
    assert opened > 2  # mm: the mouth was open once


def test_positions_are_smooth(truth: Truth, take: Take) -> None:
    speed = np.linalg.norm(np.diff(truth.marker_positions, axis=0), axis=2) * 20
    assert speed.max() < 600  # mm/s


def test_unknown_faps_are_nan_and_known_ones_are_not(truth: Truth) -> None:
    known = ~np.isnan(truth.faps)
    assert (known.all(axis=0) | ~known.any(axis=0)).all()
    assert not known[:, :2].any()  # visemes and expressions
    assert known[0].sum() >= 55


def test_a_seed_is_a_take(make_plain_take: Callable[..., Take]) -> None:
    a, b, c = (make_plain_take(s, seconds=0.6, rate_hz=20.0) for s in (2, 2, 4))

    np.testing.assert_array_equal(take_truth(a).marker_positions, take_truth(b).marker_positions)
    np.testing.assert_array_equal(a.rig["cam0"].matrix, b.rig["cam0"].matrix)
    assert not np.array_equal(a.head.mesh.vertices, c.head.mesh.vertices)
