"""USD files, judged by USD's own validators, skinning and package reader."""

from __future__ import annotations

import io
import sys
import zipfile
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from facewright.core.audio import Audio, read_audio
from facewright.core.errors import InputError
from facewright.core.formats.gltf import GltfPart, GltfScene, MorphTarget
from facewright.core.formats.usd import time_codes, write_usd
from facewright.core.mesh import vertex_normals
from facewright.core.rigid import rotation_from_quaternion

N_FRAMES = 6
POINTS = np.array([[0, 0, 0], [40, 0, 0], [0, 40, 0], [0, 0, 40]], dtype=np.float64)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)


@pytest.fixture(autouse=True)
def usd() -> None:
    pytest.importorskip("pxr.UsdSkel", reason="needs the package usd-core")


def picture(shade: int) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (8, 8), (shade, 128, 255)).save(out, "PNG")
    return out.getvalue()


def turning(axis: tuple[float, float, float], most: float) -> NDArray[np.float64]:
    angles = np.linspace(0.1, most, N_FRAMES)[:, None]
    return np.concatenate([np.cos(angles / 2), np.sin(angles / 2) * np.array([axis])], axis=1)


def some_scene() -> GltfScene:
    rng = np.random.default_rng(4)
    uv = rng.uniform(size=(4, 2))
    targets = (
        MorphTarget("jawOpen", np.array([1, 3], np.int32), *rng.normal(scale=9, size=(2, 2, 3))),
        MorphTarget("fp_8.3_x+1", np.arange(4, dtype=np.int32), *rng.normal(size=(2, 4, 3))),
        MorphTarget("fp 8.3 x 1", np.zeros(0, np.int32), np.zeros((0, 3)), np.zeros((0, 3))),
    )
    skin = GltfPart(
        "skin", POINTS + (0, 30, 80), FACES, vertex_normals(POINTS, FACES), uv, joint="head",
        texture_png=picture(200), normal_png=picture(128), roughness_png=picture(0),
        targets=targets, weights=rng.uniform(-1, 1, size=(N_FRAMES, 3)),
    )  # fmt: skip
    jaw = replace(
        skin, name="teeth", vertices=POINTS + (0, -60, 20), joint="jaw", targets=(), weights=None,
        rotation=turning((1, 0, 0), 0.5), translation=rng.normal(size=(N_FRAMES, 3)),
        pivot=np.array([0.1, -20.3, -70.7]),
    )  # fmt: skip
    tongue = replace(
        jaw, name="tongue", targets=targets[:1], weights=rng.uniform(size=(N_FRAMES, 1)),
        base_color=np.array([0.5, 0.1, 0.1, 0.5]),
    )  # fmt: skip
    eye = replace(
        jaw, name="eye left", joint=None, rotation=turning((0, 1, 0), -0.4), translation=None,
        pivot=np.array([31.3, 1.0, 3.0]), uv=None,
        texture_png=None, normal_png=None, roughness_png=None,
    )  # fmt: skip
    return GltfScene(
        "take ✓", (skin, jaw, tongue, eye), np.arange(N_FRAMES) / 25,
        turning((0, 0.6, 0.8), 1.2), rng.normal(scale=50, size=(N_FRAMES, 3)),
        root_pivot=np.array([0.5, -91.3, -60.7]),
    )  # fmt: skip


def problems(path: Path) -> list[str]:
    """What USD's validators find; also those of packages and of skeletons."""
    from pxr import Usd, UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    context = UsdValidation.ValidationContext(validators)
    return [str(e.GetMessage()) for e in context.Validate(Usd.Stage.Open(str(path)))]


def test_the_validators_do_find_mistakes(tmp_path: Path) -> None:
    from pxr import Usd

    write_usd(tmp_path / "a.usda", some_scene())
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    stage.GetRootLayer().ClearDefaultPrim()
    stage.GetPrimAtPath("/Head/skin").RemoveAPI("MaterialBindingAPI")
    stage.GetRootLayer().Save()

    assert len(problems(tmp_path / "a.usda")) >= 2


