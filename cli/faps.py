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


def faps(
    markers_c3d: Annotated[Path, typer.Argument(metavar="markers.c3d", help="Labelled markers.")],
    markers: MarkersOption = None,
    neutral: NeutralOption = "0",
    axes: Annotated[
        str, typer.Option(help="Axes of the head at rest: world, face, or auto.")
    ] = "auto",
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
    marker_set = find_marker_set(markers, markers_c3d.parent)
    if marker_set is None:
        raise InputError(
            f"a marker set must tell what the labels mean: give one with --markers, or put "
            f"markers.toml into {markers_c3d.parent}"
        )
    performance = run_faps(trajectories, marker_set, neutral, axes)
    write_fap(out, performance.faps)
    print_table(("FAP", "lowest", "highest", "unit"), fap_ranges(performance.faps))
    note(f"wrote {out}")
    if json_file is not None:
        write_json(json_file, facts_of(performance))


def run_faps(
    trajectories: Trajectories, marker_set: MarkerSet, neutral: str = "0", axes: str = "auto"
) -> TrackedPerformance:
    """Analyse, and say what was decided."""
    import numpy as np

    from ..tracking.performance import analyse

    frame = neutral_frame(neutral, trajectories)
    performance = analyse(trajectories, marker_set, neutral_frame=frame, axes=axes)
    lost = int(np.isnan(performance.head_motion.quaternion[:, 0]).sum())
    if lost:
        note(f"head motion unknown in {lost} frames (head markers missing): FAPs not set there")
    if performance.neutral.axes == "face":
        angle = np.rad2deg(performance.neutral.face_angle_rad)
        note(f"the face is turned {angle:.0f}° from the world's axes: using the face's own")
    if performance.fapu_source == "estimated":
        note("units of the face estimated from the markers; measure them for exact FAP scale")
    return performance


def facts_of(performance: TrackedPerformance) -> dict[str, Any]:
    """What was found, for JSON."""
    return {
        "frames": len(performance.faps.time_s),
        "faps": list(performance.faps.channels),
        "approximated": list(performance.approximated),
        "neutral_frames": [int(frame) for frame in performance.neutral.frames],
        "axes": performance.neutral.axes,
        "fapu_mm": performance.fapu.as_dict(),
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
            fap = fap_by_name()[name]
            unit = "1e-5 rad" if fap.fapu == "AU" else f"{fap.fapu}/1024"
            label = f"{fap.number} {name}"
            rows.append((label, float(np.nanmin(values)), float(np.nanmax(values)), unit))
    return rows
