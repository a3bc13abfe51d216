"""People: the template under phenotype and local targets.

Random people take the proportions that anthropometry has measured (`anthropometry`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.mesh import Mesh
from .anthropometry import SIZE_SD, LocalPair, fit_to_norms, phenotype_landmarks
from .appearance import make_appearance
from .appearance_traits import AppearanceTraits
from .head import Eye, Head
from .landmarks import template_landmarks
from .raycast import RayScene
from .regions import template_regions
from .template import Template, load_template, template_feature_points
from .template_from_anny import PART_NAMES

LOCAL_SD = 0.22  # of a local target's weight; asymmetry on top
ASYMMETRY_SD = 0.05
FULLNESS_SD = 0.3
ADULT_AGE = (0.45, 0.85)  # 23 to 67 years, as `age`
#: All whom `random_identity` can draw.
YOUNGEST_YEARS, OLDEST_YEARS = 6.0, 85.0
#: Local targets left out of random people: they move the head as a whole or look ill.
_EXCLUDED_LOCAL = (
    "universal", "scale-vert", "trans-forward", "trans-backward", "neck-trans",
    "mouth-angles", "mouth-dimples", "laugh-lines", "eyebrows-angle",  # they look cross or sad
)  # fmt: skip
#: These make sleepy lids at full strength; fitting leaves them alone.
_CALM_LOCAL = ("eye-height", "eyefold", "eye-bag")
#: These make pinched or hanging noses.
_CALM_NOSE = ("nose-point", "nose-septum", "nose-base", "nose-volume")
#: How readily fitting moves a target, 1 unless named: 0 where no fitted distance tells what it
#: does well, little where much of it makes pinched or upturned noses, pouts and receding chins.
_EASE = {
    "eye-push": 0.0, "neck": 0.0, "cleft": 0.0, "eyebrows": 0.0, "head-fat": 0.0,
    "nose-base": 0.35, "nose-point": 0.3, "nose-septum": 0.3, "nose-trans": 0.6,
    "nose-scale-depth": 0.6, "nose-greek": 1.3, "upperlip-middle": 0.5, "mouth-scale-depth": 0.4,
    "chin-prognathism": 1.6, "chin-prominent": 1.3,
}  # fmt: skip
#: Pairs that fitting needs, less of each in those drawn: opposites by their effect.
_PROPORTIONS = (
    (("nose-scale-vert-incr",), ("nose-scale-vert-decr",)),
    (("nose-trans-forward",), ("nose-trans-backward",)),
    (("mouth-scale-vert-incr",), ("mouth-scale-vert-decr",)),
    (("head-scale-vert-incr",), ("head-scale-vert-decr",)),
    (("forehead-scale-vert-incr",), ("forehead-scale-vert-decr",)),
    (("head-triangular",), ("head-invertedtriangular",)),
    (("head-round",), ("head-diamond",)),
    (("head-oval",), ("head-rectangular",)),
    (
        ("l-ear-scale-vert-incr", "r-ear-scale-vert-incr"),
        ("l-ear-scale-vert-decr", "r-ear-scale-vert-decr"),
    ),
)
_PROPORTION_SD = 0.1
_SMILE = (0.15, 0.5)  # of mouth-angles-up: a friendly rest
_ANCESTRIES = ("african", "asian", "caucasian")
_ANCESTRY_CONCENTRATION = 0.5  # of the Dirichlet distribution: most have one, many are mixed
#: Age in years at `age` 0, 0.5 and 1; MakeHuman's child has the proportions of about six years.
_AGE_YEARS = ((0.0, 0.5, 1.0), (6.0, 25.0, 85.0))
#: Beyond this age a person is compared with people this old: what age does to a face shows.
_REFERENCE_AGE = 0.62
_JAW_PIVOT_MM = (0.0, -22.0, -57.5)  # between the condyles (cdl), on the template
_NECK_PIVOT_MM = (0.0, -60.0, -85.0)  # atlanto-occipital joint, on the template
#: The base mesh's dental arches reach into the corners of the mouth and show through them.
_ARCH_WIDTH, _ARCH_BACK_MM = 0.86, 1.5
_SEALINGS = 3
_MOUTH_MM, _MOUTH_BOX_MM = (0.0, -67.0, 15.0), (40.0, 25.0, 40.0)  # on the template
_SLIT_STEP_MM = 0.05
_SEAL_FALLOFF_MM = 5.0
_LIP_PRESS_MM = 0.25


def age_of_years(years: float) -> float:
    """`Identity.age` of an age in years: 6 → 0, 25 → 0.5, 85 → 1, straight between."""
    return float(np.interp(years, _AGE_YEARS[1], _AGE_YEARS[0]))


@dataclass(frozen=True)
class Identity:
    """Who a head is.

    Attributes
    ----------
    name : str
    age : float
        0 child of six, 0.5 young adult, 1 old; `age_of_years` makes it.
    female : float
        0 male to 1 female.
    ancestry : mapping from ``african``, ``asian``, ``caucasian`` to a share
        Normalised to sum 1.
    fullness : float
        −1 thin to 1 full.
    local : mapping from target name to weight
    traits : AppearanceTraits
    size : float
        Scale of the whole head, above 0.
    """

    name: str
    age: float = 0.5
    female: float = 0.5
    ancestry: Mapping[str, float] = field(default_factory=lambda: {"caucasian": 1.0})
    fullness: float = 0.0
    local: Mapping[str, float] = field(default_factory=dict)
    traits: AppearanceTraits = field(default_factory=AppearanceTraits)
    size: float = 1.0

    @property
    def age_years(self) -> float:
        """Age in years, from 6 to 85."""
        return float(np.interp(self.age, *_AGE_YEARS))


def random_identity(
    rng: np.random.Generator,
    name: str = "someone",
    *,
    age_years: tuple[float, float] | None = None,
    female: bool | None = None,
) -> Identity:
    """Draw a person: an adult of 23 to 67 unless told otherwise.

    Local targets come in opposite pairs of which one side is taken; left and right differ a
    little, as they do in people. Then size and local weights are moved so that the distances of
    the face are spread as published for the sex and age.

    Parameters
    ----------
    rng : numpy Generator
    name : str
    age_years : (lowest, highest) float, optional
        Within 6 to 85.
    female : bool, optional
        Either sex unless given.

    Raises
    ------
    ValueError
        If the ages are not within 6 to 85, lowest first.
    """
    if age_years is not None:
        low, high = age_years
        if not YOUNGEST_YEARS <= low <= high <= OLDEST_YEARS:
            raise ValueError(
                f"age_years must be (lowest, highest) within {YOUNGEST_YEARS:g} to "
                f"{OLDEST_YEARS:g}, got {age_years}"
            )
    shares = rng.dirichlet((_ANCESTRY_CONCENTRATION,) * len(_ANCESTRIES))
    ancestry = dict(zip(_ANCESTRIES, (float(x) for x in shares), strict=True))
    is_female = bool(rng.random() < 0.5) if female is None else female
    if age_years is None:
        age = float(rng.uniform(*ADULT_AGE))
    else:
        age = age_of_years(float(rng.uniform(*age_years)))
    drawn, uneven = [], []
    for pair in local_pairs():
        calm = pair.sd / LOCAL_SD
        drawn.append(calm * np.clip(rng.normal(0, LOCAL_SD), -0.6, 0.6))
        sides = pair.positive if len(pair.positive) > 1 else ()
        uneven.append([float(rng.normal(0, ASYMMETRY_SD)) for _ in sides] or [0.0])
    smile = float(rng.uniform(*_SMILE))
    traits = AppearanceTraits.random(rng, ancestry=ancestry, age=age, female=float(is_female))
    body = rng.spawn(1)[0]  # the form of a head does not hang on how many numbers its paint takes
    fullness = float(body.normal(0, FULLNESS_SD))
    log_size = float(body.normal(0, SIZE_SD))
    more = body.normal(0, _PROPORTION_SD, size=len(_proportion_pairs()))
    pairs = local_pairs() + _proportion_pairs()
    uneven += [[0.0] * len(pair.positive) for pair in _proportion_pairs()]
    local = {"mouth-angles-up": smile}
    person = Identity(name, age, float(is_female), ancestry, fullness, local, traits)
    fitted, size = _proportioned(person, pairs, np.append(drawn, more), log_size)
    for pair, weight, shifts in zip(pairs, fitted, uneven, strict=True):
        for plus, minus, shift in zip(pair.positive, pair.negative, shifts, strict=True):
            w = float(weight) + shift
            local[plus if w >= 0 else minus] = abs(w)
    return replace(person, local=local, size=size)


def _proportioned(
    person: Identity, pairs: tuple[LocalPair, ...], drawn: NDArray[np.float64], log_size: float
) -> tuple[NDArray[np.float64], float]:
    """Local weights and size with which a person has people's proportions."""
    usual = {"mouth-angles-up": float(np.mean(_SMILE))}
    age = min(person.age, _REFERENCE_AGE)
    evenly = dict.fromkeys(_ANCESTRIES, 1 / len(_ANCESTRIES))
    mean = Identity("mean", age, person.female, evenly, 0.0, usual)
    middle = phenotype_landmarks(target_weights(mean))
    # the Dirichlet distribution's covariance is a multiple of the projection onto sum 0
    n = len(_ANCESTRIES)
    share_sd = np.sqrt(1 / (n * (n * _ANCESTRY_CONCENTRATION + 1)))
    spread = []
    for ancestry in _ANCESTRIES:
        pure = phenotype_landmarks(target_weights(replace(mean, ancestry={ancestry: 1.0})))
        spread.append(share_sd * (pure - middle))
    full, thin = (
        phenotype_landmarks(target_weights(replace(mean, fullness=f)))
        for f in (FULLNESS_SD, -FULLNESS_SD)
    )
    spread.append((full - thin) / 2)
    return fit_to_norms(
        pairs,
        drawn,
        weights=target_weights(person),
        mean_weights=target_weights(mean),
        spread=np.stack(spread, axis=-1),
        log_size=log_size,
        sex="female" if person.female >= 0.5 else "male",
        age_years=person.age_years,
    )


