"""`facewright view`: which files make which page."""

from __future__ import annotations

import base64
import dataclasses
import gzip
import io
import json
import re
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
import soundfile
from typer.testing import CliRunner

from facewright.cli.main import app
from facewright.cli.page_points import ball_places, feature_point_places, head_of
from facewright.cli.page_size import rounded_glb
from facewright.cli.view_files import Shown, animated, head_model
from facewright.core.audio import Audio, write_audio
from facewright.core.clip import Clip
from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.c3d import write_c3d
from facewright.core.formats.clip_npz import write_clip_npz
from facewright.core.formats.fap import write_fap
from facewright.core.formats.gltf import GltfScene, glb_bytes, scene_from_glb
from facewright.core.formats.live_link_csv import write_live_link_csv
from facewright.core.trajectories import Trajectories
from facewright.heads.catalogue import built_in_identity
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head
from facewright.retarget.export import animation_glb

RATE_HZ = 25
TIMES = np.arange(15) / RATE_HZ
ICT_HEAD = Path(__file__).parents[3] / "shared/data/real/heads/ict_random_identity.glb"


def faps(amount: float = 300.0) -> Clip:
    """A jaw that opens and shuts, and a brow."""
    names = ("open_jaw", "raise_l_i_eyebrow", "head_yaw")
    open_shut = np.sin(np.pi * TIMES / TIMES[-1])
    return Clip(TIMES, names, np.outer(open_shut, (amount, 80.0, 9000.0)))


@pytest.fixture(scope="module")
def head() -> Head:
    return make_head(Identity("average"), texture_px=256)


