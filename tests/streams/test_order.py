from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from prc_cli.core.errors import OrderError
from prc_cli.streams import order
from prc_cli.streams.order import (
    OrderWatch,
)


def watch_in_chunks(values: np.ndarray, chunk: int, policy: str = "trust") -> OrderWatch:
    watch = OrderWatch("drive.las", policy)  # type: ignore[arg-type]
    for start in range(0, len(values), chunk):
        watch.see(values[start : start + chunk], None)
    return watch


def slow_evidence(values: list[float]) -> tuple[int, int, int, int | None]:
    """Count record by record: steps, steps back, equal steps, first record that is lower than the one before."""
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


@settings(deadline=None, max_examples=200)
@given(
    values=st.lists(st.sampled_from([0.0, 1.0, 1.5, 2.0, 3.0, float("nan"), float("inf")]), max_size=30),
    chunk=st.integers(1, 31),
)
def test_figures_equal_the_slow_count_for_any_chunk_size(values: list[float], chunk: int) -> None:
    evidence = watch_in_chunks(np.array(values, np.float64), chunk).evidence()
    steps, back, equal, first = slow_evidence(values)
    assert (evidence.n_steps, evidence.n_back, evidence.n_equal) == (steps, back, equal)
    assert (evidence.first.record if evidence.first else None) == first
    assert evidence.n_not_finite == int(np.sum(~np.isfinite(values)))
    assert evidence == watch_in_chunks(np.array(values, np.float64), 100).evidence()


def test_refusal_names_file_evidence_and_remedy() -> None:
    times = np.arange(20_000.0)[::-1] / 2 + 3 - 9999.5
    with pytest.raises(OrderError) as caught:
        watch_in_chunks(times, 20_000, "require").finish()
    assert str(caught.value) == (
        "drive.las: gps_time decreases in 100.0 % of 19,999 steps, first at record 1: 2.50 s after 3.00 s; "
        "expected shots in the order they were fired; "
        "sort with --sort-by-time if every record is there, or insist with --trust-order"
    )


@pytest.mark.parametrize(("n_back", "refused"), [(1, False), (2, True)])
def test_share_of_swapped_pairs(n_back: int, refused: bool) -> None:
    times = np.arange(12_001) / 1e3
    for k in range(n_back):
        times[[100 * k + 10, 100 * k + 11]] = times[[100 * k + 11, 100 * k + 10]]
    watch = watch_in_chunks(times, 5000)
    assert watch.evidence().n_back == n_back
    assert watch.evidence().is_chronological is not refused


def test_one_seam_in_a_long_drive_is_tolerated_and_reported() -> None:
    times = np.arange(30_000) / 1e3
    times[20_000:] -= 1.5
    watch = watch_in_chunks(times, 30_000, "require")
    watch.finish()
    assert watch.evidence().sentence() == (
        "gps_time decreases in 1 of 29,999 steps, largest at record 20000: 18.50 s after 20.00 s"
    )


def test_a_long_file_is_refused_on_the_way_and_for_any_chunk_size(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_week_turnover_has_its_own_hint() -> None:
    times = np.concatenate([np.arange(604_000.0, 604_800.0, 0.05), np.arange(0.0, 10.0, 0.05)])
    with pytest.raises(OrderError, match="GPS week turned over"):
        watch_in_chunks(times[12_000:], 1 << 20, "require").finish()


@pytest.mark.parametrize("policy", ["trust", "sort-time"])
def test_other_policies_only_count(policy: str) -> None:
    watch = watch_in_chunks(np.arange(20_000.0)[::-1], 700, policy)
    watch.finish()
    assert watch.evidence().n_back == 19_999


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
    ("kind", "hint"),
    [
        ("swapped halves", "sort with --sort-by-time"),
        ("permuted blocks", "sort with --sort-by-time"),
        ("lines twice", "the times from record 40000 on were there before: split the file there"),
        ("begun anew", "the times from record 60000 on were there before: split the file there"),
    ],
)
def test_a_single_large_step_back_is_refused_however_small_its_share(kind: str, hint: str) -> None:
    times = moved(kind)
    watch = watch_in_chunks(times, 7000, "require")
    evidence = watch.evidence()
    assert evidence.share_back < 2e-4
    assert not evidence.is_chronological
    with pytest.raises(OrderError, match=hint):
        watch.finish()
