"""``rig.json``: cameras of one world, version 1, also as written by hand.

A file holds ``version`` (1), ``units`` (``"mm"``, the default) and ``cameras``, a list of objects
with ``name``, ``image_size`` [width, height] in pixels, ``matrix`` (3x3), ``distortion`` (an
object of ``model`` and ``coefficients``; none if left out), and the pose ``rotation`` (3x3) and
``translation`` (mm) with x_camera = R x_world + t. The pose may be left out where the file holds
one camera: its frame is then the world. Other keys are ignored, unless they look like a
misspelling of one of these.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..camera import DISTORTION_MODELS, Camera
from ..errors import FileFormatError
from ..files import atomic_write, read_text
from ..rig import Rig
from ..rigid import Rigid

VERSION = 1
_MAX_BYTES = 16 * 1024 * 1024
_MAX_SIZE_PX = 100_000
#: Entries of R Rᵀ − I below this are rounding of a matrix typed by hand, and are put right.
_ORTHONORMAL_WITHIN = 1e-3
_FILE_KEYS = ("version", "units", "cameras")
_CAMERA_KEYS = ("name", "image_size", "matrix", "distortion", "rotation", "translation")
_DISTORTION_KEYS = ("model", "coefficients")


def read_rig(path: Path) -> Rig:
    """Read the cameras of a rig (or the one camera of a camera file).

    Raises
    ------
    FileFormatError
        ``rig.json, camera "cam0", matrix: expected 3 rows of 3 numbers, found 2 rows``; a syntax
        error names line and column.
    OSError
        If the file cannot be read.
    """
    document = _parse(path)
    where = "file"
    if not isinstance(document, dict):
        raise FileFormatError(path, where, "an object with version and cameras", _show(document))
    _refuse_misspelt(path, where, document, _FILE_KEYS)
    version = document.get("version")
    if version != VERSION or isinstance(version, bool):
        raise FileFormatError(path, "version", str(VERSION), _show(version))
    if document.get("units", "mm") != "mm":
        raise FileFormatError(path, "units", '"mm"', _show(document["units"]))
    entries = document.get("cameras")
    if not isinstance(entries, list) or not entries:
        raise FileFormatError(path, "cameras", "a list of at least one camera", _show(entries))
    cameras: dict[str, Camera] = {}
    for number, entry in enumerate(entries):
        name = _name(path, number, entry)
        if name in cameras:
            raise FileFormatError(
                path, f"cameras[{number}], name", "a name not used before", f'"{name}"'
            )
        cameras[name] = _camera(path, f'camera "{name}"', entry, is_alone=len(entries) == 1)
    return Rig(cameras)


def write_rig(path: Path, rig: Rig) -> None:
    """Write a rig; numbers keep all their digits, so that it reads back as it was.

    (Rotations are stored as matrices: the unit quaternion returns to within 1e-15.)
    """
    with atomic_write(path) as stream:
        stream.write(f'{{"version": {VERSION}, "units": "mm",\n "cameras": [')
        for number, (name, camera) in enumerate(rig.cameras.items()):
            stream.write(",\n  " if number else "\n  ")
            stream.write(",\n   ".join(_camera_lines(name, camera)))
        stream.write("]}\n")


def _camera_lines(name: str, camera: Camera) -> list[str]:
    pose = camera.camera_from_world
    distortion = {"model": camera.distortion_model, "coefficients": camera.distortion.tolist()}
    return [
        f'{{"name": {json.dumps(name)}, "image_size": {json.dumps(camera.image_size)}',
        f'"matrix": {json.dumps(camera.matrix.tolist())}',
        f'"distortion": {json.dumps(distortion)}',
        f'"rotation": {json.dumps(pose.rotation.tolist())}',
        f'"translation": {json.dumps(pose.translation.tolist())}}}',
    ]


class _Junk(ValueError):
    """Something JSON itself allows, or Python's reader does, but this format does not."""


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise _Junk(f"the key {_show(key)} twice in one object")
        found[key] = value
    return found


def _no_constant(text: str) -> NoReturn:
    raise _Junk(f"{text}, which is no number")


def _parse(path: Path) -> Any:
    text = read_text(path, _MAX_BYTES).removeprefix("\ufeff")
    try:
        return json.loads(text, parse_constant=_no_constant, object_pairs_hook=_unique_keys)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        found = _show(text[error.pos : error.pos + 20]) if text[error.pos :].strip() else "the end"
        raise FileFormatError(path, where, "valid JSON", f"{found} ({error.msg})") from error
    except _Junk as error:
        raise FileFormatError(path, "file", "plain JSON", str(error)) from error
    except RecursionError as error:
        raise FileFormatError(path, "file", "a flat document", "thousands of brackets") from error
    except ValueError as error:  # an integer of more digits than Python takes
        raise FileFormatError(path, "file", "numbers", str(error)) from error


def _show(value: Any) -> str:
    """A value as found in the file, short enough for a message."""
    if value is None:
        return "nothing"
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _refuse_misspelt(
    path: Path, where: str, entry: Mapping[str, Any], known: Collection[str]
) -> None:
    for key in entry:
        if key not in known:
            close = difflib.get_close_matches(key.lower(), known, n=1, cutoff=0.75)
            if close:
                raise FileFormatError(path, where, f'the key "{close[0]}"', _show(key))


