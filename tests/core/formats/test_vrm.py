"""Expressions of VRM 0 and VRM 1 avatars by their morph targets."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import pytest

from facewright.core.errors import FileFormatError
from facewright.core.formats.glb_document import GlbDocument
from facewright.core.formats.gltf import GltfPart, GltfScene, MorphTarget, glb_bytes
from facewright.core.formats.vrm import vrm_expressions


def avatar() -> bytes:
    """A triangle with three morph targets."""
    rows = np.arange(3, dtype=np.int32)
    targets = tuple(
        MorphTarget(name, rows, np.full((3, 3), i + 1.0))
        for i, name in enumerate(("M_A", "Blink_L", "Blink_R"))
    )
    part = GltfPart("Face", np.eye(3), np.array([[0, 1, 2]]), np.eye(3), targets=targets)
    return glb_bytes(GltfScene("avatar", (part,), np.zeros(0)))


def with_extension(data: bytes, extensions: dict[str, Any]) -> GlbDocument:
    size = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + size])
    document["extensions"] = extensions
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    header = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    return GlbDocument("a.vrm", header + struct.pack("<I4s", len(text), b"JSON") + text + rest)


def test_vrm_0_presets_and_own_names() -> None:
    groups = [
        {"name": "Blink", "presetName": "blink",
         "binds": [{"mesh": 0, "index": 1, "weight": 100}, {"mesh": 0, "index": 2, "weight": 50}]},
        {"name": "Smug", "presetName": "unknown", "binds": [{"mesh": 0, "index": 0, "weight": 30}]},
        {"name": "Neutral", "presetName": "neutral", "binds": []},
    ]  # fmt: skip

    found = vrm_expressions(
        with_extension(avatar(), {"VRM": {"blendShapeMaster": {"blendShapeGroups": groups}}})
    )

    assert found == {"blink": {"Blink_L": 1.0, "Blink_R": 0.5}, "Smug": {"M_A": 0.3}}


def test_vrm_1_presets_and_custom_ones() -> None:
    data = avatar()
    nodes = GlbDocument("a", data).root["nodes"]
    node = next(i for i, n in enumerate(nodes) if "mesh" in n)
    expressions = {
        "preset": {"aa": {"morphTargetBinds": [{"node": node, "index": 0, "weight": 1}]}},
        "custom": {"wink": {"morphTargetBinds": [{"node": node, "index": 1, "weight": 0.5}]}},
    }

    found = vrm_expressions(with_extension(data, {"VRMC_vrm": {"expressions": expressions}}))

    assert found == {"aa": {"M_A": 1.0}, "wink": {"Blink_L": 0.5}}


def test_a_glb_without_expressions_has_none() -> None:
    assert vrm_expressions(GlbDocument("a.glb", avatar())) == {}


@pytest.mark.parametrize("bind", [{"mesh": 7, "index": 0}, {"mesh": 0, "index": 3}, "x"])
def test_binds_to_what_is_not_there_are_refused(bind: Any) -> None:
    group = {"name": "x", "presetName": "joy", "binds": [bind]}
    extensions = {"VRM": {"blendShapeMaster": {"blendShapeGroups": [group]}}}

    with pytest.raises(FileFormatError, match="expression joy"):
        vrm_expressions(with_extension(avatar(), extensions))
