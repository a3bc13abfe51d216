"""What every way to a camera rig tells of it: tables, JSON fields, how sure it is at the face."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..capture.rig_uncertainty import SPOT_SD_PX
from ..capture.tsai import Parameter
from ..core.errors import InputError
from .calibration_plots import uncertainty_plane
from .calibration_report import parameters_json, rejected_json
from .drawing import Drawing
from .tables import Table

if TYPE_CHECKING:
    from ..capture.rig_uncertainty import TriangulationSd
    from ..capture.rigs import RigCalibration
    from ..capture.synchronise import ClockFit

Floats = NDArray[np.float64]


def at_face(found: RigCalibration) -> TriangulationSd | None:
    """How sure triangulated points are where a face would be; None where no face is looked at."""
    from ..capture.rig_face import face_uncertainty
    from ..capture.rig_world import head_from_world

    try:
        if not found.view_poses:
            head_from_world(found.rig)  # nothing else says where the face is
        return face_uncertainty(found)
    except InputError:
        return None


def face_words(sd: TriangulationSd | None) -> str:
    """The same for a summary; empty where it is not known."""
    if sd is None:
        return ""
    return (
        f"; at a face where the cameras look the calibration displaces points by "
        f"{_rms(sd.calibration_mm):.2g} mm against each other (RMS), and {SPOT_SD_PX:g} px of "
        f"noise in each picture by {_rms(sd.noise_mm):.2g} mm"
    )


def face_json(sd: TriangulationSd | None) -> dict[str, Any] | None:
    """The same for machines."""
    if sd is None:
        return None
    return {
        "calibration": _rms(sd.calibration_mm),
        "noise": _rms(sd.noise_mm),
        "spot_sd_px": SPOT_SD_PX,
    }


def face_drawings(found: RigCalibration, sd: TriangulationSd | None) -> list[Drawing]:
    """Over the plane of the face; none where it is not known."""
    from ..capture.rig_face import FACE_MM, plane_uncertainty

    if sd is None:
        return []
    plane = plane_uncertainty(found)
    title = "What triangulated points are sure to, in the plane of the face"
    return [uncertainty_plane(title, plane, FACE_MM[:2])]


def _rms(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt((known**2).mean())) if len(known) else float("nan")


def common_json(found: RigCalibration, clocks: Mapping[str, ClockFit]) -> dict[str, Any]:
    """The fields that all ways to a rig write."""
    return {
        "rms_px": found.rms_px,
        "rms_used_px": found.rms_used_px,
        "sd_px": found.sd_px,
        "views_used": views_used(found),
        "views_rejected": rejected_json(found.views_rejected),
        "parameters": [
            entry
            for name in found.rig
            for entry in parameters_json(camera_parameters(found, name))
        ],
        "cameras": list(found.rig),
        "unconnected": list(found.unconnected),
        "distances_mm": [
            {"cameras": [a, b], "value": value, "sd": sd} for a, b, value, sd in distances(found)
        ],
        "at_face_mm": face_json(at_face(found)),
        "clocks": {
            name: {"offset_s": c.offset_s, "drift": c.drift, "offset_sd_s": c.offset_sd_s,
                   "method": c.method}
            for name, c in clocks.items()
        },
        "warnings": list(found.warnings),
    }  # fmt: skip


def views_used(found: RigCalibration) -> list[str]:
    """Names of the views used, in order."""
    return list(dict.fromkeys(view for _, view in found.residuals))


def camera_parameters(found: RigCalibration, name: str) -> list[Parameter]:
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


def camera_table(found: RigCalibration, at_target: Mapping[str, float], target: str) -> Table:
    """Where each camera stands, and how sure that is.

    Parameters
    ----------
    found : RigCalibration
    at_target : mapping from camera to mm
        Of `across_mm`.
    target : str
        What that is: "the board".
    """
    rows = []
    for name, camera in found.rig.cameras.items():
        residuals = [r for (c, _), r in found.residuals.items() if c == name]
        rms = float(np.sqrt((np.concatenate(residuals) ** 2).sum(axis=1).mean()))
        C = found.covariance[name]
        centre_sd = float(np.sqrt(max(np.trace(C[3:, 3:]), 0)))
        turn_sd = float(np.rad2deg(np.sqrt(max(np.trace(C[:3, :3]), 0))))
        x, y, z = (f"{v:.2f}" for v in camera.position)
        rows.append((name, len(residuals), rms, x, y, z, centre_sd, turn_sd, at_target[name]))
    columns = ("camera", "views", "RMS px", "x mm", "y mm", "z mm", "centre sd mm",
               "rotation sd °", f"mm at {target}")  # fmt: skip
    return Table(columns, tuple(rows))


def distance_table(found: RigCalibration) -> Table:
    """From the first camera to each other."""
    rows = tuple((f"{a} – {b}", f"{value:.2f}", sd) for a, b, value, sd in distances(found))
    return Table(("cameras", "mm", "sd mm"), rows)


def distances(found: RigCalibration) -> list[tuple[str, str, float, float]]:
    """From the first camera to each other: names, mm, standard deviation in mm."""
    first, *others = found.rig
    start = _centre(found, first)
    rows = []
    for name in others:
        apart: Floats = found.rig[name].position - found.rig[first].position
        value = float(np.linalg.norm(apart))
        way = apart / max(value, 1e-9)
        J = np.zeros(len(found.joint_covariance))
        J[_centre(found, name)], J[start] = way, -way
        sd = float(np.sqrt(max(float(J @ found.joint_covariance @ J), 0.0)))
        rows.append((first, name, value, sd))
    return rows


def _centre(found: RigCalibration, name: str) -> slice:
    """Where a camera's centre stands in the joint covariance."""
    outer = found.columns(name)[1]
    return slice(outer.start + 3, outer.stop)


def lens_table(found: RigCalibration) -> Table:
    """Every intrinsic that was estimated."""
    rows = tuple(
        (p.name, f"{p.value:.6g}", p.sd, p.unit)
        for name in found.rig
        for p in camera_parameters(found, name)[: len(found.parameters[name])]
    )
    return Table(("parameter", "value", "sd", "unit"), rows)


def clock_table(clocks: Mapping[str, ClockFit]) -> Table:
    """How the cameras' clocks run against the first's."""
    rows = tuple(
        (name, 1e3 * c.offset_s, 1e3 * c.offset_sd_s, 1e6 * c.drift, c.method)
        for name, c in clocks.items()
    )
    return Table(("camera", "offset ms", "sd ms", "drift ppm", "from"), rows)


def across_mm(found: RigCalibration, places: Floats) -> dict[str, float]:
    """What each pose's uncertainty amounts to at some places, across the line of sight, mm.

    First order, root mean square over the places; the frame's own camera, or cameras, are held.

    Parameters
    ----------
    found : RigCalibration
    places : (N, 3) float64, mm, world frame
    """
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
