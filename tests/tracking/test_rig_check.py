"""Exchanged, moved and foreign cameras, from exactly projected dots with noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid
from facewright.datasets_synthetic.rigs import face_rig
from facewright.tracking.footage import Footage
from facewright.tracking.rig_check import check_rig
from facewright.tracking.tracker import FrameDots

Floats = NDArray[np.float64]
NOISE_PX = 0.04


@pytest.fixture(scope="module")
def rig() -> Rig:
    return face_rig(np.random.default_rng(11))


def face_in_motion(rng: np.random.Generator, n_frames: int = 60) -> Floats:
    """(T, 30, 3) mm: half an ellipsoid of points that nods and wanders."""
    d = rng.normal(size=(30, 3))
    d[:, 2] = np.abs(d[:, 2])
    points = d / np.linalg.norm(d, axis=1, keepdims=True) * (65, 95, 75)
    t = np.arange(n_frames) / 30
    turns = Rotation.from_euler("xyz", 0.2 * np.sin(np.outer(t, (1.1, 1.7, 0.9)))).as_matrix()
    shift = 15 * np.sin(np.outer(t, (0.8, 1.3, 0.6)))
    return np.asarray(np.einsum("tij,mj->tmi", turns, points) + shift[:, None])


def dots(truth: Floats, rigs: list[Rig], seed: int = 0) -> list[FrameDots]:
    """What cameras see that stand as `rigs` says, one for each frame."""
    rng = np.random.default_rng(seed)
    frames = []
    for t, (points, rig) in enumerate(zip(truth, rigs, strict=True)):
        pixels = [c.project(points) for c in rig.cameras.values()]
        noisy = tuple(p + rng.normal(0, NOISE_PX, p.shape) for p in pixels)
        frames.append(FrameDots(t / 30, noisy, tuple(np.full(len(p), NOISE_PX) for p in noisy)))
    return frames


def knocked(rig: Rig, name: str, mm: float, degrees: float) -> Rig:
    """The rig with a camera moved to its side and turned about a slanting axis."""
    camera: Camera = rig[name]
    R = camera.camera_from_world.rotation
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * np.array([0.6, 0.64, 0.48])).as_matrix()
    centre = camera.position + mm * np.array([0.6, 0.0, 0.8])
    pose = Rigid.from_rotation(turn @ R, -turn @ R @ centre)
    return Rig({**rig.cameras, name: replace(camera, camera_from_world=pose)})


def test_a_rig_that_is_right_is_let_pass_as_it_is(rig: Rig) -> None:
    truth = face_in_motion(np.random.default_rng(0))

    verdict = check_rig(rig, dots(truth, [rig] * len(truth)))

    assert verdict.rigs == ((0, rig),)
    assert verdict.notes == () and verdict.moved == () and verdict.shifts == ()


@pytest.mark.parametrize(("a", "b"), [("cam0", "cam1"), ("cam1", "cam2"), ("cam0", "cam3")])
def test_two_exchanged_videos_are_named(rig: Rig, a: str, b: str) -> None:
    truth = face_in_motion(np.random.default_rng(1))
    exchanged = Rig({n: rig[{a: b, b: a}.get(n, n)] for n in rig})

    with pytest.raises(InputError, match=f"videos of {a} and {b} are exchanged"):
        check_rig(rig, dots(truth, [exchanged] * len(truth)))


@pytest.mark.slow
def test_the_rig_of_another_take_is_refused(rig: Rig) -> None:
    truth = face_in_motion(np.random.default_rng(2))
    other = face_rig(np.random.default_rng(99))

    with pytest.raises(InputError, match="few of the dots"):
        check_rig(rig, dots(truth, [other] * len(truth)))


@pytest.mark.parametrize(("mm", "degrees"), [(2.0, 0.5), (5.0, 0.0), (0.0, 0.3)])
def test_a_camera_that_was_knocked_is_told_by_how_much(rig: Rig, mm: float, degrees: float) -> None:
    truth = face_in_motion(np.random.default_rng(3))
    now = knocked(rig, "cam2", mm, degrees)

    verdict = check_rig(rig, dots(truth, [now] * len(truth)))

    assert verdict.moved == ((0, "cam2"),)
    (shift,) = verdict.shifts
    assert shift.distance_mm == pytest.approx(mm, abs=4 * shift.distance_sd_mm + 0.05)
    assert np.rad2deg(shift.angle_rad) == pytest.approx(degrees, abs=0.03)
    assert "cam2 was moved before the take: by" in verdict.notes[0]
    found = verdict.rigs[0][1]["cam2"]
    off = found.project(truth[0]) - now["cam2"].project(truth[0])
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.15


def test_a_camera_that_is_knocked_in_mid_take_is_told_from_when(rig: Rig) -> None:
    truth = face_in_motion(np.random.default_rng(4), 90)
    now = knocked(rig, "cam1", 3.0, 0.4)

    verdict = check_rig(rig, dots(truth, [rig] * 40 + [now] * 50))

    ((frame, camera),) = verdict.moved
    assert camera == "cam1"
    assert 38 <= frame <= 44  # it looks at every other frame
    assert "cam1 was moved about 1." in verdict.notes[0]
    assert verdict.rigs[0] == (0, rig)
    assert [first for first, _ in verdict.rigs] == [0, frame]


def test_no_dots_are_no_take(rig: Rig) -> None:
    empty = FrameDots(0.0, (np.zeros((0, 2)),) * 4, (np.zeros(0),) * 4)

    with pytest.raises(InputError, match="no marker was seen by two cameras at once"):
        check_rig(rig, [empty] * 5)


@pytest.mark.parametrize("refine", [False, True])
def test_a_moved_camera_is_left_out_or_refined(rig: Rig, refine: bool) -> None:
    truth = face_in_motion(np.random.default_rng(5))
    now = knocked(rig, "cam2", 2.0, 0.5)
    footage = Footage(rig)
    for frame in dots(truth, [now] * len(truth)):
        footage.step(frame)

    found = footage.tracked(refine_rig=refine)

    tracks = found.followed.trajectories
    d = np.linalg.norm(tracks.positions[:, :, None] - truth[:, None], axis=3)
    seen = ~np.isnan(tracks.positions[..., 0])
    error = np.where(np.isnan(d), np.inf, d).min(axis=2)[seen]
    assert seen.sum() > 0.98 * truth.shape[0] * truth.shape[1]
    assert np.sqrt((error**2).mean()) < 0.06
    n_views = np.asarray(tracks.n_views)[seen]
    assert (n_views == (4 if refine else 3)).mean() > 0.95
    assert ("left out" in found.verdict.notes[0]) != refine
