"""Cameras as OpenCV's FileStorage and ROS write them: ``.yml``, ``.yaml``.

Three layouts are read (and letters' case does not matter):

- one camera: ``image_width``, ``image_height``, ``camera_matrix``, ``distortion_coefficients``
  (4, 5, 8, 12 or 14 numbers, of which the last two, a tilted sensor, must be 0) and perhaps
  ``rotation`` (3x3, or a rotation vector) and ``translation``, x_camera = R x_world + t;
- a rig: ``cameras``, a list of such mappings, each with ``name`` and pose. That is our own layout
  of several cameras: OpenCV has none;
- a stereo pair: ``K1`` (``M1``, ``cameraMatrix1``), ``D1`` (``distCoeffs1``), the same with 2, and
  ``R``, ``T`` of ``stereoCalibrate``: x_2 = R x_1 + T. The first camera is the world.

The files name no unit of length; it is the board's. It is taken to be the millimetre unless told.
Pixels are counted as ours: (0, 0) is the centre of the top-left pixel.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from ..errors import FileFormatError
from ..files import atomic_write
from ..rig import Rig
from ..rigid import Rigid
from .camera_values import (
    checked_matrix,
    checked_numbers,
    checked_pose,
    checked_size,
    opencv_coefficients,
    show,
)
from .yaml_subset import read_yaml

_MATRIX = ("camera_matrix", "cameramatrix", "intrinsic_matrix", "k", "m", "mtx")
_DISTORTION = ("distortion_coefficients", "distcoeffs", "dist_coeffs", "dist", "d")
_WIDTH = ("image_width", "width")
_HEIGHT = ("image_height", "height")
_SIZE = ("image_size", "imagesize")
_ROTATION = ("rotation", "rotation_matrix", "rvec", "r")
_TRANSLATION = ("translation", "tvec", "t")
_NAME = ("name", "camera_name")
_NUMBERED = re.compile(rf"({'|'.join(_MATRIX)})_?(\d{{1,3}})")
#: What ROS calls the models that are OpenCV's.
_ROS_MODELS = ("plumb_bob", "rational_polynomial", "opencv", "radtan", "none")
_COUNTS = (0, 4, 5, 8, 12, 14)


def read_opencv_yaml(path: Path, *, mm_per_unit: float = 1.0) -> Rig:
    """Read one camera, a rig or a stereo pair.

    Parameters
    ----------
    path : Path
    mm_per_unit : float
        Millimetres in the file's unit of length: 1000 for poses in metres.

    Raises
    ------
    FileFormatError
        ``camera.yml, camera_matrix: expected 9 numbers, found 8``; also for models that are not
        ours: fisheye, a tilted sensor, skew.
    OSError
        If the file cannot be read.
    """
    document = read_yaml(path)
    if not isinstance(document, dict):
        raise FileFormatError(path, "file", "camera_matrix and image_width", show(document))
    keys = _lower_keys(path, "", document)
    if "cameras" in keys:
        return _rig(path, keys["cameras"], mm_per_unit)
    numbered = sorted({int(match[2]) for key in keys if (match := _NUMBERED.fullmatch(key))})
    if numbered:
        return _stereo_pair(path, keys, numbered, mm_per_unit)
    name = _pick(path, "", keys, _NAME)
    camera = _camera(path, "", keys, mm_per_unit, may_lack_pose=True)
    return Rig({path.stem if name is None else str(name): camera})


def write_opencv_yaml(path: Path, rig: Rig) -> None:
    """Write a rig: one camera as OpenCV's own tools do, several as the list ``cameras``.

    Lengths are millimetres. All digits are kept; a camera without distortion gets five zeros, as
    OpenCV's functions like them, and reads back with those.

    Raises
    ------
    InputError
        If a camera has Tsai's distortion or skew, of which OpenCV's functions know nothing.
    """
    blocks = {name: _camera_lines(path, name, camera) for name, camera in rig.cameras.items()}
    lines = ["%YAML:1.0", "---"]
    if len(rig) == 1:
        (block,) = blocks.values()
        lines += block
    else:
        lines += ['length_unit: "mm"', "cameras:"]
        for block in blocks.values():
            lines += ["   -", *(f"      {line}" for line in block)]
    with atomic_write(path) as stream:
        stream.write("\n".join(lines) + "\n")


def _camera_lines(path: Path, name: str, camera: Camera) -> list[str]:
    k = opencv_coefficients(path, name, camera, "OpenCV's YAML")
    pose = camera.camera_from_world
    return [
        f"name: {json.dumps(name, ensure_ascii=False)}",
        f"image_width: {camera.image_size[0]}",
        f"image_height: {camera.image_size[1]}",
        *_matrix_lines("camera_matrix", camera.matrix),
        *_matrix_lines("distortion_coefficients", k[None, : max(5, len(camera.distortion))]),
        *_matrix_lines("rotation", pose.rotation),
        *_matrix_lines("translation", pose.translation[:, None]),
    ]


def _matrix_lines(key: str, values: NDArray[np.float64]) -> list[str]:
    rows = [", ".join(map(repr, row)) for row in values.tolist()]
    between = ",\n       "  # OpenCV refuses a continuation that is indented less than its key
    return [
        f"{key}: !!opencv-matrix",
        f"   rows: {values.shape[0]}",
        f"   cols: {values.shape[1]}",
        "   dt: d",
        *f"   data: [ {between.join(rows)} ]".split("\n"),
    ]


# Reading ------------------------------------------------------------------------------------


def _lower_keys(path: Path, where: str, entry: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in entry.items():
        if key.lower() in found and key.lower() in (*_MATRIX, *_DISTORTION, *_ROTATION):
            raise FileFormatError(path, _in(where, key), "a key not used before", key)
        found.setdefault(key.lower(), value)
    return found


def _in(where: str, key: str) -> str:
    return f"{where}, {key}" if where else key


def _pick(path: Path, where: str, keys: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    """The value of the one of these keys that is there; None without any."""
    there = [name for name in names if keys.get(name) is not None]
    if len(there) > 1:
        raise FileFormatError(path, where or "file", "one of these keys", " and ".join(there))
    return keys[there[0]] if there else None


def _rig(path: Path, entries: Any, mm_per_unit: float) -> Rig:
    if not isinstance(entries, list) or not entries:
        raise FileFormatError(path, "cameras", "a list of at least one camera", show(entries))
    cameras: dict[str, Camera] = {}
    for number, entry in enumerate(entries):
        where = f"cameras[{number}]"
        if not isinstance(entry, dict):
            raise FileFormatError(path, where, "keys and values", show(entry))
        keys = _lower_keys(path, where, entry)
        name = _pick(path, where, keys, _NAME)
        name = f"cam{number}" if name is None else str(name)
        if name in cameras:
            raise FileFormatError(path, where, "a name not used before", name)
        where = f'camera "{name}"'
        alone = len(entries) == 1
        cameras[name] = _camera(path, where, keys, mm_per_unit, may_lack_pose=alone)
    return Rig(cameras)


def _stereo_pair(
    path: Path, keys: Mapping[str, Any], numbers: list[int], mm_per_unit: float
) -> Rig:
    if len(numbers) != 2:
        found = ", ".join(map(str, numbers))
        raise FileFormatError(path, "file", "two numbered cameras with R and T", f"only {found}")
    if _pick(path, "", keys, _ROTATION) is None or _pick(path, "", keys, _TRANSLATION) is None:
        expected = "R and T of stereoCalibrate (where they are in extrinsics.yml: add them)"
        raise FileFormatError(path, "file", expected, "no pose of the second camera")
    shared = {key: keys[key] for key in (*_WIDTH, *_HEIGHT, *_SIZE) if key in keys}
    cameras: dict[str, Camera] = {}
    for number in numbers:
        own = dict(shared)
        for names in (_MATRIX, _DISTORTION, _WIDTH, _HEIGHT, _SIZE):
            for name in names:
                for key in (f"{name}{number}", f"{name}_{number}"):
                    if key in keys:
                        own[name] = keys[key]
        is_second = number == numbers[1]
        if is_second:
            own |= {key: keys[key] for key in (*_ROTATION, *_TRANSLATION) if key in keys}
        where = f"camera {number}"
        cameras[f"cam{number}"] = _camera(
            path, where, own, mm_per_unit, may_lack_pose=not is_second
        )
    return Rig(cameras)


def _camera(
    path: Path, where: str, keys: Mapping[str, Any], mm_per_unit: float, *, may_lack_pose: bool
) -> Camera:
    K = _array(path, _in(where, "camera_matrix"), _pick(path, where, keys, _MATRIX), 9)
    if K[1] or K[3] or (K[6:] != (0, 0, 1)).any():
        expected = "[fx, 0, cx, 0, fy, cy, 0, 0, 1] (OpenCV's cameras have no skew)"
        raise FileFormatError(path, _in(where, "camera_matrix"), expected, show(K.tolist()))
    matrix = checked_matrix(path, _in(where, "camera_matrix"), K[0], K[4], K[2], K[5])
    size = _image_size(path, where, keys)
    k = _distortion(path, where, keys)
    pose = _pose(path, where, keys, mm_per_unit, may_lack=may_lack_pose)
    return Camera(size, matrix, pose, "opencv" if len(k) else "none", k)


def _image_size(path: Path, where: str, keys: Mapping[str, Any]) -> tuple[int, int]:
    pair = _pick(path, where, keys, _SIZE)
    if pair is not None:
        width, height = _array(path, _in(where, "image_size"), pair, 2)
        return checked_size(path, _in(where, "image_size"), float(width), float(height))
    width = _pick(path, where, keys, _WIDTH)
    height = _pick(path, where, keys, _HEIGHT)
    if width is None or height is None:
        expected = "the pictures' size (add the lines image_width: and image_height:)"
        raise FileFormatError(path, where or "file", expected, "none")
    return checked_size(path, _in(where, "image_width, image_height"), width, height)


def _distortion(path: Path, where: str, keys: Mapping[str, Any]) -> NDArray[np.float64]:
    """(0, 5, 8 or 12) float64 in OpenCV's order."""
    model = keys.get("distortion_model")
    if keys.get("fisheye_model") or (model is not None and model not in _ROS_MODELS):
        expected = "OpenCV's pinhole model (plumb_bob, rational_polynomial)"
        found = "a fisheye model" if keys.get("fisheye_model") else show(model)
        raise FileFormatError(path, _in(where, "distortion_model"), expected, found)
    value = _pick(path, where, keys, _DISTORTION)
    if value is None:
        return np.zeros(0)
    where = _in(where, "distortion_coefficients")
    k = _array(path, where, value, None)
    if len(k) not in _COUNTS:
        expected = f"{' or '.join(map(str, _COUNTS[1:]))} numbers"
        raise FileFormatError(path, where, expected, str(len(k)))
    if k[12:].any():
        expected = "no tilted sensor (numbers 13 and 14 are 0)"
        raise FileFormatError(path, where, expected, show(k[12:].tolist()))
    return np.append(k, 0.0) if len(k) == 4 else k[:12]


