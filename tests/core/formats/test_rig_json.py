"""rig.json: read and written, also by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from facewright.core.camera import Camera
from facewright.core.errors import FileFormatError
from facewright.core.formats.rig_json import read_rig, write_rig
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid

#: The example of the format's description.
EXAMPLE = """{"version": 1, "units": "mm",
 "cameras": [{"name": "cam0", "image_size": [1280, 720],
   "matrix": [[1500.0, 0.0, 640.0], [0.0, 1500.0, 360.0], [0.0, 0.0, 1.0]],
   "distortion": {"model": "opencv", "coefficients": [0.0, 0.0, 0.0, 0.0, 0.0]},
   "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "translation": [0, 0, 1000]}]}
"""


def document() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(EXAMPLE)
    return found


def write(path: Path, value: Any) -> Path:
    path.write_text(value if isinstance(value, str) else json.dumps(value))
    return path


def test_the_example_of_the_description_is_read(tmp_path: Path) -> None:
    rig = read_rig(write(tmp_path / "rig.json", EXAMPLE))
    camera = rig["cam0"]
    assert rig.names == ("cam0",)
    assert camera.image_size == (1280, 720)
    np.testing.assert_array_equal(camera.project((0, 0, 0)), (640, 360))
    np.testing.assert_allclose(camera.position, (0, 0, -1000))


@pytest.mark.parametrize(
    ("model", "k"),
    [
        ("none", []),
        ("opencv", []),
        ("opencv", [0.1, -0.2, 1e-4, 1 / 3, 0.5]),
        ("opencv", list(np.linspace(-0.1, 0.1, 8))),
        ("opencv", list(np.linspace(-0.1, 0.1, 12))),
        ("tsai", [-0.123456789012345]),
    ],
)
def test_what_is_written_reads_back(tmp_path: Path, model: str, k: list[float]) -> None:
    rng = np.random.default_rng(5)
    K = np.array([[1400 / 3, 0.1, 319.7], [0, 1500 / 7, 239.1], [0, 0, 1]])
    cameras = {
        name: Camera(
            (640, 480), K, Rigid(rng.normal(size=4), rng.normal(size=3) * 999), model, np.array(k)
        )
        for name in ("left", 'the "odd" one \\ ä\n')
    }

    write_rig(tmp_path / "rig.json", Rig(cameras))
    found = read_rig(tmp_path / "rig.json")

    assert found.names == tuple(cameras)
    for name, camera in cameras.items():
        again = found[name]
        assert (again.image_size, again.distortion_model) == (camera.image_size, model)
        np.testing.assert_array_equal(again.matrix, camera.matrix)
        np.testing.assert_array_equal(again.distortion, camera.distortion)
        there, here = again.camera_from_world, camera.camera_from_world
        np.testing.assert_array_equal(there.translation, here.translation)
        np.testing.assert_allclose(there.rotation, here.rotation, atol=1e-15)
    json.loads((tmp_path / "rig.json").read_text())


def test_a_camera_file_may_leave_out_pose_units_and_distortion(tmp_path: Path) -> None:
    value = document()
    del value["units"]
    for key in ("rotation", "translation", "distortion"):
        del value["cameras"][0][key]
    camera = read_rig(write(tmp_path / "camera.json", value))["cam0"]
    assert camera.camera_from_world == Rigid.identity()
    assert camera.distortion_model == "none"


def test_a_rotation_typed_with_few_digits_is_put_right(tmp_path: Path) -> None:
    value = document()
    c, s = round(np.cos(0.3), 4), round(np.sin(0.3), 4)
    value["cameras"][0]["rotation"] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    R = read_rig(write(tmp_path / "rig.json", value))["cam0"].camera_from_world.rotation
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(R, [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-4)


def test_notes_beside_the_fields_are_ignored(tmp_path: Path) -> None:
    value = document()
    value["rms_px"] = 0.2
    value["cameras"][0]["serial"] = "A1"
    assert read_rig(write(tmp_path / "rig.json", value)).names == ("cam0",)


CAMERA_ERRORS = [
    ("image_size", [1280], r'camera "cam0", image_size: expected 2 numbers, found 1'),
    ("image_size", [1280.5, 720], "whole pixels"),
    ("image_size", [0, 720], "whole pixels"),
    ("image_size", [10**9, 720], "whole pixels"),
    ("image_size", None, "found nothing"),
    ("matrix", [[1, 0, 0], [0, 1, 0]], 'cam0", matrix: expected 3 rows of 3 numbers, found 2 rows'),
    ("matrix", [[1, 0, 0], [0, 1], [0, 0, 1]], "matrix, row 1: expected 3 numbers, found 2"),
    ("matrix", [[1, 0, 0], [0, "1", 0], [0, 0, 1]], 'row 1: expected finite numbers, found "1"'),
    ("matrix", [[1, 0, 0], [0, True, 0], [0, 0, 1]], "finite numbers, found true"),
    ("matrix", [[1, 0, 0], [0, 1e308, 0], [0, 0, 1]], "finite numbers"),
    ("matrix", [[-1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx and fy above 0"),
    ("matrix", [[1, 0, 5], [0, 1, 5], [0, 0, 2]], r"\[0, 0, 1\]"),
    ("rotation", [[1, 0, 0], [0, 1, 0], [0, 0, 1.01]], "orthonormal .*, found one that is off"),
    ("rotation", [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "mirror image"),
    ("rotation", None, "rotation: expected 3 rows of 3 numbers, found nothing"),
    ("translation", [1, 2], "translation: expected 3 numbers, found 2"),
    ("distortion", [0.1], "an object with model"),
    ("distortion", {"model": "fisheye"}, r'distortion, model: expected one of "none", .* "fish'),
    ("distortion", {"model": "opencv", "coefficients": [0, 0, 0, 0]}, "0 or 5 or 8 or 12 .* 4"),
    ("distorsion", {"model": "none"}, 'the key "distortion", found "distorsion"'),
]


@pytest.mark.parametrize(("key", "value", "message"), CAMERA_ERRORS)
def test_errors_in_a_camera_name_the_field(
    tmp_path: Path, key: str, value: Any, message: str
) -> None:
    whole = document()
    whole["cameras"][0][key] = value
    path = write(tmp_path / "rig.json", whole)
    with pytest.raises(FileFormatError, match=message) as caught:
        read_rig(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "an empty file"),
        ("[]", "an object with version"),
        ('{"version": 2, "cameras": []}', "version: expected 1, found 2"),
        ('{"cameras": []}', "version: expected 1, found nothing"),
        ('{"version": 1, "units": "m", "cameras": []}', 'units: expected "mm", found "m"'),
        ('{"version": 1, "cameras": []}', "at least one camera"),
        ('{"version": 1, "cameras": [7]}', r"cameras\[0\]: expected an object, found 7"),
        ('{"version": 1, "cameras": [{}]}', r"cameras\[0\], name: expected a text"),
        ('{"version": 1,\n "cameras": [}', "line 2, column 14: expected valid JSON"),
        ('{"version": 1, "cameras": [', "line 1, column 28: expected valid JSON, found the end"),
        ('{"version": 1, "version": 1}', 'the key "version" twice'),
        ('{"version": NaN}', "NaN, which is no number"),
        ("[" * 100_000, "brackets"),
        ('{"version": ' + "1" * 5000 + "}", "expected numbers"),
        ("\x00\x01\x02", "line 1, column 1"),
    ],
)
def test_errors_in_the_file_name_the_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FileFormatError, match=message):
        read_rig(write(tmp_path / "rig.json", text))


def test_two_cameras_of_one_name_and_a_rig_without_poses_are_refused(tmp_path: Path) -> None:
    value = document()
    value["cameras"].append(dict(value["cameras"][0]))
    with pytest.raises(FileFormatError, match=r"cameras\[1\], name: expected a name not used"):
        read_rig(write(tmp_path / "rig.json", value))
    value["cameras"][1] = {**value["cameras"][1], "name": "cam1"}
    del value["cameras"][1]["rotation"], value["cameras"][1]["translation"]
    with pytest.raises(FileFormatError, match=r'"cam1", rotation: .* found nothing'):
        read_rig(write(tmp_path / "rig.json", value))


def test_any_cut_of_a_file_is_an_error(tmp_path: Path) -> None:
    for n in range(len(EXAMPLE.strip())):
        with pytest.raises(FileFormatError):
            read_rig(write(tmp_path / "rig.json", EXAMPLE[:n]))
