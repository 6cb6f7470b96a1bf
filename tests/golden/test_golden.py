"""All golden cases, in four parts so that workers share them; long ones apart."""

import json
import sys
from collections.abc import Collection

import pytest

from tests.golden.cases import all_cases
from tests.golden.run import GOLDEN, Result, differences, lines_of, needed, run
from tests.messages import check_messages

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="cases have paths and names that Windows has not"
)
CASES = all_cases()
KEPT = json.loads(GOLDEN.read_text(encoding="utf-8"))

SCANS = {"sim-sick", "sim-scan", "sim-street-laz"}
"""Inputs of about half of the cases, so that one worker alone makes them."""

LONG = (
    "demo",
    "info-points",
    "batch-formats",
    "batch-reference",
    "batch-references",
    "batch-done-reference",
    "batch-methods",
)
"""Cases that take most of the time; no other case reads their files."""


def check(names: Collection[str]) -> int:
    """Compare the cases whose data are there; return their number."""
    results, _ = run(names, 1, exact=True)
    assert differences(KEPT, results) == []
    return len(results)


def part_of(name: str) -> int:
    """Cases that read the scans are the first part; the others are three parts of a size."""
    reads = not SCANS.isdisjoint(needed(CASES, [name]))
    return 0 if reads else 1 + len(name) % 3


@pytest.mark.parametrize("part", [0, 1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_all_cases_are_as_they_were(part):
    assert check([name for name in CASES if name not in LONG and part_of(name) == part]) > 100


@pytest.mark.slow
def test_long_cases_are_as_they_were():
    assert check(LONG) == len(LONG)


def test_no_case_is_a_mistake_of_its_own():
    """Python in a case may be refused by prc, but it must not break."""
    broken = ("AttributeError", "ImportError", "NameError", "TypeError", "FileNotFoundError")
    assert [
        name for name, case in KEPT.items() if any(word in case["exit"] for word in broken)
    ] == []


WORDY = {
    "captures-unknown",
    "check-wrong",
    "classify-angle-order",
    "classify-dimension",
    "classify-no-channel",
    "classify-sorted-las",
    "classify-times",
    "data-packets",
    "doubtful-far",
    "e57-lies",
    "evaluate-match-dimension",
    "evaluate-poses-elsewhere",
    "las-suffixes",
    "mapping-fits",
    "mapping-unlisted",
    "misread-unit",
    "reading-three",
    "refused-evaluate-dimension",
    "transfer-no-time",
    "transfer-same-wrong",
}
"""Cases with a message that is too long: they name all dimensions, classes or options to type."""


def is_wordy(case: Result) -> bool:
    try:
        check_messages("\n".join(lines_of(case.get("stderr", ""))))
    except AssertionError:
        return True
    return False


def test_all_other_messages_are_short():
    assert {name for name, case in KEPT.items() if is_wordy(case)} == WORDY


def test_one_bit_is_seen():
    case = KEPT["classify-channels"]
    altered = {**case, "files": {**case["files"], "o.laz": "0" * 64}}
    assert differences(KEPT, {"classify-channels": altered}) != []
    assert differences(KEPT, {"classify-channels": case}) == []
