"""Each command once per mode, on the command line: output, exit code, files."""

import json
import os
import subprocess
import sys
from pathlib import Path

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
from tests.methods.fused.street_lines import BEAM, street_lines
from tests.patience import wait_until
from tests.streams.evidence.test_estimates import forest_lines
from tests.street import (
    POINTS_PER_LINE,
    street,
    write_raw,
)


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


def test_labels_of_a_bag_lie_beside_its_folder(tmp_path, monkeypatch):
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag_0.db3").touch()
    (bag / "metadata.yaml").touch()
    assert output_for(bag / "bag_0.db3") == tmp_path / "bag_labels.npy"
    monkeypatch.chdir(bag)  # which may be named by a dot
    assert output_for(Path("bag_0.db3")).resolve() == tmp_path / "bag_labels.npy"


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
