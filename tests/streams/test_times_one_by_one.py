"""Times, elevations and orders, compared with plain loops and at their limits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from prc_cli.core.errors import InputError, OrderError
from prc_cli.core.stream import ReadTally, ScanBlock, StreamInfo
from prc_cli.core.types import F64
from prc_cli.formats.records import RecordChunk
from prc_cli.streams import order
from prc_cli.streams.lines import time_in_line
from prc_cli.streams.order import OrderEvidence, OrderWatch, StepBack, WatchedStream, WeekState, order_hint, unwrap_week
from prc_cli.streams.rules import _WithElevation
from prc_cli.streams.setup import _column_step, _shot_step, find_timing
from prc_cli.streams.trajectory import Trajectory, load_trajectory


@pytest.mark.parametrize("drop_deg", [20.0, -20.0])
@pytest.mark.parametrize("chunk", [1, 2, 7, 60])
def test_lines_by_elevation_equal_a_plain_loop(drop_deg: float, chunk: int) -> None:
    rng = np.random.default_rng(4)
    xyz = rng.normal(size=(60, 3)) * rng.choice([0.0, 1.0], (60, 3), p=[0.3, 0.7])
    xyz[:2] = 0.0

    def chunks(names: tuple[str, ...]) -> Iterator[RecordChunk]:
        assert names == ("t", "x", "y", "z")
        for i in range(0, 60, chunk):
            rows = xyz[i : i + chunk]
            values = {"t": np.arange(i, i + len(rows)), **dict(zip("xyz", rows.T, strict=True))}
            yield RecordChunk(i, values, len(rows))

    line, last = 0, math.nan
    lines, angles = [], []
    for x, y, z in xyz.tolist():
        angle = math.atan2(z, math.hypot(x, y)) if (x, y, z) != (0.0, 0.0, 0.0) else math.nan
        if not math.isnan(angle):
            back = math.degrees(last - angle)
            line += back > 20.0 if drop_deg > 0 else back < -20.0
            last = angle
        lines.append(line)
        angles.append(angle)
    source = _WithElevation(SimpleNamespace(chunks=chunks), math.radians(drop_deg))  # type: ignore[arg-type]
    found = list(source.chunks(("line by elevation", "t", "angle")))
    assert [one for part in found for one in part.values["line by elevation"].tolist()] == lines
    np.testing.assert_allclose(np.concatenate([part.values["angle"] for part in found]), angles)
    assert [one for part in found for one in part.values["t"].tolist()] == list(range(60))
    assert list(found[0].values) == ["line by elevation", "t", "angle"]


@pytest.mark.parametrize("seed", range(12))
def test_steps_of_columns_and_shots_equal_plain_loops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = 400, 20
    number = np.sort(rng.choice(2 * n, n, replace=False))
    time = number * 0.01 + rng.normal(0, 1e-4, n)
    if seed % 3 == 0:
        time = np.round(time, 2) if seed % 2 else np.floor(number / 3) * 0.03
    column = number % m
    time[rng.random(n) < 0.05] = np.nan
    column[rng.random(n) < 0.05] = -1
    if seed == 5:
        column = column[::-1].copy()
    period = 0.2
    pairs = [(t, c) for t, c in zip(time.tolist(), column.tolist(), strict=True) if not math.isnan(t) and c >= 0]
    steps = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(pairs)]
    near = [(dt, dc) for dt, dc in steps if 0 <= dt < period]
    forward = [one for one in near if one[1] > 0]
    if not forward or len(forward) < sum(dc < 0 for _, dc in near):
        expected = 0.0
    else:
        most = 10 * np.median([dc for _, dc in forward])
        forward = [one for one in forward if one[1] <= most]
        expected = sum(dt for dt, _ in forward) / sum(dc for _, dc in forward)
    assert _column_step(time, column, period) == pytest.approx(expected)
    known = [t for t in time.tolist() if not math.isnan(t)]
    gaps = [b - a for a, b in pairwise(known) if 0 <= b - a < period]
    ahead = [one for one in gaps if one > 0]
    if len(ahead) < 0.995 * len(gaps):
        shot = np.mean([one for one in gaps if one < 2.5 * np.median(ahead)])
    else:
        shot = np.median([one for one in ahead if one <= 1.5 * np.percentile(ahead, 20)])
    assert _shot_step(time, period) == pytest.approx(shot)


def test_columns_and_shots_that_tell_nothing() -> None:
    assert _shot_step(np.zeros(9), 1.0) == _shot_step(np.arange(9.0), 1.0) == _shot_step(np.empty(0), 1.0) == 0.0
    # as many steps forward as back are enough, of equal columns none counts
    for column, expected in (([0, 1, 0, 1, 0], 0.1), ([1, 0, 1, 0], 0.0), ([1, 0, 1, 0, 0, 1], 0.1), ([3, 3, 3], 0.0)):
        assert _column_step(0.1 * np.arange(len(column)), np.array(column), 1.0) == pytest.approx(expected)
    # ten typical steps ahead are in the line, eleven are not
    for far, expected in ((10, 0.4 / 13), (11, 0.1)):
        assert _column_step(0.1 * np.arange(5), np.cumsum([0, 1, 1, 1, far]), 9.0) == pytest.approx(expected)
    # one of 200 may have the time of its neighbour
    for n_equal, expected in ((1, 1.0), (2, 199 / 201)):
        step = np.where(np.arange(201 if n_equal == 2 else 200) < n_equal, 0.0, 1.0)
        assert _shot_step(np.concatenate([[0.0], np.cumsum(step)]), 9.0) == pytest.approx(expected)
    assert (
        find_timing(np.zeros(3), np.arange(3), 4.0, 50).shot_s
        == find_timing(np.zeros(3), None, 4.0, 50).shot_s
        == 0.005
    )
    assert find_timing(np.zeros(3), np.arange(3), 4.0, 50).column_s == pytest.approx(0.0, abs=0.006)


def test_columns_beyond_a_line_have_no_time() -> None:
    found = time_in_line(np.array([-1, 0, 3, 104, 105, 106]), 0.01, 1.0)
    np.testing.assert_allclose(found, [np.nan, 0.0, 0.03, 1.04, np.nan, np.nan])


# -- trajectories ------------------------------------------------------------------------------------------------------


def track(*time_s: float, gap: float | None = None) -> Trajectory:
    n = len(time_s)
    return Trajectory("drive.csv", np.array(time_s), np.arange(3.0 * n).reshape(n, 3), gap)


@pytest.mark.parametrize(
    ("time_s", "limit"),
    [
        ((0.0, 0.05, 0.1, 9.0), 1.0),
        ((0.0, 1.0, 1100.0), 10.0),
        ((0.0, 0.2, 0.4, 5.0, 10.0), 2.0),
        ((0.0, 3.0), 30.0),
        ((4.0,), 1.0),
    ],
)
def test_usual_gaps_are_ten_lower_median_steps(time_s: tuple[float, ...], limit: float) -> None:
    assert track(*time_s).gap_limit_s == pytest.approx(limit)


def test_times_in_gaps_are_refused() -> None:
    one = track(0.0, 1.0, 13.25, 14.0)
    np.testing.assert_allclose(one.positions(np.array([0.0, 0.5, 1.0, 13.25, 14.0]))[:, 0], [0.0, 1.5, 3.0, 6.0, 9.0])
    with pytest.raises(InputError) as refused:
        one.positions(np.array([0.5, 13.2, 1.25, 13.25]))
    assert str(refused.value) == (
        "drive.csv: no position from 1.00 to 13.25 s, a gap of 12.25 s that holds the point time 13.20 s; expected "
        "gaps of at most 10.00 s (2 of 4 point times are in such gaps); give the whole trajectory, or set "
        "trajectory_max_gap = 13 to take straight lines across"
    )
    assert track(0.0, 1.0, 13.25, gap=12.25).positions(np.array([7.0])).shape == (1, 3)
    for gap, shown in ((1e15 - 1, "999999999999999 to take"), (1e15, "more to take"), (2e15, "more to take")):
        with pytest.raises(InputError, match=f"trajectory_max_gap = {shown}"):
            track(0.0, 1.0, 1.0 + gap, gap=5.0).positions(np.array([3.0]))


def test_times_outside_are_told() -> None:
    one = track(100.0, 101.0)
    with pytest.raises(InputError) as refused:
        one.positions(np.array([99.5, np.nan, 100.5, 101.5, 100.0, 101.0]))
    assert str(refused.value) == (
        "drive.csv: 3 of 6 point times are outside the trajectory: points from 99.50 to 101.50 s, trajectory from "
        "100.00 to 101.00 s (1 times are NaN or infinite); give the trajectory of this drive, or set "
        "trajectory_time_offset to what its times lack"
    )
    with pytest.raises(InputError, match="all 2 point times are NaN or infinite, expected times within"):
        one.positions(np.array([np.nan, np.inf]))
    assert one.positions(np.empty(0)).shape == (0, 3)


WEEK = 604_800.0


@pytest.mark.parametrize(
    ("offset", "hint"),
    [
        (WEEK, "differ by +1 GPS weeks: try trajectory_time_offset = 604800"),
        (-2 * WEEK, "differ by -2 GPS weeks: try trajectory_time_offset = -1209600"),
        (-1e9, "differ by -1e+09 s: try trajectory_time_offset = -1000000000"),
        (1e9 + WEEK, "differ by +1 GPS weeks and +1e+09 s: try trajectory_time_offset = 1000604800"),
        # points take 10 s, the trajectory 16: so far apart that the middles may be 3 s and one more off
        (WEEK + 4.0, "+1 GPS weeks"), (WEEK + 4.01, None), (WEEK - 3.99, "+1 GPS weeks"), (500.0, None), (1e15, None),
    ],
)  # fmt: skip
def test_clocks_that_differ_by_weeks(offset: float, hint: str | None) -> None:
    one = track(*(300_000.0 + np.arange(17.0)).tolist())
    with pytest.raises(InputError) as refused:
        one.positions(300_003.0 + np.arange(11.0) + offset)
    if hint is None:
        assert (
            refused.value.hint
            == "give the trajectory of this drive, or set trajectory_time_offset to what its times lack"
        )
    else:
        assert refused.value.hint is not None
        assert hint in refused.value.hint


def test_points_longer_than_the_trajectory_leave_a_second() -> None:
    for off, is_told in ((0.99, True), (1.01, False)):
        with pytest.raises(InputError) as refused:
            track(0.0, 1.0).positions(np.array([-1.0, 2.0]) + WEEK + off)
        assert ("GPS weeks" in str(refused.value)) is is_told


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (["1,0,0,0"], "1 positions, expected at least 2 to interpolate between"),
        (["1,0,0,0", "2,0,0,0", "2,0,0,0", "1.5,0,0,0"],
         "position 3 (counted from 1) has time 2.000000 s after 2.000000 s, expected times that increase (2 such st"),
    ],
)  # fmt: skip
def test_trajectories_that_cannot_be_used(tmp_path, rows: list[str], said: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(["t,x,y,z", *rows, ""]))
    with pytest.raises(InputError, match=said.replace("(", r"\(").replace(")", r"\)")):
        load_trajectory(path, crs=None, source_crs_wkt=None, time_offset=0.0)


# -- weeks and orders --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "is_end"), [(0.0, True), (6048.0, True), (6048.5, False), (-6048.0, True), (-6048.5, False)]
)
def test_a_week_ends_with_a_step_back_of_a_week(step: float, is_end: bool) -> None:
    times = np.array([604_000.0, np.nan, 604_000.0 - WEEK + step, 200_000.0, 301_599.0, 301_601.0])
    expected = np.where([0, 0, 1, 1, 1, 0], times + WEEK, times) if is_end else times
    for split in (1, 2, 3, 6):
        state, found = WeekState(), []
        for part in (times[:split], times[split:]):
            out, _, state = unwrap_week(part, state)
            found.append(out)
        np.testing.assert_array_equal(np.concatenate(found), expected)


def evidence(n_steps: int = 100, n_back: int = 0, back: float = 0.0, span: float = 100.0, **more: int) -> OrderEvidence:
    step = StepBack(7, 50.0 - back, 50.0) if n_back else None
    return OrderEvidence("t", n_steps, n_back, 0, 0, step, step, span, **more)


@pytest.mark.parametrize(
    ("one", "is_fine"),
    [
        (evidence(20_000, 2, 0.5), True), (evidence(20_000, 3, 0.5), False),
        # 5000 shots of a hundredth of a second, a tenth of 100 s
        (evidence(1_000_000, 1, 0.5), True), (evidence(1_000_000, 1, 0.501), False),
        (evidence(10_000, 1, 10.0), True), (evidence(10_000, 1, 10.01), False),
        (evidence(0, 0), True), (evidence(1, 0), True), (evidence(1, 1), False),
    ],
)  # fmt: skip
def test_orders_at_their_limits(one: OrderEvidence, is_fine: bool) -> None:
    assert one.is_chronological is is_fine


@pytest.mark.parametrize(
    ("n_steps", "n_back", "said"),
    [
        (1000, 1, "t decreases in 0.1 % of 1,000 steps, first"), (1001, 1, "t decreases in 1 of 1,001 steps, largest"),
        (10_000, 1500, "t decreases in 15.0 % of 10,000 steps, first"), (2_000_000, 1999, "t decreases in 1,999 of"),
    ],
)  # fmt: skip
def test_small_shares_are_told_as_counts(n_steps: int, n_back: int, said: str) -> None:
    assert evidence(n_steps, n_back, 1.0).sentence().startswith(said)


@pytest.mark.parametrize(
    ("back", "value", "before"),
    [
        (12.0, "38.00", "50.00"),
        (0.5, "49.50", "50.00"),
        (0.012, "49.988", "50.000"),
        (0.00995, "49.990", "50.000"),
        (1e-12, "50.000000000", "50.000000000"),
    ],
)
def test_times_are_shown_as_finely_as_their_step(back: float, value: str, before: str) -> None:
    assert evidence(9, 3, back).sentence().endswith(f"first at record 7: {value} s after {before} s")


@pytest.mark.parametrize(
    ("one", "can_sort", "hint"),
    [
        (evidence(9, 1, WEEK + 6047.0, WEEK), True, "the GPS week turned over"),
        (evidence(9, 1, WEEK + 6049.0, WEEK), True, "sort with"),
        (evidence(9, 1, WEEK - 6049.0, WEEK), True, "sort with"),
        (evidence(9, 2, WEEK, WEEK), False, "write the lines in the order"),
        (evidence(9, 2, 9.0, begins_anew=0), False, "the times from record 0 on were there before"),
    ],
)  # fmt: skip
def test_hints_of_orders(one: OrderEvidence, can_sort: bool, hint: str) -> None:
    assert order_hint(one, can_sort=can_sort).startswith(hint)


def slow_begins(times: list[float], most: float) -> int | None:
    """Return where a run of rising times covers more than so much of an earlier one, and all runs begin alike."""
    starts = [0, *(i for i in range(1, len(times)) if times[i] < times[i - 1])]
    runs = [(times[a], times[b - 1]) for a, b in zip(starts, [*starts[1:], len(times)], strict=True)]
    if len(runs) > 64 or (len(runs) > 2 and any(abs(start - runs[0][0]) > most for start, _ in runs)):
        return None
    for i, (start, top) in enumerate(runs):
        if any(min(top, other[1]) - max(start, other[0]) > most for other in runs[:i]):
            return starts[i]
    return None


@pytest.mark.parametrize("seed", range(25))
def test_where_times_begin_anew_equals_a_plain_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    runs = [
        np.sort(rng.uniform(0 if seed % 2 else rng.uniform(0, 40), rng.uniform(45, 99), 30))
        for _ in range((1, 2, 3, 4, 70)[seed % 5])
    ]
    if seed % 2:
        for run in runs:
            run[0] = rng.uniform(0, 12)
            run.sort()
    times = np.concatenate(runs)
    watch = OrderWatch("a.las", "trust")
    for part in np.array_split(times, seed % 4 + 1):
        watch.see(part, None)
    found = watch.evidence()
    assert found.span == np.ptp(times)
    assert found.begins_anew == slow_begins(times.tolist(), found.most_back)


def test_64_runs_are_kept() -> None:
    for n, expected in ((64, 10), (65, None)):
        watch = OrderWatch("a.las", "trust")
        watch.see(np.tile(np.arange(10.0), n), None)
        assert watch.evidence().begins_anew == expected


@pytest.mark.parametrize("has_line_times", [True, False])
def test_images_are_watched_by_line_or_by_shot(has_line_times: bool) -> None:
    time: F64 = (
        np.repeat([0.0, 1.0, 0.25, 0.5], 5).reshape(4, 5) if has_line_times else np.arange(20.0).reshape(4, 5) % 11
    )
    facts = SimpleNamespace(time_name="time_s", has_line_times=has_line_times)
    info = StreamInfo("a.npz", "array", 5, None, 4, facts=facts)  # type: ignore[arg-type]
    range_m = np.ones((2, 5), np.float32)
    blocks = [
        ScanBlock(10, range_m, time_s=time[:2], tally=ReadTally(n_records=3)), ScanBlock(0, range_m),
        ScanBlock(12, range_m, time_s=time[2:], tally=ReadTally(n_time_steps_back=4)),
    ]  # fmt: skip
    source = SimpleNamespace(info=info, blocks=lambda: iter(blocks))
    found = list(WatchedStream(source, "trust").blocks())  # type: ignore[arg-type]
    assert [block.tally.n_time_steps_back for block in found] == [0, 0, 5]
    assert found[0].tally.n_records == 3
    with pytest.raises(OrderError, match=f"time_s decreases in .* at record {60 if has_line_times else 11}: "):
        list(WatchedStream(source, "require").blocks())  # type: ignore[arg-type]
    assert order.CHECK_RECORDS == 1 << 20
