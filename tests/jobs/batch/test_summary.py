"""The summary of a run: counts, exit codes in their order, and JSON that holds every name."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

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
    Problem,
    ReferenceSettings,
    Shard,
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


def test_json_is_valid_and_exact_for_every_name() -> None:
    names = [os.fsdecode(b"stra\xdfe.laz"), "a\nb\x1b[31m.laz", "\u2028日本.laz"]
    table = as_dict(summary(done=tuple(done(name, ground=1) for name in names), failed=(FAILED,)))
    text = json.dumps(table, allow_nan=False)
    assert text.isascii()
    assert json.loads(text) == table
    assert [found["name"] for found in table["done"]] == names
    assert [os.fsencode(found["name"]) for found in json.loads(text)["done"]] == [os.fsencode(name) for name in names]


def test_the_file_is_written_whole_and_each_shard_has_its_own(tmp_path: Path) -> None:
    for shard in (None, Shard(1, 2), Shard(2, 2)):
        write_summary(summary(out=tmp_path, shard=shard))
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["summary.1-of-2.json", "summary.2-of-2.json", "summary.json"]
    # a later run replaces it
    write_summary(summary(out=tmp_path, run="r2"))
    assert json.loads((tmp_path / "summary.json").read_text())["run"] == "r2"
