"""Persons as NumPy archives (``.npz``), so that a new take is labelled from an old one.

Members: ``version`` (1), ``marker_set`` and ``labels`` (M,) text, ``neutral`` (M, 3) and ``modes``
(K, M, 3) float64 mm, ``noise_mm`` (M,) float64, ``is_known`` (M,) bool, ``log_scale_sd`` float64,
``n_frames`` int64. No pickles.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import atomic_path
from ..person import Person
from .npz_members import read_npz_members

VERSION = 1
_MAX_BYTES = 64 * 1024**2  # of all members, unpacked
_KINDS = {
    "version": "iu",
    "marker_set": "U",
    "labels": "U",
    "neutral": "f",
    "modes": "f",
    "noise_mm": "f",
    "is_known": "b",
    "log_scale_sd": "f",
    "n_frames": "iu",
}
_SCALARS = ("version", "marker_set", "log_scale_sd", "n_frames")


def read_person_npz(path: Path) -> Person:
    """Read a person.

    Raises
    ------
    FileFormatError
        If the file is no such archive, is damaged, or unpacks to more than it may.
    OSError
        If it cannot be read.
    """
    found = read_npz_members(path, _KINDS, max_bytes=_MAX_BYTES)
    for name in _SCALARS:
        if found[name].shape != ():
            raise FileFormatError(path, name, "a single value", f"shape {found[name].shape}")
    version = int(found["version"])
    if version != VERSION:
        raise FileFormatError(path, "version", str(VERSION), str(version))
    try:
        return Person(
            marker_set=str(found["marker_set"]),
            labels=tuple(str(n) for n in found["labels"].ravel()),
            neutral=found["neutral"],
            modes=found["modes"],
            noise_mm=found["noise_mm"],
            is_known=found["is_known"],
            log_scale_sd=float(found["log_scale_sd"]),
            n_frames=int(found["n_frames"]),
        )
    except ValueError as error:
        raise FileFormatError(path, "contents", "a person", str(error)) from error


def write_person_npz(path: Path, person: Person) -> None:
    """Write a person; it reads back as it was, to the last bit."""
    with atomic_path(path) as part, open(part, "wb") as stream:
        np.savez_compressed(
            stream,
            version=np.int64(VERSION),
            marker_set=np.array(person.marker_set),
            labels=np.array(person.labels, dtype=np.str_),
            neutral=person.neutral,
            modes=person.modes,
            noise_mm=person.noise_mm,
            is_known=person.is_known,
            log_scale_sd=np.float64(person.log_scale_sd),
            n_frames=np.int64(person.n_frames),
        )
