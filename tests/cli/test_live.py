"""A head moved by sliders: poses, and the server that shows them."""

from __future__ import annotations

import importlib.util
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from facewright.cli import live as live_module
from facewright.cli.live_pose import FAP_GROUPS, Pose, PoseDrive, fap_file, slider_range
from facewright.core.errors import InputError
from facewright.core.formats.fap import read_fap
from facewright.core.formats.live_link_csv import ARKIT_SHAPES
from facewright.core.mpeg4 import ANGLE_UNIT_RAD, fap_by_name, fap_table
from facewright.heads.expressions import EXPRESSIONS, VISEMES, expression_weights
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head

needs_viser = pytest.mark.skipif(
    importlib.util.find_spec("viser") is None, reason="needs the package viser (extra live)"
)


@pytest.fixture(scope="module")
def head() -> Head:
    return make_head(Identity("average"), texture_px=256)


@pytest.fixture(scope="module")
def drive(head: Head) -> PoseDrive:
    return PoseDrive(head)


def skin_rows(head: Head) -> np.ndarray:
    return head.part_vertices("skin")


def test_nothing_asked_for_is_the_head_at_rest(head: Head, drive: PoseDrive) -> None:
    posed = drive.posed(Pose())

    assert np.abs(posed.vertices - head.mesh.vertices).max() < 1e-9
    assert posed.quaternion == pytest.approx([1, 0, 0, 0])
    assert posed.translation == pytest.approx([0, 0, 0])


def test_weights_and_expressions_move_the_skin_as_the_sculpted_shapes_do(
    head: Head, drive: PoseDrive
) -> None:
    for pose, weights in (
        (Pose(weights={"jawOpen": 0.7, "browInnerUp": 1.0}), {"jawOpen": 0.7, "browInnerUp": 1.0}),
        (Pose(looks={"joy": 0.6}), expression_weights("joy", 0.6)),
    ):
        truth = head.shaped(weights)

        off = np.abs(drive.posed(pose).vertices - truth)[skin_rows(head)]

        assert off.max() < 1e-4  # the shapes are stored in single precision
        assert np.abs(truth - head.mesh.vertices).max() > 3


def test_faps_move_their_feature_points_by_their_units(head: Head, drive: PoseDrive) -> None:
    fap = fap_by_name()["raise_l_i_eyebrow"]
    posed = drive.posed(Pose(faps={fap.name: 100.0}))

    moved = head.feature_points.at(posed.vertices) - head.feature_points.at(head.mesh.vertices)

    at = moved[head.feature_points.names.index(fap.feature_points[0])]
    assert at[1] == pytest.approx(100.0 * head.fapu.unit(fap), abs=1e-6)


def test_faps_and_weights_add_up(head: Head, drive: PoseDrive) -> None:
    fap, weight = {"raise_l_i_eyebrow": 120.0}, {"mouthSmileLeft": 0.8}
    rest = head.mesh.vertices
    both = drive.posed(Pose(faps=fap, weights=weight)).vertices - rest
    one = drive.posed(Pose(faps=fap)).vertices - rest
    other = drive.posed(Pose(weights=weight)).vertices - rest

    rows = skin_rows(head)
    assert np.abs(both - one - other)[rows].max() < 1e-9
    assert np.abs(one[rows]).max() > 1 and np.abs(other[rows]).max() > 1


def test_the_head_turns_as_its_faps_say(drive: PoseDrive) -> None:
    posed = drive.posed(Pose(faps={"head_yaw": 30_000.0}))

    assert 2 * np.arccos(posed.quaternion[0]) == pytest.approx(30_000 * ANGLE_UNIT_RAD)
    assert abs(posed.quaternion[2]) == pytest.approx(np.sin(0.15))


def test_the_pose_is_saved_as_faps_that_say_the_same(drive: PoseDrive, tmp_path: Path) -> None:
    pose = Pose(faps={"open_jaw": 250.0, "head_roll": -4000.0}, weights={"eyeBlinkLeft": 1.0})
    path = tmp_path / "pose.fap"
    path.write_bytes(fap_file(drive.faps(pose)))

    clip = read_fap(path)

    assert len(clip.time_s) == 1
    assert clip["head_roll"][0] == -4000
    assert clip["open_jaw"][0] == pytest.approx(250, abs=15)  # a blink hardly opens the jaw
    assert clip["close_t_l_eyelid"][0] > 500  # most of the eye's height
    assert abs(clip["close_t_r_eyelid"][0]) < 50


def test_a_head_without_shapes_takes_weights_as_faps(head: Head) -> None:
    import dataclasses

    plain = dataclasses.replace(head, shape_names=(), shapes=None)
    drive = PoseDrive(plain)

    posed = drive.posed(Pose(weights={"jawOpen": 0.8}))

    down = (posed.vertices - head.mesh.vertices)[skin_rows(head), 1].min()
    assert not drive.has_shapes
    assert down < -8


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ValueError, match="faps has no jump"):
        Pose(faps={"jump": 1.0})
    with pytest.raises(ValueError, match="looks has no boredom"):
        Pose(looks={"boredom": 0.5})


