"""``prc simulate`` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.test_commands import Prc

SMALL = ("--lines", "40", "--sight", "25", "--set", "scanner.points_per_line=200")


@pytest.fixture
def prc(capsys: pytest.CaptureFixture[str]) -> Prc:
    return Prc(capsys)


def test_a_street_is_written_classified_and_evaluated(prc: Prc, tmp_path: Path) -> None:
    out = tmp_path / "drive.laz"
    result = prc("simulate", "street", "-o", out, "--seed", "7", *SMALL, "--trajectory", tmp_path / "drive.csv")
    assert (result.code, result.out) == (0, "")
    assert "40 lines of 200 shots" in result.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.csv", "drive.laz", "drive.laz.prc.json"]
    assert prc("classify", out, tmp_path / "labels.npy", "--preset", "urban", "-q").code == 0
    assert prc("evaluate", tmp_path / "labels.npy", out, "--mapping", "prc").code == 0


def test_the_forest_lists_its_stems(prc: Prc, tmp_path: Path) -> None:
    result = prc(
        "simulate", "forest", "-o", tmp_path / "walk.npz", *SMALL, "--stems", tmp_path / "stems.csv",
        "--scene", "pine-heath", "--reference", "cylinders", "-q",
    )  # fmt: skip
    assert (result.code, result.out, result.err) == (0, "", "")
    assert (tmp_path / "stems.csv").read_text().startswith("species,")


def test_json_tells_the_parameters_and_the_files(prc: Prc, tmp_path: Path) -> None:
    out = tmp_path / "station.e57"
    options = ("--set", "scanner.azimuth_step_deg=9", "--set", "station.along_m=30", "--noise", "0.02", "--json", "-q")
    result = prc("simulate", "street-scan", "-o", out, *SMALL, *options)
    assert (result.code, result.err) == (0, "")
    found = json.loads(result.out)
    table = found["config"]["simulation"]
    assert (table["scanner"]["noise_m"], table["station"]["along_m"]) == (0.02, 30.0)
    assert [Path(name).name for name in found["files"]] == [
        "station.e57", "station.e57.prc.json", "station_reference.npy",
    ]  # fmt: skip
    assert len(np.load(tmp_path / "station_reference.npy")) == 40 * 200


def test_options_win_over_set_and_file(prc: Prc, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('lines = 30\n[scanner]\nname = "sick-push-broom"\nslant_deg = 5\n')
    options = ("--config", tmp_path / "a.toml", "--set", "scanner.slant_deg=6", "--mount-slant", "7", "--speed", "2")
    result = prc("simulate", "street", "-o", tmp_path / "a.npz", *options, "--sight", "20", "--json", "-q")
    table = json.loads(result.out)["config"]["simulation"]
    assert (table["lines"], table["scanner"]["slant_deg"]) == (30, 7.0)
    assert (table["scanner"]["points_per_line"], table["trajectory"]["speed_m_s"]) == (361, 2.0)


def test_the_scanners_are_listed(prc: Prc) -> None:
    result = prc("simulate", "scanners")
    assert result.code == 0
    for text in ("photon-80", "2,154", "focus3d-120", "scanstation2", "static, pulse"):
        assert text in result.out
    assert json.loads(prc("simulate", "scanners", "--json").out)["photon-80"]["line_hz"] == 48.0


@pytest.mark.parametrize("kind", ["street", "forest", "street-scan"])
def test_printed_parameters_are_read_back(prc: Prc, tmp_path: Path, kind: str) -> None:
    result = prc("simulate", "parameters", kind, "--set", "seed=9")
    assert (result.code, result.err) == (0, "")
    assert "# range noise close by, standard deviation [m]" in result.out
    (tmp_path / "a.toml").write_text(result.out)
    assert prc("simulate", "parameters", kind, "--config", tmp_path / "a.toml").out == result.out
    assert "\n#" not in prc("simulate", "parameters", kind, "--bare").out


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


@pytest.mark.parametrize("command", [(), ("simulate",)])
def test_a_group_alone_shows_its_help(prc: Prc, command: tuple[str, ...]) -> None:
    result = prc(*command)
    shown = (result.out + result.err).splitlines()
    assert shown[0].startswith("Usage: prc")
    assert "Commands:" in shown
    assert not any(line.startswith("error") for line in shown)


def test_help_tells_what_a_scene_is(prc: Prc) -> None:
    for kind, said in (("street", "stands along the street"), ("forest", "kind of forest")):
        assert said in " ".join(prc("simulate", kind, "--help").out.split())


def test_bad_input_is_one_line(prc: Prc, tmp_path: Path) -> None:
    (tmp_path / "there.npz").write_text("mine")
    for options, code, said in (
        (["street", "-o", tmp_path / "a.xyz"], 2, "found suffix '.xyz', expected one of .bin"),
        (["street", "-o", tmp_path / "there.npz"], 2, "exists already"),
        (["street", "-o", tmp_path / "none" / "a.npz"], 1, "output folder does not exist"),
        (["street", "-o", tmp_path / "a.npz", "--trajectory", tmp_path / "w.txt"], 2, ".csv or .sbet or .out"),
        (["forest", "-o", tmp_path / "a.npz", "--stems", tmp_path / "s.txt"], 2, "found suffix '.txt', expected .csv"),
        (["street"], 2, "Missing option '-o'"),
        (["street", "-o", tmp_path / "a.npz", "--length", "5", "--lines", "3"], 2, "--length and --lines contradict"),
        (["street", "-o", tmp_path / "a.npz", "--scanner", "scanstation2"], 2, "is not one of 'photon-80'"),
        (["street", "-o", tmp_path / "a.npz", "--set", "scene.tree=1"], 2, "did you mean 'trees'?"),
        (["street", "-o", tmp_path / "a.npz", "--set", "scene.trees=9"], 2, "see `prc simulate parameters street`"),
        (["meadow", "-o", tmp_path / "a.npz"], 2, "No such command 'meadow'"),
    ):
        result = prc("simulate", *options)
        assert (result.code, result.err.count("\n")) == (code, 1), result.err
        assert said in result.err
    assert [path.name for path in tmp_path.iterdir()] == ["there.npz"]
