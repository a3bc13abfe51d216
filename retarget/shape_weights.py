"""Weights of a head's shapes from FAPs, by bounded least squares over the whole clip; and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.clip import Clip
from ..core.errors import InputError
from ..core.formats.live_link_csv import ARKIT_SHAPES
from ..core.mpeg4 import ANGLE_UNIT_RAD
from ..heads.bounded_paths import second_differences, solve_paths
from .fap_rules import completed
from .high_level_faps import HIGH_LEVEL
from .shape_jacobian import WEIGHT_SD, ShapeJacobian, carried_by_jaw
from .shape_names import understand_shapes

Floats = NDArray[np.float64]

#: How far shapes miss feature points that they mean: FAPs of another head, another sculptor, noise.
#: Of what was tried (0.03 to 1 mm), this reproduces the skin of faces best that move otherwise.
NOISE_MM = 0.3
#: How fast weights are expected to change; they follow faster changes as far as FAPs insist.
CUTOFF_HZ = 6.0
#: A weight is drawn to 0 as if its mean were this, and to its mirror image half as much.
_MEAN_WEIGHT = 0.3
_TIE = 0.5
#: FAPs that a clip does not give itself, but another side or contour implies.
_IMPLIED = 0.2
#: What lids do is seen first.
_LIDS = frozenset((19, 20, 21, 22))
_LID_CARE = 2.0
#: The jaw carries the tongue: its FAPs tell the jaw's motion once more.
_TONGUE = frozenset((43, 44, 45, 46))
_TONGUE_CARE = 0.3
_UPPER_LIDS = frozenset(("close_t_l_eyelid", "close_t_r_eyelid"))
_BOUND_ROUNDS = 3
_CORRECTIVE_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class ShapeWeights:
    """Weights of a head's shapes over time.

    Attributes
    ----------
    jacobian : ShapeJacobian
    clip : Clip
        Channels are the head's names of the shapes in use, correctives included; in [0, 1].
    residual_mm : (T,) float64, mm
        Root mean square of what feature points miss along the FAPs that the clip gives; 0 where
        weights were given instead of FAPs.
    n_rounds : int
        Of the active-set method.
    converged : bool
        False: weights are within their bounds, but not quite at the minimum.
    """

    jacobian: ShapeJacobian
    clip: Clip
    residual_mm: Floats
    n_rounds: int
    converged: bool

    def __post_init__(self) -> None:
        shape = (len(self.clip.time_s),)
        object.__setattr__(self, "residual_mm", readonly(self.residual_mm, shape, "residual_mm"))

    def arkit_clip(self) -> Clip:
        """The same as ARKit weights: sides of one shape averaged, poses spread over shapes.

        Channels are the ARKit shapes that the head's shapes speak of.
        """
        names = self.jacobian.names
        found: dict[str, Floats] = {}
        for name in ARKIT_SHAPES:
            single = [self.clip[s] for s in names.of_arkit(name) if s in self.clip.channels]
            if single:
                found[name] = np.mean(single, axis=0)
        for shape in self.jacobian.shapes:
            if names.meanings[shape].kind == "pose":
                for name, amount in names.meanings[shape].amounts.items():
                    found[name] = found.get(name, 0.0) + amount * self.clip[shape]
        channels = tuple(n for n in ARKIT_SHAPES if n in found)
        values = np.stack([np.clip(found[n], 0.0, 1.0) for n in channels], axis=1)
        return Clip(self.clip.time_s, channels, values)


def solve_weights(
    jacobian: ShapeJacobian,
    clip: Clip,
    *,
    noise_mm: float = NOISE_MM,
    cutoff_hz: float = CUTOFF_HZ,
) -> ShapeWeights:
    """Weights with which a head's feature points go where a clip's FAPs say.

    Minimises, over all frames at once and with weights in [0, 1], the squared misses along the FAPs
    that the clip gives or implies (`complete_faps`), plus a little of each weight (so that shapes
    that nothing asks for stay exactly 0), of its square, of the difference of left and right, and
    of the second difference in time. Lids close no further than the head's blink does, and shapes
    that turn an eye are used for nothing else. Frames whose FAPs are all 0 get weights of exactly
    0. ``mouthClose`` is a corrective of ``jawOpen`` and never exceeds it.

    Parameters
    ----------
    jacobian : ShapeJacobian
    clip : Clip
        Of FAPs.
    noise_mm : float, mm
        How far to trust the FAPs: about how far shapes of this head can be expected to miss them.
    cutoff_hz : float, Hz
        Weights are expected to change up to this frequency, less and less beyond it (by the fourth
        power). ``numpy.inf``: no smoothing.

    Raises
    ------
    InputError
        If the clip holds no FAP, or none that the shapes know.
    ValueError
        If `noise_mm` or `cutoff_hz` is not above 0.
    """
    if not noise_mm > 0 or not cutoff_hz > 0:
        raise ValueError(f"noise_mm and cutoff_hz must be above 0, got {noise_mm}, {cutoff_hz}")
    target, care, at_rest = _targets(jacobian, clip)
    problem = _Problem(jacobian, target, care, noise_mm)
    upper = np.where(at_rest[:, None], 0.0, _gaze_bounds(jacobian, target * (care > 0)))
    D = second_differences(clip.time_s)
    smooth = (noise_mm / WEIGHT_SD) ** 2 * _stiffness(clip.time_s, cutoff_hz)
    products = np.zeros((len(target), len(jacobian.correctives)))
    n_rounds = 0
    for _ in range(_CORRECTIVE_ROUNDS if jacobian.correctives else 1):
        weights, converged, rounds = problem.solve(products, upper, D, smooth)
        products, n_rounds = jacobian.products(weights), max(n_rounds, rounds)
    missed = weights @ jacobian.mm.T + products @ jacobian.corrective_mm.T - target
    counted = care > 0
    residual = np.sqrt((missed[:, counted] ** 2).mean(axis=1))
    channels = (*jacobian.shapes, *jacobian.correctives)
    whole = Clip(clip.time_s, channels, np.concatenate([weights, products], axis=1))
    return ShapeWeights(jacobian, whole, residual, n_rounds, converged)


def _stiffness(time_s: Floats, cutoff_hz: float) -> float:
    """Of second differences, against that of the weights themselves: equal at the cutoff."""
    if len(time_s) < 3 or not np.isfinite(cutoff_hz):
        return 0.0
    step = float(np.median(np.diff(time_s)))
    return float((2 * np.sin(min(np.pi * cutoff_hz * step, np.pi / 2))) ** -4)


def _targets(jacobian: ShapeJacobian, clip: Clip) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Where FAPs want points, (T, F) mm; how much each counts, (F,); frames that are at rest."""
    known = completed(clip)
    faps = known.clip
    target = np.zeros((len(clip.time_s), len(jacobian.faps)))
    care, closed = np.zeros(len(jacobian.faps)), _closed_mm(jacobian)
    for i, fap in enumerate(jacobian.faps):
        if fap.name not in faps.channels or (carried_by_jaw(fap) and not faps[fap.name].any()):
            continue
        values, source = faps[fap.name], known.derived.get(fap.name, HIGH_LEVEL)
        given = source == HIGH_LEVEL  # or by the clip itself: not only by a partner
        target[:, i] = np.minimum(values * jacobian.unit_mm[i], closed[i])
        care[i] = 1.0 if given else _IMPLIED
        care[i] *= _LID_CARE if fap.number in _LIDS else 1.0
        care[i] *= _TONGUE_CARE if fap.number in _TONGUE else 1.0
    if not care.any():
        raise InputError(
            f"none of the clip's FAPs moves a shape of head {jacobian.head.name}; it gives "
            + ", ".join(faps.channels[:5])
        )
    return target, care, np.asarray(~target.any(axis=1))


