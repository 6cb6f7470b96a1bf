"""Progress bars, warnings, notes and ``--profile`` on stderr.

Results go to stdout by :mod:`prc_cli.cli.output`.
"""

from __future__ import annotations

import contextlib
import re
import sys
import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from prc_cli.cli.output import console, print_line, table_of
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import ExitCode, message, printable
from prc_cli.core.findings import is_doubt
from prc_cli.core.profile import Profile, StageTime, peak_memory

if TYPE_CHECKING:
    from prc_cli.core.findings import Finding
    from prc_cli.core.stream import Assumption, ReadTally
    from prc_cli.core.types import I64
    from prc_cli.formats.writing.record import RunRecord
    from prc_cli.jobs.run import Progress


NOT_KEPT = "not kept: "
"""Prefix of a note about values that the output cannot contain."""


COMPILING_S = 2.0
"""Longest time to load compiled loops from the cache [s]; after it a note is shown."""


@contextlib.contextmanager
def compiling_note(*, quiet: bool, what: str = "classifier") -> Iterator[None]:
    """Show a note if loading the classifier, or the simulator, takes long."""
    text = f"loading the {what}; the first start compiles it, which takes up to a minute"
    timer = threading.Timer(COMPILING_S, lambda: console().print(text, soft_wrap=True))
    timer.daemon = True
    if not quiet:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextlib.contextmanager
