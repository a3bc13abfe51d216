"""Charts of a head's feature points and of where markers go, to check by eye."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.camera import Camera
from ..core.markers import MarkerSet
from .head import Head
from .marker_sets import glue_markers
from .raycast import RayScene
from .render import HeadRenderer, portrait_camera

_PANEL_PX = (1000, 1200)
_FONT, _TEXT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.42
_ROW_PX = 17
_VIEWS = (("front", 0.0), ("left", 1.25))
_MARGIN = 0.04  # of the picture, that points keep from its edge
_SEEN, _BEHIND = (255, 196, 60), (150, 170, 190)


def feature_point_chart(head: Head) -> NDArray[np.uint8]:
    """Front and side views with every feature point, its name beside and a line between.

    Parameters
    ----------
    head : Head

    Returns
    -------
    (h, w, 3) uint8, sRGB
        Bright: on the surface that is seen. Grey: behind or within it. The side view shows the
        subject's left, and only points that are not on the right.
    """
    return _chart(head, head.points)


def marker_chart(head: Head, marker_set: MarkerSet) -> NDArray[np.uint8]:
    """Front and side views with every marker of a set where it is to be glued.

    Parameters
    ----------
    head : Head
    marker_set : MarkerSet

    Returns
    -------
    (h, w, 3) uint8, sRGB
        As of `feature_point_chart`.

    Raises
    ------
    InputError
        If the head lacks a feature point of the set.
    """
    glue = glue_markers(head, marker_set)
    return _chart(head, dict(zip(glue.names, glue.at(head.mesh.vertices), strict=True)))


def _chart(head: Head, points: Mapping[str, NDArray[np.float64]]) -> NDArray[np.uint8]:
    renderer = HeadRenderer(head)
    panels = []
    for name, yaw in _VIEWS:
        shown = {n: p for n, p in points.items() if name == "front" or p[0] > -1.0}
        camera = portrait_camera(head, _PANEL_PX, yaw_rad=yaw)
        camera = _framing(camera, np.array(list(shown.values())))
        panel = renderer.render(head.mesh.vertices, camera)
        panels.append(_labelled(panel, head, camera, shown))
    return np.concatenate(panels, axis=1)


def _framing(camera: Camera, points: NDArray[np.float64]) -> Camera:
    """The camera, or one that sees less near so that all points are in the picture.

    A portrait ends on the neck; a mask has none, and its chin would be cut off.
    """
    size = np.array(camera.image_size, dtype=np.float64)
    at = camera.project(points)
    low, high = _MARGIN * size, (1 - _MARGIN) * size
    if (at >= low).all() and (at <= high).all():
        return camera
    middle = (size - 1) / 2
    first, last = np.minimum(at.min(axis=0), low), np.maximum(at.max(axis=0), high)
    zoom = float(((high - low) / (last - first)).min())
    K = np.array(camera.matrix)
    K[:2, :2] *= zoom
    K[:2, 2] = middle + zoom * (K[:2, 2] - (first + last) / 2)
    return replace(camera, matrix=K)


def _labelled(
    panel: NDArray[np.uint8],
    head: Head,
    camera: Camera,
    points: dict[str, NDArray[np.float64]],
) -> NDArray[np.uint8]:
    width, height = _PANEL_PX
    found = np.ascontiguousarray(panel)
    names = list(points)
    at = camera.project(np.array([points[n] for n in names]))
    seen = _is_seen(head, camera, np.array([points[n] for n in names]))
    middle = np.median(at[:, 0])
    margin = 14 + max(cv2.getTextSize(n, _FONT, _TEXT_SCALE, 1)[0][0] for n in names)
    for side in (0, 1):
        rows = [i for i in range(len(names)) if (at[i, 0] >= middle) == bool(side)]
        rows.sort(key=lambda i: at[i, 1])
        ys = _spread(np.array([at[i, 1] for i in rows]), height)
        for i, y in zip(rows, ys, strict=True):
            colour = _SEEN if seen[i] else _BEHIND
            end = (width - margin, round(y)) if side else (margin, round(y))
            dot = (round(at[i, 0]), round(at[i, 1]))
            cv2.line(found, dot, end, colour, 1, cv2.LINE_AA)
            cv2.circle(found, dot, 3, (20, 20, 20), -1, cv2.LINE_AA)
            cv2.circle(found, dot, 2, colour, -1, cv2.LINE_AA)
            corner = (end[0] + 4 if side else 10, end[1] + 5)
            cv2.putText(
                found, names[i], corner, _FONT, _TEXT_SCALE, (245, 245, 245), 1, cv2.LINE_AA
            )
    return found


def _spread(wanted: NDArray[np.float64], height: int) -> NDArray[np.float64]:
    """Rows for labels near the wanted ones (rising), `_ROW_PX` apart, within the picture."""
    step = min(_ROW_PX, (height - 20) / max(len(wanted), 1))
    offset = step * np.arange(len(wanted))
    free = wanted - offset  # labels keep apart if this does not fall: isotonic regression
    blocks: list[list[float]] = []
    for value in free:
        blocks.append([float(value), 1.0])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            b = blocks.pop()
            a = blocks[-1]
            blocks[-1] = [(a[0] * a[1] + b[0] * b[1]) / (a[1] + b[1]), a[1] + b[1]]
    level = np.concatenate([np.full(int(n), value) for value, n in blocks] or [np.zeros(0)])
    highest = height - 10 - (offset[-1] if len(offset) else 0)
    return np.asarray(np.clip(level, 10, highest) + offset)


def _is_seen(head: Head, camera: Camera, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether nothing but a skin's depth lies between the camera and each point."""
    scene = RayScene(head.mesh.vertices - camera.position, head.mesh.triangles)
    towards = points - camera.position
    distance = np.linalg.norm(towards, axis=1)
    t, *_ = scene.cast(np.zeros(3), towards / distance[:, None])
    return np.asarray(t > distance - 1.5)