def _pose(
    path: Path, where: str, keys: Mapping[str, Any], mm_per_unit: float, *, may_lack: bool
) -> Rigid:
    turn = _pick(path, where, keys, _ROTATION)
    shift = _pick(path, where, keys, _TRANSLATION)
    if may_lack and turn is None and shift is None:
        return Rigid.identity()
    t = _array(path, _in(where, "translation"), shift, 3) * mm_per_unit
    where = _in(where, "rotation")
    values = _array(path, where, turn, None)
    if len(values) == 3:
        from scipy.spatial.transform import Rotation

        return Rigid.from_rotation(Rotation.from_rotvec(values).as_matrix(), t)
    if len(values) != 9:
        expected = "9 numbers (a matrix) or 3 (a rotation vector)"
        raise FileFormatError(path, where, expected, str(len(values)))
    return checked_pose(path, where, values.reshape(3, 3), t)


def _array(path: Path, where: str, value: Any, count: int | None) -> NDArray[np.float64]:
    """The numbers of a matrix, row by row, however it is written: a matrix, lists, rows."""
    expected = "a matrix" if count is None else f"a matrix of {count} numbers"
    if isinstance(value, dict):
        numbers = checked_numbers(path, _in(where, "data"), value.get("data"), count)
        rows, cols = value.get("rows"), value.get("cols")
        sizes = (rows, cols) if rows is not None and cols is not None else value.get("sizes")
        if sizes is not None and not _is_shape_of(sizes, len(numbers)):
            expected = f"rows and cols of {len(numbers)} numbers"
            raise FileFormatError(path, where, expected, show(sizes))
        if count == 9 and sizes is not None and list(sizes) != [3, 3]:
            raise FileFormatError(path, where, "3 rows and 3 cols", show(sizes))
        return numbers
    if not isinstance(value, list):
        raise FileFormatError(path, where, expected, show(value))
    if value and all(isinstance(row, list) for row in value):
        if len({len(row) for row in value}) != 1:
            raise FileFormatError(path, where, "rows of one length", show(value))
        if count == 9 and len(value) != 3:
            raise FileFormatError(path, where, "3 rows of 3 numbers", f"{len(value)} rows")
        value = [number for row in value for number in row]
    return checked_numbers(path, where, value, count)


def _is_shape_of(sizes: Any, count: int) -> bool:
    if not isinstance(sizes, list | tuple):
        return False
    if any(not isinstance(n, int) or isinstance(n, bool) or n < 0 for n in sizes):
        return False
    product = 1
    for n in sizes:
        product *= n
    return product == count
