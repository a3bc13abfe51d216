"""`HEAD` of the commands: a built-in name, or a file of the user's own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import InputError
from .options import note

if TYPE_CHECKING:
    from ..heads.head import Head
    from ..heads.own_head import OwnHead

#: Suffixes of a head's file, as `heads.own_mesh.OWN_SUFFIXES`.
_SUFFIXES = (".obj", ".ply", ".glb", ".vrm")


def check_head(name_or_file: str) -> None:
    """Say a wrong name or a file that is not there before the work begins.

    Raises
    ------
    InputError
        If it is neither a built-in head nor a file that may hold one.
    """
    from ..heads.catalogue import BUILT_IN

    if name_or_file in BUILT_IN:
        return
    path = Path(name_or_file)
    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(
            f"no built-in head {name_or_file}; there are {', '.join(BUILT_IN)}; or give a file "
            f"{', '.join(_SUFFIXES)}"
        )
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")


def find_head(name_or_file: str, points: Path | None = None) -> Head:
    """The head a user means.

    Of a file the feature points are those of `points`, else of ``NAME.points.csv`` beside it
    (which is said), else they are found. Nothing is written: ``facewright head`` does that.

    Parameters
    ----------
    name_or_file : str
        A built-in name, or an ``.obj``, ``.ply``, ``.glb`` or ``.vrm`` file.
    points : Path, optional
        Of named points in the file's axes, its unit or millimetres.

    Raises
    ------
    FileFormatError
        If a file is damaged.
    InputError
        If there is no such head, no face is found on it, or the points do not fit.
    OSError
        If a file cannot be read.
    """
    from ..heads.catalogue import BUILT_IN, built_in_head

    check_head(name_or_file)
    if name_or_file in BUILT_IN:
        if points is not None:
            raise InputError(f"{points}: the built-in head {name_or_file} has its points already")
        return built_in_head(name_or_file)
    own = find_own_head(Path(name_or_file), points)
    if own.placed == "found":
        note(
            f"its feature points were placed by us: facewright head {name_or_file} --out DIR "
            "shows them on a chart and keeps them in a file to correct"
        )
    return own.head


def find_own_head(path: Path, points: Path | None = None) -> OwnHead:
    """`find_head` of a file, with all that was found, which is said too."""
    from ..core.formats.head_points import read_head_points
    from ..heads.own_head import read_own_head

    beside = path.with_suffix(".points.csv")
    if points is None and beside.is_file():
        points = beside
    known = None
    if points is not None:
        note(f"using feature points {points}")
        known = read_head_points(points)
    own = read_own_head(path, known)
    for line in own.notes:
        note(f"{path.name}: {line}")
    return own
