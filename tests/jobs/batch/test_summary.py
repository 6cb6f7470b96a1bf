"""What a batch says of itself: summary, drift, the night's report, the page on operations."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import prc_cli.core.errors
import prc_cli.jobs.batch
from prc_cli.core.errors import ExitCode
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.scores import GateResult
from prc_cli.jobs.batch.drift import Alarm, drift
from prc_cli.jobs.batch.outcomes import Doubted, Failed, Problem
from prc_cli.jobs.batch.references import BatchEvaluation
from prc_cli.jobs.batch.report import BatchSummary, write_summary
from prc_cli.jobs.batch.types import ReferenceSettings, Shard


def summary(**changes: object) -> BatchSummary:
    base = BatchSummary(
        "r1", Path("a"), Path("o"), "2026-11-21T02:00:00Z", "2026-11-21T02:01:00Z", 60.0, 4, 1
    )
    return replace(base, **changes)  # type: ignore[arg-type]


FAILED = Failed("b.laz", None, 0.5, Problem("InputError", "b.laz", "cut off", "copy it again"))
DOUBTED = Doubted("a.laz", "units", "units: odd")
ALARM = Alarm("a.laz", "ground 0.1, usually 0.5")


def evaluation(*, value: float) -> BatchEvaluation:
    matrix = ConfusionMatrix(("ground",), ("ground",), np.array([[3]]))
    gates = (GateResult("recall.ground", 0.9, value),)
    return BatchEvaluation(ReferenceSettings(Path("ref")), (), matrix, gates)


@pytest.mark.parametrize(
    "changes, code",
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
def test_the_worst_decides_the_exit_code(changes, code):
    assert summary(**changes).exit_code == code


def test_the_file_is_written_whole_and_each_shard_has_its_own(tmp_path):
    for shard in (None, Shard(1, 2), Shard(2, 2)):
        write_summary(summary(out=tmp_path, shard=shard))
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["summary.1-of-2.json", "summary.2-of-2.json", "summary.json"]
    # a later run replaces it
    write_summary(summary(out=tmp_path, run="r2"))
    assert json.loads((tmp_path / "summary.json").read_text())["run"] == "r2"


ROOT = Path(__file__).resolve().parents[3]
EXIT_CODES = (ROOT / "docs" / "operations.md").read_text(encoding="utf-8")
OPERATIONS = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")


def entries() -> set[str]:
    """Names in the first column of the table of errors, and in the paragraph above it."""
    above, _, table = OPERATIONS.partition("## Errors")[2].partition("\n|")
    return set(
        re.findall(r"`(\w+)`", above + " ".join(re.findall(r"^\| ([^|]+)\|", table, re.MULTILINE)))
    )


def subclasses(kind: type[BaseException]) -> set[str]:
    return {kind.__name__}.union(*(subclasses(item) for item in kind.__subclasses__()))


def kinds_in_code() -> set[str]:
    """First arguments of ``Problem(...)``: literals, and names of constants of the package."""
    room = Path(prc_cli.jobs.batch.__path__[0])
    text = "".join(path.read_text(encoding="utf-8") for path in room.glob("*.py"))
    constants = dict(re.findall(r'^(\w+) = "(\w+)"', text, re.MULTILINE))
    kinds = re.findall(r'\bProblem\(\s*(?:"(\w+)"|(\w+))', text)
    return {literal or constants[name] for literal, name in kinds if literal or name in constants}


def test_every_error_of_the_package_has_its_entry():
    missing = subclasses(prc_cli.core.errors.PrcError) - entries()
    # classes that tests define are none of ours
    ours = {name for name in missing if hasattr(prc_cli.core.errors, name)}
    assert not ours


def test_every_kind_of_problem_has_its_entry():
    kinds = kinds_in_code()
    assert {"killed", "timeout", "memory", "NoReference"} <= kinds
    assert not (kinds | {"interrupted", "OSError", "PermissionError"}) - entries()


def test_the_page_on_operations_lists_the_exit_codes():
    table = EXIT_CODES.partition("## Exit codes")[2].partition("\n## ")[0]
    assert [int(code) for code in re.findall(r"^\| (\d+) \|", table, re.MULTILINE)] == list(
        ExitCode
    )


def files(*ground: int) -> list[dict[str, int]]:
    return [{"GROUND": n, "OBJECT": 1000 - n} for n in ground]


def test_alarms_at_their_limits():
    usual = files(600, 610, 591, 605, 595, 600, 600, 600)
    far = {"GROUND": 100, "OBJECT": 900}
    assert (
        drift(far, usual)
        == "GROUND is 10.0 % of the records, in 8 earlier files 60.0 % (59.4 to 60.6 % in most)"
    )
    # a file of a single record counts, an empty one does not
    assert drift(far, usual[:7]) is None
    assert drift(far, [*usual[:7], {"GROUND": 1}]) is not None
    assert drift(far, [*usual[:7], {"GROUND": 0}]) is None
    assert drift({}, usual) == "there are no records, while 8 earlier files have some"
    assert drift({"GROUND": 1}, usual) is not None
    # the change of a twentieth, or six standard deviations above the median distance
    equal = files(*[600] * 8)
    assert drift({"GROUND": 5500, "OBJECT": 4500}, equal) is None
    assert drift({"GROUND": 5499, "OBJECT": 4501}, equal) is not None
    wide = files(500, 520, 540, 560, 640, 660, 680, 700)
    # distances 100, 80, 60, 40, 40, 60, 80, 100: median 70, median deviation 20
    limit = 600 - 70 - 6 * 1.4826 * 20
    assert drift({"GROUND": math.ceil(limit), "OBJECT": 1000 - math.ceil(limit)}, wide) is None
    assert (
        drift({"GROUND": math.floor(limit) - 1, "OBJECT": 1001 - math.floor(limit)}, wide)
        is not None
    )


@pytest.mark.parametrize(
    "n_alike, n_usual, is_odd", [(2, 20, True), (3, 20, False), (4, 90, True), (5, 90, False)]
)
def test_a_kind_of_drive_that_was_there_is_not_odd(n_alike, n_usual, is_odd):
    for alike, expected in ((149, is_odd), (151, True)):
        earlier = files(*[600] * n_usual, *[alike] * n_alike)
        assert (drift({"GROUND": 100, "OBJECT": 900}, earlier) is not None) is expected
