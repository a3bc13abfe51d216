"""Camera files that a calibration writes: any format we know, checked before the work."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import InputError
from .options import note, writable_file, writable_folder

if TYPE_CHECKING:
    from ..core.rig import Rig

_SUFFIXES = (".json", ".yaml", ".yml")
_COLMAP_FILE = "cameras.txt"
#: What an option `--out` says of it.
OUT_HELP = "A .json, OpenCV .yaml, Kalibr camchain.yaml, or COLMAP folder."


def writable_cameras(path: Path) -> Path:
    """Check before the work that cameras can be written there, in a format we know.

    Raises
    ------
    InputError
        If the name asks for no format, or the place cannot be written to.
    """
    if path.is_dir() or path.name.lower() == _COLMAP_FILE or not path.suffix:
        folder = path.parent if path.name.lower() == _COLMAP_FILE else path
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder} is a file: expected a folder for a COLMAP model")
        # made when there is something to put into it
        writable_folder(folder if folder.is_dir() else folder.parent)
        return path
    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(
            f"{path}: expected a name that ends in .json (ours), .yaml or .yml (OpenCV's; Kalibr's "
            "if the name holds camchain), or a folder (COLMAP's text model)"
        )
    return writable_file(path)


def write_cameras(path: Path, rig: Rig) -> None:
    """Write cameras in the format that the path asks for, and say so.

    Raises
    ------
    InputError
        If that format cannot hold them; they are then kept as .json beside it, which is said.
    """
    from ..core.formats.rig_files import write_any_rig
    from ..core.formats.rig_json import write_rig

    try:
        write_any_rig(path, rig)
    except InputError as error:
        kept = _free_json(path)
        write_rig(kept, rig)
        raise InputError(f"{error} (they are kept in {kept})") from error
    note(f"wrote {path}")


def _free_json(path: Path) -> Path:
    """A name beside a path that is not taken."""
    wanted = path.with_suffix(".json")
    for number in range(2, 1000):
        if not wanted.exists():
            break
        wanted = path.with_name(f"{path.stem}_{number}.json")
    return wanted