def expected(scene: GltfScene, part: GltfPart, frame: int) -> NDArray[np.float64]:
    """A part's vertices in the world, mm."""
    v = part.vertices.copy()
    for k, target in enumerate(part.targets):
        assert part.weights is not None
        v[target.rows] += part.weights[frame, k] * target.offsets
    if part.rotation is not None:
        turn = rotation_from_quaternion(part.rotation[frame])
        shift = 0 if part.translation is None else part.translation[frame]
        v = (v - part.pivot) @ turn.T + part.pivot + shift
    assert scene.root_rotation is not None and scene.root_translation is not None
    return np.asarray(
        v @ rotation_from_quaternion(scene.root_rotation[frame]).T + scene.root_translation[frame]
    )


def baked(stage: Any, name: str, code: float) -> NDArray[np.float64]:
    """A mesh's points in the world, m."""
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh.Get(stage, f"/Head/{name}")
    points = np.array(mesh.GetPointsAttr().Get(code), dtype=np.float64)
    matrix = np.array(mesh.ComputeLocalToWorldTransform(code))
    return np.asarray(points @ matrix[:3, :3] + matrix[3, :3])


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd", ".usdz"])
def test_usds_own_skinning_puts_vertices_where_ours_are(tmp_path: Path, suffix: str) -> None:
    from pxr import Usd, UsdSkel

    scene = some_scene()
    path = tmp_path / f"head{suffix}"
    write_usd(path, scene, rate=Fraction(25))

    assert problems(path) == []
    layer = Usd.Stage.Open(str(path)).Flatten()
    stage = Usd.Stage.Open(layer)
    assert UsdSkel.BakeSkinning(stage.Traverse())
    for part in scene.parts:
        for frame in range(N_FRAMES):
            found = baked(stage, part.name.replace(" ", "_"), frame)
            error_m = np.abs(found - expected(scene, part, frame) / 1000).max()
            assert error_m < 1e-6, f"{part.name}, frame {frame}: {error_m:.2g} m off"


def test_a_stage_says_its_units_axes_and_times(tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom

    write_usd(tmp_path / "a.usda", some_scene(), rate=Fraction(30000, 1001))

    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))

    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert stage.GetTimeCodesPerSecond() == pytest.approx(30000 / 1001, rel=1e-12)
    assert (stage.GetStartTimeCode(), stage.GetDefaultPrim().GetName()) == (0.0, "Head")
    assert stage.GetEndTimeCode() == pytest.approx(5 / 25 * 30000 / 1001)


def test_weights_and_names_of_shapes_are_kept(tmp_path: Path) -> None:
    from pxr import Usd, UsdSkel

    scene = some_scene()
    write_usd(tmp_path / "a.usdc", scene, rate=Fraction(25))

    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    animation = UsdSkel.Animation.Get(stage, "/Head/Animation")
    names = list(animation.GetBlendShapesAttr().Get())
    # the tongue's jawOpen has other weights than the skin's
    assert names == ["jawOpen", "fp_8_3_x_1", "fp_8_3_x_1_2", "jawOpen_2"]
    for frame in range(N_FRAMES):
        found = np.array(animation.GetBlendShapeWeightsAttr().Get(frame))
        truth = [p.weights[frame] for p in scene.parts if p.weights is not None]
        np.testing.assert_array_equal(found, np.float32(np.concatenate(truth)))


