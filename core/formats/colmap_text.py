"""COLMAP's text model: a folder with ``cameras.txt``, ``images.txt`` and ``points3D.txt``.

``cameras.txt`` holds lenses: ``CAMERA_ID MODEL WIDTH HEIGHT PARAMS...``; ``images.txt`` two lines
a picture: ``IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`` with x_camera = R x_world + t, and its
points, which are not read. Every picture becomes a camera of the rig, named after it (without
.jpg or .png where that leaves names unique).

COLMAP counts pixels from the *corner* of the top-left pixel, we from its centre: half a pixel is
added to the principal point on writing and taken off on reading. Its worlds have any scale: ours
are written in mm (as a comment says), and read as mm unless told otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path, PurePosixPath
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from ..errors import FileFormatError, InputError
from ..files import atomic_write
from ..rig import Rig
from ..rigid import Rigid
from .camera_values import checked_matrix, checked_numbers, checked_size, opencv_coefficients

#: Between the centre of the top-left pixel (ours) and its corner (COLMAP's), px.
HALF_PIXEL = 0.5
#: COLMAP's models that are ours: how many focal lengths, and where in OpenCV's order
#: (k1 k2 p1 p2 k3 k4 k5 k6) each of the numbers behind cx, cy belongs.
_MODELS: dict[str, tuple[int, tuple[int, ...]]] = {
    "SIMPLE_PINHOLE": (1, ()),
    "PINHOLE": (2, ()),
    "SIMPLE_RADIAL": (1, (0,)),
    "RADIAL": (1, (0, 1)),
    "OPENCV": (2, (0, 1, 2, 3)),
    "FULL_OPENCV": (2, (0, 1, 2, 3, 4, 5, 6, 7)),
}
_PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp")
_MAX_LINE = 64 * 1024 * 1024  # the points of one picture
_MAX_CAMERAS = 100_000
_UNIT_WITHIN = 1e-2  # a quaternion's length: typed with two digits it is put right
#: Files of a COLMAP model that would contradict what is written beside them.
_OTHERS = ("rigs.txt", "frames.txt", "cameras.bin", "images.bin", "rigs.bin", "frames.bin")


def read_colmap_text(path: Path, *, mm_per_unit: float = 1.0) -> Rig:
    """Read the cameras of a model.

    Parameters
    ----------
    path : Path
        The model's folder, or one of its files.
    mm_per_unit : float
        Millimetres in the model's unit of length.

    Raises
    ------
    FileFormatError
        ``cameras.txt, line 4: expected 8 numbers for OPENCV, found 7``; also for models that are
        not ours: fisheye, division, ...
    InputError
        If the folder holds no text model.
    OSError
        If a file cannot be read.
    """
    folder = path if path.is_dir() else path.parent
    cameras = folder / "cameras.txt"
    if not cameras.is_file():
        if (folder / "cameras.bin").is_file():
            raise InputError(
                f"{folder} holds a binary COLMAP model: convert it with "
                "colmap model_converter --output_type TXT"
            )
        raise InputError(f"{folder} holds no cameras.txt: expected COLMAP's text model")
    lenses = _read_lenses(cameras)
    images = folder / "images.txt"
    if images.is_file():
        return _rig(images, lenses, mm_per_unit)
    if len(lenses) > 1:
        raise InputError(f"{folder} holds no images.txt: the poses of {len(lenses)} cameras")
    return Rig({f"cam{number}": lens for number, lens in lenses.items()})


def write_colmap_text(folder: Path, rig: Rig) -> None:
    """Write a rig as a model without points: one lens and one picture a camera.

    All digits are kept; x_camera = R x_world + t in mm. The folder is made if need be.

    Raises
    ------
    InputError
        If a camera cannot be held (Tsai's distortion, thin-prism coefficients, skew, a name with
        blanks), or if the folder holds another model's points or rigs.
    """
    lines = [
        (_lens_line(folder, n, name, camera), _image_line(folder, n, name, camera))
        for n, (name, camera) in enumerate(rig.cameras.items(), 1)
    ]
    _refuse_another_model(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:  # all three appear, or none does
        streams = [
            stack.enter_context(atomic_write(folder / f"{name}.txt"))
            for name in ("cameras", "images", "points3D")
        ]
        streams[0].write("# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n")
        streams[0].write("# pixels from the corner of the top-left pixel\n")
        streams[1].write("# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME\n")
        streams[1].write("# POINTS2D[] as X Y POINT3D_ID (none here)\n")
        streams[1].write("# camera from world, millimetres\n")
        streams[2].write("# no points\n")
        for lens, image in lines:
            streams[0].write(f"{lens}\n")
            streams[1].write(f"{image}\n\n")


def _lens_line(path: Path, number: int, name: str, camera: Camera) -> str:
    k = opencv_coefficients(path, name, camera, "COLMAP's model")
    if k[8:].any():
        raise InputError(
            f'{path}: COLMAP\'s model cannot hold camera "{name}": it has thin-prism coefficients '
            "(s1 to s4); write rig.json or OpenCV YAML"
        )
    model = "FULL_OPENCV" if k[4:].any() else "OPENCV" if k.any() else "PINHOLE"
    K = camera.matrix
    values = [K[0, 0], K[1, 1], K[0, 2] + HALF_PIXEL, K[1, 2] + HALF_PIXEL, *k[list(_slots(model))]]
    width, height = camera.image_size
    return f"{number} {model} {width} {height} {_text(values)}"


def _image_line(path: Path, number: int, name: str, camera: Camera) -> str:
    if not name or any(c.isspace() or not c.isprintable() for c in name):
        raise InputError(f'{path}: COLMAP takes names without blanks: rename camera "{name}"')
    pose = camera.camera_from_world
    return f"{number} {_text([*pose.quaternion, *pose.translation])} {number} {name}"


def _text(values: list[np.float64]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _slots(model: str) -> tuple[int, ...]:
    return _MODELS[model][1]


def _refuse_another_model(folder: Path) -> None:
    for name in _OTHERS:
        if (folder / name).exists():
            raise InputError(f"{folder} holds another COLMAP model ({name}): name an empty folder")
    points = folder / "points3D.txt"
    if points.is_file() and next(_data_lines(points), None) is not None:
        raise InputError(f"{folder} holds a COLMAP model with points: name an empty folder")


# Reading ------------------------------------------------------------------------------------


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, one at a time: ``images.txt`` may be of any length."""
    with open(path, encoding="utf-8", errors="replace") as stream:
        number = 0
        while line := _line(path, number + 1, stream):
            number += 1
            yield number, line.strip()