def line_progress(name: str, *, quiet: bool, unit: str = "lines") -> Iterator[Progress | None]:
    """Show a progress bar if stderr is a terminal."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from tqdm import tqdm

    with tqdm(desc=printable(name), unit=f" {unit}", unit_scale=True, leave=False) as bar:
        yield LineBar(bar)


class LineBar:
    """Moves a bar of tqdm by lines; its end follows from the share that is done."""

    def __init__(self, bar: Any) -> None:
        self._bar = bar
        self._share = 0.0

    def __call__(self, n_lines: int) -> None:
        """Move on by some lines."""
        self._bar.total = (
            None if self._share <= 0 else max(round((self._bar.n + n_lines) / self._share), 1)
        )
        self._bar.update(n_lines)

    def reached(self, share: float) -> None:
        """Set the share of the input that is done; less than before = the input is read again."""
        self._share = share if share >= self._share else 0.0


def lines_of_shots(n_lines: int, points_per_line: int) -> str:
    """Return how many lines of how many shots there are; scanners may differ in M, which is 0 then.

    >>> lines_of_shots(1200, 361), lines_of_shots(220, 0)
    ('1,200 lines of 361 shots', '220 lines')
    """
    return f"{n_lines:,} lines" + (f" of {points_per_line:,} shots" if points_per_line else "")


def accepting(check: str, hint: str) -> str:
    """Return a hint, and the option that accepts a warning.

    >>> accepting("units", "check -M")
    'check -M; or --accept-doubt units'
    """
    return f"{hint}{'; or ' if hint else ''}--accept-doubt {check}"


def print_doubts(doubts: Iterable[Finding]) -> ExitCode:
    """Print every warning on stderr, also with ``--quiet``; return the exit code."""
    code = ExitCode.DONE
    for doubt in doubts:
        hint = accepting(doubt.check, doubt.hint)
        click.echo(message(f"warning: {doubt.check}", doubt.problem, hint), err=True)
        code = ExitCode.LOOK
    return code


def end_with(doubts: Iterable[Finding]) -> None:
    """Print warnings, and end the command with exit code 4 if there are any."""
    if code := print_doubts(doubts):
        raise SystemExit(code)


def print_classes(name: str, labels: I64, config: Mapping[str, Any]) -> None:
    """Print the number of records by class."""
    table = table_of(f"{name}: classes", "class", "code", "shots", "share")
    codes = ClassCodes.model_validate(config["classes"])
    counts = labels.tolist()
    returned = sum(counts) - counts[Label.MISSING]
    for label in Label:
        if counts[label]:
            share = "" if label is Label.MISSING else f"{counts[label] / returned:.1%}"
            table.add_row(label.name.lower(), str(codes.code(label)), f"{counts[label]:,}", share)
    console().print(table)


def short_reason(text: str) -> str:
    """Return the first part of a reason.

    >>> short_reason("the place looks like a street: 94 % of the ground is smooth")
    'the place looks like a street'
    """
    return re.split("[:;] ", text)[0]


def print_choice(choice: Assumption | None) -> None:
    """Print the method that prc chose, and a short reason; None = the user named it."""
    if choice is not None:
        print_line(f"method: {choice.value}: {short_reason(choice.why)}")


def print_run_assumptions(record: RunRecord, *, verbose: bool) -> None:
    """Print all assumptions, or only the method that prc chose."""
    if verbose:
        print_assumptions(record.assumptions, record.tally)
    else:
        print_choice(
            next(
                (assumption for assumption in record.assumptions if assumption.key == "method"),
                None,
            )
        )


def print_notices(notices: Iterable[str]) -> None:
    """Print the notes of a run, without its warnings."""
    for notice in notices:
        if not is_doubt(notice):
            print_line(notice if notice.startswith(NOT_KEPT) else f"note: {notice}")


def notices_of_files(notices_by_file: Iterable[Iterable[str]]) -> Iterator[str]:
    """Yield the notes of several files; notes that differ only in their numbers are one.

    >>> list(notices_of_files([["12 of 40 rows repeat"], ["7 of 30 rows repeat"]]))
    ['12 of 40 rows repeat (1 more file has this note, with other numbers)']
    >>> list(notices_of_files([["scanner 1 leans", "scanner 2 leans"]]))
    ['scanner 1 leans', 'scanner 2 leans']
    """
    alike: dict[tuple[str, int], dict[str, None]] = {}
    for notices in notices_by_file:
        # the notes of a file on its scanners differ in numbers too: each stays
        seen = Counter[str]()
        for notice in dict.fromkeys(notices):
            words = re.sub(r"\d[\d.,]*", "0", notice)
            alike.setdefault((words, seen[words]), {})[notice] = None
            seen[words] += 1
    for first, *others in alike.values():
        n = len(others)
        files = "1 more file has" if n == 1 else f"{n} more files have"
        yield f"{first} ({files} this note, with other numbers)" if n else first


def print_assumptions(assumptions: Sequence[Assumption], tally: ReadTally) -> None:
    """Print the assumptions and the counts of the reader."""
    if assumptions:
        rows = ((item.key, item.value, item.why) for item in assumptions)
        console().print(table_of("assumptions", "key", "value", "reason", rows=rows, n_words=3))
    for name, count in tally.counts():
        console().print(f"{name}: {count:,} records")


REST = "all else"
"""Time outside all stages: threads of libraries, passing on of blocks, the run record."""
_WAITING = "waiting"
_NO_RATE = (REST, "loading compiled loops", "opening")
_NEGLIGIBLE_S = 1e-5


def profile_of(profile: Profile, n_shots: int, threads: int) -> dict[str, Any]:
    """Return an ended profile as plain values; ``threads`` are those that classify ``n_shots``."""
    return {
        "wall_s": profile.wall_s,
        "cpu_s": profile.cpu_s,
        "threads": threads,
        "shots": n_shots,
        "peak_memory_bytes": peak_memory(),
        "stages": [
            {
                "name": stage.name,
                "wall_s": stage.wall_s,
                "cpu_s": stage.cpu_s,
                "share_of_cpu": stage.cpu_s / profile.cpu_s if profile.cpu_s else 0.0,
                "mshots_per_cpu_s": _rate(stage, n_shots),
                "calls": stage.calls,
            }
            for stage in _rows(profile)
        ],
    }


def print_profile(profile: Profile, n_shots: int, threads: int) -> None:
    """Print a profile, the most expensive stage first."""
    shown = profile_of(profile, n_shots, threads)
    headings = ("stage", "wall s", "CPU s", "of CPU", "M/s of a core")
    table = table_of("where the time went", *headings, no_wrap=True)
    for row in shown["stages"]:
        wall = "" if row["name"] == REST else f"{row['wall_s']:.3f}"
        rate = "" if row["mshots_per_cpu_s"] is None else f"{row['mshots_per_cpu_s']:.3g}"
        table.add_row(row["name"], wall, f"{row['cpu_s']:.3f}", f"{row['share_of_cpu']:.1%}", rate)
    console().print(table)
    peak = shown["peak_memory_bytes"]
    memory = "" if peak is None else f", {peak / 2**20:.0f} MiB of memory at most"
    console().print(
        f"{shown['wall_s']:.3f} s by the clock, {shown['cpu_s']:.3f} s of processor time on "
        f"{threads} thread{'s' * (threads > 1)}{memory}; stages run at the same time",
        soft_wrap=True,
    )


def _rows(profile: Profile) -> Iterator[StageTime]:
    """Yield the stages by cost, then the remaining time, then the stages that wait."""
    stages = profile.stages()
    is_waiting = [stage.name.startswith(_WAITING) for stage in stages]
    at_work = (stage for stage, waits in zip(stages, is_waiting, strict=True) if not waits)
    yield from sorted(at_work, key=lambda stage: -stage.cpu_s)
    remaining_s = profile.cpu_s - sum(stage.cpu_s for stage in stages)
    yield StageTime(REST, 0.0, max(remaining_s, 0.0), 0)
    yield from (stage for stage, waits in zip(stages, is_waiting, strict=True) if waits)


def _rate(stage: StageTime, n_shots: int) -> float | None:
    """Million shots per second of processor time; None if the stage has no rate."""
    if stage.name.startswith(_WAITING) or stage.name in _NO_RATE or stage.cpu_s < _NEGLIGIBLE_S:
        return None
    return n_shots / stage.cpu_s / 1e6