@cache
def local_pairs() -> tuple[LocalPair, ...]:
    """The local targets that people are drawn with, both sides of the face together."""
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
        if any(word in name for word in _EXCLUDED_LOCAL) or name.startswith("r-"):
            continue
        for plus, minus in opposites:
            opposite = name.removesuffix(plus) + minus
            if name.endswith(plus) and opposite in names:
                sides = ("l-", "r-") if name.startswith("l-") else ("",)
                calm = any(word in name for word in _CALM_LOCAL)
                half = calm or any(word in name for word in _CALM_NOSE)
                stem, other = name.removeprefix("l-"), opposite.removeprefix("l-")
                pairs.append(
                    LocalPair(
                        tuple(side + stem for side in sides),
                        tuple(side + other for side in sides),
                        LOCAL_SD * (0.5 if half else 1.0),
                        0.0 if calm else _ease(name),
                    )
                )
    return tuple(pairs)


def _ease(target: str) -> float:
    return next((ease for word, ease in _EASE.items() if word in target), 1.0)


@cache
def _proportion_pairs() -> tuple[LocalPair, ...]:
    return tuple(LocalPair(up, down, _PROPORTION_SD, _ease(up[0])) for up, down in _PROPORTIONS)


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


def make_head(identity: Identity, *, texture_px: int = 2048) -> Head:
    """Build a head: geometry, closed lips, feature points, landmarks, ARKit shapes, looks.

    Parameters
    ----------
    identity : Identity
    texture_px : int
        Side of the skin's textures, at least 256: painting takes most of the time.

    Raises
    ------
    InputError
        If a local target is unknown, or the size is not above 0.
    """
    if not identity.size > 0:
        raise InputError(f"identity {identity.name}: size must be above 0, got {identity.size:g}")
    template = load_template()
    weights = np.zeros(len(template.identity_names))
    for name, weight in target_weights(identity).items():
        if name not in template.identity_names:
            raise InputError(f"identity {identity.name}: unknown target {name}")
        weights[template.identity_names.index(name)] = weight
    moved = (weights @ template.identity).reshape(3, -1).T
    vertices = _sealed_lips(template, identity.size * (template.vertices + moved))
    for part in ("teeth_upper", "teeth_lower"):
        rows = template.vertices_of(part)
        vertices[rows] = vertices[rows] * (_ARCH_WIDTH, 1, 1) - (0, 0, _ARCH_BACK_MM)
    eyes = {side: _eye(template, vertices, f"eye_{side}") for side in ("right", "left")}
    vertices = vertices - (eyes["right"].centre + eyes["left"].centre) / 2
    eyes = {side: _eye(template, vertices, f"eye_{side}") for side in ("right", "left")}
    size = np.float32(identity.size)
    jaw, neck = joints(vertices, identity.size)
    return Head(
        name=identity.name,
        mesh=Mesh(
            vertices,
            template.triangles,
            template.uv,
            template.uv_triangles,
            template.groups(),
            template_landmarks(),
        ),
        feature_points=template_feature_points(),
        eyes=eyes,
        jaw_pivot=jaw,
        neck_pivot=neck,
        appearance=make_appearance(template, identity.traits, size=texture_px),
        shape_names=template.arkit_names,
        shapes=template.arkit if size == 1 else size * template.arkit,
        regions=template_regions(),
    )


