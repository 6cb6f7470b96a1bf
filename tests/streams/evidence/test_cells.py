"""Checks of counts and ranges, just inside and just outside of every limit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import Assumption, ReadTally, StreamInfo
from prc_cli.core.types import F32
from prc_cli.streams.evidence.checks import (
    _known_ranges,
    check_collisions,
    check_left_out,
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


@pytest.mark.parametrize(("n", "verdict"), [(50, FINE), (51, DOUBTFUL), (201, AGAINST)])
def test_shots_of_a_ring_meet_more_often(n: int, verdict: Verdict) -> None:
    one = seen(tally=ReadTally(n_records=1000, n_collisions=n))
    frame = replace(one.info, assumptions=(Assumption("input.azimuth_step", "0.16 deg", "as they are"),))
    found = check_collisions(replace(one, info=frame))
    assert found is not None
    assert (found.verdict, "--set input.azimuth_step" in found.hint) == (verdict, True)


def test_of_images_the_shots_count_as_records() -> None:
    assert told(check_unplaced(seen(n_shots=100, tally=ReadTally(n_unplaced=50))))[1].startswith("unplaced: 50.0% of")
    for few in (seen(n_shots=99), seen(n_shots=1000, tally=ReadTally(n_records=99))):
        assert check_unplaced(few) is check_collisions(few) is None
    assert check_collisions(seen(tally=ReadTally(n_records=100))) is not None


@pytest.mark.parametrize(
    ("n_records", "columns", "verdict"),
    [(980, "order", FINE), (971, "order", FINE), (969, "order", DOUBTFUL), (500, "angle", None)],
)
def test_shots_left_out_of_lines_by_order(n_records: int, columns: str, verdict: Verdict | None) -> None:
    info = StreamInfo("a.csv", "text", 10, None, None, assumptions=(Assumption("input.columns", columns, ""),))
    found = check_left_out(Seen(info, 0, (), n_shots=1000, tally=ReadTally(n_records=n_records)))
    assert (None if found is None else found.verdict) is verdict


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


def test_too_few_ranges_are_not_judged() -> None:
    for check, least in ((check_missing_code, 100), (check_ranges, 100), (check_rounding, 5000)):
        assert check(seen(np.full(least - 1, 5.0))) is None
        assert check(seen(np.append(np.full(least - 1, 5.0), np.nan))) is None
        assert check(seen()) is None
        assert check(seen(np.full(least, 5.0))) is not None


def test_the_ranges_that_are_looked_at_are_even_over_the_stream() -> None:
    most = 65_536
    for n, every in ((10, 1), (2 * most - 1, 1), (2 * most, 2), (3 * most + 7, 3)):
        one = seen(np.arange(1, n + 1))
        assert _known_ranges(one).tolist() == list(range(1, n + 1, every))
    two = Seen(
        one.info,
        0,
        (Window(0, np.array([[1, np.nan], [3, 4]], np.float32)), Window(9, np.array([[5, np.inf]], np.float32))),
    )
    assert _known_ranges(two).tolist() == [1, 3, 4, 5]


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
    ("share", "off", "is_rounded"),
    [(0.02, 0.025, False), (0.019, 0.025, True), (0.5, 0.018, True), (0.5, 0.022, False)],
)
def test_nearly_all_ranges_are_rounded(share: float, off: float, is_rounded: bool) -> None:
    """Steps of 0.1 m below 20 m; above, wider ones, of which some are off by a part of a step."""
    ranges = 0.1 * (100 + np.arange(10_000) % 100)
    n = round(share * len(ranges))
    ranges[:n] = 0.1 * (250 + 10 * (np.arange(n) % 50) + off)
    ranges[n : n + 50] = 0.1 * (250 + 10 * np.arange(50))
    assert told(check_rounding(seen(ranges)))[0] is (DOUBTFUL if is_rounded else FINE)


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


@pytest.mark.parametrize(("n", "verdict"), [(1, FINE), (2, DOUBTFUL), (20, DOUBTFUL), (21, AGAINST)])
def test_ranges_beyond_any_scanner(n: int, verdict: Verdict) -> None:
    ranges = np.where(np.arange(100) < n, 20_001.0, 30.0)
    ranges[-3:] = 20_000.0
    found = told(check_ranges(seen(ranges)))
    assert found[0] is verdict
    assert f"ranges: the median range is 30 m, and {n}.00% of the ranges lie beyond 20 km" in found[1]
