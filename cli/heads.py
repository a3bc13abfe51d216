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
    (which is said), else they are found; what is found is written beside the file as
    ``NAME.points.csv``, which may be corrected by hand, and ``NAME.chart.png``, to look at.

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
    return find_own_head(Path(name_or_file), points).head


def find_own_head(path: Path, points: Path | None = None) -> OwnHead:
    """`find_head` of a file, with all that was found."""
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
    if known is None or not set(own.head.feature_points.names) <= set(known):
        _write_beside(path, own, beside if points != beside else None)
    return own


def _write_beside(path: Path, own: OwnHead, points: Path | None) -> None:
    """Write the points and the chart beside a head, or say that it is not possible.

    `points` is None where the file that was read would be overwritten.
    """
    from ..core.formats.head_points import write_head_points
    from ..heads.chart import feature_point_chart
    from .pictures import write_png

    chart = path.with_suffix(".chart.png")
    written = []
    try:
        write_png(chart, feature_point_chart(own.head))
        written.append(chart.name)
        if points is not None:
            write_head_points(points, own.points_in_file().items())
            written.append(points.name)
    except OSError as error:
        note(f"feature points were found, but {error.filename or chart} cannot be written")
    if written:
        note(
            f"wrote {' and '.join(written)} beside {path.name}: look at the chart; points may be "
            "corrected in the .csv, which is then used"
        )
