"""Truth in pieces is truth in one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from facewright.datasets_synthetic.truth_file import join_truth


def test_blocks_are_joined_along_their_rows(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(7, 3, 2)), rng.integers(0, 9, size=7)
    for i, rows in enumerate((slice(0, 4), slice(4, 5), slice(5, 7))):
        np.savez(tmp_path / f"{i}.npz", a=a[rows], b=b[rows])

    blocks = [tmp_path / f"{i}.npz" for i in range(3)]
    join_truth(blocks, tmp_path / "all.npz", {"names": np.array(["x", "yy"])})

    with np.load(tmp_path / "all.npz", allow_pickle=False) as z:
        np.testing.assert_array_equal(z["a"], a)
        np.testing.assert_array_equal(z["b"], b)
        assert z["b"].dtype == b.dtype
        assert z["names"].tolist() == ["x", "yy"]


def test_the_same_blocks_give_the_same_bytes(tmp_path: Path) -> None:
    np.savez(tmp_path / "0.npz", a=np.arange(5.0))

    for name in ("one", "two"):
        join_truth([tmp_path / "0.npz"], tmp_path / f"{name}.npz", {"n": np.array([1])})

    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