def test_every_low_level_fap_is_in_one_group_and_has_a_range() -> None:
    numbers = [n for _, first, last in FAP_GROUPS for n in range(first, last + 1)]

    assert numbers == list(range(3, 69))
    for fap in fap_table()[2:]:
        low, high = slider_range(fap)
        assert low <= 0 < high


# the server


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def live(head: Head) -> Iterator[live_module.LiveHead]:
    pytest.importorskip("viser", reason="needs the package viser (extra live)")
    served = live_module.LiveHead(head, free_port())
    yield served
    served.stop()


def wait_for(condition: object, limit_s: float = 20.0) -> float:
    """Seconds until a condition holds."""
    assert callable(condition)
    begin = time.perf_counter()
    while not condition():
        assert time.perf_counter() - begin < limit_s, "it did not happen"
        time.sleep(0.001)
    return time.perf_counter() - begin


def test_there_is_a_slider_for_everything(live: live_module.LiveHead) -> None:
    wanted = {*(f.name for f in fap_table()[2:]), *ARKIT_SHAPES, *EXPRESSIONS, *VISEMES[1:]}

    assert set(live.sliders) == wanted
    assert all(slider.value == 0 for slider in live.sliders.values())


def test_a_slider_moves_the_head_that_is_shown(live: live_module.LiveHead, head: Head) -> None:
    live.sliders["jawOpen"].value = 0.5
    truth = head.shaped({"jawOpen": 0.5})
    rows = skin_rows(head)
    wait_for(lambda: np.abs(live.posed.vertices - truth)[rows].max() < 1e-4)

    sent = np.concatenate([handle.vertices for handle, _ in live._view._bending])
    whose = np.concatenate([vertices for _, vertices in live._view._bending])
    on_skin = np.isin(whose, rows)

    assert np.abs(sent[on_skin] * 1000 - truth[whose[on_skin]]).max() < 1e-3
    live.reset()
    wait_for(lambda: np.abs(live.posed.vertices - head.mesh.vertices).max() < 1e-9)
    assert live.pose().weights == {}


def test_it_follows_a_slider_that_is_dragged(live: live_module.LiveHead) -> None:
    took = []
    for value in range(50, 1050, 50):
        before = live.n_posed
        live.sliders["raise_l_i_eyebrow"].value = value / 5
        took.append(wait_for(lambda n=before: live.n_posed > n))
    live.reset()

    # 50 ms is promised, about 10 are needed; the median leaves room for a busy machine
    assert np.median(took) < 0.05


def test_the_eyes_look_where_they_are_told(live: live_module.LiveHead, head: Head) -> None:
    eyes = {handle.name: handle for handle, _ in live._view._turning}
    live.sliders["yaw_l_eyeball"].value = 30_000.0
    wait_for(lambda: eyes["/head/eye_left"].wxyz[0] < 0.999)
    turned = {name: np.array(handle.wxyz) for name, handle in eyes.items()}
    live.reset()

    assert 2 * np.arccos(turned["/head/eye_left"][0]) == pytest.approx(0.3, abs=1e-3)
    assert turned["/head/eye_right"][0] == pytest.approx(1.0)


def test_the_page_is_served(live: live_module.LiveHead) -> None:
    with urllib.request.urlopen(f"http://127.0.0.1:{live.port}", timeout=20) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read(4096).lower()


@needs_viser
def test_stopping_frees_the_port(head: Head) -> None:
    port = free_port()
    served = live_module.LiveHead(head, port)
    served.stop()
    served.stop()

    live_module._need_port(port)
    assert not served._worker.is_alive()


@needs_viser
def test_a_port_in_use_is_told() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]

        with pytest.raises(InputError, match=f"port {port} cannot be used.*--port"):
            live_module.show_live("average", port)


def test_without_viser_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)

    with pytest.raises(InputError, match=r'pip install "facewright\[live\]"'):
        live_module.show_live(None, 8080)


@needs_viser
def test_ctrl_c_ends_it_cleanly() -> None:
    root = Path(__file__).parents[2]
    command = (  # a shell's background jobs, and what they start, are deaf to Ctrl-C
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from facewright.cli.main import app; app()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", command, "view", "--live", "--port", str(free_port())],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(root)},
    )
    assert process.stderr is not None and process.stdout is not None
    try:
        line = ""
        while "Ctrl-C ends" not in line:
            line = process.stderr.readline()
            assert line, "it ended by itself"
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    finally:
        process.kill()

    assert process.returncode == 0
    assert "Traceback" not in err and err.strip().endswith("ended")
    assert out == ""