def _line(path: Path, number: int, stream: TextIO) -> str:
    line = stream.readline(_MAX_LINE)
    if len(line) == _MAX_LINE:
        raise FileFormatError(path, f"line {number}", "a line of text", "one without an end")
    return line


def _data_lines(path: Path) -> Iterator[tuple[int, str]]:
    return ((n, line) for n, line in _lines(path) if line and not line.startswith("#"))


def _numbers(path: Path, where: str, words: list[str]) -> NDArray[np.float64]:
    found: list[float] = []
    for word in words:
        try:
            found.append(float(word))
        except ValueError:
            raise FileFormatError(path, where, "a number", repr(word[:40])) from None
    return checked_numbers(path, where, found, len(found))


def _id(path: Path, where: str, word: str) -> int:
    if not (word.isascii() and word.isdigit() and len(word) < 12):
        raise FileFormatError(path, where, "an ID (a whole number)", repr(word[:40]))
    return int(word)


def _read_lenses(path: Path) -> dict[int, Camera]:
    found: dict[int, Camera] = {}
    for number, line in _data_lines(path):
        where = f"line {number}"
        words = line.split()
        if len(words) < 5:
            expected = "CAMERA_ID MODEL WIDTH HEIGHT PARAMS"
            raise FileFormatError(path, where, expected, f"{len(words)} words")
        key = _id(path, where, words[0])
        if key in found:
            raise FileFormatError(path, where, "a camera ID not used before", words[0])
        if len(found) == _MAX_CAMERAS:
            raise FileFormatError(path, where, f"at most {_MAX_CAMERAS} cameras", "more")
        found[key] = _lens(path, where, words)
    if not found:
        raise FileFormatError(path, "file", "at least one camera", "none")
    return found


