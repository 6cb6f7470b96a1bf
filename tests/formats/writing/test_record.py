from __future__ import annotations

import json
from pathlib import Path

import pytest

from prc_cli import __version__
from tests.formats.common import run_record


def test_json_is_sorted_and_the_same_every_time() -> None:
    text = run_record().to_json()
    assert text == run_record().to_json()
    found = json.loads(text)
    assert list(found) == sorted(found)
    assert found["program"] == "prc-cli"
    assert found["version"] == __version__
    assert found["input"] == {"name": "drive.bin", "sha256": "00ff", "size": 17}
    assert found["stream"]["points_per_line"] == 20
    assert found["tally"]["n_not_finite"] == 3
    assert found["assumptions"] == [{"key": "input.lines", "value": "fixed", "why": "told so"}]
    assert text.endswith(b"}\n")


@pytest.mark.parametrize(
    ("value", "kept"),
    [
        ("trajectory:/home/a/drive.csv", "trajectory:drive.csv"),
        ("/data/x.las", "x.las"),
        ("C:\\scans\\x.las", "x.las"),
        ("trajectory:C:\\scans\\drive.csv", "trajectory:drive.csv"),
        (Path("/data/t.csv"), "t.csv"),
        ("trajectory:drive.csv", "trajectory:drive.csv"),
        ("time:48", "time:48"),
        ("", ""),
    ],
)
def test_folders_are_left_out(value: object, kept: str) -> None:
    found = json.loads(run_record(config={"input": {"range": [value]}}).to_json())
    assert found["config"]["input"]["range"] == [kept]


def test_short_form_is_json_and_names_what_it_left_out() -> None:
    record = run_record(config={"a": "x" * 1000}, notices=("y" * 1000,))
    assert record.to_json_within(10_000) == record.to_json()
    short = json.loads(record.to_json_within(2200))
    assert "config" not in short
    assert len(short["config_sha256"]) == 64
    assert short["complete"] is False
    assert short["notices"] == ["y" * 1000]
    shortest = json.loads(record.to_json_within(1400))
    assert "notices" not in shortest
    with pytest.raises(ValueError, match="even in short form, limit 10"):
        record.to_json_within(10)
