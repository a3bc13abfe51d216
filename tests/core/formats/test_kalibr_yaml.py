"""Kalibr's camchain: its documented example, OpenCV's projection, PyYAML as a second reader."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from facewright.core.camera import Camera
from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.kalibr_yaml import read_kalibr_yaml, write_kalibr_yaml
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid

#: Laid out as Kalibr writes it (through PyYAML); two cameras 110 mm apart.
CHAIN = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.8e-05]
  distortion_model: radtan
  intrinsics: [458.65, 457.3, 367.2, 248.4]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.955336489125606, 0.0, 0.29552020666133955,
    -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [-0.29552020666133955, 0.0, 0.955336489125606, 0.01]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.2, 0.05, 0.0, 0.0]
  distortion_model: radtan
  intrinsics: [457.6, 456.1, 379.9, 255.2]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
"""
K = np.array([[1400 / 3, 0, 319.7], [0, 1500 / 7, 239.1], [0, 0, 1]])
POINTS = np.random.default_rng(1).uniform((-200, -200, 800), (200, 200, 1200), size=(20, 3))


def camera(k: list[float], seed: int = 3) -> Camera:
    """A camera that looks about along z, with all digits in use."""
    rng = np.random.default_rng(seed)
    pose = Rigid(np.array([1, *rng.normal(scale=0.1, size=3)]), rng.normal(size=3) * 100)
    return Camera((640, 480), K, pose, "opencv" if k else "none", np.array(k))


def write(folder: Path, text: str) -> Path:
    (folder / "camchain.yaml").write_text(text)
    return folder / "camchain.yaml"


def test_a_chain_projects_as_opencv_does(tmp_path: Path) -> None:
    """Kalibr's radtan is OpenCV's k1 k2 p1 p2; its metres are our thousand millimetres."""
    rig = read_kalibr_yaml(write(tmp_path, CHAIN))

    assert rig.names == ("cam0", "cam1")
    assert rig["cam0"].image_size == (752, 480)
    matrix = np.array([[458.65, 0, 367.2], [0, 457.3, 248.4], [0, 0, 1]])
    k = np.array([-0.28, 0.07, 0.0002, 1.8e-05])
    theirs, _ = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), matrix, k)
    np.testing.assert_allclose(rig["cam0"].project(POINTS), theirs[:, 0], atol=1e-9)
    matrix = np.array([[457.6, 0, 379.9], [0, 456.1, 255.2], [0, 0, 1]])
    turn, shift = np.array([0, 0.3, 0]), np.array([-110.0, 0, 10])
    theirs, _ = cv2.projectPoints(POINTS, turn, shift, matrix, np.array([-0.2, 0.05, 0, 0]))
    np.testing.assert_allclose(rig["cam1"].project(POINTS), theirs[:, 0], atol=1e-9)


def test_the_third_camera_is_placed_by_the_second(tmp_path: Path) -> None:
    third = CHAIN[CHAIN.index("cam1:") :].replace("cam1", "cam2")
    rig = read_kalibr_yaml(write(tmp_path, CHAIN + third))
    step = rig["cam1"].camera_from_world.matrix
    np.testing.assert_allclose(rig["cam2"].camera_from_world.matrix, step @ step, atol=1e-9)


@pytest.mark.parametrize("k", [[], [0.1, -0.2, 1e-4, 1 / 3000, 0.0]])
def test_what_is_written_reads_back_in_its_own_world(tmp_path: Path, k: list[float]) -> None:
    cameras = {name: camera(k, seed) for seed, name in enumerate(("left", 'a "b"', "cam0"))}

    write_kalibr_yaml(tmp_path / "a.yaml", Rig(cameras))
    found = read_kalibr_yaml(tmp_path / "a.yaml")

    assert found.names == tuple(cameras)
    for name, mine in cameras.items():
        again = found[name]
        assert again.image_size == mine.image_size
        np.testing.assert_array_equal(again.matrix, mine.matrix)
        np.testing.assert_array_equal(again.distortion, k or np.zeros(5))
        here, there = mine.camera_from_world.matrix, again.camera_from_world.matrix
        np.testing.assert_allclose(there, here, atol=1e-11)


