"""The cleaning report of tracked markers: what was measured, filled, repaired and refused."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..core.formats.gltf import write_glb
from ..core.markers import MarkerSet
from ..core.trajectories import Source, Trajectories
from .drawing import ACCENT, ALARM, FAINT, INK, Drawing
from .marker_scene import marker_scene
from .page import PageModel, PageTable, PageVideo, write_page
from .pictures import write_png
from .tables import cell_text

if TYPE_CHECKING:
    from ..tracking.labelling import Repair

_SOURCE_COLOURS = {
    Source.MISSING: ALARM,
    Source.MEASURED: "#9cc7e6",
    Source.INTERPOLATED: "#e69f00",
    Source.RECONSTRUCTED: "#7a4fa3",
}
_ROW_PX, _NAME_PX, _PLOT_PX, _SIDE_PX = 13.0, 132.0, 640.0, 140.0
_HEAD_PX, _FOOT_PX = 40.0, 26.0
_WORST_MM = 0.1  # right end of the bars of noise, at least


def gaps_of(source: NDArray[np.uint8]) -> list[tuple[int, int, Source]]:
    """Runs of one marker that were not measured: first frame, end, what stands there.

    Parameters
    ----------
    source : (T,) uint8
        Values of `Source`.
    """
    edges = np.flatnonzero(np.diff(source.astype(np.int16))) + 1
    starts = [0, *edges.tolist()]
    ends = [*edges.tolist(), len(source)]
    return [
        (a, b, Source(int(source[a])))
        for a, b in zip(starts, ends, strict=True)
        if b > a and source[a] != Source.MEASURED
    ]


def marker_rows(tracks: Trajectories) -> list[tuple[str, ...]]:
    """For each marker: shares, gaps, the longest one (s), and noise (mm)."""
    rows: list[tuple[str, ...]] = []
    t, noises = tracks.time_s, noise_mm(tracks)
    for m, name in enumerate(tracks.names):
        source = tracks.source[:, m]
        share = [float((source == s).mean()) for s in Source]
        gaps = gaps_of(source)
        last = len(t) - 1
        longest = max((float(t[min(b, last)] - t[max(a - 1, 0)]) for a, b, _ in gaps), default=0.0)
        noise = noises[m]
        rows.append(
            (
                name,
                f"{100 * share[Source.MEASURED]:.1f}",
                f"{100 * share[Source.INTERPOLATED]:.1f}",
                f"{100 * share[Source.RECONSTRUCTED]:.1f}",
                f"{100 * share[Source.MISSING]:.1f}",
                str(len(gaps)),
                f"{longest:.2f}",
                "" if np.isnan(noise) else f"{noise:.3f}",
            )
        )
    return rows


MARKER_COLUMNS = (
    "marker", "measured %", "interpolated %", "reconstructed %", "missing %", "gaps",
    "longest s", "noise mm",
)  # fmt: skip


def noise_mm(tracks: Trajectories) -> NDArray[np.float64]:
    """(M,) median standard deviation in space of the measured samples; NaN where none is known."""
    found = np.full(len(tracks.names), np.nan)
    if tracks.covariances is None:
        return found
    variance = np.einsum("tmii->tm", tracks.covariances)
    for m in range(len(found)):
        known = tracks.is_measured[:, m] & np.isfinite(variance[:, m])
        if known.any():
            found[m] = float(np.sqrt(np.median(variance[known, m])))
    return found


def summary_of(tracks: Trajectories) -> str:
    """One sentence."""
    share = {s: 100 * float((tracks.source == s).mean()) for s in Source}
    return (
        f"{len(tracks.names)} markers over {len(tracks.time_s)} frames: "
        f"{share[Source.MEASURED]:.2f} % of samples measured, "
        f"{share[Source.INTERPOLATED]:.2f} % interpolated, "
        f"{share[Source.RECONSTRUCTED]:.2f} % reconstructed from other markers, "
        f"{share[Source.MISSING]:.2f} % missing."
    )


def availability_chart(tracks: Trajectories) -> Drawing:
    """A line a marker over time, coloured by where its samples come from, and its noise."""
    n = len(tracks.names)
    drawing = Drawing(_NAME_PX + _PLOT_PX + _SIDE_PX, _HEAD_PX + _ROW_PX * n + _FOOT_PX)
    drawing.words(0, 14, "Where samples come from", size=13)
    x = _NAME_PX
    for source in (Source.MEASURED, Source.INTERPOLATED, Source.RECONSTRUCTED, Source.MISSING):
        drawing.box(x, 20, 10, 10, fill=_SOURCE_COLOURS[source])
        drawing.words(x + 14, 29, source.name.lower())
        x += 118
    noise = noise_mm(tracks)
    widest = max(_WORST_MM, float(np.nanmax(noise))) if np.isfinite(noise).any() else _WORST_MM
    drawing.words(_NAME_PX + _PLOT_PX + 10, 29, f"noise, 0 to {widest:.2g} mm")
    T = len(tracks.time_s)
    for m, name in enumerate(tracks.names):
        y = _HEAD_PX + m * _ROW_PX
        drawing.words(_NAME_PX - 8, y + 9, name, size=10, anchor="end")
        drawing.box(_NAME_PX, y, _PLOT_PX, _ROW_PX - 3, fill=_SOURCE_COLOURS[Source.MEASURED])
        for a, b, source in gaps_of(tracks.source[:, m]):
            left, width = _PLOT_PX * a / T, max(_PLOT_PX * (b - a) / T, 1.0)
            drawing.box(_NAME_PX + left, y, width, _ROW_PX - 3, fill=_SOURCE_COLOURS[source])
        if np.isfinite(noise[m]):
            length = (_SIDE_PX - 16) * noise[m] / widest
            drawing.box(_NAME_PX + _PLOT_PX + 10, y + 2, length, _ROW_PX - 7, fill=ACCENT)
    y = _HEAD_PX + n * _ROW_PX + 12
    drawing.line((_NAME_PX, y - 10), (_NAME_PX + _PLOT_PX, y - 10), colour=FAINT)
    seconds = tracks.time_s - tracks.time_s[0]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        at = _NAME_PX + share * _PLOT_PX
        drawing.line((at, y - 12), (at, y - 8), colour=INK)
        drawing.words(at, y + 4, f"{share * seconds[-1]:.4g} s", size=10, anchor="middle")
    return drawing


def repair_rows(repairs: Sequence[Repair], time_s: NDArray[np.float64]) -> list[tuple[str, ...]]:
    """Swaps undone and samples refused, for a table."""
    rows: list[tuple[str, ...]] = []
    for repair in repairs:
        when = f"{time_s[repair.first_frame]:.3f} to {time_s[repair.last_frame]:.3f}"
        what = f"{repair.before or 'nobody'} to {repair.after or 'nobody'}"
        rows.append((repair.kind, repair.track, when, what if repair.kind == "cut" else ""))
    return rows


def write_tracking_report(
    path: Path,
    tracks: Trajectories,
    marker_set: MarkerSet | None,
    facts: Mapping[str, Any],
    repairs: Sequence[Repair],
    overlays: Mapping[str, Path],
) -> Path:
    """Write the page; its chart too as a PNG beside it, whose path is returned.

    Parameters
    ----------
    path : Path
    tracks : Trajectories
    marker_set : MarkerSet or None
    facts : mapping
        Figures of the run.
    repairs : sequence of Repair
    overlays : mapping from camera to a video with the tracks drawn
    """
    chart = availability_chart(tracks)
    picture = path.with_suffix(".png")
    write_png(picture, chart.image())
    with tempfile.TemporaryDirectory() as folder:
        glb = Path(folder) / "markers.glb"
        write_glb(glb, marker_scene(tracks, marker_set))
        model = PageModel("markers, with the average head among them", glb.read_bytes())
    plain = [
        (k.replace("_", " "), cell_text(v))
        for k, v in facts.items()
        if not isinstance(v, list | dict) and not hasattr(v, "shape")
    ]
    tables = [
        PageTable("This run", ("measured", "value"), plain),
        PageTable("Markers", MARKER_COLUMNS, marker_rows(tracks)),
    ]
    if repairs:
        columns = ("kind", "track", "seconds", "from, to")
        tables.append(PageTable("Put right", columns, repair_rows(repairs, tracks.time_s)))
    write_page(
        path,
        title=f"{path.stem}: tracked markers",
        models=[model],
        videos=[PageVideo(name, video.read_bytes()) for name, video in overlays.items()],
        drawings=[chart],
        tables=tables,
        notes=summary_of(tracks),
    )
    return picture
