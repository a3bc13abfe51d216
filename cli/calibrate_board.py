"""`facewright calibrate board`: a lens from pictures or a video of a calibration board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.errors import InputError
from .camera_files import OUT_HELP, writable_cameras, write_cameras
from .options import JsonOption, ReportOption, note, writable_file
from .progress import Ticks, progress
from .synth_board import BoardOption

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..capture.board_detection import Detection
    from ..capture.lens import LensCalibration
    from ..core.boards import Board
    from .calibration_report import CalibrationReport
    from .drawing import Drawing

_GRID = (12, 16)  # cells of the uncertainty map
#: A focal length no surer than this share of it is none.
_NO_FOCAL = 0.25
#: No lens sees less than about 1°: more picture widths than this are a fit to noise.
_LONGEST = 50.0


def board(
    inputs: Annotated[
        list[Path],
        typer.Argument(metavar="IMAGES|VIDEO", help="Pictures, a folder of them, or one video."),
    ],
    board: BoardOption = "chessboard:9x6:25",
    model: Annotated[
        str | None,
        typer.Option(
            help="Lens model: none, radial1, radial2, opencv4, opencv5 or opencv8. Default: the "
            "plainest that predicts views it has not seen about as well as any."
        ),
    ] = None,
    bow: Annotated[bool, typer.Option("--bow", help="The board may be bowed.")] = False,
    distance: Annotated[
        float, typer.Option(min=1.0, help="Where the uncertainty is told, mm from the camera.")
    ] = 750.0,
    max_views: Annotated[
        int, typer.Option(min=1, max=1000, help="Most frames taken from a video.")
    ] = 30,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="camera.json",
            help=f"{OUT_HELP} Default: camera.json beside the pictures, VIDEO.camera.json beside a "
            "video.",
        ),
    ] = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """A camera's lens from views of a board, and how sure it is in mm."""
    from ..core.boards import parse_board
    from ..core.rig import Rig
    from .calibration_report import show_tables, write_calibration_report
    from .tables import write_json

    pattern = parse_board(board)
    check_model(model)
    pictures, video = sort_inputs(inputs)
    out = writable_cameras(out or _default_out(pictures, video))
    for path, suffixes in ((report, (".html",)), (json_file, ())):
        if path is not None:
            writable_file(path, suffixes)
    size, detections = _detect(pictures, video, pattern, max_views)
    found = lens_of(detections, size, pattern, model=model, bow=bow)
    shown = board_report(found, distance)
    name = video.stem if video is not None else out.stem
    show_tables(shown)
    if report is not None:
        picture = write_calibration_report(report, shown)
        note(f"wrote {report} and {picture.name}")
    if json_file is not None:
        write_json(json_file, board_json(found, distance))
    write_cameras(out, Rig({name: found.camera}))


def check_model(model: str | None) -> None:
    """Wrong usage where there is no lens model of that name."""
    from ..capture.lens import LENS_MODELS

    if model is not None and model not in LENS_MODELS:
        known = ", ".join(LENS_MODELS)
        raise typer.BadParameter(f"expected one of {known}", param_hint="--model")


def sort_inputs(inputs: Sequence[Path]) -> tuple[list[Path], Path | None]:
    """Pictures (folders opened), or the one video.

    Raises
    ------
    InputError
        If both are given, several videos, or nothing.
    """
    from ..capture.calibration_take import VIDEO_SUFFIXES, pictures_in

    pictures: list[Path] = []
    videos = [p for p in inputs if p.is_file() and p.suffix.lower() in VIDEO_SUFFIXES]
    for path in inputs:
        if path.is_dir():
            inside = pictures_in(path)
            if not inside:
                raise InputError(f"{path}: expected pictures in it, found none")
            pictures += inside
        elif path not in videos:
            pictures.append(path)
    if len(videos) > 1 or (videos and pictures):
        found = f"{len(videos)} videos and {len(pictures)} pictures"
        raise InputError(f"expected pictures or one video of one camera, found {found}")
    return pictures, videos[0] if videos else None


def _default_out(pictures: Sequence[Path], video: Path | None) -> Path:
    return video.with_suffix(".camera.json") if video else pictures[0].parent / "camera.json"


def _detect(
    pictures: Sequence[Path], video: Path | None, pattern: Board, max_views: int
) -> tuple[tuple[int, int], list[Detection]]:
    from ..capture.calibration_take import detect_in_pictures
    from ..capture.view_choice import choose_frames
    from ..core.video import probe_video

    if video is None:
        shown = progress(pictures, len(pictures), "searching")
        return detect_in_pictures(shown, pattern, names=_naming(pictures))
    info = probe_video(video)
    with Ticks(info.n_frames, "choosing frames") as tick:
        chosen = choose_frames(video, pattern, max_views=max_views, on_frame=tick)
    if not chosen:
        raise InputError(f"{video}: no frame shows {pattern} sharply")
    return (info.width, info.height), chosen


def _naming(paths: Sequence[Path]) -> Any:
    """File names, or whole paths where two files have the same name."""
    names = [path.name for path in paths]
    return str if len(set(names)) < len(names) else (lambda path: path.name)


