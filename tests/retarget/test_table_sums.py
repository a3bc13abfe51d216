from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from facewright.retarget.table_sums import FRAMES_AT_ONCE, table_sums


@pytest.mark.parametrize("n_frames", [0, 1, 2, 11, 12, FRAMES_AT_ONCE, FRAMES_AT_ONCE + 5, 53])
def test_sums_are_the_sparse_product_and_the_same_in_batches(n_frames: int) -> None:
    rng = np.random.default_rng(n_frames)
    table = sparse.random(77, 9, 0.2, format="csr", rng=rng)
    table.data -= 0.5
    moves = rng.normal(size=(n_frames, 9, 3))
    found = np.full((n_frames, 77, 3), np.nan)

    table_sums(table, moves, found)

    wanted = np.einsum("vn,tna->tva", table.toarray(), moves)
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    assert (np.diff(table.indptr) == 0).any(), "some vertices stay"
    for frame in range(n_frames):
        one = np.empty((1, 77, 3))
        table_sums(table, moves[frame : frame + 1], one)
        np.testing.assert_array_equal(one[0], found[frame])


def test_displacements_need_not_be_contiguous() -> None:
    rng = np.random.default_rng(2)
    table = sparse.random(40, 6, 0.4, format="csr", rng=rng)
    for n_frames in (3, 30):
        wide = rng.normal(size=(n_frames, 12, 6))
        found = np.empty((n_frames, 40, 3))
        table_sums(table, wide[:, ::2, 1:4], found)
        wanted = np.einsum("vn,tna->tva", table.toarray(), wide[:, ::2, 1:4])
        np.testing.assert_allclose(found, wanted, atol=1e-12)
