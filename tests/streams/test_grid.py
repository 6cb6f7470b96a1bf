"""Records to the stream: every rule gives the same scene, chunks do not matter, all losses are
counted."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ReadTally
from prc_cli.streams import grid, lines
from tests.streams.record_lists import (
    LINE_HZ,
    N_LINES,
    SHOT_HZ,
    M,
    only,
    open_records,
    read,
    scene,
)

RULES: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "named": (("range", "scan_line", "column"), {}),
    "angle": (("range", "scan_line", "angle"), {"columns": "angle"}),
    "given angle": (
        ("range", "scan_line", "angle"),
        {"columns": "angle", "angle_start": 0.0, "angle_step": 360 / M, "points_per_line": M},
    ),
    "time": (("range", "time"), {"lines": f"time:{LINE_HZ}", "columns": f"time:{SHOT_HZ}"}),
    "time and angle": (
        ("range", "time", "angle"),
        {"lines": f"time:{LINE_HZ}", "columns": "angle"},
    ),
    "time and column": (("range", "time", "column"), {"lines": f"time:{LINE_HZ}"}),
    "line and time": (
        ("range", "scan_line", "time"),
        {"columns": f"time:{SHOT_HZ}", "points_per_line": M},
    ),
    "sensor xyz": (("x", "y", "z", "scan_line", "column"), {"range": "sensor-xyz"}),
}


def every_line_begins(records: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Only lines whose first shot is there: time columns without a line frequency count from it."""
    first = records["column"] == 0
    keep = np.isin(records["scan_line"], records["scan_line"][first])
    return {name: value[keep] for name, value in records.items()}


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("chunk_records", [1, 7, 1000])
def test_every_rule_finds_the_same_scene(rule, chunk_records):
    image, records = scene()
    names, options = RULES[rule]
    if rule == "line and time":
        records = every_line_begins(records)
        image[~np.isin(np.arange(N_LINES), records["scan_line"])] = np.nan
        image = image[: records["scan_line"].max() + 1]
        assert records["scan_line"][0] == 0
    stream = open_records(only(records, *names), chunk_records, **options)
    whole = read(stream)
    assert stream.info.points_per_line == M
    if rule == "sensor xyz":
        np.testing.assert_allclose(whole.range_m, image, rtol=1e-6)
    else:
        assert np.array_equal(whole.range_m, image, equal_nan=True)
    assert np.array_equal(whole.record[whole.record >= 0], np.arange(len(records["range"])))
    assert np.array_equal(whole.record >= 0, ~np.isnan(image))
    assert whole.tally == ReadTally()
    if rule == "angle":
        assert any("steps of the scan angle" in item.why for item in stream.info.assumptions)


@given(st.data())
def test_chunks_change_nothing_in_hostile_input(data):
    """Random returns, repeated cells and times, lines that go back, gaps, NaN.

    The same for every chunk size.
    """
    n = data.draw(st.integers(1, 60))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    line = np.cumsum(rng.choice([0, 0, 0, 0, 1, 2, -1, -2], n)).astype(np.float64)
    line[rng.random(n) < 0.1] = np.nan
    records = {
        "range": rng.choice([1.0, 2.0, 3.0, np.nan, -1.0], n),
        "scan_line": line,
        "column": rng.choice([0.0, 1.0, 2.0, 3.0, 4.0, np.nan, 2.5], n),
        "time": np.round(np.cumsum(rng.choice([0.0, 0.0, 0.01, 0.03, -0.01], n)), 3),
        "number_of_returns": rng.choice([1, 2, 3], n),
        "return_number": rng.choice([1, 2, 3], n),
        "intensity": rng.integers(0, 3, n),
    }
    if data.draw(st.booleans()):
        del records["return_number"]
    options: dict[str, Any] = data.draw(
        st.sampled_from(
            [
                {},
                {"columns": "order"},
                {"lines": "time:50", "columns": "time:200"},
                {"lines": "time:50", "columns": "order", "points_per_line": 3},
                {"lines": "time:50", "columns": "order"},
                {"lines": "time:50"},
                {"lines": "time:50", "points_per_line": 3},
                {"lines": "fixed", "points_per_line": 4, "partial_line": "pad"},
            ]
        )
    )
    results = []
    for chunk_records in (1, 2, 7, 1000):
        try:
            whole = read(
                open_records(records, chunk_records, order="trust", return_="first", **options)
            )
        except InputError as error:
            results.append(str(error))
            continue
        labelled = np.concatenate(
            [whole.record[whole.record >= 0], [item[3] for item in whole.extras]]
        )
        assert len(np.unique(labelled)) == len(labelled)
        assert len(labelled) + whole.tally.n_unplaced == n
        assert len(whole.extras) == whole.tally.n_collisions + whole.tally.n_extra_returns
        shown = [(item[0], item[1], item[3]) for item in whole.extras]
        results.append(str((whole.range_m.tolist(), whole.record.tolist(), shown, whole.tally)))
    assert len(set(results)) == 1


