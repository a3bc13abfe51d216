"""C3D files: marker trajectories, as every optical system reads and writes them.

What is written, and read back: positions as float32, mm (``POINT:UNITS``); a missing sample as
(0, 0, 0) with a fourth word of -1, the format's mark; else that word holds a residual (low byte,
in steps of ``POINT:SCALE``) and a mask of cameras (high byte). So our `residual_px` keeps 1/254
of the take's largest; a residual of 0 is the format's mark for a sample that was filled in (with
camera 1 in the mask if it was reconstructed from other markers, with none if interpolated), and
a measured one is written as at least one step. C3D's residuals are lengths, ours are pixels: the
group ``FACEWRIGHT`` says so, and residuals of files without it are not taken for pixels. The mask
has seven bits; we know the number of cameras only and set that many, seven at most.
C3D holds no covariances, one rate instead of times, and no time of the first frame. It counts
frames in 16 bits; longer takes are written with ``POINT:LONG_FRAMES``, as c3d.org advises.

In files by others, a sample at exactly (0, 0, 0) without residual and cameras is missing too
(several programs write gaps like that), and samples of residual 0 count as filled only if others
in the file have one.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError, InputError
from ..trajectories import Source, Trajectories
from .c3d_layout import Layout, floats_of_words, read_layout
from .c3d_writer import MAX_STEPS, OWN_GROUP, C3dWriter

_UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}

_log = logging.getLogger(__name__)


def read_c3d(path: Path) -> Trajectories:
    """Read trajectories. Names that are empty or there twice get a number added.

    Returns
    -------
    Trajectories
        Positions in mm, whatever the file's unit (a file that names none is taken to be in mm,
        and that is logged); times from the first frame. `residual_px` only from files that say
        that their residuals are pixels, `n_views` only where cameras are recorded.

    Raises
    ------
    FileFormatError
        If the file is not C3D, is damaged or cut off, has no points or no rate.
    OSError
        If it cannot be read.
    """
    layout = read_layout(path)
    xyz, word = _read_points(path, layout)
    is_missing = (word < 0) | np.isnan(xyz).any(axis=2)
    residual = (word & 0xFF) * abs(layout.scale)
    n_views = np.bitwise_count(((word >> 8) & 0x7F).astype(np.uint8)).astype(np.int32)
    is_ours = (OWN_GROUP, "RESIDUAL_UNIT") in layout.parameters
    if not is_ours:
        is_missing |= (xyz == 0).all(axis=2) & (word == 0)
    broken = np.argwhere(np.isinf(xyz).any(axis=2) & ~is_missing)
    if len(broken):
        where = f"frame {broken[0][0]}, point {broken[0][1]}"
        raise FileFormatError(path, where, "finite numbers", "inf")
    marks_filled = is_ours or bool((residual[~is_missing] > 0).any())
    source = _source(is_missing, (residual == 0) & marks_filled, (n_views > 0) & is_ours)
    n_views = np.where(is_missing | (is_ours & (source >= Source.INTERPOLATED)), 0, n_views)
    return Trajectories(
        np.arange(layout.n_frames) / layout.rate_hz,
        _names(_labels(layout), layout.n_points),
        np.where(is_missing[..., None], np.nan, xyz * _unit_mm(path, layout)),
        source=source,
        residual_px=_residual_px(layout, residual, is_missing),
        n_views=n_views if n_views.any() else None,
    )


def write_c3d(path: Path, trajectories: Trajectories) -> None:
    """Write trajectories; see the module for what the format keeps.

    `c3d_writer.C3dWriter` does the same for takes that come in pieces.

    Raises
    ------
    InputError
        If there are no markers or fewer than 2 frames, the times are uneven, there are more than
        16 million frames, or a name is empty, longer than 127 bytes, or padded with spaces.
    """
    T, rate_hz = len(trajectories.time_s), trajectories.rate_hz
    if rate_hz is None and T > 1:
        raise InputError(
            "a C3D file has one frame rate, but the times of these trajectories are uneven: "
            "resample them first"
        )
    residual = trajectories.residual_px
    largest = None
    if residual is not None:
        largest = float(np.max(residual, where=np.isfinite(residual), initial=0.0))
    writer = C3dWriter(path, trajectories.names, rate_hz or 1.0, T, largest_residual_px=largest)
    with writer:
        writer.write(trajectories)


# --- Reading ---


def _source(
    is_missing: NDArray[np.bool_], is_filled: NDArray[np.bool_], by_others: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    filled = np.where(by_others, Source.RECONSTRUCTED, Source.INTERPOLATED)
    known = np.where(is_filled, filled, Source.MEASURED)
    return np.where(is_missing, Source.MISSING, known).astype(np.uint8)


def _read_points(path: Path, layout: Layout) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Positions (T, M, 3) in the file's unit, and each point's fourth word (T, M).

    That word is negative for a missing sample; else its high byte is the mask of cameras and its
    low byte the residual in steps of the scale.
    """
    T, M = layout.n_frames, layout.n_points
    n_halves = 2 if layout.scale < 0 else 1
    count = T * layout.frame_words * n_halves
    data = np.fromfile(path, dtype="<u2", count=count, offset=layout.offset)
    data = data.reshape(T, layout.frame_words * n_halves)[:, : 4 * M * n_halves]
    if layout.scale > 0:
        words = np.ascontiguousarray(data).view("<i2").reshape(T, M, 4)
        return words[..., :3] * layout.scale, words[..., 3].astype(np.int64)
    floats = floats_of_words(np.ascontiguousarray(data).ravel(), layout.processor).reshape(T, M, 4)
    fourth = np.clip(np.nan_to_num(floats[..., 3], nan=-1.0), -1, 0x7FFF)
    return floats[..., :3].astype(np.float64), np.floor(fourth).astype(np.int64)


