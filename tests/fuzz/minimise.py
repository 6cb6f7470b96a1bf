"""Makes an input that shows a fault smaller and more like the seed that it comes from."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

MOST_TRIALS, MOST_S = 250, 30.0


def minimise(data: bytes, sound: bytes, shows: Callable[[bytes], bool]) -> bytes:
    """Put back what the fault does not need, then leave out what it does not need.

    Parameters
    ----------
    data : bytes
        Shows the fault.
    sound : bytes
        The undamaged seed.
    shows : callable
        Whether an input shows the fault; asked :data:`MOST_TRIALS` times and :data:`MOST_S` seconds at most.

    Returns
    -------
    bytes
        Still shows it.
    """
    end, n_trials = time.monotonic() + MOST_S, 0
    for trials in (_put_back, _left_out):
        again = True
        while again:
            again = False
            for trial in trials(data, sound):
                if n_trials >= MOST_TRIALS or time.monotonic() > end:
                    return data
                n_trials += 1
                if trial != data and shows(trial):
                    data, again = trial, True
                    break
    return data


def _put_back(data: bytes, sound: bytes) -> Iterator[bytes]:
    n = min(len(data), len(sound))
    size = n
    while size:
        for at in range(0, n, size):
            if data[at : at + size] != sound[at : at + size]:
                yield data[:at] + sound[at : at + size] + data[at + size :]
        size //= 4


def _left_out(data: bytes, sound: bytes) -> Iterator[bytes]:
    size = len(data) // 2
    while size:
        for at in range(len(data) - size, -1, -size):
            yield data[:at] + data[at + size :]
        size //= 4
