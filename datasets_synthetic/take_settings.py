"""What a take simulates, and ``take.toml``, which says it.

::

    version = 1
    seed = 7
    seconds = 4.0
    kind = "markers"            # "plain": no markers; "wand": a calibration wand, nobody

    [performance]
    style = "mixed"             # "expressions", "speech", "range"
    voice = true                # sound of the speech

    [cameras]
    count = 4
    image_size = [1280, 720]
    rate_hz = 60.0

and so on: every table and key is a field of the types below. A file may leave out what it does
not change, so ``facewright synth take --settings take.toml`` repeats a take, and a few lines of
one's own describe a new kind.
"""

from __future__ import annotations

import dataclasses
import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.errors import FileFormatError, InputError
from ..core.files import atomic_write, read_text

VERSION = 1
KINDS = ("markers", "plain", "wand")
MAX_CAMERAS = 8
SHORTEST_VOICE_S = 1.5
_LOOKS = ("dots", "spheres")


@dataclass(frozen=True)
class PerformanceSettings:
    """What the actor does: style, and whether one hears the speech."""

    style: str = "mixed"
    voice: bool = False


@dataclass(frozen=True)
class ActorSettings:
    """Who acts: a built-in head's name, or "" for a random person; years only for the latter.

    `strangeness` 1 makes a face and expressions that no identity has (`strangeness`).
    """

    head: str = ""
    youngest_years: float = 20.0
    oldest_years: float = 70.0
    strangeness: float = 0.0


@dataclass(frozen=True)
class MarkerSettings:
    """Markers: flat painted "dots" or retro-reflective "spheres" of a ready set."""

    look: str = "dots"
    set: str = "kshirsagar"
    radius_mm: float = 1.6


@dataclass(frozen=True)
class CameraSettings:
    """Cameras around the face; `exposure_s` and the lens are the same for all."""

    count: int = 4
    image_size: tuple[int, int] = (1280, 720)
    rate_hz: float = 60.0
    exposure_s: float = 0.0
    readout_s: float = 0.0
    pupil_mm: float = 0.0
    psf_px: float = 0.45
    vignetting: float = 0.0
    ghost: float = 0.0
    distortion: bool = True
    noise: bool = True
    gain: float = 1.0
    full_well_e: float = 11333.0
    read_noise_e: float = 26.7
    gamma: float = 1.0


@dataclass(frozen=True)
class ClockSettings:
    """How the cameras' clocks differ: uniform up to these; and what the files lose of it."""

    max_offset_s: float = 0.0
    max_drift_ppm: float = 0.0
    dropped: float = 0.0
    jitter_frames: float = 0.0
    stamps_tell: bool = True


@dataclass(frozen=True)
class VideoSettings:
    """How videos are written: "h264" or "lossless"; `rotation_deg` as phones write it."""

    codec: str = "h264"
    crf: int = 13
    max_bit_rate: int = 1_450_000
    rotation_deg: int = 0


@dataclass(frozen=True)
class SceneSettings:
    """What is around: background "dark", "studio" or "clutter"; occluder "none", "hand", "hair"."""

    background: str = "dark"
    light: str = "studio"
    occluder: str = "none"


@dataclass(frozen=True)
class EventSettings:
    """What happens: hand claps (a number), a flash, one camera knocked (mm and degrees)."""

    claps: int = 0
    flash: bool = False
    knocked: bool = False
    knock_mm: float = 2.0
    knock_deg: float = 0.5


@dataclass(frozen=True)
class TakeSettings:
    """All that a take simulates, but for what its seed draws."""

    kind: str = "markers"
    seconds: float = 4.0
    performance: PerformanceSettings = field(default_factory=PerformanceSettings)
    actor: ActorSettings = field(default_factory=ActorSettings)
    markers: MarkerSettings = field(default_factory=MarkerSettings)
    cameras: CameraSettings = field(default_factory=CameraSettings)
    clocks: ClockSettings = field(default_factory=ClockSettings)
    video: VideoSettings = field(default_factory=VideoSettings)
    scene: SceneSettings = field(default_factory=SceneSettings)
    events: EventSettings = field(default_factory=EventSettings)

    def __post_init__(self) -> None:
        for path, allowed in _CHOICES.items():
            value = _value_at(self, path)
            if value not in allowed:
                known = ", ".join(str(a) for a in allowed)
                raise InputError(f"{path}: expected one of {known}, got {value}")
        for path, (low, high) in _RANGES.items():
            value = _value_at(self, path)
            if not low <= value <= high:
                raise InputError(f"{path}: expected {low:g} to {high:g}, got {value:g}")
        width, height = self.cameras.image_size
        if width % 2 or height % 2 or not (64 <= width <= 4096 and 64 <= height <= 4096):
            raise InputError(
                f"cameras.image_size: expected even numbers from 64 to 4096, got {width}x{height}"
            )
        if self.actor.oldest_years < self.actor.youngest_years:
            raise InputError("actor: oldest_years lies below youngest_years")
        if self.performance.voice and self.performance.style not in _SPOKEN:
            raise InputError(
                f"performance: a voice goes with the styles {' and '.join(_SPOKEN)}, not with "
                f"{self.performance.style}"
            )
        if self.performance.voice and self.seconds < SHORTEST_VOICE_S:
            raise InputError(f"seconds: a voice needs at least {SHORTEST_VOICE_S:g} s")
        if self.kind == "wand" and (self.performance.voice or self.scene.occluder != "none"):
            raise InputError("a wand take has nobody who speaks, or whose face is hidden")
        if self.kind == "plain" and self.scene.background == "dark":
            raise InputError("scene.background: a plain take has studio or clutter behind it")


