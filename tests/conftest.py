"""Fixtures that every room's tests may use."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from facewright.datasets_synthetic.film import FilmedTake, film_take, filmed_files
from facewright.datasets_synthetic.take_settings import TakeSettings, settings_with
from facewright.datasets_synthetic.takes import Take, make_take
from facewright.heads.appearance import Appearance
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head, random_identity

_REPOSITORY = Path(__file__).resolve().parents[1]
_FILMING_S = 300.0


@pytest.fixture(scope="session")
def repository() -> Path:
    """The root of the checkout."""
    return _REPOSITORY


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Recordings by other people, kept beside the checkout; the test is skipped without them."""
    folder = _REPOSITORY.parent / "shared" / "data" / "real"
    if not folder.is_dir():
        pytest.skip(f"real recordings are not on this machine (expected in {folder})")
    return folder


@pytest.fixture(scope="session")
def khronos_issues(repository: Path) -> Callable[[Path], dict[str, Any]]:
    """What the Khronos glTF validator says of a file; the test is skipped without it."""
    node = shutil.which("node")
    installed = repository / ".venv" / "node" / "node_modules" / "gltf-validator"
    folder = Path(os.environ.get("GLTF_VALIDATOR", installed))
    if node is None or not folder.is_dir():
        pytest.skip(
            "needs node and the npm package gltf-validator: npm install --prefix .venv/node "
            "gltf-validator, or GLTF_VALIDATOR=its folder"
        )
    script = (
        f"const v=require({json.dumps(str(folder.resolve()))});"
        "v.validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[1])))"
        ".then(r=>console.log(JSON.stringify(r.issues)))"
    )

    def issues(path: Path) -> dict[str, Any]:
        run = subprocess.run([node, "-e", script, str(path)], capture_output=True, check=True)
        found: dict[str, Any] = json.loads(run.stdout)
        return found

    return issues


@contextmanager
def plain_looks() -> Iterator[None]:
    """Heads made in this block are grey: painting takes a second each, and geometry no paint."""
    grey = Appearance(np.full((4, 4, 3), 128, np.uint8))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("facewright.heads.identity.make_appearance", lambda *_, **__: grey)
        yield


@pytest.fixture(scope="session")
def average_head() -> Head:
    """The average head, unpainted."""
    with plain_looks():
        return make_head(Identity("average"))


@pytest.fixture(scope="session")
def people() -> tuple[Head, ...]:
    """Thirty random adults, unpainted."""
    with plain_looks():
        return tuple(
            make_head(random_identity(np.random.default_rng(seed), f"person {seed}"))
            for seed in range(100, 130)
        )


@pytest.fixture(scope="session")
def make_plain_take() -> Callable[..., Take]:
    """`make_take` with an unpainted actor, and settings by their keys."""

    def make(seed: int, *, seconds: float, rate_hz: float = 60.0, **changes: object) -> Take:
        asked = {"seconds": seconds, "cameras.rate_hz": rate_hz, **changes}
        with plain_looks():
            return make_take(seed, settings_with(TakeSettings(), asked))

    return make


@pytest.fixture(scope="session")
def short_take(make_plain_take: Callable[..., Take]) -> Take:
    """Half a second: 0.3 s of rest, then the performance begins."""
    return make_plain_take(3, seconds=0.5)


@pytest.fixture(scope="session")
def filmed_take(short_take: Take, tmp_path_factory: pytest.TempPathFactory) -> FilmedTake:
    """`short_take` filmed by its four cameras, once for all workers."""
    base = tmp_path_factory.getbasetemp()
    # a worker's folder lies in the run's own, which the workers share
    folder = (base.parent if base.name.startswith("popen-") else base) / "filmed_take"
    done = folder / "done"
    try:
        folder.mkdir()
    except FileExistsError:
        end = time.monotonic() + _FILMING_S
        while not done.exists():
            assert time.monotonic() < end, "the other worker did not finish filming"
            time.sleep(0.1)
    else:
        film_take(short_take, folder)
        done.touch()
    return filmed_files(short_take, folder)
