"""The loops of our own methods give what they gave, and the same as Python."""

import numpy as np
import pytest

from tests.loops import digests, recorded
from tests.loops.twins import LOOPS


@pytest.mark.parametrize("name", digests.NAMES)
def test_no_output_changed(name):
    assert digests.changes([name]) == [], "if so wanted: python -m tests.loops.digests make"


@pytest.mark.slow
@pytest.mark.parametrize("name", digests.NAMES)
def test_a_loop_gives_the_same_as_python(name):
    """Nothing rests on what the compiler makes of types, overflow or the order of sums."""
    loop = LOOPS[name]
    for case in recorded.cases(name)[::4]:
        with np.errstate(all="ignore"):  # which loops that run as Python warn of
            plain = loop.py_func(*recorded.copied(case))
        compiled = loop(*recorded.copied(case))
        wholes = (digests.whole_digits(output, with_floats=False) for output in (plain, compiled))
        assert len(set(wholes)) == 1
        sums = digests.float_sum(plain), digests.float_sum(compiled)
        assert sums[0] == pytest.approx(sums[1], rel=1e-5, abs=digests.TOLERANCE)


@pytest.mark.parametrize("name", digests.NAMES)
def test_cases_show_more_than_one_side(name):
    kept = digests.kept()[name]
    assert len({kept.of_outputs(number) for number in range(kept.n_cases)}) > 3


def test_every_digest_has_cases():
    assert sorted(digests.kept()) == digests.NAMES


@pytest.mark.parametrize(
    "arguments, outputs, sums, changed",
    [
        ("0a0b0c", "0102ff", [1.0, 2.0, 3.0], [2]),  # a label
        ("0a0b0c", "010203", [1.0, 2.01, 3.0], [1]),  # a height
        ("0a0b0c", "010203", [1.0, 2.00001, 3.0], []),  # its last digit
        ("ff0b0c", "ff0203", [9.0, 2.0, 3.0], []),  # a sine of another machine
        ("ffff0c", "010203", [1.0, 2.0, 3.0], [0, 1]),  # other cases
    ],
)
def test_a_changed_case_is_named(arguments, outputs, sums, changed):
    before = digests.Digests("0a0b0c", "010203", [1.0, 2.0, 3.0])
    now = digests.Digests(arguments, outputs, sums)
    assert digests.changed_cases(before, now) == changed
