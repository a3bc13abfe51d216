"""What `facewright calibrate rig` tells of a rig from a wand, or from the performer's markers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..capture.rig_uncertainty import triangulation_sd_mm
from ..capture.tsai import Parameter
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
    from ..capture.camera_shifts import CameraShift
    from ..capture.rigs import RigCalibration
    from ..core.rig import Rig
    from .rig_from_markers import MarkerResult, WandResult

Floats = NDArray[np.float64]
_FACE_MM = (75.0, 100.0, 50.0)  # half a face: sideways, up and down, in depth
_MOST_DRAWN, _MOST_BARS = 40, 60
_INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def wand_report(result: WandResult) -> CalibrationReport:
    """What was found with a wand, in tables and pictures."""
    found = result.found
    tables = [
        ReportTable("Cameras", _camera_table(found)),
        ReportTable("Distances between cameras", _distance_table(found.rig, None)),
    ]
    if any(found.parameters.values()):
        tables.append(ReportTable("Lenses", _lens_table(found)))
    if result.clocks:
        rows = tuple(
            (n, 1e3 * c.offset_s, 1e3 * c.offset_sd_s, 1e6 * c.drift, c.method)
            for n, c in result.clocks.items()
        )
        columns = ("camera", "offset ms", "sd ms", "drift ppm", "from")
        tables.append(ReportTable("Clocks", Table(columns, rows)))
    if found.views_rejected:
        tables.append(ReportTable("Not used", rejected_table(found.views_rejected)))
    places = np.stack([pose.translation for pose in found.view_poses.values()])
    face_mm = at_face_mm(found, np.median(places, axis=0))
    summary = (
        f"{len(found.rig)} cameras from {len(found.view_poses)} moments of a wand of "
        f"{result.balls_mm[-1] - result.balls_mm[0]:g} mm: RMS {found.rms_used_px:.3g} px; the "
        f"calibration displaces points of a face there by {face_mm:.3g} mm RMS"
    )
    title = f"Rig of {len(found.rig)} cameras, from a wand"
    drawings = tuple(_wand_drawings(result))
    return CalibrationReport(title, summary, found.warnings, tuple(tables), drawings)


def wand_json(result: WandResult) -> dict[str, Any]:
    """What was found with a wand, for machines."""
    found = result.found
    places = np.stack([pose.translation for pose in found.view_poses.values()])
    return {
        **_json(found),
        "face_mm": at_face_mm(found, np.median(places, axis=0)),
        "wand_mm": list(result.balls_mm),
        "moments": len(found.view_poses),
        "clocks": {
            name: {"offset_s": c.offset_s, "drift": c.drift, "offset_sd_s": c.offset_sd_s,
                   "method": c.method}
            for name, c in result.clocks.items()
        },
    }  # fmt: skip


def marker_report(result: MarkerResult) -> CalibrationReport:
    """What became of a rig's cameras, in tables and pictures."""
    found = result.found
    tables = (
        ReportTable("Cameras against where they were", _shift_table(result.shifts)),
        ReportTable("Cameras", _camera_table(found)),
        ReportTable("Distances between cameras", _distance_table(found.rig, result.before)),
    )
    title = f"Rig of {len(found.rig)} cameras, refined by markers"
    drawn = [_frames_drawn(found)]
    return CalibrationReport(title, _marker_summary(result), found.warnings, tables, tuple(drawn))


def _marker_summary(result: MarkerResult) -> str:
    found = result.found
    moved = [s for s in result.shifts if s.is_moved]
    if moved:
        told = "; ".join(
            f"{s.camera} was moved by {s.distance_mm:.2g} mm and {np.rad2deg(s.angle_rad):.2g}°"
            for s in moved
        )
    else:
        told = "no camera was moved since the calibration"
    if result.moves:
        told += f", but {', '.join(m.camera for m in result.moves)} in mid-take"
    face_mm = at_face_mm(found, np.median(result.points, axis=0))
    return (
        f"{told}. {len(result.points)} points of {_n_views(found)} frames: RMS "
        f"{found.rms_used_px:.3g} px; the refined calibration displaces points of the face by "
        f"{face_mm:.3g} mm RMS"
    )


