"""Fixtures that every room's tests may use."""

from __future__ import annotations

from pathlib import Path

import pytest

_REPOSITORY = Path(__file__).resolve().parents[1]


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
