"""Facial animation tables as a NumPy archive (``.npz``), without pickles.

Members: ``version`` (1), ``max_error_mm``, ``rest`` (V, 3) float32 mm, ``faps`` (F,) text,
``n_knots`` and ``n_vertices`` (F,), and of all FAPs one after the other ``knots`` (sum of K,)
float64 in the table's units, ``vertices`` (sum of n,) int32, and ``offsets`` (sum of K n, 3)
float32 mm, knot by knot.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError
from ..fat import FacialTables, FapTable
from ..files import atomic_path
from .npz_members import read_npz_members

VERSION = 1
_MAX_BYTES = 2 * 1024**3  # of all members, unpacked: some hundred times a head of 20,000 vertices
_KINDS = {
    "version": "iu",
    "max_error_mm": "f",
    "rest": "f",
    "faps": "U",
    "n_knots": "iu",
    "n_vertices": "iu",
    "knots": "f",
    "vertices": "iu",
    "offsets": "f",
}


def write_fat_npz(path: Path, tables: FacialTables) -> None:
    """Write facial animation tables; they read back as they were, to the last bit."""
    rows = tables.tables
    none = np.zeros((0, 3), np.float32)
    with atomic_path(path) as part, open(part, "wb") as stream:
        np.savez_compressed(
            stream,
            version=np.int64(VERSION),
            max_error_mm=np.float64(tables.max_error_mm),
            rest=tables.rest,
            faps=np.array([t.fap for t in rows], dtype=np.str_),
            n_knots=np.array([len(t.knots) for t in rows], dtype=np.int64),
            n_vertices=np.array([len(t.vertices) for t in rows], dtype=np.int64),
            knots=np.concatenate([np.zeros(0), *(t.knots for t in rows)]),
            vertices=np.concatenate([np.zeros(0, np.int32), *(t.vertices for t in rows)]),
            offsets=np.concatenate([none, *(t.offsets.reshape(-1, 3) for t in rows)]),
        )


def read_fat_npz(path: Path) -> FacialTables:
    """Read facial animation tables.

    Raises
    ------
    FileFormatError
        If the file is no such archive, is damaged, unpacks to more than it may, or its parts do
        not fit together.
    OSError
        If it cannot be read.
    """
    found = read_npz_members(path, _KINDS, max_bytes=_MAX_BYTES)
    version = found["version"]
    if version.shape != () or int(version) != VERSION:
        raise FileFormatError(path, "version", str(VERSION), str(version))
    if found["max_error_mm"].shape != ():
        raise FileFormatError(path, "max_error_mm", "one number", f"{found['max_error_mm'].shape}")
    n_knots, n_vertices = _counts(path, found)
    try:
        rows = _rows(found, n_knots, n_vertices)
        return FacialTables(found["rest"], float(found["max_error_mm"]), rows)
    except ValueError as error:
        raise FileFormatError(path, "contents", "facial animation tables", str(error)) from error


def _counts(path: Path, found: dict[str, NDArray[Any]]) -> tuple[list[int], list[int]]:
    """Counts for each FAP, held against the arrays that they divide."""
    n_faps = found["faps"].size
    for name in ("n_knots", "n_vertices"):
        a = found[name]
        if a.shape != (n_faps,) or (a.size and (int(a.min()) < 0 or int(a.max()) > 2**31)):
            raise FileFormatError(path, name, f"{n_faps} counts", f"an array of shape {a.shape}")
    n_knots = [int(n) for n in found["n_knots"]]
    n_vertices = [int(n) for n in found["n_vertices"]]
    wanted = {
        "knots": (sum(n_knots),),
        "vertices": (sum(n_vertices),),
        "offsets": (sum(k * n for k, n in zip(n_knots, n_vertices, strict=True)), 3),
    }
    for name, shape in wanted.items():
        if found[name].shape != shape:
            raise FileFormatError(path, name, f"shape {shape}", f"{found[name].shape}")
    return n_knots, n_vertices


def _rows(
    found: dict[str, NDArray[Any]], n_knots: list[int], n_vertices: list[int]
) -> tuple[FapTable, ...]:
    rows, k, v, o = [], 0, 0, 0
    for name, nk, nv in zip(found["faps"].ravel(), n_knots, n_vertices, strict=True):
        offsets = found["offsets"][o : o + nk * nv].reshape(nk, nv, 3)
        rows.append(
            FapTable(
                str(name),
                found["knots"][k : k + nk],
                found["vertices"][v : v + nv].astype(np.int32),
                offsets,
            )
        )
        k, v, o = k + nk, v + nv, o + nk * nv
    return tuple(rows)
