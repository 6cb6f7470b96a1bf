"""Archives for all tests of this folder, and copies to damage."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.faults.harness import FAST, Archive, make_archive, part_of


@pytest.fixture(scope="session")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    """All kinds of files."""
    return make_archive(tmp_path_factory.mktemp("faults"))


@pytest.fixture(scope="session")
def fast(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    if sys.platform != "linux":
        pytest.skip("processes are found through /proc")
    return make_archive(tmp_path_factory.mktemp("fast"), FAST)


@pytest.fixture
def few(fast: Archive, tmp_path: Path) -> Archive:
    return part_of(fast, tmp_path / "archive")
