"""The page: what is inside it, and what a browser makes of it."""

from __future__ import annotations

import base64
import gzip
import hashlib
import html.parser
import io
import json
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image

from facewright.cli import page as page_module
from facewright.cli import page_html
from facewright.cli.page import PageCurves, PageModel, PageSound, PageTable, PageVideo, write_page
from facewright.cli.page_channels import REGIONS, channel_entries, region_of, shown_first
from facewright.core.audio import Audio
from facewright.core.clip import Clip
from facewright.core.errors import FileFormatError, InputError
from facewright.core.formats.gltf import (
    GltfPart,
    GltfScene,
    MorphTarget,
    glb_bytes,
    scene_from_glb,
)
from facewright.core.mpeg4 import fap_channels

RATE_HZ = 25
N_FRAMES = 50
TIMES = np.arange(N_FRAMES) / RATE_HZ


def head_glb(name: str = "head") -> bytes:
    """A ball that grows a long chin, and turns."""
    polar, turn = np.meshgrid(
        np.linspace(0, np.pi, 17), np.linspace(0, 2 * np.pi, 33), indexing="ij"
    )
    ball = np.stack(
        [np.sin(polar) * np.sin(turn), np.cos(polar), np.sin(polar) * np.cos(turn)], axis=-1
    ).reshape(-1, 3)
    corner = (np.arange(16)[:, None] * 33 + np.arange(32)).ravel()
    quads = np.stack([corner, corner + 33, corner + 1, corner + 34], axis=1)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [2, 1, 3]]]).astype(np.int32)
    rows = np.flatnonzero(ball[:, 1] < -0.3).astype(np.int32)
    jaw = MorphTarget("jawOpen", rows, np.tile((0.0, -24.0, 0.0), (len(rows), 1)))
    angles = 0.3 * np.sin(2 * TIMES)
    part = GltfPart(
        name,
        ball * 90,
        triangles,
        ball,
        base_color=np.array([0.7, 0.45, 0.35, 1.0]),
        targets=(jaw,),
        weights=0.5 - 0.5 * np.cos(np.pi * TIMES)[:, None],
        rotation=np.stack([np.cos(angles), 0 * angles, np.sin(angles), 0 * angles], axis=1),
    )
    return glb_bytes(GltfScene(name, (part,), TIMES))


