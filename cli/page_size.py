"""Making models small for a page, in ways that are not seen."""

from __future__ import annotations

import json
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..core.formats.glb_document import GlbDocument

#: A mesh's size has this many steps: a head's are below 8 µm.
_POSITION_BITS = 16
_NORMAL_STEP = 2.0**-9
_WEIGHT_STEP = 2.0**-13
_FLOAT, _SINGLE_BYTES = 5126, 4


def rounded_glb(glb: bytes) -> bytes:
    """A .glb file whose coordinates, normals and weights are rounded, so that it packs well.

    Coordinates go to steps of a 65,536th of the mesh's size (rounded up to a power of two), normals
    to 1/512, weights of blendshapes to 1/8192. All else stays as it is, as do values that are not
    stored as plain rows of floats of their own, such as those of compressed or interleaved files.
    """
    document = GlbDocument("the model", glb)
    steps = dict(_steps(document))
    shared = _shared_views(document.root)
    data = bytearray(glb)
    start = _binary_start(glb)
    bounds: dict[int, tuple[list[float], list[float]]] = {}
    for index, step in steps.items():
        accessor = document.root["accessors"][index]
        if accessor.get("componentType") != _FLOAT:
            continue
        for view_index in _views(accessor):
            view = document.root["bufferViews"][view_index]
            if view_index in shared or view.get("buffer", 0) != 0 or "byteStride" in view:
                continue
            place = slice(
                start + view.get("byteOffset", 0),
                start + view.get("byteOffset", 0) + view["byteLength"],
            )
            if view["byteLength"] % _SINGLE_BYTES:
                continue
            values = np.frombuffer(bytes(data[place]), "<f4")
            data[place] = _rounded(values, step).tobytes()
        if "min" in accessor and "max" in accessor:
            low, high = (np.array(accessor[k], "<f4") for k in ("min", "max"))
            bounds[index] = _rounded(low, step).tolist(), _rounded(high, step).tolist()
    return _with_bounds(bytes(data), bounds)


def _rounded(values: np.ndarray[Any, Any], step: float) -> np.ndarray[Any, np.dtype[np.float32]]:
    whole = np.rint(values / np.float32(step))
    return np.asarray(whole * np.float32(step), dtype="<f4") + np.float32(0.0)  # no -0


def _steps(document: GlbDocument) -> Iterator[tuple[int, float]]:
    """The accessors that may be rounded, and to what."""
    root = document.root
    for mesh in root.get("meshes", []):
        for primitive in mesh.get("primitives", []):
            attributes = primitive.get("attributes", {})
            if "POSITION" not in attributes:
                continue
            step = _position_step(root["accessors"][attributes["POSITION"]])
            for group in (attributes, *primitive.get("targets", [])):
                if "POSITION" in group:
                    yield group["POSITION"], step
                if "NORMAL" in group:
                    yield group["NORMAL"], _NORMAL_STEP
    for animation in root.get("animations", []):
        for channel in animation.get("channels", []):
            if channel.get("target", {}).get("path") == "weights":
                yield animation["samplers"][channel["sampler"]]["output"], _WEIGHT_STEP


def _position_step(accessor: dict[str, Any]) -> float:
    reach = max((abs(x) for x in [*accessor.get("min", []), *accessor.get("max", [])]), default=0.0)
    return float(2.0 ** (np.ceil(np.log2(max(reach, 1e-6))) - _POSITION_BITS + 1))


def _views(accessor: dict[str, Any]) -> list[int]:
    found = [accessor["bufferView"]] if "bufferView" in accessor else []
    if "sparse" in accessor:
        found.append(accessor["sparse"]["values"]["bufferView"])
    return found


def _shared_views(root: Mapping[str, Any]) -> set[int]:
    """Buffer views that several accessors read."""
    counts = Counter(v for accessor in root.get("accessors", []) for v in _views(accessor))
    return {view for view, n in counts.items() if n > 1}


def _binary_start(glb: bytes) -> int:
    """Where the binary chunk's data begins; the file's end if there is none."""
    length = struct.unpack_from("<I", glb, 12)[0]
    return min(20 + int(length) + 8, len(glb))


def _with_bounds(glb: bytes, bounds: dict[int, tuple[list[float], list[float]]]) -> bytes:
    """The file with other least and greatest values of accessors."""
    length = struct.unpack_from("<I", glb, 12)[0]
    root = json.loads(glb[20 : 20 + length])
    for index, (low, high) in bounds.items():
        root["accessors"][index] |= {"min": low, "max": high}
    text = json.dumps(root, separators=(",", ":"), ensure_ascii=False).encode("utf-8")
    text += b" " * (-len(text) % 4)
    rest = glb[20 + length :]
    header = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    return header + struct.pack("<I4s", len(text), b"JSON") + text + rest
