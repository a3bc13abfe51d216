"""`facewright calibrate rig`: where the cameras of a rig stand, from what they all saw."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.errors import InputError
from .camera_files import OUT_HELP, writable_cameras, write_cameras
from .options import JsonOption, ReportOption, note, writable_file
from .rig_clocks import SYNCS, Step, clocks_of
from .rig_sightings import collect
from .synth_board import BoardOption

if TYPE_CHECKING:
    from ..capture.calibration_take import TakeCamera
    from ..core.rig import Rig
    from .calibration_report import CalibrationReport

#: A moment shows a few balls of a wand where it would show dozens of a board's corners.
_MOMENTS_PER_VIEW = 4


def rig(
    take: Annotated[
        Path,
        typer.Argument(
            metavar="TAKE_DIR", help="cam0.mp4, cam1.mp4, ... or cam0/, cam1/, ... of pictures."
        ),
    ],
    board: BoardOption = "chessboard:9x6:25",
    wand: Annotated[
        str | None,
        typer.Option(
            metavar="0,45,120",
            help="Instead of a board: a waved wand, and where its bright balls sit on it, mm.",
        ),
    ] = None,
    markers: Annotated[
        bool,
        typer.Option(
            "--markers", help="Refine --rig by the performer's markers; which cameras moved?"
        ),
    ] = False,
    existing: Annotated[
        Path | None,
        typer.Option("--rig", metavar="rig.json", help="For --markers. Default: in TAKE_DIR."),
    ] = None,
    world: Annotated[
        str,
        typer.Option(
            metavar="camera|VIEW|head",
            help="World frame: that of the first camera; of the board in a view; or of a head "
            "where the cameras' axes meet.",
        ),
    ] = "camera",
    lenses: Annotated[
        Path | None,
        typer.Option("--lenses", metavar="rig.json", help="Known lenses: kept as they are."),
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="Lens model of all cameras; see calibrate board.")
    ] = None,
    sync: Annotated[
        str,
        typer.Option(
            metavar="HOW",
            help="How videos that did not start together are brought into step: none, sound, "
            "flash, flash-light or motion (of the board).",
        ),
    ] = "none",
    max_offset: Annotated[
        float, typer.Option(min=0.01, help="How far apart videos may have started, s.")
    ] = 30.0,
    exposure: Annotated[
        float, typer.Option(min=0.0, max=1000.0, help="For flashes: exposure of a frame, ms.")
    ] = 0.0,
    shutter: Annotated[
        bool, typer.Option(help="Look for a rolling shutter where the board moves most.")
    ] = True,
    distance: Annotated[
        float, typer.Option(min=1.0, help="Where a lens's uncertainty is told, mm.")
    ] = 750.0,
    max_views: Annotated[
        int, typer.Option(min=2, max=5000, help="Most moments taken from videos.")
    ] = 100,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="rig.json", help=f"{OUT_HELP} Default: in TAKE_DIR."),
    ] = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Cameras of a rig from a board (or a wand, or markers) that several see at the same time.

    BOARD is one of chessboard:COLSxROWS:MM and circles:COLSxROWS:MM[:asymmetric], which count inner
    corners and dots, or charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY[:legacy], which counts
    squares; for example charuco:8x5:30:22:DICT_5X5_100.

    --sync none takes the first frames of all videos to be of one moment, and counts from there by
    their time stamps. flash: the moments when it became bright, known to about the time between
    frames (several flashes make it surer, and so does --exposure). flash-light: a flash that lights
    the whole room alike also tells by how far it has died away; needs pictures linear in light.

    --world head: the origin lies where the cameras' optical axes come nearest to each other, y
    points up (against the mean image-down of the cameras), z level towards the mean camera.
    A rig refined by markers stays in its world unless head is asked for.
    """
    check_usage(sync, exposure, wand, markers, existing, lenses, model, world)
    from ..capture.calibration_take import find_take
    from .calibration_report import show_tables, write_calibration_report
    from .tables import write_json

    step = Step(sync, max_offset, 1e-3 * exposure)
    cameras = find_take(take)
    out = writable_cameras(out or _default_out(take))
    for path, suffixes in ((report, (".html",)), (json_file, ())):
        if path is not None:
            writable_file(path, suffixes)
    if markers:
        result = _by_markers(cameras, existing, world)
    elif wand is not None:
        result = _by_wand(cameras, wand, lenses, model, step, world, max_views)
    else:
        result = _by_board(cameras, board, lenses, model, step, world, max_views, shutter, distance)
    found, shown, told = result
    show_tables(shown)
    if json_file is not None:
        write_json(json_file, told)
    if report is not None:
        picture = write_calibration_report(report, shown)
        note(f"wrote {report} and {picture.name}")
    write_cameras(out, found)


