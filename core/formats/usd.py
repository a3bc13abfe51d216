"""Animated heads as USD files, with a UsdSkel skeleton and blend shapes (extra: ``usd``).

One ``SkelRoot`` holds everything. Joints are those of `GltfPart.joint`; weights of blend shapes and
turns of joints are time samples of one ``SkelAnimation``. Metres, y up. Frame 0 of the scene is
time code 0.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..audio import Audio, write_audio
from ..errors import InputError
from ..files import atomic_path
from .gltf_scene import GltfScene
from .usd_looks import add_materials, pictures_of
from .usd_skeleton import add_skeleton

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
#: Time codes a second where frames are not evenly spaced.
UNEVEN_RATE = Fraction(60)
_SOUND = "sound.wav"
#: Frames of a rate may be off by this share of one: time stamps are rounded.
_SNAP = 0.05


def check_usd() -> None:
    """Say how to get USD where it is not installed.

    Raises
    ------
    InputError
        If the package usd-core is missing.
    """
    try:
        import pxr.UsdSkel  # noqa: F401
    except ImportError:
        raise InputError(
            "USD files need the package usd-core: pip install 'facewright[usd]'"
        ) from None


def write_usd(
    path: Path, scene: GltfScene, *, rate: Fraction | None = None, sound: Audio | None = None
) -> None:
    """Write a scene as a USD file, which appears whole or not at all.

    A ``.usdz`` holds textures and sound; the others have them in a folder ``NAME_files`` beside.

    Parameters
    ----------
    path : Path
        ``.usd`` and ``.usdc`` are binary, ``.usda`` is text.
    scene : GltfScene
    rate : Fraction or None
        Time codes a second, so that each frame has a whole number; None: `UNEVEN_RATE`.
    sound : Audio or None
        Starts with the first frame.

    Raises
    ------
    InputError
        If usd-core is missing or the suffix is another.
    OSError
        If a file cannot be written.
    """
    check_usd()
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: expected a name that ends in {', '.join(SUFFIXES)}")
    pictures = pictures_of(scene)
    is_package = suffix == ".usdz"
    folder = "files" if is_package else f"{path.stem}_files"
    stage = _stage(scene, rate or UNEVEN_RATE, folder, pictures, sound)
    if is_package:
        _write_package(path, stage, folder, pictures, sound)
    else:
        _write_beside(path, stage, folder, pictures, sound)


def _stage(
    scene: GltfScene,
    rate: Fraction,
    folder: str,
    pictures: Mapping[bytes, str],
    sound: Audio | None,
) -> Any:
    """A stage in memory."""
    from pxr import Kind, Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    codes = time_codes(scene.time_s, rate)
    stage.SetTimeCodesPerSecond(float(rate))
    stage.SetFramesPerSecond(float(rate))
    stage.SetStartTimeCode(0.0)
    last = float(codes[-1]) if len(codes) else 0.0
    heard = 0.0 if sound is None else sound.duration_s * float(rate)  # the last pose is held
    stage.SetEndTimeCode(max(last, heard))
    root = UsdSkel.Root.Define(stage, "/Head")
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    stage.SetDefaultPrim(root.GetPrim())
    stage.GetRootLayer().documentation = f"{scene.name}, by facewright"
    meshes = add_skeleton(stage, scene, codes)
    add_materials(stage, scene, meshes, {data: f"./{folder}/{n}" for data, n in pictures.items()})
    if sound is not None:
        _add_sound(stage, f"./{folder}/{_SOUND}")
    return stage


def time_codes(time_s: NDArray[np.float64], rate: Fraction) -> NDArray[np.float64]:
    """Time codes of times, (T,): whole numbers where all frames are at such."""
    codes = time_s * rate.numerator / rate.denominator
    whole = np.rint(codes)
    is_even = len(codes) and np.abs(codes - whole).max() < _SNAP and (np.diff(whole) > 0).all()
    return whole if is_even else codes


def _add_sound(stage: Any, file: str) -> None:
    from pxr import Sdf, UsdMedia

    sound = UsdMedia.SpatialAudio.Define(stage, "/Head/Sound")
    sound.CreateFilePathAttr(Sdf.AssetPath(file))
    sound.CreateAuralModeAttr(UsdMedia.Tokens.nonSpatial)
    sound.CreatePlaybackModeAttr(UsdMedia.Tokens.onceFromStart)


def _write_beside(
    path: Path,
    stage: Any,
    folder: str,
    pictures: Mapping[bytes, str],
    sound: Audio | None,
) -> None:
    with atomic_path(path) as part:
        _export(stage, part)
        if pictures or sound is not None:
            _write_assets(path.with_name(folder), pictures, sound)


def _write_package(
    path: Path,
    stage: Any,
    folder: str,
    pictures: Mapping[bytes, str],
    sound: Audio | None,
) -> None:
    from pxr import Sdf

    with ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=path.parent)))
        part = stack.enter_context(atomic_path(path))
        layer = scratch / f"{path.stem}.usdc"
        _export(stage, layer)
        _write_assets(scratch / folder, pictures, sound)
        # a package starts with its layer; the writer aligns files as the format asks
        files = [layer, *sorted((scratch / folder).iterdir())]
        with Sdf.ZipFileWriter.CreateNew(str(part)) as package:
            for file in files:
                inside = file.relative_to(scratch).as_posix()
                if not package.AddFile(str(file), inside):
                    raise OSError(f"{path}: {inside} cannot be put into the package")


def _export(stage: Any, path: Path) -> None:
    from pxr import Tf

    try:
        done = stage.GetRootLayer().Export(str(path))
    except Tf.ErrorException as error:
        raise OSError(f"{path}: cannot be written ({error})") from error
    if not done:
        raise OSError(f"{path}: cannot be written")


def _write_assets(folder: Path, pictures: Mapping[bytes, str], sound: Audio | None) -> None:
    folder.mkdir(exist_ok=True)
    for data, name in pictures.items():
        with atomic_path(folder / name) as part, open(part, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
    if sound is not None:
        write_audio(folder / _SOUND, sound)