def joints(
    vertices: NDArray[np.float64], size: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The pivots of jaw and neck, (3,) mm each, of a head in the template's topology.

    Parameters
    ----------
    vertices : (V, 3) float64, mm, head frame
    size : float
        Of the head relative to the template.
    """
    template = load_template()
    return (
        _pivot(template, vertices, _JAW_PIVOT_MM, size),
        _pivot(template, vertices, _NECK_PIVOT_MM, size),
    )


def _pivot(
    template: Template,
    vertices: NDArray[np.float64],
    on_template: tuple[float, float, float],
    size: float,
) -> NDArray[np.float64]:
    """A joint's place: as far from the ears' tragi as on the template, times the size."""
    ears = template_landmarks().select(("t_r", "t_l"))
    here, there = ears.at(vertices).mean(axis=0), ears.at(template.vertices).mean(axis=0)
    return np.asarray((here + size * (np.array(on_template) - there)) * (0, 1, 1))


def _eye(template: Template, vertices: NDArray[np.float64], part: str) -> Eye:
    p = vertices[template.vertices_of(part)]
    centre = (p.min(axis=0) + p.max(axis=0)) / 2
    return Eye(centre, float(np.median(np.linalg.norm(p - centre, axis=1))))


def _sealed_lips(template: Template, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move the lips so that they just touch at rest.

    Subdivision and phenotypes leave a slit of a millimetre or less. Its height is measured by
    rays along −z in columns over the mouth; both lips move by half of it, fading away from it.
    A slit that winds through depth may open anew beside the first: it is looked for again.
    """
    lips = np.zeros(len(vertices))
    lips[template.triangles.ravel()] = template.masks["lips"][template.uv_triangles.ravel()]
    mouth = template.triangles[
        (template.part_of_triangle == PART_NAMES.index("skin"))
        & (
            np.abs(template.vertices[template.triangles].mean(axis=1) - _MOUTH_MM) < _MOUTH_BOX_MM
        ).all(axis=1)
    ]
    found = vertices.copy()
    for _ in range(_SEALINGS):
        xs, gaps, seams, middle_y = _slits(found, mouth)
        if not gaps.any():
            break
        near = np.flatnonzero(np.abs(found[:, 1] - middle_y) < 25)
        p = found[near]
        opening = np.interp(p[:, 0], xs, gaps, left=0, right=0)
        opening = opening + _LIP_PRESS_MM * (opening > 0)
        below = p[:, 1] < np.interp(p[:, 0], xs, seams)
        distance = np.abs(p[:, 1] - np.interp(p[:, 0], xs, seams))
        weight = np.exp(-((distance / _SEAL_FALLOFF_MM) ** 2)) * np.clip(lips[near] * 1.5, 0, 1)
        found[near, 1] += np.where(below, 0.5, -0.5) * opening * weight
    return found


def _slits(
    vertices: NDArray[np.float64], skin: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
    """Columns x over the mouth, the height of the opening in each, its middle; and the seam's y."""
    points = template_feature_points().select(("8.4", "8.3", "2.2", "2.3"))
    right, left, upper, lower = points.at(vertices)
    middle_y = float((upper[1] + lower[1]) / 2)
    xs = np.linspace(right[0], left[0], 41)[1:-1]
    lip_z = np.interp(xs, [right[0], 0, left[0]], [right[2], lower[2], left[2]])
    ys = np.arange(middle_y + 6, middle_y - 6, -_SLIT_STEP_MM)
    grid = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
    origins = np.concatenate([grid, np.full((len(grid), 1), 500.0)], axis=1)
    t, *_ = RayScene(vertices, skin).cast(origins, np.tile([0.0, 0.0, -1.0], (len(grid), 1)))
    t = t.reshape(len(xs), len(ys))
    behind = 500.0 - t < (lip_z - 6.0)[:, None]
    is_open = behind.any(axis=1)
    first = np.argmax(behind, axis=1)
    last = len(ys) - 1 - np.argmax(behind[:, ::-1], axis=1)
    gaps = np.where(is_open, ys[first] - ys[last] + _SLIT_STEP_MM, 0.0)
    seams = np.where(is_open, (ys[first] + ys[last]) / 2, ys[np.argmax(t, axis=1)])
    return xs, gaps, seams, middle_y
