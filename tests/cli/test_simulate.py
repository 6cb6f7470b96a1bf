"""``prc simulate`` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.test_commands import Prc


@pytest.fixture
def prc(capsys: pytest.CaptureFixture[str]) -> Prc:
    return Prc(capsys)


def test_options_win_over_set_and_file(prc: Prc, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('lines = 30\n[scanner]\nname = "sick-push-broom"\nslant_deg = 5\n')
    options = ("--config", tmp_path / "a.toml", "--set", "scanner.slant_deg=6", "--mount-slant", "7", "--speed", "2")
    result = prc("simulate", "street", tmp_path / "a.npz", *options, "--sight", "20", "--json", "-q")
    table = json.loads(result.out)["config"]["simulation"]
    assert (table["lines"], table["scanner"]["slant_deg"]) == (30, 7.0)
    assert (table["scanner"]["points_per_line"], table["trajectory"]["speed_m_s"]) == (361, 2.0)


def test_printed_parameters_name_the_preset_of_every_table(prc: Prc, tmp_path: Path) -> None:
    options = ("--set", "scanner.name=profiler-1mhz", "--set", "scanner.slant_deg=30", "--set", "scene.name=suburb")
    text = prc("simulate", "parameters", "street", *options).out
    assert [line for line in text.splitlines() if line.startswith("[")] == [
        "[scene]  # from: preset suburb",
        "[scanner]  # from: preset profiler-1mhz; changed: slant_deg",
        "[trajectory]  # from: preset car",
        "[classes]",
    ]
    (tmp_path / "a.toml").write_text(text)
    # a whole table is what it says, whatever the default would have been
    again = prc("simulate", "parameters", "street", "--config", tmp_path / "a.toml").out
    assert "[scene]  # from: preset suburb\n" in again
    assert "[scanner]\n" in again


def test_bad_input_is_one_line(prc: Prc, tmp_path: Path) -> None:
    (tmp_path / "there.npz").write_text("mine")
    for options, code, said in (
        (["street", tmp_path / "a.xyz"], 2, "found suffix '.xyz', expected one of .bin"),
        (["street", tmp_path / "there.npz"], 2, "exists already"),
        (["street", tmp_path / "none" / "a.npz"], 1, "output folder does not exist"),
        (["street", tmp_path / "a.npz", "--trajectory", tmp_path / "w.txt"], 2, ".csv or .sbet or .out"),
        (["forest", tmp_path / "a.npz", "--stems", tmp_path / "s.txt"], 2, "found suffix '.txt', expected .csv"),
        (["street"], 2, "Missing argument 'OUT'"),
        (["street", tmp_path / "a.npz", "--length", "5", "--lines", "3"], 2, "--length and --lines contradict"),
        (["street", tmp_path / "a.npz", "--scanner", "scanstation2"], 2, "is not one of 'photon-80'"),
        (["street", tmp_path / "a.npz", "--set", "scene.tree=1"], 2, "did you mean 'trees'?"),
        (["street", tmp_path / "a.npz", "--set", "scene.trees=9"], 2, "see `prc simulate parameters street`"),
        (["meadow", tmp_path / "a.npz"], 2, "No such command 'meadow'"),
    ):
        result = prc("simulate", *options)
        assert (result.code, result.err.count("\n")) == (code, 1), result.err
        assert said in result.err
    assert [path.name for path in tmp_path.iterdir()] == ["there.npz"]