def _name(path: Path, number: int, entry: Any) -> str:
    where = f"cameras[{number}]"
    if not isinstance(entry, dict):
        raise FileFormatError(path, where, "an object", _show(entry))
    name = entry.get("name")
    if not isinstance(name, str) or not name:
        raise FileFormatError(path, f"{where}, name", "a text in quotes", _show(name))
    return name


def _camera(path: Path, where: str, entry: dict[str, Any], *, is_alone: bool) -> Camera:
    _refuse_misspelt(path, where, entry, _CAMERA_KEYS)
    model, coefficients = _distortion(path, where, entry)
    return Camera(
        _image_size(path, where, entry),
        _matrix(path, where, entry),
        _pose(path, where, entry, may_lack=is_alone),
        model,
        coefficients,
    )


def _numbers(
    path: Path, where: str, value: Any, shape: tuple[int | None, ...]
) -> NDArray[np.float64]:
    """An array of `shape` (None: any length) from lists of finite numbers, or an error."""
    size = f"{shape[0]} numbers" if shape[0] is not None else "a list of numbers"
    expected = size if len(shape) == 1 else f"{shape[0]} rows of {shape[1]} numbers"
    if not isinstance(value, list):
        raise FileFormatError(path, where, expected, _show(value))
    if shape[0] is not None and len(value) != shape[0]:
        what = "rows" if len(shape) == 2 else "numbers"
        raise FileFormatError(path, where, expected, f"{len(value)} {what}")
    if len(shape) == 2:
        rows = [_numbers(path, f"{where}, row {n}", row, shape[1:]) for n, row in enumerate(value)]
        return np.array(rows)
    for item in value:
        is_number = isinstance(item, int | float) and not isinstance(item, bool)
        if not is_number or not abs(item) < 1e300:
            raise FileFormatError(path, where, "finite numbers", _show(item))
    return np.array(value, dtype=np.float64)


def _image_size(path: Path, where: str, entry: dict[str, Any]) -> tuple[int, int]:
    size = _numbers(path, f"{where}, image_size", entry.get("image_size"), (2,))
    if (size != np.round(size)).any() or (size < 1).any() or (size > _MAX_SIZE_PX).any():
        expected = f"[width, height], whole pixels, 1 to {_MAX_SIZE_PX}"
        found = _show(entry["image_size"])
        raise FileFormatError(path, f"{where}, image_size", expected, found)
    return int(size[0]), int(size[1])


def _matrix(path: Path, where: str, entry: dict[str, Any]) -> NDArray[np.float64]:
    K = _numbers(path, f"{where}, matrix", entry.get("matrix"), (3, 3))
    if K[0, 0] <= 0 or K[1, 1] <= 0 or K[1, 0] or (K[2] != (0, 0, 1)).any():
        expected = "[[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx and fy above 0"
        raise FileFormatError(path, f"{where}, matrix", expected, _show(entry["matrix"]))
    return K


def _distortion(path: Path, where: str, entry: dict[str, Any]) -> tuple[str, NDArray[np.float64]]:
    distortion = entry.get("distortion")
    if distortion is None:
        return "none", np.zeros(0)
    where = f"{where}, distortion"
    if not isinstance(distortion, dict):
        raise FileFormatError(
            path, where, "an object with model and coefficients", _show(distortion)
        )
    _refuse_misspelt(path, where, distortion, _DISTORTION_KEYS)
    model = distortion.get("model")
    if not isinstance(model, str) or model not in DISTORTION_MODELS:
        known = ", ".join(f'"{name}"' for name in DISTORTION_MODELS)
        raise FileFormatError(path, f"{where}, model", f"one of {known}", _show(model))
    given = distortion.get("coefficients", [])
    k = _numbers(path, f"{where}, coefficients", given, (None,))
    counts = DISTORTION_MODELS[model]
    if len(k) not in counts:
        expected = f'{" or ".join(map(str, counts))} numbers for the model "{model}"'
        raise FileFormatError(path, f"{where}, coefficients", expected, str(len(k)))
    return model, k


def _pose(path: Path, where: str, entry: dict[str, Any], *, may_lack: bool) -> Rigid:
    if may_lack and "rotation" not in entry and "translation" not in entry:
        return Rigid.identity()
    R = _numbers(path, f"{where}, rotation", entry.get("rotation"), (3, 3))
    t = _numbers(path, f"{where}, translation", entry.get("translation"), (3,))
    off = float(np.abs(R @ R.T - np.eye(3)).max()) if np.abs(R).max() < 2 else np.inf
    if off > _ORTHONORMAL_WITHIN:
        expected = f"a rotation matrix: orthonormal to within {_ORTHONORMAL_WITHIN:g}"
        raise FileFormatError(path, f"{where}, rotation", expected, f"one that is off by {off:.3g}")
    if np.linalg.det(R) < 0:
        expected = "a rotation matrix with determinant +1"
        raise FileFormatError(path, f"{where}, rotation", expected, "a mirror image, -1")
    u, _, vt = np.linalg.svd(R)  # the nearest rotation matrix
    return Rigid.from_rotation(u @ vt, t)