def marker_json(result: MarkerResult) -> dict[str, Any]:
    """What became of a rig's cameras, for machines."""
    return {
        **_json(result.found),
        "face_mm": at_face_mm(result.found, np.median(result.points, axis=0)),
        "points": len(result.points),
        "camera_shifts": [
            {"camera": s.camera, "moved": s.is_moved, "mm": s.distance_mm,
             "mm_sd": s.distance_sd_mm, "degrees": float(np.rad2deg(s.angle_rad)),
             "degrees_sd": float(np.rad2deg(s.angle_sd_rad)), "picture_px": s.picture_px,
             "p_value": s.p_value}
            for s in result.shifts
        ],
        "mid_take_moves": [
            {"camera": m.camera, "before": m.before, "after": m.after,
             "mm": m.shift.distance_mm, "degrees": float(np.rad2deg(m.shift.angle_rad))}
            for m in result.moves
        ],
    }  # fmt: skip


def at_face_mm(found: RigCalibration, middle: Floats) -> float:
    """What the calibration alone does to points of a face about a place, mm RMS in space.

    The face's own rigid motion is taken off (`capture.rig_uncertainty`); NaN where too few of its
    points are seen by two cameras.
    """
    grid = np.stack(np.meshgrid(*[np.linspace(-h, h, 3) for h in _FACE_MM]), axis=-1)
    told = triangulation_sd_mm(found, middle + grid.reshape(-1, 3))
    mm = told.calibration_mm[np.isfinite(told.calibration_mm)]
    return float(np.sqrt((mm**2).mean())) if len(mm) else float("nan")


def _json(found: RigCalibration) -> dict[str, Any]:
    return {
        "rms_px": found.rms_px,
        "rms_used_px": found.rms_used_px,
        "sd_px": found.sd_px,
        "views_used": list(dict.fromkeys(view for _, view in found.residuals)),
        "views_rejected": rejected_json(found.views_rejected),
        "parameters": [e for n in found.rig for e in parameters_json(_parameters(found, n))],
        "cameras": list(found.rig),
        "unconnected": list(found.unconnected),
        "warnings": list(found.warnings),
    }


def _parameters(found: RigCalibration, name: str) -> list[Parameter]:
    """Estimated intrinsics, and the centre in the world."""
    camera = found.rig[name]
    K = camera.matrix
    row = (K[0, 0], K[1, 1], K[0, 2], K[1, 2], *camera.distortion)
    values = dict(zip(_INTRINSICS, row, strict=False))
    inner = [
        Parameter(f"{name}.{p}", float(values.get(p, 0.0)), float(sd), "px" if p[0] in "fc" else "")
        for p, sd in zip(found.parameters[name], found.intrinsics_sd[name], strict=True)
    ]
    centre_sd = np.sqrt(np.maximum(np.diag(found.covariance[name])[3:], 0))
    outer = [
        Parameter(f"{name}.{axis}", float(value), float(sd), "mm")
        for axis, value, sd in zip("xyz", camera.position, centre_sd, strict=True)
    ]
    return inner + outer


def _n_views(found: RigCalibration) -> int:
    return len({view for _, view in found.residuals})


def _camera_table(found: RigCalibration) -> Table:
    rows = []
    for name, camera in found.rig.cameras.items():
        residuals = [r for (c, _), r in found.residuals.items() if c == name]
        rms = float(np.sqrt((np.concatenate(residuals) ** 2).sum(axis=1).mean()))
        C = found.covariance[name]
        turn_sd, centre_sd = (
            float(np.sqrt(max(np.trace(C[at, at]), 0.0))) for at in (slice(0, 3), slice(3, 6))
        )
        x, y, z = (f"{v:.2f}" for v in camera.position)
        rows.append((name, len(residuals), rms, x, y, z, centre_sd, float(np.rad2deg(turn_sd))))
    columns = ("camera", "moments", "RMS px", "x mm", "y mm", "z mm", "centre sd mm",
               "rotation sd °")  # fmt: skip
    return Table(columns, tuple(rows))


