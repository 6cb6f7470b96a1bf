"""The order of records in time, and weeks that end."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.errors import OrderError
from prc_cli.streams import order
from prc_cli.streams.order import WEEK_S, OrderWatch
from tests.streams.record_lists import LINE_HZ, SHOT_HZ, START_S, only, open_records, read, scene


def watch_in_chunks(values: np.ndarray, chunk: int, policy: str = "trust") -> OrderWatch:
    watch = OrderWatch("drive.las", policy)  # type: ignore[arg-type]
    for start in range(0, len(values), chunk):
        watch.see(values[start : start + chunk], None)
    return watch


def slow_evidence(values: list[float]) -> tuple[int, int, int, int | None]:
    """Count record by record: steps, steps back, equal steps, first record that is lower than the
    one before."""
    steps = back = equal = 0
    first = None
    last = None
    for index, value in enumerate(values):
        if not np.isfinite(value):
            continue
        if last is not None:
            steps += 1
            equal += value == last
            if value < last:
                back += 1
                first = index if first is None else first
        last = value
    return steps, back, equal, first


@given(
    values=st.lists(
        st.sampled_from([0.0, 1.0, 1.5, 2.0, 3.0, float("nan"), float("inf")]), max_size=30
    ),
    chunk=st.integers(1, 31),
)
def test_figures_equal_the_slow_count_for_any_chunk_size(values, chunk):
    evidence = watch_in_chunks(np.array(values, np.float64), chunk).evidence()
    steps, back, equal, first = slow_evidence(values)
    assert (evidence.n_steps, evidence.n_back, evidence.n_equal) == (steps, back, equal)
    assert (evidence.first.record if evidence.first else None) == first
    assert evidence.n_not_finite == int(np.sum(~np.isfinite(values)))
    assert evidence == watch_in_chunks(np.array(values, np.float64), 100).evidence()


def test_a_long_file_is_refused_on_the_way_and_for_any_chunk_size(
    monkeypatch,
):
    monkeypatch.setattr(order, "CHECK_RECORDS", 1000)
    times = np.arange(10_000.0)
    times[1500] = 0.0
    messages = set()
    for chunk in (1, 7, 999, 1000, 1001, 10_000):
        with pytest.raises(OrderError) as caught:
            watch_in_chunks(times, chunk, "require")
        messages.add(str(caught.value))
    assert len(messages) == 1
    assert "1,999 steps" in messages.pop()


def stamps(n: int = 60_000, hz: float = 1e5) -> np.ndarray:
    return np.arange(n) / hz


def moved(kind: str) -> np.ndarray:
    """Times of a file whose parts are out of place, by few steps back."""
    times = stamps()
    parts = np.split(times, 8)
    if kind == "swapped halves":
        return np.concatenate([times[30_000:], times[:30_000]])
    if kind == "permuted blocks":
        return np.concatenate([parts[i] for i in (3, 1, 0, 2, 7, 5, 6, 4)])
    if kind == "lines twice":
        return np.concatenate([times[:40_000], times[30_000:40_000], times[40_000:]])
    return np.concatenate([times, times])


@pytest.mark.parametrize(
    "kind, hint",
    [
        ("swapped halves", "if no record is missing: --sort-by-time"),
        ("permuted blocks", "if no record is missing: --sort-by-time"),
        ("lines twice", "the times start again at record 40000: split the file there"),
        ("begun anew", "the times start again at record 60000: split the file there"),
    ],
)
def test_a_single_large_step_back_is_refused_however_small_its_share(kind, hint):
    times = moved(kind)
    watch = watch_in_chunks(times, 7000, "require")
    evidence = watch.evidence()
    assert evidence.share_back < 2e-4
    assert not evidence.is_chronological
    with pytest.raises(OrderError, match=hint):
        watch.finish()


@pytest.mark.parametrize("chunk", [1, 7000, 100_000])
def test_records_without_a_time_are_not_to_be_sorted(chunk):
    """Sorted, they would come first, and lines would be counted from them."""
    times = stamps(20_000) + 5.0
    times[[7, 900, 15_000]] = -1.0
    watch = watch_in_chunks(times, chunk, "require")
    with pytest.raises(OrderError, match=r"3 records have the time -1.*: --trust-order"):
        watch.finish()


BY_TIME: dict[str, Any] = {"lines": f"time:{LINE_HZ}", "columns": f"time:{SHOT_HZ}"}
MIDDLE_S = 11.4 / LINE_HZ
"""From the begin of the scene to the end of the week [s]."""


def wrapped() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the scene, the week ending in its middle."""
    image, records = scene()
    time_s = records["time"] - START_S + WEEK_S - MIDDLE_S
    return image, {**records, "time": np.where(time_s >= WEEK_S, time_s - WEEK_S, time_s)}


@pytest.mark.parametrize("goes_on", [False, True])
def test_the_trajectory_is_asked_by_the_times_that_it_has(goes_on, tmp_path):
    image, records = wrapped()
    begin = WEEK_S - MIDDLE_S - 1
    track = [begin, begin + 3] if goes_on else [0.0, 2.0, begin, begin + 1.5]
    rows = "".join(f"{time_s},0,0,0\n" for time_s in track)
    (tmp_path / "drive.csv").write_text("time,x,y,z\n" + rows)
    options = {**BY_TIME, "range": f"trajectory:{tmp_path / 'drive.csv'}", "order": "trust"}
    if not goes_on:
        options["trajectory_max_gap"] = WEEK_S
    whole = read(open_records(only(records, "x", "y", "z", "time"), 50, **options))
    np.testing.assert_allclose(whole.range_m, image, rtol=1e-6)
