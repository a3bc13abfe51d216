"""How people's heads differ: the template under MakeHuman's targets as a linear model.

The outer skin under all targets, each weighted by how much its weight varies among people, is
reduced to principal components.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .identity import Identity, local_pairs, target_weights
from .regions import template_regions
from .template import load_template

Floats = NDArray[np.float64]

#: Regions of the skin that are laid onto a surface, and how much each counts.
_REGION_WEIGHTS = {
    "forehead": 0.7, "scalp": 0.25, "neck": 0.15, "nose": 1.0, "upper_lip": 1.0, "lower_lip": 1.0,
    "chin": 1.0, "brow": 1.0, "lids": 1.0, "orbit": 1.0, "temple": 0.5, "cheek": 1.0, "jaw": 0.7,
    "ear": 0.5,
}  # fmt: skip
_MEAN_AGE = 0.6
_SD_USUAL, _SD_LOCAL, _SD_RARE = 0.25, 0.3, 0.12
_VARIANCE_KEPT = 0.9995


@dataclass(frozen=True, eq=False)
class FaceModel:
    """The outer skin of the template and how people's heads differ from the mean.

    Attributes
    ----------
    rows : (n,) int64
        Vertices of the template.
    triangles : (f, 3) int32, rows of `rows`
    weight : (n,) float64
    mean : (n, 3) float64, mm
    basis : (K, n, 3) float64, mm
        Principal components, each by its standard deviation.
    targets : (K, N) float64
        The targets' weights in each component; `mean_targets` (N,) of the mean.
    """

    rows: NDArray[np.int64]
    triangles: NDArray[np.int32]
    weight: Floats
    mean: Floats
    basis: Floats
    targets: Floats
    mean_targets: Floats

    def whole(self, amounts: Floats) -> Floats:
        """All vertices of the template, (V, 3) mm, under amounts (K,) of the components."""
        template = load_template()
        weights = self.mean_targets + amounts @ self.targets
        return np.asarray(template.vertices + (weights @ template.identity).reshape(3, -1).T)


@cache
def face_model() -> FaceModel:
    """The model (about a second, once a process)."""
    template = load_template()
    names = template.identity_names
    mean = np.zeros(len(names))
    usual = target_weights(Identity("mean", age=_MEAN_AGE))
    for name, amount in usual.items():
        mean[names.index(name)] = amount
    rows, triangles, weight = _outer_skin()
    n_all = len(template.vertices)
    columns = np.concatenate([rows + axis * n_all for axis in range(3)])
    sd = _spreads(names)
    spread = sparse.diags(sd) @ template.identity[:, columns]
    gram = (spread @ spread.T).toarray()
    value, vector = np.linalg.eigh(gram)
    value, vector = value[::-1], vector[:, ::-1]
    n = int(np.searchsorted(np.cumsum(value) / value.sum(), _VARIANCE_KEPT)) + 1
    basis = (spread.T @ vector[:, :n]).T.reshape(n, 3, len(rows)).transpose(0, 2, 1)
    whole = template.vertices + (mean @ template.identity).reshape(3, -1).T
    return FaceModel(
        rows,
        triangles,
        weight,
        whole[rows],
        np.ascontiguousarray(basis),
        vector[:, :n].T * sd,
        mean,
    )


def _spreads(names: tuple[str, ...]) -> Floats:
    """Standard deviation of each target's weight among people."""
    local = {target for pair in local_pairs() for target in (*pair.positive, *pair.negative)}
    usual = ("universal-", "african-", "asian-", "caucasian-")
    found = [
        _SD_USUAL if n.startswith(usual) else _SD_LOCAL if n in local or "scale" in n else _SD_RARE
        for n in names
    ]
    return np.array(found)


def _outer_skin() -> tuple[NDArray[np.int64], NDArray[np.int32], Floats]:
    """Vertices of the template, triangles among them, and how much each vertex counts."""
    template, regions = load_template(), template_regions()
    weight = np.zeros(len(template.vertices))
    chosen = []
    for name, region in regions.items():
        plain = name.removesuffix("_l").removesuffix("_r")
        if plain in _REGION_WEIGHTS:
            chosen.append(region)
            corners = template.triangles[region].ravel()
            weight[corners] = np.maximum(weight[corners], _REGION_WEIGHTS[plain])
    triangles = template.triangles[np.concatenate(chosen)]
    rows, local = np.unique(triangles, return_inverse=True)
    return rows.astype(np.int64), local.reshape(-1, 3).astype(np.int32), weight[rows]
