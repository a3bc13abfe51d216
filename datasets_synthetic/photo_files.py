"""The folder of a photo session: photographs, mesh, marked points, and the truth."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.files import atomic_path, atomic_write
from ..core.formats.ply import PlyMesh, write_ply
from ..core.formats.rig_json import write_rig
from ..core.mesh import Mesh
from ..heads.appearance import png_bytes
from ..heads.head import Head
from .photo_pictures import Photographer
from .photo_points import MarkedPoints, mark_points, spread_points, visible_points
from .photos import PhotoSession, PhotoShot

_ORIENTATION_TAG = 0x0112  # of EXIF


def write_photos(
    folder: Path, session: PhotoSession, *, on_photo: Callable[[], object] | None = None
) -> None:
    """Take the photographs of a session and write its folder.

    ``photos.toml`` comes last: a folder that has it is complete. The same session gives the same
    bytes.

    Parameters
    ----------
    folder : Path
        It must exist.
    session : PhotoSession
    on_photo : callable, optional
        Called after each photograph.
    """
    truth = folder / "truth"
    for made in (folder / "points", truth / "points_exact"):
        made.mkdir(parents=True, exist_ok=True)
    (folder / "photos.toml").unlink(missing_ok=True)  # of an earlier session
    head = session.head
    write_ply(folder / "head.ply", PlyMesh(outer_skin(head)))
    write_ply(truth / "head.ply", PlyMesh(_as_textured(head), texture="albedo.png"), double=True)
    _write_bytes(truth / "albedo.png", png_bytes(np.asarray(head.appearance.skin)))
    write_rig(truth / "rig.json", session.rig)
    photographer = Photographer(session)
    counts = []
    for index, shot in enumerate(session.shots):
        exact = spread_points(visible_points(head, shot.camera), session.settings.points)
        rng = np.random.default_rng([session.seed, 84, index])
        marked = mark_points(exact, head, session.settings, rng)
        _write_points(folder / "points" / f"{shot.name}.csv", marked, named=False)
        _write_points(truth / "points_exact" / f"{shot.name}.csv", exact, named=True)
        counts.append(len(marked.names))
        _write_bytes(folder / f"{shot.name}.jpg", _jpeg(photographer.take(shot), shot))
        if on_photo is not None:
            on_photo()
    _write_truth(folder / "truth.npz", session)
    _write_toml(folder / "photos.toml", session, counts)


def outer_skin(head: Head) -> Mesh:
    """What a scanner sees of a head's skin: without the inside of the mouth and the eye sockets.

    One shell, open at the neck, the lids and between the lips. Vertices keep the head's order;
    those of other parts are left out. Texture coordinates are those of the head's textures.
    """
    hidden = [head.regions[n] for n in ("inner_mouth", "socket_l", "socket_r") if n in head.regions]
    kept = np.setdiff1d(head.mesh.groups["skin"], np.concatenate([np.zeros(0, np.int32), *hidden]))
    mesh = _as_textured(head)
    triangles = np.asarray(mesh.triangles)[kept]
    rows, inverse = np.unique(triangles, return_inverse=True)
    uv = uv_triangles = None
    if mesh.uv is not None and mesh.uv_triangles is not None:
        uv_rows, uv_inverse = np.unique(mesh.uv_triangles[kept], return_inverse=True)
        uv, uv_triangles = mesh.uv[uv_rows], uv_inverse.reshape(-1, 3).astype(np.int32)
    return Mesh(
        np.asarray(mesh.vertices)[rows],
        inverse.reshape(-1, 3).astype(np.int32),
        uv,
        uv_triangles,
    )


def _as_textured(head: Head) -> Mesh:
    """The head's mesh with the coordinates that its textures use."""
    mesh, looks = head.mesh, head.appearance
    uv = mesh.uv if looks.uv is None else looks.uv
    return Mesh(mesh.vertices, mesh.triangles, uv, mesh.uv_triangles)