def _texts(layout: Layout, name: str) -> list[str]:
    """The texts of a parameter of the group POINT; none if it is missing."""
    parameter = layout.parameters.get(("POINT", name))
    if parameter is None or parameter.kind != -1:
        return []
    length = parameter.shape[0] if parameter.shape else 1
    parts = [parameter.data[at : at + length] for at in range(0, len(parameter.data), length or 1)]
    return [_decoded(part).strip(" \0") for part in parts]


def _decoded(data: bytes) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _unit_mm(path: Path, layout: Layout) -> float:
    """Millimetres in the file's unit."""
    given = {unit.lower() for unit in _texts(layout, "UNITS")} - {""}
    if not given:
        _log.warning("%s: POINT:UNITS is missing; taken to be mm", path)
        return 1.0
    if len(given) > 1 or not given <= set(_UNIT_MM):
        found = ", ".join(sorted(given))
        raise FileFormatError(path, "POINT:UNITS", f"one of {', '.join(_UNIT_MM)}", found)
    return _UNIT_MM[given.pop()]


def _labels(layout: Layout) -> list[str]:
    found = _texts(layout, "LABELS")
    more = 2
    while ("POINT", f"LABELS{more}") in layout.parameters:  # a parameter has room for 255
        found.extend(_texts(layout, f"LABELS{more}"))
        more += 1
    return found


def _names(labels: Iterable[str], n_points: int) -> tuple[str, ...]:
    """As many names as points, all different."""
    given = list(labels)[:n_points]
    given += [""] * (n_points - len(given))
    found: list[str] = []
    taken = set(given)
    seen: set[str] = set()
    for number, name in enumerate(given, 1):
        unique = name
        count = 1 if name else number - 1
        while not unique or unique in seen or (unique != name and unique in taken):
            count += 1
            unique = f"{name or 'unnamed'}_{count}"
        seen.add(unique)
        found.append(unique)
    return tuple(found)


def _residual_px(
    layout: Layout, residual: NDArray[Any], is_missing: NDArray[np.bool_]
) -> NDArray[np.float64] | None:
    unit = layout.parameters.get((OWN_GROUP, "RESIDUAL_UNIT"))
    if unit is None or unit.data != b"px":
        return None
    steps = np.round(residual / abs(layout.scale))
    is_known = ~is_missing & (steps >= 1) & (steps <= MAX_STEPS)
    return np.where(is_known, residual, np.nan)
