"""The small YAML reader, against PyYAML and against what it must refuse."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from facewright.core.errors import FileFormatError
from facewright.core.formats.yaml_subset import read_yaml

#: Everything the reader knows that PyYAML knows too.
DOCUMENTS = [
    "a: 1\nb: 2.5\nc: -1e-3\nd: .5\ne: 1.\n",
    "a: text with 'quotes' and [brackets]\nb: Bob's camera   # a comment\nc: x#y\n",
    "a: \"q \\\" \\\\ \\n \\x41 # no comment\"\nb: 'it''s'\n'c d': 1\n\"e: f\": 2\n",
    "a: true\nb: False\nc: null\nd: ~\ne:\nf: 'true'\n",
    "a:\n  b:\n    c: [1, 2,\n      3]\n  d: {x: 1, y: [2, {z: 3}]}\n",
    "a:\n- 1\n- [2, 3]\n-\n  b: 4\n- c: 5\n  d: 6\n- - 7\n  - 8\ne: 9\n",
    "a:\n  - b: 1\n    c:\n      - 2\n  - d: 3\n",
    "# only\n---\n- a\n\n- b # c\n- http://x.y/z\n...\n# end\n",
    "[1, 2, [], {}, [3,],\n 'x, y', \"]\"]\n",
    "cam0:\n  T:\n  - [1.0, 0.0,\n    0.5]\n  - [0, 1, 0]\n  name: /cam0/image_raw\n",
]


@pytest.mark.parametrize("text", DOCUMENTS)
def test_it_reads_what_pyyaml_reads(tmp_path: Path, text: str) -> None:
    yaml = pytest.importorskip("yaml", reason="PyYAML, the peer, is not installed")
    path = tmp_path / "a.yaml"
    path.write_text(text)

    wanted = yaml.safe_load(text.replace("1e-3", "1.0e-3"))  # YAML 1.1 asks for a point

    assert read_yaml(path) == wanted


def test_what_opencv_writes_and_no_yaml_reader_takes(tmp_path: Path) -> None:
    path = tmp_path / "a.yml"
    path.write_text(
        "%YAML:1.0\n---\nm: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: d\n"
        "   data: [ 1., -2.5000000000000000e-01 ]\np: { a:1, b:[ 2, .Nan ] }\n"
    )

    found = read_yaml(path)

    assert found["m"] == {"rows": 1, "cols": 2, "dt": "d", "data": [1.0, -0.25]}
    assert found["p"]["a"] == 1
    assert found["p"]["b"][0] == 2
    assert found["p"]["b"][1] != found["p"]["b"][1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "an empty file"),
        ("# nothing\n---\n", "only comments"),
        ("a: 1\n b: 2\n", "line 2: expected an indentation of 0 spaces, found 1"),
        ("  a: 1\nb: 2\n", "line 2: expected a line that is indented"),
        ("a: [1, 2\nb: 3\n", "line 1: expected a closing bracket"),
        ("a: [1 2}\n", "line 1: expected a comma or ]"),
        ("a: [1, , 2]\n", "line 1: expected a value"),
        ("a: [1] 2\n", "line 1: expected nothing behind"),
        ("a: {b}\n", "expected key: value"),
        ("a: {b: 1, b: 2}\n", "a key not used before, found b"),
        ('a: "x\n', "line 1: expected a closing quote"),
        ('a: "x" y\n', "expected nothing behind the closing quote"),
        ("a: 1\na: 2\n", "line 2: expected a key not used before, found a"),
        ("a: &x 1\nb: *x\n", "line 1: expected a plain value"),
        ("a: |\n  text\n", "line 1: expected a plain value"),
        ("a: !!python/object/apply:os.system ['true']\n", "found !!python/object/apply:os.system"),
        ("a: !!binary xyz\n", "found !!binary"),
        ("a: 1\n---\nb: 2\n", "line 2: expected one document"),
        ("a: 1\n...\nb: 2\n", "line 3: expected one document"),
        ("a: 1\nwords\n", "line 2: expected key: value, found words"),
        ("a:\n\tb: 1\n", "line 2: expected indentation by spaces, found a tab"),
        ("a: \0\n", "a binary file"),
        ("a: " + "[" * 1000 + "]" * 1000, "at most 32 brackets"),
        ("a: !!seq " + "[" * 5000 + "]" * 5000, "at most 32 brackets"),
        ("- " * 1000 + "a", "at most 32 levels"),
        ("".join(f"{' ' * n}a:\n" for n in range(1000)), "at most 32 levels"),
    ],
)
def test_what_it_does_not_read_is_said_with_its_line(
    tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(FileFormatError) as error:
        read_yaml(tmp_path / "a.yaml")
    assert message in str(error.value)
    assert str(tmp_path / "a.yaml") in str(error.value)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    with open(tmp_path / "a.yaml", "wb") as stream:
        stream.truncate(20 * 1024 * 1024)
    with pytest.raises(FileFormatError, match="at most 16777216 bytes"):
        read_yaml(tmp_path / "a.yaml")


@pytest.mark.parametrize(
    "text",
    [
        "a" + " " * 300_000 + "b",
        "'" + "\\" * 300_000,
        "9" * 300_000 + "x: 1",
        "a: " + "9" * 300_000 + "x",
        "a: [" + "9" * 300_000 + "x]",
        '"a"' + " " * 300_000 + "b",
    ],
    ids=["blanks", "escapes", "digits in a key", "digits", "digits in a list", "quoted key"],
)
def test_a_hostile_line_takes_no_longer_than_its_length(tmp_path: Path, text: str) -> None:
    """A pattern that goes back over the line would take minutes."""
    (tmp_path / "a.yaml").write_text(text)
    begin = time.perf_counter()
    try:
        read_yaml(tmp_path / "a.yaml")
    except FileFormatError as error:
        assert len(str(error)) < 500
    assert time.perf_counter() - begin < 5
