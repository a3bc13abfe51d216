"""`facewright retarget`: what goes in, what comes out, and one clear line for what does not."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from facewright.cli.main import build_app
from facewright.cli.retarget import retarget
from facewright.core.audio import Audio, write_audio
from facewright.core.clip import Clip
from facewright.core.formats.bvh_read import read_bvh
from facewright.core.formats.clip_npz import read_clip_npz, write_clip_npz
from facewright.core.formats.fap import read_fap, write_fap
from facewright.core.formats.gltf import read_glb
from facewright.core.formats.live_link_csv import read_live_link_csv, write_live_link_csv
from facewright.core.mpeg4 import ANGLE_UNIT_RAD

APP = build_app({"retarget": retarget})
HEAD = "average"


def run(*arguments: object) -> tuple[int, str]:
    words = [str(a) for a in arguments]
    done = CliRunner().invoke(APP, ["retarget", *words], catch_exceptions=False)
    return done.exit_code, done.output


def said(*arguments: object) -> str:
    """The one line that a command fails with."""
    code, output = run(*arguments)
    assert code == 1, output
    lines = [line for line in output.splitlines() if line.startswith("facewright: ")]
    assert len(lines) == 1, output
    return lines[0]


@pytest.fixture
def faps(tmp_path: Path) -> Path:
    t = np.arange(30) / 25  # past a whole second: a .csv then tells its rate
    curves = {
        "open_jaw": 400 * np.sin(4 * t) ** 2,
        "stretch_l_cornerlip": 150 * np.sin(3 * t),
        "close_t_l_eyelid": 700 * np.sin(6 * t) ** 2,
        "yaw_l_eyeball": 20000 * np.sin(5 * t),
        "head_yaw": 20000 * np.sin(4 * t),
        "head_pitch": 9000 * np.sin(3 * t),
    }
    path = tmp_path / "take.fap"
    write_fap(path, Clip(t, tuple(curves), np.stack(list(curves.values()), axis=1)))
    return path


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    t = np.arange(60) / 60
    curves = {"jawOpen": 0.4 * np.sin(4 * t) ** 2, "browInnerUp": 0.5 * np.sin(3 * t) ** 2}
    path = tmp_path / "take.csv"
    write_live_link_csv(path, Clip(t, tuple(curves), np.stack(list(curves.values()), axis=1)))
    return path


def test_a_head_by_its_shapes_has_shapes_with_their_names(tmp_path: Path, faps: Path) -> None:
    code, output = run(
        faps, "--head", HEAD, "--out", tmp_path / "a.glb", "--drive", "shapes", "--fps", "29.97"
    )

    assert code == 0, output
    assert "resampled to 35 frames, 29.97/s: 6 channels linear between keys" in output
    assert "leave these shapes unsure: " in output
    scene = read_glb(tmp_path / "a.glb")
    np.testing.assert_allclose(scene.time_s, np.arange(35) * 1001 / 30000, atol=1e-6)
    skin = next(p for p in scene.parts if p.name == "skin")
    assert {"jawOpen", "eyeBlinkLeft"} <= {t.name for t in skin.targets}
    assert {p.joint for p in scene.parts} == {"head", "jaw", "eye_left", "eye_right"}


def test_frames_as_shapes_have_two_weights_at_a_time(tmp_path: Path, faps: Path) -> None:
    code, output = run(
        faps, "--head", HEAD, "--out", tmp_path / "a.glb", "--morphs", "frames", "--fps", "10"
    )

    assert code == 0, output
    skin = next(p for p in read_glb(tmp_path / "a.glb").parts if p.name == "skin")
    assert skin.weights is not None
    assert (np.count_nonzero(skin.weights, axis=1) <= 1).all()


def test_rotations_as_bvh_are_those_of_the_faps(tmp_path: Path, faps: Path) -> None:
    code, output = run(faps, "--head", HEAD, "--out", tmp_path / "a.bvh", "--fps", "50")

    assert code == 0, output
    motion = read_bvh(tmp_path / "a.bvh")
    assert (motion.rate, len(motion)) == (Fraction(50), 59)
    assert [j.name for j in motion.joints] == ["Head", "Jaw", "LeftEye", "RightEye"]
    rows = (tmp_path / "a.bvh").read_text().split("Frame Time:")[1].splitlines()[1:]
    found = np.array([[float(x) for x in row.split()] for row in rows])
    clip = read_fap(faps)
    for column, name in ((3, "head_yaw"), (4, "head_pitch")):
        truth = np.rad2deg(clip[name] * ANGLE_UNIT_RAD)
        np.testing.assert_allclose(found[::2, column], truth, atol=1e-5)
    assert np.ptp(found[:, :3], axis=0).max() < 1e-5  # the neck stays


def test_faps_become_weights_and_weights_faps(tmp_path: Path, faps: Path, weights: Path) -> None:
    code, output = run(faps, "--head", HEAD, "--out", tmp_path / "out.csv")
    assert code == 0, output
    assert "count 25 frames a second" in output
    found = read_live_link_csv(tmp_path / "out.csv")
    np.testing.assert_allclose(found.time_s, np.arange(30) / 25, atol=1e-3)
    yaw = read_fap(faps)["head_yaw"] * ANGLE_UNIT_RAD
    np.testing.assert_allclose(found["headYaw"], yaw, atol=1e-6)

    assert run(weights, "--head", HEAD, "--out", tmp_path / "out.fap")[0] == 0
    again = read_fap(tmp_path / "out.fap")
    assert again.rate_hz == 60
    assert again["open_jaw"].max() > 50
    code, output = run(
        tmp_path / "out.fap", "--head", HEAD, "--out", tmp_path / "back.csv", "--fps", "60"
    )
    assert code == 0, output
    back = read_live_link_csv(tmp_path / "back.csv", timecode_rate=60)
    truth = read_live_link_csv(weights, timecode_rate=60)
    for name in ("jawOpen", "browInnerUp"):
        assert np.sqrt(np.mean((back[name] - truth[name]) ** 2)) < 0.05, name


def test_an_archive_holds_the_clip_or_the_shapes_weights(tmp_path: Path, weights: Path) -> None:
    assert run(weights, "--head", HEAD, "--out", tmp_path / "a.npz", "--fps", "30")[0] == 0
    found = read_clip_npz(tmp_path / "a.npz")
    np.testing.assert_array_equal(found.time_s, np.arange(30) / 30)

    out = tmp_path / "b.npz"
    assert run(weights, "--head", HEAD, "--out", out, "--drive", "shapes")[0] == 0
    np.testing.assert_allclose(
        read_clip_npz(out)["jawOpen"], read_live_link_csv(weights)["jawOpen"], atol=1e-9
    )


def test_weights_drive_a_head_by_its_shapes_which_is_said(tmp_path: Path, weights: Path) -> None:
    code, output = run(weights, "--head", HEAD, "--out", tmp_path / "a.glb")

    assert code == 0, output
    assert "average is driven by its shapes" in output
    skin = next(p for p in read_glb(tmp_path / "a.glb").parts if p.name == "skin")
    names = [t.name for t in skin.targets]
    assert sorted(names) == ["browInnerUp", "jawOpen"]
    assert skin.weights is not None
    truth = read_live_link_csv(weights)
    for name in names:
        found = skin.weights[:, names.index(name)]
        np.testing.assert_allclose(found, truth[name], atol=1e-6)


def test_a_video_keeps_its_sound_in_step(tmp_path: Path) -> None:
    """A clip from 0.5 s on, whose jaw opens where the sound clicks."""
    import av

    t = 0.5 + np.arange(13) / 25
    clip = Clip(t, ("open_jaw",), np.where(t >= 0.8, 600.0, 0.0)[:, None])
    write_clip_npz(tmp_path / "late.npz", clip)
    samples = np.zeros(48000 * 2, np.float32)
    samples[round(0.8 * 48000) :] = 0.5
    write_audio(tmp_path / "click.wav", Audio(samples, 48000))

    code, output = run(
        tmp_path / "late.npz", "--head", HEAD, "--out", tmp_path / "a.mp4", "--size", "96x96",
        "--audio", tmp_path / "click.wav",
    )  # fmt: skip

    assert code == 0, output
    assert "the clip begins at 0.500 s: so does the sound" in output
    assert "the sound goes on 1.020 s after the clip: the last pose is held" in output
    with av.open(str(tmp_path / "a.mp4")) as video:
        assert video.streams.video[0].average_rate == 25
        frames = [(float(f.time), f.to_ndarray(format="gray")) for f in video.decode(video=0)]
    assert len(frames) == 38  # 1.5 s and the first
    changes = [np.abs(b[1].astype(int) - a[1]).mean() for a, b in pairwise(frames)]
    opened_s = frames[int(np.argmax(changes)) + 1][0]
    with av.open(str(tmp_path / "a.mp4")) as video:
        blocks = [(f.time, f.to_ndarray()[0], f.sample_rate) for f in video.decode(audio=0)]
    times = np.concatenate([start + np.arange(len(b)) / rate for start, b, rate in blocks])
    heard_s = times[np.argmax(np.abs(np.concatenate([b for _, b, _ in blocks])) > 0.25)]
    assert abs(opened_s - heard_s) < 0.5 / 25, (opened_s, heard_s)


# what cannot be done


def test_what_does_not_fit_is_said_in_one_line(tmp_path: Path, faps: Path) -> None:
    other = tmp_path / "other.npz"
    write_clip_npz(other, Clip(np.zeros(1), ("tail_wag",), np.ones((1, 1))))
    uneven = tmp_path / "uneven.npz"
    write_clip_npz(uneven, Clip(np.array([0, 0.1, 0.5]), ("open_jaw",), np.ones((3, 1))))
    empty = tmp_path / "empty.npz"
    write_clip_npz(empty, Clip(np.zeros(0), ("open_jaw",), np.zeros((0, 1))))
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.glb").mkdir()
    (tmp_path / "no.wav").write_text("this is no sound")
    before = sorted(p.name for p in tmp_path.iterdir())

    assert "no FAP, ARKit weight or shape of head average" in said(other, "--head", HEAD)
    assert "tail_wag" in said(other, "--head", HEAD)
    assert "expected a name that ends in .glb" in said(faps, "--out", tmp_path / "a.fbx")
    assert "expected curves in a .fap" in said(tmp_path / "file", "--out", tmp_path / "a.glb")
    assert "the clip has no frames" in said(empty, "--head", HEAD)
    assert "--fps" in said(uneven, "--head", HEAD, "--out", tmp_path / "a.bvh")
    assert "cannot write there" in said(faps, "--out", tmp_path / "file" / "a.glb")
    assert "is a folder" in said(faps, "--out", tmp_path / "folder.glb")
    assert "no.wav" in said(
        faps, "--head", HEAD, "--out", tmp_path / "a.mp4", "--audio", tmp_path / "no.wav"
    )
    assert "videos and .usd only" in said(
        faps, "--out", tmp_path / "a.glb", "--audio", tmp_path / "no.wav"
    )
    assert "the clip itself" in said(faps, "--out", faps)
    assert "--drive shapes" in said(faps, "--out", tmp_path / "a.csv", "--drive", "points")
    assert "no built-in head nobody" in said(faps, "--head", "nobody")
    assert "No such file" in said(tmp_path / "none.fap", "--head", HEAD)
    assert sorted(p.name for p in tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("--fps", "0", "24, 25, 29.97"),
        ("--fps", "fast", "30000/1001"),
        ("--drive", "muscles", "points, shapes or direct"),
        ("--morphs", "some", "curves or frames"),
        ("--size", "3x4", "even"),
    ],
)
def test_wrong_usage_exits_with_2(faps: Path, option: str, value: str, expected: str) -> None:
    code, output = run(faps, option, value)

    assert code == 2
    assert expected in " ".join(output.replace("│", " ").split()), output
    assert not faps.with_suffix(".glb").exists()
