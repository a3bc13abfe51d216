"""Pictures of plain takes: shutter, rows, landmarks, and a face that a detector accepts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.core.camera import Camera
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.actor import Pose
from facewright.datasets_synthetic.optics import NOISELESS, Optics, Sensor
from facewright.datasets_synthetic.plain_views import PlainFilmer, PlainView, Scenery
from facewright.datasets_synthetic.rigs import look_at
from facewright.heads.catalogue import built_in_head
from facewright.heads.head import Head
from facewright.heads.raycast import RayScene

Floats = NDArray[np.float64]
PoseAt = Callable[[float], Pose]
SIZE = (480, 360)
STUDIO = Scenery(seed=3, background="studio", breathing=False)
T = 0.5


def camera(yaw_deg: float = 0.0, focal_px: float = 900.0) -> Camera:
    yaw = np.deg2rad(yaw_deg)
    K = np.array([[focal_px, 0, 240], [0, focal_px, 180], [0, 0, 1]])
    pose = look_at((800 * np.sin(yaw), 0, 800 * np.cos(yaw)), (0, -30, -20))
    return Camera(SIZE, K, pose, "opencv", np.array([-0.1, 0.03, 5e-4, -5e-4, 0.0]))


def turning(head: Head, *, rad_per_s: float = 2.0, mm_per_s: float = 200.0) -> PoseAt:
    """A head that turns and goes aside, with some acceleration, past rest at time T."""

    def pose_at(time_s: float) -> Pose:
        s = time_s - T
        angle = rad_per_s * s + 4 * s * s
        R = Rotation.from_rotvec([0.3 * angle, angle, 0]).as_matrix()
        pivot = head.neck_pivot
        shift = np.array([mm_per_s * s, 0.4 * mm_per_s * s, 0])
        motion = Rigid.from_rotation(R, pivot - R @ pivot + shift)
        return Pose(time_s, np.zeros(1), np.array(head.mesh.vertices), motion)

    return pose_at


def filmer(
    head: Head,
    optics: Optics,
    scenery: Scenery = STUDIO,
    sensor: Sensor = NOISELESS,
    **cameras: Camera,
) -> PlainFilmer:
    cameras = cameras or {"cam": camera()}
    return PlainFilmer(
        head,
        cameras,
        dict.fromkeys(cameras, optics),
        dict.fromkeys(cameras, sensor),
        scenery=scenery,
    )


def shot(made: PlainFilmer, pose_at: PoseAt, time_s: float = T, name: str = "cam") -> PlainView:
    return made.view(name, pose_at, time_s, np.random.default_rng(0))


@pytest.fixture(scope="module")
def ruth() -> Head:
    """Painted: grey faces have too little to see motion by."""
    return built_in_head("ruth")


def test_rows_are_exposed_at_their_own_times(ruth: Head) -> None:
    """When a row was seen, by the change of pictures rendered about its time."""
    optics = Optics(readout_s=0.030)
    pose_at = turning(ruth)

    rolled = shot(filmer(ruth, optics), pose_at).image.astype(np.float64)

    instant = filmer(ruth, Optics())
    step_s, late_s = 1e-3, []
    for row in (60, 100, 140, 220, 260, 300, 330):
        t = T + optics.row_delay_s(row, SIZE[1])
        before, at, after = (
            shot(instant, pose_at, t + d).image[row].astype(np.float64)
            for d in (-step_s, 0.0, step_s)
        )
        change = (after - before) / (2 * step_s)
        late_s.append((change * (rolled[row] - at)).sum() / (change**2).sum())
    rms_px = 230 * np.sqrt(np.mean(np.square(late_s)))  # the face goes 230 px/s
    assert rms_px < 0.1, f"rows are {rms_px:.3f} px off; they are up to 3.4 px from the frame's"


def test_blur_is_the_mean_over_the_exposure(ruth: Head) -> None:
    """Against the mean of 25 instants, in linear light."""
    optics = Optics(exposure_s=0.020)
    pose_at = turning(ruth)

    blurred = shot(filmer(ruth, optics), pose_at).image.astype(np.float64)

    instant = filmer(ruth, Optics())
    times = T + optics.exposure_s * ((np.arange(25) + 0.5) / 25 - 0.5)
    mean = np.mean([shot(instant, pose_at, float(t)).image for t in times], axis=0)
    sharp = shot(instant, pose_at).image.astype(np.float64)
    error = np.sqrt(((blurred - mean) ** 2).mean())
    without = np.sqrt(((sharp - mean) ** 2).mean())
    assert error < 0.25 * without, f"{error:.2f} against {without:.2f} grey levels without blur"


def test_a_still_person_is_not_blurred_or_bent(ruth: Head) -> None:
    pose = turning(ruth)(T)

    found = shot(filmer(ruth, Optics(exposure_s=0.02, readout_s=0.02)), lambda t: pose)

    expected = shot(filmer(ruth, Optics()), lambda t: pose)
    np.testing.assert_array_equal(found.image, expected.image)
    np.testing.assert_allclose(found.landmarks, expected.landmarks, atol=1e-9)


def test_blur_keeps_the_light(ruth: Head) -> None:
    """Cover and light that leave a pixel arrive elsewhere; the person is within the picture."""
    scenery = replace(STUDIO, bust=False)
    far = {"cam": replace(camera(focal_px=520.0))}
    pose_at = turning(ruth)

    def total(optics: Optics) -> float:
        made = filmer(ruth, optics, scenery, Sensor(0.25, np.inf, 0.0), **far)
        empty = made.room("cam")
        return float((shot(made, pose_at).image / 63.75 - np.minimum(empty, 4)).mean())

    sharp = total(Optics())
    assert abs(sharp) > 0.01
    assert total(Optics(exposure_s=0.02)) == pytest.approx(sharp, rel=0.04)
    assert total(Optics(readout_s=0.02)) == pytest.approx(sharp, rel=0.06)


def test_centres_agree_with_their_row_times(average_head: Head) -> None:
    """The law of the rolling shutter: projected at the time of its own row, a point stays."""
    optics = Optics(readout_s=0.030)
    made = filmer(average_head, optics)
    pose_at = turning(average_head, rad_per_s=5.0, mm_per_s=800.0)

    def points_at(t: float) -> Floats:
        return average_head.feature_points.at(pose_at(t).world_vertices)

    found = made.centres("cam", points_at, T)

    for i, (x, y) in enumerate(found):
        if 0 <= y <= SIZE[1] - 1:
            t = T + optics.row_delay_s(y, SIZE[1])
            expected = made.cameras["cam"].project(points_at(t)[i])
            np.testing.assert_allclose((x, y), expected, atol=1e-3)
    still = filmer(average_head, Optics()).centres("cam", points_at, T)
    assert np.nanmax(np.linalg.norm(found - still, axis=1)) > 3


def test_landmarks_are_the_centres_of_the_feature_points(average_head: Head) -> None:
    made = filmer(average_head, Optics(exposure_s=0.01, readout_s=0.02))
    pose_at = turning(average_head)

    found = shot(made, pose_at).landmarks

    expected = made.centres(
        "cam", lambda t: average_head.feature_points.at(pose_at(t).world_vertices), T
    )
    np.testing.assert_allclose(found, expected, atol=0.02)


@pytest.mark.parametrize("yaw_deg", [0.0, 50.0])
def test_landmarks_are_visible_where_rays_reach_them(average_head: Head, yaw_deg: float) -> None:
    """Against rays from the points back to the camera, past the lashes."""
    made = filmer(average_head, Optics(), replace(STUDIO, bust=False), cam=camera(yaw_deg))
    pose = turning(average_head)(T)

    view = shot(made, lambda t: pose)

    mesh = average_head.mesh
    solid = np.delete(np.asarray(mesh.triangles), np.asarray(mesh.groups["lashes"]), axis=0)
    v = pose.world_vertices
    points = average_head.feature_points.at(v)
    eye = made.cameras["cam"].position
    way = eye - points
    start = points + 1.5 * way / np.linalg.norm(way, axis=1, keepdims=True)
    t, _, _ = RayScene(v, solid).cast(start, eye - start)
    free = np.isinf(t)
    assert (view.landmarks_visible == free).mean() > 0.95
    assert 20 < free.sum() < 79


def test_a_hand_hides_landmarks(average_head: Head) -> None:
    pose = turning(average_head)(T)
    shares = []
    for seed in range(8):
        made = filmer(average_head, Optics(), replace(STUDIO, seed=seed, occluder="hand"))
        bare = filmer(average_head, Optics(), replace(STUDIO, seed=seed))
        n = [int(shot(m, lambda t: pose, 1.3).landmarks_visible.sum()) for m in (bare, made)]
        shares.append(n[1] / n[0])
    assert min(shares) < 0.75
    assert max(shares) <= 1


def test_the_shoulders_stand_below_the_head(average_head: Head) -> None:
    pose = turning(average_head)(T)
    shirt = replace(STUDIO, shirt=(20, 160, 30), sleeves="long")

    with_bust = shot(filmer(average_head, Optics(), shirt), lambda t: pose).image
    without = shot(filmer(average_head, Optics(), replace(shirt, bust=False)), lambda t: pose).image

    green = with_bust[330:, :, 1] > 1.5 * with_bust[330:, :, 0].astype(float)
    assert green.mean() > 0.3
    np.testing.assert_array_equal(with_bust[:60], without[:60])
    changed = np.abs(with_bust.astype(int) - without).max(axis=2) > 8
    assert not changed[:150].mean() > 0.02


def test_pictures_do_not_depend_on_what_was_filmed_before(ruth: Head) -> None:
    optics = Optics(exposure_s=0.01, readout_s=0.01, pupil_mm=3.0, focus_mm=780)
    scenery = Scenery(seed=5, occluder="hair")
    both = {"cam": camera(), "side": camera(40)}
    sensor = Sensor(gamma=2.2)
    pose_at = turning(ruth)
    first, second = (filmer(ruth, optics, scenery, sensor, **both) for _ in range(2))

    for t in (T + 0.2, T - 0.1):
        shot(first, pose_at, t)
    found = shot(first, pose_at, T, "side").image

    np.testing.assert_array_equal(found, shot(second, pose_at, T, "side").image)


def test_focus_blurs_what_is_out_of_it(ruth: Head) -> None:
    pose = turning(ruth)(T)

    def detail(optics: Optics) -> float:
        picture = shot(filmer(ruth, optics), lambda t: pose).image.astype(np.float64)
        return float(np.abs(np.diff(picture[130:230, 190:290], axis=1)).mean())

    in_focus = detail(Optics(pupil_mm=8.0, focus_mm=775))
    assert in_focus > 0.8 * detail(Optics())
    assert detail(Optics(pupil_mm=8.0, focus_mm=1500)) < 0.75 * in_focus


def test_every_camera_needs_its_optics(average_head: Head) -> None:
    with pytest.raises(ValueError, match="optics must name every camera; cam is missing"):
        PlainFilmer(average_head, {"cam": camera()}, {}, {"cam": Sensor()})


@pytest.mark.slow
def test_a_face_finder_accepts_the_faces() -> None:
    from facewright.heads import face_network
    from facewright.heads.face_finder import FaceFinder

    if face_network.face_networks_path() is None:
        pytest.skip(f"the face networks are not installed: {face_network.INSTALL_NETWORKS}")
    finder = FaceFinder()
    optics = Optics(exposure_s=0.008, readout_s=0.01, pupil_mm=3.0, focus_mm=760, psf_px=0.5)
    found, off = 0, []
    names = ("ruth", "maya", "kofi", "luis", "noor", "mei", "arno", "average")
    for seed, name in enumerate(names):
        head = built_in_head(name)
        made = filmer(head, optics, Scenery(seed=seed), Sensor(gamma=2.2))
        view = shot(made, turning(head, rad_per_s=0.5, mm_per_s=50.0))
        faces = finder.find(view.image)
        found += len(faces) == 1
        if faces:
            nose = view.landmarks[head.feature_points.index("9.3")]
            off.append(np.linalg.norm(faces[0].landmarks_px[1, :2] - nose) / faces[0].size_px)
    assert found == len(names)
    assert np.median(off) < 0.06  # of the face's size
