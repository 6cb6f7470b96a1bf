"""Archives for all tests of this folder, and copies to damage."""

import sys

import pytest

from tests.faults.harness import FAST, make_archive, part_of


@pytest.fixture(scope="session")
def archive(tmp_path_factory):
    """All kinds of files."""
    return make_archive(tmp_path_factory.mktemp("faults"))


@pytest.fixture(scope="session")
def fast(tmp_path_factory):
    if sys.platform != "linux":
        pytest.skip("processes are found through /proc")
    return make_archive(tmp_path_factory.mktemp("fast"), FAST)


@pytest.fixture
def few(fast, tmp_path):
    return part_of(fast, tmp_path / "archive")
