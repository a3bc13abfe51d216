"""The folder of a scan: what the scanner gives, and the truth.

A folder that has ``scan.toml`` is complete: it is written last.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..core.files import atomic_path, atomic_write
from ..core.formats.ply import PlyMesh, write_ply
from ..core.rigid import Rigid
from ..heads.appearance import png_bytes
from .scan_meshes import MeshScan
from .scan_target import ScanTarget
from .scans import QUANTUM_MM, CylinderScan

#: Levels of ``range.png`` are this long; level 0 is a void.
RANGE_LEVEL_MM = 0.01


def write_cylinder_scan(folder: Path, target: ScanTarget, scan: CylinderScan, seed: int) -> None:
    """Write ``range.png``, ``colour.png``, ``scan.npz``, the truth, and ``scan.toml``.

    Parameters
    ----------
    folder : Path
        It must exist.
    target : ScanTarget
        What was scanned.
    scan : CylinderScan
    seed : int
        To be named in ``scan.toml``.
    """
    import cv2

    (folder / "scan.toml").unlink(missing_ok=True)  # of an earlier scan
    levels = np.nan_to_num(np.rint(scan.range_mm / RANGE_LEVEL_MM)).astype(np.uint16)
    done, png = cv2.imencode(".png", levels)
    assert done, "OpenCV encodes every 16-bit picture"
    _write_bytes(folder / "range.png", bytes(png))
    _write_bytes(folder / "colour.png", png_bytes(np.asarray(scan.colour)))
    _write_npz(
        folder / "scan.npz",
        {
            "range_mm": scan.range_mm,
            "angle_rad": scan.angle_rad,
            "height_mm": scan.height_mm,
            "axis_point_mm": np.zeros(3),
            "axis_direction": np.array([0.0, 1.0, 0.0]),
        },
    )
    _write_truth(folder, target, scan.scan_from_head, {"exact_range_mm": scan.exact_mm})
    lines = [
        "# Range and colour over a cylinder about a head. The point of row i, column j is",
        "# (r sin angle[j], height[i], r cos angle[j]) in the scan frame.",
        "version = 1",
        'kind = "cylinder"',
        f"seed = {seed}",
        f'head = "{target.head.name}"',
        'units = "mm"',
        f"size = [{scan.range_mm.shape[1]}, {scan.range_mm.shape[0]}]",
        f"range_level_mm = {RANGE_LEVEL_MM:g}  # of range.png; level 0 is a void",
        f"quantum_mm = {QUANTUM_MM:g}",
        f"voids = {float(np.isnan(scan.range_mm).mean()):.4f}  # share of the picture",
        *_pose_lines(scan.scan_from_head),
    ]
    _write_toml(folder, lines)


def write_mesh_scan(folder: Path, target: ScanTarget, scan: MeshScan, seed: int) -> None:
    """Write ``scan.ply`` with colours, the truth, and ``scan.toml``.

    Parameters
    ----------
    folder : Path
        It must exist.
    target : ScanTarget
        What was scanned.
    scan : MeshScan
    seed : int
        To be named in ``scan.toml``.
    """
    (folder / "scan.toml").unlink(missing_ok=True)  # of an earlier scan
    write_ply(folder / "scan.ply", PlyMesh(scan.mesh, np.asarray(scan.colour)))
    more = {"exact_vertices": scan.exact, "patch": scan.patch}
    _write_truth(folder, target, scan.scan_from_head, more)
    lines = [
        "# A scanned surface in the scanner's own frame.",
        "version = 1",
        'kind = "mesh"',
        f"seed = {seed}",
        f'head = "{target.head.name}"',
        'units = "mm"',
        f"vertices = {len(scan.mesh.vertices)}",
        f"triangles = {len(scan.mesh.triangles)}",
        f"patches = {int(scan.patch.max(initial=0)) + 1}",
        *_pose_lines(scan.scan_from_head),
    ]
    _write_toml(folder, lines)


def _write_truth(
    folder: Path, target: ScanTarget, scan_from_head: Rigid, more: dict[str, Any]
) -> None:
    """``truth.ply`` in the head frame; ``truth.npz``: motion, landmarks and `more`."""
    write_ply(folder / "truth.ply", PlyMesh(target.mesh), double=True)
    head = target.head
    names, places = list(head.points), np.stack(list(head.points.values()))
    if head.mesh.landmarks is not None:
        names += head.mesh.landmarks.names
        places = np.concatenate([places, head.mesh.landmarks.at(np.asarray(head.mesh.vertices))])
    _write_npz(
        folder / "truth.npz",
        {
            "scan_from_head_quaternion": scan_from_head.quaternion,
            "scan_from_head_translation": scan_from_head.translation,
            "landmark_names": np.array(names),
            "landmarks_head": places,
            "landmarks_scan": scan_from_head.apply(places),
            **more,
        },
    )


def _pose_lines(scan_from_head: Rigid) -> list[str]:
    q, t = scan_from_head.quaternion, scan_from_head.translation
    return [
        "",
        "[scan_from_head]",
        f"quaternion = [{', '.join(repr(float(x)) for x in q)}]  # w x y z",
        f"translation = [{', '.join(repr(float(x)) for x in t)}]",
    ]


def _write_bytes(path: Path, data: bytes) -> None:
    with atomic_path(path) as part:
        part.write_bytes(data)


def _write_npz(path: Path, arrays: dict[str, Any]) -> None:
    with atomic_path(path) as part:
        np.savez_compressed(part, **arrays)


def _write_toml(folder: Path, lines: list[str]) -> None:
    with atomic_write(folder / "scan.toml") as stream:
        stream.write("\n".join(lines) + "\n")