def _lens(path: Path, where: str, words: list[str]) -> Camera:
    model = words[1]
    if model not in _MODELS:
        known = ", ".join(_MODELS)
        raise FileFormatError(path, where, f"a model that we know ({known})", repr(model[:40]))
    n_focal, slots = _MODELS[model]
    values = _numbers(path, where, words[4:])
    count = n_focal + 2 + len(slots)
    if len(values) != count:
        raise FileFormatError(path, where, f"{count} numbers for {model}", str(len(values)))
    width, height = _numbers(path, where, words[2:4])
    size = checked_size(path, where, float(width), float(height))
    cx, cy = values[n_focal : n_focal + 2] - HALF_PIXEL
    matrix = checked_matrix(path, where, values[0], values[n_focal - 1], cx, cy)
    if not slots:
        return Camera(size, matrix)
    k = np.zeros(8)
    k[list(slots)] = values[n_focal + 2 :]
    return Camera(size, matrix, Rigid.identity(), "opencv", k if k[5:].any() else k[:5])


def _rig(path: Path, lenses: dict[int, Camera], mm_per_unit: float) -> Rig:
    cameras: dict[str, Camera] = {}
    lines = _lines(path)
    for number, line in lines:
        if not line or line.startswith("#"):
            continue
        where = f"line {number}"
        name, camera = _picture(path, where, line, lenses, mm_per_unit)
        if name in cameras:
            raise FileFormatError(path, where, "a picture not named before", name)
        if len(cameras) == _MAX_CAMERAS:
            raise FileFormatError(path, where, f"at most {_MAX_CAMERAS} pictures", "more")
        cameras[name] = camera
        _skip_points(path, lines)
    if not cameras:
        raise FileFormatError(path, "file", "at least one picture", "none")
    stems = [_stem(name) for name in cameras]
    names = stems if len(set(stems)) == len(stems) else list(cameras)
    return Rig(dict(zip(names, cameras.values(), strict=True)))


def _skip_points(path: Path, lines: Iterator[tuple[int, str]]) -> None:
    """Pass over the line of points, which may be empty but must be there."""
    number, line = next(lines, (0, ""))
    # X Y POINT3D_ID; ten words are a picture: someone took the empty lines out
    if len(line.split()) % 3:
        expected = "a picture's points, X Y POINT3D_ID each, or an empty line"
        raise FileFormatError(path, f"line {number}", expected, repr(line[:40]))


def _stem(name: str) -> str:
    return (
        name[: -len(suffix)]
        if (suffix := PurePosixPath(name).suffix).lower() in _PICTURES
        else name
    )


def _picture(
    path: Path, where: str, line: str, lenses: dict[int, Camera], mm_per_unit: float
) -> tuple[str, Camera]:
    words = line.split(maxsplit=9)
    if len(words) != 10:
        expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
        raise FileFormatError(path, where, expected, f"{len(words)} words")
    _id(path, where, words[0])
    values = _numbers(path, where, words[1:8])
    length = float(np.linalg.norm(values[:4]))
    if abs(length - 1) > _UNIT_WITHIN:
        raise FileFormatError(path, where, "a unit quaternion", f"one of length {length:.4g}")
    lens = lenses.get(_id(path, where, words[8]))
    if lens is None:
        raise FileFormatError(path, where, "a camera ID of cameras.txt", words[8])
    pose = Rigid(values[:4], values[4:] * mm_per_unit)
    return words[9], Camera(
        lens.image_size, lens.matrix, pose, lens.distortion_model, lens.distortion
    )
