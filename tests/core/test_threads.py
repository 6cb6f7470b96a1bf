"""Threads change neither results nor their order.

Errors keep their place; few items are in flight.
"""

import os
import signal
import threading
import time
from collections.abc import Iterator

import pytest

from prc_cli.core import threads as module
from prc_cli.core.threads import (
    Relay,
    RelayBrokenError,
    default_threads,
    ordered,
    read_ahead,
    write_behind,
)
from tests.patience import HANGS_S, wait_until

THREADS = [0, 1, 2, 5]


@pytest.fixture(autouse=True)
def no_thread_is_left():
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before


def uneven(n: int) -> int:
    time.sleep(0.002 * (n % 3))
    return n * n


class Source:
    """A generator that knows how far it was run and whether it was closed."""

    def __init__(self, n: int, fails_at: int | None = None) -> None:
        self.taken = 0
        self.closed = False
        self.n = n
        self.fails_at = fails_at

    def __call__(self) -> Iterator[int]:
        try:
            for n in range(self.n):
                if n == self.fails_at:
                    raise OSError(n)
                self.taken += 1
                yield n
        finally:
            self.closed = True


@pytest.mark.parametrize("threads", THREADS)
def test_results_come_in_order(threads):
    assert list(ordered(uneven, range(30), threads=threads)) == [n * n for n in range(30)]
    assert list(ordered(uneven, [], threads=threads)) == []


@pytest.mark.parametrize("threads, ahead, most", [(1, None, 1), (2, None, 4), (2, 3, 3), (3, 1, 1)])
def test_few_items_are_in_flight(threads, ahead, most):
    source = Source(40)
    taken = []
    for n_done, _ in enumerate(ordered(uneven, source(), threads=threads, ahead=ahead)):
        taken.append(source.taken - n_done)
    assert max(taken) == most
    assert source.closed


@pytest.mark.parametrize("threads", THREADS)
def test_error_of_an_item_comes_at_its_place(threads):
    begun: list[int] = []

    def work(n: int) -> int:
        begun.append(n)
        if n == 5:
            raise KeyError(n)
        return uneven(n)

    results: list[int] = []
    source = Source(1000)
    with pytest.raises(KeyError):
        results.extend(ordered(work, source(), threads=threads))
    assert results == [n * n for n in range(5)]
    assert max(begun) <= 5 + 2 * max(threads, 1)
    assert source.closed


@pytest.mark.parametrize("threads", THREADS)
def test_error_of_the_items_comes_after_the_results_before_it(threads):
    results: list[int] = []
    with pytest.raises(OSError, match="4"):
        results.extend(ordered(uneven, Source(10, fails_at=4)(), threads=threads))
    assert results == [0, 1, 4, 9]


@pytest.mark.parametrize("threads", THREADS)
def test_closing_early_begins_nothing_more(threads):
    source = Source(1000)
    begun: list[int] = []

    def work(n: int) -> int:
        begun.append(n)
        time.sleep(0.01)
        return n

    results = ordered(work, source(), threads=threads)
    assert next(results) == 0
    results.close()  # type: ignore[attr-defined]
    n = len(begun)
    time.sleep(0.05)
    assert len(begun) == n <= 1 + 2 * max(threads, 1)
    assert source.closed


@pytest.mark.skipif(os.name != "posix", reason="sends itself a signal")
def test_waiting_can_be_interrupted():
    """The signal comes when all is begun that there is room for; only that is waited for."""
    begun: list[int] = []
    source = Source(100)

    def work(n: int) -> None:
        begun.append(n)
        if n == 0:
            wait_until(lambda: source.taken == 4)
            os.kill(os.getpid(), signal.SIGUSR1)
        wait_until(lambda: heard)

    heard: list[int] = []

    def handler(number: int, _: object) -> None:
        heard.append(number)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGUSR1, handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            for _ in ordered(work, source(), threads=2):
                pass
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert heard == [signal.SIGUSR1]
    assert len(begun) <= 4


