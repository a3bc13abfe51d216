"""Settings found from footage: polarity, colour, level, flicker."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from facewright.core.errors import InputError
from facewright.core.video import read_frames
from facewright.tracking.blobs import find_blobs, shining
from facewright.tracking.spot_settings import COLOURS, find_settings

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
SKIN, HAIR, ROOM = (190.0, 140.0, 120.0), (40.0, 30.0, 25.0), (90.0, 95.0, 100.0)
LUMA = np.array([0.2126, 0.7152, 0.0722])


def painted_face(
    rng: np.random.Generator, colour: str, *, light: float = 1.0, n: int = 22
) -> tuple[Image, Floats]:
    """A shaded oval with hair and a lamp behind it, painted dots of 3.2 px; RGB and centres."""
    y, x = np.mgrid[:360, :480].astype(np.float64)
    image = np.empty((360, 480, 3))
    image[:] = ROOM
    shade = 0.75 + 0.25 * (x - 130) / 220
    face = ((x - 240) / 110) ** 2 + ((y - 190) / 140) ** 2 < 1
    image[face] = np.array(SKIN) * shade[face][:, None]
    image[(((x - 240) / 120) ** 2 + ((y - 170) / 160) ** 2 < 1) & (y < 100)] = HAIR
    image[(x > 430) & (y < 60)] = 250
    centres: list[Floats] = []
    while len(centres) < n:
        p = np.array([rng.uniform(175, 305), rng.uniform(120, 285)])
        if all(np.linalg.norm(p - c) > 17 for c in centres):
            centres.append(p)
    s = (np.arange(17 * 8) + 0.5) / 8 - 0.5
    for cx, cy in centres:
        x0, y0 = int(np.rint(cx)) - 8, int(np.rint(cy)) - 8
        fine = ((s + x0 - cx) ** 2 + (s[:, None] + y0 - cy) ** 2 < 3.2**2).astype(float)
        share = ndimage.gaussian_filter(fine, 4).reshape(17, 8, 17, 8).mean(axis=(1, 3))[..., None]
        tile = np.s_[y0 : y0 + 17, x0 : x0 + 17]
        image[tile] *= 1 - share
        image[tile] += np.array(COLOURS[colour]) * share * shade[tile][..., None]
    noisy = light * image + rng.normal(0, 2, image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), np.array(centres)


def luma(image: Image) -> Image:
    return np.asarray(np.clip(np.rint(image @ LUMA), 0, 255).astype(np.uint8))


def found_share(centres: Floats, true: Floats, within_px: float = 0.3) -> float:
    if not len(centres):
        return 0.0
    d = np.linalg.norm(centres[None] - true[:, None], axis=2).min(axis=1)
    return float((d < within_px).mean())


@pytest.mark.parametrize("colour", ["white", "black"])
def test_bright_and_dark_markers_are_found_in_grey_pictures(colour: str) -> None:
    rng = np.random.default_rng(3)
    takes = [painted_face(rng, colour) for _ in range(4)]
    images = [luma(image) for image, _ in takes]

    settings = find_settings(images)

    assert settings.weights == ((1.0,) if colour == "white" else (-1.0,))
    assert not settings.needs_colour
    for image, (_, true) in zip(images, takes, strict=True):
        blobs = find_blobs(image, settings)
        assert found_share(blobs.centres, true) == 1
        assert len(blobs) <= len(true) + 2


@pytest.mark.parametrize("colour", ["blue", "green", "red", "yellow"])
def test_markers_of_a_given_colour_are_found(colour: str) -> None:
    rng = np.random.default_rng(4)
    takes = [painted_face(rng, colour) for _ in range(3)]

    settings = find_settings([image for image, _ in takes], colour=colour)

    assert settings.needs_colour
    for image, true in takes:
        blobs = find_blobs(image, settings)
        assert found_share(blobs.centres, true) == 1
        assert len(blobs) <= len(true) + 3


def test_a_colour_is_found_where_grey_shows_nothing() -> None:
    """Green as bright as the skin."""
    rng = np.random.default_rng(5)
    takes = [painted_face(rng, "green") for _ in range(3)]

    settings = find_settings([image for image, _ in takes])

    assert settings.needs_colour
    assert max(settings.weights) == settings.weights[1] > 0  # what is greener shines
    assert np.mean([found_share(find_blobs(i, settings).centres, t) for i, t in takes]) > 0.95


def test_flicker_is_followed_and_one_overexposed_frame_forgiven() -> None:
    rng = np.random.default_rng(6)
    lights = [1.0, 0.7, 1.15, 2.6, 0.85]
    takes = [painted_face(rng, "black", light=light) for light in lights]
    images = [luma(image) for image, _ in takes]

    settings = find_settings(images)

    assert settings.background > 0
    for light, image, (_, true) in zip(lights, images, takes, strict=True):
        if light < 2:
            assert found_share(find_blobs(image, settings).centres, true) == 1


def test_steady_light_needs_no_following() -> None:
    rng = np.random.default_rng(7)
    images = [luma(painted_face(rng, "white")[0]) for _ in range(3)]

    assert np.isnan(find_settings(images).background)


def test_frames_without_markers_are_forgiven_unless_they_are_most() -> None:
    rng = np.random.default_rng(8)
    with_markers = [luma(painted_face(rng, "white")[0]) for _ in range(3)]
    without = [luma(painted_face(rng, "white", n=0)[0]) for _ in range(4)]

    assert find_settings([*with_markers, *without[:2]]).level > 0
    with pytest.raises(InputError, match="no markers found"):
        find_settings(without)


def test_what_cannot_be_is_refused_in_words() -> None:
    image = luma(painted_face(np.random.default_rng(9), "white")[0])

    with pytest.raises(InputError, match="no frames"):
        find_settings([])
    with pytest.raises(InputError, match="marker colour teal: expected one of white"):
        find_settings([image], colour="teal")
    with pytest.raises(InputError, match="blue markers cannot be told in grey"):
        find_settings([image], colour="blue")


def coded_420(image: Image) -> Image:
    """RGB as BT.709 limited-range 4:2:0, planes one below another, (540, 480) for (360, 480, 3).

    Colour is sited as H.264 has it: on every other column, between rows.
    """
    y = image @ LUMA
    blue = np.pad((image[..., 2] - y) / 1.8556, ((0, 0), (1, 1)), mode="edge")
    red = np.pad((image[..., 0] - y) / 1.5748, ((0, 0), (1, 1)), mode="edge")
    planes = [16 + y * 219 / 255]
    for c in (blue, red):
        across = (c[:, :-2:2] + 2 * c[:, 1:-1:2] + c[:, 2::2]) / 4
        planes.append((128 + (across[::2] + across[1::2]) / 2 * 224 / 255).reshape(-1, 480))
    return np.asarray(np.clip(np.rint(np.concatenate(planes)), 0, 255).astype(np.uint8))


def test_colour_of_half_resolution_in_video_does_not_shift_the_centres(tmp_path: Path) -> None:
    """4:2:0 keeps one colour for each 2 × 2 pixels; where it sits must be agreed on."""
    rng = np.random.default_rng(10)
    takes = [painted_face(rng, "blue") for _ in range(6)]
    path = tmp_path / "blue.mp4"
    with av.open(str(path), "w") as container:
        try:
            stream = container.add_stream("libx264", rate=30, options={"crf": "8"})
        except (av.FFmpegError, ValueError):
            pytest.skip("this FFmpeg has no x264")
        stream.width, stream.height, stream.pix_fmt = 480, 360, "yuv420p"
        stream.codec_context.colorspace, stream.codec_context.color_range = 1, 1
        for image, _ in takes:
            frame = av.VideoFrame.from_ndarray(coded_420(image), format="yuv420p")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    frames = [frame.image for frame in read_frames(path)]

    settings = find_settings(frames, colour="blue")

    errors = []
    for image, (_, true) in zip(frames, takes, strict=True):
        centres = find_blobs(image, settings).centres
        d = np.linalg.norm(centres[None] - true[:, None], axis=2)
        near = d.min(axis=1) < 1
        assert near.mean() > 0.9
        errors.append((centres[d.argmin(axis=1)] - true)[near])
    assert np.abs(np.concatenate(errors).mean(axis=0)).max() < 0.03


def test_what_shines_is_the_picture_itself_for_bright_markers() -> None:
    image = luma(painted_face(np.random.default_rng(11), "white")[0])

    assert shining(image, find_settings([image])) is image
