"""A few golden cases in every run of the suite, all of them with slow tests."""

from __future__ import annotations

import json

import pytest

from tests.golden.run import GOLDEN, differences, run

QUICK = ("help-classify", "config-urban", "classify-channels", "convert-las-scanners", "damaged-ptx-half", "stream")


def check(only: tuple[str, ...], jobs: int) -> dict[str, dict[str, object]]:
    found, _ = run(only, jobs)
    assert differences(json.loads(GOLDEN.read_text(encoding="utf-8")), found) == []
    return found


def test_quick_cases_are_as_they_were() -> None:
    found = check(QUICK, 1)
    assert len(found) >= len(QUICK)
    # and the comparison sees one bit
    name = "classify-channels"
    altered = {**found[name], "files": {**found[name]["files"], "o.laz": "0" * 64}}  # type: ignore[dict-item]
    assert differences({name: altered}, found)[0] != ""


@pytest.mark.slow
def test_all_cases_are_as_they_were() -> None:
    check(("",), 2)
