"""All golden cases, in two halves so that two workers share them; three long ones apart."""

from __future__ import annotations

import json
import re
import zlib

import pytest

from tests.golden.cases import all_cases
from tests.golden.run import GOLDEN, differences, run

SHARED = ("made", "sim-street", "sim-sick", "sim-forest", "sim-scan", "sim-street-laz")
"""Inputs that both halves make; cases that read another one's files run beside it."""

LONG = ("demo", "info-points", "batch-formats")
"""Cases that take most of the time; no other case reads their files."""


def half(name: str, commands: str) -> int:
    read = [
        case for case in re.findall(r"\.\./([\w.-]+)/", commands) if case not in (*SHARED, name)
    ]
    return zlib.crc32((read or [name])[0].encode()) % 2


@pytest.mark.parametrize("number", [0, 1])
def test_all_cases_are_as_they_were(number: int) -> None:
    chosen = [
        name
        for name, commands in all_cases().items()
        if half(name, commands) == number and name not in LONG
    ]
    results, _ = run(chosen, 1, exact=True)
    assert differences(json.loads(GOLDEN.read_text(encoding="utf-8")), results) == []
    assert len(results) > 100


@pytest.mark.slow
def test_long_cases_are_as_they_were() -> None:
    results, _ = run(LONG, exact=True)
    assert differences(json.loads(GOLDEN.read_text(encoding="utf-8")), results) == []
    assert len(results) == len(LONG)


def test_no_case_is_a_mistake_of_its_own() -> None:
    """Python in a case may be refused by prc, but it must not break."""
    broken = ("AttributeError", "ImportError", "NameError", "TypeError", "FileNotFoundError")
    kept = json.loads(GOLDEN.read_text(encoding="utf-8"))
    assert [
        name for name, case in kept.items() if any(word in case["exit"] for word in broken)
    ] == []


def test_one_bit_is_seen() -> None:
    kept = json.loads(GOLDEN.read_text(encoding="utf-8"))
    name = "classify-channels"
    altered = {**kept[name], "files": {**kept[name]["files"], "o.laz": "0" * 64}}
    assert differences(kept, {name: altered}) != []
    assert differences(kept, {name: kept[name]}) == []