def check_usage(
    sync: str,
    exposure: float,
    wand: str | None,
    markers: bool,
    existing: Path | None,
    lenses: Path | None,
    model: str | None,
    world: str,
) -> None:
    """Wrong usage where options do not go together."""
    from .calibrate_board import check_model

    def refuse(name: str, told: str) -> None:
        raise typer.BadParameter(told, param_hint=name)

    if sync not in SYNCS:
        refuse("--sync", f"expected {', '.join(SYNCS)}")
    if exposure and not sync.startswith("flash"):
        refuse("--exposure", "is used with --sync flash alone")
    check_model(model)
    if lenses is not None and model is not None and wand is None:
        refuse("--model", "with --lenses the lenses are known")
    if markers and wand is not None:
        refuse("--markers", "give either --wand or --markers")
    if existing is not None and not markers:
        refuse("--rig", "is used with --markers alone (known lenses are --lenses)")
    if markers and sync != "none":
        refuse("--sync", "markers need videos that began together")
    if markers and (lenses is not None or model is not None):
        refuse("--lenses", "with --markers the lenses of --rig are kept")
    if (markers or wand is not None) and world not in ("camera", "head"):
        refuse("--world", "expected camera or head: only a board has a frame of its own")


#: The cameras, what is shown, and what is written for machines.
Outcome = tuple["Rig", "CalibrationReport", dict[str, Any]]


def _by_board(
    cameras: Sequence[TakeCamera],
    board: str,
    lenses: Path | None,
    model: str | None,
    step: Step,
    world: str,
    max_views: int,
    shutter: bool,
    distance: float,
) -> Outcome:
    from ..core.boards import parse_board
    from ..core.formats.rig_files import read_any_rig
    from .rig_from_board import rig_by_board
    from .rig_report import rig_json, rig_report

    pattern = parse_board(board)
    known = None if lenses is None else read_any_rig(lenses).cameras
    seen = collect(cameras, pattern, step, max_views=max_views, known=known)
    result = rig_by_board(seen, pattern, known, model, world, look_at_shutters=shutter)
    return result.found.rig, rig_report(result, distance), rig_json(result)


def _by_wand(
    cameras: Sequence[TakeCamera],
    wand: str,
    lenses: Path | None,
    model: str | None,
    step: Step,
    world: str,
    max_views: int,
) -> Outcome:
    from dataclasses import replace

    from ..core.formats.rig_files import read_any_rig
    from .marker_rig_report import wand_json, wand_report
    from .rig_from_board import around_head
    from .rig_from_markers import parse_wand, rig_by_wand

    balls = parse_wand(wand)
    if lenses is None:
        raise InputError("a wand needs known lenses: give them with --lenses (calibrate board)")
    known = read_any_rig(lenses).cameras
    videos = {c.name: c.video for c in cameras if c.video is not None}
    clocks = clocks_of(videos, step) if videos and step.by not in ("none", "motion") else None
    result = rig_by_wand(
        cameras,
        balls,
        known,
        model=model,
        clocks=clocks,
        by_motion=step.by == "motion",
        max_offset_s=step.max_offset_s,
        max_moments=_MOMENTS_PER_VIEW * max_views,
    )
    if world == "head":
        result = replace(result, found=around_head(result.found))
    return result.found.rig, wand_report(result), wand_json(result)


def _by_markers(cameras: Sequence[TakeCamera], existing: Path | None, world: str) -> Outcome:
    from dataclasses import replace

    from ..capture.rig_world import head_from_world
    from .marker_rig_report import marker_json, marker_report
    from .options import find_rig
    from .rig_from_board import around_head
    from .rig_from_markers import rig_by_markers

    videos = [c.video for c in cameras if c.video is not None]
    if not videos:
        raise InputError("markers are found in videos: this take has folders of pictures")
    result = rig_by_markers(cameras, find_rig(existing, videos))
    if world == "head":
        points = head_from_world(result.found.rig).apply(result.points)
        result = replace(result, found=around_head(result.found), points=points)
    return result.found.rig, marker_report(result), marker_json(result)


def _default_out(take: Path) -> Path:
    wanted = take / "rig.json"
    if not wanted.exists():
        return wanted
    other = take / "calibrated_rig.json"
    note(f"{wanted} is there already and is kept: writing {other}")
    return other
