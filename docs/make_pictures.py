"""Makes every picture of the documentation with the project's own code.

    python docs/make_pictures.py [--demo DIR] [NAME ...]

NAME chooses single pictures. Some show the results of a demo: without ``--demo`` one is run first,
into a temporary folder (some minutes). The picture of the page needs Chromium, its driver and the
package selenium; without them it is left as it is, and that is said.
"""

from __future__ import annotations

import argparse
import colorsys
import shutil
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from facewright.capture import (
    BoardView,
    LensCalibration,
    calibrate_board,
    calibrate_rig,
    detect_board,
    point_sd_mm,
    tsai,
)
from facewright.cli.animate_plain import PlainOptions, run_plain
from facewright.cli.calibration_plots import cameras_in_space, residual_field, uncertainty_map
from facewright.cli.demo import demo
from facewright.cli.drawing import Drawing
from facewright.cli.track import track
from facewright.core.boards import Board, parse_board
from facewright.core.clip import Clip
from facewright.core.formats.ply import PlyMesh, write_ply
from facewright.core.formats.rig_json import read_rig
from facewright.core.mesh import Mesh, vertex_normals
from facewright.core.mpeg4 import fap_by_name
from facewright.core.rigid import Rigid
from facewright.core.video import read_frames
from facewright.datasets_synthetic.boards import board_truth, board_views, make_board_shots
from facewright.datasets_synthetic.face_motion import FaceMotion
from facewright.datasets_synthetic.film import film_take
from facewright.datasets_synthetic.film_views import open_views
from facewright.datasets_synthetic.foreign_heads import foreign_head
from facewright.datasets_synthetic.photo_pictures import Photographer
from facewright.datasets_synthetic.photo_points import mark_points, visible_points
from facewright.datasets_synthetic.photos import PhotoSettings, plan_photos
from facewright.datasets_synthetic.scan_meshes import scan_mesh
from facewright.datasets_synthetic.scan_target import ScanTarget
from facewright.datasets_synthetic.scans import scan_cylinder
from facewright.datasets_synthetic.take_settings import TROUBLES, settings_for, settings_with
from facewright.datasets_synthetic.takes import make_take
from facewright.datasets_synthetic.voices import make_voice
from facewright.heads.bones import make_bones
from facewright.heads.catalogue import BUILT_IN, built_in_head
from facewright.heads.chart import feature_point_chart, marker_chart
from facewright.heads.expressions import EXPRESSIONS as BASIC_EXPRESSIONS
from facewright.heads.expressions import expression_weights, viseme_weights
from facewright.heads.head import Head
from facewright.heads.identity import make_head, random_identity
from facewright.heads.marker_sets import ready_marker_set
from facewright.heads.own_head import read_own_head
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
#: Visemes that are shown, with a sound of each.
VISEMES = {"PP": "p", "FF": "f", "CH": "sh", "aa": "ah", "oh": "aw", "ou": "oo"}
BOARDS = ("chessboard:9x6:25", "charuco:8x5:30:22:DICT_5X5_100", "circles:4x11:20:asymmetric")
SENTENCE = "the baby is in the green house"


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
    return [_save(_grid(panels, 5), "heads.jpg", width=1400)]


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


def markerless(_: Path) -> list[Path]:
    """A plain take: the actor, the landmarks that were followed, another head doing the same."""
    settings = settings_with(settings_for("plain"), {"seconds": 4.0})
    with tempfile.TemporaryDirectory() as folder:
        take = film_take(make_take(601, settings), Path(folder))
        video, out = take.videos[0], Path(folder) / "out"
        video = video.rename(video.with_name("actor.mp4"))  # its camera is not known then
        out.mkdir()
        run_plain([video], None, out, PlainOptions(head=HEAD))
        stills = [picture for _, picture in _frames_at(out / "preview.mp4", (0.9, 2.0, 3.2))]
    return [_save(np.concatenate(stills), "markerless.webp", width=1200)]