def _distance_table(rig: Rig, before: Rig | None) -> Table:
    rows: list[tuple[object, ...]] = []
    for a, b in combinations(rig, 2):
        now = float(np.linalg.norm(rig[a].position - rig[b].position))
        row: tuple[object, ...] = (f"{a} – {b}", f"{now:.2f}")
        if before is not None:
            then = float(np.linalg.norm(before[a].position - before[b].position))
            row = (*row, f"{then:.2f}", f"{now - then:+.2f}")
        rows.append(row)
    columns = ("cameras", "mm") if before is None else ("cameras", "mm", "before mm", "change mm")
    return Table(columns, tuple(rows))


def _lens_table(found: RigCalibration) -> Table:
    rows = tuple(
        (p.name, f"{p.value:.6g}", p.sd, p.unit)
        for name in found.rig
        for p in _parameters(found, name)[: len(found.parameters[name])]
    )
    return Table(("parameter", "value", "sd", "unit"), rows)


def _shift_table(shifts: Sequence[CameraShift]) -> Table:
    rows = tuple(
        (s.camera, "moved" if s.is_moved else "as it was", s.distance_mm, s.distance_sd_mm,
         float(np.rad2deg(s.angle_rad)), float(np.rad2deg(s.angle_sd_rad)), s.picture_px,
         f"{s.p_value:.2g}")
        for s in shifts
    )  # fmt: skip
    columns = ("camera", "verdict", "by mm", "sd mm", "by °", "sd °", "in the picture px",
               "chance alone")  # fmt: skip
    return Table(columns, rows)


def _wand_drawings(result: WandResult) -> list[Drawing]:
    found = result.found
    views = list(found.view_poses)
    picks = np.linspace(0, len(views) - 1, min(_MOST_DRAWN, len(views))).round().astype(int)
    wand = np.zeros((len(result.balls_mm), 3))
    wand[:, 0] = np.array(result.balls_mm) - result.balls_mm[0]
    shown = {views[i]: found.view_poses[views[i]] for i in picks}
    drawn = [cameras_in_space("The cameras and the wand", found.rig, shown, wand)]
    drawn.append(_frames_drawn(found))
    for name, camera in found.rig.cameras.items():
        pixels, residuals = [], []
        for row, moment in zip(result.pixels[name], result.moments, strict=True):
            off = found.residuals.get((name, moment))
            seen = row[np.isfinite(row[:, 0])]
            if off is not None and len(off) == len(seen):  # else some balls were left out
                pixels.append(seen)
                residuals.append(off)
        if pixels:
            joined = np.concatenate(pixels), np.concatenate(residuals)
            drawn.append(residual_field(f"Residuals of {name}", camera.image_size, *joined))
    return drawn


def _frames_drawn(found: RigCalibration) -> Drawing:
    """Residuals over time: what goes wrong at one moment stands out."""
    by_view: dict[str, list[Floats]] = {}
    for (_, view), residuals in found.residuals.items():
        by_view.setdefault(view, []).append(residuals)
    views = list(by_view)
    groups = np.array_split(np.arange(len(views)), min(_MOST_BARS, len(views)))
    shown = []
    for group in groups:
        joined = np.concatenate([r for i in group for r in by_view[views[i]]])
        rms = float(np.sqrt((joined**2).sum(axis=1).mean()))
        shown.append((views[group[0]].removeprefix("frame "), rms))
    return bars("Residuals over time, all cameras, px", shown, "px")
