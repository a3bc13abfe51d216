"""The library as a user imports it: names, whatever came before, and what importing costs."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import facewright.capture as capture
from facewright.capture import ClockFit, Flash, find_flashes, synchronise
from facewright.core.audio import Audio

REPOSITORY = Path(__file__).resolve().parents[2]
FRAME_S = 1 / 60


def in_a_fresh_interpreter(code: str) -> object:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", f"import json, sys\n{code}"],
        capture_output=True, text=True, check=False, env={"PYTHONPATH": str(REPOSITORY)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_all_that_is_promised_is_there_and_typed() -> None:
    tree = ast.parse((REPOSITORY / "capture" / "__init__.py").read_text(encoding="utf-8"))
    typed = {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level
        for alias in node.names
    }

    assert typed == set(capture.__all__)
    assert len(capture.__all__) == len(typed)
    for name in capture.__all__:
        assert getattr(capture, name) is not None
    assert set(capture.__all__) <= set(dir(capture))
    with pytest.raises(AttributeError, match="no attribute 'calibrate_bored'"):
        capture.calibrate_bored  # type: ignore[attr-defined]  # noqa: B018


def test_importing_the_room_loads_nothing_heavy() -> None:
    loaded = in_a_fresh_interpreter(
        "import facewright.capture\nprint(json.dumps([m.split('.')[0] for m in sys.modules]))"
    )

    assert isinstance(loaded, list)
    assert not {"numpy", "cv2", "scipy", "numba"} & set(loaded)


@pytest.mark.parametrize("name", ["tsai", "synchronise"])
@pytest.mark.parametrize(
    "before",
    ["", "import facewright.capture.{0}", "from facewright.capture.{0} import {0}",
     "from facewright.capture import {0}", "import facewright.capture.rigs"],
)  # fmt: skip
def test_functions_are_not_hidden_by_their_modules(name: str, before: str) -> None:
    kinds = in_a_fresh_interpreter(
        f"{before.format(name)}\nimport facewright.capture as c\n"
        f"from facewright.capture.{name} import {name} as other\n"
        f"print(json.dumps([type(c.{name}).__name__, c.{name} is other]))"
    )

    assert kinds == ["function", True]


def lag(fit: ClockFit) -> float:
    return fit.offset_s


def test_one_entry_takes_sound_motion_and_light() -> None:
    rng = np.random.default_rng(4)
    sound = 0.2 * rng.standard_normal(4 * 16000)
    late = np.concatenate([np.zeros(1600), sound])
    a, b = (Audio(x.clip(-1, 1).astype(np.float32), 16000) for x in (sound, late))
    t = np.arange(240) * FRAME_S
    rates, phases = rng.uniform(2, 10, (2, 4)), rng.uniform(0, 6, (2, 4))

    def course(at: np.ndarray) -> np.ndarray:
        return np.asarray(np.sin(at[:, None, None] * rates + phases).sum(axis=2))

    def light(at: np.ndarray) -> np.ndarray:
        since = at - 1.003
        return np.asarray(50 * (1 + np.where(since >= 0, 3 * np.exp(-np.abs(since) / 0.03), 0)))

    noisy = [course(x) + rng.normal(0, 1e-3, (240, 2)) for x in (t, t - 0.25)]
    flashes = [find_flashes(x + o, light(x)) for x, o in ((t, 0.0), (t + 0.004, 0.5 - 0.004))]

    assert lag(synchronise(a, b)) == pytest.approx(0.1, abs=1e-4)
    assert lag(synchronise((t, noisy[0]), (t, noisy[1]))) == pytest.approx(0.25, abs=1e-3)
    assert lag(synchronise((t, light(t)), (t + 0.3, light(t)))) == pytest.approx(0.3, abs=1e-6)
    by_light = synchronise(*flashes, method="light")
    assert by_light.method == "flash light"
    assert lag(by_light) == pytest.approx(0.496, abs=1e-3)
    single: tuple[Flash, Flash] = (flashes[0][0], flashes[1][0])
    assert lag(synchronise(*single)) == pytest.approx(lag(synchronise(*flashes)), abs=1e-12)
    one = synchronise((t, noisy[0][:, 0]), (t, noisy[1][:, 0]), method="motion")
    assert one.method == "motion"


def test_recordings_that_do_not_go_together_are_refused() -> None:
    sound = Audio(np.full(16000, 0.1, np.float32), 16000)
    t = np.arange(60) * FRAME_S
    with pytest.raises(ValueError, match="one kind, got sound and brightness"):
        synchronise(sound, (t, t))
    with pytest.raises(ValueError, match="one of sound, motion, flash, light, not clap"):
        synchronise(sound, sound, method="clap")
    with pytest.raises(ValueError, match="sound cannot be synchronised by motion"):
        synchronise(sound, sound, method="motion")
    with pytest.raises(ValueError, match="signals cannot be synchronised by flash"):
        synchronise((t, np.ones((60, 2))), (t, np.ones((60, 2))), method="flash")
    with pytest.raises(ValueError, match=r"got \(60,\) and \(59, 2\)"):
        synchronise((t, np.ones((59, 2))), (t, np.ones((60, 2))))
    with pytest.raises(ValueError, match="a recording is Audio"):
        synchronise((), ())