def test_another_yaml_reader_finds_kalibrs_keys_in_metres(tmp_path: Path) -> None:
    yaml = pytest.importorskip("yaml", reason="PyYAML, which Kalibr reads with, is not installed")
    cameras = [camera([0.1, -0.2, 1e-4, 2e-4, 0.0], seed) for seed in (0, 1)]

    write_kalibr_yaml(tmp_path / "a.yaml", Rig({"left": cameras[0], "right": cameras[1]}))
    found = yaml.safe_load((tmp_path / "a.yaml").read_text())

    assert list(found) == ["cam0", "cam1"]
    assert found["cam1"]["camera_model"] == "pinhole"
    assert found["cam1"]["distortion_model"] == "radtan"
    assert found["cam1"]["distortion_coeffs"] == [0.1, -0.2, 1e-4, 2e-4]
    assert found["cam1"]["resolution"] == [640, 480]
    assert found["cam1"]["intrinsics"] == [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    T = np.array(found["cam1"]["T_cn_cnm1"])
    apart_mm = np.linalg.norm(cameras[0].position - cameras[1].position)
    assert np.linalg.norm(T[:3, 3]) * 1000 == pytest.approx(apart_mm)


def test_the_first_camera_as_world_needs_no_key_of_ours(tmp_path: Path) -> None:
    rig = read_kalibr_yaml(write(tmp_path, CHAIN))
    write_kalibr_yaml(tmp_path / "again.yaml", rig)
    assert "T_c0_world" not in (tmp_path / "again.yaml").read_text()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("cam1:\n", "cam2:\n", "expected cam0, cam1, ... without gaps, found cam0, cam2"),
        (CHAIN, "x: 1\n", "expected cam0, cam1, ... without gaps"),
        (CHAIN, "cam0: 3\n", "cam0: expected keys and values, found 3"),
        ("pinhole", "omni", "cam0, camera_model: expected pinhole, found 'omni'"),
        ("radtan", "equidistant", "cam0, distortion_model: expected radtan or none, found 'equi"),
        ("0.07, 0.0002, 1.8e-05", "0.07", "cam0, distortion_coeffs: expected 4 numbers, found 2"),
        ("458.65,", "0,", "cam0, intrinsics: expected focal lengths above 0"),
        ("458.65,", ".nan,", "cam0, intrinsics: expected finite numbers"),
        ("458.65,", "", "cam0, intrinsics: expected 4 numbers, found 3"),
        ("752,", "752.5,", "cam0, resolution: expected width and height in whole pixels"),
        ("T_cn_cnm1", "T_cam_imu", "cam1, T_cn_cnm1: expected 4 rows of 4 numbers, found nothing"),
        ("  - [0.0, 1.0, 0.0, 0.0]\n", "", "expected 4 rows of 4 numbers, found 3 rows"),
        ("[0.0, 1.0, 0.0, 0.0]", "[0.0, 1.0, 0.0]", "row 1: expected 4 numbers, found 3"),
        ("[0.0, 1.0, 0.0, 0.0]", "[0.0, -1.0, 0.0, 0.0]", "cam1, T_cn_cnm1: expected a rotation"),
        ("[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0, 2.0]", "row 3: expected 0, 0, 0, 1"),
        ("  rostopic: /cam1/", "  name: cam0\n  x: ", "cam1, name: expected a name not used"),
    ],
)
def test_bad_contents_are_one_clear_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in CHAIN
    with pytest.raises(FileFormatError) as error:
        read_kalibr_yaml(write(tmp_path, CHAIN.replace(old, new, 1)))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("mine", "message"),
    [
        (Camera((9, 9), K, Rigid.identity(), "tsai", np.array([0.1])), "distortion is Tsai's"),
        (camera([0.1, 0, 0, 0, 0.01]), "coefficient 5 is not 0"),
        (camera([0.1, *[0] * 10, 0.01]), "coefficient 12 is not 0"),
        (Camera((9, 9), K + [[0, 1.5, 0], [0] * 3, [0] * 3]), "a skew of 1.5 px"),
    ],
)
def test_what_kalibr_cannot_hold_is_refused_and_nothing_is_written(
    tmp_path: Path, mine: Camera, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        write_kalibr_yaml(tmp_path / "a.yaml", Rig({"good": camera([]), "bad": mine}))
    assert not list(tmp_path.iterdir())