class TestRelay:
    @pytest.mark.parametrize("threads", [2, 5])
    def test_value_passes_in_order(self, threads):
        relay = Relay("")

        def work(n: int) -> str:
            uneven(n)
            return relay.take_turn(n, lambda text: (text, text + str(n)))[0]

        assert list(ordered(work, range(10), threads=threads))[-1] == "012345678"

    def test_first_error_is_what_is_seen(self):
        relay = Relay(0)

        def work(n: int) -> int:
            def add(value: int) -> tuple[int, int]:
                if n == 3:
                    raise ValueError("block 3")
                return value, value + n

            return relay.take_turn(n, add)[0]

        errors: list[int] = []
        with pytest.raises(ValueError, match="block 3"):
            errors.extend(ordered(work, range(20), threads=4))
        assert errors == [0, 0, 1]

    def test_nobody_waits_for_a_job_that_gave_up(self):
        relay = Relay(0)
        relay.give_up(1)
        assert relay.take_turn(0, lambda value: (value, value + 1)) == (0, 1)
        with pytest.raises(RelayBrokenError):
            relay.take_turn(7, lambda value: (value, value))


class TestReadAhead:
    def test_items_come_in_order_and_a_few_are_ready(self):
        source = Source(50)
        leads = []
        for taken, item in enumerate(read_ahead(source(), depth=2)):
            assert item == taken
            wait_until(lambda: source.taken >= min(taken + 3, 50))  # noqa: B023
            leads.append(source.taken - taken - 1)
        assert max(leads) <= 3
        assert source.closed

    def test_error_comes_at_its_place(self):
        results: list[int] = []
        with pytest.raises(OSError, match="7"):
            results.extend(read_ahead(Source(20, fails_at=7)()))
        assert results == list(range(7))

    def test_closing_stops_the_thread_and_closes_the_source(self):
        source = Source(10_000)
        items = read_ahead(source(), depth=3)
        assert next(items) == 0
        items.close()  # type: ignore[attr-defined]
        assert source.closed
        assert source.taken <= 6

    def test_a_read_that_never_comes_back_holds_nobody_up(self):
        go_on = threading.Event()

        def stuck() -> Iterator[int]:
            yield 1
            go_on.wait()

        items = read_ahead(stuck(), patience_s=0.05)
        assert next(items) == 1
        items.close()  # type: ignore[attr-defined]
        go_on.set()
        for thread in threading.enumerate():
            if thread.name == "read-ahead":
                thread.join()


class TestWriteBehind:
    def test_put_waits_while_the_queue_is_full(self):
        go_on = threading.Event()
        n_put: list[int] = []

        def fill(queue: write_behind[int]) -> None:
            for n in range(6):
                queue.put(n)
                n_put.append(n)

        def sink(_: int) -> None:
            go_on.wait(HANGS_S)

        with write_behind(sink, depth=2) as queue:
            filler = threading.Thread(target=fill, args=(queue,))
            filler.start()
            time.sleep(0.05)
            assert len(n_put) <= 3
            go_on.set()
            filler.join()
        assert len(n_put) == 6

    def test_error_of_the_sink_is_raised_at_put(self):
        written: list[object] = []

        def sink(n: int) -> None:
            if n == 2:
                raise OSError("disk full")
            written.append(n)

        queue = write_behind(sink)
        with pytest.raises(OSError, match="disk full"):
            for n in range(1000):
                queue.put(n)
        assert written == [0, 1]

    def test_error_of_the_last_item_is_raised_at_close(self):
        def sink(_: int) -> None:
            time.sleep(0.01)
            raise OSError("disk full")

        queue = write_behind(sink)
        queue.put(1)
        with pytest.raises(OSError, match="disk full"):
            queue.close()

    def test_an_error_elsewhere_drops_what_waits(self):
        written: list[object] = []

        def sink(n: int) -> None:
            written.append(n)
            wait_until(lambda: queue._channel._cancelled)

        with pytest.raises(KeyError), write_behind(sink, depth=50) as queue:
            for n in range(50):
                queue.put(n)
            wait_until(lambda: written)
            raise KeyError
        assert written == [0]
        with pytest.raises(RuntimeError, match="after abort"):
            queue.put(1)


@pytest.mark.parametrize(
    "files, quota",
    [
        ({}, None),
        ({"cpu.max": "max 100000\n"}, None),
        ({"cpu.max": "150000 100000\n"}, 1.5),
        ({"cpu.max": "nonsense\n"}, None),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, None),
        ({"cpu/cpu.cfs_quota_us": "200000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 2.0),
    ],
)
def test_quota_of_a_container(
    tmp_path,
    monkeypatch,
    files,
    quota,
):
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert module._quota(tmp_path) == quota
    monkeypatch.setattr(module, "_CGROUP", tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)), raising=False)
    assert default_threads() == (64 if quota is None else 2)
