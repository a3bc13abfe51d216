"""`facewright track`: videos to trajectories."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import (
    JsonOption,
    MarkersOption,
    NeutralOption,
    ReportOption,
    find_marker_set,
    find_rig,
    note,
    parse_when,
    writable_file,
    writable_folder,
)
from .progress import Ticks
from .tables import print_table, write_json

if TYPE_CHECKING:
    from ..core.markers import MarkerSet
    from ..core.person import Person
    from ..core.rig import Rig
    from ..core.trajectories import Trajectories
    from ..tracking.long_takes import LongSettings, LongTake

RigOption = Annotated[
    Path | None,
    typer.Option("--rig", metavar="rig.json", help="Default: rig.json beside the videos."),
]
LevelOption = Annotated[
    float | None, typer.Option(help="Grey level above which a pixel is a dot's. Default: found.")
]
ColourOption = Annotated[
    str | None,
    typer.Option(
        help="Colour of the markers: white, black, red, green, blue, yellow, cyan, magenta. "
        "Default: found."
    ),
]
RateOption = Annotated[
    float | None,
    typer.Option(min=1.0, help="Frames a second as filmed, where the files say a wrong rate."),
]
MaxGapOption = Annotated[
    float, typer.Option(min=0.0, help="Longest gap that is filled, in seconds.")
]
RefineOption = Annotated[
    bool,
    typer.Option(
        "--refine-rig", help="Estimate cameras anew that were moved. Default: leave them out."
    ),
]
DEFAULT_MAX_GAP_S = 3.0


@dataclass(frozen=True, eq=False)
class TrackResult:
    """What tracking found, with the figures that go with it.

    Attributes
    ----------
    take : LongTake
    trajectories : Trajectories or None
        Where they were asked for.
    facts : dict
    """

    take: LongTake
    trajectories: Trajectories | None
    facts: dict[str, Any]


def track(
    videos: Annotated[list[Path], typer.Argument(metavar="VIDEO", help="One a camera.")],
    rig: RigOption = None,
    markers: MarkersOption = None,
    neutral: NeutralOption = "0",
    person: Annotated[
        Path | None,
        typer.Option(metavar="person.npz", help="Whose face it is, from --save-person."),
    ] = None,
    save_person: Annotated[
        Path | None,
        typer.Option(metavar="person.npz", help="Keep this face, to label other takes by."),
    ] = None,
    face: Annotated[int, typer.Option(min=0, help="Of several faces, which; 0 is seen most.")] = 0,
    colour: ColourOption = None,
    level: LevelOption = None,
    rate: RateOption = None,
    refine_rig: RefineOption = False,
    max_gap: MaxGapOption = DEFAULT_MAX_GAP_S,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="markers.c3d", help="Default: markers.c3d beside the videos."
        ),
    ] = None,
    samples: Annotated[
        Path | None,
        typer.Option(
            metavar="samples.npz",
            help="Also all that is known of each sample, covariances too; held in memory.",
        ),
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Also each camera's video with the tracks over it."),
    ] = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Follow markers through the videos of a calibrated camera rig, in space.

    Takes of any length; a run that was stopped goes on where it was when called again. The report
    shows gaps, repairs and noise, and the markers in 3-D.
    """
    from ..core.formats.person_npz import read_person_npz, write_person_npz
    from ..core.formats.samples_npz import write_samples_npz
    from ..tracking.long_takes import LongSettings

    out = writable_file(out or videos[0].parent / "markers.c3d", (".c3d",))
    for path, suffix in ((samples, ".npz"), (save_person, ".npz"), (report, ".html")):
        if path is not None:
            writable_file(path, (suffix,))
    marker_set = find_marker_set(markers, videos[0].parent)
    if marker_set is None:
        note("no marker set given: trajectories stay unlabelled")
    known = None if person is None else read_person_npz(person)
    cameras = find_rig(rig, videos)
    frame, seconds = parse_when(neutral)
    settings = LongSettings(
        level=level, colour=colour, rate_hz=rate, refine_rig=refine_rig, max_gap_s=max_gap,
        neutral_frame=frame, neutral_s=seconds, face=face,
    )  # fmt: skip
    keep = any(path is not None for path in (samples, overlay, report))
    result = run_track(videos, cameras, out, marker_set, settings, person=known, keep=keep)
    print_table(("measured", "value"), [(k.replace("_", " "), v) for k, v in result.facts.items()])
    note(f"wrote {out}")
    if json_file is not None:
        write_json(json_file, result.facts)
    if save_person is not None:
        if result.take.person is None:
            note("no person kept: there was no marker set to name markers by")
        else:
            write_person_npz(save_person, result.take.person)
            note(f"wrote {save_person}")
    if result.trajectories is not None:
        if samples is not None:
            write_samples_npz(samples, result.trajectories)
            note(f"wrote {samples}")
        _pictures(videos, cameras, marker_set, result, overlay, report)


