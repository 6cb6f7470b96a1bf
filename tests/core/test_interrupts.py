"""Signals wait while compiled loops run."""

import threading

import pytest

from prc_cli.core.interrupts import raise_or_wait, signals_wait
from prc_cli.core.loops import Loop
from tests.patience import HANGS_S


def test_outside_it_is_raised_at_once():
    with pytest.raises(SystemExit, match="143"):
        raise_or_wait(SystemExit(143))


def test_inside_the_work_ends_first_even_when_nested():
    done = []
    with pytest.raises(KeyboardInterrupt), signals_wait:
        with signals_wait:
            raise_or_wait(KeyboardInterrupt())
            done.append("inner")
        done.append("outer")
    assert done == ["inner", "outer"]
    with signals_wait:
        pass  # nothing is left waiting


def test_work_in_another_thread_lets_nothing_wait_here():
    entered = threading.Event()
    leave = threading.Event()

    def work() -> None:
        with signals_wait:
            entered.set()
            leave.wait(HANGS_S)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        assert entered.wait(HANGS_S)
        with pytest.raises(KeyboardInterrupt):
            raise_or_wait(KeyboardInterrupt())
    finally:
        leave.set()
        thread.join()


def test_a_loop_ends_before_the_exception_of_a_signal(monkeypatch):
    done = []

    def double(value: int) -> int:
        raise_or_wait(KeyboardInterrupt())
        done.append(value)
        return 2 * value

    interrupted = Loop(double, "")
    monkeypatch.setattr(interrupted, "_compiled", double)
    with pytest.raises(KeyboardInterrupt):
        interrupted(3)
    assert done == [3]
