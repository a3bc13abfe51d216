"""Millimetres of a rig: against repetition, Monte Carlo, the tracker's triangulation, formulas."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.capture.lens import BoardView
from facewright.capture.rig_face import (
    FACE_MM,
    face_points,
    face_uncertainty,
    facing_frame,
    place_of_face,
    plane_uncertainty,
)
from facewright.capture.rig_uncertainty import sample_rigs, triangulation_sd_mm
from facewright.capture.rigs import RigCalibration, calibrate_rig
from facewright.core.boards import parse_board
from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.board_poses import rig_poses, sees
from facewright.tracking.rigid_fit import fit_rigid
from facewright.tracking.triangulation import Views, triangulate

Floats = NDArray[np.float64]
SIZE = (1280, 960)
BOARD = parse_board("chessboard:9x6:20")
CORNERS = BOARD.object_points()
SD = 0.15
N = 40


def true_rig(n: int = 3) -> Rig:
    """Cameras on an arc, 900 mm from the world's origin, the first of them the world."""
    cameras = {}
    for i, yaw in enumerate(np.linspace(-0.4, 0.4, n)):
        K = np.array([[1300.0 + 20 * i, 0, 640.0], [0, 1300.0 + 20 * i, 470.0], [0, 0, 1]])
        R = Rotation.from_euler("yx", [-yaw, 0.1 * i]).as_matrix()
        pose = Rigid.from_rotation(R, (5.0 * i, -7.0, 900.0))
        cameras[f"cam{i}"] = Camera(SIZE, K, pose, "opencv", np.array([-0.2, 0.06, 0, 0, 0]))
    first = cameras["cam0"].camera_from_world.inverse()
    return Rig(
        {n: replace(c, camera_from_world=c.camera_from_world @ first) for n, c in cameras.items()}
    )


TRUTH = true_rig()
HELD = tuple(rig_poses(BOARD, TRUTH, 16, np.random.default_rng(4)))


def views_of(rig: Rig, held: tuple[Rigid, ...], seed: int) -> dict[str, list[BoardView]]:
    rng = np.random.default_rng(seed)
    found: dict[str, list[BoardView]] = {name: [] for name in rig}
    for i, pose in enumerate(held):
        for name, camera in rig.cameras.items():
            seen = sees(camera, pose, CORNERS)
            uv = camera.project(pose.apply(CORNERS)) + rng.normal(0, SD, (len(CORNERS), 2))
            if seen.sum() >= 20:
                found[name].append(BoardView(f"view {i}", CORNERS[seen], uv[seen]))
    return found


@pytest.fixture(scope="module")
def repeated() -> list[RigCalibration]:
    refine = dict.fromkeys(TRUTH.names, "opencv4")
    return [
        calibrate_rig(views_of(TRUTH, HELD, seed), TRUTH.cameras, refine=refine)
        for seed in range(N)
    ]


def face() -> Floats:
    return facing_frame(TRUTH, 900.0).apply(face_points())


def triangulated(found: Rig, truth: Rig, points: Floats) -> Floats:
    """Points as the found cameras place what the true ones see, exactly."""
    xy = [found[n].undistort(truth[n].project(points)) for n in truth]
    views = Views.of([found[n] for n in truth])
    return triangulate(views, np.stack(xy, axis=1), tolerance_px=np.inf).positions


def rms_mm(errors: Floats) -> float:
    return float(np.sqrt((errors**2).sum(axis=-1).mean()))