_SPOKEN = ("mixed", "speech")
_CHOICES: dict[str, tuple[Any, ...]] = {
    "kind": KINDS,
    "performance.style": ("mixed", "expressions", "speech", "range"),
    "markers.look": _LOOKS,
    "video.codec": ("h264", "lossless"),
    "video.rotation_deg": (0, 90, 180, 270),
    "scene.background": ("dark", "studio", "clutter"),
    "scene.light": ("studio", "window", "overcast", "warm room", "hard sun", "any"),
    "scene.occluder": ("none", "hand", "hair"),
}
_RANGES: dict[str, tuple[float, float]] = {
    "seconds": (0.5, 7200.0),
    "actor.youngest_years": (6, 85),
    "actor.oldest_years": (6, 85),
    "actor.strangeness": (0.0, 2.0),
    "markers.radius_mm": (0.5, 5.0),
    "cameras.count": (1, MAX_CAMERAS),
    "cameras.rate_hz": (5.0, 240.0),
    "cameras.exposure_s": (0.0, 0.1),
    "cameras.readout_s": (0.0, 0.1),
    "cameras.pupil_mm": (0.0, 50.0),
    "cameras.psf_px": (0.0, 10.0),
    "cameras.vignetting": (0.0, 0.95),
    "cameras.ghost": (0.0, 0.5),
    "cameras.gain": (0.01, 100.0),
    "cameras.full_well_e": (100.0, 1e9),
    "cameras.read_noise_e": (0.0, 1e4),
    "cameras.gamma": (0.2, 5.0),
    "clocks.max_offset_s": (0.0, 10.0),
    "clocks.max_drift_ppm": (0.0, 1000.0),
    "clocks.dropped": (0.0, 0.5),
    "clocks.jitter_frames": (0.0, 0.45),
    "video.crf": (0, 51),
    "video.max_bit_rate": (100_000, 1_000_000_000),
    "events.claps": (0, 20),
    "events.knock_mm": (0.0, 100.0),
    "events.knock_deg": (0.0, 20.0),
}

#: Difficulties by name, each as what it changes.
TROUBLES: dict[str, dict[str, Any]] = {
    "blur": {"cameras.exposure_s": 0.010},
    "rolling": {"cameras.readout_s": 0.012},
    "focus": {"cameras.pupil_mm": 14.0},
    "vignetting": {"cameras.vignetting": 0.4},
    "ghosts": {"cameras.ghost": 0.03},
    "noise": {"cameras.full_well_e": 2500.0, "cameras.read_noise_e": 25.0},
    "drops": {"clocks.dropped": 0.05},
    "clocks": {"clocks.max_offset_s": 0.25, "clocks.max_drift_ppm": 80.0},
    "vfr": {"clocks.jitter_frames": 0.3},
    "claps": {"events.claps": 3},
    "flash": {"events.flash": True},
    "knock": {"events.knocked": True},
    "rotated": {"video.rotation_deg": 90},
    "clutter": {"scene.background": "clutter"},
    "hand": {"scene.occluder": "hand"},
    "hair": {"scene.occluder": "hair"},
}


def settings_for(kind: str, look: str = "dots") -> TakeSettings:
    """What suits a kind of take, before anything else is asked.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    look : str
        Of markers: "dots" or "spheres".
    """
    if kind == "plain":
        return TakeSettings(
            kind="plain",
            cameras=CameraSettings(count=1, rate_hz=30.0, exposure_s=0.008, gamma=2.2),
            video=VideoSettings(crf=18, max_bit_rate=8_000_000),
            scene=SceneSettings(background="clutter", light="any"),
        )
    if kind == "markers" and look == "spheres":
        markers = MarkerSettings(look="spheres", radius_mm=1.5)
        return TakeSettings(markers=markers, cameras=CameraSettings(exposure_s=0.001))
    return settings_with(TakeSettings(), {"kind": kind, "markers.look": look})