def run_track(
    videos: Sequence[Path],
    rig: Rig,
    out: Path,
    marker_set: MarkerSet | None,
    settings: LongSettings,
    *,
    person: Person | None = None,
    keep: bool = True,
) -> TrackResult:
    """Track, label, fill gaps and write the C3D file, with a progress bar.

    Parameters
    ----------
    keep : bool
        Hand back the trajectories too: they take memory in proportion to the take's length.
    """
    from ..core.video import probe_video
    from ..tracking.long_takes import track_long
    from ..tracking.videos import warm_up

    warm_up()
    pieces: list[Trajectories] = []
    total = probe_video(videos[0]).n_frames
    start = time.perf_counter()
    with Ticks(total, "tracking") as tick:
        take = track_long(
            videos, rig, out, marker_set=marker_set, person=person, settings=settings,
            on_frame=tick, on_resume=_resumed, on_chunk=pieces.append if keep else None,
        )  # fmt: skip
    took_s = time.perf_counter() - start
    for text in take.notes:
        note(text)
    never = [n for n, seen in zip(take.names, take.n_measured, strict=True) if not seen]
    if never and marker_set is not None:
        note(f"never seen: {', '.join(never)}")
    facts: dict[str, Any] = {
        "frames": take.n_frames,
        "markers": len(take.names) - len(never),
        "camera_frames_per_second": take.n_frames * len(videos) / took_s,
        "reprojection_rms_px": take.reprojection_rms_px,
    }
    if take.labelling is not None:
        facts |= {
            "samples_filled": int(take.n_filled.sum()),
            "samples_missing": int(take.n_missing.sum()),
            "repairs": len(take.repairs),
            "template_distance_mm": take.labelling.mean_distance_mm,
        }
    return TrackResult(take, joined(pieces) if keep else None, facts)


def _resumed(seconds: float) -> None:
    note(f"going on from an interrupted run: {seconds:.0f} s are done")


def joined(pieces: Sequence[Trajectories]) -> Trajectories:
    """Trajectories of the same markers, one after the other."""
    import numpy as np

    first = pieces[0]
    parts: dict[str, Any] = {
        name: np.concatenate([getattr(piece, name) for piece in pieces])
        for name in ("time_s", "positions", "covariances", "source", "residual_px", "n_views")
        if getattr(first, name) is not None
    }
    return replace(first, **parts)


def _pictures(
    videos: Sequence[Path],
    rig: Rig,
    marker_set: MarkerSet | None,
    result: TrackResult,
    overlay: Path | None,
    report: Path | None,
) -> None:
    import tempfile

    from .tracking_report import write_tracking_report

    tracks = result.trajectories
    assert tracks is not None
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if overlay is None else writable_folder(overlay)
        overlays = _overlays(videos, rig, tracks, folder)
        if overlay is not None:
            note(f"wrote {', '.join(str(path) for path in overlays.values())}")
        if report is not None:
            picture = write_tracking_report(
                report, tracks, marker_set, result.facts, result.take.repairs, overlays
            )
            note(f"wrote {report} and {picture.name}")


def _overlays(
    videos: Sequence[Path], rig: Rig, tracks: Trajectories, folder: Path
) -> Mapping[str, Path]:
    from ..core.video import probe_video
    from .overlay import write_overlay

    found = {}
    for video in videos:
        path = folder / f"tracks_{video.stem}.mp4"
        with Ticks(probe_video(video).n_frames, f"drawing {video.stem}") as tick:
            write_overlay(path, video, rig[video.stem], tracks, on_frame=tick)
        found[video.stem] = path
    return found
