"""Strange actors: altered as much as is said, and still whole."""

from __future__ import annotations

import numpy as np
import pytest

from facewright.datasets_synthetic.face_motion import FaceMotion
from facewright.datasets_synthetic.strangeness import FORM_MM, strange_head
from facewright.datasets_synthetic.take_settings import TakeSettings, settings_with
from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head
from facewright.heads.template import load_template


@pytest.fixture(scope="module")
def head() -> Head:
    return make_head(Identity("someone"), texture_px=256)


def test_strangeness_0_is_the_same_head(head: Head) -> None:
    assert strange_head(head, np.random.default_rng(0), 0.0) is head


def test_forms_lie_outside_the_identities_and_shapes_differ_by_what_is_said(head: Head) -> None:
    strange = strange_head(head, np.random.default_rng(3), 1.0)

    template, skin = load_template(), head.part_vertices("skin")
    moved = strange.mesh.vertices - head.mesh.vertices
    targets = template.identity.toarray().reshape(len(template.identity_names), 3, -1)
    A = targets[:, :, skin].reshape(len(targets), -1).T
    b = moved[skin].T.ravel()
    left = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]

    assert np.sqrt((moved[skin] ** 2).sum(axis=1).mean()) == pytest.approx(FORM_MM, rel=1e-6)
    assert np.linalg.norm(left) > 0.4 * np.linalg.norm(b)
    assert head.shapes is not None and strange.shapes is not None
    smile = head.shape_names.index("mouthSmileLeft")
    off = np.linalg.norm(strange.shapes[smile] - head.shapes[smile])
    assert 0.15 < off / np.linalg.norm(head.shapes[smile]) < 0.6


def test_a_strange_face_still_closes_its_mouth_and_its_eyes(head: Head) -> None:
    strange = strange_head(head, np.random.default_rng(5), 1.0)
    motion = FaceMotion(strange)
    blink = np.zeros(len(strange.shape_names))
    blink[[strange.shape_names.index(f"eyeBlink{s}") for s in ("Left", "Right")]] = 1.0

    shut = strange.feature_points.at(motion.vertices(blink))
    names = strange.feature_points.names
    gap = shut[names.index("3.1"), 1] - shut[names.index("3.3"), 1]
    lips = [h.points["2.2"][1] - h.points["2.3"][1] for h in (head, strange)]

    assert abs(gap) < 1.0
    assert abs(lips[1] - lips[0]) < 0.3


def test_strangeness_is_a_setting_of_takes() -> None:
    settings = settings_with(TakeSettings(), {"actor.strangeness": 1.0})

    assert settings.actor.strangeness == 1.0
