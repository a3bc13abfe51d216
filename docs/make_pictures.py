"""Makes every picture of the documentation with the project's own code.

    python docs/make_pictures.py [--demo DIR] [NAME ...]

Without ``--demo`` a demo is run first, into a temporary folder (some minutes); NAME chooses single
pictures. The picture of the page needs Chromium, its driver and the package selenium; without
them it is left as it is, and that is said.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from facewright.cli.demo import demo
from facewright.core.clip import Clip
from facewright.core.formats.rig_json import read_rig
from facewright.core.mesh import vertex_normals
from facewright.core.mpeg4 import fap_by_name
from facewright.core.rigid import Rigid
from facewright.core.video import read_frames
from facewright.heads.catalogue import BUILT_IN, built_in_head
from facewright.heads.chart import feature_point_chart
from facewright.heads.head import Head
from facewright.heads.marker_sets import glue_markers, ready_marker_set
from facewright.heads.raycast import NO_HIT, RayScene
from facewright.heads.render import HeadRenderer, portrait_camera
from facewright.retarget.drive import HeadDrive

Picture = NDArray[np.uint8]
PICTURES = Path(__file__).resolve().parent / "pictures"
HEAD = "ruth"
#: Moments of the demo's take (seed 0) that show something, s.
STILLS_S = (0.5, 1.4)
PAGE_S = 1.4
#: Expressions by FAPs, in mm or degrees; the right side takes the left one's.
EXPRESSIONS: dict[str, dict[str, float]] = {
    "neutral": {"open_jaw": 0.0},
    "smile": {
        "stretch_l_cornerlip": 7.0,
        "raise_l_cornerlip": 6.0,
        "lift_l_cheek": 4.0,
        "close_b_l_eyelid": 1.5,
        "lower_t_lip_lm": -2.0,
        "raise_b_lip_lm": 1.5,
    },
    "open jaw": {
        "open_jaw": 20.0,
        "raise_b_midlip": -18.0,
        "raise_b_lip_lm": -15.5,
        "raise_l_cornerlip": -6.0,
        "stretch_l_cornerlip": -2.0,
    },
    "pucker": {
        "stretch_l_cornerlip": -8.0,
        "push_t_lip": 5.0,
        "push_b_lip": 5.0,
    },
    "brows up": {
        "raise_l_i_eyebrow": 6.0,
        "raise_l_m_eyebrow": 7.0,
        "raise_l_o_eyebrow": 5.0,
        "close_t_l_eyelid": -2.0,
    },
    "frown": {
        "raise_l_i_eyebrow": -4.0,
        "raise_l_m_eyebrow": -4.0,
        "raise_l_o_eyebrow": -1.5,
        "squeeze_l_eyebrow": 4.0,
        "close_t_l_eyelid": 2.0,
        "close_b_l_eyelid": 1.0,
        "raise_l_cornerlip": -3.0,
    },
    "lids closed": {"close_t_l_eyelid": 9.5, "close_b_l_eyelid": 1.0},
    "glance, turn, tilt": {
        "yaw_l_eyeball": 20.0,
        "head_yaw": -18.0,
        "head_pitch": 6.0,
        "head_roll": 7.0,
    },
}
#: Feature points whose influence is drawn, with the axis on which they are moved.
INFLUENCES = (("4.3", 1), ("8.3", 0), ("2.3", 1))


def demo_still(folder: Path) -> list[Path]:
    """Two moments of the preview: source, tracks, animated head."""
    frames = dict(_frames_at(folder / "preview.mp4", STILLS_S))
    stacked = np.concatenate([frames[s] for s in STILLS_S])
    return [_save(stacked, "demo.jpg", width=1200)]


def demo_animation(folder: Path) -> list[Path]:
    """The preview as an animated picture, half its frames."""
    pictures = []
    with closing(read_frames(folder / "preview.mp4")) as frames:
        for frame in frames:
            if frame.index % 2 == 0:
                picture = Image.fromarray(np.ascontiguousarray(frame.image))
                pictures.append(picture.resize((960, 360), Image.Resampling.LANCZOS))
    path = PICTURES / "demo.webp"
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=67, loop=0, quality=62, method=6
    )
    return [path]


def camera_views(folder: Path) -> list[Path]:
    """One instant of a take from all four cameras, brightened."""
    panels = []
    for name in read_rig(folder / "rig.json"):
        ((_, frame),) = _frames_at(folder / f"{name}.mp4", (STILLS_S[0],))
        bright = np.clip(frame.astype(np.float32) * 2.0, 0, 255).astype(np.uint8)
        panels.append(_labelled(bright[:, 200:-200], name))
    return [_save(_grid(panels, 2), "views.jpg", width=1200)]


def feature_points(_: Path) -> list[Path]:
    """The chart that names the feature points."""
    return [_save(feature_point_chart(built_in_head("average")), "feature_points.jpg", width=1800)]


def built_in_heads(_: Path) -> list[Path]:
    """All built-in heads."""
    panels = [_labelled(_portrait(built_in_head(name)), name) for name in BUILT_IN]
    return [_save(_grid(panels, 4), "heads.jpg", width=1400)]


def expressions(_: Path) -> list[Path]:
    """What single groups of FAPs do to a head."""
    head = built_in_head(HEAD)
    drive = HeadDrive(head)
    renderer, camera = HeadRenderer(head), portrait_camera(head, (420, 460))
    panels = []
    for name, moves in EXPRESSIONS.items():
        animation = drive.animate(_clip(head, moves))
        pose = Rigid(animation.motion.quaternion[0], animation.motion.translation[0])
        panels.append(_labelled(renderer.render(animation.vertices(0), camera, pose), name))
    return [_save(_grid(panels, 4), "expressions.jpg", width=1400)]


def marker_placement(_: Path) -> list[Path]:
    """Where the ready marker set's dots are glued, with their labels."""
    head, markers = built_in_head("average"), ready_marker_set()
    at = glue_markers(head, markers).at(head.mesh.vertices)
    camera = portrait_camera(head, (1140, 960))
    picture = Image.fromarray(HeadRenderer(head).render(head.mesh.vertices, camera))
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(15)
    pixels = camera.project(at)
    is_left = pixels[:, 0] < pixels[:, 0].mean() - 2
    for rows, x in ((np.flatnonzero(is_left), 20), (np.flatnonzero(~is_left), 960)):
        rows = rows[np.argsort(pixels[rows, 1])]
        for i, y in zip(rows, _apart(pixels[rows, 1], 27.0, 930.0), strict=True):
            marker = markers.markers[i]
            text = f"{marker.label}  {marker.feature_point}"
            end = x - 8 if x > 500 else x + draw.textlength(text, font=font) + 8
            draw.line([(end, y), tuple(pixels[i])], fill=(160, 160, 160), width=1)
            draw.text((x, y - 9), text, font=font, fill=(245, 245, 245))
    for x, y in pixels:
        draw.ellipse([x - 6, y - 6, x + 6, y + 6], fill=(255, 255, 255), outline=(40, 40, 40))
    return [_save(np.asarray(picture), "markers.jpg", width=1140)]


