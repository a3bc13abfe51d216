"""Options and conventions that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.errors import InputError

if TYPE_CHECKING:
    from ..core.markers import MarkerSet
    from ..core.rig import Rig
    from ..core.trajectories import Trajectories

JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the results as JSON too.")
]
ReportOption = Annotated[
    Path | None,
    typer.Option("--report", metavar="report.html", help="Write a page (and a PNG) too."),
]
NeutralOption = Annotated[
    str,
    typer.Option(
        "--neutral", metavar="WHEN", help="The neutral face: a frame number, or seconds with an s."
    ),
]
HeadOption = Annotated[
    str,
    typer.Option(
        "--head", metavar="HEAD", help="A built-in head (see synth head --list) or a file of one."
    ),
]
MarkersOption = Annotated[
    str | None,
    typer.Option(
        "--markers",
        metavar="SET.toml",
        help="Marker set: a file or the name of a ready one. Default: markers.toml beside the "
        "input, if there is one.",
    ),
]


def note(text: str) -> None:
    """Say on stderr what was decided for the user."""
    import sys

    print(f"facewright: {text}", file=sys.stderr)


def parse_size(text: str, option: str = "--size") -> tuple[int, int]:
    """Width and height of ``"1280x720"``, px; wrong usage (naming the option) if it is none."""
    import re

    found = re.fullmatch(r"([0-9]{1,6})[xX×]([0-9]{1,6})", text.strip())
    if found is None or not (int(found[1]) and int(found[2])):
        raise typer.BadParameter(
            f"expected WIDTHxHEIGHT in pixels, such as 1280x720, got {text}", param_hint=option
        )
    return int(found[1]), int(found[2])


def parse_when(when: str) -> tuple[int, float | None]:
    """What `--neutral` names: ``"12"`` is frame 12, ``"0.2s"`` a time (then the frame is 0).

    Raises
    ------
    InputError
        If it is neither.
    """
    import math

    text = when.strip()
    try:
        if text.endswith("s"):
            seconds = float(text[:-1])
            if math.isfinite(seconds):
                return 0, seconds
        else:
            return int(text), None
    except ValueError:
        pass
    raise InputError(f"--neutral {when}: expected a frame number (12) or seconds with an s (0.2s)")


def neutral_frame(when: str, trajectories: Trajectories) -> int:
    """The frame of a take that `--neutral` names.

    Raises
    ------
    InputError
        If it is no frame and no time, or outside the take.
    """
    frame, seconds = parse_when(when)
    n = len(trajectories.time_s)
    if seconds is not None:
        return _frame_at(when, seconds, trajectories)
    if not 0 <= frame < n:
        raise InputError(f"--neutral {when}: the take has frames 0 to {n - 1}")
    return frame


def _frame_at(when: str, seconds: float, trajectories: Trajectories) -> int:
    import numpy as np

    last = float(trajectories.time_s[-1])
    if not -1e-9 <= seconds <= last + 1e-9:
        raise InputError(f"--neutral {when}: the take lasts {last:.3f} s")
    return int(np.argmin(np.abs(trajectories.time_s - seconds)))


def find_marker_set(given: str | None, beside: Path) -> MarkerSet | None:
    """The marker set a user means.

    `given` is a file, or the name of a ready set; without it ``markers.toml`` beside the input is
    taken, and that is said; None if there is none.
    """
    from ..core.formats.markers_toml import read_marker_set
    from ..heads.marker_sets import READY_SETS, ready_marker_set

    if given is not None:
        if given in READY_SETS or not given.endswith(".toml"):
            return ready_marker_set(given)
        return read_marker_set(Path(given))
    found = beside / "markers.toml"
    if not found.is_file():
        return None
    note(f"using marker set {found}")
    return read_marker_set(found)


def find_rig(given: Path | None, videos: Sequence[Path]) -> Rig:
    """The camera rig a user means, or ``rig.json`` beside the videos (which is said).

    `given` is a file of any format we read (rig.json, OpenCV or Kalibr YAML) or the folder of a
    COLMAP text model.
    """
    from ..core.formats.rig_files import read_any_rig
    from ..core.formats.rig_json import read_rig

    if given is not None:
        return read_any_rig(given)
    found = videos[0].parent / "rig.json"
    if not found.is_file():
        raise InputError(
            f"tracking needs a calibrated camera rig: give one with --rig, or put rig.json into "
            f"{videos[0].parent}"
        )
    note(f"using camera rig {found}")
    return read_rig(found)


def writable_folder(folder: Path) -> Path:
    """Make a folder (and its parents) if need be, and check that files can be made in it.

    Raises
    ------
    InputError
        If it cannot be made or written to, before any work is done.
    """
    import os
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"{folder}: cannot write there ({error.strerror or os.strerror(error.errno or 0)})"
        ) from error
    return folder


def writable_file(path: Path, suffixes: Sequence[str] = ()) -> Path:
    """Check before the work that a result file can be written, and that its suffix is known."""
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError(f"{path}: expected a name that ends in {' or '.join(suffixes)}")
    if path.is_dir():
        raise InputError(f"{path} is a folder: expected a file to write")
    writable_folder(path.parent)
    return path
