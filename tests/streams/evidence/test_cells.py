"""Checks of counts and ranges, just inside and just outside of every limit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import ReadTally, StreamInfo
from prc_cli.core.types import F32
from prc_cli.streams.evidence.checks import (
    check_collisions,
    check_missing_code,
    check_ranges,
    check_returns,
    check_rounding,
    check_unplaced,
)
from prc_cli.streams.evidence.figures import Seen, Window

FINE, DOUBTFUL, AGAINST = Verdict.FINE, Verdict.DOUBTFUL, Verdict.AGAINST


def seen(ranges: ArrayLike = (), **more: Any) -> Seen:
    row: F32 = np.asarray(ranges, np.float32).reshape(1, -1)
    windows = (Window(0, row),) if row.size else ()
    return Seen(StreamInfo("a.npy", "array", 10, None, None), 0, windows, **more)


def told(found: Finding | None) -> tuple[Verdict, str]:
    assert found is not None
    return found.verdict, found.sentence()


@pytest.mark.parametrize(
    ("n", "verdict", "share"),
    [(0, FINE, "0.0%"), (10, FINE, "1.0%"), (11, DOUBTFUL, "1.1%"), (200, DOUBTFUL, "20.0%"), (201, AGAINST, "20.1%")],
)
def test_lost_and_meeting_records(n: int, verdict: Verdict, share: str) -> None:
    one = seen(tally=ReadTally(n_records=1000, n_collisions=n, n_unplaced=n), n_shots=7)
    assert told(check_collisions(one)) == (
        verdict,
        f"collisions: {share} of the records met another shot in their cell, expected at most 1%; check --lines, "
        "--columns and -M; several scanners in one file: --scanner DIMENSION",
    )
    assert told(check_unplaced(one)) == (
        verdict,
        f"unplaced: {share} of the records found no cell and stay unclassified, expected at most 1%; check --lines, "
        "--columns and -M; a recording that was begun anew: split the file there",
    )


@pytest.mark.parametrize(
    ("n_shots", "n_missing", "verdict", "share"),
    [
        (100, 0, FINE, "100.00%"),
        (100, 98, FINE, "2.00%"),
        (1000, 981, DOUBTFUL, "1.90%"),
        (400, 400, DOUBTFUL, "0.00%"),
    ],
)
def test_returns(n_shots: int, n_missing: int, verdict: Verdict, share: str) -> None:
    assert told(check_returns(seen(n_shots=n_shots, n_missing=n_missing))) == (
        verdict,
        f"returns: {share} of the shots have a range, expected at least 2%; check --range, --max-range, the layout, "
        "and --columns and -M",
    )
    assert check_returns(seen(n_shots=99, n_missing=99)) is None


@pytest.mark.parametrize(
    ("n", "usual_m", "verdict"),
    [(10, 20.0, FINE), (11, 20.0, DOUBTFUL), (50, 50.0, FINE), (50, 49.9, DOUBTFUL)],
)
def test_the_largest_range_as_a_code(n: int, usual_m: float, verdict: Verdict) -> None:
    found = check_missing_code(seen(np.where(np.arange(1000) < n, 100.0, usual_m)))
    option = "--max-range 99.9999924"
    assert told(found) == (
        verdict,
        f"missing-code: {n / 10:.1f}% of the ranges are 100 m, the largest of all, expected at most 1%; if it stands "
        f"for no return: {option}; else the scanner's reach cuts the scene off",
    )
    assert found is not None
    assert found.option == (option if verdict else "")


@pytest.mark.parametrize(
    ("step_m", "said", "verdict"),
    [
        (0.014, "the ranges are finer than any threshold", FINE),
        (0.016, "all ranges are multiples of 0.016 m", FINE),
        (0.0299, "all ranges are multiples of 0.0299 m", FINE),
        (0.0301, "all ranges are multiples of 0.0301 m", DOUBTFUL),
        (0.25, "all ranges are multiples of 0.25 m", DOUBTFUL),
    ],
)
def test_rounded_ranges(step_m: float, said: str, verdict: Verdict) -> None:
    assert told(check_rounding(seen(step_m * (100 + np.arange(6000) % 300)))) == (
        verdict,
        f"rounding: {said}, expected steps of at most 0.03 m; take the ranges from a file that was not rounded; check "
        "the scale of the layout",
    )


@pytest.mark.parametrize(
    ("median_m", "verdict"),
    [
        (0.0199, AGAINST), (0.0201, FINE), (150.0, FINE), (150.1, DOUBTFUL), (5000.0, DOUBTFUL), (5000.1, AGAINST),
    ],
)  # fmt: skip
def test_median_range(median_m: float, verdict: Verdict) -> None:
    unit = ""
    if not 0.15 <= median_m <= 150.0:
        name, scale = ("millimetres", "0.001") if median_m > 1.0 else ("kilometres", "1000")
        unit = f"if they are {name}: --set input.range_scale={scale}; else "
    assert told(check_ranges(seen(np.full(100, median_m)))) == (
        verdict,
        f"ranges: the median range is {np.float32(median_m):.4g} m, and 0.00% of the ranges lie beyond 20 km, expected "
        f"0.02 to 150 m, and at most 1% that far; {unit}check the layout (byte order, types, scale, header bytes), and "
        "--range with its coordinate system",
    )
