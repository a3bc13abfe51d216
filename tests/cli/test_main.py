"""The command as a user meets it: help, exit codes, one line for what went wrong."""

from __future__ import annotations

import json
import logging
import os
import pty
import subprocess
import sys
import tomllib
import wave
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner, Result

from facewright.cli import doctor as doctor_module
from facewright.cli import progress as progress_module
from facewright.cli.doctor import DEPENDENCIES, Dependency
from facewright.cli.errors import guarded
from facewright.cli.main import COMMANDS, app, build_app
from facewright.cli.progress import progress
from facewright.cli.tables import Table, print_table, write_json
from facewright.core.errors import FileFormatError, InputError
from facewright.core.files import atomic_write


def facewright(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def run_guarded(function: Callable[..., None], *words: str) -> Result:
    """A command made of `function` alone, run as the real ones are."""
    small = typer.Typer(pretty_exceptions_enable=False)
    small.command()(guarded(function))
    return CliRunner().invoke(small, list(words))


RIG = {
    "version": 1,
    "units": "mm",
    "cameras": [
        {
            "name": name,
            "image_size": [1280, 720],
            "matrix": [[1500.0, 0.0, 640.0], [0.0, 1500.0, 360.0], [0.0, 0.0, 1.0]],
            "distortion": {"model": "opencv", "coefficients": [0.0] * 5},
            "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            "translation": translation,
        }
        for name, translation in (("left", [0.0, 0.0, 1000.0]), ("right", [300.0, 400.0, 1000.0]))
    ],
}


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """Two cameras, 500 mm apart, written by hand."""
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(RIG))
    return path


# The command ---------------------------------------------------------------------------------


def test_without_arguments_the_help_names_every_command() -> None:
    result = facewright()

    shown = result.output
    assert "Usage: facewright" in shown
    assert not [name for name in COMMANDS if name.split()[0] not in shown]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_and_debug(name: str) -> None:
    result = facewright(*name.split(), "--help")

    assert result.exit_code == 0, result.output
    assert "--debug" in result.output
    assert len(result.output.splitlines()) > 8


def test_the_version_is_that_of_the_project(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]

    assert facewright("--version").stdout == f"facewright {project['version']}\n"


def test_an_unknown_command_is_wrong_usage_and_a_near_one_is_suggested() -> None:
    result = facewright("inf")

    assert result.exit_code == 2
    assert "info" in result.stderr
    assert result.stdout == ""


@pytest.mark.parametrize("words", [("info",), ("info", "--frobnicate", "x"), ("doctor", "--json")])
def test_wrong_usage_exits_with_2(words: tuple[str, ...]) -> None:
    assert facewright(*words).exit_code == 2


def test_commands_of_a_group_follow_its_name() -> None:
    made: list[int] = []

    def take(seed: int = 0) -> None:
        """Film a performance."""
        if seed < 0:
            raise InputError("a seed is 0 or more")
        made.append(seed)

    grouped = build_app({"synth take": take})

    result = CliRunner().invoke(grouped, ["synth", "take", "--seed", "3"])
    listed = CliRunner().invoke(grouped, ["synth", "--help"])
    failed = CliRunner().invoke(grouped, ["--debug", "synth", "take", "--seed", "-1"])
    assert (result.exit_code, made) == (0, [3])
    assert "Film a performance." in listed.output
    assert failed.exit_code == 1
    assert failed.stderr.startswith("Traceback")


# Errors ---------------------------------------------------------------------------------------


def fails_with(error: BaseException) -> Callable[..., None]:
    def command() -> None:
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (InputError("two videos, one camera"), "two videos, one camera"),
        (
            FileFormatError("take1.fap", "line 214", "68 values", "66"),
            "take1.fap, line 214: expected 68 values, found 66",
        ),
        (FileNotFoundError(2, "No such file or directory", "a.mp4"), "a.mp4: No such file"),
        (PermissionError(13, "Permission denied", "out/.head.77.part.glb"), "out/head.glb: Perm"),
        (OSError("cannot identify image file"), "cannot identify image file"),
        (InputError("two\nlines"), "two lines"),
        (MemoryError("Unable to allocate 9 TiB"), "not enough memory: Unable to allocate 9 TiB"),
    ],
)
def test_what_a_user_can_mend_is_one_line(error: Exception, line: str) -> None:
    result = run_guarded(fails_with(error))

    assert result.exit_code == 1
    assert result.stderr.startswith(f"facewright: {line}")
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""


