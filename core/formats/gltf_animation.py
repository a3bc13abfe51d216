"""The first animation of a .glb file, at one set of times for all its channels."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .glb_document import GlbDocument, Object

_log = logging.getLogger(__name__)
_MM_PER_METRE = 1000.0
_PATHS = ("rotation", "translation", "weights")


@dataclass(frozen=True, eq=False)
class Curve:
    """One channel as it is stored.

    Attributes
    ----------
    key_s : (K,) float64, s
    values : (K, n) float64, or (K, 3, n) for cubic splines: in-tangent, value, out-tangent
    interpolation : str
        ``LINEAR``, ``STEP`` or ``CUBICSPLINE``.
    is_rotation : bool
        Values are quaternions.
    """

    key_s: NDArray[np.float64]
    values: NDArray[np.float64]
    interpolation: str
    is_rotation: bool

    @property
    def keys(self) -> NDArray[np.float64]:
        """(K, n): the values at the keys."""
        return self.values[:, 1] if self.values.ndim == 3 else self.values

    def at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """(T, n) values; held before the first and after the last key (glTF 2.0, appendix C)."""
        if np.array_equal(time_s, self.key_s):
            return self.keys
        if len(self.key_s) == 1:
            return np.tile(self.keys, (len(time_s), 1))
        k = np.clip(np.searchsorted(self.key_s, time_s, side="right") - 1, 0, len(self.key_s) - 2)
        step_s = (self.key_s[k + 1] - self.key_s[k])[:, None]
        s = np.clip((time_s - self.key_s[k])[:, None] / step_s, 0, 1)
        a, b = self.keys[k], self.keys[k + 1]
        if self.interpolation == "STEP":
            return np.where(s < 1, a, b)
        if self.interpolation == "CUBICSPLINE":
            out_slope, in_slope = self.values[k, 2] * step_s, self.values[k + 1, 0] * step_s
            return np.asarray(
                (2 * s**3 - 3 * s**2 + 1) * a
                + (s**3 - 2 * s**2 + s) * out_slope
                + (3 * s**2 - 2 * s**3) * b
                + (s**3 - s**2) * in_slope
            )
        return _slerp(a, b, s) if self.is_rotation else a + s * (b - a)


@dataclass(frozen=True, eq=False)
class Animation:
    """What moves, at common times.

    Attributes
    ----------
    time_s : (T,) float64, s
        All key times of all channels; starts at 0. Empty where nothing moves.
    curves : mapping from (node, path) to Curve
    """

    time_s: NDArray[np.float64]
    curves: Mapping[tuple[int, str], Curve]

    @classmethod
    def read(cls, file: GlbDocument, nodes: Set[int]) -> Animation:
        """The first animation's channels that move any of `nodes`."""
        animations = file.array(file.root, "animations", "document")
        if not animations:
            return cls(np.zeros(0), {})
        if len(animations) > 1:
            _log.warning("%s: the first of %d animations is read", file.name, len(animations))
        animation = file.item("animations", 0, "document")
        curves: dict[tuple[int, str], Curve] = {}
        for channel in file.array(animation, "channels", "animation 0"):
            if not isinstance(channel, dict):
                file.fail("animation 0", "channels that are objects", channel)
            target = file.member(channel, "target", "animation 0")
            node, path = target.get("node"), target.get("path")
            if not isinstance(node, int) or node not in nodes or path not in _PATHS:
                _log.warning("%s: animated %s of node %s is left out", file.name, path, node)
                continue
            curves[node, path] = _curve(file, animation, channel, str(path))
        if not curves:
            return cls(np.zeros(0), {})
        time_s = np.unique(np.concatenate([curve.key_s for curve in curves.values()]))
        if time_s[0] < 0:
            file.fail("animation 0", "times from 0 s", f"{time_s[0]} s")
        if time_s[0] > 0:  # the first pose is held from 0 on
            time_s = np.concatenate([[0.0], time_s])
        width = sum(curve.keys.shape[1] for curve in curves.values())
        file.spend(len(time_s) * width, "animation 0")
        return cls(time_s, curves)

    def moves(self, node: int) -> bool:
        """Whether a node is turned or shifted."""
        return (node, "rotation") in self.curves or (node, "translation") in self.curves

    def rotation(self, node: int) -> NDArray[np.float64] | None:
        """(T, 4) w x y z, or None where it is not animated."""
        curve = self.curves.get((node, "rotation"))
        return None if curve is None else np.roll(curve.at(self.time_s), 1, axis=1)

    def translation(self, node: int) -> NDArray[np.float64] | None:
        """(T, 3) mm, or None where it is not animated."""
        curve = self.curves.get((node, "translation"))
        return None if curve is None else curve.at(self.time_s) * _MM_PER_METRE

    def weights(self, node: int) -> NDArray[np.float64] | None:
        """(T, n) blendshape weights, or None where they are not animated."""
        curve = self.curves.get((node, "weights"))
        return None if curve is None else curve.at(self.time_s)


def _curve(file: GlbDocument, animation: Object, channel: Object, path: str) -> Curve:
    where = f"animation 0, {path}"
    samplers = file.array(animation, "samplers", where)
    index = file.integer(channel, "sampler", where)
    if index >= len(samplers) or not isinstance(samplers[index], dict):
        file.fail(where, f"a sampler below {len(samplers)}", index)
    sampler = samplers[index]
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
        file.fail(where, "LINEAR, STEP or CUBICSPLINE", interpolation)
    key_s = file.accessor(sampler.get("input"), ("SCALAR",), where)
    if not (np.diff(key_s) > 0).all():
        file.fail(where, "increasing times", "others")
    kind = {"rotation": "VEC4", "translation": "VEC3", "weights": "SCALAR"}[path]
    values = file.accessor(sampler.get("output"), (kind,), where)
    each = len(key_s) * (3 if interpolation == "CUBICSPLINE" else 1)
    if len(values) % each or (path != "weights" and len(values) != each):
        file.fail(
            where,
            f"a multiple of {each} values" if path == "weights" else f"{each} values",
            len(values),
        )
    shape = (len(key_s), 3, -1) if interpolation == "CUBICSPLINE" else (len(key_s), -1)
    curve = Curve(key_s, values.reshape(shape), interpolation, path == "rotation")
    if curve.is_rotation and not (np.linalg.norm(curve.keys, axis=1) > 1e-6).all():
        file.fail(where, "quaternions of unit length", "zeros")
    return curve


def _slerp(
    a: NDArray[np.float64], b: NDArray[np.float64], s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Between unit quaternions, (T, 4), on the shorter arc; `s` (T, 1) in 0..1."""
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    b = b / np.linalg.norm(b, axis=1, keepdims=True)
    cosine = (a * b).sum(axis=1, keepdims=True)
    b = np.where(cosine < 0, -b, b)
    angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    near = angle < 1e-6
    sine = np.where(near, 1.0, np.sin(angle))
    return np.where(
        near, a + s * (b - a), (np.sin((1 - s) * angle) * a + np.sin(s * angle) * b) / sine
    )
