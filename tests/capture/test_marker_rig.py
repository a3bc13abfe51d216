"""Rigs against unlabelled markers: moved cameras found, their poses, gauges, and bad input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from facewright.capture.camera_shifts import CameraShift, PoseSd
from facewright.capture.marker_rig import camera_shifts, refine_rig
from facewright.capture.mid_take_moves import find_moves
from facewright.capture.rays import Pose, nearest_points
from facewright.capture.rig_gauge import (
    aligned,
    change_from_step,
    changed,
    covariance_in_gauge,
    deviation,
    gauge_directions,
)
from facewright.capture.spot_matching import SpotFrame, match_spots
from facewright.cli.marker_spots import match_by_views
from facewright.core.errors import InputError
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.rigs import face_rig

Floats = NDArray[np.float64]
SD = 0.08


def rig_of(n: int, seed: int = 3) -> Rig:
    return face_rig(np.random.default_rng(seed), n_cameras=n)


def moved(rig: Rig, name: str, mm: ArrayLike, deg: ArrayLike) -> Rig:
    """A camera turned about its own centre, and shifted."""
    camera = rig[name]
    R = Rotation.from_rotvec(np.deg2rad(deg)).as_matrix() @ camera.camera_from_world.rotation
    pose = Rigid.from_rotation(R, -R @ (camera.position + np.array(mm)))
    return Rig({**rig.cameras, name: replace(camera, camera_from_world=pose)})


def frames_of(
    rig: Rig, n: int = 25, *, seed: int = 0, sd: float = SD, bias: float = 0.0, motion: float = 1.0
) -> list[SpotFrame]:
    """A face of 28 markers that turns and works; spots shuffled, some hidden.

    `bias`: errors of each marker in each camera that are the same in all frames. `motion` of the
    head: 1 is lively.
    """
    rng = np.random.default_rng(seed)
    face = np.column_stack([rng.uniform(-55, 55, 28), rng.uniform(-70, 70, 28), np.zeros(28)])
    face[:, 2] = 40 - 0.009 * (face[:, :2] ** 2).sum(axis=1)
    normals = np.column_stack([0.018 * face[:, :2], np.ones(28)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    fixed = {name: rng.normal(0, bias, (28, 2)) for name in rig}
    found = []
    for i in range(n):
        turn = Rotation.from_rotvec(motion * rng.normal(size=3) * (0.1, 0.2, 0.06))
        X = turn.apply(face + rng.normal(size=face.shape))
        X += motion * rng.normal(size=3) * (15, 10, 12)
        spots = []
        for name, camera in rig.cameras.items():
            way = camera.position - X
            way /= np.linalg.norm(way, axis=1, keepdims=True)
            seen = ((way * turn.apply(normals)).sum(axis=1) > 0.25) & (rng.random(28) > 0.04)
            uv = camera.project(X) + fixed[name] + rng.normal(0, sd, (28, 2))
            spots.append(rng.permutation(uv[seen]))
        found.append(SpotFrame(f"frame {i}", tuple(spots), tuple(np.ones(len(s)) for s in spots)))
    return found


def of(shifts: Sequence[CameraShift]) -> list[str]:
    return [s.camera for s in shifts if s.is_moved]


@pytest.mark.parametrize("n_cameras", [3, 5])
@pytest.mark.parametrize(
    ("mm", "deg"),
    [
        ((3.0, -4.0, 0.0), (0.3, 0.4, 0.0)),  # 5 mm, 0.5 degrees
        ((0.0, 0.0, 0.0), (0.0, 0.5, 0.0)),
        ((0.0, 5.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.5, 0.5, 0.5), (0.03, 0.0, -0.04)),
        ((10.0, 0.0, 10.0), (-1.0, 1.5, 1.0)),
    ],
)
def test_a_knocked_camera_is_named_and_measured(
    n_cameras: int, mm: tuple[float, ...], deg: tuple[float, ...]
) -> None:
    old = rig_of(n_cameras)
    now = moved(old, "cam1", mm, deg)

    shifts = camera_shifts(old, frames_of(now), match_by_views)

    assert of(shifts) == ["cam1"]
    shift = shifts[1]
    assert shift.p_value < 1e-4
    assert shift.distance_mm == pytest.approx(np.linalg.norm(mm), abs=0.6)
    assert np.rad2deg(shift.angle_rad) == pytest.approx(np.linalg.norm(deg), abs=0.03)
    np.testing.assert_allclose(
        shift.camera_from_world.matrix, now["cam1"].camera_from_world.matrix, atol=0.6
    )


@pytest.mark.parametrize("n_cameras", [2, 3, 6])
def test_no_camera_is_named_if_none_moved(n_cameras: int) -> None:
    rig = rig_of(n_cameras)
    rng = np.random.default_rng(5)
    old = rig
    for name in rig:  # as well as calibrations know them
        old = moved(old, name, rng.normal(0, 0.1, 3), np.rad2deg(rng.normal(0, 1e-4, 3)))

    for seed in range(3):
        assert of(camera_shifts(old, frames_of(rig, seed=seed), match_by_views)) == []


def test_errors_that_repeat_themselves_do_not_make_cameras_move() -> None:
    rig = rig_of(4)
    frames = frames_of(rig, 40, sd=0.03, bias=0.12, motion=0.1)

    found = refine_rig(rig, frames, match_by_views)

    assert of(found.shifts) == []
    alone = refine_rig(rig, frames_of(rig, 40, sd=0.124, motion=0.1), match_by_views)
    told, naive = (np.trace(f.calibration.joint_covariance[6:, 6:]) for f in (found, alone))
    assert told > 5 * naive  # 40 frames tell the same errors 40 times


def test_two_cameras_cannot_tell_which_moved() -> None:
    old = rig_of(2)

    found = refine_rig(old, frames_of(moved(old, "cam0", (0, 0, 0), (0, 0, 0.1))), match_by_views)

    assert of(found.shifts) == ["cam0", "cam1"]
    assert any("two cameras cannot tell" in w for w in found.calibration.warnings)


def test_two_of_four_cameras_may_have_moved() -> None:
    old = rig_of(4)
    now = moved(moved(old, "cam0", (4, 0, 0), (0.4, 0, 0)), "cam3", (0, 3, 0), (0, -0.5, 0))

    found = refine_rig(old, frames_of(now), match_by_views)

    assert of(found.shifts) == ["cam0", "cam3"]
    assert set(found.matched.placed_anew) >= {"cam0", "cam3"}
    mended = found.mended(old)
    assert mended["cam1"] is not None
    np.testing.assert_array_equal(mended["cam1"].position, old["cam1"].position)
    assert np.linalg.norm(mended["cam3"].position - now["cam3"].position) < 0.8


def in_world_of(found: Rig, truth: Rig) -> dict[str, Floats]:
    """Distances of centres after the best similarity (Umeyama's, by SciPy's Kabsch)."""
    p = np.stack([c.position for c in found.cameras.values()])
    q = np.stack([c.position for c in truth.cameras.values()])
    turn, _ = Rotation.align_vectors(q - q.mean(axis=0), p - p.mean(axis=0))
    scale = np.linalg.norm(q - q.mean(axis=0)) / np.linalg.norm(p - p.mean(axis=0))
    laid = scale * turn.apply(p - p.mean(axis=0)) + q.mean(axis=0)
    return dict(zip(found, np.linalg.norm(laid - q, axis=1), strict=True))


def test_without_noise_the_refined_rig_is_exact_up_to_the_gauge() -> None:
    truth = rig_of(4)
    old = moved(moved(truth, "cam1", (0.4, 0, -0.3), (0.02, 0, 0)), "cam2", (0, 0.5, 0), (0, 0, 0))

    found = refine_rig(old, frames_of(truth, sd=0.0), match_by_views).calibration

    assert max(in_world_of(found.rig, truth).values()) < 1e-4
    assert found.rms_used_px < 1e-9


def test_the_size_of_the_rig_stays_that_of_its_steady_cameras() -> None:
    truth = rig_of(4)
    grown = Rig({
        n: replace(c, camera_from_world=Rigid(c.camera_from_world.quaternion,
                                              1.001 * c.camera_from_world.translation))
        for n, c in truth.cameras.items()
    })  # fmt: skip

    found = refine_rig(grown, frames_of(truth), match_by_views)

    def size(rig: Rig) -> float:
        p = np.stack([c.position for c in rig.cameras.values()])
        return float(np.linalg.norm(p[:, None] - p[None], axis=2).sum() / 12)

    assert of(found.shifts) == []
    assert size(found.calibration.rig) == pytest.approx(size(grown), rel=1e-12)


def test_the_stated_covariance_is_that_of_repetition() -> None:
    truth, n = rig_of(4), 16
    found = [refine_rig(truth, frames_of(truth, 14, seed=s), match_by_views) for s in range(n)]
    rows = np.array([_against_first(f.calibration.rig, truth) for f in found])
    stated = [f.calibration.joint_covariance for f in found]
    chi2 = []
    for row, C in zip(rows, stated, strict=True):
        values, vectors = np.linalg.eigh(_unit(C[6:, 6:]))
        z = (row[6:] / np.sqrt(np.diag(C)[6:])) @ vectors[:, 1:]  # the scale is held: rank 17
        chi2.append(float((z**2 / values[1:]).sum()))

    # 17 degrees of freedom each; the clusters' factor makes it somewhat wide
    assert 0.65 * 17 < np.mean(chi2) < 1.2 * 17


def _unit(C: Floats) -> Floats:
    d = np.sqrt(np.diag(C))
    return np.asarray(C / np.outer(d, d))


def _against_first(found: Rig, truth: Rig) -> Floats:
    """(24,) δrotation and centre, true less found, the first camera and the mean distance held."""
    names = found.names
    p = np.stack([found[n].position for n in names])
    q = np.stack([truth[n].position for n in names])
    size = [np.linalg.norm(x[:, None] - x[None], axis=2).sum() for x in (p, q)]
    # truth, moved so that its first camera is the found one's
    turn = found[names[0]].camera_from_world.rotation.T @ truth[names[0]].camera_from_world.rotation
    rows = []
    for i, n in enumerate(names):
        R = truth[n].camera_from_world.rotation @ turn.T
        centre = p[0] + size[0] / size[1] * turn @ (q[i] - q[0])
        delta = Rotation.from_matrix(R @ found[n].camera_from_world.rotation.T).as_rotvec()
        rows += [delta, centre - p[i]]
    return np.concatenate(rows)


def test_a_move_in_mid_take_is_found_and_dated() -> None:
    before = rig_of(4)
    after = moved(before, "cam2", (1.0, -1.5, 0.5), (0.2, -0.4, 0.1))
    frames = [
        replace(f, name=f"frame {i}")
        for i, f in enumerate([*frames_of(before, 26), *frames_of(after, 19, seed=1)])
    ]

    moves = find_moves(before, frames, match_by_views)

    assert [(m.camera, m.index, m.before, m.after) for m in moves] == [
        ("cam2", 26, "frame 25", "frame 26")
    ]
    assert moves[0].shift.distance_mm == pytest.approx(np.linalg.norm((1, 1.5, 0.5)), abs=0.5)
    assert find_moves(before, frames[:24], match_by_views) == ()


def test_footage_of_another_rig_is_refused() -> None:
    other = rig_of(4, seed=11)
    swapped = Rig({"cam0": other["cam3"], "cam1": other["cam0"], "cam2": other["cam1"],
                   "cam3": other["cam2"]})  # fmt: skip

    with pytest.raises(InputError, match="too few of the cameras' spots meet in space"):
        refine_rig(swapped, frames_of(other), match_by_views)


def test_a_camera_that_sees_nothing_is_named() -> None:
    rig = rig_of(3)
    none = np.zeros((0, 2)), np.zeros(0)
    frames = [
        replace(f, centres=(*f.centres[:2], none[0]), sd_px=(*f.sd_px[:2], none[1]))
        for f in frames_of(rig, 5)
    ]

    with pytest.raises(InputError, match="cam2: no bright spots"):
        refine_rig(rig, frames, match_by_views)


def test_too_few_points_are_told() -> None:
    with pytest.raises(InputError, match="points are seen by two cameras or more"):
        refine_rig(rig_of(4), frames_of(rig_of(4), 1), match_by_views)


def test_one_camera_is_no_rig() -> None:
    with pytest.raises(InputError, match="two cameras or more"):
        refine_rig(rig_of(1), [], match_by_views)


def test_matching_places_a_knocked_camera_anew() -> None:
    old = rig_of(4)
    now = moved(old, "cam3", (0, 0, 4.0), (0.5, 0, 0.3))

    found = match_spots(old, frames_of(now, 20), match_by_views)

    assert found.placed_anew == ("cam3",)
    assert found.share.min() > 0.85
    assert np.linalg.norm(found.rig["cam3"].position - now["cam3"].position) < 1.0


# the gauge


def poses_of(rig: Rig) -> list[Pose]:
    return [
        (c.camera_from_world.rotation, c.camera_from_world.translation)
        for c in rig.cameras.values()
    ]


def test_directions_of_the_gauge_leave_pictures_as_they_are() -> None:
    rig = rig_of(3)
    X = np.random.default_rng(0).normal(0, 50, (10, 3))
    poses, N = poses_of(rig), gauge_directions(poses_of(rig))
    for k, size in enumerate([1e-6] * 3 + [1e-3] * 3 + [1e-6]):
        step = np.zeros(7)
        step[k] = size
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        world = (1 + step[6]) * X @ turn.T + step[3:6]
        for c, (name, camera) in enumerate(rig.cameras.items()):
            R, t = changed(poses[c], N[6 * c : 6 * c + 6] @ step)
            there = replace(camera, camera_from_world=Rigid.from_rotation(R, t))
            np.testing.assert_allclose(
                there.project(world), rig[name].project(X), atol=1e-7, err_msg=f"{name} {k}"
            )


def test_alignment_undoes_any_similarity() -> None:
    rig = rig_of(4)
    rng = np.random.default_rng(1)
    Q, q, s = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 500, 3), 1.7
    old = poses_of(rig)
    # close enough for a linear start: the worlds of two calibrations of one rig are
    Q = Rotation.from_rotvec(0.3 * Rotation.from_matrix(Q).as_rotvec()).as_matrix()
    elsewhere = [(R @ Q.T, s * t - R @ Q.T @ q) for R, t in old]

    back = aligned(elsewhere, old, np.ones(24))

    np.testing.assert_allclose(deviation(back, old), 0, atol=1e-7)


def test_steps_of_the_solver_are_changes() -> None:
    pose = poses_of(rig_of(1))[0]
    step = np.array([2e-6, -1e-6, 3e-6, 1e-3, -2e-3, 1e-3])
    R = Rotation.from_rotvec(step[:3]).as_matrix() @ pose[0]

    change = deviation([(R, pose[1] + step[3:])], [pose])

    np.testing.assert_allclose(change_from_step([pose]) @ step, change, rtol=1e-4, atol=1e-9)


def test_covariance_in_a_gauge_holds_what_is_held() -> None:
    rig = rig_of(3)
    poses = poses_of(rig)
    rng = np.random.default_rng(2)
    A = rng.normal(size=(40, 18)) * np.tile([1e3] * 3 + [1.0] * 3, 3)
    N = gauge_directions(poses)
    A = A - A @ N @ np.linalg.pinv(N)

    C = covariance_in_gauge(A.T @ A, poses, (0, 1, 2))

    np.testing.assert_array_equal(C[:6], 0)
    p = np.stack([c.position for c in rig.cameras.values()])
    row = np.zeros(18)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        way = (p[a] - p[b]) / np.linalg.norm(p[a] - p[b])
        row[6 * a + 3 : 6 * a + 6] += way
        row[6 * b + 3 : 6 * b + 6] -= way
    assert abs(row @ C @ row) < 1e-9 * np.abs(C).max() * (row @ row)
    assert np.linalg.matrix_rank(_unit(C[6:, 6:]), tol=1e-8) == 11


def test_rays_meet_where_the_points_are() -> None:
    rig = rig_of(4)
    X = np.random.default_rng(0).normal(0, 60, (50, 3))
    xy = np.stack([c.undistort(c.project(X)) for c in rig.cameras.values()], axis=1)
    xy[::3, 0] = np.nan
    xy[::7, 1:] = np.nan

    found = nearest_points(poses_of(rig), xy)

    lone = np.isfinite(xy[..., 0]).sum(axis=1) < 2
    assert lone.any()
    assert np.isnan(found[lone]).all()
    np.testing.assert_allclose(found[~lone], X[~lone], atol=1e-8)


def test_a_prior_as_wide_as_a_knock_hides_it() -> None:
    old = rig_of(4)
    now = moved(old, "cam1", (1.0, 0, 0), (0, 0.1, 0))

    wide = PoseSd(centre_mm=20.0, rotation_rad=0.05)

    assert of(camera_shifts(old, frames_of(now), match_by_views)) == ["cam1"]
    assert of(camera_shifts(old, frames_of(now), match_by_views, pose_sd=wide)) == []
