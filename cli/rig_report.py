"""What `facewright calibrate rig` tells of its result."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .calibrate_board import lens_drawings
from .calibration_plots import bars, cameras_in_space, residual_field
from .calibration_report import (
    CalibrationReport,
    ReportTable,
    rejected_table,
)
from .drawing import Drawing
from .rig_tables import (
    across_mm,
    at_face,
    camera_table,
    clock_table,
    common_json,
    distance_table,
    face_drawings,
    face_words,
    lens_table,
    views_used,
)
from .tables import Table

if TYPE_CHECKING:
    from ..capture.rig_uncertainty import TriangulationSd
    from ..capture.shutter_check import ShutterCheck
    from .rig_from_board import RigResult

Floats = NDArray[np.float64]


def rig_report(result: RigResult, distance_mm: float) -> CalibrationReport:
    """What was found, in tables and pictures."""
    found = result.found
    at_board, face = at_board_mm(result), at_face(found)
    tables = [
        ReportTable("Cameras", camera_table(found, at_board, "the board")),
        ReportTable("Distances between cameras", distance_table(found)),
    ]
    if result.lenses:
        tables.append(ReportTable("Lenses", lens_table(found)))
    if result.clocks:
        tables.append(ReportTable("Clocks", clock_table(result.clocks)))
    if result.shutters:
        tables.append(ReportTable("Shutters", _shutter_table(result)))
    if found.views_rejected:
        tables.append(ReportTable("Not used", rejected_table(found.views_rejected)))
    board_mm, n = board_check_mm(result)
    summary = (
        f"{len(found.rig)} cameras, {len(views_used(found))} views: RMS {found.rms_used_px:.4g} "
        f"px; at the board the cameras' poses are sure to {max(at_board.values()):.3g} mm or "
        f"better across the line of sight; {n} points of the board, triangulated, come out where "
        f"they were printed to {board_mm:.3g} mm RMS{face_words(face)}"
    )
    title = f"Rig of {len(found.rig)} cameras"
    drawings = tuple(_drawings(result, distance_mm, face))
    return CalibrationReport(title, summary, found.warnings, tuple(tables), drawings)


def rig_json(result: RigResult) -> dict[str, Any]:
    """What was found, for machines."""
    found = result.found
    board_mm, n = board_check_mm(result)
    return {
        **common_json(found, result.clocks),
        "at_board_mm": at_board_mm(result),
        "board_points_mm": {"rms": board_mm, "points": n},
        "rolling_shutter": {n: _shutter_json(check) for n, check in result.shutters.items()},
        "board_speed_mm_s": {name: speed.mm_s for name, speed in result.speeds.items()},
        "notes": list(result.notes),
        "lens_models": {name: lens.model for name, lens in result.lenses.items()},
    }


def at_board_mm(result: RigResult) -> dict[str, float]:
    """What each pose's uncertainty amounts to at the board, across the line of sight, mm."""
    middle = result.board.object_points().mean(axis=0)
    places = np.stack([pose.apply(middle) for pose in result.found.view_poses.values()])
    return across_mm(result.found, places)


def _shutter_table(result: RigResult) -> Table:
    rows: list[tuple[object, ...]] = []
    for name, check in result.shutters.items():
        read, speed = check.readout, check.speed.mm_s
        if read is None:
            rows.append((name, None, None, speed, None, None, check.reason))
            continue
        told = "rolling" if read.warnings else "none shown"
        row = (1e3 * read.readout_s, 1e3 * read.sd_s, speed, check.bend_px, check.bend_mm, told)
        rows.append((name, *row))
    columns = ("camera", "first to last row ms", "sd ms", "board mm/s", "bend px", "bend mm",
               "rolling shutter")  # fmt: skip
    return Table(columns, tuple(rows))


def _shutter_json(check: ShutterCheck) -> dict[str, Any]:
    read = check.readout
    return {
        "readout_s": None if read is None else read.readout_s,
        "sd_s": None if read is None else read.sd_s,
        "frames": 0 if read is None else read.n_frames,
        "reason": check.reason,
        "bend_px": check.bend_px,
        "bend_mm": check.bend_mm,
        "matters": check.matters,
    }


def board_check_mm(result: RigResult) -> tuple[float, int]:
    """How far triangulated points of the board lie from where they were printed, and how many.

    Each view's points are laid over the board by a rigid motion. It is the residuals said in mm,
    not another judge: poses and points come from the same pictures.
    """
    from ..tracking.rigid_fit import fit_rigid
    from ..tracking.triangulation import Views, triangulate

    found, cameras = result.found, list(result.found.rig)
    views = Views.of([found.rig[c] for c in cameras])
    seen = {(c, v.name): v for c in cameras for v in result.views[c]}
    squares, count = 0.0, 0
    board = result.board.object_points()
    for name in found.view_poses:
        xy = np.full((len(board), len(cameras), 2), np.nan)
        for i, camera in enumerate(cameras):
            if (camera, name) in found.residuals:
                view = seen[camera, name]
                rows = np.abs(board[None] - view.points[:, None]).max(axis=2).argmin(axis=1)
                xy[rows, i] = found.rig[camera].undistort(view.pixels)
        if np.isfinite(xy[..., 0]).any(axis=0).sum() < 2:
            continue
        points = triangulate(views, xy, tolerance_px=np.inf).positions
        R, t = fit_rigid(board, points)
        off = (board @ R.T + t - points)[np.isfinite(points).all(axis=1)]
        if np.isfinite(off).all():
            squares, count = squares + float((off**2).sum()), count + len(off)
    return float(np.sqrt(squares / count)) if count else float("nan"), count


def _drawings(result: RigResult, distance_mm: float, face: TriangulationSd | None) -> list[Drawing]:
    found = result.found
    points = result.board.object_points()
    drawn = [cameras_in_space("The cameras and the boards", found.rig, found.view_poses, points)]
    drawn += face_drawings(found, face)
    per_view = []
    for view in views_used(found):
        joined = np.concatenate([r for (_, v), r in found.residuals.items() if v == view])
        per_view.append((view, float(np.sqrt((joined**2).sum(axis=1).mean()))))
    drawn.append(bars("Residuals by view, all cameras, px", per_view, "px"))
    for name, camera in found.rig.cameras.items():
        seen = {v.name: v for v in result.views[name]}
        keys = [v for c, v in found.residuals if c == name]
        pixels = np.concatenate([seen[v].pixels for v in keys])
        residuals = np.concatenate([found.residuals[name, v] for v in keys])
        drawn.append(residual_field(f"Residuals of {name}", camera.image_size, pixels, residuals))
        if name in result.lenses:
            drawn.append(lens_drawings(name, result.lenses[name], distance_mm)[1])
    return drawn