def lens_of(
    detections: Sequence[Detection],
    size: tuple[int, int],
    pattern: Board,
    *,
    model: str | None = None,
    bow: bool = False,
) -> LensCalibration:
    """Calibrate, with the pictures that show no board among the rejected views.

    Raises
    ------
    InputError
        If no picture shows the board, or the views do not tell the focal length.
    """
    from ..capture.board_views import without_repeats
    from ..capture.lens import RejectedView, calibrate_board

    views = [d.view for d in detections if d.view is not None]
    unseen = [RejectedView(d.name, d.reason or "no board") for d in detections if d.view is None]
    if not views:
        first = "; ".join(f"{r.name}: {r.reason}" for r in unseen[:3])
        more = f"; and {len(unseen) - 3} more" if len(unseen) > 3 else ""
        raise InputError(f"no picture shows {pattern} ({first}{more})")
    views, repeated = without_repeats(views)
    found = calibrate_board(views, size, model=model, estimate_bow=bow)
    for p in found.parameters:
        is_lens = 0.0 < p.value < _LONGEST * size[0]
        if p.name in ("f", "fx", "fy") and not (is_lens and p.sd < _NO_FOCAL * p.value):
            n = len(found.views)
            told = f"{n} views are too much alike" if n > 1 else "one view is too frontal"
            raise InputError(
                f"the lens cannot be found: {told} to tell focal length from distance "
                f"({p.name} {p.value:.3g} px, standard deviation {p.sd:.2g}); show the board in "
                "10 poses or more, tilted by 30° to every side"
            )
    return replace(found, views_rejected=(*unseen, *repeated, *found.views_rejected))


def board_report(found: LensCalibration, distance_mm: float) -> CalibrationReport:
    """What was found, in tables and pictures."""
    from ..capture.lens import coverage
    from .calibration_report import (
        CalibrationReport,
        ReportTable,
        parameter_table,
        rejected_table,
    )
    from .tables import Table

    tables = [ReportTable("Parameters", parameter_table(found.parameters))]
    if found.held_out_px:
        best = min(found.held_out_px.values())
        rows = tuple(
            (m, s, 100 * (s / best - 1), "taken" if m == found.model else "")
            for m, s in found.held_out_px.items()
        )
        columns = ("lens model", "px on unseen views", "% above the best", "")
        tables.append(ReportTable("Choice of the lens model", Table(columns, rows)))
    if found.views_rejected:
        tables.append(ReportTable("Not used", rejected_table(found.views_rejected)))
    mm = _mm_grid(found, distance_mm)
    share = coverage(found.views, found.camera.image_size)
    n = len(found.views)
    bowed = f"; the board is bowed by {found.bow_mm:.2f} mm" if found.bow_mm else ""
    summary = (
        f"{n} of {n + len(found.views_rejected)} views, lens model {found.model}: "
        f"RMS {found.rms_used_px:.4g} px; corners cover {100 * share:.0f} % of the picture; at "
        f"{distance_mm:g} mm the lens is sure to {_median(mm):.3g} mm (median over the picture), "
        f"{_worst(mm):.3g} mm at worst{bowed}"
    )
    drawings = lens_drawings("", found, distance_mm)
    title = f"Lens from {n} views"
    return CalibrationReport(title, summary, found.warnings, tuple(tables), tuple(drawings))


def lens_drawings(name: str, found: LensCalibration, distance_mm: float) -> list[Drawing]:
    """Residuals over the picture and by view, and the uncertainty."""
    import numpy as np

    from .calibration_plots import bars, residual_field, uncertainty_map

    size, of = found.camera.image_size, f" of {name}" if name else ""
    pixels = np.concatenate([v.pixels for v in found.views])
    residuals = np.concatenate(found.residuals)
    per_view = [
        (Path(v.name).stem, float(np.sqrt((r**2).sum(axis=1).mean())))
        for v, r in zip(found.views, found.residuals, strict=True)
    ]
    what = f"Standard deviation across the line of sight at {distance_mm:g} mm"
    return [
        residual_field(f"Residuals{of} over the picture", size, pixels, residuals),
        uncertainty_map(
            f"What the lens{of} is sure to", size, _mm_grid(found, distance_mm), pixels, what
        ),
        bars(f"Residuals{of} by view, px", per_view, "px"),
    ]


def board_json(found: LensCalibration, distance_mm: float) -> dict[str, Any]:
    """What was found, for machines."""
    from ..capture.lens import coverage
    from .calibration_report import parameters_json, rejected_json

    mm = _mm_grid(found, distance_mm)
    return {
        "rms_px": found.rms_px,
        "rms_used_px": found.rms_used_px,
        "sd_px": found.sd_px,
        "views_used": [v.name for v in found.views],
        "views_rejected": rejected_json(found.views_rejected),
        "points_used": sum(len(r) for r in found.residuals),
        "parameters": parameters_json(found.parameters),
        "covariance": found.covariance,
        "model": found.model,
        "held_out_px": dict(found.held_out_px),
        "bow_mm": found.bow_mm,
        "coverage": coverage(found.views, found.camera.image_size),
        "distance_mm": distance_mm,
        "uncertainty_mm": {"median": _median(mm), "worst": _worst(mm), "grid": mm},
        "image_size": list(found.camera.image_size),
        "warnings": list(found.warnings),
    }


def _mm_grid(found: LensCalibration, distance_mm: float) -> NDArray[Any]:
    """Standard deviations over the picture, (rows, columns), mm."""
    import numpy as np

    from ..capture.lens import point_sd_mm

    w, h = found.camera.image_size
    rows, columns = _GRID
    y, x = np.mgrid[0:rows, 0:columns] + 0.5
    pixels = np.stack([x * w / columns, y * h / rows], axis=-1) - 0.5
    return np.asarray(point_sd_mm(found, pixels, distance_mm))


def _median(mm: NDArray[Any]) -> float:
    import numpy as np

    return float(np.nanmedian(mm)) if np.isfinite(mm).any() else float("nan")


def _worst(mm: NDArray[Any]) -> float:
    import numpy as np

    return float(np.nanmax(mm)) if np.isfinite(mm).any() else float("nan")
