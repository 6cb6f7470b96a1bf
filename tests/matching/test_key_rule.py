from __future__ import annotations

import numpy as np

from prc_cli.matching.keys import exact_keys


def test_ids_are_exact_below_two_to_the_53() -> None:
    """The next whole number, 2**53 + 1, is the same float64 as 2**53."""
    stored = np.array([2**53 - 1, 2**53, 2**53 + 1, 1 - 2**53, -(2**53), 0])
    key, exact = exact_keys(stored)
    assert exact.tolist() == [True, False, False, True, False, True]
    assert key[1] == key[2]
