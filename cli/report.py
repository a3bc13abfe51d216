"""The page of a performance: source, tracks and head on one time line, curves, tables."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from .page import PageModel, PageTable, PageVideo, write_page
from .tables import cell_text

if TYPE_CHECKING:
    from ..tracking.face_analysis import FacePerformance
    from ..tracking.performance import TrackedPerformance


def write_report(
    folder: Path,
    source: Path,
    head: str,
    performance: TrackedPerformance,
    facts: dict[str, Any],
) -> None:
    """Write `report.html` from the folder's ``head.glb`` and a video of source and tracks."""
    units = [(name, f"{value:.2f}") for name, value in performance.fapu.as_dict().items()]
    approximated = ", ".join(performance.approximated)
    write_page(
        folder / "report.html",
        title=f"{folder.name}: performance on head {head}",
        models=[PageModel(f"{head}, driven by FAPs", (folder / "head.glb").read_bytes())],
        videos=[PageVideo("source and tracks", source.read_bytes())],
        curves=performance.faps,
        tables=[
            _table_of(facts),
            PageTable(f"Units of the performer ({performance.fapu_source})", ("unit", "mm"), units),
        ],
        notes=(
            "FAPs are in the units of the MPEG-4 table: 1/1024 of a distance on the neutral face, "
            "or 1e-5 rad. "
            + (f"Taken from the outer lip contour: {approximated}." if approximated else "")
        ),
    )


def write_plain_report(
    folder: Path,
    source: Path,
    head: str,
    performance: FacePerformance,
    facts: dict[str, Any],
) -> None:
    """The same for a face without markers, and what of it was not seen."""
    unseen = ", ".join(performance.dead)
    write_page(
        folder / "report.html",
        title=f"{folder.name}: face on head {head}",
        models=[PageModel(f"{head}, driven by FAPs", (folder / "head.glb").read_bytes())],
        videos=[PageVideo("source and landmarks", source.read_bytes())],
        curves=performance.faps,
        tables=[_table_of(facts)],
        notes=(
            "FAPs are in the units of the MPEG-4 table: 1/1024 of a distance on the neutral face, "
            f"or 1e-5 rad. Not set, since a picture does not show it: {unseen}."
        ),
    )


def _table_of(facts: dict[str, Any]) -> PageTable:
    rows = [
        (name.replace("_", " "), cell_text(value))
        for name, value in facts.items()
        if not isinstance(value, list | dict) and not hasattr(value, "shape")
    ]
    return PageTable("This run", ("measured", "value"), rows)
