"""How a set's markers stand on anybody's face, and how they move: what labelling starts from.

People differ along a few dozen directions (`people_modes`, drawn from `heads.identity`), faces
move along the ARKit shapes, and glue is never quite where the set says. All three together are the
`Person` called anyone. A set without heads' geometry, such as another system's, takes all of it
from a take that is labelled already (`person_of_take`).
"""

from __future__ import annotations

from functools import cache
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import readonly
from ..core.errors import InputError
from ..core.files import atomic_path
from ..core.markers import MarkerSet
from ..core.person import Person
from ..core.trajectories import Trajectories
from ..heads.identity import (
    OLDEST_YEARS,
    YOUNGEST_YEARS,
    Identity,
    make_head,
    random_identity,
    target_weights,
)
from ..heads.marker_sets import glue_markers
from ..heads.template import load_template
from .weighted_fit import fit_frames, to_head

Floats = NDArray[np.float64]

N_MODES = 40  # of a Person; with the pose, what a frame's linear algebra costs
LOG_SCALE_SD = 0.08  # of heads, children among them
_GLUE_SD_MM = 2.5  # how far off its place a marker is glued
_SKULL_GLUE_SD_MM = 7.0  # the same on the skull, where no feature guides the hand
_EXPRESSION_SD = 0.30  # of ARKit weights in a performance
_REST_SD = 0.05  # and of a face asked to rest
#: What shapes do not tell: smooth displacements, their standard deviation and reach.
_SMOOTH_SD_MM, _SMOOTH_REACH_MM = 2.0, 45.0
#: The same against another take of the same markers, which are glued anew.
_TAKE_SMOOTH_SD_MM, _TAKE_NOISE_MM = 6.0, 1.5
_TAKE_SCALE_SD = 0.06
_TAKE_ROUNDS = 4
_MIN_FRAMES = 10
#: People drawn for ``data/people.npz``, what is kept of them, and where on the head it is judged.
_N_DRAWN, _N_PEOPLE_MODES, _BACK_MM, _EVERY = 800, 50, -90.0, 5


@cache
def template_positions(marker_set: MarkerSet) -> Floats:
    """Where a set's markers sit on the average head, (M, 3) mm, head frame; read-only."""
    return _on_average(marker_set)[0]


@cache
def anyone(marker_set: MarkerSet, *, at_rest: bool = False) -> Person:
    """Whoever may wear a set, in performance or at rest.

    Modes are those of people's forms, of ARKit's shapes (with little weight at rest) and of
    smooth displacements that neither explains, reduced to the 40 strongest; what is cut off goes
    to `noise_mm`, with the glue.
    """
    _, neutral, of_people, of_shapes = _on_average(marker_set)
    expression = _REST_SD if at_rest else _EXPRESSION_SD
    modes = np.concatenate([of_people, expression * of_shapes])
    smooth = _SMOOTH_SD_MM * (0.5 if at_rest else 1.0)
    covariance = _second_moment(modes) + _smooth(neutral, smooth)
    glue = np.where([m.is_rigid for m in marker_set.markers], _SKULL_GLUE_SD_MM, _GLUE_SD_MM)
    modes, noise = low_rank(covariance, glue)
    return Person(
        marker_set.name,
        marker_set.labels,
        neutral,
        modes,
        noise,
        np.zeros(len(noise), bool),
        LOG_SCALE_SD,
    )


@cache
def expression_covariance(marker_set: MarkerSet) -> Floats:
    """(3M, 3M) mm²: how a face that is known moves, before any of it has been seen."""
    neutral, _, _, of_shapes = _on_average(marker_set)
    moved = _second_moment(_EXPRESSION_SD * of_shapes) + _smooth(neutral, _SMOOTH_SD_MM / 2)
    return readonly(moved, (None, None), "covariance")


