"""`facewright track`: videos to trajectories."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import (
    JsonOption,
    MarkersOption,
    NeutralOption,
    find_marker_set,
    find_rig,
    neutral_frame,
    note,
    writable_file,
)
from .progress import Ticks
from .tables import print_table, write_json

if TYPE_CHECKING:
    from ..core.markers import MarkerSet
    from ..core.rig import Rig
    from ..core.trajectories import Trajectories


@dataclass(frozen=True, eq=False)
class TrackResult:
    """Labelled (or not) trajectories and the figures that go with them."""

    trajectories: Trajectories
    facts: dict[str, Any]


def track(
    videos: Annotated[list[Path], typer.Argument(metavar="VIDEO", help="One a camera.")],
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="rig.json", help="Default: rig.json beside the videos."),
    ] = None,
    markers: MarkersOption = None,
    neutral: NeutralOption = "0",
    level: Annotated[
        float | None,
        typer.Option(help="Grey level above which a pixel is a dot's. Default: found."),
    ] = None,
    max_gap: Annotated[
        float, typer.Option(min=0.0, help="Longest gap that is filled, in seconds.")
    ] = 0.1,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="markers.c3d", help="Default: markers.c3d beside the videos."
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Follow markers through the videos of a calibrated camera rig, in space."""
    from ..core.formats.c3d import write_c3d

    out = writable_file(out or videos[0].parent / "markers.c3d", (".c3d",))
    marker_set = find_marker_set(markers, videos[0].parent)
    if marker_set is None:
        note("no marker set given: trajectories stay unlabelled")
    result = run_track(videos, find_rig(rig, videos), marker_set, neutral, level, max_gap)
    write_c3d(out, result.trajectories)
    print_table(("measured", "value"), [(k.replace("_", " "), v) for k, v in result.facts.items()])
    note(f"wrote {out}")
    if json_file is not None:
        write_json(json_file, result.facts)


def run_track(
    videos: Sequence[Path],
    rig: Rig,
    marker_set: MarkerSet | None,
    neutral: str = "0",
    level: float | None = None,
    max_gap_s: float = 0.1,
) -> TrackResult:
    """Track, label and fill short gaps, with a progress bar."""
    import numpy as np

    from ..core.video import probe_video
    from ..tracking.gaps import fill_gaps
    from ..tracking.labelling import label_tracks
    from ..tracking.videos import track_videos, warm_up

    warm_up()
    total = probe_video(videos[0]).n_frames
    start = time.perf_counter()
    with Ticks(total, "tracking") as tick:
        found = track_videos(videos, rig, level=level, on_frame=tick)
    took_s = time.perf_counter() - start
    trajectories = found.trajectories
    n_frames = len(trajectories.time_s)
    facts: dict[str, Any] = {
        "frames": n_frames,
        "markers": len(trajectories.names),
        "camera_frames_per_second": n_frames * len(videos) / took_s,
        "reprojection_rms_px": _rms(trajectories),
    }
    if marker_set is not None:
        frame = neutral_frame(neutral, trajectories)
        trajectories, labelling = label_tracks(trajectories, marker_set, neutral_frame=frame)
        trajectories = fill_gaps(trajectories, max_gap_s=max_gap_s)
        missing = np.isnan(trajectories.positions[..., 0])
        never = [n for m, n in enumerate(trajectories.names) if missing[:, m].all()]
        if never:
            note(f"never seen: {', '.join(never)}")
        facts |= {
            "markers": len(marker_set.labels) - len(never),
            "samples_filled": int(trajectories.is_filled.sum()),
            "samples_missing": int(missing.sum()),
            "template_distance_mm": labelling.mean_distance_mm,
        }
    return TrackResult(trajectories, facts)


def _rms(trajectories: Trajectories) -> float:
    """Over all views used of all points."""
    import numpy as np

    assert trajectories.residual_px is not None
    assert trajectories.n_views is not None
    seen = trajectories.n_views > 0
    squares = trajectories.residual_px[seen] ** 2 * trajectories.n_views[seen]
    return float(np.sqrt(squares.sum() / trajectories.n_views[seen].sum()))
