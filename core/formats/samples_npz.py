"""All that is known of every sample of trajectories, as a NumPy archive (``.npz``).

Members: ``version`` (1), ``time_s`` (T,), ``names`` (M,) text, ``positions`` (T, M, 3) mm, NaN
where missing, ``source`` (T, M) uint8 (0 missing, 1 measured, 2 interpolated, 3 reconstructed),
``covariances`` (T, M, 3, 3) mm² and ``residual_px`` (T, M), NaN where not known, ``n_views``
(T, M), 0 where not known. No pickles. C3D holds less: no covariances, coarse residuals.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import atomic_path
from ..trajectories import Trajectories
from .npz_members import read_npz_members

VERSION = 1
_MAX_BYTES = 16 * 1024**3  # of all members, unpacked: some hours of markers
_KINDS = {
    "version": "iu",
    "time_s": "f",
    "names": "U",
    "positions": "f",
    "source": "iu",
    "covariances": "f",
    "residual_px": "f",
    "n_views": "iu",
}


def write_samples_npz(path: Path, trajectories: Trajectories) -> None:
    """Write trajectories; what they hold reads back as it was, to the last bit."""
    shape = trajectories.source.shape
    residual, n_views = trajectories.residual_px, trajectories.n_views
    covariances = trajectories.covariances
    with atomic_path(path) as part, open(part, "wb") as stream:
        np.savez_compressed(
            stream,
            version=np.int64(VERSION),
            time_s=trajectories.time_s,
            names=np.array(trajectories.names, dtype=np.str_),
            positions=trajectories.positions,
            source=trajectories.source,
            covariances=np.full((*shape, 3, 3), np.nan) if covariances is None else covariances,
            residual_px=np.full(shape, np.nan) if residual is None else residual,
            n_views=np.zeros(shape, np.int32) if n_views is None else n_views,
        )


def read_samples_npz(path: Path) -> Trajectories:
    """Read trajectories.

    Raises
    ------
    FileFormatError
        If the file is no such archive, is damaged, or unpacks to more than it may.
    OSError
        If it cannot be read.
    """
    found = read_npz_members(path, _KINDS, max_bytes=_MAX_BYTES)
    version = found["version"]
    if version.shape != () or int(version) != VERSION:
        raise FileFormatError(path, "version", str(VERSION), str(version))
    try:
        return Trajectories(
            found["time_s"],
            tuple(str(n) for n in found["names"].ravel()),
            found["positions"],
            found["covariances"],
            found["source"].astype(np.uint8),
            found["residual_px"],
            found["n_views"],
        )
    except ValueError as error:
        raise FileFormatError(path, "contents", "trajectories", str(error)) from error
