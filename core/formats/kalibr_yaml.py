"""Kalibr's ``camchain.yaml``: cam0, cam1, ..., each placed by the one before it.

Every camera has ``camera_model`` (pinhole), ``intrinsics`` [fx, fy, cx, cy], ``distortion_model``
(radtan or none), ``distortion_coeffs`` [k1, k2, p1, p2], ``resolution`` [width, height], and from
the second on ``T_cn_cnm1``, a 4x4 matrix: x_camera_n = T x_camera_(n-1). Lengths are metres in the
file, millimetres here. Pixels are counted as ours: (0, 0) is the centre of the top-left pixel.

Kalibr's world is cam0. So that a rig reads back as it was, two keys are written that Kalibr does
not know and ours reads: ``name``, and in cam0 ``T_c0_world`` where the world is not cam0.
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
from ..errors import FileFormatError, InputError
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

_MM = 1000.0
_CAMERA = re.compile(r"cam(\d{1,4})")


def read_kalibr_yaml(path: Path) -> Rig:
    """Read a chain of cameras.

    Raises
    ------
    FileFormatError
        ``camchain.yaml, cam1, T_cn_cnm1: expected 4 rows of 4 numbers, found 3 rows``; also for
        models that are not ours: omni, equidistant, ...
    OSError
        If the file cannot be read.
    """
    document = read_yaml(path)
    entries = document if isinstance(document, dict) else {}
    numbers = sorted(int(match[1]) for key in entries if (match := _CAMERA.fullmatch(key)))
    if numbers != list(range(len(numbers))) or not numbers:
        found = ", ".join(f"cam{n}" for n in numbers) or show(document)
        raise FileFormatError(path, "file", "cam0, cam1, ... without gaps", found)
    cameras: dict[str, Camera] = {}
    camera_from_world = Rigid.identity()
    for number in numbers:
        where = f"cam{number}"
        entry = entries.get(where)
        if not isinstance(entry, dict):
            raise FileFormatError(path, where, "keys and values", show(entry))
        step = _step(path, where, entry, is_first=number == 0)
        camera_from_world = step @ camera_from_world
        name = where if entry.get("name") is None else str(entry["name"])
        if name in cameras:
            raise FileFormatError(path, f"{where}, name", "a name not used before", name)
        cameras[name] = _camera(path, where, entry, camera_from_world)
    return Rig(cameras)


def write_kalibr_yaml(path: Path, rig: Rig) -> None:
    """Write a chain; poses read back to within rounding (about 1e-12 mm a link).

    Raises
    ------
    InputError
        If a camera's distortion is more than k1, k2, p1, p2 (Kalibr's radtan has no more), or
        Tsai's, or if it has skew.
    """
    lines: list[str] = []
    before = Rigid.identity()
    for number, (name, camera) in enumerate(rig.cameras.items()):
        lines += _camera_lines(path, number, name, camera, before)
        before = camera.camera_from_world
    with atomic_write(path) as stream:
        stream.write("\n".join(lines) + "\n")


def _camera_lines(path: Path, number: int, name: str, camera: Camera, before: Rigid) -> list[str]:
    k = opencv_coefficients(path, name, camera, "Kalibr's YAML")
    if k[4:].any():
        raise InputError(
            f'{path}: Kalibr\'s YAML cannot hold camera "{name}": radtan has k1, k2, p1 and p2 '
            f"alone, and coefficient {5 + int(np.flatnonzero(k[4:])[0])} is not 0; write rig.json, "
            "OpenCV YAML or COLMAP text, or calibrate with k3 fixed at 0"
        )
    K = camera.matrix
    step = camera.camera_from_world @ before.inverse()
    key = "T_cn_cnm1" if number else "T_c0_world"
    pose = _matrix_lines(key, step) if number or step != Rigid.identity() else []
    return [
        f"cam{number}:",
        *pose,
        "  camera_model: pinhole",
        f"  distortion_coeffs: {k[:4].tolist()}",
        "  distortion_model: radtan",
        f"  intrinsics: {[float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])]}",
        f"  name: {json.dumps(name, ensure_ascii=False)}",
        f"  resolution: {list(camera.image_size)}",
        f"  rostopic: /cam{number}/image_raw",
    ]


def _matrix_lines(key: str, pose: Rigid) -> list[str]:
    T = pose.matrix
    T[:3, 3] /= _MM
    return [f"  {key}:", *(f"  - {row}" for row in T.tolist())]


# Reading ------------------------------------------------------------------------------------


def _camera(path: Path, where: str, entry: Mapping[str, Any], pose: Rigid) -> Camera:
    model = entry.get("camera_model")
    if model != "pinhole":
        raise FileFormatError(path, f"{where}, camera_model", "pinhole", show(model))
    at = f"{where}, intrinsics"
    fx, fy, cx, cy = checked_numbers(path, at, entry.get("intrinsics"), 4)
    matrix = checked_matrix(path, at, fx, fy, cx, cy)
    at = f"{where}, resolution"
    width, height = checked_numbers(path, at, entry.get("resolution"), 2)
    size = checked_size(path, at, float(width), float(height))
    distortion = entry.get("distortion_model")
    if distortion in (None, "none"):
        return Camera(size, matrix, pose)
    if distortion != "radtan":
        at = f"{where}, distortion_model"
        raise FileFormatError(path, at, "radtan or none", show(distortion))
    at = f"{where}, distortion_coeffs"
    k = checked_numbers(path, at, entry.get("distortion_coeffs"), 4)
    return Camera(size, matrix, pose, "opencv", np.append(k, 0.0))


def _step(path: Path, where: str, entry: Mapping[str, Any], *, is_first: bool) -> Rigid:
    """The motion from the camera before (from the world, for the first) to this one, mm."""
    key = "T_c0_world" if is_first else "T_cn_cnm1"
    if is_first and key not in entry:
        return Rigid.identity()
    where = f"{where}, {key}"
    rows = entry.get(key)
    if not isinstance(rows, list):
        raise FileFormatError(path, where, "4 rows of 4 numbers", show(rows))
    if len(rows) != 4:
        raise FileFormatError(path, where, "4 rows of 4 numbers", f"{len(rows)} rows")
    T: NDArray[np.float64] = np.array(
        [checked_numbers(path, f"{where}, row {n}", row, 4) for n, row in enumerate(rows)]
    )
    if (T[3] != (0, 0, 0, 1)).any():
        raise FileFormatError(path, f"{where}, row 3", "0, 0, 0, 1", show(T[3].tolist()))
    return checked_pose(path, where, T[:3, :3], T[:3, 3] * _MM)
