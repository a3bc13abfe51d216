"""What `facewright calibrate rig` tells of its result."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..capture.tsai import Parameter
from .calibrate_board import lens_drawings
from .calibration_plots import bars, cameras_in_space, residual_field
from .calibration_report import (
    CalibrationReport,
    ReportTable,
    parameters_json,
    rejected_json,
    rejected_table,
)
from .drawing import Drawing
from .tables import Table

if TYPE_CHECKING:
    from ..capture.rigs import RigCalibration
    from .calibrate_rig import RigResult

Floats = NDArray[np.float64]


def rig_report(result: RigResult, distance_mm: float) -> CalibrationReport:
    """What was found, in tables and pictures."""
    found = result.found
    tables = [
        ReportTable("Cameras", _camera_table(result)),
        ReportTable("Distances between cameras", _distance_table(found)),
    ]
    if result.lenses:
        tables.append(ReportTable("Lenses", _lens_table(found)))
    if result.clocks:
        tables.append(ReportTable("Clocks", _clock_table(result)))
    if found.views_rejected:
        tables.append(ReportTable("Not used", rejected_table(found.views_rejected)))
    board_mm, n = board_check_mm(result)
    at_board = at_board_mm(result)
    summary = (
        f"{len(found.rig)} cameras, {len(_views_used(found))} views: RMS {found.rms_used_px:.4g} "
        f"px; at the board the cameras' poses are sure to {max(at_board.values()):.3g} mm or "
        f"better across the line of sight; {n} points of the board, triangulated, come out where "
        f"they were printed to {board_mm:.3g} mm RMS"
    )
    title = f"Rig of {len(found.rig)} cameras"
    drawings = tuple(_drawings(result, distance_mm))
    return CalibrationReport(title, summary, found.warnings, tuple(tables), drawings)


def rig_json(result: RigResult) -> dict[str, Any]:
    """What was found, for machines."""
    found = result.found
    board_mm, n = board_check_mm(result)
    return {
        "rms_px": found.rms_px,
        "rms_used_px": found.rms_used_px,
        "sd_px": found.sd_px,
        "views_used": list(_views_used(found)),
        "views_rejected": rejected_json(found.views_rejected),
        "parameters": [
            entry for name in found.rig for entry in parameters_json(_parameters(found, name))
        ],
        "cameras": list(found.rig),
        "unconnected": list(found.unconnected),
        "at_board_mm": at_board_mm(result),
        "board_points_mm": {"rms": board_mm, "points": n},
        "distances_mm": [
            {"cameras": [a, b], "value": value, "sd": sd}
            for a, b, value, sd in _distances(found)
        ],
        "clocks": {
            name: {"offset_s": c.offset_s, "drift": c.drift, "offset_sd_s": c.offset_sd_s,
                   "method": c.method}
            for name, c in result.clocks.items()
        },
        "lens_models": {name: lens.model for name, lens in result.lenses.items()},
        "warnings": list(found.warnings),
    }  # fmt: skip


def _views_used(found: RigCalibration) -> list[str]:
    return list(dict.fromkeys(view for _, view in found.residuals))


def _parameters(found: RigCalibration, name: str) -> list[Parameter]:
    """Estimated intrinsics, and the centre in the world."""
    camera = found.rig[name]
    K, d = camera.matrix, camera.distortion
    values: dict[str, float] = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    labels = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    values |= dict(zip(labels, d, strict=False))
    sds = found.intrinsics_sd[name]
    inner = [
        Parameter(f"{name}.{p}", float(values[p]), float(sd), "px" if p[0] in "fc" else "")
        for p, sd in zip(found.parameters[name], sds, strict=True)
    ]
    centre_sd = np.sqrt(np.maximum(np.diag(found.covariance[name])[3:], 0))
    outer = [
        Parameter(f"{name}.{axis}", float(value), float(sd), "mm")
        for axis, value, sd in zip("xyz", camera.position, centre_sd, strict=True)
    ]
    return inner + outer


def _camera_table(result: RigResult) -> Table:
    found = result.found
    at_board = at_board_mm(result)
    rows = []
    for name, camera in found.rig.cameras.items():
        residuals = [r for (c, _), r in found.residuals.items() if c == name]
        rms = float(np.sqrt((np.concatenate(residuals) ** 2).sum(axis=1).mean()))
        C = found.covariance[name]
        centre_sd = float(np.sqrt(max(np.trace(C[3:, 3:]), 0)))
        turn_sd = float(np.rad2deg(np.sqrt(max(np.trace(C[:3, :3]), 0))))
        x, y, z = (f"{v:.2f}" for v in camera.position)
        rows.append((name, len(residuals), rms, x, y, z, centre_sd, turn_sd, at_board[name]))
    columns = ("camera", "views", "RMS px", "x mm", "y mm", "z mm", "centre sd mm",
               "rotation sd °", "mm at the board")  # fmt: skip
    return Table(columns, tuple(rows))


def _distance_table(found: RigCalibration) -> Table:
    rows = tuple((f"{a} – {b}", f"{value:.2f}", sd) for a, b, value, sd in _distances(found))
    return Table(("cameras", "mm", "sd mm"), rows)


def _distances(found: RigCalibration) -> list[tuple[str, str, float, float]]:
    """From the first camera to each other: it is held, so the other's covariance tells all."""
    first, *others = found.rig
    rows = []
    for name in others:
        apart: Floats = found.rig[name].position - found.rig[first].position
        value = float(np.linalg.norm(apart))
        way = apart / max(value, 1e-9)
        sd = float(np.sqrt(max(float(way @ found.covariance[name][3:, 3:] @ way), 0.0)))
        rows.append((first, name, value, sd))
    return rows


def _lens_table(found: RigCalibration) -> Table:
    rows = tuple(
        (p.name, f"{p.value:.6g}", p.sd, p.unit)
        for name in found.rig
        for p in _parameters(found, name)[: len(found.parameters[name])]
    )
    return Table(("parameter", "value", "sd", "unit"), rows)


def _clock_table(result: RigResult) -> Table:
    rows = tuple(
        (name, 1e3 * c.offset_s, 1e3 * c.offset_sd_s, 1e6 * c.drift, c.method)
        for name, c in result.clocks.items()
    )
    return Table(("camera", "offset ms", "sd ms", "drift ppm", "from"), rows)


def at_board_mm(result: RigResult) -> dict[str, float]:
    """What each pose's uncertainty amounts to at the board, across the line of sight, mm.

    First order, against the first camera, root mean square over the views' middles.
    """
    found = result.found
    middle = result.board.object_points().mean(axis=0)
    places = np.stack([pose.apply(middle) for pose in found.view_poses.values()])
    mm = {}
    for name, camera in found.rig.cameras.items():
        R = camera.camera_from_world.rotation
        p = camera.camera_from_world.apply(places)
        squares = []
        for x, y, z in p:
            # p = exp(δ) R (P - C): dp = δ × p - R dC
            cross = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])
            J = np.hstack([cross, -R])[:2]
            squares.append(np.trace(J @ found.covariance[name] @ J.T) / 2)
        mm[name] = float(np.sqrt(max(float(np.mean(squares)), 0.0)))
    return mm


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


def _drawings(result: RigResult, distance_mm: float) -> list[Drawing]:
    found = result.found
    points = result.board.object_points()
    drawn = [cameras_in_space("The cameras and the boards", found.rig, found.view_poses, points)]
    per_view = []
    for view in _views_used(found):
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
