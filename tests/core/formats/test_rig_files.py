"""Camera files of any format: told apart, read, written, shown."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from facewright.cli.info import describe_file
from facewright.cli.options import find_rig
from facewright.core.camera import Camera
from facewright.core.errors import InputError
from facewright.core.formats.rig_files import (
    RIG_FORMATS,
    read_any_rig,
    rig_format,
    write_any_rig,
)
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid

#: A path that asks for each format.
PATHS = {
    "rig.json": "a.json",
    "opencv": "a.yml",
    "kalibr": "a-camchain.yaml",
    "colmap": "model",
}
POINTS = np.random.default_rng(1).uniform((-200, -200, 800), (200, 200, 1200), size=(20, 3))


@pytest.fixture
def rig() -> Rig:
    """Three cameras that every format can hold."""
    rng = np.random.default_rng(0)
    K = np.array([[1400 / 3, 0, 319.7], [0, 1500 / 7, 239.1], [0, 0, 1]])
    k = np.array([0.1, -0.1, 1e-3, 2e-3, 0])
    return Rig(
        {
            name: Camera(
                (640, 480),
                K,
                Rigid(np.array([1, *rng.normal(scale=0.1, size=3)]), rng.normal(size=3) * 50),
                "opencv",
                k,
            )
            for name in ("left", "middle", "right")
        }
    )


@pytest.mark.parametrize("name", RIG_FORMATS)
def test_every_format_keeps_where_a_rig_sees_points(tmp_path: Path, rig: Rig, name: str) -> None:
    path = tmp_path / PATHS[name]

    write_any_rig(path, rig)
    found = read_any_rig(path)

    assert rig_format(path) == name
    assert found.names == rig.names
    for camera in rig:
        mine, again = rig[camera].project(POINTS), found[camera].project(POINTS)
        np.testing.assert_allclose(again, mine, atol=1e-9)


def test_one_rig_through_all_formats_in_turn_stays_where_it_is(tmp_path: Path, rig: Rig) -> None:
    found = rig
    for name in (*PATHS, *reversed(PATHS)):
        write_any_rig(tmp_path / PATHS[name], found)
        found = read_any_rig(tmp_path / PATHS[name])
    for camera in rig:
        mine, again = rig[camera].project(POINTS), found[camera].project(POINTS)
        np.testing.assert_allclose(again, mine, atol=1e-9)


def test_the_contents_of_yaml_tell_not_its_name(tmp_path: Path, rig: Rig) -> None:
    write_any_rig(tmp_path / "camchain.yaml", rig, as_format="opencv")
    write_any_rig(tmp_path / "opencv.yaml", rig, as_format="kalibr")
    assert rig_format(tmp_path / "camchain.yaml") == "opencv"
    assert rig_format(tmp_path / "opencv.yaml") == "kalibr"
    assert read_any_rig(tmp_path / "opencv.yaml").names == rig.names


@pytest.mark.parametrize("odd_key", ["cam0", "intrinsics"])
def test_one_of_kalibrs_keys_does_not_make_an_opencv_file_kalibrs(
    tmp_path: Path, odd_key: str
) -> None:
    path = tmp_path / "cam0.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("name", "cam0")
    storage.write(odd_key, 1)
    storage.write("image_size", (640, 480))
    storage.write("K", np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]))
    storage.release()
    assert rig_format(path) == "opencv"
    assert read_any_rig(path).names == ("cam0",)


def test_a_folder_holds_a_model_or_a_rig_but_not_both(tmp_path: Path, rig: Rig) -> None:
    with pytest.raises(InputError, match="a folder without cameras"):
        read_any_rig(tmp_path)
    write_any_rig(tmp_path / "rig.json", rig)
    assert read_any_rig(tmp_path).names == rig.names
    write_any_rig(tmp_path / "cameras.txt", rig)
    with pytest.raises(InputError, match=r"both rig\.json and a COLMAP model"):
        read_any_rig(tmp_path)
    assert read_any_rig(tmp_path / "cameras.txt").names == rig.names
    assert rig_format(tmp_path / "images.txt") == "colmap"


@pytest.mark.parametrize(
    ("name", "hint"), [("a.xml", "ends in .yml"), ("a.bin", "model_converter"), ("a.txt", "")]
)
def test_what_is_no_camera_file_is_said(tmp_path: Path, rig: Rig, name: str, hint: str) -> None:
    path = tmp_path / name
    with pytest.raises(FileNotFoundError):
        read_any_rig(path)
    path.write_text("x")
    with pytest.raises(InputError, match=f"not a camera file that we read: .*{hint}"):
        read_any_rig(path)
    with pytest.raises(InputError, match="not a camera file that we write"):
        write_any_rig(path, rig)
    with pytest.raises(ValueError, match="as_format must be one of"):
        write_any_rig(path, rig, as_format="xml")
    assert path.read_text() == "x"


@pytest.mark.parametrize("name", RIG_FORMATS)
def test_the_command_takes_and_describes_every_format(
    tmp_path: Path, rig: Rig, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / PATHS[name]
    write_any_rig(path, rig)

    described = describe_file(path)
    found = find_rig(path, [tmp_path / "left.mp4"])

    words = {"rig.json": "camera rig"}.get(name, f"camera rig ({RIG_FORMATS[name]})")
    assert described.contents == words
    assert described.facts == {"n_cameras": 3}
    assert [item["name"] for item in described.items] == list(rig.names)
    json.dumps(described.items)
    assert found.names == rig.names
    assert capsys.readouterr() == ("", "")
