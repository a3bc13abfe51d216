"""COLMAP's text model, against pycolmap in both directions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from facewright.core.camera import Camera
from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.colmap_text import read_colmap_text, write_colmap_text
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
    [0.1, -0.2, 1e-4, 1 / 3000, 0.0],
    [0.1, -0.2, 1e-4, 1 / 3000, 0.05],
    [*np.linspace(-0.03, 0.02, 8).tolist()],
]


@pytest.fixture
def pycolmap() -> Any:
    """The peer."""
    return pytest.importorskip("pycolmap", reason="pycolmap, the peer, is not installed")


def pixels_by_colmap(image: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Where COLMAP puts POINTS, in its own pixels."""
    return np.array([image.project_point(point) for point in POINTS])


@pytest.mark.parametrize("k", COEFFICIENTS, ids=["PINHOLE", "OPENCV", "FULL_OPENCV", "rational"])
def test_colmap_reads_what_we_write_half_a_pixel_on(
    tmp_path: Path, pycolmap: Any, k: list[float]
) -> None:
    cameras = {name: camera(k, seed) for seed, name in enumerate(("left", "a/b.c", "ä"))}

    write_colmap_text(tmp_path / "model", Rig(cameras))
    model = pycolmap.Reconstruction(str(tmp_path / "model"))

    assert {image.name for image in model.images.values()} == set(cameras)
    for image in model.images.values():
        mine = cameras[image.name].project(POINTS)
        np.testing.assert_allclose(pixels_by_colmap(image), mine + 0.5, atol=1e-9)


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("SIMPLE_PINHOLE", [500, 320, 240]),
        ("PINHOLE", [500, 510, 320, 240]),
        ("SIMPLE_RADIAL", [500, 320, 240, -0.1]),
        ("RADIAL", [500, 320, 240, -0.1, 0.05]),
        ("OPENCV", [500, 510, 320, 240, -0.1, 0.05, 1e-3, 2e-3]),
        ("FULL_OPENCV", [500, 510, 320, 240, -0.1, 0.05, 1e-3, 2e-3, 0.01, 0.02, 0.03, 0.04]),
    ],
)
def test_we_read_what_colmap_writes(
    tmp_path: Path, pycolmap: Any, model: str, params: list[float]
) -> None:
    lens = pycolmap.Camera(model=model, width=640, height=480, params=params, camera_id=4)
    built = pycolmap.Reconstruction()
    built.add_camera_with_trivial_rig(lens)
    rng = np.random.default_rng(2)
    for number, name in enumerate(("a.JPG", "sub/b.png", "c"), 1):
        turn = np.array([*rng.normal(scale=0.1, size=3), 1.0])  # x y z w
        pose = pycolmap.Rigid3d(
            pycolmap.Rotation3d(turn / np.linalg.norm(turn)), rng.normal(size=3) * 50
        )
        image = pycolmap.Image(name=name, camera_id=4, image_id=number)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(rng.normal(size=2))] * number)
        built.add_image_with_trivial_frame(image, pose)
    built.write_text(str(tmp_path))

    rig = read_colmap_text(tmp_path)

    assert sorted(rig.names) == ["a", "c", "sub/b"]
    for image in built.images.values():
        mine = rig[image.name.removesuffix(".JPG").removesuffix(".png")].project(POINTS)
        np.testing.assert_allclose(pixels_by_colmap(image) - 0.5, mine, atol=1e-9)


@pytest.mark.parametrize("k", COEFFICIENTS, ids=["PINHOLE", "OPENCV", "FULL_OPENCV", "rational"])
def test_what_is_written_reads_back(tmp_path: Path, k: list[float]) -> None:
    cameras = {name: camera(k, seed) for seed, name in enumerate(("left", "right", "7"))}

    write_colmap_text(tmp_path, Rig(cameras))
    found = read_colmap_text(tmp_path / "images.txt")

    assert found.names == tuple(cameras)
    for name, mine in cameras.items():
        again = found[name]
        assert (again.image_size, again.distortion_model) == (SIZE, mine.distortion_model)
        np.testing.assert_allclose(again.matrix, mine.matrix, rtol=1e-15)
        np.testing.assert_array_equal(again.distortion, mine.distortion)
        here, there = mine.camera_from_world, again.camera_from_world
        np.testing.assert_array_equal(there.translation, here.translation)
        np.testing.assert_allclose(there.quaternion, here.quaternion, atol=1e-15)


LENSES = "# comment\n3 PINHOLE 640 480 500 510 320.5 240.5\n"
PICTURES = (
    "# comment\n\n1 1 0 0 0 0.5 0 1 3 a.jpg\n10 20 -1 30 40 7\n2 0 1 0 0 0 0 1 3 the b.png\n\n"
)


def model(folder: Path, lenses: str = LENSES, pictures: str | None = PICTURES) -> Path:
    (folder / "cameras.txt").write_text(lenses)
    if pictures is not None:
        (folder / "images.txt").write_text(pictures)
    return folder


