"""What a decoded frame looks like: RGB or luma, turned as it is to be shown."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: 8-bit formats whose first plane is luma (or gray) for each pixel.
_LUMA_PLANE_8 = frozenset(
    ["gray", "nv12", "nv21", "nv16", "nv24", "nv42", "yuva420p", "yuva422p", "yuva444p"]
    + [f"yuv{j}{layout}p" for j in ("", "j") for layout in (410, 411, 420, 422, 440, 444)]
)
#: swscale's flags: bilinear colour for each pixel, rounded right. Its fast path is off by up to 4
#: grey levels, and takes the colour of every other pixel.
EXACT_SCALING = 0x2 | 0x40000 | 0x2000


def rgb_of(frame: Any) -> NDArray[np.uint8]:
    """Colours, (h, w, 3) uint8, as coded: not turned yet."""
    return np.asarray(frame.to_ndarray(format="rgb24", interpolation=EXACT_SCALING))


def luma_of(frame: Any) -> NDArray[np.uint8]:
    """Brightness, (h, w) uint8, as coded; a view of the decoder's memory where it can be."""
    layout = frame.format
    bits = layout.components[0].bits
    is_luma_first = layout.name in _LUMA_PLANE_8
    if is_luma_first and frame.planes[0].line_size >= frame.width:
        plane = frame.planes[0]
        rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
        return rows[: frame.height, : frame.width]
    is_yuv = layout.name.startswith(("yuv", "gray")) and layout.name.endswith("le")
    if is_yuv and 8 < bits <= 16 and layout.is_planar | (len(layout.components) == 1):
        plane = frame.planes[0]
        rows = np.frombuffer(plane, "<u2").reshape(-1, plane.line_size // 2)
        wide = rows[: frame.height, : frame.width].astype(np.uint32)
        rounded = (wide + (1 << (bits - 9))) >> (bits - 8)
        return np.asarray(np.minimum(rounded, 255), dtype=np.uint8)
    if layout.is_rgb:
        return np.asarray(frame.to_ndarray(format="gray"))
    return luma_of(frame.reformat(format="yuv420p"))  # packed or semi-planar: same range


def turn_of(frame: Any) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """What turns a stream's pictures as they are to be shown, by the matrix beside its first frame.

    Looking at a frame's side data ties it into a reference cycle, which keeps its picture in
    memory until the garbage collector comes by: so it is done once a stream.
    """
    data = next((bytes(d) for d in frame.side_data if d.type.name == "DISPLAYMATRIX"), None)
    if data is None or len(data) < 36:
        return lambda image: image
    # x' = a x + c y, y' = b x + d y; 16.16 fixed point, in the machine's order
    a, b, _, c, d = (int(x) for x in np.frombuffer(data, np.int32, count=5))
    swaps = abs(a) + abs(d) < abs(b) + abs(c)
    flip_x, flip_y = (c < 0, b < 0) if swaps else (a < 0, d < 0)
    if not (swaps or flip_x or flip_y):
        return lambda image: image
    down, right = slice(None, None, -1 if flip_y else 1), slice(None, None, -1 if flip_x else 1)

    def turned(image: NDArray[Any]) -> NDArray[Any]:
        upright = image.swapaxes(0, 1) if swaps else image
        return np.ascontiguousarray(upright[down, right])

    return turned
