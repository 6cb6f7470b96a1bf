"""Confidence through the command line: written, evaluated, filtered by, drawn."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import Prc
from tests.methods.fused.street_lines import BEAM, BUILDING, GROUND, street_lines

RANGES, KIND = street_lines(140)
THERE = ~np.isnan(RANGES.ravel())
SET = ("--preset", "fused", "--set", "output.confidence=true", "--set", "input.nadir=0", "-q")


@pytest.fixture
def folder(tmp_path):
    """A scan and its reference."""
    np.savez(tmp_path / "scan.npz", range_m=RANGES, angle_deg=np.rad2deg(BEAM))
    codes = np.select([np.isnan(RANGES), KIND == GROUND, KIND == BUILDING], [0, 2, 6], 5)
    np.save(tmp_path / "truth.npy", codes.ravel().astype(np.uint8))
    return tmp_path


def classified(prc: Prc, folder: Path, suffix: str) -> Path:
    """Classify the scan with confidence."""
    output = folder / f"out{suffix}"
    assert prc(f"classify {folder}/scan.npz {output}", *SET).code == 0
    return output


def values(path: Path) -> np.ndarray:
    """Return the column of a .csv."""
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=3)


def test_evaluate_tells_how_reliable_it_is(prc, folder):
    labels = classified(prc, folder, ".csv")
    command = ("evaluate", labels, folder / "truth.npy", "--mapping", "street")
    shown = prc(*command, "--by", "confidence:50,90,99")
    assert shown.code == 0
    for text in (
        "by confidence",
        "50-89 %",
        "99-100 %",
        "expected calibration error",
        "of the 90 % with the most",
    ):
        assert text in shown.out
    evaluation = prc.json(*command, "--by", "confidence:50,90,99")
    sure = values(labels)
    parts = evaluation["splits"]["confidence"]
    assert [part["low"] for part in parts] == [0, 50, 90, 99]
    assert sum(part["n_scored"] for part in parts) == THERE.sum()
    assert parts[-1]["n_scored"] == (sure >= 99).sum()


def test_evaluate_without_it(prc, folder):
    np.save(folder / "labels.npy", np.load(folder / "truth.npy"))
    result = prc(f"evaluate {folder}/labels.npy {folder}/truth.npy --by confidence:90")
    assert result.code == 2
    assert "no confidence in" in result.err
    assert "output.confidence=true" in result.err
    result = prc(f"evaluate {folder}/labels.npy {folder}/truth.npy --by confidence:90,80")
    assert (result.code, "expected increasing percentages" in result.err) == (2, True)


def test_thin_drops_what_is_not_sure(prc, folder):
    labels = classified(prc, folder, ".csv")
    least = ("--min-confidence", "95", "--keep", "noise=1")
    result = prc(f"thin {folder}/scan.npz {folder}/thin.npz --labels {labels}", *least)
    assert result.code == 0
    assert "confidence below 95 %" in result.err
    kept = ~np.isnan(np.load(folder / "thin.npz")["range_m"]).ravel()
    np.testing.assert_array_equal(kept, values(labels) >= 95)
    way = ("--preset", "fused", "--set", "input.nadir=0", "-q")
    # a preset decides, whatever classes are there
    marked = {**np.load(folder / "scan.npz"), "class": np.full(RANGES.shape, 7)}
    np.savez(folder / "marked.npz", **marked)
    for name in ("scan", "marked"):
        out = folder / f"{name}_way.npz"
        assert prc(f"thin {folder}/{name}.npz {out}", *way, *least).code == 0
        np.testing.assert_array_equal(~np.isnan(np.load(out)["range_m"]).ravel(), kept)
    assert prc(f"thin {folder}/marked.npz {folder}/no.npz").code == 2
    for options, expected_words in (
        (("--labels", folder / "truth.npy"), "output.confidence=true"),
        (("--preset", "prc-2019-urban"), "expected fused"),
    ):
        refused = prc(f"thin {folder}/scan.npz {folder}/no.npz", *options, *least)
        assert (refused.code, expected_words in refused.err) == (2, True)
        assert not (folder / "no.npz").exists()


def test_the_most_confident_of_a_real_strip_are_right(prc, real_data, tmp_path):
    strip = real_data / "oakland" / "oakland_1.csv.gz"
    labels = tmp_path / "labels.csv"
    options = ("--preset", "fused", "--set", "output.confidence=true", "-q")
    assert prc(f"classify {strip} {labels}", *options).code == 0
    command = ("evaluate", labels, strip, "--mapping", "street_oakland", "--json")
    every = json.loads(prc(*command).out)["overall"]["accuracy"]
    _, sure = json.loads(prc(*command, "--by", "confidence:98").out)["splits"]["confidence"]
    assert sure["n_scored"] > 30_000
    assert 1 - sure["overall"]["accuracy"] < (1 - every) / 4
