"""Expressions of VRM avatars (``.vrm``: a .glb with an extension), version 0 and 1.

An expression is a sum of morph targets. Here it comes by the targets' names, so that it can be
built from a scene that `gltf_read` has read.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .glb_document import GlbDocument, Object
from .gltf_read import target_names

#: Percent in VRM 0; shares of 1 in VRM 1.
_PERCENT = 100.0


def vrm_expressions(document: GlbDocument) -> dict[str, dict[str, float]]:
    """Each expression's morph targets and their weights; empty where the file has none.

    Names are as given: the preset's name (``blink_l``, ``aa``), or the artist's.

    Raises
    ------
    FileFormatError
        If an expression speaks of a mesh, node or target that is not there.
    """
    extensions = document.member(document.root, "extensions", "document")
    found = {}
    if "VRMC_vrm" in extensions:
        expressions = document.member(
            document.member(extensions, "VRMC_vrm", "extensions"), "expressions", "VRMC_vrm"
        )
        for kind in ("preset", "custom"):
            for name, expression in document.member(expressions, kind, "expressions").items():
                found[str(name)] = _sum(document, str(name), expression, "morphTargetBinds", 1.0)
    elif "VRM" in extensions:
        master = document.member(
            document.member(extensions, "VRM", "extensions"), "blendShapeMaster", "VRM"
        )
        for group in document.array(master, "blendShapeGroups", "blendShapeMaster"):
            name = _name_in_0(group)
            if name:
                found[name] = _sum(document, name, group, "binds", _PERCENT)
    return {name: weights for name, weights in found.items() if weights}


def _name_in_0(group: Any) -> str:
    if not isinstance(group, Mapping):
        return ""
    preset, name = group.get("presetName"), group.get("name")
    if isinstance(preset, str) and preset not in ("", "unknown"):
        return preset
    return name if isinstance(name, str) else ""


def _sum(
    document: GlbDocument, name: str, expression: Any, key: str, whole: float
) -> dict[str, float]:
    where = f"expression {name}"
    if not isinstance(expression, Mapping):
        document.fail(where, "an object", expression)
    found: dict[str, float] = {}
    for bind in document.array(expression, key, where):
        if not isinstance(bind, Mapping):
            document.fail(where, f"{key} that are objects", bind)
        mesh = _mesh_of(document, bind, where)
        names = _all_target_names(document, mesh, where)
        index = document.integer(bind, "index", where)
        if index >= len(names):
            document.fail(where, f"a target below {len(names)}", index)
        weight = document.number(bind, "weight", where, whole) / whole
        found[names[index]] = weight
    return found


def _mesh_of(document: GlbDocument, bind: Object, where: str) -> Object:
    if "node" in bind:
        node = document.item("nodes", bind["node"], where)
        return document.item("meshes", node.get("mesh"), where)
    return document.item("meshes", bind.get("mesh"), where)


def _all_target_names(document: GlbDocument, mesh: Object, where: str) -> list[str]:
    primitives = document.array(mesh, "primitives", where)
    if not primitives or not isinstance(primitives[0], Mapping):
        document.fail(where, "a mesh with primitives", "none")
    count = len(document.array(primitives[0], "targets", where))
    return target_names(mesh, primitives[0], count)