def settings_with(settings: TakeSettings, changes: Mapping[str, Any]) -> TakeSettings:
    """Settings with some keys (``"cameras.count"``) changed; InputError for an unknown key."""
    found = settings
    for path, value in changes.items():
        table, _, key = path.rpartition(".")
        owner = getattr(found, table, None) if table else found
        if not dataclasses.is_dataclass(owner) or key not in _keys(owner):
            raise InputError(f"no setting {path}")
        changed = dataclasses.replace(owner, **{key: value})  # type: ignore[type-var]
        found = dataclasses.replace(found, **{table: changed}) if table else changed  # type: ignore
    return found


def write_take_settings(path: Path, settings: TakeSettings, seed: int) -> None:
    """Write ``take.toml``; `read_take_settings` gives it back."""
    lines = [f"version = {VERSION}", f"seed = {seed}"]
    tables = []
    for key in _keys(settings):
        value = getattr(settings, key)
        if dataclasses.is_dataclass(value):
            tables.append((key, value))
        else:
            lines.append(f"{key} = {_toml(value)}")
    for name, table in tables:
        lines += ["", f"[{name}]"]
        lines += [f"{key} = {_toml(getattr(table, key))}" for key in _keys(table)]
    with atomic_write(path) as stream:
        stream.write("\n".join(lines) + "\n")


def read_take_settings(path: Path) -> tuple[TakeSettings, int | None]:
    """Read ``take.toml`` (or a part of one): the settings, and the seed if it says one.

    Raises
    ------
    FileFormatError
        If it is no TOML, or a key or a kind of value is not known; it is named.
    InputError
        If a value is out of its range; the message names the file.
    OSError
        If the file cannot be read.
    """
    text = read_text(path, 1024 * 1024).removeprefix("\ufeff")
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise FileFormatError(path, "file", "valid TOML", str(error)) from error
    version = document.pop("version", VERSION)
    if version != VERSION:
        raise FileFormatError(path, "version", str(VERSION), repr(version))
    seed = document.pop("seed", None)
    if seed is not None and (not isinstance(seed, int) or isinstance(seed, bool) or seed < 0):
        raise FileFormatError(path, "seed", "a whole number from 0", repr(seed))
    try:
        return _built(path, _base(path, document), document, ""), seed
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _base(path: Path, document: Mapping[str, Any]) -> TakeSettings:
    """What the file's kind of take starts from."""
    markers = document.get("markers")
    look = markers.get("look", "dots") if isinstance(markers, dict) else "dots"
    kind = document.get("kind", "markers")
    for place, value, known in (("kind", kind, KINDS), ("markers.look", look, _LOOKS)):
        if value not in known:
            raise FileFormatError(path, place, f"one of {', '.join(known)}", repr(value)[:40])
    return settings_for(kind, look)


def _built(path: Path, default: Any, document: Mapping[str, Any], prefix: str) -> Any:
    known = _keys(default)
    changed: dict[str, Any] = {}
    for key, value in document.items():
        place = prefix + key
        if key not in known:
            raise FileFormatError(path, place, f"one of {', '.join(known)}", "an unknown key")
        old = getattr(default, key)
        if dataclasses.is_dataclass(old):
            if not isinstance(value, dict):
                raise FileFormatError(path, place, f"a table [{place}]", repr(value)[:40])
            changed[key] = _built(path, old, value, f"{place}.")
        else:
            changed[key] = _converted(path, place, old, value)
    return dataclasses.replace(default, **changed)


def _converted(path: Path, place: str, old: Any, value: Any) -> Any:
    """`value` as the kind of value that `old` is."""
    expected = {bool: "true or false", int: "a whole number", str: "a text", tuple: "[w, h]"}
    is_whole = isinstance(value, int) and not isinstance(value, bool)
    if isinstance(old, float):
        if (is_whole or isinstance(value, float)) and math.isfinite(value):
            return float(value)
        raise FileFormatError(path, place, "a number", repr(value)[:40])
    if isinstance(old, tuple):
        if isinstance(value, list) and len(value) == 2 and all(type(v) is int for v in value):
            return tuple(value)
    elif type(value) is type(old):
        return value
    raise FileFormatError(path, place, expected[type(old)], repr(value)[:40])


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value)
    return str(list(value)) if isinstance(value, tuple) else repr(value)


def _keys(value: Any) -> tuple[str, ...]:
    return tuple(f.name for f in dataclasses.fields(value))


def _value_at(settings: Any, path: str) -> Any:
    for key in path.split("."):
        settings = getattr(settings, key)
    return settings