@pytest.fixture
def quick_heads(head: Head, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every built-in name is the same head, made once."""
    monkeypatch.setattr(
        "facewright.cli.heads.find_head", lambda name: dataclasses.replace(head, name=name)
    )


@pytest.fixture(scope="module")
def glb(head: Head) -> bytes:
    return glb_bytes(animation_glb(head, animated(head, faps()), name="average"))


def run(*arguments: str | Path) -> tuple[int, str]:
    """Exit code and what was said."""
    result = CliRunner().invoke(app, ["view", *map(str, arguments)])
    return result.exit_code, result.stderr


def config_of(page: Path) -> dict[str, Any]:
    found = re.search(r'id="config">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    config: dict[str, Any] = json.loads(found[1])
    return config


def block_of(page: Path, name: str) -> bytes:
    text = page.read_text(encoding="utf-8")
    found = re.search(rf'id="{name}"( data-packed="gzip")?>(.*?)</script>', text, re.DOTALL)
    assert found is not None
    data = base64.b64decode(found[2])
    return gzip.decompress(data) if found[1] else data


def tone(path: Path, seconds: float = 0.6, rate_hz: int = 16000) -> Path:
    samples = 0.5 * np.sin(2 * np.pi * 200 * np.arange(int(seconds * rate_hz)) / rate_hz)
    write_audio(path, Audio(samples.astype(np.float32), rate_hz))
    return path


def video(path: Path, *, has_sound: bool) -> Path:
    with av.open(str(path), "w") as container:
        pictures = container.add_stream("libx264", rate=RATE_HZ)
        pictures.width, pictures.height, pictures.pix_fmt = 64, 48, "yuv420p"
        sound = container.add_stream("aac", rate=48000, layout="mono") if has_sound else None
        for i in range(15):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 10 * i, np.uint8), "rgb24")
            container.mux(pictures.encode(frame))
        container.mux(pictures.encode(None))
        if sound is not None:
            for i in range(28):
                wave = np.full((1, 1024), 0.25, np.float32) * (-1) ** i
                block = av.AudioFrame.from_ndarray(wave, format="fltp", layout="mono")
                block.sample_rate, block.pts = 48000, 1024 * i
                container.mux(sound.encode(block))
            container.mux(sound.encode(None))
    return path


# pages


def test_a_clip_moves_a_head_and_its_curves_and_sound_go_with_it(
    quick_heads: None, tmp_path: Path
) -> None:
    clip, wav, out = tmp_path / "line.fap", tone(tmp_path / "line.wav"), tmp_path / "page.html"
    write_fap(clip, faps())

    code, said = run(clip, wav, "--head", "average", "--out", out)

    assert code == 0
    assert f"wrote {out}, {out.stat().st_size / 2**20:.1f} MiB" in said
    config = config_of(out)
    assert [m["label"] for m in config["models"]] == ["average"]
    assert len(config["models"][0]["points"]) > 70
    assert [c["label"] for c in config["clips"]] == ["line.fap"]
    assert config["sound"]["isInVideo"] is False
    assert config["sound"]["duration"] == pytest.approx(0.6)
    scene = scene_from_glb(block_of(out, "model-0"), "page")
    assert scene.time_s[-1] == pytest.approx(TIMES[-1], abs=1e-5)
    samples, rate_hz = soundfile.read(io.BytesIO(block_of(out, "sound")))
    truth, _ = soundfile.read(wav)
    assert rate_hz == 16000
    assert np.abs(samples - truth).max() <= 1.5 / 32768


def test_the_sound_has_a_picture_of_lows_and_highs(tmp_path: Path) -> None:
    rate_hz, seconds = 44_100, 1.7
    time_s = np.arange(int(seconds * rate_hz)) / rate_hz
    samples = np.where(time_s < 1, 0.0, np.where(time_s < 1.5, 0.5, -1.0)).astype(np.float32)
    wav, out = tmp_path / "steps.wav", tmp_path / "page.html"
    write_audio(wav, Audio(samples, rate_hz))
    run(wav, "--out", out)

    peaks = np.frombuffer(block_of(out, "sound-peaks"), np.int8).reshape(-1, 2)

    assert len(peaks) == 425  # 1.7 s of 250 columns
    columns = (np.arange(425) + 0.5) / 250
    assert (peaks[columns < 0.99] == 0).all()
    assert (np.abs(peaks[(columns > 1.01) & (columns < 1.49)] - 63.5) <= 0.5).all()
    assert (peaks[columns > 1.51] == -127).all()


def test_two_clips_on_two_heads_share_a_time_line(quick_heads: None, tmp_path: Path) -> None:
    first, second, out = tmp_path / "a.fap", tmp_path / "b.npz", tmp_path / "page.html"
    write_fap(first, faps())
    write_clip_npz(second, faps(150.0))

    code, _ = run(first, second, "--head", "average", "--head", "maya", "--out", out)

    config = config_of(out)
    assert code == 0
    assert [m["label"] for m in config["models"]] == ["average: a.fap", "maya: b.npz"]
    assert [c["label"] for c in config["clips"]] == ["a.fap", "b.npz"]
    assert config["shown"].count("open_jaw") == 1  # one curve's name for both


def test_heads_in_files_are_compared_with_their_feature_points(glb: bytes, tmp_path: Path) -> None:
    first, second, out = tmp_path / "a.glb", tmp_path / "b.glb", tmp_path / "page.html"
    first.write_bytes(glb)
    second.write_bytes(glb)

    code, _ = run(first, second, "--out", out)

    config = config_of(out)
    assert code == 0
    assert [m["label"] for m in config["models"]] == ["a", "b"]
    assert config["models"][0]["points"] == config["models"][1]["points"]
    assert len(config["models"][0]["points"]) > 70
    assert config["clips"] == []
    assert config["rate"] == pytest.approx(RATE_HZ, rel=1e-4)


def test_a_clip_beside_a_model_is_only_plotted_unless_a_head_is_named(
    quick_heads: None, glb: bytes, tmp_path: Path
) -> None:
    model, clip, out = tmp_path / "a.glb", tmp_path / "a.fap", tmp_path / "page.html"
    model.write_bytes(glb)
    write_fap(clip, faps())

    run(model, clip, "--out", out)
    alone = config_of(out)
    run(model, clip, "--head", "average", "--out", out)
    together = config_of(out)

    assert [m["label"] for m in alone["models"]] == ["a"] and len(alone["clips"]) == 1
    assert [m["label"] for m in together["models"]] == ["a", "average"]


def test_arkit_weights_move_the_head_by_its_shapes(head: Head, tmp_path: Path) -> None:
    open_shut = np.sin(np.pi * TIMES / TIMES[-1])
    write_live_link_csv(
        tmp_path / "a.csv", Clip(TIMES, ("jawOpen",), 0.6 * open_shut[:, None]), rate=RATE_HZ
    )
    shown = Shown()
    shown.add(tmp_path / "a.csv")

    scene = scene_from_glb(
        head_model("x", head, animated(head, shown.clips[0].clip)).glb, "the model"
    )

    skin = next(part for part in scene.parts if part.name == "skin")
    truth = head.shaped({"jawOpen": 0.6}) - head.mesh.vertices
    assert skin.weights is not None
    at = {t.name: t for t in skin.targets}["jawOpen"]
    frame = int(np.argmax(open_shut))
    weight = skin.weights[frame, [t.name for t in skin.targets].index("jawOpen")]
    lowest = float((weight * at.offsets[:, 1]).min())
    assert lowest == pytest.approx(truth[:, 1].min() * open_shut[frame], abs=0.05)


def test_markers_are_balls_with_names(tmp_path: Path) -> None:
    positions = np.zeros((10, 3, 3))
    positions[:, :, 0] = (0.0, 40.0, 80.0)
    positions[:, 1, 1] = np.linspace(0, 20, 10)
    write_c3d(tmp_path / "m.c3d", Trajectories(np.arange(10) / 50, ("a", "b", "c"), positions))
    out = tmp_path / "page.html"

    code, _ = run(tmp_path / "m.c3d", "--out", out)

    config = config_of(out)
    assert code == 0
    assert [name for name, _ in config["models"][0]["points"]] == ["a", "b", "c"]
    scene = scene_from_glb(block_of(out, "model-0"), "page")
    for name, place in config["models"][0]["points"]:
        mesh, _, *corners = (int(n) for n in place.split()[:5])
        shares = np.array([float(s) for s in place.split()[5:]])
        part = scene.parts[mesh]
        middle = (part.vertices - part.pivot)[corners].T @ shares
        assert part.name == name and np.abs(middle).max() < 1e-3


@pytest.mark.parametrize("has_sound", [True, False])
def test_a_video_plays_its_own_sound(has_sound: bool, tmp_path: Path) -> None:
    path, out = video(tmp_path / "v.mp4", has_sound=has_sound), tmp_path / "page.html"

    code, _ = run(path, "--out", out)

    config = config_of(out)
    assert code == 0
    assert config["videos"][0]["hasSound"] is has_sound
    assert (config["sound"] is not None) is has_sound
    assert block_of(out, "video-0") == path.read_bytes()
    if has_sound:
        assert config["sound"]["isInVideo"] is True
        assert 'id="sound"' not in out.read_text(encoding="utf-8")  # it is stored once


def test_a_sound_file_goes_before_a_videos_own(tmp_path: Path) -> None:
    path, wav = video(tmp_path / "v.mp4", has_sound=True), tone(tmp_path / "a.wav")
    out = tmp_path / "page.html"

    run(path, wav, "--out", out)

    config = config_of(out)
    assert config["sound"]["label"] == "a.wav" and not config["videos"][0]["hasSound"]


# models


def test_feature_points_lie_where_the_head_has_them(head: Head, glb: bytes) -> None:
    places = feature_point_places(glb, head)
    scene = scene_from_glb(glb, "glb")

    assert set(places) == set(head.feature_points.names)
    for name, place in places.items():
        mesh, primitive, *corners = (int(n) for n in place.split()[:5])
        shares = np.array([float(s) for s in place.split()[5:]])
        assert primitive == 0 and shares.sum() == pytest.approx(1, abs=2e-4)
        at = scene.parts[mesh].vertices[corners].T @ shares
        assert np.linalg.norm(at - head.points[name]) < 0.01, name


def test_another_heads_model_has_none_of_its_points(glb: bytes) -> None:
    other = make_head(built_in_identity("kofi"), texture_px=256)

    assert len(feature_point_places(glb, other)) < 5
    assert head_of(glb) == "average"
    assert ball_places(glb, ("a",)) == {}


def test_rounding_is_not_seen_and_packs_better(glb: bytes) -> None:
    small = rounded_glb(glb)

    before, after = scene_from_glb(glb, "glb"), scene_from_glb(small, "small")
    assert len(gzip.compress(small)) < 0.85 * len(gzip.compress(glb))
    for old, new in zip(before.parts, after.parts, strict=True):
        assert np.abs(old.vertices - new.vertices).max() < 0.004
        assert np.abs(old.normals - new.normals).max() < 0.002
        assert (old.triangles == new.triangles).all()
        assert old.texture_png == new.texture_png
        for a, b in zip(old.targets, new.targets, strict=True):
            assert (a.rows == b.rows).all()
            assert np.abs(a.offsets - b.offsets).max() < 0.004
        if old.weights is not None:
            assert new.weights is not None
            assert np.abs(old.weights - new.weights).max() < 1e-4


def test_rounding_again_changes_nothing(glb: bytes) -> None:
    once = rounded_glb(glb)

    assert rounded_glb(once) == once


def test_bounds_are_those_of_the_rounded_values(glb: bytes) -> None:
    import pygltflib

    document = pygltflib.GLTF2.load_from_bytes(rounded_glb(glb))
    blob = document.binary_blob()
    seen = 0
    for mesh in document.meshes:
        accessor = document.accessors[mesh.primitives[0].attributes.POSITION]
        view = document.bufferViews[accessor.bufferView]
        values = np.frombuffer(blob, "<f4", accessor.count * 3, view.byteOffset).reshape(-1, 3)
        assert accessor.min == values.min(axis=0).tolist()
        assert accessor.max == values.max(axis=0).tolist()
        seen += 1
    assert seen >= 7


def test_a_model_by_another_program_is_shown_and_hardly_changed(tmp_path: Path) -> None:
    if not ICT_HEAD.is_file():
        pytest.skip("needs shared/data/real/heads, which is not here")
    out = tmp_path / "page.html"

    code, _ = run(ICT_HEAD, "--out", out)

    assert code == 0
    before = scene_from_glb(ICT_HEAD.read_bytes(), "ict")
    after = scene_from_glb(block_of(out, "model-0"), "page")
    size = np.ptp(before.parts[0].vertices, axis=0).max()
    for old, new in zip(before.parts, after.parts, strict=True):
        assert np.abs(old.vertices - new.vertices).max() < 2e-5 * size


# bad input


def test_every_wrong_use_is_one_clear_line(glb: bytes, tmp_path: Path) -> None:
    clip, model = tmp_path / "a.fap", tmp_path / "a.glb"
    write_fap(clip, faps())
    model.write_bytes(glb)
    wav = tone(tmp_path / "a.wav")
    for name in ("a.usd", "a.obj", "a.bvh", "a.txt"):
        (tmp_path / name).write_text("x")
    (tmp_path / "broken.glb").write_bytes(glb[: len(glb) // 2])
    (tmp_path / "broken.fap").write_text("2.1 x 25 9\n1 1 1\n")
    (tmp_path / "broken.wav").write_bytes(b"RIFF\0\0\0\0WAVE")
    (tmp_path / "broken.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + bytes(64))
    muscles = tmp_path / "muscles.npz"
    write_clip_npz(muscles, Clip(TIMES, ("zygomatic",), TIMES[:, None]))
    for arguments, words in (
        ([tmp_path / "none.fap"], "No such file"),
        ([tmp_path / "a.usd"], "write the same as .glb"),
        ([tmp_path / "a.obj"], "give it by --head"),
        ([tmp_path / "a.bvh"], "show the clip"),
        ([tmp_path / "a.txt"], "a page shows .glb, .fap"),
        ([wav, tone(tmp_path / "b.wav")], "what can be compared side by side are clips"),
        ([clip, clip, clip, "--head", "average", "--head", "maya"], "do not go together"),
        ([model] * 5, "at most 4 heads"),
        ([clip] * 5, "at most 4 clips"),
        ([wav, "--head", "average"], "needs a clip that moves it"),
        ([clip, "--head", "nobody"], "no built-in head nobody"),
        ([clip, "--out", tmp_path / "page.txt"], "ends in .html"),
        ([muscles, "--head", "average"], "no FAP, ARKit weight"),
        ([tmp_path / "broken.glb"], "broken.glb"),
        ([tmp_path / "broken.fap"], "broken.fap"),
        ([tmp_path / "broken.wav"], "broken.wav"),
        ([tmp_path / "broken.mp4"], "broken.mp4"),
    ):
        before = sorted(tmp_path.iterdir())

        code, said = run(*arguments)

        assert code == 1, arguments
        lines = [line for line in said.splitlines() if line.startswith("facewright: ")]
        assert words in lines[-1] and said.splitlines()[-1] == lines[-1], said
        assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "arguments", [[], ["--live", "a.fap"], ["--live", "--out", "x.html"], ["--live", "--port", "0"]]
)
def test_wrong_usage_is_told_as_such(arguments: list[str]) -> None:
    code, said = run(*arguments)

    assert code == 2 and "Usage" in said


def test_errors_of_files_have_their_own_types(tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(b"glTF")
    with pytest.raises(FileFormatError):
        Shown().add(tmp_path / "a.glb")
    with pytest.raises(InputError):
        Shown().add_heads(["average"])


def test_a_scene_without_a_heads_name_has_no_head(glb: bytes) -> None:
    scene = scene_from_glb(glb, "glb")
    bare = GltfScene(scene.name, scene.parts, scene.time_s)

    assert head_of(glb_bytes(bare)) is None
