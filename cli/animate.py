"""`facewright animate`: videos of a performance to an animated head."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.errors import InputError
from .animate_plain import PlainOptions
from .faps import facts_of, run_faps
from .heads import check_head, find_head
from .options import (
    HeadOption,
    JsonOption,
    MarkersOption,
    find_marker_set,
    find_rig,
    note,
    parse_when,
    writable_file,
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
    markerless: Annotated[
        bool,
        typer.Option(
            "--markerless", help="An ordinary video of a face. Default: where there is no set."
        ),
    ] = False,
    neutral: Annotated[
        str | None,
        typer.Option(
            "--neutral",
            metavar="WHEN",
            help="The neutral face: a frame number, or seconds with an s; without markers also a "
            "file of --save-neutral. Default: frame 0; without markers it is found.",
        ),
    ] = None,
    save_neutral: Annotated[
        Path | None,
        typer.Option(
            "--save-neutral", metavar="FILE.npz", help="Without markers: keep the person's face."
        ),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(
            "--points",
            metavar="CSV",
            help="Without markers: points marked in one frame (columns frame,name,x,y), where the "
            "face networks are missing or see nothing.",
        ),
    ] = None,
    face: Annotated[
        int,
        typer.Option(
            "--face", min=0, help="Without markers, of several faces: which; 0 is the largest."
        ),
    ] = 0,
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
    """Videos of a performance, with markers or without, to a head that moves.

    With markers the cameras must be calibrated; without, one ordinary video is enough. Writes
    performance.fap, head.glb, preview.mp4 and report.html; markers.c3d or arkit.csv besides.
    """
    from ..tracking.long_takes import LongSettings

    check_head(head)  # a wrong name is said before the work
    marker_set = None if markerless else find_marker_set(markers, videos[0].parent)
    if markerless and markers is not None:
        raise typer.BadParameter("--markers and --markerless exclude each other")
    default = videos[0].parent / "animation"
    if marker_set is None:
        if not markerless:
            note(f"no marker set given or beside {videos[0]}: taken as a face without markers")
        how = PlainOptions(head, neutral, face, save_neutral, points)
        _without_markers(videos, rig, out or default, how, json_file)
        return
    cameras = find_rig(rig, videos)
    folder = writable_folder(out or default)
    neutral = "0" if neutral is None else neutral
    frame, seconds = parse_when(neutral)
    settings = LongSettings(
        level=level, colour=colour, rate_hz=rate, refine_rig=refine_rig, max_gap_s=max_gap,
        neutral_frame=frame, neutral_s=seconds,
    )  # fmt: skip
    result = run_animate(videos, cameras, marker_set, folder, settings, head=head, neutral=neutral)
    _print_facts(result.facts)
    note(f"wrote {folder}/ markers.c3d performance.fap head.glb preview.mp4 report.html")
    if json_file is not None:
        write_json(json_file, result.facts)


def _without_markers(
    videos: Sequence[Path],
    rig_file: Path | None,
    folder: Path,
    how: PlainOptions,
    json_file: Path | None,
) -> None:
    from ..tracking.videos import match_videos_to_rig
    from .animate_plain import run_plain

    cameras = _cameras(videos, rig_file)
    if cameras is not None:
        cameras, paths = match_videos_to_rig(videos, cameras, at_least=1)
        videos = list(paths.values())
    if how.save_neutral is not None:
        writable_file(how.save_neutral, (".npz",))
    result = run_plain(videos, cameras, writable_folder(folder), how)
    _print_facts(result.facts)
    note(f"wrote {folder}/ performance.fap arkit.csv head.glb preview.mp4 report.html")
    if json_file is not None:
        write_json(json_file, result.facts)


def _cameras(videos: Sequence[Path], rig_file: Path | None) -> Rig | None:
    """The cameras given, or beside the videos; None for one video of a camera that is not known."""
    beside = videos[0].parent / "rig.json"
    if rig_file is None and not beside.exists():
        if len(videos) > 1:
            raise InputError(f"{len(videos)} videos need a camera rig: give --rig, or put {beside}")
        return None
    found = find_rig(rig_file, videos)
    if rig_file is None and len(videos) == 1 and videos[0].stem not in found.cameras:
        note(f"{beside} has no camera {videos[0].stem}: the focal length is estimated")
        return None
    return found


def _print_facts(facts: dict[str, Any]) -> None:
    rows = [(k.replace("_", " "), v) for k, v in facts.items() if not isinstance(v, list | dict)]
    print_table(("measured", "value"), rows)


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
    from .preview import choose_view, preview_step, source_panels, write_previews
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
    rate_hz = tracks.rate_hz or 60.0
    step = preview_step(rate_hz)
    with tempfile.TemporaryDirectory() as scratch:
        source = Path(scratch) / "source.mp4"
        start = time.perf_counter()
        with Ticks(-(-n_preview // step), "preview") as tick:
            n = write_previews(
                folder / "preview.mp4", source, source_panels(view, tracks, step),
                rate_hz / step, animation, head, on_frame=tick,
            )  # fmt: skip
        facts["preview_frames_per_second"] = n / (time.perf_counter() - start)
        write_report(folder, source, head, performance, facts)
    return AnimateResult(tracked, performance, facts)