def _gaze_bounds(jacobian: ShapeJacobian, target: Floats) -> Floats:
    """Upper bounds, (T, K): shapes that turn an eye serve where the eye turns their way alone.

    Else a look up and a look down would be used, both at once, for what they do to the lids.
    """
    turns = [i for i, fap in enumerate(jacobian.faps) if fap.is_rotation]
    their_way = (target[:, turns, None] * jacobian.mm[None, turns] > 0).any(axis=1)
    looks = (np.abs(jacobian.mm[turns]) > 0).any(axis=0)
    return np.where(their_way | ~looks, 1.0, 0.0)


def _closed_mm(jacobian: ShapeJacobian) -> Floats:
    """How far each FAP of an upper lid can go on this head, (F,) mm: until the lids meet."""
    found = np.full(len(jacobian.faps), np.inf)
    blinks = [i for i, s in enumerate(jacobian.shapes) if jacobian.closes_eye(s)]
    for i, fap in enumerate(jacobian.faps):
        most = jacobian.mm[i, blinks].max(initial=0.0)
        if fap.name in _UPPER_LIDS and most > 0:
            found[i] = most
    return found


class _Problem:
    """The least squares of one clip, ready for the solver."""

    def __init__(
        self, jacobian: ShapeJacobian, target: Floats, care: Floats, noise_mm: float
    ) -> None:
        self._jacobian, self._target = jacobian, target
        self._care = care**2
        index = {jacobian.arkit(s): i for i, s in enumerate(jacobian.shapes)}
        self._close = index.get("mouthClose") if "jawOpen" in index else None
        self._open = index.get("jawOpen")
        self._columns = jacobian.mm.copy()
        if self._close is not None:  # its column becomes: jaw open, lips closed
            self._columns[:, self._close] += self._columns[:, self._open]
        ridge = (noise_mm / WEIGHT_SD) ** 2
        n = len(jacobian.shapes)
        prior = ridge * np.eye(n)
        for i, j in jacobian.pairs():
            prior[[i, j], [i, j]] += _TIE * ridge
            prior[[i, j], [j, i]] -= _TIE * ridge
        self._gram = self._columns.T @ (self._care[:, None] * self._columns) + prior
        self._sparsity = noise_mm**2 / _MEAN_WEIGHT

    def solve(
        self, products: Floats, upper: Floats, D: Floats, smooth: float
    ) -> tuple[Floats, bool, int]:
        """Weights (T, K) beside given ones of the correctives."""
        wanted = self._target - products @ self._jacobian.corrective_mm.T
        pull = wanted @ (self._care[:, None] * self._columns) - self._sparsity
        bound = upper.copy()
        for _ in range(_BOUND_ROUNDS):
            found = solve_paths(self._gram, pull, bound, D, smooth)
            if self._close is None:
                break
            over = found.values[:, self._open] + found.values[:, self._close] - 1.0
            if over.max(initial=0.0) <= 0:
                break
            # the jaw, open with and without closed lips, opens once
            rows = over > 0
            bound[rows, self._open] = np.maximum(1.0 - found.values[rows, self._close], 0.0)
            bound[rows, self._close] = np.minimum(
                bound[rows, self._close], found.values[rows, self._close]
            )
        weights = found.values.copy()
        if self._close is not None:
            weights[:, self._open] += weights[:, self._close]
        return np.clip(weights, 0.0, upper), found.converged, found.n_rounds


