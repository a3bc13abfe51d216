"""What a page tells of a clip's channels: their region of the face, unit and range."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from ..core.clip import Clip
from ..core.mpeg4 import fap_by_name

#: Regions of the face in the order they are listed.
REGIONS = (
    "Jaw",
    "Lips",
    "Lids",
    "Brows",
    "Cheeks",
    "Nose",
    "Eyes",
    "Tongue",
    "Head",
    "Ears",
    "Visemes and expressions",
    "Other",
)
#: What the names of a region's channels look like: FAPs of MPEG-4, blendshapes of ARKit. The first
#: that fits is taken.
_PATTERNS: tuple[tuple[str, str], ...] = (
    ("Visemes and expressions", r"^(viseme|expression)\b"),
    ("Head", r"head|^neck"),
    ("Eyes", r"eyeball|pupil|eye_?look"),
    ("Lids", r"eyelid|blink|eye_?(squint|wide)"),
    ("Brows", r"brow"),
    ("Tongue", r"tongue"),
    ("Jaw", r"jaw|chin"),
    ("Nose", r"nose|nostril"),
    ("Cheeks", r"cheek"),
    ("Ears", r"_ear$|^ears?"),
    ("Lips", r"lip|mouth"),
)
_ANGLE_UNIT = "10⁻⁵ rad"
_FAPU_SCALE = "FAPU/1024"
#: How far a lively channel moves, by its scale: makes ranges of unlike units comparable.
_LIVELY = {_FAPU_SCALE: 300.0, _ANGLE_UNIT: 30000.0}
_N_SHOWN = 5


def channel_entries(clip: Clip) -> list[dict[str, Any]]:
    """Name, region, unit, scale (what shares an axis), title and range of each channel."""
    return [_entry(clip, i, name) for i, name in enumerate(clip.channels)]


def shown_first(entries: list[dict[str, Any]]) -> list[int]:
    """The channels plotted when the page opens: the liveliest of the liveliest regions."""
    lively: dict[str, tuple[float, int]] = {}
    for i, entry in enumerate(entries):
        low, high = entry["range"]
        score = (high - low) / _LIVELY.get(entry["scale"], 1.0)
        if entry["scale"] != "" or not entry["name"].startswith(("viseme.", "expression.")):
            lively[entry["region"]] = max(lively.get(entry["region"], (0.0, i)), (score, i))
    best = sorted(lively.values(), reverse=True)[:_N_SHOWN]
    return sorted(i for score, i in best if score > 0)


def region_of(channel: str) -> str:
    """The region of the face that a channel moves, by its name."""
    for region, pattern in _PATTERNS:
        if re.search(pattern, channel, re.IGNORECASE):
            return region
    return REGIONS[-1]


def _entry(clip: Clip, column: int, name: str) -> dict[str, Any]:
    unit, scale, title = _unit_of(name)
    values = clip.values[:, column].astype(np.float32)
    return {
        "name": name,
        "region": region_of(name),
        "unit": unit,
        "scale": scale,
        "title": title,
        "range": [float(np.nanmin(values)), float(np.nanmax(values))],
    }


def _unit_of(name: str) -> tuple[str, str, str]:
    """Unit, name of the axis it shares, and a longer description."""
    fap = fap_by_name().get(name)
    if fap is None or fap.fapu == "na":
        return "", "", name
    title = f"FAP {fap.number}"
    if fap.feature_points:
        title += f", feature point {' and '.join(fap.feature_points)}"
    if fap.fapu == "AU":
        return _ANGLE_UNIT, _ANGLE_UNIT, title
    return f"{fap.fapu}/1024", _FAPU_SCALE, title
