"""The neutral face: found, written, read again, and refused where it is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facewright.core.errors import FileFormatError, InputError
from facewright.heads.face_landmarks import NAMED_LANDMARKS
from facewright.tracking.face_fit import N_SHAPES, FittedFace
from facewright.tracking.landmark_tracks import LandmarkTracks
from facewright.tracking.neutral_personal import (
    find_neutral_frames,
    frames_around,
    read_neutral,
    write_neutral,
)


def somebody() -> FittedFace:
    rng = np.random.default_rng(2)
    return FittedFace(rng.normal(size=N_SHAPES), 1.02, rng.normal(size=(397, 3)), 1400.0, 90.0, 8)


def clip(n: int = 90) -> LandmarkTracks:
    """A face that opens its mouth, blinks and turns, but not from frame 40 to 52."""
    rng = np.random.default_rng(0)
    p = np.broadcast_to(300 + 100 * rng.random((478, 2)), (n, 478, 2)).copy()
    places = {
        "eye_right_outer": (300, 300), "eye_left_outer": (400, 300), "mouth_right": (325, 380),
        "mouth_left": (375, 380), "lip_upper_inner": (350, 380), "lip_lower_inner": (350, 381),
        "nose_tip": (350, 340), "lid_right_upper": (320, 296), "lid_right_lower": (320, 304),
        "lid_left_upper": (380, 296), "lid_left_lower": (380, 304),
    }  # fmt: skip
    for name, at in places.items():
        p[:, NAMED_LANDMARKS[name]] = at
    t = np.arange(n)
    acting = (t < 40) | (t > 52)
    p[:, NAMED_LANDMARKS["lip_lower_inner"], 1] += acting * (12 + 8 * np.sin(t))
    blink = (t % 20 < 4) & acting
    for side in ("right", "left"):
        p[:, NAMED_LANDMARKS[f"lid_{side}_upper"], 1] += 7 * blink
    p[:, NAMED_LANDMARKS["nose_tip"], 0] += acting * 10
    return LandmarkTracks(
        t / 30, p, np.full((n, 478), 0.3), np.full(n, 20.0), np.ones(n, int), (640, 480), cuts=(60,)
    )


def test_the_neutral_frames_are_those_with_a_face_at_rest() -> None:
    frames = find_neutral_frames(clip())

    assert len(frames) >= 4
    assert frames.min() >= 40
    assert frames.max() <= 52


def test_brows_of_unlike_height_are_not_neutral() -> None:
    plain = clip()
    p = np.array(plain.points_px)
    p[:, 105], p[:, 334] = (300, 280), (400, 280)
    p[40:44, 105, 1] -= 12
    p[40:44, 334, 1] += 12  # together they are as high as ever

    frames = find_neutral_frames(replace(plain, points_px=p))

    assert frames.min() >= 44
    assert frames.max() <= 52


def test_of_like_stretches_an_early_one_is_neutral() -> None:
    still = clip()
    p = np.repeat(still.points_px[45:46], len(still.time_s), axis=0)
    p[:30, NAMED_LANDMARKS["lip_lower_inner"], 1] += 0.3  # a hundredth of a lip's height

    frames = find_neutral_frames(replace(still, points_px=p, cuts=()))

    assert frames.max() < 10


def test_every_camera_has_its_say() -> None:
    one, other = clip(), clip()
    p = np.repeat(one.points_px[45:46], len(one.time_s), axis=0)
    beside = replace(one, points_px=p, cuts=())

    frames = find_neutral_frames(beside, [other])

    assert frames.min() >= 40
    assert frames.max() <= 52


def test_frames_around_a_time_stay_in_its_shot() -> None:
    frames = frames_around(clip(), 61 / 30)

    assert frames.min() >= 60
    assert 61 in frames


def test_a_time_without_a_face_is_refused() -> None:
    with pytest.raises(InputError, match="choose another neutral time"):
        frames_around(clip(), 99.0)


def test_a_neutral_face_is_read_back_exactly(tmp_path: Path) -> None:
    write_neutral(tmp_path / "me.npz", somebody())

    found = read_neutral(tmp_path / "me.npz")

    for name in ("amounts", "offsets"):
        assert np.array_equal(getattr(found, name), getattr(somebody(), name))
    assert (found.size, found.focal_px, found.n_frames) == (1.02, 1400.0, 8)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 broken"])
def test_what_is_no_neutral_face_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.npz"
    path.write_bytes(content)

    with pytest.raises(FileFormatError, match=r"bad\.npz"):
        read_neutral(path)


@pytest.mark.parametrize(
    ("field", "value"),
    [("size", np.array(np.nan)), ("version", np.array(9)), ("offsets", np.zeros(3))],
)
def test_a_neutral_face_with_wrong_fields_is_refused(
    tmp_path: Path, field: str, value: np.ndarray
) -> None:
    write_neutral(tmp_path / "me.npz", somebody())
    with np.load(tmp_path / "me.npz") as z:
        arrays = {name: z[name] for name in z.files}
    np.savez(tmp_path / "wrong.npz", **{**arrays, field: value})

    with pytest.raises(FileFormatError):
        read_neutral(tmp_path / "wrong.npz")


def test_objects_in_the_file_are_not_unpickled(tmp_path: Path) -> None:
    write_neutral(tmp_path / "me.npz", somebody())
    with np.load(tmp_path / "me.npz") as z:
        arrays = {name: z[name] for name in z.files}
    arrays["amounts"] = np.array([{"a": 1}], dtype=object)
    np.savez(tmp_path / "wrong.npz", **arrays)

    with pytest.raises(FileFormatError):
        read_neutral(tmp_path / "wrong.npz")