def weights_to_faps(jacobian: ShapeJacobian, clip: Clip) -> Clip:
    """FAPs of a head under weights of its shapes, or under ARKit weights.

    Parameters
    ----------
    jacobian : ShapeJacobian
    clip : Clip
        Channels: shapes of the head by its own names, or ARKit's. What is not set counts 0.
        Rotations of the head (``headYaw`` ...) become FAPs 48 to 50.

    Returns
    -------
    Clip
        Every FAP that the shapes move, table units.

    Raises
    ------
    InputError
        If none of the channels is a shape of the head.
    """
    weights = given_weights(jacobian, clip)
    k = len(jacobian.shapes)
    mm = weights[:, :k] @ jacobian.mm.T + weights[:, k:] @ jacobian.corrective_mm.T
    names = tuple(fap.name for fap in jacobian.faps)
    values = mm / jacobian.unit_mm
    turns = head_turns(clip)
    if turns is not None:
        names = (*names, "head_pitch", "head_yaw", "head_roll")
        values = np.concatenate([values, turns / ANGLE_UNIT_RAD], axis=1)
    return Clip(clip.time_s, names, values)


def head_turns(clip: Clip) -> Floats | None:
    """Pitch, yaw and roll of the head, (T, 3) rad, of an ARKit clip; None if it has none."""
    names = ("headPitch", "headYaw", "headRoll")
    if not set(names) & set(clip.channels):
        return None
    none = np.zeros(len(clip.time_s))
    return np.nan_to_num(np.stack([clip[n] if n in clip.channels else none for n in names], axis=1))


def given_weights(jacobian: ShapeJacobian, clip: Clip) -> Floats:
    """(T, K + C) weights of the shapes and correctives that a clip gives by name, in [0, 1]."""
    asked = {n: np.nan_to_num(clip[n]) for n in clip.channels}
    meant = understand_shapes([n for n in clip.channels if n in ARKIT_SHAPES])
    found = np.zeros((len(clip.time_s), len(jacobian.shapes)))
    known = False
    for i, shape in enumerate(jacobian.shapes):
        name = jacobian.arkit(shape)
        if shape in asked or (name is not None and name in meant.meanings):
            known = True
            found[:, i] = asked[shape if shape in asked else str(name)]
    if not known:
        raise InputError(
            f"head {jacobian.head.name} has none of the clip's shapes: "
            + ", ".join(clip.channels[:5])
        )
    found = np.clip(found, 0.0, 1.0)
    return np.concatenate([found, jacobian.products(found)], axis=1)
