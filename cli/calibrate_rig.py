"""`facewright calibrate rig`: where the cameras of a rig stand, from a board that they all saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.errors import InputError
from .options import JsonOption, ReportOption, note, writable_file
from .progress import Ticks, progress
from .synth_board import BoardOption

if TYPE_CHECKING:
    from ..capture.board_detection import Detection
    from ..capture.calibration_take import TakeCamera, TimedDetections
    from ..capture.lens import BoardView, LensCalibration, RejectedView
    from ..capture.rigs import RigCalibration
    from ..capture.synchronise import ClockFit
    from ..core.boards import Board
    from ..core.camera import Camera

_LOOKS_PER_S = 8.0
_MIN_LENS_VIEWS = 4
_SAME_RATE = 0.01
#: A best offset so near to the end of the search is none.
_AT_LIMIT = 0.97


@dataclass(frozen=True, eq=False)
class Sightings:
    """What a take shows of the board.

    Attributes
    ----------
    image_sizes : mapping from camera to (width, height), px
    views : mapping from camera to its views
        Views of the same name were taken at the same moment.
    rejected : tuple of RejectedView
        Named CAMERA/VIEW.
    clocks : mapping from camera to ClockFit
        Against the first camera; empty if nothing was synchronised.
    """

    image_sizes: Mapping[str, tuple[int, int]]
    views: Mapping[str, list[BoardView]]
    rejected: tuple[RejectedView, ...]
    clocks: Mapping[str, ClockFit]


@dataclass(frozen=True, eq=False)
class RigResult:
    """A calibrated rig with all that its report tells.

    Attributes
    ----------
    found : RigCalibration
        Its rejected views and warnings include those of detection and of the lenses.
    lenses : mapping from camera to LensCalibration
        Empty where lenses were given.
    views : mapping from camera to views
        As handed to the solver.
    clocks : mapping from camera to ClockFit
    board : Board
    """

    found: RigCalibration
    lenses: Mapping[str, LensCalibration]
    views: Mapping[str, list[BoardView]]
    clocks: Mapping[str, ClockFit]
    board: Board


def rig(
    take: Annotated[
        Path,
        typer.Argument(
            metavar="TAKE_DIR", help="cam0.mp4, cam1.mp4, ... or cam0/, cam1/, ... of pictures."
        ),
    ],
    board: BoardOption = "chessboard:9x6:25",
    world: Annotated[
        str,
        typer.Option(
            metavar="camera|VIEW",
            help="World frame: that of the first camera, or of the board in a view.",
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
            metavar="none|sound|motion",
            help="How videos that did not start together are brought into step.",
        ),
    ] = "none",
    max_offset: Annotated[
        float, typer.Option(min=0.01, help="How far apart videos may have started, s.")
    ] = 30.0,
    distance: Annotated[
        float, typer.Option(min=1.0, help="Where a lens's uncertainty is told, mm.")
    ] = 750.0,
    max_views: Annotated[
        int, typer.Option(min=2, max=5000, help="Most moments taken from videos.")
    ] = 100,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="rig.json", help="Default: rig.json in TAKE_DIR."),
    ] = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Cameras of a rig from a board that several of them see at the same time."""
    if sync not in ("none", "sound", "motion"):
        raise typer.BadParameter("expected none, sound or motion", param_hint="--sync")
    from ..capture.calibration_take import find_take
    from ..core.boards import parse_board
    from ..core.formats.rig_json import read_rig, write_rig
    from .calibrate_board import check_model
    from .calibration_report import show_tables, write_calibration_report
    from .rig_report import rig_json, rig_report
    from .tables import write_json

    check_model(model)
    pattern = parse_board(board)
    cameras = find_take(take)
    out = writable_file(out or _default_out(take), (".json",))
    if report is not None:
        writable_file(report, (".html",))
    known = None if lenses is None else read_rig(lenses).cameras
    seen = collect(cameras, pattern, sync, max_views, max_offset_s=max_offset)
    result = calibrate(seen, pattern, known, model, world)
    shown = rig_report(result, distance)
    write_rig(out, result.found.rig)
    show_tables(shown)
    note(f"wrote {out}")
    if report is not None:
        picture = write_calibration_report(report, shown)
        note(f"wrote {report} and {picture.name}")
    if json_file is not None:
        write_json(json_file, rig_json(result))


def _default_out(take: Path) -> Path:
    wanted = take / "rig.json"
    if not wanted.exists():
        return wanted
    other = take / "calibrated_rig.json"
    note(f"{wanted} is there already and is kept: writing {other}")
    return other


