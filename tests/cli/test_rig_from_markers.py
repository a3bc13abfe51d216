"""From videos of a wand, or of markers, to a rig: filmed takes against their truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.capture.calibration_take import TakeCamera, find_take
from facewright.capture.synchronise import ClockFit
from facewright.capture.wand_track import WandTrack, at_times
from facewright.cli.marker_rig_report import marker_json, marker_report, wand_json, wand_report
from facewright.cli.rig_from_markers import parse_wand, rig_by_markers, rig_by_wand
from facewright.core.errors import InputError
from facewright.core.formats.rig_json import read_rig
from facewright.core.rig import Rig
from facewright.datasets_synthetic.film import film_take
from facewright.datasets_synthetic.take_settings import settings_for, settings_with
from facewright.datasets_synthetic.takes import make_take
from facewright.datasets_synthetic.wand import BALLS_MM

Floats = NDArray[np.float64]
SMALL = {"cameras.count": 3, "cameras.image_size": (640, 360), "cameras.rate_hz": 30.0}


def filmed(folder: Path, kind: str, seed: int, **changes: object) -> Path:
    named = {k.replace("__", "."): v for k, v in changes.items()}
    settings = settings_with(settings_for(kind), SMALL | named)
    film_take(make_take(seed, settings), folder)
    return folder


@pytest.fixture(scope="module")
def wand_take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return filmed(tmp_path_factory.mktemp("wand"), "wand", 4, seconds=4.0)


@pytest.fixture(scope="module")
def late_take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cameras that began at different times."""
    folder = tmp_path_factory.mktemp("late")
    return filmed(folder, "wand", 5, seconds=5.0, clocks__max_offset_s=0.2)


@pytest.fixture(scope="module")
def knocked_take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A camera is knocked by 2 mm and 0.5 degrees."""
    folder = tmp_path_factory.mktemp("knocked")
    return filmed(
        folder, "markers", 7, seconds=2.0, events__knocked=True,
        cameras__image_size=(960, 540),
    )  # fmt: skip


def worst(found: Rig, truth: Rig) -> tuple[float, float]:
    """Largest error of a centre, mm, and of a rotation, degrees, in the first camera's frame."""
    first = truth[found.names[0]].camera_from_world
    own = found[found.names[0]].camera_from_world
    mm, degrees = [], []
    for name in found:
        true = truth[name].camera_from_world @ first.inverse()
        got = found[name].camera_from_world @ own.inverse()
        mm.append(np.linalg.norm(true.inverse().translation - got.inverse().translation))
        turn = Rotation.from_matrix(true.rotation @ got.rotation.T)
        degrees.append(np.rad2deg(turn.magnitude()))
    return float(max(mm)), float(max(degrees))


def test_a_wand_places_the_cameras(wand_take: Path) -> None:
    truth = read_rig(wand_take / "rig.json")

    result = rig_by_wand(find_take(wand_take), BALLS_MM, truth.cameras)

    assert result.found.rig.names == truth.names
    mm, degrees = worst(result.found.rig, truth)
    assert mm < 0.3, f"centres off by {mm:.3f} mm"
    assert degrees < 0.01, f"rotations off by {degrees:.4f} degrees"
    assert len(result.found.view_poses) > 80
    assert not result.clocks


def test_the_report_of_a_wand_tells_what_was_found(wand_take: Path) -> None:
    truth = read_rig(wand_take / "rig.json")
    result = rig_by_wand(find_take(wand_take), BALLS_MM, truth.cameras, max_moments=60)

    report, told = wand_report(result), wand_json(result)

    assert len(result.found.view_poses) <= 60
    assert report.summary.startswith("3 cameras from ")
    assert {t.title for t in report.tables} >= {"Cameras", "Distances between cameras"}
    assert told["moments"] == len(result.found.view_poses)
    assert told["rms_px"] == result.found.rms_px
    assert 0 < told["face_mm"] < 0.1
    names = [p["name"] for p in told["parameters"]]
    assert names == [f"{c}.{axis}" for c in truth for axis in "xyz"]


def test_cameras_out_of_step_are_brought_into_step_by_the_wand(late_take: Path) -> None:
    truth = read_rig(late_take / "rig.json")
    with np.load(late_take / "truth.npz") as z:
        offsets = dict(zip(z["camera_names"].tolist(), z["clock_offset_s"], strict=True))

    result = rig_by_wand(
        find_take(late_take), BALLS_MM, truth.cameras, by_motion=True, max_offset_s=0.5
    )

    assert set(result.clocks) == set(truth.names[1:])
    for name, clock in result.clocks.items():
        # the other's clock shows 0 at world time `offset`
        assert clock.offset_s == pytest.approx(-offsets[name], abs=0.05 / 30)
    mm, degrees = worst(result.found.rig, truth)
    assert mm < 0.5, f"centres off by {mm:.3f} mm"
    assert degrees < 0.03, f"rotations off by {degrees:.4f} degrees"


def test_clocks_may_be_given(late_take: Path) -> None:
    truth = read_rig(late_take / "rig.json")
    with np.load(late_take / "truth.npz") as z:
        offsets = dict(zip(z["camera_names"].tolist(), z["clock_offset_s"], strict=True))
    clocks = {
        name: ClockFit(-float(offsets[name]), 0.0, 0.0, 0.0, 1, 1, "sound")
        for name in truth.names[1:]
    }

    result = rig_by_wand(find_take(late_take), BALLS_MM, truth.cameras, clocks=clocks)

    assert worst(result.found.rig, truth)[0] < 0.3


