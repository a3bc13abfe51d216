"""What options mean, and what is said when they mean nothing."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from facewright.cli.options import (
    find_marker_set,
    find_rig,
    neutral_frame,
    writable_file,
    writable_folder,
)
from facewright.core.errors import InputError
from facewright.core.formats.markers_toml import write_marker_set
from facewright.core.formats.rig_json import write_rig
from facewright.core.trajectories import Trajectories
from facewright.datasets_synthetic.rigs import face_rig
from facewright.heads.marker_sets import ready_marker_set


@pytest.fixture(scope="module")
def take() -> Trajectories:
    """Thirty frames at 60 per second: 0 to 0.483 s."""
    return Trajectories(np.arange(30) / 60, ("a",), np.zeros((30, 1, 3)))


@pytest.mark.parametrize(
    ("when", "frame"),
    [
        ("0", 0), ("12", 12), (" 7 ", 7), ("29", 29), ("0s", 0), ("0.2s", 12), ("0.21s", 13),
        ("0.4833333333s", 29), (" 0.1s ", 6), ("1e-1s", 6), ("+3", 3),
    ],
)  # fmt: skip
def test_the_neutral_frame_is_a_number_or_seconds(
    take: Trajectories, when: str, frame: int
) -> None:
    assert neutral_frame(when, take) == frame


@pytest.mark.parametrize(
    ("when", "says"),
    [
        ("30", "the take has frames 0 to 29"),
        ("-1", "the take has frames 0 to 29"),
        ("0.5s", r"the take lasts 0\.483 s"),
        ("-0.1s", "the take lasts"),
        ("nans", "the take lasts|expected a frame number"),
        ("infs", "the take lasts|expected a frame number"),
        ("1.5", "expected a frame number"),
        ("nan", "expected a frame number"),
        ("1e1", "expected a frame number"),
        ("", "expected a frame number"),
        ("s", "expected a frame number"),
        ("start", "expected a frame number"),
        ("12 frames", "expected a frame number"),
        ("0.2 sec", "expected a frame number"),
    ],
)
def test_what_names_no_frame_is_refused_in_one_line(
    take: Trajectories, when: str, says: str
) -> None:
    with pytest.raises(InputError, match=says) as caught:
        neutral_frame(when, take)

    assert f"--neutral {when}" in str(caught.value)


def test_seconds_are_those_of_uneven_time_stamps() -> None:
    take = Trajectories(np.array([0.0, 0.1, 0.5, 0.55]), ("a",), np.zeros((4, 1, 3)))

    assert [neutral_frame(w, take) for w in ("0.29s", "0.31s", "0.53s")] == [1, 2, 3]


def test_a_marker_set_is_a_ready_one_a_file_or_beside_the_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = ready_marker_set()
    write_marker_set(tmp_path / "mine.toml", own)

    assert find_marker_set("kshirsagar", tmp_path) == own
    assert find_marker_set(str(tmp_path / "mine.toml"), tmp_path) == own
    assert find_marker_set(None, tmp_path) is None
    assert capsys.readouterr() == ("", "")

    shutil.copy(tmp_path / "mine.toml", tmp_path / "markers.toml")
    assert find_marker_set(None, tmp_path) == own
    out, err = capsys.readouterr()
    assert out == ""
    assert f"using marker set {tmp_path / 'markers.toml'}" in err


def test_a_marker_set_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        find_marker_set(str(tmp_path / "none.toml"), tmp_path)


def test_a_rig_is_a_file_or_beside_the_videos(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = face_rig(np.random.default_rng(0))
    elsewhere = tmp_path / "elsewhere.json"
    write_rig(elsewhere, rig)
    videos = [tmp_path / "cam0.mp4", tmp_path / "cam1.mp4"]

    with pytest.raises(InputError, match=r"--rig, or put rig\.json into"):
        find_rig(None, videos)
    assert find_rig(elsewhere, videos).names == rig.names
    assert capsys.readouterr() == ("", "")

    shutil.copy(elsewhere, tmp_path / "rig.json")
    assert find_rig(None, videos).names == rig.names
    assert "using camera rig" in capsys.readouterr().err


def test_a_folder_is_made_with_its_parents_and_left_empty(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"

    assert writable_folder(folder) == folder
    assert writable_folder(folder) == folder
    assert list(folder.iterdir()) == []


def test_a_folder_that_cannot_be_made_or_written_to_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()

    with pytest.raises(InputError, match=r"file: cannot write there \(.*exists"):
        writable_folder(file)
    with pytest.raises(InputError, match=r"cannot write there \(Not a directory"):
        writable_folder(file / "below")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_refused(tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir()
    locked.chmod(0o500)
    try:
        with pytest.raises(InputError, match="cannot write there"):
            writable_folder(locked)
    finally:
        locked.chmod(0o700)


def test_a_file_to_write_needs_a_known_suffix_and_no_folder_of_its_name(tmp_path: Path) -> None:
    path = tmp_path / "new" / "take.C3D"

    assert writable_file(path, (".c3d",)) == path
    assert not path.exists()
    assert path.parent.is_dir()
    with pytest.raises(InputError, match=r"take\.txt: expected a name that ends in \.fap or \.npz"):
        writable_file(tmp_path / "take.txt", (".fap", ".npz"))
    (tmp_path / "d.fap").mkdir()
    with pytest.raises(InputError, match=r"d\.fap is a folder"):
        writable_file(tmp_path / "d.fap", (".fap",))
