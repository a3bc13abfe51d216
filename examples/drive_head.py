"""Drive a built-in head by FAPs that you write yourself.

    python examples/drive_head.py [--head NAME] [--out FOLDER]

Two seconds: the head smiles, blinks and turns. Writes gesture.fap, for any MPEG-4 player, and
gesture.glb, for any glTF viewer (``facewright view gesture.glb`` makes a page of it).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from facewright.core.clip import Clip
from facewright.core.formats.fap import write_fap
from facewright.core.formats.gltf import write_glb
from facewright.core.mpeg4 import fap_by_name
from facewright.heads.catalogue import built_in_head
from facewright.retarget.drive import HeadDrive
from facewright.retarget.export import animation_glb

RATE_HZ = 30
SECONDS = 2.0


def main() -> None:
    """Write the curves, move the head, write the files."""
    parser = argparse.ArgumentParser(description="Drive a head by FAPs.")
    parser.add_argument("--head", default="maya")
    parser.add_argument("--out", type=Path, default=Path())
    options = parser.parse_args()
    head = built_in_head(options.head)
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    smile = np.sin(np.pi * t / SECONDS) ** 2  # 0, 1 in the middle, 0
    blink = np.exp(-(((t - 1.0) / 0.07) ** 2))
    millimetres = {  # what is not given on the right side follows the left
        "stretch_l_cornerlip": 6 * smile,
        "raise_l_cornerlip": 5 * smile,
        "lift_l_cheek": 4 * smile,
        "close_t_l_eyelid": 9 * blink,
    }
    degrees = {"head_yaw": 15 * np.sin(2 * np.pi * t / SECONDS)}

    units = {name: head.fapu.unit(fap_by_name()[name]) for name in (*millimetres, *degrees)}
    curves = {name: mm / units[name] for name, mm in millimetres.items()}
    curves |= {name: np.deg2rad(d) / units[name] for name, d in degrees.items()}
    clip = Clip(t, tuple(curves), np.stack(list(curves.values()), axis=1))

    animation = HeadDrive(head).animate(clip)
    write_fap(options.out / "gesture.fap", clip)
    write_glb(options.out / "gesture.glb", animation_glb(head, animation, name="gesture"))
    moved = animation.vertices(len(t) // 2) - head.mesh.vertices
    print(f"{head.name}: {len(moved)} vertices, the farthest goes {np.abs(moved).max():.1f} mm")


if __name__ == "__main__":
    main()
