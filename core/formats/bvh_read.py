"""Reading Biovision hierarchies (``.bvh``); `bvh` writes them."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..errors import FileFormatError
from ..files import read_text
from .bvh import MM_PER_UNIT, BvhJoint, BvhMotion

Floats = NDArray[np.float64]

_MAX_BYTES = 256 * 1024 * 1024
_MAX_JOINTS = 1000
_END = -2
_CHANNELS = {f"{axis}{kind}" for axis in "xyz" for kind in ("position", "rotation")}


def read_bvh(path: Path) -> BvhMotion:
    """Read joints and their motion; channels in any order, lengths in centimetres.

    Raises
    ------
    FileFormatError
        ``walk.bvh, line 31: expected 12 values, found 9``.
    OSError
        If it cannot be read.
    """
    return _Reader(path).motion()


class _Reader:
    """One file: word by word up to the motion, then line by line."""

    def __init__(self, path: Path) -> None:
        self._path = path
        lines = read_text(path, _MAX_BYTES).removeprefix("\ufeff").splitlines()
        numbered = [(n, words) for n, line in enumerate(lines, 1) if (words := line.split())]
        if not numbered or numbered[0][1][0].upper() != "HIERARCHY":
            raise FileFormatError(path, "line 1", "HIERARCHY", "other contents")
        starts = [i for i, (_, words) in enumerate(numbered) if words[0].upper() == "MOTION"]
        if not starts:
            raise FileFormatError(path, "the end", "MOTION", "none (cut off)")
        self._words = [(n, w) for n, words in numbered[: starts[0]] for w in words][1:]
        self._rows = numbered[starts[0] + 1 :]
        self._at = 0
        self._names: list[str] = []
        self._parents: list[int] = []
        self._offsets: list[Floats] = []
        self._channels: list[list[str]] = []

    def motion(self) -> BvhMotion:
        self._read_hierarchy()
        values, rate = self._read_values()
        joints, column = [], 0
        for i, channels in enumerate(self._channels):
            mine = values[:, column : column + len(channels)]
            column += len(channels)
            joints.append(self._joint(i, mine))
        try:
            return BvhMotion(tuple(joints), rate)
        except ValueError as error:
            expected = "joints that fit together"
            raise FileFormatError(self._path, "hierarchy", expected, str(error)) from error

    def _read_hierarchy(self) -> None:
        stack: list[int] = []
        while self._at < len(self._words):
            word = self._take("a joint").upper()
            inside = stack[-1] if stack else None
            if word == "ROOT" and not self._names:
                stack.append(self._open(-1))
            elif word == "JOINT" and inside is not None and inside != _END:
                stack.append(self._open(inside))
            elif word == "END" and inside is not None and inside != _END:
                self._take("Site")
                self._brace()
                stack.append(_END)
            elif word == "}" and stack:
                stack.pop()
            elif word == "OFFSET" and inside is not None:
                offset = np.array([self._number() for _ in range(3)]) * MM_PER_UNIT
                if inside != _END:
                    self._offsets[inside] = offset
            elif word == "CHANNELS" and inside is not None and inside != _END:
                self._channels[inside] = self._read_channels()
            else:
                self._fail("a joint, its OFFSET or CHANNELS, or }")
        if stack or not self._names:
            raise FileFormatError(self._path, "hierarchy", "a whole one", "its end (cut off)")

    def _open(self, parent: int) -> int:
        if len(self._names) >= _MAX_JOINTS:
            self._fail(f"at most {_MAX_JOINTS} joints")
        self._names.append(self._take("a name"))
        self._parents.append(parent)
        self._offsets.append(np.zeros(3))
        self._channels.append([])
        self._brace()
        return len(self._names) - 1

    def _brace(self) -> None:
        if self._take("{") != "{":
            self._fail("{")

    def _read_channels(self) -> list[str]:
        count = self._take("a number of channels")
        if count not in ("0", "1", "2", "3", "4", "5", "6"):
            self._fail("0 to 6 channels")
        found = [self._take("a channel").lower() for _ in range(int(count))]
        if not set(found) <= _CHANNELS or len(set(found)) != len(found):
            self._fail("channels such as Xposition and Yrotation, each once")
        return found

    def _take(self, expected: str) -> str:
        if self._at >= len(self._words):
            raise FileFormatError(self._path, "hierarchy", expected, "its end (cut off)")
        self._at += 1
        return self._words[self._at - 1][1]

    def _number(self) -> float:
        word = self._take("a number")
        if not _is_number(word):
            self._fail("a number")
        return float(word)

    def _fail(self, expected: str) -> NoReturn:
        number, word = self._words[max(self._at - 1, 0)]
        raise FileFormatError(self._path, f"line {number}", expected, f'"{word[:40]}"')

    def _read_values(self) -> tuple[Floats, Fraction]:
        heads = [" ".join(words).lower() for _, words in self._rows[:2]]
        n_frames = heads[0].removeprefix("frames:").strip() if heads else ""
        step = heads[1].removeprefix("frame time:").strip() if len(heads) > 1 else ""
        if not (n_frames.isascii() and n_frames.isdigit() and int(n_frames) > 0):
            raise FileFormatError(self._path, "after MOTION", "Frames: a number", f'"{n_frames}"')
        if not _is_number(step) or not 1e-4 <= float(step) <= 1e4:
            raise FileFormatError(self._path, "after Frames", "Frame Time: seconds", f'"{step}"')
        rows, width = self._rows[2:], sum(len(channels) for channels in self._channels)
        if len(rows) != int(n_frames):
            raise FileFormatError(self._path, "MOTION", f"{n_frames} frames", str(len(rows)))
        for number, words in rows:
            if len(words) != width:
                found = str(len(words))
                raise FileFormatError(self._path, f"line {number}", f"{width} values", found)
            bad = next((w for w in words if not _is_number(w)), None)
            if bad is not None:
                raise FileFormatError(self._path, f"line {number}", "numbers", f'"{bad[:40]}"')
        values = np.array([[float(w) for w in words] for _, words in rows]).reshape(-1, width)
        return values, _rate(float(step))

    def _joint(self, index: int, values: Floats) -> BvhJoint:
        channels, offset = self._channels[index], self._offsets[index]
        turns = [c for c in channels if c.endswith("rotation")]
        rotation = Rotation.identity(len(values))
        if turns:
            angles = values[:, [channels.index(c) for c in turns]]
            for turn, angle in zip(turns, angles.T, strict=True):  # as written, left to right
                rotation = rotation * Rotation.from_euler(turn[0], angle[:, None], degrees=True)
        place = np.tile(offset, (len(values), 1))
        for axis, letter in enumerate("xyz"):
            if f"{letter}position" in channels:
                place[:, axis] = values[:, channels.index(f"{letter}position")] * MM_PER_UNIT
        quaternion = rotation.as_quat(scalar_first=True)
        name, parent = self._names[index], self._parents[index]
        return BvhJoint(name, parent, offset, quaternion, place - offset)


def _is_number(word: str) -> bool:
    try:
        return "_" not in word and math.isfinite(float(word))
    except ValueError:
        return False


def _rate(step_s: float) -> Fraction:
    """Frames a second of a rounded time between frames: a whole number, or that by 1000/1001."""
    for base in (Fraction(1), Fraction(1000, 1001)):
        rate = round(1 / step_s / float(base)) * base
        if rate and abs(float(1 / rate) - step_s) <= 1e-6 * step_s + 5e-8:
            return rate
    return Fraction(1 / step_s).limit_denominator(100_000)