def collect(
    cameras: Sequence[TakeCamera],
    pattern: Board,
    sync: str,
    max_views: int,
    *,
    max_offset_s: float = 30.0,
) -> Sightings:
    """Find the board in everything that the cameras recorded.

    Raises
    ------
    InputError
        If pictures of one camera differ in size, or videos cannot be brought into step.
    FileFormatError
        If a file is no picture or no video.
    """
    from ..capture.calibration_take import detect_in_pictures, views_of_pictures

    if cameras[0].video is not None:
        return _collect_videos(cameras, pattern, sync, max_views, max_offset_s)
    if sync != "none":
        raise InputError(f"--sync {sync} needs videos: pictures of the same name belong together")
    sizes, found = {}, {}
    for camera in cameras:
        shown = progress(camera.pictures, len(camera.pictures), f"searching {camera.name}")
        # cam1/007.png belongs to cam0/007.jpg
        sizes[camera.name], found[camera.name] = detect_in_pictures(
            shown, pattern, names=lambda path: path.stem
        )
    return Sightings(sizes, views_of_pictures(found), _unseen(found), {})


def _unseen(found: Mapping[str, Sequence[Detection]]) -> tuple[RejectedView, ...]:
    from ..capture.lens import RejectedView

    return tuple(
        RejectedView(f"{camera}/{d.name}", d.reason or "no board")
        for camera, seen in found.items()
        for d in seen
        if d.view is None
    )


def _collect_videos(
    cameras: Sequence[TakeCamera], pattern: Board, sync: str, max_views: int, max_offset_s: float
) -> Sightings:
    from ..capture.calibration_take import views_at_moments, views_of_frames
    from ..core.video import probe_video

    videos = {c.name: c.video for c in cameras if c.video is not None}
    infos = {name: probe_video(path) for name, path in videos.items()}
    rates = {name: info.rate_hz for name, info in infos.items()}
    first = cameras[0].name
    if sync == "none":
        odd = [n for n, r in rates.items() if abs(r - rates[first]) > _SAME_RATE * rates[first]]
        if odd:
            raise InputError(
                f"{videos[odd[0]]} has {rates[odd[0]]:.2f} frames a second, {first} "
                f"{rates[first]:.2f}: bring them into step with --sync sound or --sync motion"
            )
    stride = max(1, round(rates[first] / _LOOKS_PER_S))
    frames = {name: info.n_frames for name, info in infos.items()}
    if sync == "motion":
        whole = {n: _searched(n, path, pattern, frames[n], 1) for n, path in videos.items()}
        clocks = _clocks_by_motion(whole, pattern, max_offset_s)
        moments = _moments(whole[first], stride)
        views = views_at_moments(whole, clocks, moments, pattern, max_views=max_views)
        return Sightings(_sizes(whole), views, (), clocks)
    if sync == "sound":
        clocks = _clocks_by_sound(videos, max_offset_s)
        seen = {first: _searched(first, videos[first], pattern, frames[first], stride)}
        moments = _moments(seen[first], 1)
        for name in list(videos)[1:]:
            wanted = clocks[name].other_s([t for _, t in moments]).tolist()
            seen[name] = _searched(
                name, videos[name], pattern, frames[name], 1, wanted, 1.05 / rates[name]
            )
        views = views_at_moments(seen, clocks, moments, pattern, max_views=max_views)
        return Sightings(_sizes(seen), views, (), clocks)
    seen = {n: _searched(n, path, pattern, frames[n], stride) for n, path in videos.items()}
    return Sightings(_sizes(seen), views_of_frames(seen, max_views=max_views), (), {})


def _searched(
    name: str,
    path: Path,
    pattern: Board,
    n_frames: int | None,
    stride: int,
    wanted_s: Sequence[float] | None = None,
    within_s: float = 0.0,
) -> TimedDetections:
    """The board in one of so many frames, or in those near to wanted times."""
    import numpy as np

    from ..capture.calibration_take import detect_in_video

    def is_wanted(index: int, time_s: float) -> bool:
        if wanted_s is None:
            return index % stride == 0
        return bool(np.abs(np.asarray(wanted_s) - time_s).min() <= within_s)

    with Ticks(n_frames, f"searching {name}") as tick:
        return detect_in_video(path, pattern, is_wanted=is_wanted, on_frame=tick)


def _moments(seen: TimedDetections, stride: int) -> list[tuple[str, float]]:
    pairs = zip(seen.detections, seen.time_s, strict=True)
    return [(d.name, float(t)) for d, t in list(pairs)[::stride]]


def _sizes(seen: Mapping[str, TimedDetections]) -> dict[str, tuple[int, int]]:
    return {name: found.image_size for name, found in seen.items()}


def _clocks_by_sound(videos: Mapping[str, Path], max_offset_s: float) -> dict[str, ClockFit]:
    from ..capture.synchronise import synchronise_sound
    from ..core.audio import read_audio

    first, *others = videos
    reference = read_audio(videos[first])
    clocks = {}
    for name in others:
        try:
            clocks[name] = synchronise_sound(
                reference, read_audio(videos[name]), max_offset_s=max_offset_s
            )
        except InputError as error:
            raise InputError(f"{videos[name]} against {first}: {error}") from error
    return clocks


