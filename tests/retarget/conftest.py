"""A head and its drive, built once."""

from __future__ import annotations

import pytest

from facewright.heads.head import Head
from facewright.heads.identity import Identity, make_head
from facewright.retarget.drive import HeadDrive


@pytest.fixture(scope="session")
def head() -> Head:
    return make_head(Identity("average"))


@pytest.fixture(scope="session")
def drive(head: Head) -> HeadDrive:
    return HeadDrive(head)
