"""`facewright animate`: videos of a performance to an animated head."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.errors import InputError
from .faps import facts_of, run_faps
from .options import (
    HeadOption,
    JsonOption,
    MarkersOption,
    NeutralOption,
    find_marker_set,
    find_rig,
    note,
    writable_folder,
)
from .progress import Ticks
from .tables import print_table, write_json
from .track import TrackResult, run_track

if TYPE_CHECKING:
    from ..core.markers import MarkerSet
    from ..core.rig import Rig
    from ..tracking.performance import TrackedPerformance


@dataclass(frozen=True, eq=False)
class AnimateResult:
    """What a run found; files lie in the output folder."""

    track: TrackResult
    performance: TrackedPerformance
    facts: dict[str, Any] = field(default_factory=dict)


def animate(
    videos: Annotated[
        list[Path], typer.Argument(metavar="VIDEO", help="One a camera, named after it.")
    ],
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="rig.json", help="Default: rig.json beside the videos."),
    ] = None,
    markers: MarkersOption = None,
    neutral: NeutralOption = "0",
    head: HeadOption = "ruth",
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Default: animation beside the videos."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Marker videos of a calibrated camera rig to a head that moves.

    Writes markers.c3d, performance.fap, head.glb, preview.mp4 and report.html.
    """
    from ..heads.catalogue import built_in_identity

    built_in_identity(head)  # a wrong name is said before the work
    marker_set = find_marker_set(markers, videos[0].parent)
    if marker_set is None:
        raise InputError(
            f"a marker set must tell which dot is what: give one with --markers, or put "
            f"markers.toml into {videos[0].parent}"
        )
    cameras = find_rig(rig, videos)
    folder = writable_folder(out or videos[0].parent / "animation")
    result = run_animate(videos, cameras, marker_set, folder, head=head, neutral=neutral)
    rows = [(k.replace("_", " "), v) for k, v in result.facts.items() if not isinstance(v, list)]
    print_table(("measured", "value"), [r for r in rows if not isinstance(r[1], dict)])
    note(f"wrote {folder}/ markers.c3d performance.fap head.glb preview.mp4 report.html")
    if json_file is not None:
        write_json(json_file, result.facts)


def run_animate(
    videos: Sequence[Path],
    rig: Rig,
    marker_set: MarkerSet,
    folder: Path,
    *,
    head: str,
    neutral: str = "0",
) -> AnimateResult:
    """The whole way from videos to the animated head; writes all files into a folder."""
    import tempfile
    import time

    from ..core.formats.c3d import write_c3d
    from ..core.formats.fap import write_fap
    from ..core.formats.gltf import write_glb
    from ..heads.catalogue import built_in_head
    from ..retarget.drive import HeadDrive
    from ..retarget.export import animation_glb
    from ..tracking.videos import match_videos_to_rig
    from .preview import choose_view, write_previews
    from .report import write_report

    tracked = run_track(videos, rig, marker_set, neutral)
    write_c3d(folder / "markers.c3d", tracked.trajectories)
    performance = run_faps(tracked.trajectories, marker_set, neutral)
    write_fap(folder / "performance.fap", performance.faps)
    note("animating the head")
    target = built_in_head(head)
    animation = HeadDrive(target).animate(performance.faps)
    write_glb(folder / "head.glb", animation_glb(target, animation, name=head))
    facts = {
        **tracked.facts,
        **facts_of(performance),
        "head": head,
    }
    rig, paths = match_videos_to_rig(videos, rig)
    forward = performance.neutral.rotation[:, 2]
    view = choose_view(rig, paths, tracked.trajectories, forward)
    n_preview = len(tracked.trajectories.time_s)
    step = max(1, round((tracked.trajectories.rate_hz or 60.0) / 30.0))
    with tempfile.TemporaryDirectory() as scratch:
        source = Path(scratch) / "source.mp4"
        start = time.perf_counter()
        with Ticks(-(-n_preview // step), "preview") as tick:
            n = write_previews(
                folder / "preview.mp4", source, view, tracked.trajectories, animation, head,
                on_frame=tick,
            )  # fmt: skip
        facts["preview_frames_per_second"] = n / (time.perf_counter() - start)
        write_report(folder, source, head, performance, facts)
    return AnimateResult(tracked, performance, facts)
