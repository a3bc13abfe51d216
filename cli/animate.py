"""`facewright animate`: videos of a performance to an animated head."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.errors import InputError
from .faps import facts_of, run_faps
from .heads import check_head, find_head
from .options import (
    HeadOption,
    JsonOption,
    MarkersOption,
    NeutralOption,
    find_marker_set,
    find_rig,
    note,
    parse_when,
    writable_folder,
)
from .progress import Ticks
from .tables import print_table, write_json
from .track import (
    DEFAULT_MAX_GAP_S,
    ColourOption,
    LevelOption,
    MaxGapOption,
    RateOption,
    RefineOption,
    RigOption,
    TrackResult,
    run_track,
)

if TYPE_CHECKING:
    from ..core.markers import MarkerSet
    from ..core.rig import Rig
    from ..tracking.long_takes import LongSettings
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
    rig: RigOption = None,
    markers: MarkersOption = None,
    neutral: NeutralOption = "0",
    colour: ColourOption = None,
    level: LevelOption = None,
    rate: RateOption = None,
    refine_rig: RefineOption = False,
    max_gap: MaxGapOption = DEFAULT_MAX_GAP_S,
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
    from ..tracking.long_takes import LongSettings

    check_head(head)  # a wrong name is said before the work
    marker_set = find_marker_set(markers, videos[0].parent)
    if marker_set is None:
        raise InputError(
            f"a marker set must tell which dot is what: give one with --markers, or put "
            f"markers.toml into {videos[0].parent}"
        )
    cameras = find_rig(rig, videos)
    folder = writable_folder(out or videos[0].parent / "animation")
    frame, seconds = parse_when(neutral)
    settings = LongSettings(
        level=level, colour=colour, rate_hz=rate, refine_rig=refine_rig, max_gap_s=max_gap,
        neutral_frame=frame, neutral_s=seconds,
    )  # fmt: skip
    result = run_animate(videos, cameras, marker_set, folder, settings, head=head, neutral=neutral)
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
    settings: LongSettings,
    *,
    head: str,
    neutral: str = "0",
) -> AnimateResult:
    """The whole way from videos to the animated head; writes all files into a folder."""
    import tempfile
    import time

    from ..core.formats.fap import write_fap
    from ..core.formats.gltf import write_glb
    from ..retarget.drive import HeadDrive
    from ..retarget.export import animation_glb
    from ..tracking.videos import match_videos_to_rig
    from .preview import choose_view, write_previews
    from .report import write_report

    tracked = run_track(videos, rig, folder / "markers.c3d", marker_set, settings)
    tracks = tracked.trajectories
    assert tracks is not None
    performance = run_faps(tracks, marker_set, neutral)
    write_fap(folder / "performance.fap", performance.faps)
    note("animating the head")
    target = find_head(head)
    head = target.name
    animation = HeadDrive(target).animate(performance.faps)
    write_glb(folder / "head.glb", animation_glb(target, animation, name=head))
    facts = {
        **tracked.facts,
        **facts_of(performance),
        "head": head,
    }
    rig, paths = match_videos_to_rig(videos, rig)
    forward = performance.neutral.rotation[:, 2]
    view = choose_view(rig, paths, tracks, forward)
    n_preview = len(tracks.time_s)
    step = max(1, round((tracks.rate_hz or 60.0) / 30.0))
    with tempfile.TemporaryDirectory() as scratch:
        source = Path(scratch) / "source.mp4"
        start = time.perf_counter()
        with Ticks(-(-n_preview // step), "preview") as tick:
            n = write_previews(
                folder / "preview.mp4", source, view, tracks, animation, head,
                on_frame=tick,
            )  # fmt: skip
        facts["preview_frames_per_second"] = n / (time.perf_counter() - start)
        write_report(folder, source, head, performance, facts)
    return AnimateResult(tracked, performance, facts)
