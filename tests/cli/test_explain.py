"""``prc explain``: the class is the one that ``prc classify`` writes, and the answers lead to it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.cli.report import results
from prc_cli.config import load_config
from prc_cli.core.classes import Label
from prc_cli.jobs.classify import classify
from prc_cli.jobs.explain import Explanation, explain
from prc_cli.methods.fused import pipeline
from prc_cli.methods.fused.thresholds import NEVER, STREET, Forest, Limits
from prc_cli.simulation.settings import Kind
from tests.cli.test_commands import Prc
from tests.methods.fused.street_lines import BEAM, street_lines

SHOTS = 6


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


def of_each_class(codes: np.ndarray, seed: int) -> list[tuple[int, int]]:
    """Draw shots of every class, and others."""
    rng = np.random.default_rng(seed)
    lines, columns = codes.shape
    places = [(int(rng.integers(lines)), int(rng.integers(columns))) for _ in range(SHOTS // 2)]
    for code in np.unique(codes):
        there = np.argwhere(codes == code)
        places.append(tuple(there[rng.integers(len(there))].tolist()))  # type: ignore[arg-type]
    return places


def said(found: Explanation) -> Mapping[str, Any]:
    return {answer.stage: answer for answer in found.answers}


@pytest.mark.parametrize(("name", "preset"), CASES)
def test_the_class_is_that_of_classify(folder: Path, name: str, preset: str | None) -> None:
    given: dict[str, object] = {"nadir": 0.0} if (name, preset) == ("street", "street-scan") else {}
    loaded = load_config(preset=preset, options={"input": {**given}})
    source, output = folder / f"{name}.npz", folder / f"{name}-{preset}.npy"
    summary = classify(source, output, loaded, overwrite=True)
    codes = np.load(output).reshape(summary.counts.n_lines, -1)
    for line, column in of_each_class(codes, 23):
        found = explain(source, line, column, loaded)
        assert found.code == codes[line, column], (line, column)
        assert (found.range_m is None) == (found.label == Label.MISSING)
        if found.label != Label.MISSING:
            check_answers(found)
            json.dumps(found.as_dict())


def check_answers(found: Explanation) -> None:
    """The answers lead to the label."""
    answers = said(found)
    name = found.label.name.lower()
    known = {"prc", "fused", "sequential_angle", *Limits._fields, *Forest._fields}
    assert all(key.partition(".")[0] in known for a in found.answers for key, _ in a.limits)
    if found.method == "fused":
        last = [answer for answer in found.answers if answer.so != "keeps its class"][-1]
        assert last.so.startswith(name)
    elif found.method == "sequential-angle":
        coarse = {Label.VEGETATION: "vegetation", Label.HORIZONTAL: "horizontal", Label.VERTICAL: "vertical"}
        assert coarse.get(found.label, "") in answers["coarse class"].found
    elif found.label == Label.NOISE:
        assert answers["support"].so == "not supported: noise"
    elif "classes" in answers:
        assert answers["support"].so == "supported"
        smooth = found.label in (Label.GROUND, Label.BUILDING)
        assert (answers["surfaces"].so == "smooth") == smooth
        assert name in answers["classes"].so
    else:
        assert answers["columns"].so.startswith("its returns are ground") == (found.label == Label.GROUND)
        if found.label != Label.GROUND:
            assert (answers["surfaces"].so == "smooth") == (found.label == Label.STEM)


def test_the_answers_of_the_wider_window_are_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, labels, loaded = folder / "street.npz", [], load_config(preset="fused")
    off = STREET.again._replace(mirror_m=np.float32(NEVER), alone_texture=np.float32(NEVER))
    for limits in (STREET, STREET._replace(again=off)):
        monkeypatch.setattr(pipeline, "STREET", limits)
        summary = classify(source, folder / "again.npy", loaded, overwrite=True)
        labels.append(np.load(folder / "again.npy").reshape(summary.counts.n_lines, -1))
    monkeypatch.undo()
    noise = 7
    line, column = np.argwhere((labels[0] == noise) & (labels[1] != noise))[0].tolist()
    assert said(explain(source, line, column, loaded))["wider window"].so == "noise"


def test_a_table_and_json(prc: Prc, folder: Path) -> None:
    result = prc("explain", folder / "street.npz", "--at", "100,300", "--preset", "urban")
    assert result.code == 0, result.err
    assert "prc.support.zeta_p = 1.0" in result.out
    assert "neighbours in the line agree" in result.out
    found = json.loads(prc("explain", folder / "street.npz", "--at", "100,300", "--json").out)
    assert found["method"] == "fused"
    assert found["chosen"]["preset"] == "fused"
    assert found["record"] == 100 * 720 + 300
    assert found["answers"][-1]["limits"]


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


def test_a_narrow_table_is_whole(prc: Prc, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    results.cache_clear()
    found = prc("explain", folder / "street.npz", "--at", "100,300")
    results.cache_clear()
    assert found.code == 0
    assert max(map(len, found.out.splitlines()[:-2])) == 60
    assert "…" not in found.out


def test_a_missing_option_is_one_sentence(prc: Prc, folder: Path) -> None:
    result = prc("explain", folder / "street.npz")
    assert result.code == 2
    assert result.err == "error: Missing option '--at'; see prc explain --help\n"


def test_scanners_have_lines_of_their_own(prc: Prc, folder: Path) -> None:
    result = prc("explain", folder / "street.npz", "--at", "3,5", "--preset", "urban", "--station", "4")
    assert result.code == 1
    assert "found scanners 0, expected 4" in result.err
