"""Words that all of ``prc batch`` says things with, and the console on stderr that it says them to."""

from __future__ import annotations

import contextlib
from datetime import UTC, datetime
from functools import cache
from typing import Any

from prc_cli.cli.report import SafeConsole
from prc_cli.cli.safe import printable
from prc_cli.jobs.batch.run import Again, Noted, RunEvent
from prc_cli.jobs.batch.types import Alarm, Done, Doubted, Failed, Problem


class _Patient(SafeConsole):
    """A console that falls silent when nobody reads it any more; rich would end the program."""

    def on_broken_pipe(self) -> None:
        """Go on without printing."""
        self.quiet = True

    def print(self, *objects: Any, **options: Any) -> None:
        """Print; older versions of rich pass on that nobody reads."""
        try:
            super().print(*objects, **options)
        except BrokenPipeError:
            self.quiet = True


@cache
def console() -> SafeConsole:
    """Return the console on stderr."""
    return _Patient(stderr=True, markup=False, highlight=False, emoji=False)


def say(text: str) -> None:
    """Print a line on stderr, whatever names are in it, if anybody is there to read it."""
    with contextlib.suppress(OSError):
        console().print(printable(text), soft_wrap=True)


def done_words(event: Done) -> str:
    """Return what became of a file, for people."""
    rate = f", {event.n_shots / event.seconds / 1e6:.2g} M/s" if event.seconds > 0 else ""
    return f"{event.n_shots:,} shots in {event.seconds:.1f} s{rate}"


def failed_words(event: Failed) -> str:
    """Return why a file failed; its name stands once, as it is in the archive."""
    return about(event.name, event.problem)


def about(name: str, problem: Problem) -> str:
    """Return what is wrong with a file, its name once."""
    where = problem.where
    # the journal holds names that are no UTF-8 escaped
    for written in (name, name.encode("utf-8", "backslashreplace").decode("utf-8")):
        before, found, rest = where.partition(written)
        if found and (not before or before.endswith(("/", "\\"))):
            where = name + rest
            break
    else:
        where = f"{name}: {where}" if where else name
    return f"{where}: {problem.problem}" + (f"; {problem.hint}" if problem.hint else "")


def doubt_words(doubt: Doubted) -> str:
    """Return a doubt about a file, and how to accept it.

    >>> doubt_words(Doubted("a.laz", "standing", "standing: lines do not differ; cut such stretches out"))
    'warning a.laz: standing: lines do not differ; cut such stretches out (to accept it: --accept-doubt standing)'
    """
    return f"warning {doubt.name}: {doubt.sentence} (to accept it: --accept-doubt {doubt.check})"


def rare_words(event: RunEvent, *, quiet: bool) -> str:
    """Return a line for what happens seldom; empty for all else."""
    if isinstance(event, Doubted):
        return doubt_words(event)
    if isinstance(event, Alarm):
        return f"alarm {event.name}: {event.sentence}"
    if quiet:
        return ""
    if isinstance(event, Again):
        return f"again {event.name}: tried once more ({event.problem.kind}: {event.problem.problem})"
    return f"note: {event.text}" if isinstance(event, Noted) else ""


def now() -> str:
    """Return the time as logs have it, UTC to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def minute(stamp: str) -> str:
    """Shorten a time of the journal.

    >>> minute("2026-11-21T17:49:02.072890+00:00")
    '2026-11-21 17:49:02'
    """
    return stamp[:19].replace("T", " ")


def count_of(count: int, what: str) -> str:
    """Return how many there are of something, for people.

    >>> count_of(1, "file"), count_of(2000, "file")
    ('1 file', '2,000 files')
    """
    return f"{count:,} {what}{'s' * (count != 1)}"


def size_of(n_bytes: int) -> str:
    """Return a size for people.

    >>> size_of(3 << 20), size_of(5 << 30)
    ('3.0 MiB', '5.0 GiB')
    """
    for unit, name in ((1 << 40, "TiB"), (1 << 30, "GiB")):
        if n_bytes >= unit:
            return f"{n_bytes / unit:.1f} {name}"
    return f"{n_bytes / 2**20:.1f} MiB"


def duration(seconds: float) -> str:
    """Return a time for people.

    >>> duration(5.04), duration(3725), duration(7500)
    ('5.0 s', '62 min', '2 h 5 min')
    """
    if seconds < 120:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"