def test_materials_find_their_textures(tmp_path: Path) -> None:
    from pxr import Usd, UsdShade

    scene = some_scene()
    write_usd(tmp_path / "a.usda", scene)

    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    skin = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/Head/skin")).ComputeBoundMaterial()[0]
    surface = skin.ComputeSurfaceSource()[0]
    truth = {
        "diffuseColor": scene.parts[0].texture_png,
        "normal": scene.parts[0].normal_png,
        "roughness": scene.parts[0].roughness_png,
    }
    for name, data in truth.items():
        texture = surface.GetInput(name).GetConnectedSource()[0]
        shader = UsdShade.Shader(texture.GetPrim())
        file = shader.GetInput("file").Get()
        space = shader.GetInput("sourceColorSpace").Get()
        assert space == ("sRGB" if name == "diffuseColor" else "raw")
        assert Path(file.resolvedPath).read_bytes() == data, name
    tongue = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/Head/tongue"))
    surface = tongue.ComputeBoundMaterial()[0].ComputeSurfaceSource()[0]
    assert surface.GetInput("opacity").GetConnectedSource() is not None


def test_a_package_is_a_zip_with_aligned_files_its_layer_first(tmp_path: Path) -> None:
    sound = Audio(np.linspace(-0.5, 0.5, 800, dtype=np.float32), 8000)
    write_usd(tmp_path / "a.usdz", some_scene(), sound=sound)

    with zipfile.ZipFile(tmp_path / "a.usdz") as package:
        infos = package.infolist()
        assert package.testzip() is None
        for info in infos:
            assert info.compress_type == zipfile.ZIP_STORED
        data = (tmp_path / "a.usdz").read_bytes()
        for info in infos:
            start = data.index(package.read(info), info.header_offset)
            assert start % 64 == 0, info.filename
        assert infos[0].filename == "a.usdc"
        package.extract("files/sound.wav", tmp_path)
    assert read_audio(tmp_path / "files" / "sound.wav").duration_s == 0.1
    assert problems(tmp_path / "a.usdz") == []


def test_sound_starts_with_the_first_frame(tmp_path: Path) -> None:
    from pxr import Usd, UsdMedia

    sound = Audio(np.zeros(16000, np.float32), 8000)
    write_usd(tmp_path / "a.usda", some_scene(), rate=Fraction(25), sound=sound)

    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    found = UsdMedia.SpatialAudio.Get(stage, "/Head/Sound")

    assert Path(found.GetFilePathAttr().Get().resolvedPath) == tmp_path / "a_files" / "sound.wav"
    assert found.GetStartTimeAttr().Get() == 0
    assert found.GetAuralModeAttr().Get() == "nonSpatial"
    assert stage.GetEndTimeCode() == 50  # it outlasts the animation
    assert problems(tmp_path / "a.usda") == []


def test_what_does_not_move_has_no_time_samples(tmp_path: Path) -> None:
    from pxr import Usd, UsdSkel

    still = tuple(
        replace(p, weights=None, rotation=None, translation=None) for p in some_scene().parts
    )
    write_usd(tmp_path / "a.usdc", GltfScene("still", still))

    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    animation = UsdSkel.Animation.Get(stage, "/Head/Animation")

    assert problems(tmp_path / "a.usdc") == []
    for attribute in animation.GetPrim().GetAttributes():
        assert attribute.GetNumTimeSamples() == 0, attribute.GetName()


@pytest.mark.parametrize("rate", [Fraction(24), Fraction(30000, 1001), Fraction(60)])
def test_frames_of_a_rate_have_whole_time_codes(rate: Fraction) -> None:
    jittered = np.round(np.arange(900) / float(rate), 3)  # as files with milliseconds have it
    assert time_codes(jittered, rate).tolist() == list(range(900))
    uneven = np.array([0.0, 0.02, 0.03])
    np.testing.assert_allclose(time_codes(uneven, rate), uneven * float(rate))


def test_without_usd_the_user_is_told_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    monkeypatch.setitem(sys.modules, "pxr.UsdSkel", None)

    with pytest.raises(InputError, match=r"pip install 'facewright\[usd\]'"):
        write_usd(tmp_path / "a.usd", some_scene())


def test_nothing_is_left_of_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "a_files").write_text("in the way")

    with pytest.raises(OSError, match="a_files"):
        write_usd(tmp_path / "a.usd", some_scene())

    assert [p.name for p in tmp_path.iterdir()] == ["a_files"]
