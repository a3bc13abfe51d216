"""What a head's file of ours says besides its meshes, so that reading it again is exact.

It is a JSON text in the extras of the .glb's scene: other programs skip it, and most keep it.
"""

from __future__ import annotations

import base64
import binascii
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.errors import FileFormatError
from .head import Eye

Floats = NDArray[np.float64]

#: Where in the scene's extras the facts are.
FACTS_KEY = "facewright_head"
#: As many regions as `HeadFacts.region_bits` has room for.
MAX_REGIONS = 64
_VERSION = 1
_MAX_TRIANGLES = 1 << 22
_BITS = np.dtype("<u8")
_DECIMALS = 5


@dataclass(frozen=True, eq=False)
class HeadFacts:
    """What is known of a head besides its meshes. All places are (3,) mm, head frame.

    Attributes
    ----------
    name : str
    points : mapping from feature point to place
        Those of its surface.
    landmarks : mapping from Farkas's name to place
    eyes : mapping from side to Eye
    jaw_pivot, neck_pivot : places
    lips_part : bool
    regions : tuple of str
    region_bits : (n,) uint64
        For each triangle of the skin the regions that it belongs to: bit i for ``regions[i]``.
    """

    name: str
    points: Mapping[str, Floats]
    landmarks: Mapping[str, Floats]
    eyes: Mapping[str, Eye]
    jaw_pivot: Floats
    neck_pivot: Floats
    lips_part: bool
    regions: tuple[str, ...] = ()
    region_bits: NDArray[np.uint64] = field(default_factory=lambda: np.zeros(0, np.uint64))

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "jaw_pivot", readonly(self.jaw_pivot, (3,), "jaw_pivot"))
        put(self, "neck_pivot", readonly(self.neck_pivot, (3,), "neck_pivot"))
        if len(self.regions) > MAX_REGIONS:
            raise ValueError(f"at most {MAX_REGIONS} regions, got {len(self.regions)}")
        put(self, "region_bits", readonly(self.region_bits, (None,), "region_bits", np.uint64))


def facts_text(facts: HeadFacts) -> str:
    """The facts as they stand in the file."""
    packed = zlib.compress(facts.region_bits.astype(_BITS).tobytes(), 9)
    return json.dumps(
        {
            "version": _VERSION,
            "name": facts.name,
            "points": {name: _numbers(p) for name, p in facts.points.items()},
            "landmarks": {name: _numbers(p) for name, p in facts.landmarks.items()},
            "eyes": {
                side: [*_numbers(eye.centre), round(eye.radius, _DECIMALS)]
                for side, eye in facts.eyes.items()
            },
            "jaw_pivot": _numbers(facts.jaw_pivot),
            "neck_pivot": _numbers(facts.neck_pivot),
            "lips_part": facts.lips_part,
            "regions": list(facts.regions),
            "region_bits": base64.b64encode(packed).decode("ascii"),
        },
        separators=(",", ":"),
        allow_nan=False,
    )


def _numbers(p: Floats) -> list[float]:
    return [round(float(x), _DECIMALS) for x in p]


def facts_in_extras(extras: Mapping[str, str], path: Path) -> HeadFacts | None:
    """The facts in a scene's extras; None where they are not.

    Raises
    ------
    FileFormatError
        If they are damaged.
    """
    if FACTS_KEY not in extras:
        return None
    try:
        return _facts_of(json.loads(extras[FACTS_KEY]))
    except (ValueError, KeyError, TypeError, AttributeError, zlib.error, binascii.Error) as error:
        raise FileFormatError(
            path, f"scene extras {FACTS_KEY}", "the facts of a head as facewright writes them",
            f"{type(error).__name__}: {error}",
        ) from error  # fmt: skip


def _facts_of(found: Any) -> HeadFacts:
    if found["version"] != _VERSION:
        raise ValueError(f"version {found['version']}; this program reads {_VERSION}")
    eyes = {}
    for side in ("right", "left"):
        if side in found["eyes"]:
            x, y, z, radius = _finite(found["eyes"][side], 4)
            eyes[side] = Eye(np.array([x, y, z]), float(radius))
    regions = tuple(str(name) for name in found["regions"])
    unpacked = zlib.decompressobj().decompress(
        base64.b64decode(found["region_bits"], validate=True), _BITS.itemsize * _MAX_TRIANGLES
    )
    region_bits = np.frombuffer(unpacked, _BITS).astype(np.uint64)
    if len(regions) < MAX_REGIONS and (region_bits >> np.uint64(len(regions))).any():
        raise ValueError("a region that has no name")
    return HeadFacts(
        str(found["name"]),
        {str(name): _finite(p, 3) for name, p in found["points"].items()},
        {str(name): _finite(p, 3) for name, p in found["landmarks"].items()},
        eyes,
        _finite(found["jaw_pivot"], 3),
        _finite(found["neck_pivot"], 3),
        bool(found["lips_part"]),
        regions,
        region_bits,
    )


def _finite(values: Any, count: int) -> Floats:
    found = np.array(values, dtype=np.float64)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise ValueError(f"{count} finite numbers, not {values}")
    return found
