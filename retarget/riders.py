"""What rides on the skin or the jaw and bends besides: lashes and the tongue."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from ..core.mesh import SurfacePoints
from ..core.mpeg4 import fap_table
from ..core.rigid import rotation_from_quaternion
from ..heads.head import Head
from ..heads.raycast import RayScene
from .controls import TONGUE_CONTROLS, Controls, joined_points, size_of
from .deformer import FeaturePointDeformer
from .jaw import JawMotion

#: Skin this near to points on a lid's edge carries lashes.
_LASH_ROOT_MM = 2.5


def bend_tongue(
    found: NDArray[np.float64],
    points: SurfacePoints,
    head: Head,
    faps: Mapping[str, NDArray[np.float64]],
    jaw: JawMotion,
) -> None:
    """Bend the tongue so that its points go where FAPs 43 to 46 say, whatever the jaw does.

    FAPs are displacements from the neutral face in the head's axes; the tables make no exception
    for the tongue, which goes with the jaw. A FAP that is 0 throughout says nothing, as
    encoders write that know nothing: there the tongue lies in the jaw as at rest.

    Parameters
    ----------
    found : (T, N, 3) float64, mm
        Displacements before the jaw's motion; those of the tongue are filled in.
    points : SurfacePoints
        The N points.
    head : Head
    faps : mapping from name to (T,) float64, table units
    jaw : JawMotion
    """
    back = np.swapaxes(rotation_from_quaternion(jaw.rotation), 1, 2)
    for name in TONGUE_CONTROLS:
        if name not in points.names:
            continue
        rest = head.points[name]
        moved = rest + jaw.displacement(rest)
        for fap in fap_table():
            is_said = fap.name in faps and bool(faps[fap.name].any())
            if fap.direction is not None and name in fap.feature_points and is_said:
                axis = int(np.abs(fap.direction).argmax())
                along = faps[fap.name] * head.fapu.unit(fap) * fap.direction[axis]
                moved[:, axis] = rest[axis] + along
        arm = moved - jaw.pivot - jaw.translation
        found[:, points.index(name)] = np.einsum("tij,tj->ti", back, arm) + jaw.pivot - rest


def with_lashes_and_tongue(
    head: Head, skin: NDArray[np.int32], on_skin: FeaturePointDeformer, controls: Controls
) -> FeaturePointDeformer:
    """The skin's deformer, with lashes that follow the edge of the lid and a tongue that bends."""
    carry = _lash_rows(head, skin, controls)
    names = tuple(n for n in TONGUE_CONTROLS if n in head.feature_points.names)
    if "tongue" not in head.mesh.groups or "6.1" not in names:
        names = ()
    bend = _tongue_table(head, names)
    tables: list[sparse.csr_matrix] = []
    for axis, table in enumerate(on_skin.tables):
        if axis and table is on_skin.tables[axis - 1]:
            tables.append(tables[-1])
            continue
        tables.append(sparse.hstack([table + carry @ table, bend]).tocsr())
    points = joined_points(on_skin.points, (head.feature_points.select(names),))
    return on_skin.joined(points, tuple(tables))


def _lash_rows(head: Head, skin: NDArray[np.int32], controls: Controls) -> sparse.csr_matrix:
    """(V, V): for each lash vertex, the corners of the skin that carries it.

    That is the nearest skin along the edges of the lids, so that lashes keep their shape while
    the lid behind them stretches.
    """
    v = head.mesh.vertices
    lashes = head.part_vertices("lashes")
    if not len(lashes):
        return sparse.csr_matrix((len(v), len(v)))
    edge = [lid.point.at(v)[0] for lid in controls.lids if lid.share == 1.0]
    edge += [head.points[n] for n in ("3.1", "3.2", "3.3", "3.4") if n in head.points]
    near = skin[_closest_mm(v[skin].mean(axis=1), np.array(edge)) < _LASH_ROOT_MM * size_of(head)]
    surface = near if len(near) else skin
    _, triangle, b = RayScene(v, surface).closest(v[lashes])
    place = (np.repeat(lashes, 3), surface[triangle].ravel())
    return sparse.csr_matrix((b.ravel(), place), (len(v), len(v)))


def _closest_mm(points: NDArray[np.float64], targets: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(cKDTree(targets).query(points)[0])


def _tongue_table(head: Head, names: tuple[str, ...]) -> sparse.csr_matrix:
    """(V, n): how much of the tip's (6.1) and the body's (6.2) motion the tongue's vertices make.

    By depth alone: the root stays, the body's share has its peak at 6.2, the tip's grows on.
    """
    n_vertices = len(head.mesh.vertices)
    if not names:
        return sparse.csr_matrix((n_vertices, 0))
    rows = head.part_vertices("tongue")
    z = head.mesh.vertices[rows, 2]
    tip, root = head.points["6.1"][2], z.min()
    body = head.points["6.2"][2] if "6.2" in names else (tip + root) / 2
    to_tip = _smoothstep((z - body) / (tip - body))
    shares = {"6.1": to_tip, "6.2": _smoothstep((z - root) / (body - root)) * (1 - to_tip)}
    dense = np.zeros((n_vertices, len(names)))
    for column, name in enumerate(names):
        dense[rows, column] = shares[name]
    return sparse.csr_matrix(dense)


def _smoothstep(t: NDArray[np.float64]) -> NDArray[np.float64]:
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)
