"""Trajectories as a 3-D model: a ball for every marker, and a head among them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from ..core.formats.gltf_scene import GltfPart, GltfScene, MorphTarget
from ..core.markers import MarkerSet
from ..core.mesh import vertex_normals
from ..core.rigid import quaternion_from_rotation
from ..core.trajectories import Trajectories
from ..heads.identity import Identity, make_head
from ..heads.subdivision import icosphere
from ..tracking.labelling import template_positions
from ..tracking.rigid_fit import fit_rigid, fit_similarity
from .preview import marker_colour

_BALL_MM = 2.2
#: More samples a second than a screen shows are left out.
MAX_RATE_HZ = 30.0
_HEAD_COLOUR = (0.55, 0.58, 0.62, 1.0)


def marker_scene(tracks: Trajectories, marker_set: MarkerSet | None) -> GltfScene:
    """Balls that move as the markers did, and a head among them.

    A ball is gone while its marker is missing. The head is the average one, bent so that its
    markers come to lie where those of the first frame that shows most of them are; it moves as
    the head markers do, stiff, and stays as it was where they are missing.

    Parameters
    ----------
    tracks : Trajectories
        mm, world frame.
    marker_set : MarkerSet or None
        Of labelled trajectories; without one, no head is shown.
    """
    step = max(1, round((tracks.rate_hz or MAX_RATE_HZ) / MAX_RATE_HZ))
    rows = np.arange(0, len(tracks.time_s), step)
    p = tracks.positions[rows]
    middle = np.nanmedian(p.reshape(-1, 3), axis=0)
    parts = [_ball(name, p[:, m] - middle) for m, name in enumerate(tracks.names)]
    if marker_set is not None and tracks.names == marker_set.labels:
        parts.append(_head(p - middle, marker_set))
    return GltfScene("markers", tuple(parts), tracks.time_s[rows] - tracks.time_s[0])


def _held(p: NDArray[np.float64]) -> NDArray[np.float64]:
    """Missing rows as the last known, at the beginning as the first; zeros if none is known."""
    known = ~np.isnan(p.reshape(len(p), -1)).any(axis=1)
    if not known.any():
        return np.zeros_like(p)
    at = np.maximum.accumulate(np.where(known, np.arange(len(p)), -1))
    return np.asarray(p[np.where(at < 0, np.argmax(known), at)])


def _ball(name: str, p: NDArray[np.float64]) -> GltfPart:
    directions, triangles = icosphere(1)
    vertices = _BALL_MM * directions
    gone = np.isnan(p[:, 0])
    targets: tuple[MorphTarget, ...] = ()
    weights = None
    if gone.any():
        targets = (MorphTarget("missing", np.arange(len(vertices), dtype=np.int32), -vertices),)
        weights = gone[:, None].astype(np.float64)
    colour = np.array(marker_colour(name)) / 255
    return GltfPart(
        name=name,
        vertices=vertices,
        triangles=triangles,
        normals=directions,
        base_color=np.array([*colour**2.2, 1.0]),
        roughness=0.6,
        targets=targets,
        weights=weights,
        translation=_held(p),
    )


def _head(p: NDArray[np.float64], marker_set: MarkerSet) -> GltfPart:
    head = make_head(Identity("average"), texture_px=256)
    template = template_positions(marker_set)
    best = int(np.argmax((~np.isnan(p[..., 0])).sum(axis=1)))
    seen = ~np.isnan(p[best, :, 0])
    s, R0, t0 = fit_similarity(template[seen], p[best, seen])
    rigid = [i for i, m in enumerate(marker_set.markers) if m.is_rigid]
    R, t = fit_rigid(p[best, rigid], p[:, rigid])
    R, t = _held(R), _held(t)
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    used, rows = np.unique(skin, return_inverse=True)
    laid = s * template[seen] @ R0.T + t0
    vertices = (s * head.mesh.vertices @ R0.T + t0)[used]
    vertices = vertices + RBFInterpolator(laid, p[best, seen] - laid, kernel="linear")(vertices)
    triangles = rows.reshape(skin.shape).astype(np.int32)
    return GltfPart(
        name="average head",
        vertices=vertices,
        triangles=triangles,
        normals=vertex_normals(vertices, triangles),
        base_color=np.array(_HEAD_COLOUR),
        roughness=0.9,
        rotation=quaternion_from_rotation(R),
        translation=t,
    )
