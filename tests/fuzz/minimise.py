"""What a campaign does with an input: traced, and made smaller."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from coverage import tracer as native

import prc_cli

MOST_TRIALS = 250
MOST_S = 30.0


def minimise(data: bytes, sound: bytes, shows: Callable[[bytes], bool]) -> bytes:
    """Put back what the fault does not need, then leave out what it does not need.

    Parameters
    ----------
    data : bytes
        Shows the fault.
    sound : bytes
        The undamaged seed.
    shows : callable
        Whether an input shows the fault; asked :data:`MOST_TRIALS` times and :data:`MOST_S` seconds
        at most.

    Returns
    -------
    bytes
        Still shows it.
    """
    end = time.monotonic() + MOST_S
    n_trials = 0
    for trials in (_put_back, _left_out):
        again = True
        while again:
            again = False
            for trial in trials(data, sound):
                if n_trials >= MOST_TRIALS or time.monotonic() > end:
                    return data
                n_trials += 1
                if trial != data and shows(trial):
                    data = trial
                    again = True
                    break
    return data


def _put_back(data: bytes, sound: bytes) -> Iterator[bytes]:
    n = min(len(data), len(sound))
    size = n
    while size:
        for start in range(0, n, size):
            if data[start : start + size] != sound[start : start + size]:
                yield data[:start] + sound[start : start + size] + data[start + size :]
        size //= 4


def _left_out(data: bytes, sound: bytes) -> Iterator[bytes]:
    size = len(data) // 2
    while size:
        for start in range(len(data) - size, -1, -size):
            yield data[:start] + data[start + size :]
        size //= 4


_ROOT = Path(prc_cli.__file__).parent
ROOMS = (
    "core",
    "formats",
    "streams",
    "matching",
    "evaluation",
    "imaging",
    "simulation",
    "jobs",
    "cli",
)
"""Parts of the program that are traced: all but the methods and their compiled loops."""
_TRACED = (*(f"{_ROOT / room}/" for room in ROOMS), str(_ROOT / "config.py"))


class Tracer:
    """Collects steps from line to line of this thread; :meth:`fresh` returns those that are new."""

    def __init__(self) -> None:
        self._known: dict[str, set[int]] = {}
        self._data: dict[str, set[int]] = {}
        tracer: Any = native.CTracer()
        tracer.data = self._data
        tracer.trace_arcs = True
        tracer.should_trace = _choose
        tracer.should_trace_cache = {}
        tracer.warn = tracer.disable_plugin = _ignore
        tracer.lock_data = tracer.unlock_data = _ignore
        # unset ones end the process
        tracer.check_include = tracer.should_start_context = tracer.switch_context = (
            tracer.concur_id_func
        ) = None
        tracer.file_tracers = {}
        self._tracer = tracer

    def start(self) -> None:
        """Begin to trace."""
        self._tracer.start()

    def stop(self) -> None:
        """End it."""
        self._tracer.stop()

    def fresh(self) -> list[str]:
        """Return the steps that were taken for the first time, in words that are the same in every
        process."""
        steps_taken = []
        for name, steps in self._data.items():
            known = self._known.setdefault(name, set())
            if len(steps) != len(known):
                short = name.removeprefix(f"{_ROOT}/")
                steps_taken += [f"{short}:{step:x}" for step in steps - known]
                known |= steps
        return steps_taken


def _choose(name: str, frame: FrameType) -> Any:
    place = native.CFileDisposition()
    place.original_filename = place.canonical_filename = place.source_filename = name
    place.trace = name.startswith(_TRACED)
    place.reason = ""
    place.file_tracer = None
    place.has_dynamic_filename = False
    return place


def _ignore(*_: object, **__: object) -> None:
    """Nothing is to be done."""