def test_gaps_leave_in_bounded_pieces(monkeypatch):
    monkeypatch.setattr(grid, "MAX_BLOCK_CELLS", 100)
    line = np.array([0, 0, 70_000, 70_001])
    records = {
        "range": np.array([-1.0, 1, 1, 1]),
        "scan_line": line,
        "column": np.array([0, 4, 1, 2]),
    }
    whole = read(open_records(records))
    assert whole.tally == ReadTally(n_not_positive=1)
    assert max(block.n_lines for block in whole.blocks) == 20
    assert whole.range_m.shape == (70_002, 5)
    assert np.argwhere(whole.record >= 0).tolist() == [[0, 0], [0, 4], [70_000, 1], [70_001, 2]]
    with pytest.raises(
        InputError,
        match=r"scan_line: 69999 lines are missing before record 2, expected at most 500;",
    ):
        open_records(records, max_gap_lines=500)


def test_memory_is_bounded_when_a_line_never_ends(monkeypatch):
    monkeypatch.setattr(lines, "MAX_OPEN_RECORDS", 500)
    endless = {"range": np.ones(5000), "scan_line": np.zeros(5000), "column": np.arange(5000) % 7}
    with pytest.raises(
        InputError,
        match="line 0 has more than 500 records and no end, expected scan lines; .*--lines",
    ):
        open_records(endless, 100)
    stamps = {"range": np.ones(5000), "scan_line": np.zeros(5000), "time": np.ones(5000)}
    stamps["number_of_returns"] = np.full(5000, 2)
    with pytest.raises(
        InputError, match=r"more than 500 records of several returns share the time 1\.0"
    ):
        open_records(stamps, 100)


SEVERAL = "scanner_channel"


@pytest.mark.slow
@pytest.mark.parametrize("chunk_records", [1, 7, 1000])
@pytest.mark.parametrize(
    "rule", [rule for rule in RULES if rule not in ("sensor xyz", "line and time")]
)
def test_scanners_are_split(rule, chunk_records):
    names, options = RULES[rule]
    images = []
    parts = []
    for seed in (1, 2):
        image, records = scene(seed)
        images.append(image)
        parts.append(
            {**only(records, *names), SEVERAL: np.full(len(records["range"]), seed, np.uint8)}
        )
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    when = np.concatenate([scene(seed)[1]["time"] for seed in (1, 2)])
    order = np.argsort(when, kind="stable")
    mixed = {name: value[order] for name, value in joined.items()}
    stream = open_records(mixed, chunk_records, scanner=SEVERAL, **options)
    for seed, image in zip((1, 2), images, strict=True):
        whole = read(stream, seed)
        assert np.array_equal(whole.range_m, image, equal_nan=True)
        there = whole.record >= 0
        assert np.array_equal(mixed["range"][whole.record[there]], image[there])


def test_sorting_by_time_restores_the_scene():
    image, records = scene()
    order = np.random.default_rng(3).permutation(len(records["range"]))
    shuffled = {name: records[name][order] for name in ("range", "time", "scan_line", "column")}
    whole = read(open_records(shuffled, 50, order="sort-time"))
    assert np.array_equal(whole.range_m, image, equal_nan=True)
    there = whole.record >= 0
    assert np.array_equal(shuffled["range"][whole.record[there]], image[there])
    assert whole.tally == ReadTally()
    dense = {"range": np.arange(1.0, 7.0), "time": np.array([5.0, 4, 3, 2, 1, 0])}
    assert read(open_records(dense, points_per_line=3, order="sort-time")).record.tolist() == [
        [5, 4, 3],
        [2, 1, 0],
    ]


@pytest.mark.parametrize("chunk_records", [1, 2, 3, 1000])
@pytest.mark.parametrize(
    "line, options",
    [
        ([0, 0, 1, 1, 2, np.nan, np.nan], {}),  # the last records have no line
        ([0, 0, 1, 1, 2, 2, 2], {"points_per_line": 2}),  # the last record has no column
        ([0, 0, 1, 1, 2, np.nan, np.nan], {"scanner": "user_data", "points_per_line": 4}),
        ([0, 0, 1, 1, 2, 2, 2], {"lines": "fixed", "points_per_line": 4, "partial_line": "pad"}),
        ([0, 0, 1, 1, 2, 2, 2], {"lines": "fixed", "points_per_line": 7}),
    ],
)
def test_all_records_are_counted_placed_or_not(line, options, chunk_records):
    n = len(line)
    records = {
        "range": np.ones(n),
        "scan_line": np.array(line),
        "column": np.array([0, 1, 0, 1, 0, 1, 2.0]),
    }
    records["user_data"] = np.array([1, 1, 1, 2, 1, 1, 3])
    blocks = list(open_records(records, chunk_records, **options).blocks())
    assert sum((block.tally for block in blocks), ReadTally()).n_records == n
