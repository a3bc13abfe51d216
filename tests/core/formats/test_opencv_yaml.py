"""OpenCV YAML, against cv2.FileStorage in both directions."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from facewright.core.camera import Camera
from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.opencv_yaml import read_opencv_yaml, write_opencv_yaml
from facewright.core.rig import Rig
from facewright.core.rigid import Rigid

K = np.array([[1400 / 3, 0, 319.7], [0, 1500 / 7, 239.1], [0, 0, 1]])
SIZE = (640, 480)
POINTS = np.random.default_rng(1).uniform((-200, -200, 800), (200, 200, 1200), size=(20, 3))


def camera(k: list[float], seed: int = 3) -> Camera:
    """A camera that looks about along z, with all digits in use."""
    rng = np.random.default_rng(seed)
    pose = Rigid(np.array([1, *rng.normal(scale=0.1, size=3)]), rng.normal(size=3) * 100)
    return Camera(SIZE, K, pose, "opencv" if k else "none", np.array(k))


COEFFICIENTS = [
    [],
    [0.1, -0.2, 1e-4, 1 / 3000, 0.05],
    [*np.linspace(-0.03, 0.02, 8).tolist()],
    [*np.linspace(-0.01, 0.02, 12).tolist()],
]


@pytest.mark.parametrize("k", COEFFICIENTS, ids=lambda k: f"{len(k)} coefficients")
def test_opencv_reads_what_we_write(tmp_path: Path, k: list[float]) -> None:
    """And `projectPoints` with what it read puts points where our camera does."""
    mine = camera(k)
    path = tmp_path / "camera.yml"

    write_opencv_yaml(path, Rig({'the "odd" ä': mine}))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)

    assert storage.getNode("name").string() == 'the "odd" ä'
    size = [int(storage.getNode(f"image_{side}").real()) for side in ("width", "height")]
    assert size == [640, 480]
    matrix = storage.getNode("camera_matrix").mat()
    distortion = storage.getNode("distortion_coefficients").mat()
    R, t = storage.getNode("rotation").mat(), storage.getNode("translation").mat()
    np.testing.assert_array_equal(matrix, K)
    theirs, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(R)[0], t, matrix, distortion)
    np.testing.assert_allclose(theirs[:, 0], mine.project(POINTS), atol=1e-9)


@pytest.mark.parametrize("k", COEFFICIENTS[1:], ids=lambda k: f"{len(k)} coefficients")
def test_a_rig_reads_back_and_opencv_walks_through_it(tmp_path: Path, k: list[float]) -> None:
    cameras = {name: camera(k, seed) for seed, name in enumerate(("left", "a\nb", "7"))}
    path = tmp_path / "rig.yaml"

    write_opencv_yaml(path, Rig(cameras))
    found = read_opencv_yaml(path)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)

    assert found.names == tuple(cameras)
    nodes = storage.getNode("cameras")
    for number, (name, mine) in enumerate(cameras.items()):
        again, node = found[name], nodes.at(number)
        assert (again.image_size, again.distortion_model) == (SIZE, "opencv")
        np.testing.assert_array_equal(again.matrix, mine.matrix)
        np.testing.assert_array_equal(again.distortion, mine.distortion)
        here, there = mine.camera_from_world, again.camera_from_world
        np.testing.assert_array_equal(there.translation, here.translation)
        np.testing.assert_allclose(there.rotation, here.rotation, atol=1e-15)
        assert node.getNode("name").string() == name
        np.testing.assert_array_equal(node.getNode("rotation").mat(), here.rotation)


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_a_camera_that_opencv_wrote_projects_as_opencv_does(tmp_path: Path, count: int) -> None:
    path = tmp_path / "out_camera_data.yml"
    k = np.linspace(-0.02, 0.03, 14)[:count]
    k[12:] = 0
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Sun Nov 22 06:30:00 2026")
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", k[:, None])
    storage.write("avg_reprojection_error", 0.1957)
    storage.write("extrinsic_parameters", np.ones((3, 6)))
    storage.release()

    rig = read_opencv_yaml(path)

    assert rig.names == ("out_camera_data",)
    theirs, _ = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), K, k)
    np.testing.assert_allclose(rig["out_camera_data"].project(POINTS), theirs[:, 0], atol=1e-9)


@pytest.mark.parametrize("names", [("K", "D"), ("M", "D"), ("cameraMatrix", "distCoeffs")])
def test_a_stereo_pair_that_opencv_wrote(tmp_path: Path, names: tuple[str, str]) -> None:
    path = tmp_path / "stereo.yml"
    R, _ = cv2.Rodrigues(np.array([0.01, -0.2, 0.03]))
    T = np.array([[-83.2], [0.5], [1.5]])
    k = {1: np.array([[0.1, -0.1, 1e-3, 2e-3, 0.01]]), 2: np.array([[-0.2, 0.1, 0, 0, 0]])}
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_size", (640, 480))
    for number in (1, 2):
        storage.write(f"{names[0]}{number}", K + np.diag([number, 0, 0]))
        storage.write(f"{names[1]}{number}", k[number])
    storage.write("R", R)
    storage.write("T", T)
    storage.write("R1", np.eye(3) * 0.5)  # rectification: none of our business
    storage.release()

    rig = read_opencv_yaml(path)

    assert rig.names == ("cam1", "cam2")
    assert rig["cam1"].camera_from_world == Rigid.identity()
    turn, _ = cv2.Rodrigues(R)
    theirs, _ = cv2.projectPoints(POINTS, turn, T, K + np.diag([2.0, 0, 0]), k[2])
    np.testing.assert_allclose(rig["cam2"].project(POINTS), theirs[:, 0], atol=1e-9)
    assert np.linalg.norm(rig["cam2"].position) == pytest.approx(np.linalg.norm(T))


def test_a_camera_as_ros_writes_it(tmp_path: Path) -> None:
    path = tmp_path / "head_camera.yaml"
    path.write_text(
        "image_width: 640\nimage_height: 480\ncamera_name: head_camera\n"
        "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [500, 0, 320, 0, 510, 240, 0, 0, 1]\n"
        "distortion_model: plumb_bob\n"
        "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.1, -0.2, 0.001, 0.002, 0.0]\n"
        "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
    )

    mine = read_opencv_yaml(path)["head_camera"]

    np.testing.assert_array_equal(mine.matrix, [[500, 0, 320], [0, 510, 240], [0, 0, 1]])
    np.testing.assert_array_equal(mine.distortion, [0.1, -0.2, 0.001, 0.002, 0])


def test_a_rotation_vector_and_metres(tmp_path: Path) -> None:
    path = tmp_path / "camera.yml"
    path.write_text(
        "image_size: [640, 480]\nK: [[500, 0, 320], [0, 500, 240], [0, 0, 1]]\n"
        "rvec: [0.1, 0.2, 0.3]\ntvec: [0.5, 0.0, 1.0]\n"
    )

    pose = read_opencv_yaml(path, mm_per_unit=1000)["camera"].camera_from_world

    np.testing.assert_allclose(pose.rotation, cv2.Rodrigues(np.array([0.1, 0.2, 0.3]))[0])
    np.testing.assert_array_equal(pose.translation, (500, 0, 1000))


GOOD = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 320., 0., 500., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0.1, 0., 0., 0., 0. ]
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("image_width: 640\n", "", "add the lines image_width: and image_height:"),
        ("640", "0", "width and height in whole pixels"),
        ("640", "640.5", "width and height in whole pixels"),
        ("640", "1000000", "width and height in whole pixels"),
        ("500., 0., 320., 0.", "500., 0., 320.", "camera_matrix, data: expected 9 numbers, found"),
        ("500., 0., 320., 0.", "500., 3., 320., 0.", "have no skew"),
        ("500., 0., 320., 0.", "-500., 0., 320., 0.", "expected focal lengths above 0"),
        ("500., 0., 320., 0.", ".Nan, 0., 320., 0.", "expected finite numbers, found nan"),
        ("500., 0., 320., 0.", "1e400, 0., 320., 0.", "expected finite numbers, found inf"),
        ("500., 0., 320., 0.", "x, 0., 320., 0.", "expected finite numbers, found 'x'"),
        ("rows: 3", "rows: 9", "camera_matrix: expected rows and cols of 9 numbers"),
        ("   rows: 3\n   cols: 3", "   rows: 1\n   cols: 9", "expected 3 rows and 3 cols"),
        (
            "rows: 5\n   cols: 1\n   dt: d\n   data: [ 0.1, 0.,",
            "data: [ ",
            "4 or 5 or 8 or 12 or 14 numbers, found 3",
        ),
        ("   rows: 5", "   rows: 1000000000", "rows and cols of 5 numbers"),
        ("%YAML:1.0\n---\n", "fisheye_model: 1\n", "found a fisheye model"),
        ("%YAML:1.0\n---\n", "distortion_model: equidistant\n", "found 'equidistant'"),
        ("%YAML:1.0\n---\n", "rotation: [1, 2]\ntranslation: [0, 0, 0]\n", "9 numbers (a matrix)"),
        ("%YAML:1.0\n---\n", "rotation: [0, 0, 0]\n", "translation: expected a matrix of 3"),
        (
            "%YAML:1.0\n---\n",
            "R: [[1, 0, 0], [0, 1, 0], [0, 0, -1]]\nT: [0, 0, 0]\n",
            "a mirror image",
        ),
        ("%YAML:1.0\n---\n", "R: [[2, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: [0, 0, 0]\n", "orthonormal"),
        ("%YAML:1.0\n---\n", "K: [1]\n", "one of these keys, found camera_matrix and k"),
        ("%YAML:1.0\n---\n", "K1: [1]\n", "two numbered cameras with R and T, found only 1"),
        ("%YAML:1.0\n---\n", "K1: [1]\nK2: [1]\n", "R and T of stereoCalibrate"),
        ("%YAML:1.0\n---\n", "cameras: 3\n", "a list of at least one camera, found 3"),
        ("%YAML:1.0\n---\n", "cameras: [3]\n", "cameras[0]: expected keys and values"),
        ("camera_matrix", "something", "camera_matrix: expected a matrix of 9 numbers, found noth"),
    ],
)
def test_bad_contents_are_one_clear_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    path = tmp_path / "camera.yml"
    path.write_text(GOOD)
    read_opencv_yaml(path)
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(FileFormatError) as error:
        read_opencv_yaml(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_tilted_sensor_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.yml"
    tilted = GOOD.replace("rows: 5", "rows: 14").replace("[ 0.1,", "[ 0, 0, 0, 0, 0, 0, 0, 0, 0.1,")
    path.write_text(tilted.replace("0.1, 0., 0., 0., 0. ]", "0., 0., 0., 0., 0., 0.1 ]"))
    with pytest.raises(FileFormatError, match="no tilted sensor"):
        read_opencv_yaml(path)


def test_any_cut_is_an_error_or_a_whole_camera(tmp_path: Path) -> None:
    path = tmp_path / "camera.yml"
    write_opencv_yaml(path, Rig({"a": camera(COEFFICIENTS[1]), "b": camera(COEFFICIENTS[1], 4)}))
    text = path.read_text()
    for n in range(0, len(text) - 40, 7):  # the last number may lose digits and stay a number
        path.write_text(text[:n])
        with pytest.raises(FileFormatError):
            if len(read_opencv_yaml(path)) == 1:  # the first camera, whole: no error to see
                raise FileFormatError(path, "", "", "")


@pytest.mark.parametrize(
    ("mine", "message"),
    [
        (Camera(SIZE, K, Rigid.identity(), "tsai", np.array([0.1])), r"distortion is Tsai's"),
        (Camera(SIZE, K + [[0, 1.5, 0], [0] * 3, [0] * 3]), r"a skew of 1\.5 px; write rig\.json"),
    ],
)
def test_what_opencv_cannot_hold_is_refused_and_nothing_is_written(
    tmp_path: Path, mine: Camera, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        write_opencv_yaml(tmp_path / "a.yml", Rig({"good": camera([]), "bad": mine}))
    assert not list(tmp_path.iterdir())
