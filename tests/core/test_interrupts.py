"""Interrupts wait only for compiled code."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from prc_cli import kernels
from prc_cli.core.interrupts import held, raise_or_hold
from tests.patience import HANGS_S


def test_outside_it_is_raised_at_once() -> None:
    with pytest.raises(SystemExit, match="143"):
        raise_or_hold(SystemExit(143))


def test_inside_the_work_ends_first_even_when_nested() -> None:
    done = []

    @held
    def inner() -> None:
        raise_or_hold(KeyboardInterrupt())
        done.append("inner")

    @held
    def outer() -> None:
        inner()
        done.append("outer")

    with pytest.raises(KeyboardInterrupt):
        outer()
    assert done == ["inner", "outer"]
    inner_again = held(lambda: 5)
    assert inner_again() == 5, "nothing is left pending"


def test_an_error_of_the_work_gives_way_to_the_interrupt() -> None:
    @held
    def work() -> None:
        raise_or_hold(KeyboardInterrupt())
        raise ValueError

    with pytest.raises(KeyboardInterrupt):
        work()


def test_work_in_another_thread_holds_nothing_back_here() -> None:
    entered, leave = threading.Event(), threading.Event()

    @held
    def work() -> None:
        entered.set()
        leave.wait(HANGS_S)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        assert entered.wait(HANGS_S)
        with pytest.raises(KeyboardInterrupt):
            raise_or_hold(KeyboardInterrupt())
    finally:
        leave.set()
        thread.join()


def test_every_kernel_is_held() -> None:
    assert kernels.dilate.__wrapped__ is not kernels.dilate  # type: ignore[attr-defined]
    assert not kernels.dilate(np.zeros((2, 2), np.bool_), 1).any()
