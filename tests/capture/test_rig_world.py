"""World frames. Truth: a rig built around a known point, and laws of rigid motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.capture.rig_world import head_from_world, in_world
from facewright.capture.rigs import RigCalibration
from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid

K = np.array([[1000.0, 0, 639.5], [0, 1000, 359.5], [0, 0, 1]])


def looking(place: tuple[float, float, float], at: tuple[float, float, float]) -> Camera:
    """An upright camera (y up in the world) at a place, whose axis goes through a point."""
    forward = np.subtract(at, place) / np.linalg.norm(np.subtract(at, place))
    right = np.cross([0, -1.0, 0], forward)
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    return Camera((1280, 720), K, Rigid.from_rotation(R, -R @ np.array(place)))


def moved(rig: Rig, old_from_new: Rigid) -> Rig:
    return Rig(
        {
            n: replace(c, camera_from_world=c.camera_from_world @ old_from_new)
            for n, c in rig.cameras.items()
        }
    )


def around_head() -> Rig:
    """Left, right and below, equally far to both sides; all look at the origin."""
    places = {"l": (400.0, 100.0, 700.0), "r": (-400.0, 100.0, 700.0), "m": (0.0, -200.0, 800.0)}
    return Rig({n: looking(p, (0, 0, 0)) for n, p in places.items()})


@pytest.mark.parametrize("seed", range(5))
def test_head_frame_is_found_wherever_the_world_was(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = Rigid.from_rotation(Rotation.random(rng=rng).as_matrix(), rng.uniform(-900, 900, 3))

    found = head_from_world(moved(around_head(), truth))

    np.testing.assert_allclose((found @ truth.inverse()).matrix, truth_free(), atol=1e-6)


def truth_free() -> NDArray[np.float64]:
    """Head from the world that `around_head` is built in: upright, but tilted as its cameras are.

    The mean image-down of these cameras leans in the plane x = 0 alone.
    """
    down = np.mean(
        [c.camera_from_world.rotation[1] for c in around_head().cameras.values()], axis=0
    )
    assert abs(down[0]) < 1e-12
    lean = np.arctan2(down[2], -down[1])
    return Rigid.from_rotation(Rotation.from_euler("X", lean).as_matrix()).matrix


def test_axes_that_miss_each_other_meet_half_way() -> None:
    # one axis along x at z = 10, the other along y at z = -10: halfway is the origin
    along_x = looking((-500.0, 0.0, 10.0), (0.0, 0.0, 10.0))
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along y, z is up
    along_y = Camera((1280, 720), K, Rigid.from_rotation(turn, -turn @ np.array([0, -500.0, -10])))

    found = head_from_world(Rig({"a": along_x, "b": along_y}))

    np.testing.assert_allclose(found.apply([0.0, 0, 0]), [0, 0, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("rig", "told"),
    [
        ({"a": ((0, 0, 800), (0, 0, 0)), "b": ((100, 0, 800), (100, 0, 0))}, "same direction"),
        ({"a": ((100, 0, 0), (900, 0, 100)), "b": ((-100, 0, 0), (-900, 0, 100))}, "lies behind"),
    ],
)
def test_cameras_that_look_at_no_head_are_refused(rig: dict[str, tuple], told: str) -> None:  # type: ignore[type-arg]
    with pytest.raises(InputError, match=told):
        head_from_world(Rig({n: looking(*c) for n, c in rig.items()}))


def test_calibration_says_the_same_in_another_world() -> None:
    rng = np.random.default_rng(2)
    rig = around_head()
    size = 6 * len(rig) + 2
    root = rng.normal(size=(size, size))
    view = Rigid.from_rotation(Rotation.random(rng=rng).as_matrix(), [5, 6, 7])
    before = RigCalibration(
        rig, {"l": (), "r": ("fx", "k1"), "m": ()}, root @ root.T, {"v": view}, {}, (), (),
        0.1, 0.1, 0.1, (),
    )  # fmt: skip
    new_from_old = Rigid.from_rotation(Rotation.random(rng=rng).as_matrix(), [100, -50, 20])

    after = in_world(before, new_from_old)

    corner = np.array([[10.0, 20, 0]])
    for n in rig:
        np.testing.assert_allclose(
            after.rig[n].project(after.view_poses["v"].apply(corner)),
            rig[n].project(view.apply(corner)),
            atol=1e-6,
        )
    # what a calibration says of lengths does not depend on the frame they are told in
    assert spread_mm2(after) == pytest.approx(spread_mm2(before), rel=1e-9)
    # and a draw of its errors moves the cameras' pictures alike
    for n in rig:
        np.testing.assert_allclose(pixel_covariance(after, n), pixel_covariance(before, n))


def spread_mm2(found: RigCalibration) -> float:
    """Variance of the distance from camera l to camera r, with all cross terms."""
    a, b = (slice(found.columns(n)[1].start + 3, found.columns(n)[1].stop) for n in "lr")
    way = found.rig["r"].position - found.rig["l"].position
    way /= np.linalg.norm(way)
    J = np.zeros(len(found.joint_covariance))
    J[a], J[b] = -way, way
    return float(J @ found.joint_covariance @ J)


def pixel_covariance(found: RigCalibration, name: str) -> NDArray[np.float64]:
    """Of a point's picture, by differences, from a camera's δrotation and centre."""
    camera, point = found.rig[name], found.view_poses["v"].apply([10.0, 20, 0])

    def seen(change: NDArray[np.float64]) -> NDArray[np.float64]:
        R = Rotation.from_rotvec(change[:3]).as_matrix() @ camera.camera_from_world.rotation
        pose = Rigid.from_rotation(R, -R @ (camera.position + change[3:]))
        return replace(camera, camera_from_world=pose).project(point)

    steps = 1e-6 * np.eye(6)
    J = np.stack([(seen(s) - seen(-s)) / 2e-6 for s in steps], axis=1)
    return np.asarray(J @ found.covariance[name] @ J.T)