def influence(_: Path) -> list[Path]:
    """How far single points move the skin: the paper's weights, and ours."""
    head = built_in_head(HEAD)
    rows = []
    for words, drive in (
        ("as printed", HeadDrive(head, smoothing=0.0, fade=False)),
        ("with fade and smoothing", HeadDrive(head)),
    ):
        panels = []
        points = drive.deformer.points
        for name, axis in INFLUENCES:
            moved = np.zeros((len(points), 3))
            moved[points.index(name), axis] = 1.0
            share = np.abs(drive.deformer.displace(moved)[:, axis])
            picture = _heat_map(head, share, points.at(head.mesh.vertices))
            panels.append(_labelled(picture, f"{name} along {'xyz'[axis]}, {words}"))
        rows.append(np.concatenate(panels, axis=1))
    return [_save(np.concatenate(rows), "influence.jpg", width=1200)]


def page(folder: Path) -> list[Path]:
    """The report in a browser; nothing where there is none."""
    chromium, driver_path = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver_path is None:
        print("page.jpg is left as it is: chromium and chromedriver are not installed")
        return []
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    with tempfile.TemporaryDirectory() as profile:
        for argument in (
            "--headless",
            "--no-sandbox",
            "--window-size=1440,1180",
            "--use-gl=angle",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            f"--user-data-dir={profile}",
        ):
            options.add_argument(argument)
        driver = webdriver.Chrome(options=options, service=Service(driver_path))
        try:
            driver.set_script_timeout(120)
            driver.get((folder / "report.html").resolve().as_uri())
            driver.execute_async_script("facewright.ready.then(arguments[arguments.length - 1])")
            driver.execute_script(f"facewright.seek({PAGE_S})")
            time.sleep(4)  # software drawing
            shot = Path(profile) / "page.png"
            driver.save_screenshot(str(shot))
            picture = np.asarray(Image.open(shot).convert("RGB"))
        finally:
            driver.quit()
    return [_save(picture, "page.jpg", width=1200)]


#: In the order of making; each takes the demo's folder and returns what it wrote.
MAKERS: Mapping[str, Callable[[Path], list[Path]]] = {
    "demo": demo_still,
    "animation": demo_animation,
    "views": camera_views,
    "feature_points": feature_points,
    "heads": built_in_heads,
    "expressions": expressions,
    "markers": marker_placement,
    "influence": influence,
    "page": page,
}


def _frames_at(video: Path, times_s: tuple[float, ...]) -> list[tuple[float, Picture]]:
    """The frames shown at some times (rising)."""
    found: list[tuple[float, Picture]] = []
    with closing(read_frames(video)) as frames:
        for frame in frames:
            if frame.time_s >= times_s[len(found)] - 1e-6:
                found.append((times_s[len(found)], np.array(frame.image)))
                if len(found) == len(times_s):
                    return found
    raise SystemExit(f"{video} ends before {times_s[len(found)]} s: was the demo cut short?")


