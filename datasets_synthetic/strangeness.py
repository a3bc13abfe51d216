"""People whom no model of ours describes: faces and expressions beyond the identities.

For judging what fits heads: an actor's face gets forms that no target makes, and moves otherwise
than the sculpted shapes do. The jaw's own motion, the lids' and the eyes' stay, for they are joints
and not shapes (`face_motion`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..heads.head import Head
from .jaw_motion import JAW_SHAPES

Floats = NDArray[np.float64]
#: At strangeness 1: RMS of the forms over the front of the face; gains of the shapes; how the
#: shapes change from place to place (standard deviation of a factor).
FORM_MM, GAIN, LOCAL_GAIN = 1.2, (0.15, 0.35), 0.15
_WAVES, _WAVE_MM = 24, (60.0, 160.0)  # lengths: smaller forms are wrinkles
_FACE_MM, _EYE_MM = ((0.0, -35.0, 25.0), 75.0), 24.0
_KEPT = (*JAW_SHAPES, "eyeBlink", "eyeWide", "eyeLook", "tongueOut")


def strange_head(head: Head, rng: np.random.Generator, strangeness: float) -> Head:
    """The same person made strange.

    Parameters
    ----------
    head : Head
        Built-in, with its shapes.
    rng : numpy Generator
    strangeness : float
        0: as before; 1: forms of 1.2 mm RMS that no identity has, and shapes 15 to 35 % weaker or
        stronger, by parts of the face besides.
    """
    if not strangeness:
        return head
    if head.shapes is None:
        raise ValueError(f"head {head.name} has no shapes to be altered")
    rest = np.array(head.mesh.vertices)
    (centre, reach) = _FACE_MM
    front = np.exp(-(((rest - centre) ** 2).sum(axis=1)) / reach**2)
    field = np.stack([_waves(rng, rest) for _ in range(3)], axis=1)
    near_eyes = sum(
        np.exp(-(((rest - eye.centre) ** 2).sum(axis=1)) / _EYE_MM**2) for eye in head.eyes.values()
    )
    share = (front * np.clip(1 - near_eyes, 0, 1))[:, None]
    moved = share * field
    skin = head.part_vertices("skin")
    moved *= strangeness * FORM_MM / np.sqrt((moved[skin] ** 2).sum(axis=1).mean())
    shapes = np.array(head.shapes)
    for i, name in enumerate(head.shape_names):
        gain = 1 + strangeness * float(rng.choice((-1, 1)) * rng.uniform(*GAIN))
        local = 1 + strangeness * LOCAL_GAIN * _waves(rng, rest)
        if not name.startswith(_KEPT):
            shapes[i] *= np.clip(gain * local, 0, None)[:, None].astype(np.float32)
    mesh = replace(head.mesh, vertices=rest + moved)
    return replace(head, mesh=mesh, shapes=shapes)


def _waves(rng: np.random.Generator, p: Floats) -> Floats:
    """A smooth random field over places, (V,), of variance 1."""
    way = rng.standard_normal((_WAVES, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    number = 2 * np.pi / rng.uniform(*_WAVE_MM, _WAVES)
    phase = rng.uniform(0, 2 * np.pi, _WAVES)
    return np.asarray(
        np.sqrt(2 / _WAVES) * np.cos(p @ (way * number[:, None]).T + phase).sum(axis=1)
    )
