"""Camera files of any format we know, told apart by name and contents."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from ..errors import InputError
from ..files import read_text
from ..rig import Rig
from .colmap_text import read_colmap_text, write_colmap_text
from .kalibr_yaml import read_kalibr_yaml, write_kalibr_yaml
from .opencv_yaml import read_opencv_yaml, write_opencv_yaml
from .rig_json import read_rig, write_rig
from .yaml_subset import MAX_BYTES

#: What `rig_format` finds and `write_any_rig` takes, with words for people.
RIG_FORMATS: Mapping[str, str] = MappingProxyType(
    {
        "rig.json": "rig.json",
        "opencv": "OpenCV YAML",
        "kalibr": "Kalibr YAML",
        "colmap": "COLMAP text model",
    }
)
_READERS: dict[str, Callable[[Path], Rig]] = {
    "rig.json": read_rig,
    "opencv": read_opencv_yaml,
    "kalibr": read_kalibr_yaml,
    "colmap": read_colmap_text,
}
_WRITERS: dict[str, Callable[[Path, Rig], None]] = {
    "rig.json": write_rig,
    "opencv": write_opencv_yaml,
    "kalibr": write_kalibr_yaml,
    "colmap": lambda path, rig: write_colmap_text(_colmap_folder(path), rig),
}
_YAML = (".yaml", ".yml")
_COLMAP_FILES = ("cameras.txt", "images.txt", "points3d.txt")
#: What only a Kalibr chain holds.
_KALIBR_CAMERA = re.compile(r"^cam\d+\s*:", re.MULTILINE)
_KALIBR_KEY = re.compile(r"[\s{,](?:intrinsics|camera_model|T_cn_cnm1)\s*:")
_KALIBR_NAME = re.compile(r"camchain|kalibr", re.IGNORECASE)


def rig_format(path: Path) -> str:
    """Which of `RIG_FORMATS` a file (or folder) is of, by its name and, for YAML, its contents.

    Raises
    ------
    InputError
        If it is of none.
    FileFormatError
        If it is empty or far too large.
    OSError
        If it cannot be read.
    """
    path.stat()  # what is not there is said to be missing, not unknown
    suffix = path.suffix.lower()
    if path.is_dir():
        return _folder_format(path)
    if suffix == ".json":
        return "rig.json"
    if suffix in _YAML:
        text = read_text(path, MAX_BYTES)
        is_kalibr = _KALIBR_CAMERA.search(text) and _KALIBR_KEY.search(text)
        return "kalibr" if is_kalibr else "opencv"
    if path.name.lower() in _COLMAP_FILES:
        return "colmap"
    raise InputError(f"{path}: not a camera file that we read: {_known()}{_hint(suffix)}")


def read_any_rig(path: Path) -> Rig:
    """Read a rig from ``rig.json``, OpenCV or Kalibr YAML, or a COLMAP text model (its folder).

    Lengths of files that name no unit (OpenCV, COLMAP) are taken to be millimetres.

    Raises
    ------
    InputError, FileFormatError, OSError
        As `rig_format` and the format's own reader.
    """
    found = rig_format(path)
    return _READERS[found](path / "rig.json" if found == "rig.json" and path.is_dir() else path)


def write_any_rig(path: Path, rig: Rig, *, as_format: str | None = None) -> None:
    """Write a rig in the format its path asks for.

    ``.json`` is ours; ``.yaml`` and ``.yml`` are OpenCV's, or Kalibr's where the name holds
    ``camchain`` or ``kalibr``; a folder, a path without suffix, and ``cameras.txt`` are COLMAP's.

    Parameters
    ----------
    path : Path
    rig : Rig
    as_format : str, optional
        One of `RIG_FORMATS`, whatever the path is called.

    Raises
    ------
    InputError
        If the path asks for no format we write, or the format cannot hold a camera.
    ValueError
        If `as_format` is unknown.
    """
    if as_format is not None and as_format not in RIG_FORMATS:
        raise ValueError(f"as_format must be one of {', '.join(RIG_FORMATS)}, not {as_format}")
    _WRITERS[as_format or _wanted(path)](path, rig)


def _wanted(path: Path) -> str:
    suffix = path.suffix.lower()
    if path.is_dir() or not suffix or path.name.lower() in _COLMAP_FILES:
        return "colmap"
    if suffix == ".json":
        return "rig.json"
    if suffix in _YAML:
        return "kalibr" if _KALIBR_NAME.search(path.name) else "opencv"
    raise InputError(f"{path}: not a camera file that we write: {_known()}")


def _folder_format(path: Path) -> str:
    has_rig = (path / "rig.json").is_file()
    has_model = (path / "cameras.txt").is_file() or (path / "cameras.bin").is_file()
    if has_rig and has_model:
        raise InputError(f"{path} holds both rig.json and a COLMAP model: name the file")
    if not has_rig and not has_model:
        raise InputError(f"{path} is a folder without cameras: expected cameras.txt or rig.json")
    return "rig.json" if has_rig else "colmap"


def _colmap_folder(path: Path) -> Path:
    return path.parent if path.name.lower() in _COLMAP_FILES else path


def _known() -> str:
    return "rig.json, OpenCV or Kalibr YAML (.yaml, .yml), a COLMAP text model (its folder)"


def _hint(suffix: str) -> str:
    if suffix == ".xml":
        return "; OpenCV writes the same as YAML if the name ends in .yml"
    if suffix == ".bin":
        return "; colmap model_converter --output_type TXT makes text of a binary model"
    return ""