def _clip(head: Head, moves: Mapping[str, float]) -> Clip:
    """One frame of FAPs from millimetres, and degrees for rotations."""
    values = []
    for name, amount in moves.items():
        fap = fap_by_name()[name]
        size = np.deg2rad(amount) if fap.is_rotation else amount
        values.append(size / head.fapu.unit(fap))
    return Clip(np.zeros(1), tuple(moves), np.array([values]))


def _portrait(head: Head) -> Picture:
    return HeadRenderer(head).render(head.mesh.vertices, portrait_camera(head, (420, 480)))


def _heat_map(head: Head, share: NDArray[np.float64], points: NDArray[np.float64]) -> Picture:
    """The face from the front: grey where nothing moves, to red where all does; points as dots."""
    width, height, per_mm, top = 400, 470, 2.4, 72.0
    skin = head.mesh.triangles[head.mesh.groups["skin"]]
    v = head.mesh.vertices
    scene = RayScene(v, skin)
    x, y = np.meshgrid(
        (np.arange(width) - width / 2 + 0.5) / per_mm, top - np.arange(height) / per_mm
    )
    origins = np.stack([x.ravel(), y.ravel(), np.full(x.size, 500.0)], axis=1)
    _, triangle, uv = scene.cast(origins, np.tile([0.0, 0.0, -1.0], (x.size, 1)))
    is_hit = triangle != NO_HIT
    corners = skin[np.where(is_hit, triangle, 0)]
    b = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
    s = np.clip(np.einsum("nc,nc->n", b, share[corners]), 0, 1)[:, None]
    light = np.einsum("nc,ncx->nx", b, vertex_normals(v, skin)[corners]) @ (0.35, 0.45, 0.82)
    colour = (1 - s) * np.array([205.0, 205.0, 205.0]) + s * np.array([220.0, 40.0, 20.0])
    lines = (np.abs((s * 10) % 1 - 0.5) > 0.44) & (s > 0.02)  # at tenths
    colour = np.where(lines, 0.6 * colour, colour) * np.clip(0.3 + 0.7 * light, 0, 1)[:, None]
    found = np.where(is_hit[:, None], colour, 28.0).reshape(height, width, 3)
    picture = Image.fromarray(np.clip(found, 0, 255).astype(np.uint8))
    draw = ImageDraw.Draw(picture)
    seen_z = (
        500.0
        - scene.cast(
            np.column_stack([points[:, :2], np.full(len(points), 500.0)]),
            np.tile([0.0, 0.0, -1.0], (len(points), 1)),
        )[0]
    )
    for p, z in zip(points, seen_z, strict=True):
        if p[2] > z - 2.0:
            px, py = p[0] * per_mm + width / 2, (top - p[1]) * per_mm
            draw.ellipse([px - 2, py - 2, px + 2, py + 2], fill=(20, 60, 120))
    return np.asarray(picture)


def _apart(wanted: NDArray[np.float64], gap: float, end: float) -> NDArray[np.float64]:
    """Rising numbers near the wanted ones, at least a gap apart and not beyond the end."""
    found = np.array(wanted)
    for i in range(1, len(found)):
        found[i] = max(found[i], found[i - 1] + gap)
    found[-1] = min(found[-1], end)
    for i in range(len(found) - 2, -1, -1):
        found[i] = min(found[i], found[i + 1] - gap)
    return found


def _labelled(picture: Picture, text: str) -> Picture:
    found = Image.fromarray(np.ascontiguousarray(picture))
    size = max(18, picture.shape[1] // 24)
    ImageDraw.Draw(found).text(
        (size * 0.6, picture.shape[0] - size * 1.7),
        text,
        font=ImageFont.load_default(size),
        fill=(245, 245, 245),
        stroke_width=max(1, size // 10),
        stroke_fill=(20, 20, 20),
    )
    return np.asarray(found)


def _grid(panels: list[Picture], columns: int) -> Picture:
    rows = [np.concatenate(panels[i : i + columns], axis=1) for i in range(0, len(panels), columns)]
    return np.concatenate(rows)


def _save(picture: Picture, name: str, *, width: int) -> Path:
    found = Image.fromarray(np.ascontiguousarray(picture))
    if found.width > width:
        height = round(found.height * width / found.width)
        found = found.resize((width, height), Image.Resampling.LANCZOS)
    path = PICTURES / name
    found.save(path, quality=85, optimize=True, progressive=True)
    return path


def main() -> None:
    """Make the pictures that are asked for."""
    parser = argparse.ArgumentParser(description="Make the documentation's pictures.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(MAKERS))
    parser.add_argument("--demo", type=Path, help="folder of `facewright demo` with seed 0")
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in MAKERS]
    if unknown:
        sys.exit(f"no picture {', '.join(unknown)}; there are {', '.join(MAKERS)}")
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        if options.demo is None:
            demo(out=Path(folder) / "demo")
        for name in options.names or MAKERS:
            for path in MAKERS[name](options.demo or Path(folder) / "demo"):
                print(f"{path.relative_to(PICTURES.parent)}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