def video_mp4(*, has_sound: bool = False) -> bytes:
    """Frame i has the grey level 16 + 4 i all over; the sound is a tone."""
    out = io.BytesIO()
    with av.open(out, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=RATE_HZ)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        sound = container.add_stream("aac", rate=48000, layout="mono") if has_sound else None
        for i in range(N_FRAMES):
            grey = np.full((96, 128, 3), 16 + 4 * i, np.uint8)
            frame = av.VideoFrame.from_ndarray(grey, format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
        if sound is not None:
            for i in range(94):
                tone = 0.2 * np.sin(0.02 * (1024 * i + np.arange(1024, dtype=np.float32)))
                block = av.AudioFrame.from_ndarray(tone[None], format="fltp", layout="mono")
                block.sample_rate, block.pts = 48000, 1024 * i
                container.mux(sound.encode(block))
            container.mux(sound.encode(None))
    return out.getvalue()


def fap_clip(n_frames: int = N_FRAMES) -> Clip:
    channels = fap_channels()
    time_s = np.arange(n_frames) / RATE_HZ
    values = np.full((n_frames, len(channels)), np.nan)
    values[:, channels.index("open_jaw")] = 400 * np.sin(3 * time_s)
    values[:, channels.index("head_yaw")] = 20000 * np.sin(time_s)
    values[:, channels.index("raise_l_i_eyebrow")] = 50.0
    values[10:20, channels.index("raise_l_i_eyebrow")] = np.nan
    return Clip(time_s, channels, values)


class Blocks(html.parser.HTMLParser):
    """Tags, and the text of every script by its id."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: dict[str, str] = {}
        self.modules: list[str] = []
        self.rest = ""
        self._inside: str | None = None
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        self.tags.append((tag, attributes))
        if tag == "script":
            self._inside = attributes.get("id") or ""

    def handle_endtag(self, tag: str) -> None:
        if tag == "script":
            self._inside = None

    def handle_data(self, data: str) -> None:
        if self._inside is None:
            self.rest += data
        elif self._inside:
            self.scripts[self._inside] = self.scripts.get(self._inside, "") + data
        else:
            self.modules.append(data)


def unpacked(blocks: Blocks, name: str) -> bytes:
    return gzip.decompress(base64.b64decode(blocks.scripts[name]))


def page_text(tmp_path: Path, **parts: Any) -> str:
    path = tmp_path / "page.html"
    write_page(path, **{"title": "take", **parts})
    return path.read_text(encoding="utf-8")


# without a browser


def test_nothing_on_the_page_can_reach_a_network(tmp_path: Path) -> None:
    text = page_text(
        tmp_path,
        models=[PageModel("head", head_glb())],
        videos=[PageVideo("cam", video_mp4())],
        curves=fap_clip(),
    )

    blocks = Blocks(text)
    policy = next(a["content"] for t, a in blocks.tags if a.get("http-equiv"))
    assert policy is not None
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert {source for rule in rules.values() for source in rule.split()} <= {
        "'none'",
        "'unsafe-inline'",
        "'wasm-unsafe-eval'",
        "data:",
        "blob:",
        *(source for source in rules["script-src"].split() if source.startswith("'sha256-")),
    }
    assert "unsafe" not in rules["script-src"].replace("'wasm-unsafe-eval'", "")
    sources = {(t, k): v for t, a in blocks.tags for k, v in a.items() if k in ("src", "href")}
    assert sources == {("link", "href"): "data:,"}
    own = "\n".join(
        (Path(page_module.__file__).parent / "data" / name).read_text()
        for name in ("page.html", "page.css", *page_html._SCRIPTS)
    )
    assert (
        re.findall(
            r"(?:https?:|wss?://)|@import|url\(", own.replace("http://www.w3.org/2000/svg", "")
        )
        == []
    )
    assert "sourceMappingURL" not in text


def test_the_policy_names_the_scripts_as_they_are(tmp_path: Path) -> None:
    text = page_text(tmp_path, models=[PageModel("head", head_glb())])

    blocks = Blocks(text)
    policy = next(str(a["content"]) for t, a in blocks.tags if a.get("http-equiv"))
    modules = re.findall(r'<script type="module">(.*?)</script>', text, re.DOTALL)
    assert len(modules) == 2
    for module in modules:
        digest = base64.b64encode(hashlib.sha256(module.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy


def test_the_viewer_is_only_there_for_models(tmp_path: Path) -> None:
    with_model = page_text(tmp_path, models=[PageModel("head", head_glb())])
    without = page_text(tmp_path, curves=fap_clip())

    assert len(with_model) > 1_000_000
    assert len(without) < 100_000


def test_what_is_embedded_is_what_was_given(tmp_path: Path) -> None:
    glb, mp4, clip = head_glb(), video_mp4(), fap_clip()
    blocks = Blocks(
        page_text(tmp_path, models=[PageModel("a", glb)], videos=[PageVideo("b", mp4)], curves=clip)
    )

    config = json.loads(blocks.scripts["config"])
    assert unpacked(blocks, "model-0") == glb
    assert base64.b64decode(blocks.scripts["video-0"]) == mp4
    times = np.frombuffer(unpacked(blocks, "curves-0-times"), "<f8")
    values = np.frombuffer(unpacked(blocks, "curves-0-values"), "<f4")
    names = [channel["name"] for channel in config["clips"][0]["channels"]]
    assert names == ["open_jaw", "raise_l_i_eyebrow", "head_yaw"]  # those that are set at all
    assert (times == clip.time_s).all()
    expected = np.stack([clip[name] for name in names]).astype("f4")
    assert np.array_equal(values.reshape(3, -1), expected, equal_nan=True)


def test_long_curves_stay_compact(tmp_path: Path) -> None:
    """Ten minutes at 60 Hz, all FAPs: 4 bytes a value, a third more for base64."""
    n_frames = 36_000
    values = np.zeros((n_frames, len(fap_channels())))
    clip = Clip(np.arange(n_frames) / 60, fap_channels(), values)

    size = len(page_text(tmp_path, curves=clip))

    assert size < 4 / 3 * (4 * values.size + 8 * n_frames) + 100_000


EVIL = (
    "</script><script>alert(1)</script ><!-- <script <img src=x onerror=alert(2)> "
    "\u2028 & \" ' {{data}}"
)


def test_hostile_texts_stay_texts(tmp_path: Path) -> None:
    text = page_text(
        tmp_path,
        title=EVIL,
        models=[PageModel(EVIL, head_glb())],
        videos=[PageVideo(EVIL, video_mp4())],
        curves=Clip(TIMES, (EVIL,), TIMES[:, None]),
        tables=[PageTable(EVIL, [EVIL], [[EVIL]])],
        notes=EVIL,
    )

    blocks = Blocks(text)
    config = json.loads(blocks.scripts["config"])
    assert config["models"][0]["label"] == config["videos"][0]["label"] == EVIL
    assert config["clips"][0]["channels"][0]["name"] == EVIL
    assert blocks.rest.count(EVIL) == 6  # title twice, caption, header, cell, notes
    scripts = [a for t, a in blocks.tags if t == "script"]
    assert [a.get("type") for a in scripts].count("module") == 2
    assert {a.get("type") for a in scripts} == {"module", "application/json", "text/plain"}
    assert not any(tag == "img" for tag, _ in blocks.tags)


def test_a_script_cannot_be_ended_from_within() -> None:
    script = page_html.inline('a = "</SCRIPT>" + "<!--" + "<script>";\n//# sourceMappingURL=x')

    assert re.search("<(/?script|!--)", script, re.IGNORECASE) is None
    assert script == r'a = "\x3c/SCRIPT>" + "\x3c!--" + "\x3cscript>";'


def test_tables_put_numbers_to_the_right(tmp_path: Path) -> None:
    table = PageTable("t", ["what", "value"], [["a", "1.5"], ["2", "−3e-4"], ["b", "—"]])

    text = page_text(tmp_path, tables=[table])

    assert text.count('<td class="number">') == 3
    assert '<th scope="col" class="number">value' in text
    with pytest.raises(ValueError, match="2 cells"):
        page_text(tmp_path, tables=[PageTable("t", ["a", "b"], [["1"]])])


def test_the_frame_rate_is_that_of_what_is_shown(tmp_path: Path) -> None:
    def rate(**parts: Any) -> Any:
        return json.loads(Blocks(page_text(tmp_path, **parts)).scripts["config"])["rate"]

    assert rate(videos=[PageVideo("v", video_mp4())]) == RATE_HZ
    assert rate(models=[PageModel("m", head_glb())]) == pytest.approx(RATE_HZ, rel=1e-4)
    assert rate() is None


@pytest.mark.parametrize(
    ("parts", "error", "message"),
    [
        ({"models": [PageModel("m", b"junk")]}, FileFormatError, "signature glTF"),
        ({"videos": [PageVideo("v", b"RIFF....AVI ")]}, InputError, "neither MP4 nor WebM"),
        ({"videos": [PageVideo("v", b"\0\0\0\x18ftypmp42" + bytes(64))]}, InputError, "read"),
    ],
)
def test_what_no_browser_could_show_is_refused_and_nothing_is_written(
    parts: dict[str, Any], error: type[Exception], message: str, tmp_path: Path
) -> None:
    with pytest.raises(error, match=message):
        page_text(tmp_path, **parts)

    assert list(tmp_path.iterdir()) == []


def test_what_is_too_large_for_a_browser_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_module, "MAX_ITEM_BYTES", 1000)

    with pytest.raises(InputError, match="make it shorter or smaller"):
        page_text(tmp_path, models=[PageModel("m", head_glb())])


def test_channels_have_regions_units_and_a_lively_first_choice() -> None:
    entries = {entry["name"]: entry for entry in channel_entries(fap_clip_all())}

    assert {entry["region"] for entry in entries.values()} == set(REGIONS) - {"Other"}
    assert entries["open_jaw"]["unit"] == "MNS/1024"
    assert entries["head_yaw"]["unit"] == "10⁻⁵ rad"
    assert entries["viseme.blend"]["unit"] == ""
    assert entries["open_jaw"]["title"] == "FAP 3, feature point 2.1"
    arkit = {
        "jawOpen": "Jaw",
        "mouthSmileLeft": "Lips",
        "eyeBlinkLeft": "Lids",
        "browDown_L": "Brows",
    }
    arkit |= {"eyeLookInLeft": "Eyes", "cheekPuff": "Cheeks", "noseSneerLeft": "Nose"}
    arkit |= {"tongueOut": "Tongue", "headYaw": "Head", "strange": "Other", "eyeWideLeft": "Lids"}
    assert {name: region_of(name) for name in arkit} == arkit
    shown = shown_first(list(entries.values()))
    regions = [list(entries.values())[i]["region"] for i in shown]
    assert 0 < len(shown) <= 5 and len(set(regions)) == len(regions)


def fap_clip_all() -> Clip:
    channels = fap_channels()
    values = np.outer(np.sin(TIMES), np.arange(1, len(channels) + 1))
    return Clip(TIMES, channels, values)


def test_nothing_lively_is_shown_where_nothing_moves() -> None:
    still = Clip(TIMES, ("open_jaw",), np.zeros((N_FRAMES, 1)))

    assert shown_first(channel_entries(still)) == []


# in a browser


class Browser:
    """A page in headless Chromium, driven through ``window.facewright``."""

    def __init__(self, driver: Any) -> None:
        self._driver = driver

    def load(self, path: Path) -> None:
        self._driver.get("about:blank")
        self._driver.get_log("browser")
        self._driver.get_log("performance")
        self._driver.get(path.resolve().as_uri())
        self.wait("facewright.ready")

    def wait(self, promise: str) -> Any:
        script = (
            "const done = arguments[0];"
            f"Promise.resolve({promise}).then((v) => done([v ?? null, null]),"
            "(error) => done([null, String(error)]));"
        )
        value, error = self._driver.execute_async_script(script)
        assert error is None, error
        return value

    def run(self, script: str) -> Any:
        return self._driver.execute_script(script)

    def press(self, key: str, shift: bool = False) -> None:
        options = json.dumps({"key": key, "shiftKey": shift, "bubbles": True, "cancelable": True})
        self.run(f"document.body.dispatchEvent(new KeyboardEvent('keydown', {options}))")
        self.wait("new Promise((done) => setTimeout(done, 300))")

    def seek(self, time_s: float) -> dict[str, Any]:
        state: dict[str, Any] = self.wait(
            f"facewright.seek({time_s}).then(() => facewright.state())"
        )
        return state

    def state(self) -> dict[str, Any]:
        state: dict[str, Any] = self.run("return facewright.state()")
        return state

    def picture(self, index: int = 0) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """What a model-viewer shows, (height, width, 4)."""
        url = self.run(f"return document.querySelectorAll('model-viewer')[{index}].toDataURL()")
        data = base64.b64decode(url.partition(",")[2])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))

    def grey(self) -> float:
        """The grey level in the middle of the video, as shown."""
        level = self.run(
            "const v = document.querySelector('video'), c = document.createElement('canvas');"
            "c.width = v.videoWidth; c.height = v.videoHeight;"
            "const pen = c.getContext('2d'); pen.drawImage(v, 0, 0);"
            "return pen.getImageData(64, 48, 1, 1).data[1];"
        )
        return float(level)

    def requests(self) -> set[str]:
        """Addresses that the page asked for, by the browser's own account."""
        events = [json.loads(e["message"])["message"] for e in self._driver.get_log("performance")]
        return {
            e["params"]["request"]["url"]
            for e in events
            if e["method"] == "Network.requestWillBeSent"
        }

    def errors(self) -> list[str]:
        return [e["message"] for e in self._driver.get_log("browser") if e["level"] == "SEVERE"]

    def screenshot(self) -> np.ndarray[Any, np.dtype[np.uint8]]:
        picture = Image.open(io.BytesIO(self._driver.get_screenshot_as_png()))
        return np.asarray(picture.convert("RGB"))


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    driver_path = shutil.which("chromedriver")
    if chromium is None or driver_path is None:
        pytest.skip("needs chromium and chromedriver, which are not installed")
    selenium = pytest.importorskip("selenium.webdriver", reason="needs the package selenium")
    from selenium.webdriver.chrome.service import Service

    options = selenium.ChromeOptions()
    options.binary_location = chromium
    with tempfile.TemporaryDirectory() as profile:
        for argument in (
            "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run "
            "--disable-background-networking --disable-component-update --disable-sync "
            "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader "
            "--autoplay-policy=no-user-gesture-required "
            f"--window-size=900,700 --user-data-dir={profile}"
        ).split():
            options.add_argument(argument)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        driver = selenium.Chrome(options=options, service=Service(driver_path))
        driver.set_script_timeout(90)
        try:
            yield Browser(driver)
        finally:
            driver.quit()


@pytest.fixture(scope="module")
def full_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "page.html"
    write_page(
        path,
        title="take",
        models=[PageModel("head", head_glb(), orbit="0deg 90deg 160%")],
        videos=[PageVideo("cam", video_mp4())],
        curves=fap_clip(),
        tables=[PageTable("t", ["a"], [["1"]])],
        notes="n",
    )
    return path


def test_seeking_shows_the_frame_of_that_time(browser: Browser, full_page: Path) -> None:
    browser.load(full_page)

    for frame in (0, 7, 31, 30, 49):
        state = browser.seek(float(TIMES[frame]))
        assert state["frame"] == frame
        assert not state["playing"]
        assert state["time"] == pytest.approx(TIMES[frame], abs=1e-9)
        assert state["modelTime"] == pytest.approx(TIMES[frame], abs=1e-3)
        assert state["videoTime"] == pytest.approx(TIMES[frame], abs=2e-3)
        assert browser.grey() == pytest.approx(16 + 4 * frame, abs=1.9)  # the next frame is 4 off


@pytest.mark.parametrize("has_curves", [True, False])
def test_the_frame_named_is_the_frame_shown(
    has_curves: bool, browser: Browser, tmp_path: Path
) -> None:
    """Also where a time, rounded, lies just beside a frame's own."""
    path = tmp_path / "page.html"
    curves = fap_clip() if has_curves else None
    write_page(path, title="t", videos=[PageVideo("v", video_mp4())], curves=curves)
    browser.load(path)

    for off_s in (-0.0015, -0.0009, -0.0007, -0.0003, 0.0, 0.0005):
        state = browser.seek(float(TIMES[5]) + off_s)
        assert browser.grey() == pytest.approx(16 + 4 * state["frame"], abs=1.9), off_s


def test_the_model_moves_with_the_time_and_comes_back(browser: Browser, full_page: Path) -> None:
    def visible_rows(picture: np.ndarray[Any, np.dtype[np.uint8]]) -> int:
        return int((picture[..., 3] > 128).any(axis=1).sum())

    browser.load(full_page)
    browser.seek(0.0)
    shut = browser.picture()
    browser.seek(1.0)
    wide = browser.picture()
    browser.seek(0.0)
    again = browser.picture()

    # the chin goes down by 24 mm, from a ball of 180 mm
    assert visible_rows(wide) / visible_rows(shut) == pytest.approx(204 / 180, abs=0.02)
    assert visible_rows(wide) < len(wide) - 2  # and is not cut off
    assert np.abs(again.astype(int) - shut).mean() < 0.5


def test_playing_goes_at_the_speed_asked_for_and_stops(browser: Browser, full_page: Path) -> None:
    browser.load(full_page)
    browser.run("document.querySelectorAll('.speeds button')[1].click()")  # half speed
    browser.run("facewright.play()")
    browser.wait("new Promise((done) => setTimeout(done, 600))")
    begin, clock = browser.run("return [facewright.state(), performance.now()]")
    browser.wait("new Promise((done) => setTimeout(done, 900))")
    middle, later = browser.run("return [facewright.state(), performance.now()]")
    browser.run("facewright.seek(0.1)")  # while it plays
    browser.wait("new Promise((done) => setTimeout(done, 900))")
    jumped = browser.state()
    stopped = browser.wait("facewright.pause()")
    rest = browser.state()
    time.sleep(0.2)

    assert stopped is None
    assert begin["playing"] and middle["playing"]
    passed = middle["time"] - begin["time"]
    assert passed == pytest.approx((later - clock) / 1000 * 0.5, abs=0.02)
    assert middle["videoTime"] == pytest.approx(middle["time"], abs=0.25)
    assert jumped["playing"] and 0.3 < jumped["time"] < 1.2
    assert jumped["videoTime"] == pytest.approx(jumped["time"], abs=0.25)
    assert not rest["playing"]
    assert browser.state()["time"] == rest["time"]
    assert rest["videoTime"] == pytest.approx(rest["time"], abs=2e-3)
    assert browser.grey() == pytest.approx(16 + 4 * rest["frame"], abs=1.9)


def test_it_ends_at_the_end_or_starts_anew(browser: Browser, full_page: Path) -> None:
    browser.load(full_page)
    browser.press("l")
    browser.seek(1.8)
    browser.run("facewright.play()")
    browser.wait("new Promise((done) => setTimeout(done, 900))")
    ended = browser.state()
    browser.press("l")
    browser.seek(1.8)
    browser.run("facewright.play()")
    browser.wait("new Promise((done) => setTimeout(done, 900))")
    looping = browser.state()
    browser.wait("facewright.pause()")

    assert not ended["playing"] and ended["time"] == pytest.approx(ended["duration"])
    assert looping["playing"] and looping["time"] < 1.8


def test_keys_step_and_jump(browser: Browser, full_page: Path) -> None:
    browser.load(full_page)
    browser.seek(0.4)
    frames = []
    for key, shift in (
        ("ArrowRight", False),
        (".", False),
        (",", False),
        ("ArrowLeft", False),
        ("ArrowRight", True),
        ("Home", False),
        ("End", False),
    ):
        browser.press(key, shift)
        frames.append(browser.state()["frame"])
    browser.press("Home")
    browser.press(" ")
    playing = browser.state()["playing"]
    browser.press(" ")

    assert frames == [11, 12, 11, 10, 35, 0, 49]
    assert playing and not browser.state()["playing"]


def test_a_click_on_the_curves_seeks_to_a_frame(browser: Browser, full_page: Path) -> None:
    browser.load(full_page)
    browser.run(
        "const plot = document.querySelector('.plot'), box = plot.getBoundingClientRect();"
        "const x = box.left + 62 + (box.width - 76) / 2, y = box.top + 40;"
        "for (const name of ['pointerdown', 'pointermove']) {"
        " try { plot.dispatchEvent(new PointerEvent(name, {clientX: x, clientY: y, button: 0,"
        "  pointerId: 1, bubbles: true})); } catch {} }"
    )
    browser.wait("new Promise((done) => setTimeout(done, 400))")

    state = browser.state()
    hover = browser.run("return document.querySelector('.hover').innerText")

    assert state["frame"] in (24, 25)
    assert state["time"] == pytest.approx(TIMES[state["frame"]])
    assert "open_jaw" in hover and "MNS/1024" in hover and "°" in hover


def test_the_picker_searches_and_shows_a_curve(browser: Browser, full_page: Path) -> None:
    browser.load(full_page)
    before = browser.run("return document.querySelector('.plot canvas').toDataURL()")
    browser.run(
        "const field = document.querySelector('input[type=search]'); field.value = 'brow';"
        "field.dispatchEvent(new Event('input'));"
    )
    names = browser.run(
        "return [...document.querySelectorAll('.picker label')].filter((l) => l.offsetParent)"
        ".map((l) => l.innerText.trim())"
    )
    browser.run(
        "[...document.querySelectorAll('.picker label')].find((l) => l.offsetParent).click()"
    )
    browser.wait("new Promise((done) => setTimeout(done, 300))")

    legend = browser.run("return document.querySelector('.legend').innerText")
    assert names == ["raise_l_i_eyebrow"]
    assert "raise_l_i_eyebrow" in legend
    assert browser.run("return document.querySelector('.plot canvas').toDataURL()") != before


def test_the_browser_asks_for_nothing_and_complains_of_nothing(
    browser: Browser, full_page: Path
) -> None:
    browser.load(full_page)
    browser.seek(1.0)

    asked = {url.partition(":")[0] for url in browser.requests()}

    assert asked <= {"file", "blob", "data", "about"}, asked
    assert "file" in asked
    assert browser.errors() == []


def test_a_page_may_have_any_number_of_each(browser: Browser, tmp_path: Path) -> None:
    glb, mp4 = head_glb(), video_mp4()
    path = tmp_path / "page.html"
    write_page(
        path,
        title="many",
        models=[PageModel("a", glb), PageModel("b", glb, start_s=0.5)],
        videos=[PageVideo("v", mp4, start_s=1.0)] * 3,
    )
    browser.load(path)

    state = browser.seek(1.2)

    assert state["videoTime"] == pytest.approx(1.2, abs=2e-3)
    assert browser.grey() == pytest.approx(16 + 4 * 5, abs=1.9)  # 0.2 s into the video
    assert state["duration"] == pytest.approx(3.0, abs=0.05)
    times = browser.run(
        "return [...document.querySelectorAll('model-viewer')].map((v) => v.currentTime)"
    )
    assert times == pytest.approx([1.2, 0.7], abs=1e-3)
    assert browser.run("return document.getElementById('curves').hidden")


@pytest.mark.parametrize("parts", [{}, {"notes": "only words"}, {"curves": fap_clip(1)}])
def test_a_page_without_pictures_works(
    parts: dict[str, Any], browser: Browser, tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    write_page(path, title="plain", **parts)
    browser.load(path)

    browser.run("facewright.play()")

    assert not browser.state()["playing"]
    assert browser.run("return document.getElementById('stage').hidden")
    assert browser.errors() == []


def test_broken_media_are_told_of_and_the_rest_goes_on(browser: Browser, tmp_path: Path) -> None:
    mp4 = video_mp4()
    path = tmp_path / "page.html"
    write_page(path, title="broken", videos=[PageVideo("v", mp4[:200])], curves=fap_clip())
    browser.load(path)

    state = browser.seek(1.0)

    assert "cannot be played" in browser.run("return document.body.innerText")
    assert state["time"] == 1.0 and state["videoTime"] is None


def test_long_curves_are_drawn_in_columns(browser: Browser, tmp_path: Path) -> None:
    """A single frame's spike among 100,000 is still seen."""
    values = np.zeros((100_000, 1))
    values[51_234] = 1.0
    path = tmp_path / "page.html"
    write_page(path, title="long", curves=Clip(np.arange(100_000) / 100, ("w",), values))
    browser.load(path)

    inked = browser.run(
        "const c = document.querySelector('.plot canvas');"
        "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        "const rows = new Set();"
        "const x0 = Math.round(c.width * .3), x1 = Math.round(c.width * .75);"
        "for (let y = 0; y < c.height; y++) for (let x = x0; x < x1; x++) {"
        " const i = 4 * (y * c.width + x);"
        " if (d[i + 3] > 128 && d[i] - d[i + 2] > 80) rows.add(y); }"  # orange, dark or light
        "return rows.size / c.height"
    )

    assert inked > 0.5


# sound, ranges, comparing, points


def spoken(seconds: float = 1.6, rate_hz: int = 16000) -> Audio:
    time_s = np.arange(int(seconds * rate_hz)) / rate_hz
    return Audio((0.3 * np.sin(2 * np.pi * 180 * time_s)).astype(np.float32), rate_hz)


@pytest.fixture(scope="module")
def sounding_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """2 s of curves and pictures, 1.6 s of sound."""
    path = tmp_path_factory.mktemp("sound") / "page.html"
    write_page(
        path,
        title="spoken",
        videos=[PageVideo("cam", video_mp4())],
        curves=fap_clip(),
        sound=PageSound("line.wav", spoken()),
    )
    return path


def sleep(browser: Browser, seconds: float) -> None:
    browser.wait(f"new Promise((done) => setTimeout(done, {1000 * seconds}))")


def test_the_sound_is_the_clock(browser: Browser, sounding_page: Path) -> None:
    browser.load(sounding_page)
    browser.seek(0.3)
    browser.run("facewright.play()")
    browser.wait(
        "new Promise((done) => { const look = () => facewright.state().leading === 'leading'"
        " && facewright.state().time > 0.32 ? done() : setTimeout(look, 10); look(); })"
    )
    pairs = []
    for _ in range(5):
        sleep(browser, 0.1)
        state = browser.state()
        pairs.append((state["time"], state["soundTime"], state["frame"] / RATE_HZ))
    browser.wait("facewright.pause()")
    rest = browser.state()

    times = np.array(pairs)
    assert (np.diff(times[:, 0]) > 0.02).all()
    assert np.abs(times[:, 0] - times[:, 1]).max() < 0.005  # read one after the other
    assert np.abs(times[:, 0] - times[:, 2]).max() < 0.2  # what is drawn, on a busy machine
    assert not rest["playing"] and rest["leading"] == "idle"
    assert browser.grey() == pytest.approx(16 + 4 * rest["frame"], abs=1.9)


def test_a_video_with_sound_is_the_clock_and_the_head_follows(
    browser: Browser, tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    write_page(
        path,
        title="film",
        models=[PageModel("head", head_glb())],
        videos=[PageVideo("cam", video_mp4(has_sound=True)), PageVideo("other", video_mp4())],
    )
    browser.load(path)
    browser.run("facewright.play()")
    browser.wait(
        "new Promise((done) => { const look = () => facewright.state().leading === 'leading'"
        " && facewright.state().time > 0.1 ? done() : setTimeout(look, 10); look(); })"
    )
    state = browser.state()
    browser.wait("facewright.pause()")
    rest = browser.state()
    muted = browser.run("return [...document.querySelectorAll('video')].map((v) => v.muted)")

    assert state["time"] == pytest.approx(state["videoTime"], abs=0.005)
    assert rest["videoTime"] == pytest.approx(rest["time"], abs=2e-3)
    assert rest["modelTime"] == pytest.approx(rest["time"], abs=1e-3)
    assert browser.grey() == pytest.approx(16 + 4 * rest["frame"], abs=1.9)
    assert muted == [False, True]


def test_where_the_sound_stands_still_so_do_the_pictures(
    browser: Browser, sounding_page: Path
) -> None:
    browser.load(sounding_page)
    browser.run(
        "const start = HTMLMediaElement.prototype.play;"
        "HTMLMediaElement.prototype.play = function () { if (this.tagName === 'AUDIO') {"
        " window.sound = this; } return start.call(this); };"
        "facewright.play();"
    )
    browser.wait(
        "new Promise((done) => { const look = () => facewright.state().leading === 'leading'"
        " ? done() : setTimeout(look, 10); look(); })"
    )
    # a sound that runs at a tenth of its speed, whatever the clock asked for
    browser.run("window.sound.playbackRate = 0.1")
    sleep(browser, 0.2)
    begin = browser.state()["time"]
    sleep(browser, 0.8)
    passed = browser.state()["time"] - begin
    browser.wait("facewright.pause()")

    assert 0.02 < passed < 0.25


def test_after_the_sound_has_ended_time_goes_on(browser: Browser, sounding_page: Path) -> None:
    browser.load(sounding_page)
    browser.press("l")
    browser.seek(1.4)
    browser.run("facewright.play()")
    sleep(browser, 1.8)

    state = browser.state()

    assert not state["playing"]
    assert state["time"] == pytest.approx(state["duration"])
    assert state["duration"] == pytest.approx(2.0, abs=0.05)


def test_a_range_is_played_again_and_again(browser: Browser, sounding_page: Path) -> None:
    browser.load(sounding_page)
    browser.seek(0.6)
    browser.press("i")
    browser.seek(1.0)
    browser.press("o")
    browser.run("facewright.play()")
    seen = []
    for _ in range(12):
        sleep(browser, 0.1)
        seen.append(browser.state()["time"])
    browser.wait("facewright.pause()")
    marked = browser.state()
    browser.press("Home")
    begin = browser.state()["time"]
    browser.press("x")
    whole = browser.state()

    assert (marked["inPoint"], marked["outPoint"]) == (0.6, 1.0)
    assert min(seen) >= 0.6 - 1e-6 and max(seen) <= 1.0 + 1e-6
    assert min(np.diff(seen)) < 0  # it came round
    assert begin == 0.6
    assert whole["inPoint"] is None and whole["outPoint"] is None


def test_any_speed_may_be_asked_for(browser: Browser, full_page: Path) -> None:
    browser.load(full_page)
    speeds = []
    for asked in (0.35, 3.0, 100.0, 0.0):
        browser.wait(f"facewright.setSpeed({asked})")
        speeds.append(browser.state()["speed"])
    browser.wait("facewright.setSpeed(1)")
    browser.press("]")
    faster = browser.state()["speed"]
    browser.press("[")

    assert speeds == [0.35, 3.0, 8.0, 0.1]
    assert faster == 1.25 and browser.state()["speed"] == 1.0


def test_clips_are_compared_by_their_channels_names(browser: Browser, tmp_path: Path) -> None:
    steady = np.full((N_FRAMES, 2), (100.0, 5000.0))
    steady[-1] = 0.0
    first = Clip(TIMES, ("open_jaw", "head_yaw"), steady)
    second = Clip(TIMES[:25], ("open_jaw",), np.linspace(0, 240, 25)[:, None])
    path = tmp_path / "page.html"
    curves = [PageCurves("take1.fap", first), PageCurves("take2.fap", second, start_s=0.2)]
    write_page(path, title="two", curves=curves)
    browser.load(path)

    def legend_at(time_s: float) -> str:
        browser.seek(time_s)
        return str(browser.run("return document.querySelector('.legend').innerText"))

    assert "take1.fap" in legend_at(0.5) and "take2.fap" in legend_at(0.5)
    assert "100 | 80" in legend_at(0.53)  # frame 8 of the second, which begins at 0.2 s
    assert "100 | –" in legend_at(0.0)  # not begun
    assert "100 | –" in legend_at(1.6)  # ended
    assert browser.state()["duration"] == pytest.approx(TIMES[-1])


def test_points_are_shown_on_demand_and_go_with_the_surface(
    browser: Browser, tmp_path: Path
) -> None:
    scene = scene_from_glb(head_glb(), "head")
    ball = scene.parts[0]
    chin = int(ball.vertices[:, 1].argmin())
    front = int(ball.vertices[:, 2].argmax())
    points = {name: f"0 0 {v} {v} {v} 1 0 0" for name, v in (("2.1", chin), ("9.3", front))}
    path = tmp_path / "page.html"
    model = PageModel("head", head_glb(), orbit="0deg 90deg 160%", points=points)
    write_page(path, title="points", models=[model])
    browser.load(path)

    def heights() -> dict[str, float]:
        sleep(browser, 0.5)
        found: dict[str, float] = browser.run(
            "return Object.fromEntries([...document.querySelectorAll('.point')].map((p) =>"
            " [p.innerText.trim() || p.textContent, p.getBoundingClientRect().top]))"
        )
        return found

    none = heights()
    browser.press("p")
    browser.seek(0.0)
    shut = heights()
    browser.seek(1.0)
    wide = heights()
    browser.press("p")
    named = browser.run("return document.querySelector('.pane').dataset.points")
    browser.press("p")

    assert none == {} and set(shut) == {"2.1", "9.3"}
    size = shut["2.1"] - shut["9.3"]  # 90 mm
    assert (wide["2.1"] - shut["2.1"]) / size == pytest.approx(24 / 90, abs=0.03)
    assert abs(wide["9.3"] - shut["9.3"]) < 0.05 * size
    assert named == "names" and heights() == {}


def test_heads_turn_together_until_they_are_parted(browser: Browser, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    write_page(path, title="two", models=[PageModel(n, head_glb()) for n in ("a", "b")])
    browser.load(path)
    turn = (
        "const [first] = document.querySelectorAll('model-viewer');"
        "const box = first.getBoundingClientRect(), x = box.left + box.width / 2;"
        "const target = first.shadowRoot.querySelector('.userInput');"
        "const send = (to, name, dx) => to.dispatchEvent(new PointerEvent(name, {clientX: x + dx,"
        " clientY: box.top + box.height / 2, button: 0, buttons: 1, pointerId: 7, isPrimary: true,"
        " pointerType: 'mouse', bubbles: true, composed: true}));"
        "send(target, 'pointerdown', 0); for (let d = 10; d <= 100; d += 10)"
        " send(target, 'pointermove', d); send(target, 'pointerup', 100);"
    )
    thetas = (
        "return [...document.querySelectorAll('model-viewer')].map((v) => v.getCameraOrbit().theta)"
    )

    browser.run(turn)
    sleep(browser, 1.5)
    together = browser.run(thetas)
    browser.press("v")
    browser.run(turn)
    sleep(browser, 1.5)
    parted = browser.run(thetas)

    assert abs(together[0]) > 0.2
    assert together[1] == pytest.approx(together[0], abs=1e-3)
    assert parted[1] == pytest.approx(together[1], abs=1e-3)
    assert abs(parted[0] - parted[1]) > 0.2


def test_keys_are_listed_and_only_those_that_do_something(
    browser: Browser, full_page: Path, tmp_path: Path
) -> None:
    browser.load(full_page)
    browser.press("?")
    listed = browser.run("return document.querySelector('dialog[open]').innerText")
    browser.press("?")
    is_open = browser.run("return document.querySelector('dialog').open")
    path = tmp_path / "page.html"
    write_page(path, title="curves", curves=fap_clip())
    browser.load(path)
    browser.press("?")
    without = browser.run("return document.querySelector('dialog[open]').innerText")

    for words in ("play or pause", "a frame on", "play from here", "faster", "from the front"):
        assert words in listed, words
    assert not is_open
    assert "from the front" not in without and "sound" not in without


def test_light_and_dark_differ_everywhere(browser: Browser, full_page: Path) -> None:
    browser.load(full_page)
    level = {}
    for _ in range(2):
        theme = browser.run("return document.documentElement.dataset.theme")
        sleep(browser, 0.3)
        level[theme] = float(browser.screenshot().mean())
        browser.press("t")

    assert set(level) == {"light", "dark"}
    assert level["light"] > 180 and level["dark"] < 80


@pytest.mark.parametrize("width", [360, 768, 1600])
def test_nothing_hangs_over_the_edge_at_any_width(
    width: int, browser: Browser, sounding_page: Path
) -> None:
    size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 600}
    browser._driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        browser.load(sounding_page)
        wide = browser.run("return document.documentElement.scrollWidth")
        cut = browser.run(
            "return [...document.querySelectorAll('.transport *, .legend *, .pane')].filter((e) =>"
            " e.getBoundingClientRect().right > innerWidth + 1).map((e) => e.outerHTML)"
        )
    finally:
        browser._driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})

    assert wide <= width
    assert cut == []


def test_a_sound_alone_is_a_page(browser: Browser, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    write_page(path, title="line", sound=PageSound("line.wav", spoken()))
    browser.load(path)

    inked = browser.run(
        "const c = document.querySelector('.plot canvas'), d = c.getContext('2d')"
        ".getImageData(0, 0, c.width, c.height).data; let n = 0;"
        "for (let x = 0; x < c.width; x++) for (let y = 10; y < 64; y++)"
        " if (d[4 * (y * c.width + x) + 3] > 200 && d[4 * (y * c.width + x) + 2]"
        " - d[4 * (y * c.width + x)] > 40) { n++; break; }"
        "return n / c.width"
    )

    assert browser.state()["duration"] == pytest.approx(1.6)
    assert inked > 0.8
    assert browser.errors() == []