def test_debug_shows_the_traceback_before_the_line() -> None:
    result = run_guarded(fails_with(InputError("bad")), "--debug")

    assert result.exit_code == 1
    assert result.stderr.startswith("Traceback")
    assert result.stderr.endswith("facewright: bad\n")


@pytest.mark.parametrize(
    "words", [("--debug", "info", "nothing.c3d"), ("info", "nothing.c3d", "--debug")]
)
def test_debug_may_stand_before_or_after_the_command(words: tuple[str, ...]) -> None:
    result = facewright(*words)

    assert result.exit_code == 1
    assert "Traceback" in result.stderr


def test_a_fault_of_ours_is_not_hidden() -> None:
    result = run_guarded(fails_with(ZeroDivisionError("our mistake")))

    assert isinstance(result.exception, ZeroDivisionError)


def test_an_exit_code_of_a_command_is_kept() -> None:
    assert run_guarded(fails_with(typer.Exit(1))).exit_code == 1


def test_an_interrupted_command_says_so_and_leaves_nothing(tmp_path: Path) -> None:
    def command() -> None:
        with atomic_write(tmp_path / "out.txt") as stream:
            stream.write("half")
            raise KeyboardInterrupt

    result = run_guarded(command)

    assert result.exit_code == 130
    assert result.stderr == "facewright: interrupted; nothing half-written\n"
    assert list(tmp_path.iterdir()) == []


def test_the_progress_of_what_failed_ends_before_the_message() -> None:
    def frames() -> Iterator[int]:
        try:
            yield from range(10)
        finally:
            print("the bar ends", file=sys.stderr)

    def track(items: Iterator[int]) -> None:
        for item in items:
            if item == 3:
                raise InputError("no markers")

    result = run_guarded(lambda: track(frames()))

    assert result.stderr == "the bar ends\nfacewright: no markers\n"


def test_warnings_are_shown_while_a_command_runs_and_no_longer() -> None:
    ours = logging.getLogger("facewright")
    before = list(ours.handlers)

    def command() -> None:
        logging.getLogger("facewright.core.formats.c3d").warning("no unit given: taken for mm")

    result = run_guarded(command)

    assert result.stderr == "facewright: no unit given: taken for mm\n"
    assert result.stdout == ""
    assert ours.handlers == before


def test_options_of_a_command_reach_it() -> None:
    seen: dict[str, object] = {}

    def command(name: str, count: int = 3) -> None:
        seen.update(name=name, count=count)

    result = run_guarded(command, "cam0", "--count", "7")

    assert result.exit_code == 0, result.output
    assert seen == {"name": "cam0", "count": 7}


def run_info_into(stdout: int, repository: Path, path: Path) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    return subprocess.run(
        [sys.executable, "-c", "from facewright.cli.main import app; app()", "info", str(path)],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        env={**environment, "PYTHONPATH": str(repository)},
        check=False,
    )


def test_a_reader_of_our_output_that_leaves_is_no_error(repository: Path, rig_file: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)

    done = run_info_into(writing, repository, rig_file)

    os.close(writing)
    assert done.returncode == 1
    assert done.stderr == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_results_that_find_no_room_are_an_error(repository: Path, rig_file: Path) -> None:
    with open("/dev/full", "wb") as full:
        done = run_info_into(full.fileno(), repository, rig_file)

    assert done.returncode == 1
    assert done.stderr == "facewright: No space left on device\n"


# Tables and JSON -----------------------------------------------------------------------------


def test_a_table_aligns_numbers_right_and_words_left(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [("cam0", 1280, 0.123456), ("a long name", 7, float("nan")), ("顔", None, 12345.6)]

    print_table(("name", "width", "error"), rows, title="cameras")

    assert capsys.readouterr().out.splitlines() == [
        "cameras",
        "name         width   error",
        "───────────  ─────  ──────",
        "cam0          1280  0.1235",
        "a long name      7       –",
        "顔               –   12346",
    ]


def test_a_table_without_rows_shows_its_columns() -> None:
    assert str(Table(("a", "b"), ())) == "a  b\n─  ─"


def test_a_name_cannot_break_a_table() -> None:
    assert str(Table(("",), (("two\nlines\x1b[2J",),))) == r"two\nlines\x1b[2J"


def test_results_survive_an_output_that_knows_no_such_letters() -> None:
    code = "from facewright.cli.tables import print_table; print_table(('ä', 'b'), [(None, 1)])"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONPATH": os.pathsep.join(sys.path)},
        check=False,
    )

    assert done.returncode == 0, done.stderr
    assert done.stdout.decode("ascii").splitlines()[1:] == ["-  -", "-  1"]


