"""Ready marker sets, and where a set's markers sit on a head."""

from __future__ import annotations

from functools import cache
from importlib.resources import as_file, files

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.formats.markers_toml import read_marker_set
from ..core.markers import FACE, MarkerSet
from ..core.mesh import Mesh, SurfacePoints
from .head import Head
from .identity import Identity, make_head
from .raycast import RayScene

#: Marker sets that come with the package, by name.
READY_SETS = ("kshirsagar", "full53", "few16")
#: How far from the lid's edge a lid marker is glued, so that upper and lower never touch.
LID_OFFSET_MM = 1.8
#: How far beside the corner of the mouth its marker is glued: in the crease it would be cut off.
CORNER_OFFSET_MM = 2.0
_CORNER_POINTS = {"8.3": 1.0, "8.4": -1.0}
_LID_POINTS = {"3.1": 1.0, "3.2": 1.0, "3.3": -1.0, "3.4": -1.0}


def ready_marker_set(name: str = "kshirsagar") -> MarkerSet:
    """A marker set that comes with the package; InputError if there is none of that name."""
    if name not in READY_SETS:
        raise InputError(f"no ready marker set {name}; there are {', '.join(READY_SETS)}")
    with as_file(files(__package__).joinpath("data", f"markers_{name}.toml")) as path:
        return read_marker_set(path)


def glue_markers(head: Head, marker_set: MarkerSet) -> SurfacePoints:
    """Points on a head's skin where a set's markers sit, named by label.

    Raises
    ------
    InputError
        If the head lacks a feature point of the set.
    """
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    scene = RayScene(head.mesh.vertices, skin)
    wanted = np.array([_marker_spot(head, marker_set, i) for i in range(len(marker_set.markers))])
    _, triangle, b = scene.closest(wanted)
    return SurfacePoints(marker_set.labels, skin[triangle], b / b.sum(axis=1, keepdims=True))


def _marker_spot(head: Head, marker_set: MarkerSet, index: int) -> NDArray[np.float64]:
    marker = marker_set.markers[index]
    if marker.feature_point == FACE and np.array_equal(head.mesh.triangles, _average().triangles):
        return _same_place(head, np.array(marker.template_mm))
    if marker.template_mm is not None:
        return np.array(marker.template_mm) * _size(head)
    if marker.feature_point not in head.points:
        raise InputError(f"head {head.name} has no feature point {marker.feature_point}")
    spot = np.array(head.points[marker.feature_point])
    spot[1] += _LID_POINTS.get(marker.feature_point, 0.0) * LID_OFFSET_MM
    spot[0] += _CORNER_POINTS.get(marker.feature_point, 0.0) * CORNER_OFFSET_MM
    return spot


@cache
def _average() -> Mesh:
    return make_head(Identity("average")).mesh


def _same_place(head: Head, spot: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where a spot of the average head's skin is on another head of ours."""
    average = _average()
    skin = average.triangles[average.groups["skin"]]
    _, triangle, b = RayScene(average.vertices, skin).closest(spot[None])
    return np.asarray(b[0] @ head.mesh.vertices[skin[triangle[0]]])


def _size(head: Head) -> NDArray[np.float64]:
    """A head's width, height and depth relative to the average head (for spots on the skull)."""
    p = head.points
    return np.array(
        [
            (p["10.1"][0] - p["10.2"][0]) / _AVERAGE_WIDTH_MM,
            (p["11.4"][1] - p["2.1"][1]) / _AVERAGE_HEIGHT_MM,
            (p["9.3"][2] - p["11.6"][2]) / _AVERAGE_DEPTH_MM,
        ]
    )


#: Of the built-in head ``average``.
_AVERAGE_WIDTH_MM, _AVERAGE_HEIGHT_MM, _AVERAGE_DEPTH_MM = 144.4, 209.3, 211.6
