"""Import an animated head (.glb or .usd) into Blender and draw one frame of it.

Inside Blender, or with the package bpy in a Python environment of its own (bpy is GPL and no
dependency of facewright)::

    blender --background --python docs/blender_render.py -- head.glb frame.png --time 1.2
    python docs/blender_render.py head.glb frame.png --time 1.2

What it does is what a user does by hand: File > Import > glTF 2.0, frame rate of the scene first.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import bpy
from mathutils import Vector


def main() -> None:
    """Read the options, import, light, look, draw."""
    options = _options()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    # before the import: it turns seconds into frames of the scene's rate
    scene.render.fps, scene.render.fps_base = _rate(options.fps)
    if options.head.suffix.lower() == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(options.head.resolve()))
    else:
        bpy.ops.wm.usd_import(filepath=str(options.head.resolve()))
    frame = options.time * scene.render.fps / scene.render.fps_base
    scene.frame_set(math.floor(frame), subframe=frame % 1)
    _say_what_came()
    _light(scene)
    _look(scene, options.turn)
    _draw(scene, options)


def _options() -> argparse.Namespace:
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("head", type=Path)
    parser.add_argument("picture", type=Path, help="a .png file")
    parser.add_argument("--time", type=float, default=0.0, help="seconds from the first frame")
    parser.add_argument("--fps", type=float, default=30.0, help="the scene's rate, frames a second")
    parser.add_argument("--turn", type=float, default=20.0, help="view from the side, degrees")
    parser.add_argument("--size", type=int, default=640, help="pixels")
    parser.add_argument("--save", type=Path, help="a .blend file to keep")
    return parser.parse_args(words)


def _rate(fps: float) -> tuple[int, float]:
    """Blender's frames a second and the base they are divided by: 29.97 is 30 / 1.001."""
    whole = round(fps)
    return (whole, 1.0) if abs(fps - whole) < 1e-3 else (math.ceil(fps), math.ceil(fps) / fps)


def _meshes() -> list[bpy.types.Object]:
    """The meshes that are drawn: the importer also makes a small one as the bones' shape."""
    shown = [o for o in bpy.context.scene.objects if o.type == "MESH"]
    return [o for o in shown if o.visible_get() and o.data.materials]


def _say_what_came() -> None:
    for thing in bpy.context.scene.objects:
        if thing.type == "ARMATURE":
            print("bones:", ", ".join(bone.name for bone in thing.data.bones))
    for thing in _meshes():
        keys = thing.data.shape_keys
        shapes = keys.key_blocks[1:] if keys else ()
        used = [f"{k.name} {k.value:.2f}" for k in shapes if abs(k.value) > 5e-3]
        print(f"{thing.name}: {len(shapes)} shapes; now {', '.join(used) or 'none'}")


def _light(scene: bpy.types.Scene) -> None:
    scene.world = bpy.data.worlds.new("studio")
    if scene.world.node_tree is None:  # before Blender 5
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.16, 0.17, 0.19, 1.0)
    for name, turn, rise, energy in (("key", 40, 35, 1.6), ("rim", 200, 40, 1.2)):
        sun = bpy.data.objects.new(name, bpy.data.lights.new(name, "SUN"))
        sun.data.energy, sun.data.angle = energy, math.radians(8)
        sun.rotation_euler = (math.radians(90 - rise), 0.0, math.radians(turn))
        scene.collection.objects.link(sun)


def _look(scene: bpy.types.Scene, turn_deg: float) -> None:
    """A camera before the face: Blender's z is up, and the face looks along -y."""
    corners = [o.matrix_world @ Vector(c) for o in _meshes() for c in o.bound_box]
    eyes = [o for o in _meshes() if o.name.startswith("eye")] or _meshes()
    middle = sum((o.matrix_world @ Vector(c) for o in eyes for c in o.bound_box), Vector())
    middle /= 8 * len(eyes)
    height = max(c.z for c in corners) - min(c.z for c in corners)
    middle.z -= 0.06 * height
    distance = 2.2 * height
    turn = math.radians(turn_deg)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.lens, camera.data.clip_start = 85.0, distance / 100
    camera.location = middle + distance * Vector((math.sin(turn), -math.cos(turn), 0.05))
    camera.rotation_euler = (middle - camera.location).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(camera)
    scene.camera = camera


def _draw(scene: bpy.types.Scene, options: argparse.Namespace) -> None:
    scene.render.engine = "CYCLES"  # on the processor: needs no display
    scene.cycles.device, scene.cycles.samples = "CPU", 48
    scene.render.resolution_x = scene.render.resolution_y = options.size
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = str(options.picture.resolve())
    if options.save is not None:
        bpy.ops.wm.save_as_mainfile(filepath=str(options.save.resolve()))
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()
