from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from prc_cli.core.profile import peak_memory, profiling, stage, timed, timed_items


def burn(seconds: float) -> None:
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


def test_a_stage_inside_another_is_not_counted_twice() -> None:
    with profiling() as profile, timed("outer"):
        burn(0.02)
        with timed("inner"):
            burn(0.05)
    found = {each.name: each for each in profile.stages()}
    assert found["inner"].cpu_s >= 0.05
    assert found["outer"].cpu_s >= 0.02
    assert sum(each.cpu_s for each in found.values()) <= profile.cpu_s
    assert found["outer"].wall_s + found["inner"].wall_s <= profile.wall_s


def test_threads_add_up() -> None:
    @stage("burning")
    def work() -> None:
        burn(0.02)

    with profiling() as profile:
        threads = [threading.Thread(target=work) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    (found,) = profile.stages()
    assert found.calls == 3
    assert 0.06 <= found.cpu_s <= profile.cpu_s


def test_nothing_is_kept_while_nobody_asks() -> None:
    with profiling() as profile:
        pass
    with timed("later"):
        pass
    assert profile.stages() == ()
    assert timed("one") is timed("other")


def test_a_stage_that_fails_is_timed_and_the_next_one_too() -> None:
    with profiling() as profile:
        with pytest.raises(ValueError, match="broken"), timed("failing"):
            raise ValueError("broken")
        with timed("after"):
            pass
    assert [each.name for each in profile.stages()] == ["failing", "after"]


def test_making_items_is_timed_and_using_them_is_not() -> None:
    closed = []

    def items() -> Iterator[int]:
        try:
            for n in range(3):
                burn(0.01)
                yield n
        finally:
            closed.append(True)

    with profiling() as profile:
        source = timed_items(items(), "reading")
        for _ in source:
            burn(0.03)
            break
        source.close()
    (found,) = profile.stages()
    assert 0.01 <= found.cpu_s <= profile.cpu_s - 0.03
    assert closed


def test_the_peak_of_memory_is_that_of_a_process_with_an_interpreter() -> None:
    peak = peak_memory()
    assert peak is None or 5 << 20 < peak < 1 << 40