def test_out_of_step_and_not_told_is_not_passed_over(late_take: Path) -> None:
    truth = read_rig(late_take / "rig.json")

    try:
        said = rig_by_wand(find_take(late_take), BALLS_MM, truth.cameras).found.warnings
    except InputError as error:
        assert "in step" in str(error)
    else:
        assert any("in step" in w or "do not fit" in w for w in said), said


def test_a_knock_in_mid_take_is_told(knocked_take: Path) -> None:
    truth = read_rig(knocked_take / "rig.json")
    with np.load(knocked_take / "truth.npz") as z:
        name, at_s = str(z["knocked_camera"][0]), float(z["knock_s"][0])

    result = rig_by_markers(find_take(knocked_take), truth)

    assert [m.camera for m in result.moves] == [name]
    assert any(f"{name} moved in mid-take" in w for w in result.found.warnings)
    index = result.moves[0].index
    assert index is not None
    assert result.moments.time_s[index - 1] <= at_s + 1e-9 <= result.moments.time_s[index] + 1e-9
    told = marker_json(result)
    assert told["mid_take_moves"][0]["camera"] == name
    assert told["mid_take_moves"][0]["degrees"] == pytest.approx(0.5, abs=0.1)
    assert "mid-take" in marker_report(result).summary


def test_the_part_before_a_knock_fits_the_rig_and_the_part_after_does_not(
    knocked_take: Path,
) -> None:
    truth = read_rig(knocked_take / "rig.json")
    with np.load(knocked_take / "truth.npz") as z:
        name, at_s = str(z["knocked_camera"][0]), float(z["knock_s"][0])
        pose = z["knock_quaternion"], z["knock_translation"]
    cameras = find_take(knocked_take)

    before = rig_by_markers(cameras, truth, span_s=(0.0, at_s - 0.02), max_frames=15)
    after = rig_by_markers(cameras, truth, span_s=(at_s + 0.02, 9.0), max_frames=15)

    assert [s.camera for s in before.shifts if s.is_moved] == []
    assert [s.camera for s in after.shifts if s.is_moved] == [name]
    shift = next(s for s in after.shifts if s.is_moved)
    assert shift.distance_mm == pytest.approx(_moved_mm(truth, name, pose), abs=0.6)
    assert np.rad2deg(shift.angle_rad) == pytest.approx(0.5, abs=0.05)
    assert f"{name} was moved by" in marker_report(after).summary


def _moved_mm(truth: Rig, name: str, pose: tuple[Floats, Floats]) -> float:
    w, x, y, z = pose[0]
    R = Rotation.from_quat([x, y, z, w]).as_matrix()
    return float(np.linalg.norm(-R.T @ pose[1] - truth[name].position))


@pytest.mark.parametrize("text", ["", "a,b", "0", "0,50,40", "0,,5", "0,nan"])
def test_wands_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="wand"):
        parse_wand(text)


def test_a_wand_is_read() -> None:
    assert parse_wand("0, 45,120") == (0.0, 45.0, 120.0)


def test_a_wand_that_is_nowhere_is_told(knocked_take: Path) -> None:
    truth = read_rig(knocked_take / "rig.json")

    with pytest.raises(InputError, match=r"no frame shows|no two cameras"):
        rig_by_wand(find_take(knocked_take), (0.0, 300.0, 1000.0), truth.cameras)


def test_bad_calls_are_told(wand_take: Path) -> None:
    truth = read_rig(wand_take / "rig.json")
    cameras = find_take(wand_take)
    with pytest.raises(InputError, match="no lens for cam2"):
        rig_by_wand(cameras, BALLS_MM, {n: truth[n] for n in truth.names[:2]})
    with pytest.raises(InputError, match="folders of pictures"):
        rig_by_wand([TakeCamera("a"), TakeCamera("b")], BALLS_MM, truth.cameras)
    with pytest.raises(InputError, match="no frames in common"):
        rig_by_markers(cameras, truth, span_s=(90.0, 99.0))


def test_moments_between_frames_follow_a_cubic() -> None:
    t = np.arange(20) / 30
    course = np.stack([100 * t**3 - 40 * t, 7 + 30 * t**2], axis=-1)
    track = WandTrack(t, np.repeat(course[:, None], 2, axis=1), np.full((20, 2), 0.1))
    at = np.array([0.2, 0.205, 0.43, 5.0, -1.0])

    pixels, sd = at_times(track, at)

    expected = np.stack([100 * at**3 - 40 * at, 7 + 30 * at**2], axis=-1)
    np.testing.assert_allclose(pixels[:3, 0], expected[:3], atol=1e-9)
    assert np.isnan(pixels[3:]).all()
    assert sd[0, 0] == 0.1
    assert (sd[1:3] < 0.11).all()


def test_moments_beside_gaps_are_not_known() -> None:
    t = np.delete(np.arange(20) / 30, 9)
    track = WandTrack(t, np.zeros((19, 2, 2)), np.ones((19, 2)))

    pixels, _ = at_times(track, np.array([8.5, 3.5, 9.0]) / 30)

    assert np.isnan(pixels[[0, 2]]).all()
    assert np.isfinite(pixels[1]).all()
