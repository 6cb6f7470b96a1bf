"""What ``prc batch`` shows while it runs: a line a finished file, or bars on a terminal."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from types import TracebackType

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from prc_cli.cli.batch_words import console, count_of, done_words, failed_words, now, rare_words, say
from prc_cli.cli.safe import printable
from prc_cli.core.findings import is_doubt
from prc_cli.jobs.batch.run import Again, Ready, RunEvent
from prc_cli.jobs.batch.types import Done, Failed, Started
from prc_cli.jobs.batch.types import Progress as Lines

Hear = Callable[[RunEvent], None]

_BESIDE_NAME = 60
"""Columns of a terminal that bar, counts and time take beside a name."""


class Final:
    """Passes events on; a failure only when it is known that the file is not tried again."""

    def __init__(self, *listeners: Hear) -> None:
        self._listeners = listeners
        self._held: Failed | None = None

    def __call__(self, event: RunEvent) -> None:
        """Hear an event."""
        held, self._held = self._held, None
        if held is not None and not (isinstance(event, Again) and event.name == held.name):
            self._tell(held)
        if isinstance(event, Failed):
            self._held = event
        else:
            self._tell(event)

    def close(self) -> None:
        """Pass on what was held back."""
        held, self._held = self._held, None
        if held is not None:
            self._tell(held)

    def _tell(self, event: RunEvent) -> None:
        for listener in self._listeners:
            with contextlib.suppress(OSError):  # a terminal or pipe that is gone must not stop the work
                listener(event)


class PlainLines:
    """One line a finished file, for logs; quiet: only what is wrong."""

    def __init__(self, *, quiet: bool, verbose: bool, stamps: bool) -> None:
        self._quiet, self._verbose, self._stamps = quiet, verbose, stamps
        self._n_todo = 0
        self._n_ended = 0

    def __call__(self, event: RunEvent) -> None:
        """Hear an event."""
        if isinstance(event, Ready):
            self._n_todo = len(event.plan.todo) + len(event.plan.refused)
            if self._verbose:
                self._say(
                    f"{count_of(self._n_todo, 'file')} to do, {event.jobs} at a time with {event.threads} threads each"
                )
        elif isinstance(event, Started) and self._verbose:
            self._say(f"begin {event.name} (worker {event.worker})")
        elif isinstance(event, Done):
            self._n_ended += 1
            if not self._quiet:
                self._say(f"{self._count()} done {event.name}: {done_words(event)}")
                if self._verbose:
                    for notice in event.notices:
                        if not is_doubt(notice):  # a warning of its own
                            self._say(f"note {event.name}: {notice}")
        elif isinstance(event, Failed):
            self._n_ended += 1
            self._say(f"{self._count()} failed {failed_words(event)}")
        else:
            text = rare_words(event, quiet=self._quiet)
            if text:
                self._say(text)

    def _count(self) -> str:
        return f"[{self._n_ended}/{self._n_todo}]" if self._n_todo else "[-]"

    def _say(self, text: str) -> None:
        say(f"{now()} {text}" if self._stamps else text)


class Bars:
    """One bar for the archive and a line for every file in work, on a terminal."""

    def __init__(self) -> None:
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=12),
            TextColumn("{task.fields[told]}", markup=False),
            TimeRemainingColumn(elapsed_when_finished=True),
            console=console(),
            transient=True,
        )
        self._archive: TaskID | None = None
        self._files: dict[str, tuple[TaskID, float, int]] = {}
        self._sizes: dict[str, int] = {}
        self._n_todo = self._n_done = self._n_failed = self._n_shots = 0
        self._start = time.perf_counter()

    def __enter__(self) -> Bars:
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._progress.stop()

    def __call__(self, event: RunEvent) -> None:
        """Hear an event."""
        if isinstance(event, Ready):
            self._begin(event)
        elif isinstance(event, Started):
            task = self._progress.add_task(f"  {_short(event.name)}", total=None, told="")
            self._files[event.name] = (task, time.perf_counter(), 0)
        elif isinstance(event, Lines):
            self._advance(event)
        elif isinstance(event, Done | Failed):
            self._end(event)
        else:
            text = rare_words(event, quiet=False)
            if isinstance(event, Again):
                self._remove(event.name)
            if text:
                self._progress.console.print(printable(text), soft_wrap=True)

    def _begin(self, event: Ready) -> None:
        self._sizes = {item.task.name: item.size for item in event.plan.todo}
        self._n_todo = len(self._sizes) + len(event.plan.refused)
        self._start = time.perf_counter()
        # empty files count a byte, so that an archive of them has an end
        total = sum(max(1, size) for size in self._sizes.values())
        self._archive = self._progress.add_task("archive", total=total, told=self._told())

    def _advance(self, event: Lines) -> None:
        found = self._files.get(event.name)
        if found is None:
            return
        task, start, n_lines = found
        n_lines += event.n_lines
        self._files[event.name] = (task, start, n_lines)
        seconds = time.perf_counter() - start
        rate = f", {n_lines / seconds:,.0f}/s" if seconds > 1 else ""
        self._progress.update(task, told=f"{n_lines:,} lines{rate}")

    def _end(self, event: Done | Failed) -> None:
        self._remove(event.name)
        if isinstance(event, Failed):
            self._n_failed += 1
            self._progress.console.print(printable(f"failed {failed_words(event)}"), soft_wrap=True)
        else:
            self._n_done += 1
            self._n_shots += event.n_shots
        if self._archive is not None:
            size = max(1, self._sizes[event.name]) if event.name in self._sizes else 0
            self._progress.update(self._archive, advance=size, told=self._told())

    def _remove(self, name: str) -> None:
        found = self._files.pop(name, None)
        if found is not None:
            self._progress.remove_task(found[0])

    def _told(self) -> str:
        seconds = time.perf_counter() - self._start
        rate = f", {self._n_shots / seconds / 1e6:.2g} M/s" if self._n_shots and seconds > 0 else ""
        failed = f", {self._n_failed} failed" if self._n_failed else ""
        return f"{self._n_done + self._n_failed}/{self._n_todo} files{failed}{rate}"


def _short(name: str) -> str:
    """Return the end of a name, as much as there is room for beside a bar."""
    text = printable(name)
    width = max(12, console().width - _BESIDE_NAME)
    return text if len(text) <= width else f"…{text[1 - width :]}"
