"""One archive for all tests of this folder, and small copies of it to be harmed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.faults.harness import Archive, make_archive, part_of


@pytest.fixture(scope="session")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    if sys.platform != "linux":
        pytest.skip("processes are found through /proc")
    return make_archive(tmp_path_factory.mktemp("faults"))


@pytest.fixture
def few(archive: Archive, tmp_path: Path) -> Archive:
    return part_of(archive, tmp_path / "archive")