def pooled(values: list[Floats]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("gauge", ["rigid", "similarity", "camera"])
def test_stated_millimetres_are_those_of_repetition(
    repeated: list[RigCalibration], gauge: str
) -> None:
    errors, stated = [], []
    for found in repeated:
        points = triangulated(found.rig, TRUTH, face())
        R, t = np.eye(3), np.zeros(3)
        if gauge == "rigid":
            R, t = fit_rigid(points, face())
        elif gauge == "similarity":
            R, t = similar(points, face())
        errors.append(points @ R.T + t - face())
        stated.append(triangulation_sd_mm(found, face(), gauge=gauge).calibration_mm)

    # the first camera's frame turns as a whole: its errors are few draws
    tolerance = 0.3 if gauge == "camera" else 0.15
    assert rms_mm(np.array(errors)) / pooled(stated) == pytest.approx(1, abs=tolerance)


def similar(source: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Scaled rotation and shift, by OpenCV."""
    R, scale = cv2.estimateAffine3D(source, target, force_rotation=True)
    A = R[:, :3] * (scale if scale else 1.0)
    return A, (target - source @ A.T).mean(axis=0)


def test_the_whole_turns_far_more_than_a_face_bends(repeated: list[RigCalibration]) -> None:
    free = triangulation_sd_mm(repeated[0], face(), gauge="camera").calibration_mm
    rigid = triangulation_sd_mm(repeated[0], face()).calibration_mm
    similarity = triangulation_sd_mm(repeated[0], face(), gauge="similarity").calibration_mm

    assert rms_mm(free[:, None]) > 20 * rms_mm(rigid[:, None])
    assert rms_mm(similarity[:, None]) <= rms_mm(rigid[:, None])


def test_drawn_rigs_are_as_far_off_as_is_stated(repeated: list[RigCalibration]) -> None:
    found = repeated[0]
    F = face()
    stated = triangulation_sd_mm(found, F)

    errors = []
    for real in sample_rigs(found, 300, np.random.default_rng(0)):
        points = triangulated(found.rig, real, F)
        R, t = fit_rigid(points, F)
        errors.append(points @ R.T + t - F)

    each = np.sqrt((np.array(errors) ** 2).sum(axis=2).mean(axis=0))
    np.testing.assert_allclose(each / stated.calibration_mm, 1, atol=0.2)
    assert rms_mm(np.array(errors)) == pytest.approx(pooled([stated.calibration_mm]), rel=0.05)
    apart = np.linalg.norm(np.array(errors)[:, 3] + F[3] - np.array(errors)[:, 20] - F[20], axis=1)
    assert apart.std() == pytest.approx(stated.distance_sd_mm(3, 20), rel=0.2)


def test_drawn_rigs_have_the_stated_covariance(repeated: list[RigCalibration]) -> None:
    found = repeated[0]
    drawn = list(sample_rigs(found, 500, np.random.default_rng(1)))

    for name in ("cam1", "cam2"):
        inner, outer = found.columns(name)
        off = np.array(
            [
                [*np.diag(q[name].matrix)[:2], *q[name].matrix[:2, 2], *q[name].distortion[:4],
                 *Rotation.from_matrix(
                     q[name].camera_from_world.rotation
                     @ found.rig[name].camera_from_world.rotation.T
                 ).as_rotvec(), *q[name].position]
                for q in drawn
            ]
        )  # fmt: skip
        sd = np.sqrt(np.diag(found.joint_covariance))
        at = np.r_[inner, outer]
        scale = np.outer(sd[at], sd[at])
        stated = found.joint_covariance[np.ix_(at, at)]
        np.testing.assert_allclose(np.cov(off.T) / scale, stated / scale, atol=0.25)


def test_noise_of_spots_is_that_of_repetition(repeated: list[RigCalibration]) -> None:
    found, rng = repeated[0], np.random.default_rng(0)
    F = face()
    stated = triangulation_sd_mm(found, F, spot_sd_px=0.2)

    exact = triangulated(found.rig, found.rig, F)
    errors = []
    for _ in range(300):
        spots = [found.rig[n].project(F) + rng.normal(0, 0.2, (len(F), 2)) for n in TRUTH]
        xy = [found.rig[n].undistort(uv) for n, uv in zip(TRUTH, spots, strict=True)]
        views = Views.of([found.rig[n] for n in TRUTH])
        points = triangulate(views, np.stack(xy, axis=1), tolerance_px=np.inf).positions
        errors.append(points - F)

    np.testing.assert_allclose(exact, F, atol=1e-6)
    C = np.einsum("rni,rnj->nij", errors, errors) / len(errors)
    ratio = np.sqrt(np.trace(C, axis1=1, axis2=2)) / stated.noise_mm
    np.testing.assert_allclose(ratio, 1, atol=0.2)
    assert ratio.mean() == pytest.approx(1, abs=0.03)
    np.testing.assert_allclose(
        stated.total_mm, np.sqrt(stated.noise_mm**2 + stated.calibration_mm**2)
    )


def test_noise_is_inversely_as_information(repeated: list[RigCalibration]) -> None:
    # the tracker's triangulation states the same information, up to the lens's magnification
    found = repeated[0]
    F = face()
    xy = np.stack([found.rig[n].undistort(found.rig[n].project(F)) for n in TRUTH], axis=1)
    peer = triangulate(Views.of([found.rig[n] for n in TRUTH]), xy, np.full((len(F), 3), 0.2))

    stated = triangulation_sd_mm(found, F, spot_sd_px=0.2)

    theirs = np.sqrt(np.trace(np.linalg.inv(peer.information), axis1=1, axis2=2))
    np.testing.assert_allclose(stated.noise_mm / theirs, 1, atol=0.06)


def test_the_noise_grows_with_that_of_spots_and_the_calibration_does_not(
    repeated: list[RigCalibration],
) -> None:
    one, two = (triangulation_sd_mm(repeated[0], face(), spot_sd_px=s) for s in (0.1, 0.2))

    np.testing.assert_allclose(two.noise_mm, 2 * one.noise_mm)
    np.testing.assert_allclose(two.calibration_mm, one.calibration_mm)


def test_points_of_one_camera_are_not_told(repeated: list[RigCalibration]) -> None:
    visible = np.ones((32, 3), bool)
    visible[4, :2] = False
    points = np.concatenate([face()[:-1], [[0.0, 0.0, -500.0]]])  # one behind all cameras

    found = triangulation_sd_mm(repeated[0], points, visible=visible)

    unknown = [4, 31]
    assert np.isnan(found.calibration_mm[unknown]).all()
    assert np.isnan(found.noise_mm[unknown]).all()
    assert np.isfinite(np.delete(found.total_mm, unknown)).all()
    np.testing.assert_array_equal(found.n_cameras[unknown], [1, 0])


def test_too_few_points_to_be_relative_to_are_told(repeated: list[RigCalibration]) -> None:
    with pytest.raises(InputError, match="see 2 of the 2 points"):
        triangulation_sd_mm(repeated[0], face()[:2])
    with pytest.raises(InputError, match="see 0 of the 32 points"):
        triangulation_sd_mm(repeated[0], face(), relative_to=face() * (1, 1, -1))


@pytest.mark.parametrize(
    ("points", "options", "told"),
    [
        (np.zeros((4, 2)), {}, "points must have shape"),
        (np.zeros((4, 3)), {"gauge": "world"}, "gauge must be one of rigid"),
        (np.zeros((4, 3)), {"visible": np.ones((4, 2))}, "visible must have shape"),
    ],
)
def test_wrong_arguments_are_named(
    repeated: list[RigCalibration], points: Floats, options: dict[str, object], told: str
) -> None:
    with pytest.raises(ValueError, match=told):
        triangulation_sd_mm(repeated[0], points, **options)  # type: ignore[arg-type]


def test_the_world_does_not_matter(repeated: list[RigCalibration]) -> None:
    from facewright.capture.rig_world import in_world

    move = Rigid.from_rotation(Rotation.from_rotvec([0.4, -0.9, 0.2]).as_matrix(), (90, -20, 333))
    here = triangulation_sd_mm(repeated[0], face())
    there = triangulation_sd_mm(in_world(repeated[0], move), move.apply(face()))

    np.testing.assert_allclose(there.calibration_mm, here.calibration_mm, rtol=1e-6)
    np.testing.assert_allclose(there.noise_mm, here.noise_mm, rtol=1e-9)


def test_the_covariance_has_the_cross_terms_of_repetition(repeated: list[RigCalibration]) -> None:
    # the cameras' centres stand together: all of them know the scale from the same boards
    centres = np.array(
        [np.concatenate([f.rig["cam1"].position, f.rig["cam2"].position]) for f in repeated]
    )
    at = np.r_[
        repeated[0].columns("cam1")[1].stop - 3 : repeated[0].columns("cam1")[1].stop,
        repeated[0].columns("cam2")[1].stop - 3 : repeated[0].columns("cam2")[1].stop,
    ]
    stated = np.mean([f.joint_covariance[np.ix_(at, at)] for f in repeated], axis=0)
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))

    assert np.abs(stated[:3, 3:] / scale[:3, 3:]).max() > 0.5, "no cross term to speak of"
    np.testing.assert_allclose(np.cov(centres.T) / scale, stated / scale, atol=0.6)


def test_a_face_lies_where_the_axes_meet(repeated: list[RigCalibration]) -> None:
    place = place_of_face(repeated[0])

    true = facing_frame(TRUTH, 900.0)
    assert np.linalg.norm(place.translation - true.translation) < 40
    towards_cameras = place.inverse().apply(
        np.mean([c.position for c in repeated[0].rig.cameras.values()], axis=0)
    )
    assert towards_cameras[2] > 800
    for camera in repeated[0].rig.cameras.values():  # up in the world is up in the picture
        low, high = camera.project(place.apply(np.array([[0.0, -50, 0], [0, 50, 0]])))
        assert high[1] < low[1] - 50
    stated = face_uncertainty(repeated[0])
    again = triangulation_sd_mm(repeated[0], place.apply(face_points()))
    np.testing.assert_allclose(stated.total_mm, again.total_mm)


def test_parallel_cameras_look_at_where_the_targets_were() -> None:
    K = np.array([[1300.0, 0, 640.0], [0, 1300.0, 470.0], [0, 0, 1]])
    pair = Rig(
        {
            n: Camera(SIZE, K, Rigid.from_rotation(np.eye(3), (x, 0, 0)))
            for n, x in (("left", 60.0), ("right", -60.0))
        }
    )
    near = Rigid.from_rotation(np.eye(3), (-80, -50, 700.0))
    found = RigCalibration(
        pair, {"left": (), "right": ()}, np.diag([0.0] * 6 + [1e-8] * 3 + [1e-4] * 3),
        {"view": near}, {}, (), (), 0.1, 0.1, 0.1, (),
    )  # fmt: skip

    place = place_of_face(found)

    np.testing.assert_allclose(place.translation, (0, 0, 700), atol=1e-6)
    with pytest.raises(InputError, match="same direction"):
        place_of_face(replace(found, view_poses={}))
    # two points apart in depth: the textbook's error of a parallel pair, Z² / (f b) times √2 sd
    sd = triangulation_sd_mm(found, place.apply(face_points()), spot_sd_px=0.1)
    depth = np.sqrt(sd.noise_covariance[:, 2, 2])
    Z = sd.points[:, 2]
    np.testing.assert_allclose(depth, Z**2 / (1300 * 120) * np.sqrt(2) * 0.1, rtol=2e-3)


def test_cameras_that_look_all_ways_are_told() -> None:
    K = np.array([[1300.0, 0, 640.0], [0, 1300.0, 470.0], [0, 0, 1]])
    turns = [Rotation.from_euler("y", a, degrees=True).as_matrix() for a in (0, 120, 240)]
    round_about = Rig(
        {f"c{i}": Camera(SIZE, K, Rigid.from_rotation(R)) for i, R in enumerate(turns)}
    )
    with pytest.raises(InputError, match="look all ways"):
        facing_frame(round_about, 500.0)


def test_a_plane_holds_the_points_it_says(repeated: list[RigCalibration]) -> None:
    plane = plane_uncertainty(repeated[0], distance_mm=850.0, size_mm=(400, 200), shape=(5, 8))

    np.testing.assert_allclose(plane.x_mm, np.arange(-175, 176, 50))
    np.testing.assert_allclose(plane.y_mm, np.arange(80, -81, -40))
    row, column = 1, 6
    at = plane.world_from_plane.apply(np.array([[plane.x_mm[column], plane.y_mm[row], 0.0]]))
    around = plane.world_from_plane.apply(face_points())
    alone = triangulation_sd_mm(repeated[0], at, relative_to=around)
    assert plane.calibration_mm[row, column] == pytest.approx(alone.calibration_mm[0])
    assert plane.noise_mm[row, column] == pytest.approx(alone.noise_mm[0])
    assert plane.n_cameras.max() == 3
    # x to the right and y up for the first camera
    origin, right, up = (
        repeated[0]
        .rig["cam1"]
        .project(plane.world_from_plane.apply(np.array([[0.0, 0, 0], [50, 0, 0], [0, 50, 0]])))
    )
    assert right[0] > origin[0] + 20
    assert up[1] < origin[1] - 20
    # the middle of the face is the surest
    middle = plane_uncertainty(repeated[0], shape=(9, 9)).calibration_mm
    assert np.nanargmin(middle) in {40, 31, 49, 39, 41}


def test_face_points_lie_on_the_front_of_a_face() -> None:
    p = face_points()

    assert p.shape == (32, 3)
    radius = ((p / FACE_MM * (2, 2, 1) + (0, 0, 0.5)) ** 2).sum(axis=1)
    np.testing.assert_allclose(radius, 1)
    np.testing.assert_allclose(p.mean(axis=0), 0, atol=2.0)
    np.testing.assert_allclose(np.ptp(p, axis=0), FACE_MM, rtol=0.12)
