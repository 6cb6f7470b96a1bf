"""``prc info`` of a registered cloud.

What was found, the path as an output, and a trajectory held against it.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from prc_cli.streams.trajectory import load_trajectory
from tests.streams.registered.corridor import (
    DURATION_S,
    EPSG,
    HEIGHT_M,
    LINES_HZ,
    SHOTS_HZ,
    make_corridor,
    stations,
    write_cloud,
    write_trajectory,
)

BEGIN_S = 100.0


@pytest.fixture(scope="module")
def corridor():
    return make_corridor(begin_s=BEGIN_S)


@pytest.fixture(scope="module")
def cloud(tmp_path_factory, corridor):
    return write_cloud(tmp_path_factory.mktemp("clouds") / "tile.las", corridor, epsg=EPSG)


def test_what_was_found_is_said(prc, cloud):
    result = prc(f"info {cloud} --range points")
    assert "\npath " in result.out
    said = " ".join(result.out.split())
    for words in (
        "m/s (median)",
        "m above the ground",
        "lines a second",
        "mm from their beams (median), 100% are on a beam",
        "are interpolated",
    ):
        assert words in said, words
    (figures,) = prc.json(f"info {cloud} --range points")["path_found"]["passes"]
    assert figures["lines_hz"] == pytest.approx(LINES_HZ, rel=2e-4)
    assert figures["shots_hz"] == pytest.approx(SHOTS_HZ, rel=1e-4)
    assert figures["points_per_line"] == SHOTS_HZ / LINES_HZ
    assert figures["height_m"] == pytest.approx(HEIGHT_M, abs=0.03)
    assert figures["length_m"] == pytest.approx(6.0 * DURATION_S, abs=2.0)
    assert figures["residual_m"] < 0.005


def test_nothing_is_reconstructed_unless_it_is_asked_for(
    prc,
    cloud,
    tmp_path,
    corridor,
    monkeypatch,
):
    def refuse(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr("prc_cli.streams.registered.drive.find_rotation", refuse)
    trajectory = write_trajectory(tmp_path / "true.csv", corridor)
    for words in ((), ("--range", f"trajectory:{trajectory}")):
        report = json.loads(prc(f"info {cloud}", *words, "--json").out)
        assert report["path_found"] is None
        assert report["comparisons"] == []


def off_m(path: Path, crs: str | None = None) -> float:
    trajectory = load_trajectory(path, crs=crs, source_crs_wkt=None, time_offset=0.0)
    return float(np.abs(trajectory.xyz_m - stations(trajectory.time_s - BEGIN_S)).max())


def test_the_path_is_written_with_its_uncertainty_and_read_again(prc, cloud, tmp_path):
    output = tmp_path / "path.csv"
    assert prc(f"info {cloud} --range points --path {output}").code == 0
    table = np.genfromtxt(output, delimiter=",", names=True)
    assert off_m(output) < 0.02
    assert 0.0 < np.median(table["sigma_x"]) < 0.01
    report = prc.json(f"info {cloud} --range trajectory:{output} --sort-by-time")
    assert not report["problem"]
    before = output.read_bytes()
    refused = prc(f"info {cloud} --range points --path {output}")
    assert refused.code == 2
    assert "--overwrite" in refused.err
    assert output.read_bytes() == before
    assert prc(f"info {cloud} --range points --path {output} --overwrite").code == 0


def test_the_path_as_sbet_is_read_by_the_definition_of_the_format(prc, cloud, tmp_path):
    output = tmp_path / "path.sbet"
    assert prc(f"info {cloud} --range points --path {output}").code == 0
    assert off_m(output, f"EPSG:{EPSG}") < 0.02
    records = np.fromfile(output, "<f8").reshape(-1, 17)
    assert (records[[0, -1], 0] - BEGIN_S) == pytest.approx([0.0, DURATION_S], abs=0.01)
    assert np.degrees(records[0, 1:3]) == pytest.approx([60.17, 24.91], abs=0.05)
    speed = np.hypot(records[:, 4], records[:, 5])
    assert np.median(speed) == pytest.approx(6.0, abs=1.0)
    # along x of the grid: nearly east, by the convergence of 1.8 degrees
    assert np.degrees(records[:, 9]) == pytest.approx(np.full(len(records), 88.2), abs=4.0)
    assert np.arctan2(records[:, 5], records[:, 4]) == pytest.approx(records[:, 9], abs=0.05)


@pytest.mark.parametrize(
    "name, words, code, said",
    [
        ("path.sbet", ("--range", "points"), 2, "--set input.trajectory_crs="),
        ("path.las", ("--range", "points"), 1, ".csv"),
        ("path.csv", (), 2, "--range points"),
        ("path.csv", ("--range", "points", "--check-path"), 2, "--range trajectory:FILE"),
    ],
)
def test_a_path_that_cannot_be_written_is_refused(
    prc,
    tmp_path,
    corridor,
    name,
    words,
    code,
    said,
):
    cloud = write_cloud(tmp_path / "local.las", corridor)
    result = prc(f"info {cloud}", *words, "--path", tmp_path / name)
    assert (result.code, said in result.err) == (code, True), result.err
    assert not (tmp_path / name).exists()
    assert [file.name for file in tmp_path.iterdir()] == ["local.las"]


def test_a_path_never_replaces_an_input(
    prc,
    cloud,
    tmp_path,
    corridor,
):
    trajectory = write_trajectory(tmp_path / "true.csv", corridor)
    before = trajectory.read_bytes()
    words = (
        "--range",
        f"trajectory:{trajectory}",
        "--check-path",
        "--path",
        trajectory,
        "--overwrite",
    )
    assert prc(f"info {cloud}", *words).code == 2
    assert trajectory.read_bytes() == before


def test_the_path_of_a_cloud_in_feet_is_in_feet(prc, corridor, tmp_path):
    foot = 1200 / 3937
    cloud = write_cloud(tmp_path / "feet.las", corridor, epsg=2263, metres=foot)
    output = tmp_path / "path.csv"
    assert prc(f"info {cloud} --range points --path {output}").code == 0
    table = np.genfromtxt(output, delimiter=",", names=True)
    xyz = np.stack([table[axis] for axis in "xyz"], axis=1)
    assert xyz * foot == pytest.approx(stations(table["time"] - BEGIN_S), abs=0.02)
    refused = prc(f"info {cloud} --range points --path {tmp_path}/path.sbet")
    assert refused.code == 2
    assert ".csv" in refused.err


def test_two_passes_are_one_path_with_a_gap(prc, tmp_path, monkeypatch):
    cloud = write_cloud(tmp_path / "two.las", make_corridor(begin_s=BEGIN_S, gap_s=60.0))
    output = tmp_path / "path.csv"
    report = prc.json(f"info {cloud} --range points --path {output}")
    assert len(report["path_found"]["passes"]) == 2
    assert report["written"] == [str(output)]
    # the directions of the beams are known for every pass
    assert report["method"] == "fused"
    table = np.genfromtxt(output, delimiter=",", names=True)
    assert sorted(set(table["pass"])) == [0, 1]
    again = prc.json(f"info {cloud} --range trajectory:{output} --sort-by-time")
    assert "gap" not in again["problem"]
    assert "outside" not in again["problem"]
    monkeypatch.setattr("prc_cli.cli.info.MOST_SHOWN", 1)
    out = prc(f"info {cloud} --range points").out
    assert "\npass 0 " in out
    assert "and 1 more" in out


def test_a_clock_that_differs_is_measured_and_the_command_that_mends_it_works(
    prc,
    cloud,
    tmp_path,
    corridor,
):
    trajectory = write_trajectory(tmp_path / "late.csv", corridor, clock_s=-0.25)
    words = ("info", cloud, "--range", f"trajectory:{trajectory}", "--check-path", "--json")
    report = json.loads(prc(*words).out)
    assert report["comparisons"][0]["clock_s"] == pytest.approx(0.25, abs=2e-3)
    assert "trajectory" in report["doubts"]
    option = next(word for word in report["command"].split() if "trajectory_time_offset" in word)
    mended = json.loads(prc(*words, "--set", option).out)
    assert "trajectory" not in mended["doubts"], mended["findings"][0]


def test_a_trajectory_of_the_scanner_in_the_same_clock_is_fine(
    prc,
    cloud,
    tmp_path,
    corridor,
):
    trajectory = write_trajectory(tmp_path / "true.csv", corridor)
    result = prc(f"info {cloud} --range trajectory:{trajectory} --check-path --checks")
    said = " ".join(result.out.split())
    assert "check: trajectory fine: the trajectory is the path of the points" in said


def test_other_coordinates_are_refused_with_the_command_that_does_without(
    prc,
    cloud,
    tmp_path,
    corridor,
):
    trajectory = write_trajectory(tmp_path / "moved.csv", corridor, moved_m=(1000.0, -500.0, 0.0))
    report = prc.json(f"info {cloud} --range trajectory:{trajectory} --check-path")
    assert "moved by x -1,000.0, y 500.0, z 0.0 m" in report["problem"]
    assert report["command"].endswith("--range points")
    assert not report["classifiable"]
