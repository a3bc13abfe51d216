"""What a stranger gets: the wheel, installed where there is no checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

ROOMS = (
    "core",
    "heads",
    "capture",
    "tracking",
    "speech",
    "retarget",
    "datasets_synthetic",
    "cli",
)


@dataclass(frozen=True)
class Installed:
    """A wheel in an environment of its own.

    Attributes
    ----------
    wheel : Path
    sources : Path
        The copy of the checkout that it was built from.
    before, after : frozenset of str
        What lay at the top of site-packages before and after the installation.
    site_packages : Path
    bin : Path
        Where the environment's programs are.
    """

    wheel: Path
    sources: Path
    before: frozenset[str]
    after: frozenset[str]
    site_packages: Path
    bin: Path


def run(*command: str | Path, cwd: Path) -> str:
    """Run a program outside the checkout, without its folders on the path; its stdout."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=environment,
        check=False,
    )
    assert done.returncode == 0, f"{command}: {done.stdout}\n{done.stderr}"
    return done.stdout


def copy_of_sources(repository: Path, target: Path) -> Path:
    """The files that git knows or would add: no caches, no build products."""
    listing = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=repository,
        capture_output=True,
        check=False,
    )
    if listing.returncode:
        pytest.skip("not a git checkout: which files belong to it is not known")
    for name in filter(None, os.fsdecode(listing.stdout).split("\0")):
        source = repository / name
        if not source.is_symlink() and not source.exists():
            continue  # deleted, and not yet told to git
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, target / name, follow_symlinks=False)
    return target


@pytest.fixture(scope="module")
def installed(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    sources = copy_of_sources(repository, tmp_path_factory.mktemp("sources"))
    folder = tmp_path_factory.mktemp("wheel")
    run(
        *(sys.executable, "-m", "build", "--wheel", "--no-isolation"),
        *("--outdir", folder / "dist", sources),
        cwd=folder,
    )
    [wheel] = (folder / "dist").glob("*.whl")

    environment = folder / "environment"
    venv.create(environment, with_pip=False, symlinks=True)
    paths = sysconfig.get_paths("venv", {"base": str(environment), "platbase": str(environment)})
    site_packages = Path(paths["purelib"])
    # our dependencies come from the running environment, after what this one has of its own
    (site_packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    before = frozenset(path.name for path in site_packages.iterdir())
    run(
        *(sys.executable, "-m", "pip", "--python", environment, "install"),
        *("--no-deps", "--no-index", "--quiet", wheel),
        cwd=folder,
    )
    after = frozenset(path.name for path in site_packages.iterdir())
    return Installed(wheel, sources, before, after, site_packages, Path(paths["scripts"]))


def files_of(sources: Path, room: str) -> set[str]:
    """What a room must bring: its modules, its data; as paths below ``facewright/``."""
    files = {p for p in (sources / room).rglob("*") if p.is_file()}
    wanted = {p for p in files if p.suffix == ".py" or "data" in p.relative_to(sources).parts}
    return {p.relative_to(sources).as_posix() for p in wanted}


def test_only_facewright_comes_to_the_top_of_site_packages(installed: Installed) -> None:
    new = installed.after - installed.before

    assert {name.partition("-")[0] for name in new} == {"facewright"}
    assert sorted(name.partition("-")[2].rpartition(".")[2] for name in new) == ["", "dist-info"]


@pytest.mark.parametrize("room", ROOMS)
def test_every_module_and_data_file_is_installed(installed: Installed, room: str) -> None:
    wanted = files_of(installed.sources, room)
    top = installed.site_packages / "facewright"

    assert f"{room}/__init__.py" in wanted
    assert {name for name in wanted if not (top / name).is_file()} == set()


def test_nothing_else_is_in_the_wheel(installed: Installed) -> None:
    wanted = {"facewright/__init__.py", "facewright/py.typed"}
    for room in ROOMS:
        wanted |= {f"facewright/{name}" for name in files_of(installed.sources, room)}

    with zipfile.ZipFile(installed.wheel) as archive:
        names = {n for n in archive.namelist() if ".dist-info/" not in n and not n.endswith("/")}

    assert names == wanted


def test_the_licence_comes_along(installed: Installed) -> None:
    [licence] = installed.site_packages.glob("facewright-*.dist-info/licenses/LICENSE")

    assert "Apache License" in licence.read_text()


def test_the_command_runs_outside_the_checkout(installed: Installed, tmp_path: Path) -> None:
    np.savez(tmp_path / "truth.npz", time_s=np.arange(4.0))
    facewright = installed.bin / "facewright"
    python = installed.bin / "python"

    origin = run(
        python, "-c", "import facewright.core; print(facewright.core.__file__)", cwd=tmp_path
    )
    shown = run(facewright, "info", "truth.npz", cwd=tmp_path)

    assert Path(origin.strip()).is_relative_to(installed.site_packages)
    assert "time_s" in shown


def test_the_tables_are_found_outside_the_checkout(installed: Installed, tmp_path: Path) -> None:
    code = "from facewright.core.mpeg4 import fap_table; print(len(fap_table()))"

    assert run(installed.bin / "python", "-c", code, cwd=tmp_path) == "68\n"


def test_a_page_is_made_outside_the_checkout(installed: Installed, tmp_path: Path) -> None:
    facewright = installed.bin / "facewright"
    if " view " not in run(facewright, "--help", cwd=tmp_path):
        pytest.skip("this version has no command `view`")
    code = (
        "from pathlib import Path\n"
        "import numpy as np\n"
        "from facewright.core.clip import Clip\n"
        "from facewright.core.formats.fap import write_fap\n"
        "wave = 500 * np.sin(np.arange(30) / 5)[:, None]\n"
        "write_fap(Path('jaw.fap'), Clip(np.arange(30) / 30, ('open_jaw',), wave))\n"
    )
    run(installed.bin / "python", "-c", code, cwd=tmp_path)

    run(facewright, "view", "jaw.fap", "--out", "page.html", cwd=tmp_path)

    assert "<html" in (tmp_path / "page.html").read_text(encoding="utf-8")[:1000].lower()
