"""Confidence through the command line: written, evaluated, filtered by, drawn."""

import json


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