def person_of_take(take: Trajectories, name: str = "take") -> Person:
    """The person of a take whose labels are right: a template for others of the same markers.

    Frames are laid over each other (rotation and translation, generalised Procrustes analysis),
    their mean stands for the face at rest. Expressions that the take does not show, and markers
    glued anew, are allowed for by smooth displacements.

    Raises
    ------
    InputError
        If fewer than 10 frames show half of the markers, or a marker is never seen.
    """
    p = np.asarray(take.positions)
    M = p.shape[1]
    seen = ~np.isnan(p[..., 0])
    p = p[seen.sum(axis=1) >= max(4, M // 2)]
    if len(p) < _MIN_FRAMES:
        raise InputError(
            f"a template take needs at least {_MIN_FRAMES} frames with half of the markers, this "
            f"has {len(p)}"
        )
    never = [n for m, n in enumerate(take.names) if not seen[:, m].any()]
    if never:
        raise InputError(f"the template take never shows {', '.join(never)}")
    mean = p[seen[seen.sum(axis=1) >= max(4, M // 2)].sum(axis=1).argmax()]
    mean = np.where(np.isnan(mean), np.nanmean(p, axis=0), mean)
    for _ in range(_TAKE_ROUNDS):
        q = to_head(p, *fit_frames(mean, p))
        mean = np.nanmean(q, axis=0)
    off = np.nan_to_num(q - mean).reshape(len(q), -1)
    covariance = off.T @ off / len(q) + _smooth(mean, _TAKE_SMOOTH_SD_MM)
    modes, noise = low_rank(covariance, np.full(M, _TAKE_NOISE_MM))
    known = np.ones(M, bool)
    return Person(name, take.names, mean, modes, noise, known, _TAKE_SCALE_SD, len(q))


def low_rank(covariance: Floats, own_mm: Floats, n_modes: int = N_MODES) -> tuple[Floats, Floats]:
    """Modes (K, M, 3) and noise (M,) of a covariance (3M, 3M) mm², plus each marker's own sd."""
    values, vectors = np.linalg.eigh(covariance)
    kept = slice(max(0, len(values) - n_modes), None)
    modes = (vectors[:, kept] * np.sqrt(np.maximum(values[kept], 0.0))).T[::-1]
    rest = np.maximum(np.diag(covariance) - (modes**2).sum(axis=0), 0.0).reshape(-1, 3)
    noise = np.sqrt(own_mm**2 + rest.mean(axis=1))
    return np.ascontiguousarray(modes).reshape(len(modes), -1, 3), noise


def _second_moment(modes: Floats) -> Floats:
    flat = modes.reshape(len(modes), -1)
    return np.asarray(flat.T @ flat)


def _smooth(points: Floats, sd_mm: float) -> Floats:
    """Covariance (3M, 3M) of displacements that neighbours share."""
    d = np.linalg.norm(points[:, None] - points[None], axis=2)
    kernel = sd_mm**2 * np.exp(-0.5 * (d / _SMOOTH_REACH_MM) ** 2)
    return np.asarray(np.kron(kernel, np.eye(3)))


@cache
def _on_average(marker_set: MarkerSet) -> tuple[Floats, Floats, Floats, Floats]:
    """Of each marker: place on the average head and on people's mean, (M, 3); people's modes and
    shapes' offsets, (K, M, 3); all mm."""
    average = Identity("average")
    head = make_head(average, texture_px=256)
    glue = glue_markers(head, marker_set)
    template = load_template()
    eyes = np.concatenate([template.vertices_of("eye_right"), template.vertices_of("eye_left")])
    mean, modes = people_modes()
    from_average = mean - _weights(average)
    weights = np.concatenate([from_average[None], modes])
    offsets = np.asarray(weights @ template.identity).reshape(len(weights), 3, -1).swapaxes(1, 2)
    # the origin lies between the eyeballs
    moved = glue.at(offsets) - offsets[:, eyes].mean(axis=1)[:, None]
    place = readonly(glue.at(head.mesh.vertices), (None, 3), "places")
    return place, place + moved[0], moved[1:], glue.at(np.asarray(head.shapes, dtype=np.float64))


@cache
def people_modes() -> tuple[Floats, Floats]:
    """How people differ: weights of the head template's identity targets.

    Returns
    -------
    (N,) float64
        Of the mean person.
    (K, N) float64
        Principal components over people of 6 to 85 years, each at one standard deviation.
    """
    with (
        as_file(files(__package__).joinpath("data", "people.npz")) as path,
        np.load(path, allow_pickle=False) as z,
    ):
        names, mean, modes = z["names"], z["mean"], z["modes"]
    assert tuple(str(n) for n in names) == load_template().identity_names, "make people.npz anew"
    return mean.astype(np.float64), modes.astype(np.float64)


def _weights(identity: Identity) -> Floats:
    names = load_template().identity_names
    found = np.zeros(len(names))
    for name, weight in target_weights(identity).items():
        found[names.index(name)] = weight
    return found


def make_people(path: Path, *, rng: np.random.Generator) -> None:
    """Write ``data/people.npz``: draw people and reduce them to principal components."""
    template = load_template()
    people = [
        random_identity(rng, age_years=(YOUNGEST_YEARS, OLDEST_YEARS)) for _ in range(_N_DRAWN)
    ]
    weights = np.array([_weights(p) for p in people])
    mean = weights.mean(axis=0)
    front = np.flatnonzero(template.vertices[:, 2] > _BACK_MM)[::_EVERY]
    columns = (np.arange(3)[:, None] * len(template.vertices) + front).ravel()
    shown = np.asarray((weights - mean) @ template.identity[:, columns])
    U, S, _ = np.linalg.svd(shown, full_matrices=False)
    modes = U[:, :_N_PEOPLE_MODES].T @ (weights - mean) / np.sqrt(len(people) - 1)
    print(f"kept {1 - (S[_N_PEOPLE_MODES:] ** 2).sum() / (S**2).sum():.4f} of the variance")
    with atomic_path(path) as part, open(part, "wb") as stream:
        np.savez_compressed(
            stream,
            names=np.array(template.identity_names),
            mean=mean.astype(np.float32),
            modes=modes.astype(np.float32),
        )


if __name__ == "__main__":
    make_people(Path(__file__).parent / "data" / "people.npz", rng=np.random.default_rng(20261122))