def test_a_model_in_metres_with_points_and_blanks_in_names(tmp_path: Path) -> None:
    rig = read_colmap_text(model(tmp_path), mm_per_unit=1000)
    assert rig.names == ("a", "the b")
    np.testing.assert_array_equal(rig["a"].camera_from_world.translation, (500, 0, 1000))
    np.testing.assert_array_equal(rig["a"].matrix, [[500, 0, 320], [0, 510, 240], [0, 0, 1]])
    np.testing.assert_array_equal(rig["the b"].camera_from_world.rotation, np.diag([1, -1, -1]))


def test_names_that_differ_in_their_suffix_alone_keep_it(tmp_path: Path) -> None:
    rig = read_colmap_text(model(tmp_path, pictures=PICTURES.replace("the b.png", "a.png")))
    assert rig.names == ("a.jpg", "a.png")


def test_one_lens_without_pictures_is_a_camera_at_the_origin(tmp_path: Path) -> None:
    rig = read_colmap_text(model(tmp_path, pictures=None))
    assert rig.names == ("cam3",)
    assert rig["cam3"].camera_from_world == Rigid.identity()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("PINHOLE", "OPENCV_FISHEYE", "line 2: expected a model that we know (SIMPLE_PINHOLE,"),
        ("PINHOLE", "OPENCV", "line 2: expected 8 numbers for OPENCV, found 4"),
        ("500 510", "500 x", "line 2: expected a number, found 'x'"),
        ("500 510", "500 nan", "line 2: expected finite numbers"),
        ("500 510", "500 -3", "line 2: expected focal lengths above 0"),
        ("640", "0", "line 2: expected width and height"),
        ("640", "640.5", "line 2: expected width and height"),
        ("3 PINHOLE", "x PINHOLE", "line 2: expected an ID"),
        (LENSES, LENSES * 2, "line 4: expected a camera ID not used before, found 3"),
        (LENSES, "3 PINHOLE\n", "line 1: expected CAMERA_ID MODEL"),
        (LENSES, "# none\n", "expected at least one camera, found none"),
        (PICTURES, "# none\n", "expected at least one picture, found none"),
        ("1 1 0 0 0", "1 2 0 0 0", "line 3: expected a unit quaternion, found one of length 2"),
        ("1 1 0 0 0", "1 0 0 0 0", "line 3: expected a unit quaternion"),
        ("1 1 0 0 0", "1 inf 0 0 0", "line 3: expected finite numbers"),
        ("1 3 a.jpg", "1 4 a.jpg", "line 3: expected a camera ID of cameras.txt, found 4"),
        ("1 3 a.jpg", "1 3", "line 3: expected IMAGE_ID QW"),
        ("the b.png", "a.jpg", "line 5: expected a picture not named before, found a.jpg"),
        ("10 20 -1 30 40 7\n", "", "line 4: expected a picture's points"),
        ("10 20 -1 30 40 7\n", "10 20 -1 30\n", "line 4: expected a picture's points"),
    ],
)
def test_bad_contents_are_one_clear_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in LENSES + PICTURES
    model(tmp_path, LENSES.replace(old, new, 1), PICTURES.replace(old, new, 1))
    with pytest.raises(FileFormatError) as error:
        read_colmap_text(tmp_path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("contents", [b"", b"\0\xff" * 100, b"x" * 100_000])
def test_junk_is_an_error(tmp_path: Path, contents: bytes) -> None:
    for name in ("cameras.txt", "images.txt"):
        model(tmp_path)
        (tmp_path / name).write_bytes(contents)
        with pytest.raises(FileFormatError) as error:
            read_colmap_text(tmp_path)
        assert len(str(error.value)) < 400


def test_a_folder_without_a_text_model_says_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no cameras\.txt"):
        read_colmap_text(tmp_path)
    (tmp_path / "cameras.bin").touch()
    with pytest.raises(InputError, match="colmap model_converter --output_type TXT"):
        read_colmap_text(tmp_path)
    model(tmp_path, LENSES + "4 PINHOLE 640 480 500 510 320.5 240.5\n", None)
    with pytest.raises(InputError, match=r"holds no images\.txt"):
        read_colmap_text(tmp_path)


@pytest.mark.parametrize(
    ("name", "mine", "message"),
    [
        ("a", Camera(SIZE, K, Rigid.identity(), "tsai", np.array([0.1])), "distortion is Tsai's"),
        ("a", camera(np.linspace(-0.01, 0.02, 12).tolist()), "thin-prism"),
        ("a", Camera(SIZE, K + [[0, 1.5, 0], [0] * 3, [0] * 3]), "a skew of 1.5 px"),
        ("a b", camera([]), "names without blanks"),
    ],
)
def test_what_colmap_cannot_hold_is_refused_and_nothing_is_written(
    tmp_path: Path, name: str, mine: Camera, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        write_colmap_text(tmp_path / "model", Rig({"good": camera([]), name: mine}))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "text"), [("rigs.txt", ""), ("points3D.txt", "# c\n1 0 0 0 9 9 9 0.1 1 0\n")]
)
def test_another_model_is_not_overwritten(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match="name an empty folder"):
        write_colmap_text(tmp_path, Rig({"a": camera([])}))
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == text