def _clocks_by_motion(
    seen: Mapping[str, TimedDetections], pattern: Board, max_offset_s: float
) -> dict[str, ClockFit]:
    from ..capture.calibration_take import motion_of
    from ..capture.synchronise import synchronise_motion

    first, *others = seen
    reference = motion_of(seen[first], pattern)
    clocks = {}
    for name in others:
        other = motion_of(seen[name], pattern)
        # half of both must overlap, or a short stretch may fit by chance
        most_s = min(max_offset_s, 0.5 * float(min(reference[0][-1], other[0][-1])))
        try:
            clock = synchronise_motion(*reference, *other, max_offset_s=most_s)
        except InputError as error:
            raise InputError(f"{name} against {first}: {error}") from error
        if abs(clock.offset_s) > _AT_LIMIT * most_s:
            raise InputError(
                f"{name} against {first}: within {most_s:.2g} s the board's motion does not tell "
                "the offset; move it faster and for longer, or say how little it can be with "
                "--max-offset"
            )
        clocks[name] = clock
    return clocks


def calibrate(
    seen: Sightings,
    pattern: Board,
    known: Mapping[str, Camera] | None,
    model: str | None,
    world: str,
) -> RigResult:
    """Lenses from each camera's own views (unless known), then all cameras together.

    Raises
    ------
    InputError
        If two cameras do not share views, or a lens cannot be found.
    """
    from dataclasses import replace

    from ..capture.board_turns import agree_on_turns
    from ..capture.rigs import calibrate_rig

    blind = [name for name, views in seen.views.items() if not views]
    views = {name: list(found) for name, found in seen.views.items() if found}
    if len(views) < 2:
        raise InputError(_nobody(seen, pattern, views))
    rejected = list(seen.rejected)
    lenses, found_lenses = dict(known or {}), {}
    if known is None:
        for name in progress(list(views), len(views), "lenses"):
            found_lenses[name], views[name], bad = _lens(name, views[name], seen, model)
            lenses[name] = found_lenses[name].camera
            rejected += bad
    else:
        _check_known(known, seen)
    views, n_turned = agree_on_turns(views, lenses, pattern)
    if n_turned:
        note(f"{pattern} looks the same when turned: {n_turned} views were turned to agree")
    refine = {name: lens.model for name, lens in found_lenses.items()}
    found = calibrate_rig(views, lenses, refine=refine, world=world)
    said = [f"{name}: never saw the board, and is left out" for name in blind]
    said += [
        f"{name}: {warning}" for name, lens in found_lenses.items() for warning in lens.warnings
    ]
    found = replace(
        found,
        views_rejected=(*rejected, *found.views_rejected),
        unconnected=(*found.unconnected, *blind),
        warnings=(*found.warnings, *said),
    )
    return RigResult(found, found_lenses, views, seen.clocks, pattern)


def _nobody(seen: Sightings, pattern: Board, views: Mapping[str, object]) -> str:
    if views:
        return f"only {next(iter(views))} sees {pattern}: two cameras must see it together"
    first = "; ".join(f"{r.name}: {r.reason}" for r in seen.rejected[:3])
    if seen.rejected:
        return f"no picture shows {pattern} ({first})"
    return f"no frame shows {pattern} to two cameras at the same time"


def _lens(
    name: str, views: list[BoardView], seen: Sightings, model: str | None
) -> tuple[LensCalibration, list[BoardView], list[RejectedView]]:
    """A camera's lens, the views that are good, and the others."""
    from ..capture.calibration_take import without_repeats
    from ..capture.lens import RejectedView, calibrate_board

    different, _ = without_repeats(views)  # others may see there what this one sees twice
    if len(different) < _MIN_LENS_VIEWS:
        raise InputError(
            f"{name} shows the board in {len(different)} different poses: "
            f"{_MIN_LENS_VIEWS} are the least for its lens; take more, or give --lenses"
        )
    lens = calibrate_board(different, seen.image_sizes[name], model=model)
    bad = {r.name for r in lens.views_rejected}
    out = [RejectedView(f"{name}/{r.name}", r.reason) for r in lens.views_rejected]
    return lens, [v for v in views if v.name not in bad], out


def _check_known(known: Mapping[str, Camera], seen: Sightings) -> None:
    for name, size in seen.image_sizes.items():
        if name in known and known[name].image_size != size:
            w, h = known[name].image_size
            raise InputError(
                f"the lens of {name} is for pictures of {w}x{h}, but they are {size[0]}x{size[1]}"
            )
