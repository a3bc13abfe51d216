"""`facewright calibrate tsai`: a camera from one picture of known points."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.errors import InputError
from .camera_files import OUT_HELP, writable_cameras, write_cameras
from .options import JsonOption, ReportOption, note, writable_file

if TYPE_CHECKING:
    from ..capture.tsai import TsaiCalibration
    from ..core.camera import Camera
    from ..core.formats.points_csv import PointsInPicture
    from .calibration_report import CalibrationReport

_FIXABLE = ("k1", "cx", "cy")
_CORRELATED = 0.9


def tsai(
    points: Annotated[
        Path, typer.Argument(metavar="POINTS.csv", help="Columns X,Y,Z,u,v: mm and pixels.")
    ],
    image_size: Annotated[
        str | None,
        typer.Option("--image-size", metavar="WxH", help="Not needed with --camera."),
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(
            "--camera", metavar="known.json", help="Known intrinsics: only the pose is found."
        ),
    ] = None,
    fix: Annotated[str, typer.Option(metavar="k1,cx,cy", help="What is not to be estimated.")] = "",
    sx: Annotated[
        bool, typer.Option("--sx", help="Estimate the ratio of pixel sizes too.")
    ] = False,
    sd: Annotated[
        float | None,
        typer.Option(
            metavar="PX",
            help="Standard deviation of the marking. Default: from the residuals.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="camera.json", help=f"{OUT_HELP} Default: POINTS.camera.json."
        ),
    ] = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """A camera, or its pose, from one picture of known points (Tsai 1987)."""
    fixed = _fixed(fix, sx)
    if camera is not None and (fix or sx):
        raise typer.BadParameter("with --camera the lens is known: leave out --fix and --sx")
    if camera is None and image_size is None:
        raise typer.BadParameter("give --image-size WxH (or --camera)", param_hint="--image-size")
    if sd is not None and not sd > 0:
        raise typer.BadParameter("expected a standard deviation above 0", param_hint="--sd")
    from ..core.formats.points_csv import read_points
    from ..core.rig import Rig
    from .calibration_report import show_tables, write_calibration_report
    from .tables import write_json

    out = writable_cameras(out or points.with_suffix(".camera.json"))
    for path, suffixes in ((report, (".html",)), (json_file, ())):
        if path is not None:
            writable_file(path, suffixes)
    given = read_points(points)
    known, size = _known(camera, image_size)
    found = _calibrate(given, size, known, fixed, sd)
    shown = tsai_report(points.name, given, found)
    show_tables(shown)
    if report is not None:
        picture = write_calibration_report(report, shown)
        note(f"wrote {report} and {picture.name}")
    if json_file is not None:
        write_json(json_file, tsai_json(points.name, given, found))
    write_cameras(out, Rig({points.stem: found.camera}))


def _fixed(fix: str, sx: bool) -> set[str]:
    names = {name.strip() for name in fix.split(",") if name.strip()}
    unknown = sorted(names - set(_FIXABLE))
    if unknown:
        raise typer.BadParameter(
            f"cannot fix {', '.join(unknown)}: expected some of {','.join(_FIXABLE)}",
            param_hint="--fix",
        )
    return names | (set() if sx else {"sx"})


def _known(camera: Path | None, image_size: str | None) -> tuple[Camera | None, tuple[int, int]]:
    from dataclasses import replace

    import numpy as np

    from .calibration_report import image_size_of, one_camera

    size = None if image_size is None else image_size_of(image_size)
    if camera is None:
        assert size is not None
        return None, size
    known: Camera = one_camera(camera)
    if size is not None and size != known.image_size:
        has = "x".join(map(str, known.image_size))
        raise InputError(f"{camera} is for pictures of {has}, not {size[0]}x{size[1]}")
    if not len(known.distortion):  # the same lens with its coefficients said
        known = replace(known, distortion_model="opencv", distortion=np.zeros(5))
    return known, known.image_size


def _calibrate(
    given: PointsInPicture,
    size: tuple[int, int],
    known: Camera | None,
    fixed: set[str],
    sd: float | None,
) -> TsaiCalibration:
    from dataclasses import replace

    from ..capture.tsai import tsai as calibrate

    found = calibrate(given.points, given.pixels, size, camera=known, fixed=fixed, sd_px=sd)
    return replace(found, warnings=(*found.warnings, *_outside(given, size)))


def _outside(given: PointsInPicture, size: tuple[int, int]) -> list[str]:
    """Says so if pixels lie outside the picture: its size is wrong, or the columns are mixed up."""
    out = ((given.pixels < -0.5) | (given.pixels > [size[0] - 0.5, size[1] - 0.5])).any(axis=1)
    if not out.any():
        return []
    u, v = given.pixels.max(axis=0)
    return [
        f"{int(out.sum())} points lie outside a picture of {size[0]}x{size[1]} (line "
        f"{int(given.lines[out][0])} first; u reaches {u:.0f}, v {v:.0f}): is the size right?"
    ]


def tsai_report(name: str, given: PointsInPicture, found: TsaiCalibration) -> CalibrationReport:
    """What was found, in tables and pictures."""
    import numpy as np

    from .calibration_plots import residual_field
    from .calibration_report import CalibrationReport, ReportTable, parameter_table
    from .tables import Table

    tables = [ReportTable("Parameters", parameter_table(found.parameters))]
    tied = _tied(found)
    if tied:
        rows = tuple((f"{a}, {b}", f"{c:+.4f}") for a, b, c in tied)
        tables.append(ReportTable("Tied together", Table(("pair", "correlation"), rows)))
    out = _rejected(given, found)
    if out:
        thrown = tuple((f"line {line}", px) for line, px in out)
        tables.append(ReportTable("Thrown out", Table(("point", "residual px"), thrown)))
    n = int(found.is_used.sum())
    kind = "in one plane" if found.is_coplanar else "not in one plane"
    summary = (
        f"{n} of {len(found.is_used)} points used, {kind}: RMS {found.rms_used_px:.4g} px; "
        f"the camera's uncertainty is {found.mm_at_target:.3g} mm at the points, across the line "
        "of sight"
    )
    used = found.is_used & np.isfinite(found.residuals).all(axis=1)
    field = residual_field(
        "Residuals of the points used",
        found.camera.image_size,
        given.pixels[used],
        found.residuals[used],
    )
    title = f"Calibration from {name}"
    return CalibrationReport(title, summary, found.warnings, tuple(tables), (field,))


def tsai_json(name: str, given: PointsInPicture, found: TsaiCalibration) -> dict[str, Any]:
    """What was found, for machines."""
    from .calibration_report import parameters_json

    return {
        "rms_px": found.rms_px,
        "rms_used_px": found.rms_used_px,
        "sd_px": found.sd_px,
        "views_used": [name],
        "views_rejected": [],
        "points_used": int(found.is_used.sum()),
        "points_rejected": [
            {"line": line, "residual_px": px} for line, px in _rejected(given, found)
        ],
        "parameters": parameters_json(found.parameters),
        "covariance": found.covariance,
        "correlated": [{"names": [a, b], "correlation": c} for a, b, c in _tied(found)],
        "mm_at_target": found.mm_at_target,
        "is_coplanar": found.is_coplanar,
        "image_size": list(found.camera.image_size),
        "warnings": list(found.warnings),
    }


def _tied(found: TsaiCalibration) -> list[tuple[str, str, float]]:
    """Pairs of parameters that move together, the closest first."""
    names, C = [p.name for p in found.parameters], found.correlation
    pairs = [
        (names[i], names[j], float(C[i, j]))
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if abs(C[i, j]) > _CORRELATED
    ]
    return sorted(pairs, key=lambda p: -abs(p[2]))


def _rejected(given: PointsInPicture, found: TsaiCalibration) -> list[tuple[int, float]]:
    """Line in the file and distance, px, of the points that were not used."""
    import numpy as np

    size = np.linalg.norm(found.residuals, axis=1)
    return [(int(given.lines[i]), float(size[i])) for i in range(len(size)) if not found.is_used[i]]
