"""``prc classify --profile`` and ``--threads``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from prc_cli.cli import main
from tests.street import POINTS_PER_LINE, street, write_raw

URBAN = ("--preset", "urban")


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    return int(stop.value.code or 0)


def test_a_profile_is_printed_on_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_raw(tmp_path / "drive.bin", street())
    assert (
        run("classify", source, tmp_path / "a.npy", "-M", POINTS_PER_LINE, "-q", "--profile", "--threads", 1, *URBAN)
        == 0
    )
    out, told = capsys.readouterr()
    assert out == ""
    for word in ("support", "background", "components", "reading", "writing", "fingerprint", "all else", "on 1 thread"):
        assert word in told


def test_a_profile_is_part_of_the_json_and_not_of_the_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = street()
    source = write_raw(tmp_path / "drive.bin", image)
    arguments = ("classify", source, tmp_path / "a.npy", "-M", POINTS_PER_LINE, "-q", "--json", *URBAN)
    assert run(*arguments, "--profile", "--threads", 2) == 0
    out, told = capsys.readouterr()
    assert told == ""
    found = json.loads(out)
    profile = found.pop("profile")
    assert found.pop("doubts") == []
    assert found == json.loads((tmp_path / "a.npy.prc.json").read_text())
    assert (profile["threads"], profile["shots"]) == (2, image.size)
    assert sum(row["cpu_s"] for row in profile["stages"]) == pytest.approx(profile["cpu_s"], rel=0.02)
    assert sum(row["share_of_cpu"] for row in profile["stages"]) == pytest.approx(1, rel=0.02)
    rates = [
        (row["mshots_per_cpu_s"], row["cpu_s"]) for row in profile["stages"] if row["mshots_per_cpu_s"] is not None
    ]
    assert rates
    for rate, cpu_s in rates:
        assert rate == pytest.approx(image.size / cpu_s / 1e6)
    # without it the record is the same
    assert run(*arguments, "--overwrite", "--threads", 1) == 0
    assert json.loads(capsys.readouterr().out) == {**found, "doubts": []}
