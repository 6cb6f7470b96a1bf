"""Times, elevations and orders, compared with plain loops and at their limits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.records import RecordChunk
from prc_cli.streams.order import OrderEvidence, OrderWatch, StepBack, WeekState, unwrap_week
from prc_cli.streams.rules import _WithElevation
from prc_cli.streams.setup import _column_step, _shot_step
from prc_cli.streams.trajectory import Trajectory


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


# -- trajectories ------------------------------------------------------------------------------------------------------


def track(*time_s: float, gap: float | None = None) -> Trajectory:
    n = len(time_s)
    return Trajectory("drive.csv", np.array(time_s), np.arange(3.0 * n).reshape(n, 3), gap)


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
