"""Samples of trajectories as archives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facewright.core.errors import FileFormatError
from facewright.core.formats.samples_npz import read_samples_npz, write_samples_npz
from facewright.core.trajectories import Source, Trajectories


def take(n_frames: int = 20, n_markers: int = 3) -> Trajectories:
    rng = np.random.default_rng(0)
    shape = (n_frames, n_markers)
    p = rng.normal(size=(*shape, 3))
    source = rng.integers(0, 4, shape).astype(np.uint8)
    p[source == Source.MISSING] = np.nan
    return Trajectories(
        np.arange(n_frames) / 60,
        tuple(f"m{i}" for i in range(n_markers)),
        p,
        rng.normal(size=(*shape, 3, 3)),
        source,
        rng.random(shape),
        rng.integers(0, 5, shape).astype(np.int32),
    )


def test_what_is_written_reads_back(tmp_path: Path) -> None:
    given = take()
    write_samples_npz(tmp_path / "a.npz", given)
    found = read_samples_npz(tmp_path / "a.npz")
    assert found.names == given.names
    for name in ("time_s", "positions", "covariances", "source", "residual_px", "n_views"):
        np.testing.assert_array_equal(getattr(found, name), getattr(given, name))


def test_what_is_not_known_says_so(tmp_path: Path) -> None:
    given = take()
    plain = Trajectories(given.time_s, given.names, given.positions, source=given.source)
    write_samples_npz(tmp_path / "a.npz", plain)
    found = read_samples_npz(tmp_path / "a.npz")
    assert found.covariances is not None and np.isnan(found.covariances).all()
    assert found.n_views is not None and not found.n_views.any()


def test_archives_that_are_none_are_refused(tmp_path: Path) -> None:
    write_samples_npz(tmp_path / "a.npz", take())
    data = (tmp_path / "a.npz").read_bytes()
    for n_bytes in (0, 10, len(data) // 2):
        (tmp_path / "b.npz").write_bytes(data[:n_bytes])
        with pytest.raises(FileFormatError, match=r"b\.npz"):
            read_samples_npz(tmp_path / "b.npz")
    np.savez(tmp_path / "c.npz", version=np.int64(2))
    with pytest.raises(FileFormatError, match="time_s"):
        read_samples_npz(tmp_path / "c.npz")
