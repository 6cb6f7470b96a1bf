"""Each command once per mode, on the command line: output, exit code, files."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

from prc_cli.cli import report
from prc_cli.cli.next_step import output_for
from prc_cli.cli.output import print_facts
from prc_cli.config import load_config
from prc_cli.core.classes import Label
from prc_cli.jobs.classify import classify
from prc_cli.jobs.explain import explain
from prc_cli.methods.reasons import rule_of
from prc_cli.simulation.scanners import SCANNERS
from tests import patience
from tests.clouds import seen
from tests.jobs.test_transfer import Drive, N, write_las
from tests.methods.fused.street_lines import BEAM, street_lines
from tests.patience import wait_until
from tests.streams.evidence.test_estimates import forest_lines
from tests.street import (
    N_LINES,
    POINTS_PER_LINE,
    street,
    write_npz,
    write_raw,
)


@pytest.mark.parametrize("options", [(), ("-M", POINTS_PER_LINE - 1), ("-M", 7)])
def test_info_types_the_m_that_it_found(prc, tmp_path, options):
    """Where the number of records speaks against M, or none is given, the command to type has the
    estimate."""
    source = write_raw(tmp_path / "drive.bin", street())
    result = prc(f"info {source} --json", *options)
    printed = json.loads(result.out)
    assert (result.code, printed["classifiable"]) == (
        0,
        False,
    )  # the file was read: no is an answer
    words = printed["command"].split()
    assert words[-2:] == ["-M", str(POINTS_PER_LINE)]
    assert prc(*words[1:]).code == 0


@pytest.mark.slow
def test_info_doubts_what_classify_doubts_where_heights_explain_it(prc, tmp_path):
    """Ranges in feet beside heights in metres look like a leaning plane.

    PRC does not ask for directions.
    """
    made = tmp_path / "drive.laz"
    feet = tmp_path / "feet.laz"
    assert prc(f"simulate street {made} --lines 60 --seed 72 -q").code == 0
    points = laspy.read(made)
    points["range"] = points["range"] / 0.3048
    points.write(feet)
    printed = prc.json(f"info {feet}")
    assert printed["doubts"] == ["units", "method"]
    assert prc(f"classify {feet} {tmp_path}/o.npy -q").code == 4
    assert "--set input.range_scale=0.3048" in printed["command"]
    assert prc(*printed["command"].split()[1:], "-q").code == 0


def test_info_types_no_command_that_would_be_refused(prc, tmp_path):
    """An option that mends one finding does not help where another speaks against the input."""
    image = street().ravel()
    image[np.isnan(image)] = 500.0
    np.random.default_rng(3).shuffle(image)
    source = write_raw(tmp_path / "drive.bin", image.reshape(N_LINES, POINTS_PER_LINE))
    printed = json.loads(prc(f"info {source} --json -M {POINTS_PER_LINE}").out)
    assert set(printed["doubts"]) >= {"missing-code", "shot-order"}
    assert printed["command"] == ""


def test_info_goes_on_after_a_bad_file(prc, tmp_path):
    source = write_npz(tmp_path / "drive.npz", street())
    none = tmp_path / "none.bin"
    result = prc(f"info {none} {source} --json")
    reports = json.loads(result.out)
    assert result.code == 1
    assert "no such file" in reports[0]["error"]
    assert reports[1]["classifiable"] is True


@pytest.mark.slow
def test_demo_makes_every_file(prc, tmp_path):
    folder = tmp_path / "demo"
    folder.mkdir()
    for name in ("street.png", "street_report.html"):
        (folder / name).touch()
    result = prc(f"demo --output {folder}")
    assert result.code == 2
    assert "the folder contains files" in result.err
    result = prc(f"demo --all --output {folder} --lines 200 --json --overwrite")
    assert result.code == 0, result.err
    assert result.err.splitlines()[-1] == "next, with your own file: prc info FILE"
    evaluation = json.loads(result.out)
    # found: .89, .996, .88 and .95; .98 and .58; .99, .86 and .38; with seed 1 .88, .90 and .91 in
    # the forest
    assert list(evaluation) == ["default", "prc", "sequential-angle", "default, forest"]
    floors = {
        "prc": {"ground": 0.9, "building": 0.2},
        "default": {"noise": 0.7, "ground": 0.95, "building": 0.85, "vegetation": 0.6},
        "sequential-angle": {"horizontal": 0.9, "vertical": 0.75, "car": 0.25},
        "default, forest": {"ground": 0.8, "vegetation": 0.8, "stem": 0.85},
    }
    for method, least in floors.items():
        for name, recall in least.items():
            assert evaluation[method]["classes"][name]["recall"] > recall, (method, name)
            assert evaluation[method]["classes"][name]["precision"] > 0.6, (method, name)
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "street.npz",
        "street.npz.prc.json",
        "street.laz",
        "street.laz.prc.json",
        "street.png",
        "street.html",
        "street_report.html",
        "more",
    }
    more = {path.name for path in (folder / "more").iterdir()}
    assert more >= {"static_scan.laz", "forest.laz", "street_reference.npy", "street_path.csv"}
    page = (folder / "street_report.html").read_text(encoding="utf-8")
    assert "fused (--preset fused) · input street.npz" in page
    assert str(folder) not in page
    viewer = (folder / "street.html").read_text(encoding="utf-8")
    assert "height_above_ground" in viewer
    assert "no trajectory" not in viewer


def test_what_takes_long_is_explained(monkeypatch, capsys):
    monkeypatch.setattr(report, "COMPILING_S", 0.0)
    with report.compiling_note(quiet=False):
        wait_until(lambda: "compiles it" in capsys.readouterr().err)


def test_a_trajectory_starts_where_it_was_named(prc, tmp_path, monkeypatch):
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "run.toml").write_text('[input]\nrange = "trajectory:track.csv"\n')
    monkeypatch.chdir(tmp_path)
    shown = prc.json("config show --config conf/run.toml")
    assert (
        Path(shown["config"]["input"]["range"].partition(":")[2]) == tmp_path / "conf" / "track.csv"
    )
    option = ["--range", "trajectory:track.csv"]
    shown = prc.json("config show --config conf/run.toml", *option)
    assert shown["config"]["input"]["range"] == "trajectory:track.csv"


def test_signs_of_wrong_rules_are_warned_of(prc, tmp_path):
    rows = [f"{line},{column},{5 + column / 100}" for line in range(20) for column in range(30)]
    source = tmp_path / "drive.csv"
    source.write_text("\n".join(["scan_line,column,range", *rows]) + "\n")
    assert "warning" not in prc(f"classify {source} {tmp_path}/a.npy").err
    result = prc(f"classify {source} {tmp_path}/b.npy -M 27 -q")
    assert result.err.startswith("warning: unplaced: 10.0% of the records have no cell")
    assert (result.code, np.load(tmp_path / "b.npy").size) == (4, 600)
    result = prc(f"classify {source} {tmp_path}/b2.npy -M 20")
    assert (result.code, (tmp_path / "b2.npy").exists()) == (1, False)
    assert "33.3% of the records have no cell" in result.err
    assert "to accept it: --accept-doubt unplaced" in result.err
    result = prc(f"classify {source} {tmp_path}/b2.npy -M 20 --accept-doubt unplaced")
    assert (result.code, np.load(tmp_path / "b2.npy").size) == (0, 600)
    assert "warning" not in result.err


def test_what_speaks_against_a_stream_is_told_and_it_is_converted(prc, tmp_path):
    shuffled = np.random.default_rng(3).permuted(street(), axis=1)
    source = write_npz(tmp_path / "shuffled.npz", shuffled)
    result = prc(f"convert {source} {tmp_path}/out.npy --json -q")
    assert (
        result.code,
        np.array_equal(np.load(tmp_path / "out.npy"), shuffled, equal_nan=True),
    ) == (4, True)
    assert result.err.startswith("warning: shot-order: ")
    record = json.loads(result.out)
    assert record["doubts"][0]["verdict"] == "against"
    assert any(notice.startswith("doubt shot-order: ") for notice in record["notices"])
    names = [doubt["check"] for doubt in record["doubts"]]
    options = [part for name in names for part in ("--accept-doubt", name)]
    result = prc(f"convert {source} {tmp_path}/out.npy --overwrite -q", *options)
    assert (result.code, result.err) == (0, "")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A street, a forest, and a drive that is slow and then stands."""
    place = tmp_path_factory.mktemp("explain")
    ranges = street_lines(40, noise_m=0.0)[0]
    lines = np.concatenate([np.arange(8), np.arange(32, 128) // 4, np.full(40, 32)])
    noise = np.random.default_rng(3).normal(0, 0.002, (len(lines), len(BEAM)))
    for name, range_m in (
        ("street", street_lines(120)[0]),
        ("forest", forest_lines(120)),
        ("slow", ranges[lines] + noise),
    ):
        angle_deg = np.rad2deg(BEAM)
        np.savez(place / name, range_m=range_m.astype(np.float32), angle_deg=angle_deg)
    return place


CASES = [
    ("street", "urban"),
    ("street", "fused"),
    ("street", "street-scan"),
    ("street", None),
    ("forest", "forest"),
    ("forest", "fused-forest"),
    ("slow", "fused"),
]


def of_each(reasons: NDArray[np.uint8], seed: int) -> list[tuple[int, int]]:
    """Draw a shot of every reason."""
    rng = np.random.default_rng(seed)
    places = [np.argwhere(reasons == reason) for reason in np.unique(reasons)]
    return [tuple(there[rng.integers(len(there))].tolist()) for there in places]


def test_a_shot_is_explained_with_its_range_and_beam(prc, folder):
    with np.load(folder / "street.npz") as scan:
        range_m = scan["range_m"][3, 800]
    result = prc(f"explain {folder}/street.npz --at 3,800 --preset fused --set input.nadir=0")
    assert "street.npz: line 3, column 800: ground, code 2" in result.out
    assert f"record 5,303, range {range_m:.3f} m, 10.00 deg from straight down" in result.out


@pytest.mark.slow
@pytest.mark.parametrize("name, preset", CASES)
def test_class_and_rule_are_those_of_classify(folder, name, preset):
    options = {"input": {"nadir": 0.0}, "output": {"reason": True}}
    loaded = load_config(preset=preset, options=options)
    source = folder / f"{name}.npz"
    output = folder / f"{name}-{preset}.parquet"
    summary = classify(source, output, loaded, overwrite=True)
    table = pq.read_table(output)
    codes, reasons = (
        table[key].to_numpy().reshape(summary.counts.n_lines, -1) for key in ("class", "reason")
    )
    for line, column in of_each(reasons, 23):
        explanation = explain(source, line, column, loaded)
        assert explanation.code == codes[line, column], (line, column)
        assert explanation.reason == reasons[line, column]
        rule_name, rule = rule_of(explanation.reason)
        assert (explanation.rule, explanation.sentence, tuple(explanation.limits)) == (
            rule_name,
            rule.sentence,
            rule.limits,
        )
        assert rule_name != "unknown"
        assert (
            (explanation.range_m is None)
            == (explanation.label == Label.MISSING)
            == (not explanation.measures)
        )
        json.dumps(explanation.as_dict())


def test_a_profile_is_part_of_the_json_and_not_of_the_record(prc, tmp_path):
    image = street()
    source = write_raw(tmp_path / "drive.bin", image)
    command = f"classify {source} {tmp_path}/a.npy -M {POINTS_PER_LINE} -q --json"
    command += " --preset prc-2019-urban"
    result = prc(f"{command} --profile --threads 2")
    assert (result.code, result.err) == (0, "")
    printed = json.loads(result.out)
    profile = printed.pop("profile")
    assert printed.pop("doubts") == []
    assert printed == json.loads((tmp_path / "a.npy.prc.json").read_text())
    assert (profile["threads"], profile["shots"]) == (2, image.size)
    stages = profile["stages"]
    assert sum(row["cpu_s"] for row in stages) == pytest.approx(profile["cpu_s"], rel=0.02)
    assert sum(row["share_of_cpu"] for row in stages) == pytest.approx(1, rel=0.02)
    measured = [row for row in stages if row["mshots_per_cpu_s"] is not None]
    assert measured
    for row in measured:
        assert row["mshots_per_cpu_s"] == pytest.approx(image.size / row["cpu_s"] / 1e6)
    # without it the record is the same
    again = prc(f"{command} --overwrite --threads 1")
    assert json.loads(again.out) == {**printed, "doubts": []}


def test_outputs_are_whole_or_not_there(prc, tmp_path):
    source = write_npz(tmp_path / "street.npz", street())
    (tmp_path / "old.toml").write_text("", encoding="utf-8")
    result = prc(f"calibrate {source} -o {tmp_path}/old.toml")
    assert result.code == 2
    assert "exists already" in result.err
    assert prc(f"calibrate {source} -o {tmp_path}/old.toml --overwrite -q").code == 0
    assert load_config(tmp_path / "old.toml").sources
    result = prc(f"calibrate {source} -o {source} --overwrite")
    assert result.code == 2
    assert "inputs are never modified" in result.err


@pytest.mark.parametrize("output", [".", "sub"])
def test_a_file_is_written_into_a_folder(
    prc,
    tmp_path,
    output,
    monkeypatch,
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    drive = write_raw(tmp_path / "drive.bin", street())
    result = prc(f"classify {drive} {output} -M {POINTS_PER_LINE} --accept-doubt few-lines")
    assert result.code in (0, 4), result.err
    assert len(np.load(tmp_path / output / "drive.bin.labels.npy")) == street().size


def test_options_that_are_used_are_told(prc, tmp_path):
    source = write_npz(tmp_path / "drive.npz", 1000 * street())
    result = prc(f"classify {source} {tmp_path}/o.npy --set input.range_scale=0.001 -v")
    assert result.code in (0, 4)
    assert "input.range_scale" in result.err


@pytest.mark.slow
def test_classify_loads_no_library_that_the_input_does_not_need():
    """Each costs memory and time in every run."""
    code = (
        "import sys, prc_cli.cli.classify; "
        "print({'pyarrow', 'sqlite3', 'laspy', 'pye57', 'skimage', 'dask'} & set(sys.modules))"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert ended.stdout == "set()\n"


def test_a_folder_and_what_lies_beside_a_scan_name_the_file_to_give(prc, tmp_path, monkeypatch):
    bag = tmp_path / "bag"
    bag.mkdir()
    assert "this folder itself has no scan" in prc(f"info {bag}").err
    (bag / "bag_0.db3").write_bytes(b"SQLite format 3\0")
    assert "name a file in it" in prc(f"info {bag}").err
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    assert f"{bag / 'bag_0.db3'}: found no SQLite header" in prc(f"info {bag}").err
    assert output_for(bag / "bag_0.db3") == tmp_path / "bag_labels.npy"
    monkeypatch.chdir(bag)  # which may be named by a dot
    assert output_for(Path("bag_0.db3")).resolve() == tmp_path / "bag_labels.npy"
    assert prc(f"info {bag}/metadata.yaml").err.endswith(
        f"name the file beside it, {bag / 'bag_0.db3'}\n"
    )
    (bag / "bag_1.db3").write_bytes(b"SQLite format 3\0")
    assert prc(f"info {bag}").err.endswith(f"bag_0.db3, or {bag / 'bag_1.db3'}\n")
    drive = write_raw(tmp_path / "drive.bin", street())
    assert prc(f"info {tmp_path}").err.endswith(f"name a file in it, for example {drive}\n")
    (tmp_path / "os.json").write_text("{}")
    (tmp_path / "os.pcap").write_bytes(b"x")
    assert prc(f"info {tmp_path}/os.json").err.endswith(
        f"name the capture beside it, {tmp_path / 'os.pcap'}\n"
    )


def test_only_a_frame_is_read_as_a_frame(prc, tmp_path):
    frame = np.stack([*frame_xyz(), np.full(64 * 900, 0.3)], axis=1).astype("<f4")
    frame.tofile(tmp_path / "frame.bin")
    result = prc(f"classify {tmp_path}/frame.bin {tmp_path}/frame.laz --accept-doubt ground-below")
    assert "look like x, y, z and intensity of a frame" in result.err
    assert "points are in the order of the shots" in result.err
    assert "compare it" not in result.err
    ranges = street()
    np.abs(frame).tofile(tmp_path / "other.bin")
    (frame * np.array([1, 1, 1, 3e5], "<f4")).tofile(tmp_path / "third.bin")
    for path in (
        write_raw(tmp_path / "drive.bin", ranges),
        tmp_path / "other.bin",
        tmp_path / "third.bin",
    ):
        refused = prc(f"classify {path} {tmp_path}/labels.npy")
        assert refused.code == 1
        assert "no scan lines" in refused.err


def frame_xyz() -> np.ndarray:
    """Return a road and a round wall as 64 rings see them, ring after ring, (3, n)."""
    azimuth = np.tile(np.linspace(0.0, 2 * np.pi, 900, endpoint=False), 64)
    elevation = np.repeat(np.deg2rad(np.linspace(2.0, -24.8, 64)), 900)
    distance = np.minimum(
        20.0 / np.cos(elevation),
        np.where(elevation < 0, 1.7 / np.sin(np.maximum(-elevation, 1e-3)), 99),
    )
    return seen(distance, azimuth, elevation).T


def test_options_of_simulate_win_over_set_and_file(prc, tmp_path):
    (tmp_path / "a.toml").write_text(
        'lines = 30\n[scanner]\nname = "sick-push-broom"\nslant_deg = 5\n'
    )
    options = f"--config {tmp_path}/a.toml --set scanner.slant_deg=7 --set sight_m=20"
    options += " --set trajectory.speed_m_s=2"
    result = prc(f"simulate street {tmp_path}/a.npz {options} --json -q")
    table = json.loads(result.out)["config"]["simulation"]
    assert (table["lines"], table["scanner"]["slant_deg"]) == (30, 7.0)
    assert (table["scanner"]["points_per_line"], table["trajectory"]["speed_m_s"]) == (361, 2.0)


def test_printed_parameters_name_the_preset_of_every_table(prc, tmp_path):
    options = "--set scanner.name=profiler-1mhz --set scanner.slant_deg=30 --set scene.name=suburb"
    text = prc(f"simulate parameters street {options}").out
    assert [line for line in text.splitlines() if line.startswith("[")] == [
        "[scene]  # from: preset suburb",
        "[scanner]  # from: preset profiler-1mhz; changed: slant_deg",
        "[trajectory]  # from: preset car",
        "[classes]",
    ]
    (tmp_path / "a.toml").write_text(text)
    # a whole table is what it says, whatever the default would have been
    again = prc(f"simulate parameters street --config {tmp_path}/a.toml").out
    assert "[scene]  # from: preset suburb\n" in again
    assert "[scanner]\n" in again


def test_options_reach_the_transfer(prc, tmp_path):
    drive = Drive()
    rest = np.arange(N, dtype=np.uint32)
    extra = {"head": (rest % 3).astype(np.uint8), "segment_id": rest, "mine": drive.codes}
    labels = write_las(tmp_path / "labels.las", drive, np.arange(N), **extra)
    drive.time = drive.time + 100.0000004
    registered = write_las(
        tmp_path / "registered.las", drive, np.arange(N), head=(rest % 3).astype(np.uint8)
    )
    options = "--match time+head --tolerance 1e-6 --time-offset 100 --dimension mine"
    options += " --carry segment_id --min-matched 0.9"
    result = prc(f"transfer {labels} {registered} {tmp_path}/out.laz -q {options}")
    assert (result.code, result.err) == (0, "")
    las = laspy.read(tmp_path / "out.laz")
    assert np.array_equal(las.classification, drive.codes)
    assert np.array_equal(las["segment_id"], rest)
    result = prc(f"transfer {labels} {registered} {tmp_path}/other.las -q --time-offset 100")
    assert (result.code, result.err.count("\n")) == (1, 1)
    assert "--tolerance 1e-06" in result.err
    result = prc(
        f"transfer {labels} {registered} {tmp_path}/other.las -q --match "
        "record:head+no-return --min-matched 0.1",
    )
    assert result.code == 0


def test_transfer_with_a_layout(prc, tmp_path):
    drive = Drive()
    registered = write_las(tmp_path / "registered.las", drive, drive.registered())
    layout = tmp_path / "layout.toml"
    layout.write_text(
        '[layout]\nfields = [{name = "time", type = "f8"}, {name = "range", type = "f4"}]\n'
    )
    records = np.zeros(N, "<f8,<f4")
    records["f0"] = drive.time
    records.tofile(tmp_path / "drive.bin")
    np.save(tmp_path / "whole.npy", drive.codes)
    points = f"--points {tmp_path}/drive.bin --layout {layout}"
    result = prc(f"transfer {tmp_path}/whole.npy {registered} {tmp_path}/out.las -q {points}")
    assert (result.code, result.err) == (0, "")


@pytest.mark.parametrize("command", [("completion",), ("simulate", "parameters")])
def test_a_missing_choice_is_listed_in_one_line(prc, command):
    result = prc(*command)
    assert result.code == 2
    assert re.search(r"needs \{\w+\|[\w-]+\|[\w-]+\}; see prc", result.err)
    assert "\\n" not in result.err


def test_long_words_are_whole(capsys):
    print_facts([("file", "x" * 1000)])
    assert capsys.readouterr().out.count("x") == 1000


def test_names_of_scanners_are_whole_in_a_narrow_terminal():
    command = [sys.executable, "-m", "prc_cli", "simulate", "scanners"]
    narrow = {**os.environ, "COLUMNS": "60"}
    ended = patience.run(command, env=narrow, capture_output=True, text=True)
    assert {line.split()[1] for line in ended.stdout.splitlines() if line.startswith("│")} >= set(
        SCANNERS
    )
    assert "…" not in ended.stdout
