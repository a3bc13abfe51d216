from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.heads.appearance import Appearance, jpeg_bytes, make_appearance, png_bytes
from facewright.heads.appearance_traits import CUTS, AppearanceTraits
from facewright.heads.template import load_template, template_feature_points
from facewright.heads.texture_canvas import make_canvas
from facewright.heads.texture_layout import appearance_uv


def looks(**traits: object) -> Appearance:
    return make_appearance(load_template(), AppearanceTraits(**traits))  # type: ignore[arg-type]


def colour_at(appearance: Appearance, place_mm: tuple[float, float, float]) -> NDArray[np.float64]:
    """Mean sRGB about the skin vertex nearest to a place on the template."""
    template = load_template()
    rows = template.groups()["skin"]
    vertex = template.triangles[rows].ravel()
    near = np.argmin(np.linalg.norm(template.vertices[vertex] - place_mm, axis=1))
    u, v = appearance_uv(template)[template.uv_triangles[rows].ravel()[near]]
    size = len(appearance.skin)
    x, y = int(u * size), int((1 - v) * size)
    patch = appearance.skin[max(y - 5, 0) : y + 6, max(x - 5, 0) : x + 6]
    return np.asarray(patch.reshape(-1, 3).mean(axis=0), dtype=np.float64)


def test_same_traits_give_same_bytes_and_other_seeds_do_not() -> None:
    traits = AppearanceTraits(seed=5, stubble=0.4, freckles=0.5)
    first = make_appearance(load_template(), traits)
    make_appearance.cache_clear()
    again = make_appearance(load_template(), traits)

    assert first is not again
    assert np.array_equal(first.skin, again.skin)
    assert first.normal is not None and again.normal is not None
    assert np.array_equal(first.normal, again.normal)
    assert first.roughness is not None and again.roughness is not None
    assert np.array_equal(first.roughness, again.roughness)
    assert first.eye is not None and again.eye is not None
    assert np.array_equal(first.eye, again.eye)
    assert first.details is not None and again.details is not None
    assert np.array_equal(first.details, again.details)
    assert not np.array_equal(first.skin, looks(seed=6, stubble=0.4, freckles=0.5).skin)


def test_random_traits_follow_the_generator_and_ancestry() -> None:
    def drawn(seed: int, **shares: float) -> AppearanceTraits:
        rng = np.random.default_rng(seed)
        return AppearanceTraits.random(rng, ancestry=shares, age=0.5, female=1.0)

    assert drawn(3, african=1.0) == drawn(3, african=1.0)
    dark = [drawn(k, african=1.0).melanin for k in range(20)]
    light = [drawn(k, caucasian=1.0).melanin for k in range(20)]
    assert min(dark) > max(light)
    assert all(drawn(k, asian=1.0).stubble == 0 for k in range(20))


def test_left_and_right_skin_are_alike_but_not_mirrored() -> None:
    template, skin = load_template(), looks().skin
    rows = template.groups()["skin"]
    uv = appearance_uv(template)[template.uv_triangles[rows]].mean(axis=1)
    middle = template.vertices[template.triangles[rows]].mean(axis=1)
    face = np.flatnonzero((middle[:, 0] > 5) & (middle[:, 2] > -20) & (middle[:, 1] < 60))
    mirrored = middle[face] * (-1, 1, 1)
    partner = [int(np.argmin(np.abs(middle - m).sum(axis=1))) for m in mirrored[::7]]
    exact = np.abs(middle[partner] - mirrored[::7]).max(axis=1) < 0.05

    def colours(at: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y = (at[:, 0] * 2048).astype(int), ((1 - at[:, 1]) * 2048).astype(int)
        return np.asarray(skin[y, x], dtype=np.float64)

    left, right = colours(uv[face[::7]][exact]), colours(uv[partner][exact])
    assert exact.sum() > 200
    assert np.median(np.abs(left - right)) < 9
    assert (left != right).any(axis=1).mean() > 0.8


def test_coordinates_are_one_to_one_on_the_skin() -> None:
    template = load_template()
    uv = appearance_uv(template)[template.uv_triangles[template.groups()["skin"]]]
    old = template.uv[template.uv_triangles[template.groups()["skin"]]]

    def area(t: NDArray[np.float64]) -> NDArray[np.float64]:
        a, b = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
        return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])

    assert uv.min() >= 0 and uv.max() <= 1
    # no triangle of the template that has an area loses it or, within its island, its sense
    solid = np.abs(area(old)) > 1e-9
    sense = np.sign(area(uv)[solid]) * np.sign(area(old)[solid])
    assert (sense != 0).all()
    # what is painted in total does not exceed the picture, so islands need not overlap
    assert np.abs(area(uv)).sum() / 2 < 1
    sums = np.zeros((256, 256), np.uint8)
    for triangle in np.rint(uv * 256 * 16).astype(np.int32)[np.abs(area(uv)) > 2e-5]:
        one = np.zeros_like(sums)
        cv2.fillConvexPoly(one, triangle.reshape(-1, 1, 2), 1, shift=4)
        sums += cv2.erode(one, np.ones((3, 3), np.uint8))
    assert sums.max() == 1


