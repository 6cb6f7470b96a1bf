"""``prc render`` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Prc
from tests.street import street, write_npz


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_npz(tmp_path / "drive.npz", street())


def test_a_page_to_look_into(prc: Prc, drive: Path, tmp_path: Path) -> None:
    result = prc(f"render {drive} {tmp_path}/a.html --json")
    assert result.code == 0, result.err
    record = json.loads(result.out)
    assert record["files"] == [str(tmp_path / "a.html")]
    assert "drive.npz · preset fused · all 137 lines" in result.err
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "<h1>drive.npz</h1>" in page
    assert "http://" not in page
    assert "https://" not in page


def test_a_picture_replaces_another_if_asked(prc: Prc, drive: Path, tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"old")
    assert prc(f"render {drive} {tmp_path}/a.png --overwrite").code == 0
