"""The loops of our own methods give what they gave, compiled and as Python."""

from __future__ import annotations

import os
import sys

import pytest

from tests import patience
from tests.loops import digests


@pytest.mark.parametrize("name", sorted(digests.CASES))
def test_no_output_changed(name: str) -> None:
    assert digests.changes([name]) == [], "if so wanted: python -m tests.loops.digests make"


@pytest.mark.slow
def test_loops_give_the_same_as_python() -> None:
    """Nothing rests on what the compiler makes of types, overflow or the order of sums."""
    command = [sys.executable, "-W", "ignore", "-m", "tests.loops.digests", "check"]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    ended = patience.run(command, env=environment, capture_output=True, text=True)
    assert ended.stdout == "no loop changed\n", ended.stdout + ended.stderr


@pytest.mark.parametrize("name", sorted(digests.CASES))
def test_cases_show_more_than_one_side(name: str) -> None:
    kept = digests.kept()[name]
    assert len({kept.of_outputs(number) for number in range(kept.n_cases)}) > 5
    assert kept.n_cases >= 100


def test_every_digest_has_cases() -> None:
    assert set(digests.kept()) == set(digests.CASES)


def test_a_changed_case_is_named() -> None:
    before = digests.Digests("0a0b0c", "010203", [1.0, 2.0, 3.0])
    label = digests.Digests("0a0b0c", "0102ff", [1.0, 2.0, 3.0])
    height = digests.Digests("0a0b0c", "010203", [1.0, 2.01, 3.0])
    last_digit = digests.Digests("0a0b0c", "010203", [1.0, 2.00001, 3.0])
    other_sine = digests.Digests("ff0b0c", "ff0203", [9.0, 2.0, 3.0])
    other_cases = digests.Digests("ffff0c", "010203", [1.0, 2.0, 3.0])
    assert digests.changed_cases(before, label) == [2]
    assert digests.changed_cases(before, height) == [1]
    assert digests.changed_cases(before, last_digit) == []
    assert digests.changed_cases(before, other_sine) == []
    assert digests.changed_cases(before, other_cases) == [0, 1]
