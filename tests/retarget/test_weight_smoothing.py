from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from facewright.retarget.surface_distances import mesh_edges
from facewright.retarget.weight_smoothing import SMOOTHING_FLOOR_MM, smoothed


@pytest.mark.parametrize("columns", [40, 70])
def test_it_is_the_diffusion_equations_solution(columns: int) -> None:
    n = 9
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    vertices = 3.0 * np.stack([x.ravel(), y.ravel(), 0.1 * x.ravel() ** 2], axis=1)
    a = (x[:-1, :-1] * n + y[:-1, :-1]).ravel()
    corners = [[a, a + n, a + n + 1], [a, a + n + 1, a + 1]]
    triangles = np.concatenate([np.stack(c, axis=1) for c in corners]).astype(np.int32)
    edges = mesh_edges(triangles)
    rng = np.random.default_rng(columns)
    table = sparse.random(81, columns, 0.3, format="csr", rng=rng)
    nearest = rng.uniform(0, 20, 81)

    found = smoothed(table, vertices, edges, nearest, 0.5).toarray()

    system = np.eye(81)
    for a, b in edges:
        reach = 0.5 * ((nearest[a] + nearest[b]) / 2 + SMOOTHING_FLOOR_MM)
        weight = (reach / np.linalg.norm(vertices[a] - vertices[b])) ** 2 / 6
        system[[a, b], [a, b]] += weight
        system[[a, b], [b, a]] -= weight
    np.testing.assert_allclose(found, np.linalg.solve(system, table.toarray()), atol=2e-6)
