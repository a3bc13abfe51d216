"""Animated heads as .glb files: what they hold, writing and reading them."""

from .gltf_read import read_glb, scene_from_glb
from .gltf_scene import GltfPart, GltfScene, MorphTarget, unweld
from .gltf_write import glb_bytes, write_glb

__all__ = [
    "GltfPart",
    "GltfScene",
    "MorphTarget",
    "glb_bytes",
    "read_glb",
    "scene_from_glb",
    "unweld",
    "write_glb",
]
