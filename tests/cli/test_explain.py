"""``prc explain``: class and rule are those that ``prc classify`` writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

from prc_cli.config import load_config
from prc_cli.core.classes import Label
from prc_cli.jobs.classify import classify
from prc_cli.jobs.explain import explain
from prc_cli.methods.reasons import rule_of
from prc_cli.simulation.settings import Kind
from tests.cli.test_commands import Prc
from tests.methods.fused.street_lines import BEAM, street_lines


@pytest.fixture
def prc(capsys: pytest.CaptureFixture[str]) -> Prc:
    return Prc(capsys)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("explain")
    from prc_cli.jobs.simulate import simulate
    from prc_cli.simulation.settings import load_settings

    scans: dict[str, tuple[Kind, dict[str, object]]] = {
        "street": ("street", {"lines": 160, "seed": 21, "scanner": {"points_per_line": 720}}),
        "static": (
            "street-scan",
            {"seed": 22, "scanner": {"azimuth_step_deg": 1.5, "points_per_line": 313}, "station": {"turn_deg": 120.0}},
        ),
        "forest": (
            "forest", {"lines": 150, "sight_m": 20.0, "seed": 931, "scanner": {"points_per_line": 712}},
        ),
    }  # fmt: skip
    for name, (kind, options) in scans.items():
        simulate(kind, place / f"{name}.npz", load_settings(kind, options=options))
    ranges, _ = street_lines(40, noise_m=0.0)
    lines = np.concatenate([np.arange(8), np.arange(32, 128) // 4, np.full(40, 32)])  # slow, then standing
    noise = np.random.default_rng(3).normal(0, 0.002, (len(lines), len(BEAM)))
    np.savez(place / "slow.npz", range_m=(ranges[lines] + noise).astype(np.float32), angle_deg=np.rad2deg(BEAM))
    return place


CASES = [
    ("street", "urban"), ("street", "fused"), ("street", "street-scan"), ("street", None), ("static", "street-scan"),
    ("forest", "forest"), ("forest", "fused-forest"), ("forest", "urban"), ("slow", "fused"),
]  # fmt: skip


def of_each(reasons: NDArray[np.uint8], seed: int) -> list[tuple[int, int]]:
    """Draw a shot of every reason."""
    rng = np.random.default_rng(seed)
    places = [np.argwhere(reasons == reason) for reason in np.unique(reasons)]
    return [tuple(there[rng.integers(len(there))].tolist()) for there in places]


@pytest.mark.parametrize(("name", "preset"), CASES)
def test_class_and_rule_are_those_of_classify(folder: Path, name: str, preset: str | None) -> None:
    given: dict[str, object] = {"nadir": 0.0} if (name, preset) == ("street", "street-scan") else {}
    loaded = load_config(preset=preset, options={"input": {**given}, "output": {"reason": True}})
    source, output = folder / f"{name}.npz", folder / f"{name}-{preset}.parquet"
    summary = classify(source, output, loaded, overwrite=True)
    table = pq.read_table(output)
    codes, reasons = (table[key].to_numpy().reshape(summary.counts.n_lines, -1) for key in ("class", "reason"))
    for line, column in of_each(reasons, 23):
        told = explain(source, line, column, loaded)
        assert told.code == codes[line, column], (line, column)
        assert told.reason == reasons[line, column]
        rule_name, rule = rule_of(told.reason)
        assert (told.rule, told.sentence, tuple(told.limits)) == (rule_name, rule.sentence, rule.limits)
        assert rule_name != "unknown"
        assert (told.range_m is None) == (told.label == Label.MISSING) == (not told.measures)
        json.dumps(told.as_dict())


def test_a_table_and_json(prc: Prc, folder: Path) -> None:
    result = prc("explain", folder / "street.npz", "--at", "100,300", "--preset", "urban")
    assert result.code == 0, result.err
    assert "decided by" in result.out
    assert "supported in its line from zeta_p [m]" in result.out
    found = json.loads(prc("explain", folder / "street.npz", "--at", "100,300", "--json").out)
    assert found["method"] == "fused"
    assert found["chosen"]["preset"] == "fused"
    assert found["record"] == 100 * 720 + 300
    assert found["limits"]
    assert found["measures"]["near neighbours, of 28"] <= 28


@pytest.mark.parametrize(
    ("place", "code", "said"),
    [
        ("900,3", 1, "found lines 0 to 159, expected line 900"),
        ("3,900", 1, "found column 900, expected 0 to 719"),
        ("3", 2, "found '3', expected LINE,COLUMN"),
        ("-3,5", 2, "found '-3,5', expected LINE,COLUMN"),
    ],
)
def test_places_that_are_not_there(prc: Prc, folder: Path, place: str, code: int, said: str) -> None:
    result = prc("explain", folder / "street.npz", "--at", place, "--preset", "urban")
    assert result.code == code
    assert said in result.err


def test_scanners_have_lines_of_their_own(prc: Prc, folder: Path) -> None:
    result = prc("explain", folder / "street.npz", "--at", "3,5", "--preset", "urban", "--station", "4")
    assert result.code == 1
    assert "found scanners 0, expected 4" in result.err
