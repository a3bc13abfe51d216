"""People: the template under phenotype and local targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.mesh import Mesh
from .appearance import make_appearance
from .appearance_traits import AppearanceTraits
from .head import Eye, Head
from .raycast import RayScene
from .template import Template, load_template, template_feature_points
from .template_from_anny import PART_NAMES

LOCAL_SD = 0.22  # of a local target's weight; asymmetry on top
ASYMMETRY_SD = 0.05
#: Local targets left out of random people: they move the head as a whole or look ill.
_EXCLUDED_LOCAL = (
    "universal", "scale-vert", "trans-forward", "trans-backward", "neck-trans",
    "mouth-angles", "mouth-dimples", "laugh-lines", "eyebrows-angle",  # they look cross or sad
)  # fmt: skip
#: These make sleepy lids at full strength.
_CALM_LOCAL = ("eye-height", "eyefold", "eye-bag")
_JAW_PIVOT_MM = (0.0, -38.0, -72.0)  # in front of the ear canal, on the template
_NECK_PIVOT_MM = (0.0, -60.0, -85.0)  # atlanto-occipital joint, on the template
#: The base mesh's dental arches reach into the corners of the mouth and show through them.
_ARCH_WIDTH, _ARCH_BACK_MM = 0.86, 1.5
_SEAL_FALLOFF_MM = 5.0
_LIP_PRESS_MM = 0.25


@dataclass(frozen=True)
class Identity:
    """Who a head is.

    Attributes
    ----------
    name : str
    age : float
        0 child, 0.5 young adult, 1 old.
    female : float
        0 male to 1 female.
    ancestry : mapping from ``african``, ``asian``, ``caucasian`` to a share
        Normalised to sum 1.
    fullness : float
        −1 thin to 1 full.
    local : mapping from target name to weight
    traits : AppearanceTraits
    """

    name: str
    age: float = 0.5
    female: float = 0.5
    ancestry: Mapping[str, float] = field(default_factory=lambda: {"caucasian": 1.0})
    fullness: float = 0.0
    local: Mapping[str, float] = field(default_factory=dict)
    traits: AppearanceTraits = field(default_factory=AppearanceTraits)


def random_identity(rng: np.random.Generator, name: str = "someone") -> Identity:
    """Draw an adult.

    Local targets come in opposite pairs of which one side is taken; left and right differ a
    little, as they do in people.
    """
    template = load_template()
    ancestry = dict(
        zip(("african", "asian", "caucasian"), rng.dirichlet((0.5, 0.5, 0.5)), strict=True)
    )
    female = float(rng.random() < 0.5)
    age = float(rng.uniform(0.45, 0.85))
    local: dict[str, float] = {}
    for positive, negative in _local_pairs():
        left = positive.startswith("l-")
        if positive.startswith("r-") and f"l-{positive[2:]}" in template.identity_names:
            continue
        weight = float(np.clip(rng.normal(0, LOCAL_SD), -0.6, 0.6))
        if any(word in positive for word in _CALM_LOCAL):
            weight *= 0.5
        sides = [(positive, negative)]
        if left:
            sides.append((f"r-{positive[2:]}", f"r-{negative[2:]}"))
        for plus, minus in sides:
            w = weight + (float(rng.normal(0, ASYMMETRY_SD)) if left else 0.0)
            local[plus if w >= 0 else minus] = abs(w)
    local["mouth-angles-up"] = float(rng.uniform(0.15, 0.5))  # a friendly rest
    traits = AppearanceTraits.random(rng, ancestry=ancestry, age=age, female=female)
    return Identity(name, age, female, ancestry, float(rng.normal(0, 0.3)), local, traits)


@cache
def _local_pairs() -> tuple[tuple[str, str], ...]:
    """Local targets and their opposites."""
    names = set(load_template().identity_names)
    opposites = (
        ("-incr", "-decr"),
        ("-up", "-down"),
        ("-in", "-out"),
        ("-convex", "-concave"),
        ("-forward", "-backward"),
        ("-compress", "-uncompress"),
    )
    pairs = []
    for name in sorted(names):
        if any(word in name for word in _EXCLUDED_LOCAL):
            continue
        for plus, minus in opposites:
            if name.endswith(plus) and name.removesuffix(plus) + minus in names:
                pairs.append((name, name.removesuffix(plus) + minus))
    return tuple(pairs)


def target_weights(identity: Identity) -> dict[str, float]:
    """Weights of MakeHuman's targets for an identity.

    Phenotypes combine by products: age × sex × weight for the universal targets, ancestry × sex ×
    age for the others.
    """
    a = np.clip(identity.age, 0, 1)
    ages = {"child": max(0.0, 1 - 2 * a), "old": max(0.0, 2 * a - 1)}
    ages["young"] = 1 - ages["child"] - ages["old"]
    sexes = {"female": identity.female, "male": 1 - identity.female}
    f = float(np.clip(identity.fullness, -1, 1))
    bodies = {"minweight": max(0.0, -f), "maxweight": max(0.0, f)}
    bodies["averageweight"] = 1 - bodies["minweight"] - bodies["maxweight"]
    total = sum(identity.ancestry.values())
    if not total > 0 or min(identity.ancestry.values()) < 0:
        raise InputError(f"identity {identity.name}: ancestry shares must be ≥ 0 with a sum > 0")
    found: dict[str, float] = {}
    for sex, s in sexes.items():
        for age, w in ages.items():
            for body, b in bodies.items():
                found[f"universal-{sex}-{age}-averagemuscle-{body}"] = s * w * b
            for ancestry, share in identity.ancestry.items():
                found[f"{ancestry}-{sex}-{age}"] = s * w * share / total
    return {**found, **identity.local}


def make_head(identity: Identity) -> Head:
    """Build a head: geometry, closed lips, feature points, ARKit shapes, looks.

    Raises
    ------
    InputError
        If a local target is unknown.
    """
    template = load_template()
    weights = np.zeros(len(template.identity_names))
    for name, weight in target_weights(identity).items():
        if name not in template.identity_names:
            raise InputError(f"identity {identity.name}: unknown target {name}")
        weights[template.identity_names.index(name)] = weight
    moved = (weights @ template.identity).reshape(3, -1).T
    vertices = _sealed_lips(template, template.vertices + moved)
    for part in ("teeth_upper", "teeth_lower"):
        rows = template.vertices_of(part)
        vertices[rows] = vertices[rows] * (_ARCH_WIDTH, 1, 1) - (0, 0, _ARCH_BACK_MM)
    eyes = {side: _eye(template, vertices, f"eye_{side}") for side in ("right", "left")}
    vertices = vertices - (eyes["right"].centre + eyes["left"].centre) / 2
    eyes = {side: _eye(template, vertices, f"eye_{side}") for side in ("right", "left")}
    scale = eyes["left"].centre[0] / 30.78
    return Head(
        name=identity.name,
        mesh=Mesh(
            vertices, template.triangles, template.uv, template.uv_triangles, template.groups()
        ),
        feature_points=template_feature_points(),
        eyes=eyes,
        jaw_pivot=np.array(_JAW_PIVOT_MM) * scale,
        neck_pivot=np.array(_NECK_PIVOT_MM) * scale,
        appearance=make_appearance(template, identity.traits),
        shape_names=template.arkit_names,
        shapes=template.arkit,
    )


def _eye(template: Template, vertices: NDArray[np.float64], part: str) -> Eye:
    p = vertices[template.vertices_of(part)]
    centre = (p.min(axis=0) + p.max(axis=0)) / 2
    return Eye(centre, float(np.median(np.linalg.norm(p - centre, axis=1))))


def _sealed_lips(template: Template, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move the lips so that they just touch at rest.

    Subdivision and phenotypes leave a slit of a millimetre or less. Its height is measured by
    rays along −z in columns over the mouth; both lips move by half of it, fading away from it.
    """
    points = template_feature_points()
    at = dict(zip(points.names, points.at(vertices), strict=True))
    skin = template.triangles[template.part_of_triangle == PART_NAMES.index("skin")]
    scene = RayScene(vertices, skin)
    x0, x1 = at["8.4"][0], at["8.3"][0]
    middle_y = (at["2.2"][1] + at["2.3"][1]) / 2
    xs = np.linspace(x0, x1, 41)[1:-1]
    gaps, seams = [], []
    for x in xs:
        lip_z = np.interp(x, [x0, 0, x1], [at["8.4"][2], at["2.3"][2], at["8.3"][2]])
        gap, seam = _slit(scene, float(x), float(middle_y), float(lip_z) - 6.0)
        gaps.append(gap)
        seams.append(seam)
    lips = np.zeros(len(vertices))
    lips[template.triangles.ravel()] = template.masks["lips"][template.uv_triangles.ravel()]
    found = vertices.copy()
    near = np.flatnonzero(np.abs(vertices[:, 1] - middle_y) < 25)
    p = vertices[near]
    opening = np.interp(p[:, 0], xs, gaps, left=0, right=0)
    opening = opening + _LIP_PRESS_MM * (opening > 0)
    below = p[:, 1] < np.interp(p[:, 0], xs, seams)
    distance = np.abs(p[:, 1] - np.interp(p[:, 0], xs, seams))
    weight = np.exp(-((distance / _SEAL_FALLOFF_MM) ** 2)) * np.clip(lips[near] * 1.5, 0, 1)
    found[near, 1] += np.where(below, 0.5, -0.5) * opening * weight
    return found


def _slit(scene: RayScene, x: float, y: float, z: float) -> tuple[float, float]:
    """Height of the opening between the lips in one column, and its middle."""
    ys = np.arange(y + 6, y - 6, -0.05)
    origins = np.stack([np.full_like(ys, x), ys, np.full_like(ys, 500.0)], axis=1)
    t, *_ = scene.cast(origins, np.tile([0.0, 0.0, -1.0], (len(ys), 1)))
    behind = ys[500.0 - t < z]
    if len(behind):
        return float(behind[0] - behind[-1]) + 0.05, float((behind[0] + behind[-1]) / 2)
    return 0.0, float(ys[np.argmax(t)])