def own_heads(_: Path) -> list[Path]:
    """A head of other topology, unit and axes: what is found on it, and how it moves."""
    rng = np.random.default_rng(6)
    person = make_head(random_identity(rng, "somebody"), texture_px=256)
    foreign = foreign_head(person, rng, unit_mm=10.0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "somebody.ply"
        write_ply(path, PlyMesh(Mesh(foreign.vertices, foreign.triangles)), double=True)
        head = read_own_head(path).head
    drive = HeadDrive(head)
    renderer, camera = HeadRenderer(head), portrait_camera(head, (420, 460))
    panels = []
    for name in ("neutral", "smile", "open jaw", "lids closed"):
        animation = drive.animate(_clip(head, EXPRESSIONS[name]))
        panels.append(_labelled(renderer.render(animation.vertices(0), camera), name))
    return [
        _save(feature_point_chart(head), "own_head_chart.webp", width=1400),
        _save(_grid(panels, 4), "own_head_poses.webp", width=1400),
    ]


def marker_placement(_: Path) -> list[Path]:
    """Where the markers of the 53 set are glued, with their labels."""
    chart = marker_chart(built_in_head(HEAD), ready_marker_set("full53"))
    return [_save(chart, "marker_chart.webp", width=1400)]


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
    picture = _screenshot(folder / "report.html", (1440, 1180))
    return [] if picture is None else [_save(picture, "page.jpg", width=1200)]


def cleaning_report(folder: Path) -> list[Path]:
    """What `facewright track --report` shows of the demo's take."""
    videos = sorted(folder.glob("cam*.mp4"))
    with tempfile.TemporaryDirectory() as scratch:
        report = Path(scratch) / "cleaning.html"
        track(videos, out=Path(scratch) / "markers.c3d", report=report)
        picture = _screenshot(report, (1600, 1500))
    return [] if picture is None else [_save(picture, "cleaning_report.webp", width=1200)]


def _screenshot(html: Path, size: tuple[int, int]) -> Picture | None:
    """A page of ours in a browser, some seconds into it; None where there is no browser."""
    chromium, driver_path = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver_path is None:
        print(f"no picture of {html.name}: chromium and chromedriver are not installed")
        return None
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    with tempfile.TemporaryDirectory() as profile:
        for argument in (
            "--headless",
            "--no-sandbox",
            f"--window-size={size[0]},{size[1]}",
            "--use-gl=angle",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            f"--user-data-dir={profile}",
        ):
            options.add_argument(argument)
        driver = webdriver.Chrome(options=options, service=Service(driver_path))
        try:
            driver.set_script_timeout(120)
            driver.get(html.resolve().as_uri())
            driver.execute_async_script("facewright.ready.then(arguments[arguments.length - 1])")
            driver.execute_script(f"facewright.seek({PAGE_S})")
            time.sleep(4)  # software drawing
            shot = Path(profile) / "page.png"
            driver.save_screenshot(str(shot))
            return np.asarray(Image.open(shot).convert("RGB"))
        finally:
            driver.quit()


def people(_: Path) -> list[Path]:
    """Thirty people drawn by chance, seeds 0 to 29 of `facewright synth head --age 6-85`."""
    panels = []
    for seed in range(30):
        rng = np.random.default_rng([seed, 1])
        someone = random_identity(rng, f"person-{seed}", age_years=(6.0, 85.0))
        head = make_head(someone)
        camera = portrait_camera(head, (300, 345))
        picture = HeadRenderer(head).render(head.mesh.vertices, camera)
        panels.append(_labelled(picture, f"{someone.age_years:.0f}"))
    return [_save(_grid(panels, 6), "people.jpg", width=1200)]


def acting(_: Path) -> list[Path]:
    """MPEG-4's six expressions and six of its visemes, as synthetic actors make them."""
    head = built_in_head("maya")
    motion, renderer = FaceMotion(head), HeadRenderer(head)
    camera = portrait_camera(head, (360, 400))
    shown = {name: expression_weights(name) for name in BASIC_EXPRESSIONS}
    shown |= {f"/{sound}/": viseme_weights(name) for name, sound in VISEMES.items()}
    panels = []
    for name, by_shape in shown.items():
        weights = np.array([by_shape.get(shape, 0.0) for shape in head.shape_names])
        panels.append(_labelled(renderer.render(motion.vertices(weights), camera), name))
    return [_save(_grid(panels, 6), "acting.jpg", width=1400)]


def take_frames(_: Path) -> list[Path]:
    """What cameras see of takes: plain ones, spheres and dots, in trouble."""
    plain = [
        _film_frame("plain", 3, 0.8),
        _film_frame("plain", 14, 1.6, troubles=("hand",)),
    ]
    marked = [
        _film_frame("markers", 7, 1.4, look="spheres", brighter=2.0),
        _film_frame(
            "markers", 3, 1.2, look="dots", troubles=("blur", "hand", "clutter"), brighter=2.0
        ),
    ]
    return [
        _save(_grid(plain, 2), "plain_takes.jpg", width=1200),
        _save(_grid(marked, 2), "marker_takes.jpg", width=1200),
    ]


def boards(_: Path) -> list[Path]:
    """Shots of the three kinds of calibration boards."""
    panels = []
    for seed, name in enumerate(BOARDS, start=2):
        shots = make_board_shots(parse_board(name), seed, n_views=1, image_size=(960, 720))
        (grey,) = board_views(shots, shots.rig.names[0])
        panels.append(np.repeat(grey[:, :, None], 3, axis=2))
    return [_save(_grid(panels, 3), "boards.jpg", width=1200)]


def photographs(_: Path) -> list[Path]:
    """The photographs of one session."""
    session = plan_photos(built_in_head("mei"), PhotoSettings(size=(760, 502)), 3)
    photographer = Photographer(session)
    panels = [photographer.take(shot) for shot in session.shots]
    return [_save(_grid(panels, 2), "photos.jpg", width=1200)]


def scans(_: Path) -> list[Path]:
    """A cylindrical scan's range and colour, and a mesh by structured light."""
    target = ScanTarget(built_in_head("kofi"), 1)
    cylinder = scan_cylinder(target, 1)
    r = cylinder.range_mm
    low, high = np.nanpercentile(r, (1, 99))
    grey = 40 + 215 * np.clip((r - low) / (high - low), 0, 1)
    shown = np.repeat(np.nan_to_num(grey)[:, :, None], 3, axis=2)
    shown[np.isnan(r)] = (24, 40, 92)
    made = scan_mesh(target, 1, triangles=60_000)
    back = made.scan_from_head.inverse()
    mesh = Mesh(back.apply(made.mesh.vertices), made.mesh.triangles)
    panels = [
        _labelled(shown.astype(np.uint8), "range, voids in blue"),
        _labelled(np.asarray(cylinder.colour), "colour"),
        _labelled(_relief(mesh, made.colour, yaw_deg=28.0), "mesh"),
    ]
    return [_save(_grid(panels, 3), "scans.jpg", width=1200)]


def bones_picture(_: Path) -> list[Path]:
    """Skull and mandible in half a head, from the front and from the side."""
    head = built_in_head("ruth")
    bones = make_bones(head)
    v, triangles = head.mesh.vertices, head.mesh.triangles
    kept = np.concatenate([head.mesh.groups[n] for n in ("skin", "eye_left", "eye_right")])
    is_right = v[triangles[kept]].mean(axis=1)[:, 0] < 0
    parts = [
        (Mesh(v, triangles[kept[is_right]]), (226, 176, 152)),
        (bones.skull, (236, 226, 200)),
        (bones.mandible, (206, 214, 226)),
    ]
    rows = np.cumsum([0, *(len(mesh.vertices) for mesh, _ in parts)])
    joined = Mesh(
        np.concatenate([mesh.vertices for mesh, _ in parts]),
        np.concatenate([m.triangles + np.int32(r) for (m, _), r in zip(parts, rows, strict=False)]),
    )
    colour = np.concatenate(
        [np.tile(np.array(c, np.uint8), (len(m.vertices), 1)) for m, c in parts]
    )
    panels = [_relief(joined, colour, yaw_deg=yaw) for yaw in (0.0, 45.0, 90.0)]
    return [_save(_grid(panels, 3), "bones.jpg", width=1200)]


def spectrogram(_: Path) -> list[Path]:
    """A synthetic voice: its spectrogram with the true formants and phones over it."""
    voice = make_voice(5, talker="man", text=SENTENCE)
    rate, sound, truth = voice.audio.rate_hz, voice.audio.samples, voice.truth
    top_hz, hop, n = 5000.0, rate // 250, 1024
    window = np.hanning(rate // 125)  # 8 ms: broad bands, in which formants show
    starts = np.arange(0, len(sound) - len(window), hop)
    frames = np.stack([sound[i : i + len(window)] for i in starts]) * window
    level = 20 * np.log10(np.abs(np.fft.rfft(frames, n)) + 1e-6)[:, : round(top_hz / rate * n)]
    shade = np.clip((level.max() - level) / 65, 0, 1)
    width, height, strip = 1200, 420, 34
    picture = Image.fromarray(np.uint8(255 * shade.T[::-1])).convert("RGB").resize((width, height))
    page = Image.new("RGB", (width, height + strip), (255, 255, 255))
    page.paste(picture)
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(16)
    seconds = len(sound) / rate
    assert truth.formants_hz is not None
    for row in range(0, len(truth.time_s), 4):
        for k in range(4):
            hz = truth.formants_hz[row, k]
            if np.isfinite(hz):
                x, y = truth.time_s[row] / seconds * width, height * (1 - hz / top_hz)
                draw.ellipse([x - 2, y - 2, x + 2, y + 2], fill=(214, 40, 40))
    for phone, start, end in zip(
        truth.phones.phones, truth.phones.start_s, truth.phones.end_s, strict=True
    ):
        x0, x1 = start / seconds * width, end / seconds * width
        draw.line([(x0, 0), (x0, height + strip)], fill=(90, 130, 190), width=1)
        draw.text(((x0 + x1) / 2, height + 8), phone, font=font, fill=(20, 20, 20), anchor="ma")
    return [_save(np.asarray(page), "voice.jpg", width=width)]


# --- calibration ----------------------------------------------------------------------------


def calibration_boards(_: Path) -> list[Path]:
    """A board found, its corners in their order; and one that was refused, with the reason."""
    board = parse_board(BOARDS[0])
    (tilted,) = board_views(make_board_shots(board, 5, n_views=1, image_size=(960, 720)), "cam0")
    found = detect_board(tilted, board)
    assert found.view is not None, found.reason
    drawn = _with_order(tilted, found.view, board)
    left = round(float(np.percentile(found.view.pixels[:, 0], 45)))
    cut = np.ascontiguousarray(tilted[:, left:])
    refused = detect_board(cut, board)
    assert refused.reason is not None
    sheet = np.full_like(tilted, 255)
    sheet[:, left:] = cut
    told = Image.fromarray(np.repeat(sheet[:, :, None], 3, axis=2))
    words = "\n".join(textwrap.wrap(refused.reason, 26))
    ImageDraw.Draw(told).text(
        (30, 40), words, fill=(29, 39, 51), font=ImageFont.load_default(30), spacing=10
    )
    return [_save(_grid([drawn, np.asarray(told)], 2), "calibration_boards.webp", width=1200)]


def calibration_residuals(_: Path) -> list[Path]:
    """The same views through a lens model that lacks distortion, and through one that has it."""
    views, size = _board_views(5, 12, poor=False)
    drawings = [
        residual_field(f"{words}: RMS {found.rms_used_px:.2g} px", size,
                       np.concatenate([v.pixels for v in found.views]),
                       np.concatenate(found.residuals)).image()
        for words, found in (
            ("without distortion", calibrate_board(views, size, model="none")),
            ("with the model that was chosen", calibrate_board(views, size)),
        )
    ]  # fmt: skip
    return [_save(_grid(drawings, 2), "calibration_residuals.png", width=1240)]


def calibration_uncertainty(_: Path) -> list[Path]:
    """What two ways of shooting leave unsure at the face."""
    drawings = []
    for words, count, poor in (("5 frontal views", 5, True), ("12 tilted views", 12, False)):
        views, size = _board_views(5, count, poor=poor)
        found = calibrate_board(views, size)
        drawings.append(_lens_map(f"{words}: RMS {found.rms_used_px:.2g} px", found).image())
    return [_save(_grid(drawings, 2), "calibration_uncertainty.png", width=1240)]


def calibration_rig(_: Path) -> list[Path]:
    """A rig of four, and where the board was held."""
    board = parse_board(BOARDS[0])
    shots = make_board_shots(board, 2, n_cameras=4, n_views=12)
    truth, rng = board_truth(shots), np.random.default_rng(2)
    views = {
        name: [
            BoardView(f"view {v}", board.object_points(), p + rng.normal(0, 0.05, p.shape))
            for v, p in enumerate(truth["pixels"][c])
            if np.isfinite(p).all()
        ]
        for c, name in enumerate(shots.rig.names)
    }
    lenses = {
        name: calibrate_board(seen, shots.rig[name].image_size).camera
        for name, seen in views.items()
    }
    found = calibrate_rig(views, lenses)
    drawn = cameras_in_space("", found.rig, found.view_poses, board.object_points())
    return [_save(drawn.image(), "calibration_rig.png", width=1240)]


def calibration_photo(_: Path) -> list[Path]:
    """Points marked in a photograph, and what Tsai's method leaves of them, enlarged."""
    session = plan_photos(built_in_head("mei"), PhotoSettings(size=(1520, 1004)), 3)
    shot = session.shots[1]
    marked = mark_points(
        visible_points(session.head, shot.camera), session.head, session.settings,
        np.random.default_rng(8),
    )  # fmt: skip
    pixels = np.array(marked.on_photo)
    pixels[4] += (38.0, -24.0)  # somebody clicked on the wrong place
    found = tsai(marked.on_mesh, pixels, shot.camera.image_size)
    picture = Image.fromarray(Photographer(session).take(shot))
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(20)
    for name, pixel, off, is_used in zip(
        marked.names, pixels, found.residuals, found.is_used, strict=True
    ):
        colour = (40, 230, 120) if is_used else (255, 70, 50)
        x, y = pixel
        draw.line([(x, y), tuple(pixel - off * (15 if is_used else 1))], fill=colour, width=3)
        draw.ellipse([x - 5, y - 5, x + 5, y + 5], outline=colour, width=3)
        if not is_used:
            draw.text((x + 12, y - 12), f"{name}: {np.hypot(*off):.0f} px off", colour, font)
    middle = pixels.mean(axis=0).astype(int)
    low = np.maximum(middle - (480, 420), 0)
    crop = np.asarray(picture)[low[1] : low[1] + 840, low[0] : low[0] + 960]
    known = tsai(
        marked.on_mesh, pixels, shot.camera.image_size,
        camera=replace(shot.camera, camera_from_world=Rigid.identity()),
    )  # fmt: skip
    page = Image.fromarray(np.full((crop.shape[0], 520, 3), 255, np.uint8))
    pen, font = ImageDraw.Draw(page), ImageFont.load_default(24)
    y = 36
    for title, result in (("Camera unknown", found), ("Lens known", known)):
        used = f"{int(result.is_used.sum())} of {len(pixels)} points"
        pen.text((30, y), f"{title}: {result.rms_used_px:.2g} px, {used}", (29, 39, 51), font)
        for parameter in result.parameters:
            y += 36
            values = (parameter.name, f"{parameter.value:.5g}", f"± {parameter.sd:.2g}")
            for x, text in zip((40, 110, 240), (*values[:2], f"{values[2]} {parameter.unit}"),
                               strict=True):  # fmt: skip
                pen.text((x, y), text, (29, 39, 51), font)
        y += 64
    return [_save(np.hstack([crop, np.asarray(page)]), "calibration_photo.webp", width=1200)]


def _board_views(seed: int, count: int, *, poor: bool) -> tuple[list[BoardView], tuple[int, int]]:
    """What a detector sees to 0.05 px, and the picture's size."""
    board = parse_board(BOARDS[0])
    shots = make_board_shots(board, seed, n_views=count, poor=poor)
    rng = np.random.default_rng(seed)
    views = [
        BoardView(f"view {v}", board.object_points(), p + rng.normal(0, 0.05, p.shape))
        for v, p in enumerate(board_truth(shots)["pixels"][0])
    ]
    return views, shots.rig[shots.rig.names[0]].image_size


def _lens_map(title: str, found: LensCalibration) -> Drawing:
    """A lens's uncertainty at 750 mm over the picture."""
    w, h = found.camera.image_size
    rows, columns = 8, 12
    x, y = np.meshgrid((np.arange(columns) + 0.5) / columns * w, (np.arange(rows) + 0.5) / rows * h)
    mm = point_sd_mm(found, np.stack([x, y], axis=2) - 0.5, 750.0)
    pixels = np.concatenate([v.pixels for v in found.views])
    return uncertainty_map(title, (w, h), mm, pixels, "standard deviation at 750 mm")


def _with_order(grey: Picture, view: BoardView, board: Board) -> Picture:
    """Corners joined in their order: red to violet, the first one ringed."""
    picture = Image.fromarray(np.repeat(grey[:, :, None], 3, axis=2))
    draw = ImageDraw.Draw(picture)
    row = np.rint(view.points[:, 1] / board.square_mm).astype(int)
    last = int(row.max()) or 1
    for i, (x, y) in enumerate(view.pixels):
        colour = tuple(
            round(255 * c) for c in colorsys.hsv_to_rgb(0.75 * float(row[i]) / last, 0.9, 1)
        )
        if i + 1 < len(view.pixels):
            width = 3 if row[i + 1] == row[i] else 1
            draw.line([(x, y), tuple(view.pixels[i + 1])], fill=colour, width=width)
        draw.ellipse([x - 5, y - 5, x + 5, y + 5], outline=colour, width=3)
    x, y = view.pixels[0]
    draw.ellipse([x - 14, y - 14, x + 14, y + 14], outline=(255, 40, 40), width=4)
    return np.asarray(picture)


#: In the order of making; each takes the demo's folder and returns what it wrote.
MAKERS: Mapping[str, Callable[[Path], list[Path]]] = {
    "demo": demo_still,
    "animation": demo_animation,
    "views": camera_views,
    "feature_points": feature_points,
    "heads": built_in_heads,
    "expressions": expressions,
    "markerless": markerless,
    "own_heads": own_heads,
    "markers": marker_placement,
    "cleaning": cleaning_report,
    "influence": influence,
    "people": people,
    "acting": acting,
    "takes": take_frames,
    "boards": boards,
    "photos": photographs,
    "scans": scans,
    "bones": bones_picture,
    "voice": spectrogram,
    "calibration_boards": calibration_boards,
    "calibration_residuals": calibration_residuals,
    "calibration_uncertainty": calibration_uncertainty,
    "calibration_rig": calibration_rig,
    "calibration_photo": calibration_photo,
    "page": page,
}
#: Those that show results of the demo.
OF_DEMO = ("demo", "animation", "views", "page", "cleaning")


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


def _film_frame(
    kind: str,
    seed: int,
    time_s: float,
    *,
    look: str = "dots",
    troubles: tuple[str, ...] = (),
    brighter: float = 1.0,
) -> Picture:
    """One frame of a take by one camera, as it leaves the sensor."""
    changes = {"seconds": 4.0, "cameras.count": 1}
    for word in troubles:
        changes |= TROUBLES[word]
    take = make_take(seed, settings_with(settings_for(kind, look), changes))
    name = take.rig.names[0]
    image = open_views(take).film(name, time_s, np.random.default_rng(seed)).image
    bright = np.clip(image.astype(np.float32) * brighter, 0, 255).astype(np.uint8)
    return bright if bright.ndim == 3 else np.repeat(bright[:, :, None], 3, axis=2)


def _relief(mesh: Mesh, colour: NDArray[np.uint8], *, yaw_deg: float) -> Picture:
    """A mesh of the head frame in its vertices' colours, from far away; yaw to the left."""
    size, per_mm = 512, 1.72
    yaw = np.deg2rad(yaw_deg)
    right, away = np.array([np.cos(yaw), 0, -np.sin(yaw)]), np.array([np.sin(yaw), 0, np.cos(yaw)])
    y, x = ((size / 2 - 0.5 - np.mgrid[0:size, 0:size]) / per_mm).reshape(2, -1)
    aim = np.array([0.0, -18.0, -55.0])
    origins = aim + 900 * away - x[:, None] * right + (0, 1, 0) * y[:, None]
    scene = RayScene(mesh.vertices, mesh.triangles)
    _, triangle, uv = scene.cast(origins, np.tile(-away, (len(x), 1)))
    is_hit = triangle != NO_HIT
    corners = mesh.triangles[np.where(is_hit, triangle, 0)]
    b = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
    normal = np.einsum("nc,ncx->nx", b, vertex_normals(mesh.vertices, mesh.triangles)[corners])
    light = np.abs(normal @ (0.5 * away - 0.45 * right + (0.0, 0.6, 0.0)))
    flat = np.einsum("nc,ncx->nx", b, colour[corners].astype(np.float64))
    found = np.where(is_hit[:, None], flat * (0.4 + 0.85 * light[:, None]), 28.0)
    return np.clip(found, 0, 255).astype(np.uint8).reshape(size, size, 3)


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
        names = options.names or list(MAKERS)
        if options.demo is None and set(names) & set(OF_DEMO):
            demo(out=Path(folder) / "demo")
        for name in names:
            for path in MAKERS[name](options.demo or Path(folder) / "demo"):
                print(f"{path.relative_to(PICTURES.parent)}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
