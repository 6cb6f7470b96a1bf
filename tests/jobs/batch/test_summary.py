"""The summary of a run: counts, exit codes in their order, and JSON that holds every name."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import OutputError
from prc_cli.core.findings import Finding, Verdict
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.scores import GateResult
from prc_cli.jobs.batch.report import (
    EXIT_CODES,
    BatchEvaluation,
    BatchSummary,
    as_dict,
    write_summary,
)
from prc_cli.jobs.batch.types import (
    Alarm,
    Done,
    Doubted,
    Failed,
    InputPrint,
    LeftOut,
    Problem,
    ReferenceSettings,
    Shard,
    doubts_of,
)


def done(name: str, **labels: int) -> Done:
    return Done(
        name, InputPrint(10, 20, "ab"), 30, 40, 2.0, 1.5, 100.0, 5, sum(labels.values()), sum(labels.values()),
        tuple(labels.items()), ("a note",),
    )  # fmt: skip


def summary(**changes: object) -> BatchSummary:
    base = BatchSummary("r1", Path("a"), Path("o"), "2026-11-21T02:00:00Z", "2026-11-21T02:01:00Z", 60.0, 4, 1)
    return replace(base, **changes)  # type: ignore[arg-type]


FAILED = Failed("b.laz", None, 0.5, Problem("InputError", "b.laz", "cut off", "copy it again"))
DOUBTED = Doubted("a.laz", "units", "units: odd")
ALARM = Alarm("a.laz", "ground 0.1, usually 0.5")


def evaluation(*, value: float) -> BatchEvaluation:
    matrix = ConfusionMatrix(("ground",), ("ground",), np.array([[3]]))
    gates = (GateResult("recall.ground", 0.9, value),)
    return BatchEvaluation(ReferenceSettings(Path("ref")), (), matrix, gates)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({}, 0),
        ({"n_waiting": 3}, 0),
        ({"alarms": (ALARM,)}, 4),
        ({"doubts": (DOUBTED,)}, 4),
        ({"doubts": (DOUBTED,), "evaluation": evaluation(value=0.8)}, 3),
        ({"doubts": (DOUBTED,), "failed": (FAILED,)}, 1),
        ({"alarms": (ALARM,), "evaluation": evaluation(value=0.8)}, 3),
        ({"alarms": (ALARM,), "evaluation": evaluation(value=0.9)}, 4),
        ({"evaluation": evaluation(value=float("nan"))}, 3),
        ({"alarms": (ALARM,), "evaluation": evaluation(value=0.8), "failed": (FAILED,)}, 1),
    ],
)
def test_the_worst_decides_the_exit_code(changes: dict[str, object], code: int) -> None:
    assert summary(**changes).exit_code == code
    assert code in EXIT_CODES


def test_the_exit_code_after_a_signal_is_that_of_the_signal() -> None:
    assert as_dict(summary(ended="interrupted", failed=(FAILED,)))["exit_code"] is None
    assert as_dict(summary(ended="stopped", failed=(FAILED,)))["exit_code"] == 1


def test_classes_are_pooled_over_files_in_the_order_of_labels() -> None:
    found = summary(done=(done("a", vegetation=2, ground=5), done("b", ground=1, missing=4)))
    assert found.labels == (("missing", 4), ("ground", 6), ("vegetation", 2))
    assert found.n_shots == 12
    assert found.shots_per_s == pytest.approx(12 / 60)
    assert summary().shots_per_s is None


def test_json_is_valid_and_exact_for_every_name() -> None:
    names = [os.fsdecode(b"stra\xdfe.laz"), "a\nb\x1b[31m.laz", "\u2028日本.laz"]
    table = as_dict(summary(done=tuple(done(name, ground=1) for name in names), failed=(FAILED,)))
    text = json.dumps(table, allow_nan=False)
    assert text.isascii()
    assert json.loads(text) == table
    assert [found["name"] for found in table["done"]] == names
    assert [os.fsencode(found["name"]) for found in json.loads(text)["done"]] == [os.fsencode(name) for name in names]


def test_counts_and_reasons_are_in_the_json() -> None:
    found = summary(
        done=(done("a.laz", ground=3),), failed=(FAILED,), alarms=(ALARM,), left_out=(LeftOut("x", "a fifo"),),
        n_waiting=1, reasons=(("new", 2),), shard=Shard(2, 3), evaluation=evaluation(value=0.95),
    )  # fmt: skip
    table = as_dict(found)
    expected = {
        "found": 4, "skipped": 1, "done": 1, "failed": 1, "failed_before": 0, "waiting": 1, "doubted": 0,
        "alarms": 1, "left_out": 1,
    }  # fmt: skip
    assert table["counts"] == expected
    assert table["reasons"] == {"new": 2}
    assert table["shard"] == "2/3"
    assert table["failed"][0]["kind"] == "InputError"
    assert table["failed"][0]["hint"] == "copy it again"
    assert table["evaluation"]["gates"] == [{"name": "recall.ground", "limit": 0.9, "value": 0.95, "passed": True}]


def test_doubts_are_counted_by_file_and_by_check() -> None:
    odd = Finding("units", Verdict.DOUBTFUL, "the scanner is 9 m up", "at most 5 m", "check the unit")
    far = replace(odd, check="returns")
    accepted = replace(odd, check="standing", is_accepted=True)
    notices = ("a note", odd.notice(), far.notice(), accepted.notice())
    one, two = replace(done("a.laz", ground=1), notices=notices), replace(done("b.laz"), notices=(far.notice(),))
    table = as_dict(summary(done=(one, two), doubts=(*doubts_of(one), *doubts_of(two))))
    assert table["counts"]["doubted"] == 2
    assert table["doubt_counts"] == {"returns": 2, "units": 1}
    assert table["doubts"][0] == {
        "name": "a.laz", "check": "units",
        "sentence": "units: the scanner is 9 m up, expected at most 5 m; check the unit",
    }  # fmt: skip
    assert table["exit_code"] == 4


def test_the_file_is_written_whole_and_each_shard_has_its_own(tmp_path: Path) -> None:
    for shard in (None, Shard(1, 2), Shard(2, 2)):
        write_summary(summary(out=tmp_path, shard=shard))
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["summary.1-of-2.json", "summary.2-of-2.json", "summary.json"]
    # a later run replaces it
    write_summary(summary(out=tmp_path, run="r2"))
    assert json.loads((tmp_path / "summary.json").read_text())["run"] == "r2"


def test_a_folder_that_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        write_summary(summary(out=tmp_path / "none"))
