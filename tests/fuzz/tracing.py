"""Tells which ways through the hand-written parsers an input takes: the C tracer of the package ``coverage``."""

from __future__ import annotations

from pathlib import Path
from types import FrameType
from typing import Any

from coverage import tracer as native

import prc_cli

_ROOT = Path(prc_cli.__file__).parent
ROOMS = ("core", "formats", "streams", "matching", "evaluation", "imaging", "simulation", "jobs", "cli")
"""Parts of the program that are traced: all but the methods and their compiled loops."""
_TRACED = (*(f"{_ROOT / room}/" for room in ROOMS), str(_ROOT / "config.py"))


class Tracer:
    """Collects steps from line to line of this thread; :meth:`fresh` returns those that are new."""

    def __init__(self) -> None:
        self._known: dict[str, set[int]] = {}
        self._data: dict[str, set[int]] = {}
        tracer: Any = native.CTracer()
        tracer.data, tracer.trace_arcs, tracer.should_trace, tracer.should_trace_cache = self._data, True, _choose, {}
        tracer.warn = tracer.disable_plugin = _ignore
        tracer.lock_data = tracer.unlock_data = _ignore
        # unset ones end the process
        tracer.check_include = tracer.should_start_context = tracer.switch_context = tracer.concur_id_func = None
        tracer.file_tracers = {}
        self._tracer = tracer

    def start(self) -> None:
        """Begin to trace."""
        self._tracer.start()

    def stop(self) -> None:
        """End it."""
        self._tracer.stop()

    def fresh(self) -> list[str]:
        """Return the steps that were taken for the first time, in words that are the same in every process."""
        found = []
        for name, steps in self._data.items():
            known = self._known.setdefault(name, set())
            if len(steps) != len(known):
                short = name.removeprefix(f"{_ROOT}/")
                found += [f"{short}:{step:x}" for step in steps - known]
                known |= steps
        return found


def _choose(name: str, frame: FrameType) -> Any:
    place = native.CFileDisposition()
    place.original_filename = place.canonical_filename = place.source_filename = name
    place.trace = name.startswith(_TRACED)
    place.reason, place.file_tracer, place.has_dynamic_filename = "", None, False
    return place


def _ignore(*_: object, **__: object) -> None:
    """Nothing is to be done."""