def _jpeg(picture: NDArray[np.uint8], shot: PhotoShot) -> bytes:
    """The file of an upright picture; a turned one is stored as the sensor lay."""
    from PIL import Image

    stored = np.ascontiguousarray(np.rot90(picture, 1) if shot.orientation == 6 else picture)
    exif = Image.Exif()
    exif[_ORIENTATION_TAG] = shot.orientation
    stream = io.BytesIO()
    Image.fromarray(stored).save(
        stream, "JPEG", quality=shot.jpeg_quality, subsampling="4:4:4", exif=exif
    )
    return stream.getvalue()


def _write_bytes(path: Path, data: bytes) -> None:
    with atomic_path(path) as part:
        part.write_bytes(data)


def _write_points(path: Path, points: MarkedPoints, *, named: bool) -> None:
    with atomic_write(path) as stream:
        out = csv.writer(stream, lineterminator="\n")
        out.writerow([*(["name"] if named else []), "X", "Y", "Z", "u", "v"])
        for name, p, q in zip(points.names, points.on_mesh, points.on_photo, strict=True):
            numbers = [*(f"{x:.9g}" for x in p), *(f"{x:.9g}" for x in q)]
            out.writerow([*([name] if named else []), *numbers])


def _write_truth(path: Path, session: PhotoSession) -> None:
    shots = session.shots
    lamps = [(s.lights.key, s.lights.fill, s.lights.rim) for s in shots]
    around = [(s.lights.sky, s.lights.ground) for s in shots]
    arrays: dict[str, Any] = {
        "photo_names": np.array([s.name for s in shots]),
        "exposure_stops": np.array([s.exposure_stops for s in shots]),
        "white_balance": np.stack([s.white_balance for s in shots]),
        "full_well_e": np.array([s.full_well_e for s in shots]),
        "read_noise_e": np.array([s.read_noise_e for s in shots]),
        "pupil_mm": np.array([s.optics.pupil_mm for s in shots]),
        "focus_mm": np.array([s.optics.focus_mm for s in shots]),
        "psf_px": np.array([s.optics.psf_px for s in shots]),
        "vignetting": np.array([s.optics.vignetting for s in shots]),
        "jpeg_quality": np.array([s.jpeg_quality for s in shots]),
        "orientation": np.array([s.orientation for s in shots]),
        "stage_yaw_rad": np.array([s.stage_yaw_rad for s in shots]),
        "lamp_names": np.array(["key", "fill", "rim"]),
        "lamp_towards": np.array([[lamp.towards for lamp in three] for three in lamps]),
        "lamp_colour": np.array([[lamp.colour for lamp in three] for three in lamps]),
        "lamp_spread_rad": np.array([[lamp.spread_rad for lamp in three] for three in lamps]),
        "sky_ground": np.array(around),
    }
    with atomic_path(path) as part:
        np.savez_compressed(part, **arrays)


def _write_toml(path: Path, session: PhotoSession, counts: list[int]) -> None:
    s = session.settings
    lines = [
        "# Photographs of one head; lengths in mm, the world is the mesh's frame.",
        "version = 1",
        f"seed = {session.seed}",
        f'head = "{session.head.name}"',
        'mesh = "head.ply"',
        f"count = {s.count}",
        f"size = [{s.size[0]}, {s.size[1]}]",
        f"uniform = {str(s.uniform).lower()}",
        f"mark_noise_px = {s.mark_noise_px:g}",
        f"mark_noise_mm = {s.mark_noise_mm:g}",
    ]
    for shot, n_points in zip(session.shots, counts, strict=True):
        width, height = shot.camera.image_size
        lines += [
            "",
            "[[photo]]",
            f'file = "{shot.name}.jpg"',
            f'points = "points/{shot.name}.csv"',
            f"n_points = {n_points}",
            f"upright_size = [{width}, {height}]",
            f"exif_orientation = {shot.orientation}",
            f"exposure_stops = {shot.exposure_stops:.4f}",
            f"white_balance = [{', '.join(f'{g:.4f}' for g in shot.white_balance)}]",
            f"distance_mm = {np.linalg.norm(shot.camera.position):.1f}",
        ]
    with atomic_write(path) as stream:
        stream.write("\n".join(lines) + "\n")
