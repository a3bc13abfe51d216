"""`facewright faps`: trajectories to facial animation parameters."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.errors import InputError
from .options import (
    JsonOption,
    MarkersOption,
    NeutralOption,
    find_marker_set,
    neutral_frame,
    note,
    writable_file,
)
from .tables import print_table, write_json

if TYPE_CHECKING:
    from ..core.clip import Clip
    from ..core.markers import MarkerSet
    from ..core.trajectories import Trajectories
    from ..tracking.performance import TrackedPerformance

_MAX_LABELS_BYTES = 1024 * 1024


def faps(
    markers_c3d: Annotated[Path, typer.Argument(metavar="markers.c3d", help="Labelled markers.")],
    markers: MarkersOption = None,
    neutral: NeutralOption = "0",
    axes: Annotated[
        str, typer.Option(help="Axes of the head at rest: world, face, or auto.")
    ] = "auto",
    labels: Annotated[
        Path | None,
        typer.Option(
            metavar="names.csv",
            help="What the file calls the markers: lines of ITS_NAME,LABEL_OF_THE_SET.",
        ),
    ] = None,
    high_level: Annotated[
        bool,
        typer.Option("--high-level", help="Also FAPs 1 and 2: the nearest viseme and expression."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="performance.fap", help="Default: the input's name with .fap."
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Head motion and MPEG-4 FAPs of labelled trajectories."""
    from ..core.formats.c3d import read_c3d
    from ..core.formats.fap import write_fap

    if axes not in ("auto", "world", "face"):
        raise typer.BadParameter("expected world, face or auto", param_hint="--axes")
    out = writable_file(out or markers_c3d.with_suffix(".fap"), (".fap",))
    trajectories = read_c3d(markers_c3d)
    if labels is not None:
        trajectories = renamed(trajectories, labels)
    marker_set = find_marker_set(markers, markers_c3d.parent)
    if marker_set is None:
        raise InputError(
            f"a marker set must tell what the labels mean: give one with --markers, or put "
            f"markers.toml into {markers_c3d.parent}"
        )
    performance = run_faps(trajectories, marker_set, neutral, axes, high_level)
    write_fap(out, performance.faps)
    print_table(("FAP", "lowest", "highest", "unit"), fap_ranges(performance.faps))
    note(f"wrote {out}")
    if json_file is not None:
        write_json(json_file, facts_of(performance))


def run_faps(
    trajectories: Trajectories,
    marker_set: MarkerSet,
    neutral: str = "0",
    axes: str = "auto",
    high_level: bool = False,
) -> TrackedPerformance:
    """Analyse, and say what was decided."""
    import numpy as np

    from ..tracking.performance import analyse

    frame = neutral_frame(neutral, trajectories)
    performance = analyse(
        trajectories, marker_set, neutral_frame=frame, axes=axes, high_level=high_level
    )
    lost = int(np.isnan(performance.head_motion.quaternion[:, 0]).sum())
    if lost:
        note(f"head motion unknown in {lost} frames (head markers missing): FAPs not set there")
    if performance.neutral.axes == "face":
        angle = np.rad2deg(performance.neutral.face_angle_rad)
        note(f"the face is turned {angle:.0f}° from the world's axes: using the face's own")
    if performance.fapu_source == "estimated":
        note("units of the face estimated from the markers; measure them for exact FAP scale")
    return performance


def renamed(trajectories: Trajectories, path: Path) -> Trajectories:
    """Trajectories with the names that a file of pairs gives them; others keep theirs.

    Raises
    ------
    FileFormatError
        If a line is no pair, or names a marker that is not there.
    InputError
        If two markers would have one name.
    """
    from dataclasses import replace

    from ..core.errors import FileFormatError
    from ..core.files import read_text

    names = dict(zip(trajectories.names, trajectories.names, strict=True))
    for number, line in enumerate(read_text(path, _MAX_LABELS_BYTES).splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        parts = [part.strip() for part in line.split(",")]
        if len(parts) != 2 or not all(parts):
            raise FileFormatError(path, f"line {number}", "ITS_NAME,LABEL", line.strip()[:60])
        if parts[0] not in names:
            there = ", ".join(trajectories.names[:6])
            raise FileFormatError(path, f"line {number}", f"one of {there}, ...", parts[0])
        names[parts[0]] = parts[1]
    if len(set(names.values())) != len(names):
        twice = sorted({n for n in names.values() if list(names.values()).count(n) > 1})
        raise InputError(f"{path}: {', '.join(twice)} would be the name of two markers")
    return replace(trajectories, names=tuple(names.values()))


def facts_of(performance: TrackedPerformance) -> dict[str, Any]:
    """What was found, for JSON."""
    return {
        "frames": len(performance.faps.time_s),
        "faps": list(performance.faps.channels),
        "approximated": list(performance.approximated),
        "neutral_frames": [int(frame) for frame in performance.neutral.frames],
        "axes": performance.neutral.axes,
        "fapu_mm": performance.fapu.as_dict(),
        "fapu_sd_mm": performance.fapu_sd_mm,
        "fapu_source": performance.fapu_source,
    }


def fap_ranges(clip: Clip) -> list[tuple[str, float, float, str]]:
    """Lowest and highest value of every FAP that is set."""
    import numpy as np

    from ..core.mpeg4 import fap_by_name

    rows = []
    for name in clip.channels:
        values = clip[name]
        if not np.isnan(values).all():
            fap = fap_by_name().get(name)
            if fap is None:  # a part of FAP 1 or 2: its numbers have no range
                continue
            unit = "1e-5 rad" if fap.fapu == "AU" else f"{fap.fapu}/1024"
            label = f"{fap.number} {name}"
            rows.append((label, float(np.nanmin(values)), float(np.nanmax(values)), unit))
    return rows
