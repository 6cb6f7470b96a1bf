"""``prc render`` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import Prc, Result
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


def refused(result: Result, code: int, *parts: str) -> None:
    assert result.code == code, result.err
    (line,) = result.err.strip().splitlines()
    for part in parts:
        assert part in line


def test_refusals_are_one_line_each(prc: Prc, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.png"
    np.save(tmp_path / "short.npy", np.full(100, 2, np.uint8))
    for options, code, parts in (
        (
            ["--steps", "coarse"],
            2,
            ["found 'coarse', which is no step", "possible here: range, intensity, classes"],
        ),
        (["--only", "9-12"], 2, ["--only: found '9-12', expected A:B"]),
        (["--only", "500:600"], 2, ["found 500:600, expected A:B within 0:137"]),
        (["--labels", tmp_path / "short.npy"], 1, ["found 100 labels, expected 24,660"]),
        (["--labels", tmp_path / "none.npy"], 1, ["none.npy: no such file"]),
        (["--steps", "top"], 1, ["no coordinates for a cloud"]),
        (["--steps", "top", "--only", "0:9"], 2, ["--only: belongs to lines and columns"]),
        (["--steps", "top,classes"], 2, ["--steps: found 'top,classes', expected top by itself"]),
        (
            ["--steps", "figure1", "--set", "method=sequential-angle"],
            2,
            ["--steps figure1: belongs to prc"],
        ),
        (
            ["--mapping", "nothing"],
            2,
            ["class mapping: found 'nothing', expected a .toml file or one of"],
        ),
    ):
        refused(prc(f"render {drive} {out} --quiet", *options), code, *parts)
        assert not out.exists()
    refused(
        prc(f"render {drive} {tmp_path}/a.jpg"),
        2,
        "expected .png; for a page to look around in: OUT.html",
    )
    refused(prc(f"render {drive} {drive}"), 2, "the output is the input itself")
    refused(prc(f"render {drive}"), 2, "prc render needs IN OUT")
    page = tmp_path / "b.html"
    refused(prc(f"render {drive} {page} --steps classes"), 2, "found a page to write")
    out.write_bytes(b"old")
    refused(prc(f"render {drive} {out}"), 2, "exists already", "--overwrite")
    assert prc(f"render {drive} {out} --overwrite").code == 0