def test_json_holds_no_numbers_that_are_not(tmp_path: Path) -> None:
    value = {
        "nan": float("nan"),
        "array": np.array([[1.5, np.inf], [2, 3]]),
        "count": np.int64(7),
        "yes": np.bool_(True),
        "path": Path("a/b"),
        "none": None,
        "rows": ({"x": np.float32(0.5)},),
    }

    write_json(tmp_path / "out.json", value)

    def refuse(word: str) -> Any:
        raise AssertionError(word)

    assert json.loads((tmp_path / "out.json").read_text(), parse_constant=refuse) == {
        "nan": None,
        "array": [[1.5, None], [2, 3]],
        "count": 7,
        "yes": True,
        "path": "a/b",
        "none": None,
        "rows": [{"x": 0.5}],
    }


def test_json_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="object"):
        write_json(tmp_path / "out.json", {"x": object()})

    assert list(tmp_path.iterdir()) == []


# Progress ------------------------------------------------------------------------------------


@pytest.mark.parametrize("total", [5, None, 99])
def test_progress_passes_everything_through(
    total: int | None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert list(progress(range(5), total, "tracking")) == [0, 1, 2, 3, 4]

    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("tracking: 5 done in ")
    assert captured.err.count("\n") == 1


def test_long_work_off_a_terminal_tells_now_and_then(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress_module, "_LINE_EVERY_S", -1.0)

    list(progress("ab", 2, "tracking"))

    assert capsys.readouterr().err.splitlines()[:2] == ["tracking: 1 of 2", "tracking: 2 of 2"]


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_on_a_terminal_there_is_a_bar_and_the_cursor_comes_back(repository: Path) -> None:
    code = (
        "from facewright.cli.progress import progress\n"
        "from facewright.cli.errors import user_errors\n"
        "from facewright.core.errors import InputError\n"
        "def track(items):\n"
        "    for frame in items:\n"
        "        if frame == 50: raise InputError('no markers')\n"
        "with user_errors(False):\n"
        "    track(progress(range(100), 100, 'tracking'))\n"
    )
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=theirs,
        env={**os.environ, "TERM": "xterm", "PYTHONPATH": str(repository)},
    )
    out, _ = process.communicate(timeout=60)
    os.close(theirs)
    shown = _read_all(ours)

    assert process.returncode == 1
    assert out == b""
    assert "tracking" in shown
    hidden, message = shown.rfind("\x1b[?25l"), shown.index("facewright: no markers")
    assert hidden < shown.rfind("\x1b[?25h") < message, "the bar must end before the message"
    assert shown[:message].endswith(("\n", "\x1b[?25h")), repr(shown)


def _read_all(descriptor: int) -> str:
    found = b""
    try:
        while chunk := os.read(descriptor, 4096):
            found += chunk
    except OSError:  # Linux reports the end of a pseudo-terminal so
        pass
    os.close(descriptor)
    return found.decode()


# doctor --------------------------------------------------------------------------------------


