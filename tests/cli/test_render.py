"""``prc render`` on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import Prc
from tests.street import street, write_npz


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_npz(tmp_path / "drive.npz", street())


def test_a_picture_replaces_another_if_asked(prc: Prc, drive: Path, tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"old")
    assert prc(f"render {drive} {tmp_path}/a.png --overwrite").code == 0
