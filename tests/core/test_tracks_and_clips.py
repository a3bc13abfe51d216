"""Trajectories, clips, head motion, meshes and marker sets."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from facewright.core.clip import Clip
from facewright.core.errors import InputError
from facewright.core.head_motion import HeadMotion
from facewright.core.markers import Marker, MarkerSet
from facewright.core.mesh import Mesh, SurfacePoints, vertex_normals
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.core.trajectories import Source, Trajectories

TIMES = np.arange(5) / 50.0


# --- Trajectories ---


def trajectories() -> Trajectories:
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(5, 3, 3))
    positions[2, 1] = np.nan
    source = np.ones((5, 3), np.uint8)
    source[2, 1], source[3, 2] = Source.MISSING, Source.INTERPOLATED
    covariances = np.tile(np.eye(3), (5, 3, 1, 1))
    return Trajectories(
        TIMES,
        ("a", "b", "c"),
        positions,
        covariances,
        source,
        np.ones((5, 3)),
        np.ones((5, 3), np.int32),
    )


def test_selecting_markers_takes_everything_of_them() -> None:
    whole = trajectories()
    part = whole.select(("c", "a"))
    assert part.names == ("c", "a")
    for name in ("positions", "covariances", "source", "residual_px", "n_views"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[:, [2, 0]])
    assert part.rate_hz == 50


def test_nothing_is_filled_unless_said() -> None:
    plain = Trajectories(TIMES, ("a",), np.zeros((5, 1, 3)))
    assert not plain.is_filled.any()
    assert plain.is_measured.all()
    assert plain.residual_px is None


def test_a_sample_is_missing_where_it_has_no_position_and_only_there() -> None:
    positions = np.zeros((5, 2, 3))
    positions[1, 1] = np.nan
    found = Trajectories(TIMES, ("a", "b"), positions)
    assert np.argwhere(found.is_missing).tolist() == [[1, 1]]
    assert (found.is_measured != found.is_missing).all()
    for source in (Source.MISSING, 7):
        with pytest.raises(ValueError, match="source"):
            Trajectories(TIMES, ("a", "b"), positions, source=np.full((5, 2), source, np.uint8))


@pytest.mark.parametrize(
    ("names", "broken", "message"),
    [
        (("a", "a"), 0.0, "marker names must differ; twice: a"),
        (("a",), 0.0, r"positions must have shape \(5, 1, 3\)"),
        (("a", "b"), np.nan, "NaN in all three"),
        (("a", "b"), np.inf, "NaN in all three"),
    ],
)
def test_trajectories_that_cannot_be_are_refused(
    names: tuple[str, ...], broken: float, message: str
) -> None:
    positions = np.zeros((5, 2, 3))
    positions[1, 1, 2] = broken
    with pytest.raises(ValueError, match=message):
        Trajectories(TIMES, names, positions)


def test_a_value_cannot_be_changed() -> None:
    whole = trajectories()
    with pytest.raises(FrozenInstanceError):
        whole.names = ()  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        whole.positions[0] = 0


# --- Clip ---


def test_what_is_not_set_is_nan_and_the_other_way_round() -> None:
    values = np.array([[1.0, np.nan], [2.0, 3.0]])
    clip = Clip(np.array([0.0, 1.0]), ("x", "y"), values, np.array([[True, True], [False, True]]))
    np.testing.assert_array_equal(clip.is_set, [[True, False], [False, True]])
    np.testing.assert_array_equal(clip["x"], [1, np.nan])


def test_resampling_is_linear_between_set_keys_only() -> None:
    clip = Clip(np.arange(4.0), ("x",), np.array([[np.nan], [10.0], [np.nan], [30.0]]))
    found = clip.resample(np.array([0.5, 1.0, 1.5, 2.0, 3.0, 3.5]))
    np.testing.assert_allclose(found["x"], [np.nan, 10, 15, 20, 30, np.nan])


def test_resampling_at_its_own_times_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    clip = Clip(np.cumsum(rng.uniform(0.01, 0.1, 50)), ("x", "y"), rng.normal(size=(50, 2)))
    np.testing.assert_allclose(clip.resample(clip.time_s).values, clip.values, atol=1e-12)


def test_resampling_keeps_straight_lines() -> None:
    t = np.array([0.0, 0.13, 0.5, 1.1])
    clip = Clip(t, ("x",), (3 * t - 1)[:, None])
    fine = np.linspace(0, 1.1, 40)
    np.testing.assert_allclose(clip.resample(fine)["x"], 3 * fine - 1, atol=1e-12)


def test_viseme_fields_are_held_not_interpolated() -> None:
    names = ("viseme.select1", "expression.def", "open_jaw")
    clip = Clip(np.array([0.0, 1.0]), names, np.array([[4.0, 0, 0], [11.0, 1, 100]]))
    found = clip.resample(np.array([0.25, 0.9, 1.0]))
    np.testing.assert_allclose(found.values, [[4, 0, 25], [4, 0, 90], [11, 1, 100]])


@pytest.mark.parametrize(
    ("channels", "value", "message"),
    [(("x", "x"), 0.0, "twice: x"), (("x", "y"), np.inf, "finite"), (("x",), 0.0, "shape")],
)
def test_clips_that_cannot_be_are_refused(
    channels: tuple[str, ...], value: float, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Clip(np.arange(3.0), channels, np.full((3, 2), value))


# --- HeadMotion ---


def test_head_motion_agrees_with_rigid_frame_by_frame() -> None:
    rng = np.random.default_rng(0)
    q, t = rng.normal(size=(5, 4)), rng.normal(size=(5, 3)) * 50
    motion = HeadMotion(TIMES, q, t)
    points = rng.normal(size=(5, 7, 3)) * 80

    world = motion.world_from_head(points)

    for frame in range(5):
        np.testing.assert_allclose(world[frame], Rigid(q[frame], t[frame]).apply(points[frame]))
    np.testing.assert_allclose(motion.head_from_world(world), points, atol=1e-12)


def test_head_motion_carries_one_set_of_points_to_all_times() -> None:
    rng = np.random.default_rng(1)
    motion = HeadMotion(TIMES, rng.normal(size=(5, 4)), rng.normal(size=(5, 3)))
    points = rng.normal(size=(6, 3))
    found = motion.world_from_head(points)
    assert found.shape == (5, 6, 3)
    np.testing.assert_allclose(found, motion.world_from_head(np.tile(points, (5, 1, 1))))
    with pytest.raises(ValueError, match=r"\(M, 3\)"):
        motion.world_from_head(points[0])


def test_unknown_head_motion_gives_unknown_points() -> None:
    q = np.tile((1.0, 0, 0, 0), (5, 1))
    q[2] = np.nan
    found = HeadMotion(TIMES, q, np.zeros((5, 3))).world_from_head(np.ones((4, 3)))
    assert np.isnan(found[2]).all()
    assert np.isfinite(found[[0, 1, 3, 4]]).all()


# --- Mesh ---


def test_points_on_a_surface_move_with_it() -> None:
    corners = np.array([[0, 1, 2]])
    points = SurfacePoints(
        ("p", "q"), np.repeat(corners, 2, 0), np.array([[1, 0, 0], [0.2, 0.3, 0.5]])
    )
    vertices = np.random.default_rng(0).normal(size=(4, 3, 3))
    found = points.at(vertices)
    np.testing.assert_allclose(found[:, 0], vertices[:, 0])
    np.testing.assert_allclose(found[:, 1], np.einsum("c,tcx->tx", [0.2, 0.3, 0.5], vertices))
    assert points.select(("q",)).names == ("q",) and points.index("q") == 1


def test_normals_point_out_of_a_sphere() -> None:
    v = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    f = np.array(
        [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    )
    np.testing.assert_allclose(vertex_normals(v, f), v, atol=1e-12)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("triangles", [[0, 1, 3]]),
        ("triangles", [[0, 1, -1]]),
        ("uv", [[0.0, 0.0]]),
        ("groups", {"lip": [1]}),
    ],
)
def test_meshes_that_cannot_be_are_refused(field: str, value: object) -> None:
    good: dict[str, object] = {"vertices": np.zeros((3, 3)), "triangles": [[0, 1, 2]]}
    Mesh(**good)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"must lie in|come together"):
        Mesh(**{**good, field: value})  # type: ignore[arg-type]


def test_barycentric_coordinates_sum_to_one() -> None:
    with pytest.raises(ValueError, match="sum to 1"):
        SurfacePoints(("p",), np.array([[0, 1, 2]]), np.array([[0.5, 0.5, 0.5]]))


def test_a_rig_needs_a_camera() -> None:
    with pytest.raises(ValueError, match="at least one"):
        Rig({})


# --- MarkerSet ---

HEADS = tuple(Marker(f"h{n}", "head", (float(n), 0.0, 0.0)) for n in range(3))


def test_a_marker_set_knows_its_parts() -> None:
    markers = MarkerSet("lab", (*HEADS, Marker("chin", "2.1"), Marker("lip", "8.1")))
    assert markers.head_labels == ("h0", "h1", "h2")
    assert markers.label_by_feature_point == {"2.1": "chin", "8.1": "lip"}
    assert markers.labels[-1] == "lip"


@pytest.mark.parametrize(
    ("markers", "message"),
    [
        ((*HEADS, Marker("a", "2.1"), Marker("a", "8.1")), "label a is given twice"),
        ((*HEADS, Marker("a", "8.1"), Marker("b", "8.1")), "feature point 8.1 is given twice"),
        ((*HEADS, Marker("a", "12.1")), "unknown feature point 12.1"),
        ((*HEADS[:2], Marker("a", "8.1")), "at least 3 markers .* found 2"),
        ((*HEADS, Marker("a", "head")), "head marker a needs template_mm"),
    ],
)
def test_marker_sets_that_cannot_be_used_are_refused(
    markers: tuple[Marker, ...], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        MarkerSet("lab", markers)
