"""Confidence through the command line: written, evaluated, filtered by, drawn."""

import json

import numpy as np

from tests.methods.fused.street_lines import BEAM, BUILDING, GROUND, street_lines


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


def test_parts_and_thinned_scans_go_by_the_column_of_confidence(prc, tmp_path):
    ranges, kind = street_lines(140)
    np.savez(tmp_path / "scan.npz", range_m=ranges, angle_deg=np.rad2deg(BEAM))
    codes = np.select([np.isnan(ranges), kind == GROUND, kind == BUILDING], [0, 2, 6], 5)
    np.save(tmp_path / "truth.npy", codes.astype(np.uint8).ravel())
    labels = tmp_path / "labels.csv"
    scan = f"{tmp_path}/scan.npz"
    way = "--preset fused --set input.nadir=0 -q"
    assert prc(f"classify {scan} {labels} {way} --set output.confidence=true").code == 0
    sure = np.loadtxt(labels, delimiter=",", skiprows=1, usecols=3).reshape(ranges.shape)
    parts = prc.json(f"evaluate {labels} {tmp_path}/truth.npy --by confidence:50,95")["splits"]
    there = np.isfinite(ranges)
    counts = np.histogram(sure[there], [0, 50, 95, 101])[0]
    assert [part["n_scored"] for part in parts["confidence"]] == counts.tolist()
    for name, taken in (("stored", f"--labels {labels}"), ("again", way)):
        out = tmp_path / f"{name}.npz"
        assert prc(f"thin {scan} {out} {taken} --min-confidence 95 --keep noise=1").code == 0
        np.testing.assert_array_equal(np.load(out)["range_m"], np.where(sure >= 95, ranges, np.nan))
