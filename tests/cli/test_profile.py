"""``prc classify --profile`` and ``--threads``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from prc_cli.cli import main
from tests.street import POINTS_PER_LINE, angles, street, write_raw

NADIR = "input.nadir=0"


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


def test_the_sequential_angle_method_has_its_own_stages(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "scan.npz", range_m=street(), angle_deg=np.rad2deg(angles()))
    source, output = tmp_path / "scan.npz", tmp_path / "a.npy"
    code = run("classify", source, output, "--method", "sequential-angle", "--profile", "-q", "--set", NADIR)
    told = capsys.readouterr().err
    assert code == 0, told
    for word in ("vertical lines", "angles", "coarse", "ground", "cars", "curbs", "classes"):
        assert word in told


@pytest.mark.parametrize("threads", ["0", "-1", "two"])
def test_threads_are_at_least_one(tmp_path: Path, capsys: pytest.CaptureFixture[str], threads: str) -> None:
    source = write_raw(tmp_path / "drive.bin", street())
    assert run("classify", source, tmp_path / "a.npy", "-M", POINTS_PER_LINE, "--threads", threads) != 0
    assert "threads" in capsys.readouterr().err
