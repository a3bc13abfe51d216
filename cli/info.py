"""`facewright info`: what is in a file, any format we read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.errors import FacewrightError, FileFormatError, InputError
from .description import Description
from .errors import BAD_INPUT, DebugOption, show_error
from .info_captures import (
    archive_contents,
    describe_picture,
    describe_ply,
    describe_settings,
    describe_table,
)
from .tables import cell_text, print_table, say, write_json

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..core.clip import Clip

#: More rows than this are not printed (the JSON has them all).
MAX_ROWS = 100


def info(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Any format we read.")],
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the same as JSON.")
    ] = None,
    debug: DebugOption = False,
) -> None:
    """What is in a file: a camera rig, markers, FAPs, a clip, a head, a video, a sound."""
    reports: list[dict[str, Any]] = []
    for path in files:
        try:
            described = describe_file(path)
        except (FacewrightError, OSError) as error:
            show_error(error, debug)
            reports.append({"file": str(path), "error": str(error)})
            continue
        if reports:
            say()
        _print(path, described)
        reports.append(_record(path, described))
    if json_file is not None:
        write_json(json_file, {"files": reports})
    if any("error" in report for report in reports):
        raise typer.Exit(BAD_INPUT)


def describe_file(path: Path) -> Description:
    """Look into a file.

    Raises
    ------
    FileFormatError
        If its contents are not what its format promises.
    InputError
        If it is of no format we read.
    OSError
        If it cannot be read.
    """
    return _DESCRIBE[_format_of(path)](path)


# The format ---------------------------------------------------------------------------------


#: What files begin with, whatever their names are: (offset, bytes, format).
_BEGINNINGS = (
    (0, b"glTF", "glb"),
    (0, b"PK\x03\x04", "npz"),
    (8, b"WAVE", "audio"),
    (8, b"AIFF", "audio"),
    (0, b"fLaC", "audio"),
    (8, b"AVI ", "video"),
    (4, b"ftypM4A", "audio"),
    (4, b"ftyp", "video"),
    (0, b"\x1a\x45\xdf\xa3", "video"),  # Matroska, WebM
    (0, b"\x89PNG\r\n\x1a\n", "picture"),
    (0, b"\xff\xd8\xff", "picture"),  # JPEG
    (0, b"ply\n", "ply"),
    (0, b"ply\r", "ply"),
)

_SUFFIXES = {
    **dict.fromkeys((".json", ".yaml", ".yml"), "rig"),
    ".c3d": "c3d",
    ".fap": "fap",
    ".npz": "npz",
    ".glb": "glb",
    ".toml": "toml",
    ".ply": "ply",
    ".csv": "csv",
    **dict.fromkeys((".png", ".jpg", ".jpeg"), "picture"),
    **dict.fromkeys((".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mpg", ".ogv"), "video"),
    **dict.fromkeys((".wav", ".flac", ".ogg", ".mp3", ".m4a", ".aif", ".aiff", ".opus"), "audio"),
}


def _format_of(path: Path) -> str:
    """The format by what the file begins with; by its suffix where that does not tell."""
    if path.is_dir():
        if (path / "cameras.txt").is_file():
            return "rig"
        raise InputError(f"{path} is a folder: name the files in it")
    if path.name.lower() in ("cameras.txt", "images.txt"):  # COLMAP's
        return "rig"
    with open(path, "rb") as stream:
        beginning = stream.read(16)
    if not beginning:
        raise FileFormatError(path, "file", "contents", "an empty file")
    for offset, magic, name in _BEGINNINGS:
        if beginning[offset : offset + len(magic)] == magic:
            return name
    by_suffix = _SUFFIXES.get(path.suffix.lower())
    if by_suffix is None:
        raise InputError(
            f"{path}: not a format that we read: rig.json, cameras in OpenCV or Kalibr YAML or "
            "COLMAP text, .c3d, .fap, .npz, .glb, .ply, .csv, markers.toml, take.toml, "
            "picture (PNG, JPEG), video (MP4, WebM, MOV, AVI), audio (WAV, FLAC, OGG, MP3)"
        )
    return by_suffix


# Each format --------------------------------------------------------------------------------


def _rig(path: Path) -> Description:
    import numpy as np

    from ..core.formats.rig_files import RIG_FORMATS, read_any_rig, rig_format

    rig = read_any_rig(path)
    used = rig_format(path)
    contents = "camera rig" if used == "rig.json" else f"camera rig ({RIG_FORMATS[used]})"
    places = np.array([camera.position for camera in rig.cameras.values()])
    between = np.linalg.norm(places[:, None] - places, axis=2)
    np.fill_diagonal(between, np.inf)
    items = tuple(
        {
            "name": name,
            "width_px": camera.image_size[0],
            "height_px": camera.image_size[1],
            "focal_px": camera.focal_px,
            "distortion": f"{camera.distortion_model}, {len(camera.distortion)} coefficients",
            "from_origin_mm": float(np.linalg.norm(camera.position)),
            "to_nearest_camera_mm": float(nearest) if np.isfinite(nearest) else None,
        }
        for (name, camera), nearest in zip(rig.cameras.items(), between.min(axis=1), strict=True)
    )
    return Description(contents, {"n_cameras": len(rig)}, "cameras", items)


def _c3d(path: Path) -> Description:
    import numpy as np

    from ..core.formats.c3d import read_c3d

    found = read_c3d(path)
    seen = ~np.isnan(found.positions[..., 0])
    items: tuple[dict[str, Any], ...] = tuple(
        {
            "name": name,
            "seen_percent": 100 * float(seen[:, m].mean()) if len(seen) else None,
            "n_filled": int(found.is_filled[:, m].sum()),
            **_gaps(seen[:, m]),
        }
        for m, name in enumerate(found.names)
    )
    facts = {
        "n_markers": len(found.names),
        **_time_facts(found.time_s, found.rate_hz),
        "n_gaps": sum(item["n_gaps"] for item in items),
        "seen_percent": 100 * float(seen.mean()) if seen.size else None,
    }
    return Description("marker trajectories (C3D)", facts, "markers", items)


def _gaps(seen: NDArray[np.bool_]) -> dict[str, int]:
    """Runs of frames in which a marker is not seen, (T,) bool, those at the ends included."""
    import numpy as np

    edges = np.flatnonzero(np.diff(np.concatenate([[True], seen, [True]]).astype(np.int8)))
    lengths = edges[1::2] - edges[::2]
    return {"n_gaps": len(lengths), "longest_gap_frames": int(lengths.max(initial=0))}


def _fap(path: Path) -> Description:
    from ..core.formats.fap import read_fap

    return _clip("MPEG-4 facial animation parameters (FAP)", read_fap(path))


def _clip(contents: str, clip: Clip) -> Description:
    import numpy as np

    from ..core.mpeg4 import fap_by_name

    assert clip.is_set is not None  # its constructor fills it in
    faps = fap_by_name()
    items = []
    for c, channel in enumerate(clip.channels):
        values = clip.values[clip.is_set[:, c], c]
        if not len(values):
            continue
        fap = faps.get(channel)
        items.append(
            {
                "channel": channel,
                "fap": fap.number if fap else None,
                "unit": _unit(fap.fapu) if fap else "",
                "n_set": len(values),
                "lowest": float(np.min(values)),
                "highest": float(np.max(values)),
            }
        )
    facts = {
        **_time_facts(clip.time_s, clip.rate_hz),
        "n_channels": len(clip.channels),
        "n_channels_set": len(items),
    }
    return Description(contents, facts, "channels", tuple(items))


def _unit(fapu: str) -> str:
    return {"AU": "1e-5 rad", "na": ""}.get(fapu, f"{fapu}/1024")


def _npz(path: Path) -> Description:
    import zipfile
    import zlib

    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            if {"time_s.npy", "channels.npy", "values.npy"} <= set(names):
                from ..core.formats.clip_npz import read_clip_npz

                return _clip("animation clip", read_clip_npz(path))
            items = tuple(_array(archive, name) for name in names)
    except FacewrightError:
        raise
    # what zipfile and numpy raise on damage; RuntimeError: encrypted, or packed by other means
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, RuntimeError) as error:
        raise FileFormatError(path, "file", "an archive of arrays (.npz)", str(error)) from error
    contents = archive_contents({item["name"] for item in items})
    return Description(contents, {"n_arrays": len(items)}, "arrays", items)


def _array(archive: Any, name: str) -> dict[str, Any]:
    """Name, shape and type of a stored array, from its header alone."""
    from numpy.lib import format as npy

    with archive.open(name) as stream:
        version = npy.read_magic(stream)
        read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = read_header(stream)
    return {
        "name": name.removesuffix(".npy"),
        "shape": " x ".join(map(str, shape)) or "one value",
        "type": str(dtype),
    }


def _glb(path: Path) -> Description:
    from ..core.formats.gltf import read_glb
    from ..core.time_base import uniform_rate_hz

    scene = read_glb(path)
    items: tuple[dict[str, Any], ...] = tuple(
        {
            "name": part.name,
            "n_vertices": len(part.vertices),
            "n_triangles": len(part.triangles),
            "n_morph_targets": len(part.targets),
        }
        for part in scene.parts
    )
    facts = {
        "n_parts": len(items),
        "n_vertices": sum(item["n_vertices"] for item in items),
        "n_triangles": sum(item["n_triangles"] for item in items),
        **_time_facts(scene.time_s, uniform_rate_hz(scene.time_s)),
    }
    return Description("3-D scene (glTF)", facts, "parts", items)


def _toml(path: Path) -> Description:
    return describe_settings(path) or _markers(path)


def _markers(path: Path) -> Description:
    from ..core.formats.markers_toml import read_marker_set

    found = read_marker_set(path)
    items = tuple(
        {"label": marker.label, "feature_point": marker.feature_point} for marker in found.markers
    )
    facts = {
        "name": found.name,
        "n_markers": len(items),
        "n_on_feature_points": len(found.label_by_feature_point),
        "n_on_head": len(found.head_labels),
    }
    return Description("marker set", facts, "markers", items)


def _video(path: Path) -> Description:
    from ..core.video import probe_video

    found = probe_video(path)
    facts = {
        "width_px": found.width,
        "height_px": found.height,
        "rate_hz": found.rate_hz,
        "n_frames": found.n_frames,
        "duration_s": found.duration_s,
        "codec": found.codec,
        "pixel_format": found.pixel_format,
        "bit_rate_mbit_s": found.bit_rate / 1e6 if found.bit_rate else None,
    }
    return Description("video", facts)


def _audio(path: Path) -> Description:
    import numpy as np

    from ..core.audio import read_audio

    found = read_audio(path)
    facts = {
        "rate_hz": found.rate_hz,
        "n_samples": len(found.samples),
        "duration_s": len(found.samples) / found.rate_hz,
        "peak": float(np.abs(found.samples).max(initial=0)),
    }
    return Description("audio", facts)


def _time_facts(time_s: NDArray[np.float64] | None, rate_hz: float | None) -> dict[str, Any]:
    if time_s is None or not len(time_s):
        return {"n_frames": 0}
    return {
        "n_frames": len(time_s),
        "rate_hz": rate_hz,
        "from_s": float(time_s[0]),
        "to_s": float(time_s[-1]),
    }


_DESCRIBE: dict[str, Callable[[Path], Description]] = {
    "rig": _rig,
    "c3d": _c3d,
    "fap": _fap,
    "npz": _npz,
    "glb": _glb,
    "toml": _toml,
    "ply": describe_ply,
    "picture": describe_picture,
    "csv": describe_table,
    "video": _video,
    "audio": _audio,
}


# What is shown ------------------------------------------------------------------------------


def _print(path: Path, described: Description) -> None:
    facts = [(f"  {_words(name)}", cell_text(value)) for name, value in described.facts.items()]
    print_table(("", ""), facts, title=f"{cell_text(path)}: {described.contents}")
    if described.items:
        say()
        columns = tuple(_words(key) for key in described.items[0])
        rows = [tuple(item.values()) for item in described.items[:MAX_ROWS]]
        print_table(columns, rows)
    if len(described.items) > MAX_ROWS:
        say(f"and {len(described.items) - MAX_ROWS} more {described.items_name} (--json has all)")


def _words(name: str) -> str:
    return name.removeprefix("n_").replace("_", " ")


def _record(path: Path, described: Description) -> dict[str, Any]:
    record: dict[str, Any] = {"file": str(path), "contents": described.contents, **described.facts}
    if described.items_name:
        record[described.items_name] = list(described.items)
    return record