def test_places_have_their_colours() -> None:
    plain = looks(cut="buzz", ruddiness=0.5, lip_redness=0.6)
    at = dict(
        zip(
            template_feature_points().names,
            template_feature_points().at(load_template().vertices),
            strict=True,
        )
    )
    forehead = colour_at(plain, (0, 45, 20))
    lip = colour_at(plain, (0, -74.5, 30))
    scalp = colour_at(plain, tuple(at["11.4"]))
    left, right = (colour_at(plain, (s * 30, at["4.1"][1] + 3.5, 19)) for s in (1, -1))

    def redness(c: NDArray[np.float64]) -> float:
        return float(c[0] / c[1])

    assert redness(lip) > 1.1 * redness(forehead)
    assert scalp.mean() < 0.55 * forehead.mean()
    assert left.mean() < 0.85 * forehead.mean() and right.mean() < 0.85 * forehead.mean()
    assert colour_at(looks(cut="bald"), tuple(at["11.4"])).mean() > 0.8 * forehead.mean()
    dark = colour_at(looks(melanin=0.9), (0, 45, 20))
    assert dark.mean() < 0.6 * forehead.mean()


def test_iris_lies_in_the_middle_of_the_eye() -> None:
    eye = looks(iris=(70, 110, 160)).eye
    assert eye is not None
    c = len(eye) // 2
    assert eye[c, c].max() < 40  # pupil
    iris, sclera = eye[c, c + 48].astype(int), eye[c, c + 110].astype(int)
    assert iris[2] > iris[0] and sclera.min() > 150


def relief(appearance: Appearance, x: float, y: float, half_mm: float) -> NDArray[np.float64]:
    """Normals (N, 3) of the skin within a square about a place, seen from the front."""
    assert appearance.normal is not None
    canvas = make_canvas(load_template(), len(appearance.normal))
    p = canvas.places
    rows = (np.abs(p[:, :2] - (x, y)) < half_mm).all(axis=1) & (p[:, 2] > -10)
    assert rows.sum() > 100
    found = appearance.normal.reshape(-1, 3)[canvas.texels[rows]]
    return np.asarray((found - 128.0) / 127.5)


def test_normals_are_unit_vectors_that_lean_to_no_side() -> None:
    normal = looks(age=0.8, stubble=0.5).normal
    assert normal is not None and normal.shape == looks().skin.shape
    n = (normal.reshape(-1, 3).astype(float) - (128, 128, 127.5)) / 127.5
    assert np.abs(np.linalg.norm(n, axis=1) - 1).max() < 0.025
    assert n[:, 2].min() > 0
    assert np.abs(n[:, :2].mean(axis=0)).max() < 0.01


def test_age_furrows_the_forehead_across_and_children_are_smooth() -> None:
    def rough(age: float) -> tuple[float, float]:
        n = relief(looks(seed=4, age=age), 0, 45, 25)
        return float(n[:, 0].std()), float(n[:, 1].std())

    child, adult, old = rough(0.05), rough(0.5), rough(1.0)
    assert max(child) < 0.5 * max(adult)
    assert old[1] > 1.5 * adult[1]
    # the lines run across, so they tilt the skin up and down: the texture is upright there
    assert old[1] > 1.3 * old[0]


def test_lips_are_creased_along_their_height() -> None:
    n = relief(looks(), 0, -74, 4)
    assert n[:, 0].std() > 1.4 * n[:, 1].std()