def test_doctor_looks_at_every_dependency(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    wanted = {requirement.split(">")[0] for requirement in project["dependencies"]}

    assert {dependency.distribution for dependency in DEPENDENCIES} == wanted


def test_doctor_finds_this_machine_fit(tmp_path: Path) -> None:
    result = facewright("doctor", "--json", tmp_path / "doctor.json")

    report = json.loads((tmp_path / "doctor.json").read_text())
    found = {finding["part"]: finding for finding in report["findings"]}
    assert result.exit_code == 0, result.output
    assert report["ok"] is True
    assert found["numpy"]["found"] == np.__version__
    assert found["Python"]["found"] == sys.version.split()[0]
    assert all(part in result.stdout for part in found)


def test_doctor_names_what_is_missing_and_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    absent = Dependency("no-such-thing", "no_such_module")
    monkeypatch.setattr(doctor_module, "DEPENDENCIES", (absent,))

    result = facewright("doctor")

    assert result.exit_code == 1
    assert 'pip install "no-such-thing"' in result.stdout
    assert "Missing: no-such-thing." in result.stdout


def test_doctor_names_a_version_that_is_too_old(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_module, "_minimum_versions", lambda: {"numpy": "99.1"})

    result = facewright("doctor")

    assert result.exit_code == 1
    assert f"{np.__version__}, too old" in result.stdout
    assert 'pip install "numpy>=99.1"' in result.stdout


# info ----------------------------------------------------------------------------------------


def info_of(tmp_path: Path, path: Path) -> dict[str, Any]:
    result = facewright("info", path, "--json", tmp_path / "info.json")
    assert result.exit_code == 0, result.output
    assert str(path) in result.stdout
    [report] = json.loads((tmp_path / "info.json").read_text())["files"]
    assert report["file"] == str(path)
    found: dict[str, Any] = report
    return found


def test_info_on_a_camera_rig(tmp_path: Path, rig_file: Path) -> None:
    found = info_of(tmp_path, rig_file)

    left, right = found["cameras"]
    assert found["n_cameras"] == 2
    assert (left["name"], left["width_px"], left["height_px"]) == ("left", 1280, 720)
    assert left["focal_px"] == pytest.approx(1500)
    assert left["from_origin_mm"] == pytest.approx(1000)
    assert right["to_nearest_camera_mm"] == pytest.approx(500)  # 3-4-5


def test_info_on_trajectories_counts_gaps(tmp_path: Path) -> None:
    from facewright.core.formats.c3d import write_c3d
    from facewright.core.trajectories import Trajectories

    positions = np.arange(60.0).reshape(10, 2, 3)
    positions[2:4, 1] = np.nan
    positions[7:10, 1] = np.nan
    write_c3d(tmp_path / "m.c3d", Trajectories(np.arange(10) / 60, ("chin", "brow"), positions))

    found = info_of(tmp_path, tmp_path / "m.c3d")

    chin, brow = found["markers"]
    assert (found["n_markers"], found["n_frames"], found["n_gaps"]) == (2, 10, 2)
    assert found["rate_hz"] == pytest.approx(60)
    assert (chin["seen_percent"], chin["n_gaps"]) == (100, 0)
    assert (brow["seen_percent"], brow["n_gaps"], brow["longest_gap_frames"]) == (50, 2, 3)


def test_info_on_faps_of_another_program(tmp_path: Path, real_data: Path) -> None:
    paths = sorted((real_data / "fap").glob("*.fap"))
    assert paths

    for path in paths:
        found = info_of(tmp_path, path)
        header = path.read_text().splitlines()[0].split()
        assert found["n_frames"] == int(header[-1])
        # one frame has no rate
        assert found["rate_hz"] == (float(header[-2]) if found["n_frames"] > 1 else None)
        assert 0 < found["n_channels_set"] == len(found["channels"])
        assert all(c["lowest"] <= c["highest"] for c in found["channels"])


def test_info_on_a_clip_and_on_the_truth_of_a_take(tmp_path: Path) -> None:
    from facewright.core.clip import Clip
    from facewright.core.formats.clip_npz import write_clip_npz

    values = np.array([[1.0, np.nan], [5.0, np.nan], [3.0, np.nan]])
    write_clip_npz(tmp_path / "c.npz", Clip(np.arange(3) / 30, ("open_jaw", "unset"), values))
    np.savez(tmp_path / "truth.npz", time_s=np.arange(4.0), marker_positions=np.zeros((4, 30, 3)))

    clip = info_of(tmp_path, tmp_path / "c.npz")
    truth = info_of(tmp_path, tmp_path / "truth.npz")

    [jaw] = clip["channels"]
    assert (jaw["channel"], jaw["fap"], jaw["unit"]) == ("open_jaw", 3, "MNS/1024")
    assert (jaw["lowest"], jaw["highest"], jaw["n_set"]) == (1, 5, 3)
    assert clip["n_channels"] == 2
    assert truth["arrays"] == [
        {"name": "time_s", "shape": "4", "type": "float64"},
        {"name": "marker_positions", "shape": "4 x 30 x 3", "type": "float64"},
    ]


def test_info_on_a_scene_by_another_program(tmp_path: Path, real_data: Path) -> None:
    found = info_of(tmp_path, real_data / "heads" / "ict_random_identity.glb")

    assert max(part["n_morph_targets"] for part in found["parts"]) == 57  # SOURCES.md
    assert found["n_vertices"] >= 26719


def test_info_on_a_video_by_another_program(tmp_path: Path, real_data: Path) -> None:
    found = info_of(tmp_path, real_data / "faces" / "webcam_clip.mp4")

    assert (found["width_px"], found["height_px"]) == (400, 300)  # SOURCES.md
    assert found["rate_hz"] == pytest.approx(25)
    assert found["codec"] == "h264"


def test_info_on_a_sound(tmp_path: Path) -> None:
    with wave.open(str(tmp_path / "a.wav"), "wb") as sound:
        sound.setnchannels(1)
        sound.setsampwidth(2)
        sound.setframerate(8000)
        sound.writeframes(np.array([0, 16384, -8192, 0] * 1000, dtype="<i2").tobytes())

    found = info_of(tmp_path, tmp_path / "a.wav")

    assert (found["rate_hz"], found["n_samples"]) == (8000, 4000)
    assert found["duration_s"] == pytest.approx(0.5)
    assert found["peak"] == pytest.approx(0.5, abs=1e-4)


def test_info_on_a_marker_set(tmp_path: Path) -> None:
    from facewright.core.formats.markers_toml import write_marker_set
    from facewright.core.markers import Marker, MarkerSet

    head = [Marker(f"h{i}", "head", (10.0 * i, 100.0, 0.0)) for i in range(3)]
    write_marker_set(tmp_path / "markers.toml", MarkerSet("mine", (Marker("chin", "2.1"), *head)))

    found = info_of(tmp_path, tmp_path / "markers.toml")

    assert (found["name"], found["n_markers"], found["n_on_head"]) == ("mine", 4, 3)
    assert found["markers"][0] == {"label": "chin", "feature_point": "2.1"}


def test_the_beginning_of_a_file_tells_more_than_its_name(tmp_path: Path) -> None:
    np.savez(tmp_path / "arrays.npz", a=np.zeros(3))
    (tmp_path / "arrays.npz").rename(tmp_path / "arrays.mp4")

    assert info_of(tmp_path, tmp_path / "arrays.mp4")["n_arrays"] == 1


JUNK = b"\x93\x00junk\xff\xfe" * 100


@pytest.mark.parametrize(
    "name", ["a.json", "a.c3d", "a.fap", "a.npz", "a.glb", "a.toml", "a.mp4", "a.wav", "a.xyz"]
)
@pytest.mark.parametrize("contents", [b"", JUNK], ids=["empty", "junk"])
def test_info_on_what_it_cannot_read_is_one_line(
    tmp_path: Path, name: str, contents: bytes
) -> None:
    (tmp_path / name).write_bytes(contents)

    result = facewright("info", tmp_path / name)

    assert result.exit_code == 1, result.exception
    assert result.stderr.startswith("facewright: ")
    assert str(tmp_path / name) in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""


@pytest.mark.parametrize(
    "beginning",
    [b"glTF", b"PK\x03\x04", b"RIFF\0\0\0\0WAVE", b"\0\0\0\x20ftyp", b"\x1a\x45\xdf\xa3"],
)
def test_info_on_a_file_that_breaks_off_is_one_line(tmp_path: Path, beginning: bytes) -> None:
    (tmp_path / "broken").write_bytes(beginning + b"\0\x01" * 40)

    result = facewright("info", tmp_path / "broken")

    assert result.exit_code == 1, result.exception
    assert result.stderr.count("\n") == 1, result.stderr
    assert str(tmp_path / "broken") in result.stderr


def test_one_bad_file_does_not_hide_the_others(tmp_path: Path) -> None:
    np.savez(tmp_path / "good.npz", a=np.zeros(3))

    result = facewright(
        "info", "nothing.c3d", tmp_path, tmp_path / "good.npz", "--json", tmp_path / "info.json"
    )

    reports = json.loads((tmp_path / "info.json").read_text())["files"]
    assert result.exit_code == 1
    assert len(result.stderr.splitlines()) == 2
    assert "good.npz: arrays" in result.stdout
    assert ["error" in report for report in reports] == [True, True, False]


def test_info_writes_no_json_into_a_folder_that_is_not_there(tmp_path: Path) -> None:
    np.savez(tmp_path / "good.npz", a=np.zeros(3))

    result = facewright("info", tmp_path / "good.npz", "--json", tmp_path / "no" / "info.json")

    assert result.exit_code == 1
    assert (
        result.stderr == f"facewright: {tmp_path / 'no' / 'info.json'}: No such file or directory\n"
    )
