"""Checks that the readers of camera files share: numbers, sizes, matrices, poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from ..errors import FileFormatError, InputError
from ..rigid import Rigid

_MAX_SIZE_PX = 100_000
#: Larger numbers overflow when they are squared.
_LARGEST = 1e150
#: Entries of R Rᵀ − I below this are rounding of a matrix typed by hand, and are put right.
_ORTHONORMAL_WITHIN = 1e-3


def show(value: Any) -> str:
    """A value as found in the file, short enough for a message."""
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def checked_numbers(path: Path, where: str, values: Any, count: int | None) -> NDArray[np.float64]:
    """A (count,) float64 array (None: any length) of a list of finite numbers, or an error."""
    expected = "a list of numbers" if count is None else f"{count} numbers"
    if not isinstance(values, list):
        raise FileFormatError(path, where, expected, show(values))
    for value in values:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not abs(value) < _LARGEST:
            raise FileFormatError(path, where, "finite numbers", show(value))
    if count is not None and len(values) != count:
        raise FileFormatError(path, where, expected, str(len(values)))
    return np.array(values, dtype=np.float64)


def checked_size(path: Path, where: str, width: Any, height: Any) -> tuple[int, int]:
    """An image size in whole pixels, or an error."""
    for value in (width, height):
        is_whole = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_whole or not 1 <= value <= _MAX_SIZE_PX or value != int(value):
            expected = f"width and height in whole pixels, 1 to {_MAX_SIZE_PX}"
            raise FileFormatError(path, where, expected, f"{show(width)} x {show(height)}")
    return int(width), int(height)


def checked_matrix(
    path: Path, where: str, fx: float, fy: float, cx: float, cy: float
) -> NDArray[np.float64]:
    """(3, 3) float64, px: the intrinsic matrix, or an error where a focal length is not > 0."""
    if not (fx > 0 and fy > 0):
        raise FileFormatError(path, where, "focal lengths above 0", f"{fx:g} and {fy:g}")
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def checked_pose(
    path: Path, where: str, R: NDArray[np.float64], t_mm: NDArray[np.float64]
) -> Rigid:
    """A pose from a (3, 3) matrix, put right where it is rounded, and a (3,) translation, mm."""
    off = float(np.abs(R @ R.T - np.eye(3)).max()) if np.abs(R).max() < 2 else np.inf
    if off > _ORTHONORMAL_WITHIN:
        expected = f"a rotation matrix: orthonormal to within {_ORTHONORMAL_WITHIN:g}"
        raise FileFormatError(path, where, expected, f"one that is off by {off:.3g}")
    if np.linalg.det(R) < 0:
        expected = "a rotation matrix with determinant +1"
        raise FileFormatError(path, where, expected, "a mirror image, -1")
    u, _, vt = np.linalg.svd(R)  # the nearest rotation matrix
    return Rigid.from_rotation(u @ vt, t_mm)


def opencv_coefficients(path: Path, name: str, camera: Camera, writes: str) -> NDArray[np.float64]:
    """(12,) float64: a camera's coefficients in OpenCV's order, 0 where it has none.

    Raises
    ------
    InputError
        If the camera has skew or Tsai's distortion, which the format `writes` cannot hold.
    """
    if camera.distortion_model == "tsai":
        raise InputError(
            f'{path}: {writes} cannot hold camera "{name}": its distortion is Tsai\'s, whose '
            "inverse no polynomial is; write rig.json, or calibrate with the opencv model"
        )
    if camera.matrix[0, 1]:
        raise InputError(
            f'{path}: {writes} cannot hold camera "{name}": it has a skew of '
            f"{camera.matrix[0, 1]:g} px; write rig.json"
        )
    found = np.zeros(12)
    found[: len(camera.distortion)] = camera.distortion
    return found