def test_gloss_is_on_the_nose_and_not_in_the_hair() -> None:
    rough = looks(cut="buzz").roughness
    assert rough is not None
    canvas = make_canvas(load_template(), len(rough))
    p, values = canvas.places, rough.ravel()[canvas.texels].astype(float)
    nose = values[(np.abs(p[:, 0]) < 6) & (np.abs(p[:, 1] + 30) < 6) & (p[:, 2] > 25)].mean()
    cheek = values[(np.abs(p[:, 0] - 45) < 5) & (np.abs(p[:, 1] + 45) < 6)].mean()
    scalp = values[(np.abs(p[:, 0]) < 20) & (p[:, 1] > 105)].mean()
    assert nose < cheek - 15 < scalp - 40


def test_a_small_skin_is_the_large_one_made_smaller() -> None:
    traits = AppearanceTraits(seed=12, freckles=0.4, stubble=0.5, cut="slick")
    large = make_appearance(load_template(), traits)
    small = make_appearance(load_template(), traits, size=512)
    assert small.skin.shape == (512, 512, 3)
    assert small.uv is not None and large.uv is not None
    assert np.array_equal(small.uv, large.uv)
    wanted = cv2.resize(large.skin, (512, 512), interpolation=cv2.INTER_AREA).astype(int)
    off = np.abs(small.skin - wanted)
    assert np.median(off) <= 3 and off.mean() < 8
    with pytest.raises(ValueError, match="size must be at least 256"):
        make_appearance(load_template(), traits, size=64)


def test_drawing_traits_takes_one_number_of_the_generator() -> None:
    left = []
    for female, age in ((0.0, 0.1), (1.0, 0.5), (0.0, 0.95)):
        rng = np.random.default_rng(5)
        AppearanceTraits.random(rng, ancestry={"asian": 1.0}, age=age, female=female)
        left.append(int(rng.integers(2**31)))
    assert len(set(left)) == 1


def test_children_and_old_people_are_drawn_as_such() -> None:
    def drawn(age: float) -> list[AppearanceTraits]:
        draw = AppearanceTraits.random
        return [
            draw(np.random.default_rng(k), ancestry={"caucasian": 1.0}, age=age, female=0.0)
            for k in range(40)
        ]

    child, adult, old = drawn(0.1), drawn(0.5), drawn(0.95)
    assert all(t.stubble == 0 and t.recession_mm == 0 and t.cut != "bald" for t in child)
    assert any(t.stubble > 0.2 for t in adult)

    def colourful(traits: list[AppearanceTraits]) -> float:
        return float(np.mean([max(t.hair) / (min(t.hair) + 5) for t in traits]))

    assert colourful(old) < 1.2 < 1.5 < colourful(adult)
    assert np.mean([t.brow_thickness for t in child]) < np.mean([t.brow_thickness for t in adult])
    assert {t.cut for t in adult} == set(CUTS) - {"rows"}  # braids go with hair that holds them


def test_every_cut_is_painted_differently() -> None:
    darkness = [looks(cut=cut).mean_skin()[0] for cut in CUTS]
    assert len(set(darkness)) == len(CUTS)
    assert darkness[0] == max(darkness)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_png_returns_the_picture(channels: int) -> None:
    rng = np.random.default_rng(2)
    shape = (17, 23) if channels == 1 else (17, 23, channels)
    picture = rng.integers(0, 256, shape).astype(np.uint8)

    from io import BytesIO

    from PIL import Image

    assert np.array_equal(np.asarray(Image.open(BytesIO(png_bytes(picture)))), picture)


def test_a_jpeg_of_the_skin_is_small_and_close() -> None:
    from io import BytesIO

    from PIL import Image

    skin = looks(stubble=0.6).skin
    data = jpeg_bytes(skin)
    back = np.asarray(Image.open(BytesIO(data))).astype(int)
    assert len(data) < 1.5e6
    assert np.abs(back - skin).mean() < 4


def test_bad_traits_are_refused() -> None:
    with pytest.raises(ValueError, match="cut must be one of"):
        AppearanceTraits(cut="mohawk")
    with pytest.raises(ValueError, match=r"melanin must lie in 0\.\.1"):
        AppearanceTraits(melanin=1.5)
