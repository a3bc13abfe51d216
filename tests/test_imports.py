"""Who may import whom, and what importing costs."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]

#: The arrows of ARCHITECTURE.md: what each room may import besides itself.
ARROWS: dict[str, set[str]] = {
    "core": set(),
    "heads": {"core"},
    "capture": {"core", "heads"},
    "tracking": {"core", "heads", "capture"},
    "speech": {"core"},
    "retarget": {"core", "heads"},
    "datasets_synthetic": {"core", "heads"},
    "cli": {
        "core",
        "heads",
        "capture",
        "tracking",
        "speech",
        "retarget",
        "datasets_synthetic",
    },
}
OUTSIDE_THE_PACKAGE = ("tests", "benchmarks", "examples", "docs")
SLOW_MODULES = {"torch", "open3d", "pycolmap", "anny", "cv2", "matplotlib"}
#: What ``facewright --help`` does without, besides.
NOT_FOR_HELP = {"numpy", "scipy", "numba", "av", "soundfile", "pygltflib", "PIL"}
NAMES_THAT_SAY_NOTHING = {"utils.py", "helpers.py", "common.py", "util.py", "helper.py", "misc.py"}


#: Stands for our own top in the names of relative imports.
HERE = "<here>"


def modules_of(folder: str) -> list[Path]:
    return sorted((REPOSITORY / folder).rglob("*.py"))


def imported_names(module: Path) -> Iterator[tuple[int, str]]:
    """(line, dotted name) of every import; a relative one begins with ``<here>``, our top."""
    package = (HERE, *module.relative_to(REPOSITORY).parent.parts)
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"), str(module))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - (node.level - 1)] if node.level else ()
            for alias in node.names:
                parts = [*base, *filter(None, [node.module]), alias.name]
                yield node.lineno, ".".join(parts)


def imports_where(folder: str, is_wrong: Callable[[Path, list[str]], bool]) -> list[str]:
    """``module, line: name`` of the imports in a folder whose dotted parts are judged wrong."""
    return [
        f"{module.relative_to(REPOSITORY)}, line {line}: {name}"
        for module in modules_of(folder)
        for line, name in imported_names(module)
        if is_wrong(module, name.split("."))
    ]


def test_every_room_is_installed_and_every_room_has_its_arrows() -> None:
    setup = ast.parse((REPOSITORY / "setup.py").read_text(encoding="utf-8"))
    folders = next(
        ast.literal_eval(node.value)
        for node in ast.walk(setup)
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "FOLDERS"
    )
    links = {path.name for path in (REPOSITORY / "facewright").iterdir() if path.is_symlink()}

    assert set(folders) == set(ARROWS)
    assert links == set(ARROWS)


@pytest.mark.parametrize("room", ARROWS)
def test_inside_the_package_our_own_code_is_imported_relatively(room: str) -> None:
    ours = {"facewright", *ARROWS, *OUTSIDE_THE_PACKAGE}

    assert imports_where(room, lambda _, name: name[0] in ours) == []


@pytest.mark.parametrize("room", ARROWS)
def test_rooms_import_only_along_the_arrows(room: str) -> None:
    closed = ARROWS.keys() - {room, *ARROWS[room]}

    assert imports_where(room, lambda _, name: name[0] == HERE and name[1] in closed) == []


@pytest.mark.parametrize("folder", [*ARROWS, *OUTSIDE_THE_PACKAGE])
def test_nothing_imports_a_room_without_its_package(folder: str) -> None:
    assert imports_where(folder, lambda _, name: name[0] in ARROWS) == []


@pytest.mark.parametrize("room", ARROWS)
def test_matplotlib_is_imported_in_plots_alone(room: str) -> None:
    def is_wrong(module: Path, name: list[str]) -> bool:
        return name[0] == "matplotlib" and module.name != "plots.py"

    assert imports_where(room, is_wrong) == []


@pytest.mark.parametrize("room", [room for room in ARROWS if room != "cli"])
def test_only_the_command_imports_plots(room: str) -> None:
    assert imports_where(room, lambda _, name: name[0] == HERE and "plots" in name) == []


@pytest.mark.parametrize("folder", [*ARROWS, *OUTSIDE_THE_PACKAGE])
def test_module_names_say_what_they_are_about(folder: str) -> None:
    wrong = [m.name for m in modules_of(folder) if m.name in NAMES_THAT_SAY_NOTHING]

    assert not wrong, wrong


_WATCH = """
import json, logging, os, random, sys, threading, warnings
import locale, signal
with_numpy = {with_numpy}
if with_numpy:
    import numpy as np

def state():
    found = {{
        "environment": dict(os.environ),
        "handlers": [repr(h) for h in logging.getLogger().handlers],
        "log level": logging.getLogger().level,
        "warnings": [repr(f) for f in warnings.filters],
        "random": repr(hash(random.getstate())),
        "threads": threading.active_count(),
        "folder": os.getcwd(),
        "locale": repr(locale.getlocale()),
        "interrupt": repr(signal.getsignal(signal.SIGINT)),
        "exception hook": sys.excepthook is sys.__excepthook__,
        "files": sorted(os.listdir(os.path.expanduser("~"))),
    }}
    if with_numpy:
        found["numpy random"] = repr([str(part) for part in np.random.get_state()])
        found["numpy errors"] = repr(np.geterr())
        found["numpy printing"] = repr(np.get_printoptions())
    return found

before = state()
import {module}
after = state()
changed = [name for name in before if before[name] != after[name]]
tops = sorted({{name.split(".")[0] for name in sys.modules}})
print(json.dumps({{"modules": tops, "changed": changed}}))
"""


@pytest.fixture(
    scope="module",
    params=[
        ("facewright.core", True),
        ("facewright.core.camera, facewright.core.clip, facewright.core.mpeg4", True),
        ("facewright.cli.main", True),
        ("facewright.cli.main", False),
    ],
    ids=lambda param: f"{param[0].split(',')[0]}{'' if param[1] else ' alone'}",
)
def fresh_import(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, list[str]]:
    """What a fresh interpreter has loaded, and what has changed in it, after an import."""
    module, with_numpy = request.param
    home = tmp_path_factory.mktemp("home")
    done = subprocess.run(
        [sys.executable, "-c", _WATCH.format(module=module, with_numpy=with_numpy)],
        capture_output=True,
        text=True,
        cwd=home,
        env={**os.environ, "HOME": str(home), "PYTHONPATH": str(REPOSITORY)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, list[str]] = json.loads(done.stdout)
    found["not allowed"] = sorted(SLOW_MODULES if with_numpy else SLOW_MODULES | NOT_FOR_HELP)
    return found


def test_importing_is_light(fresh_import: dict[str, list[str]]) -> None:
    assert "facewright" in fresh_import["modules"]
    assert not set(fresh_import["not allowed"]) & set(fresh_import["modules"])


def test_importing_changes_no_global_state(fresh_import: dict[str, list[str]]) -> None:
    assert fresh_import["changed"] == []
