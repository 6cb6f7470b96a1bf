"""The benchmark of trust: what the program does when it is told something wrong, or when the file
is damaged.

    python -m benchmarks.trust                          # held-out scans, minutes
    python -m benchmarks.trust --quick                  # three small scans, below a minute
    python -m benchmarks.trust --set tuning             # scans on which limits may be chosen
    python -m benchmarks.trust --only "M wrong"         # rows whose name holds this text

Every case is a file and a command line, run through ``prc classify -q`` in this process
(``--processes``: in one of its own). Only the exit code, stderr and the labels count. A case is
silent when the exit code is 0, no warning was printed, and macro F1 is more than 0.10 below the
same scan rightly told. A scan that is rightly told and refused or doubted is a false alarm. Reads
../shared/data or $PRC_DATA for the real scans."""

from __future__ import annotations

import re
import shlex
import sys
import tempfile
import time
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from benchmarks.contest_judge import Verdict, compared
from benchmarks.pages import duration, heading, parser_of, say, table
from benchmarks.trust_cases import (
    METHODS,
    ROWS,
    Context,
    Pair,
    Row,
    Told,
    methods_of,
    right_forms,
)
from benchmarks.trust_scans import PARTS, Part, Source, Window, sources
from benchmarks.user import Labelled, Runner, classify, in_own_process, in_process
from prc_cli.core.types import I64, U8

_OPTION = (
    r"(?:-M \d+|--set [a-z_.]+=[^A-Z\s;,)]+(?=[\s;,)]|$)|--sort-by-time|--scanner [a-z_]+"
    r"|--lines (?:angle-wrap|rings|[a-z]+:[a-z0-9_.+-]+)|--columns "
    r"(?:angle|order|[a-z]+:[a-z0-9_.+-]+))"
)
_TYPED = re.compile(f"{_OPTION}(?: {_OPTION})*")
MOST_HINTS = 3
"""Messages in a row whose options are typed."""
NEAR = 0.02
"""Macro F1 by which labels may be worse than those of the right way where the options that were
named are typed."""
LOST = 0.10
"""Loss of macro F1 from which a result is wrong."""
WINDOWS = 12
QUICK_WINDOWS = 2
"""Windows along a scan that are told rightly."""
CASES = 2
QUICK_CASES = 1
"""Windows of a scan at which a row is run."""
Outcome: TypeAlias = Literal["silent", "doubted", "refused", "harmless"]
OUTCOMES: tuple[Outcome, ...] = ("silent", "doubted", "refused", "harmless")
WARNING = "warning: "
TOLD = "right: told"
"""Row of the windows that are rightly told."""


@dataclass(frozen=True, slots=True)
class Result:
    """A case and what became of it."""

    row: str
    scan: str
    first_line: int
    method: str
    outcome: Outcome
    f1: float
    """Macro F1, NaN where nothing was written."""
    f1_right: float
    """The same of the scan rightly told; 1 where that is refused."""
    said: str
    """First line on stderr."""
    is_right: bool = False
    """Whether nothing was wrong: doubts and refusals are false alarms."""
    hint_works: bool | None = None
    """Whether the option that is named, typed, gives the labels of the scan rightly told.

    None = none is named.
    """

    @property
    def is_alarm(self) -> bool:
        return self.is_right and self.outcome in ("doubted", "refused")


@dataclass(slots=True)
class Trial:
    """Runs cases, and keeps what the same window gave when it was rightly told."""

    folder: Path
    run: Runner = in_process
    results: list[Result] = field(default_factory=list)

    def classify(self, stated: Told, method: tuple[str, ...]) -> Labelled:
        """Run ``prc classify``."""
        options = (*method, *stated.options)
        return classify(stated.path, self.folder / "labels.npy", options, self.run)

    def judge(
        self,
        case: Case,
        stated: Told,
        f1_right: float,
        *,
        is_right: bool = False,
    ) -> Result:
        """Run a case and say what became of it."""
        done = self.classify(stated, case.options)
        f1 = (
            float("nan")
            if done.labels is None
            else macro_f1(case.mapping, done.labels, stated.truth)
        )
        said = next((line for line in done.stderr.splitlines() if line.strip()), "").replace(
            f"{self.folder}/", ""
        )
        outcome = outcome_of(done, f1, f1_right)
        works = (
            None
            if is_right or outcome not in ("doubted", "refused")
            else self.follow(case, stated, done, f1_right)
        )
        result = Result(
            case.row,
            case.scan,
            case.first_line,
            case.method,
            outcome,
            f1,
            f1_right,
            said,
            is_right,
            works,
        )
        self.results.append(result)
        return result

    def follow(
        self,
        case: Case,
        stated: Told,
        done: Labelled,
        f1_right: float,
    ) -> bool | None:
        """Type what a message says, then what the next one says.

        Return whether that gives the right labels.
        """
        works = None
        for _ in range(MOST_HINTS):
            typed = typed_by(done.stderr)
            if not typed or set(typed) <= set(stated.options[-len(typed) :]):
                break
            stated = replace(stated, options=(*stated.options, *typed))
            done = self.classify(stated, case.options)
            works = (
                done.labels is not None
                and macro_f1(case.mapping, done.labels, stated.truth) > f1_right - NEAR
            )
        return works


def typed_by(stderr: str) -> tuple[str, ...]:
    """Return the first options that a message names with their values.

    Those that insist or need more are none.

    >>> typed_by("error: a.bin: found M = 20; give -M 10; to accept it: --accept-doubt x")
    ('-M', '10')
    >>> typed_by("warning: down: ...; give it with --set input.nadir=DEG; or accept it")
    ()
    """
    match = _TYPED.search(stderr)
    return tuple(shlex.split(match[0])) if match else ()


@dataclass(frozen=True, slots=True)
class Case:
    """What is run where."""

    row: str
    scan: str
    first_line: int
    method: str
    mapping: str
    options: tuple[str, ...]
    """Of the method."""


def case_of(row: str, window: Window, method: str) -> Case:
    """Return the case of a row at a window."""
    place = window.scan, window.first_line
    return Case(row, *place, method, window.mapping, METHODS[method])


def outcome_of(done: Labelled, f1: float, f1_right: float) -> Outcome:
    """Return what became of a case."""
    if done.labels is None:
        return "refused"
    if done.exit_code or WARNING in done.stderr:
        return "doubted"
    return "silent" if f1 < f1_right - LOST else "harmless"


def macro_f1(mapping: str, codes: U8, truth: I64) -> float:
    """Return the mean F1 of the classes that exist, of records with a reference class.

    Parameters
    ----------
    mapping : str
        Key of ``contest_judge.MAPPINGS``.
    codes : (n,) uint8
        Labels that came out; 0, none, counts as unclassified.
    truth : (n,) int64
        Reference codes; 0 = not judged.
    """
    if len(codes) != len(truth):
        problem = f"{len(codes)} labels came out, expected {len(truth)}"
        raise AssertionError(problem)
    judged = truth != 0
    f1 = Verdict(compared(mapping, codes[judged], truth[judged])).f1()
    return float(np.mean(np.nan_to_num(list(f1.values()))))


def random_of(*parts: object) -> np.random.Generator:
    """Return random numbers that depend on a case alone."""
    return np.random.default_rng(zlib.crc32(" ".join(map(str, parts)).encode()))


def try_window(
    trial: Trial,
    source: Source,
    window: Window,
    rows: Iterable[Row],
    form: int,
    seed: int,
) -> None:
    """Run a window rightly told, then the rows, with every method."""
    for method in methods_of(window):
        random = random_of(seed, "right", window.scan, window.first_line, method)
        context = Context(trial.folder, method, random)
        case = case_of(TOLD, window, method)
        forms = right_forms(window)
        stated = forms[form % len(forms)](window, context)
        right = trial.judge(case, stated, 0.0, is_right=True)
        f1_right = 1.0 if np.isnan(right.f1) else right.f1
        for row in rows:
            if not row.aimed_only or context.is_aimed:
                try_row(trial, row, window, context, f1_right, seed)


def try_row(
    trial: Trial,
    row: Row,
    window: Window,
    context: Context,
    f1_right: float,
    seed: int,
) -> Result | None:
    """Run a row at a window."""
    random = random_of(seed, row.name, window.scan, window.first_line, context.method)
    made = row.make(window, replace(context, random=random))
    if made is None:
        return None
    case = case_of(row.name, window, context.method)
    if isinstance(made, Pair):
        right = trial.judge(replace(case, row=f"right: {row.name}"), made.right, 0.0, is_right=True)
        return trial.judge(case, made.wrong, 1.0 if np.isnan(right.f1) else right.f1)
    return trial.judge(case, made, f1_right, is_right=row.is_right)


def report_progress(text: str) -> None:
    """Print how far the runs are."""
    print(text, file=sys.stderr, flush=True)


def run_set(
    trial: Trial,
    part: Part,
    seed: int,
    *,
    is_quick: bool,
    only: str,
) -> None:
    """Run all scans of a set."""
    rows = [row for row in ROWS if only in row.name]
    for source in sources(part, seed, is_quick=is_quick):
        start = time.perf_counter()
        windows = source.windows(QUICK_WINDOWS if is_quick else WINDOWS)
        chosen = chosen_windows(
            rows, len(windows), QUICK_CASES if is_quick else CASES, source.name, seed
        )
        for i, window in enumerate(windows):
            if only and not chosen[i]:
                continue
            try_window(trial, source, window, chosen[i], i, seed)
        report_progress(
            f"{source.name}: {len(windows)} windows, {time.perf_counter() - start:.0f} s"
        )


def chosen_windows(
    rows: list[Row],
    n: int,
    per_scan: int,
    scan: str,
    seed: int,
) -> list[list[Row]]:
    """Return the rows of every window.

    Those for everywhere, the others at some windows by chance.
    """
    windows: list[list[Row]] = [[] for _ in range(n)]
    for row in rows:
        random = random_of(seed, "where", row.name, scan)
        where = (
            range(n)
            if row.everywhere
            else random.choice(n, min(per_scan, n), replace=False).tolist()
        )
        for i in where:
            windows[i].append(row)
    return windows


# What is printed


def print_summary(results: list[Result]) -> None:
    """One row per corruption."""
    print("## In short\n")
    wrong = [result for result in results if not result.is_right]
    names = [row.name for row in ROWS]
    by_row = {name: [result for result in wrong if result.row == name] for name in names}
    table(
        ("what is wrong", "cases", *OUTCOMES, "hint works"),
        (
            (name, len(of_row), *_counts(of_row))
            for name, of_row in {**by_row, "all": wrong}.items()
            if of_row
        ),
    )


def _counts(results: list[Result]) -> list[str]:
    hints = [result.hint_works for result in results if result.hint_works is not None]
    counts = [
        str(sum(result.outcome == outcome for result in results) or "") for outcome in OUTCOMES
    ]
    return [*counts, f"{sum(hints)} of {len(hints)}" if hints else ""]


def print_alarms(results: list[Result]) -> None:
    """False alarms by scan: every window told all, and told nothing of straight down."""
    print("## False alarms\n")
    say("""Windows along the scan that are rightly told, in turn as a plain dump, .npz, records,
    text and LAS, with every method; and in other forms with nothing wrong. Not told: scan angles in
    the file, nothing of straight down; what is refused or doubted there may be so with reason.""")
    rows = []
    for name in [*dict.fromkeys(result.scan for result in results), ""]:
        of_scan = [result for result in results if name in ("", result.scan)]
        right = [result for result in of_scan if result.is_right]
        untold = [result for result in of_scan if result.row == "down not told"]
        cells = [len(right), *(_n(right, kind) for kind in ("doubted", "refused")), len(untold)]
        cells += [_n(untold, kind) for kind in ("doubted", "refused", "silent")]
        rows.append((name or "all", *(cell or "" for cell in cells)))
    wrongs = ("down not told", "doubted", "refused", "silent")
    table(("scan", "rightly told", "doubted", "refused", *wrongs), rows)
    alarms = [result for result in results if result.is_alarm]
    n_right = sum(result.is_right for result in results)
    if n_right:
        print(
            f"{len(alarms)} of {n_right} rightly told runs are false alarms "
            f"({len(alarms) / n_right:.1%}).\n"
        )
    wrong = [result for result in results if result.is_right and result.outcome == "silent"]
    for result in [*alarms, *wrong]:
        print(
            f"- {result.row}, {result.scan}, line {result.first_line}, {result.method}: "
            f"{result.outcome}, F1 {result.f1:.2f}: {result.said}"
        )
    if alarms or wrong:
        print()


def _n(results: list[Result], outcome: Outcome) -> int:
    return sum(result.outcome == outcome for result in results)


def print_silent(results: list[Result]) -> None:
    """Every silent failure."""
    silent = [result for result in results if not result.is_right and result.outcome == "silent"]
    print("## Silent failures\n")
    if not silent:
        print("None.\n")
        return
    table(
        ("what is wrong", "scan", "from line", "method", "macro F1", "rightly told"),
        (
            (r.row, r.scan, r.first_line, r.method, f"{r.f1:.2f}", f"{r.f1_right:.2f}")
            for r in silent
        ),
    )


def main() -> None:
    """Print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("--set", dest="part", choices=PARTS, default="held-out")
    parser.add_argument("--quick", action="store_true", help="three small scans")
    parser.add_argument(
        "--seed", type=int, default=0, help="other streets, other windows, other damage"
    )
    parser.add_argument(
        "--only", metavar="NAME", default="", help="only rows whose name holds this text"
    )
    parser.add_argument(
        "--processes", action="store_true", help="a process for every run, as in a shell; slow"
    )
    arguments = parser.parse_args()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        trial = Trial(Path(name), in_own_process if arguments.processes else in_process)
        run_set(
            trial,
            arguments.part,
            arguments.seed,
            is_quick=arguments.quick,
            only=arguments.only,
        )
    results = trial.results
    print(heading("Trust: figures", "trust"))
    say(f"""Scans that are {
        "held out: no limit was chosen on them" if arguments.part == "held-out" else "for tuning"
    }, seed {arguments.seed}; {len(results)} runs of prc classify -q. Silent: exit
    code 0, no warning, and macro F1 more than {LOST:.2f} below the same scan rightly told. Doubted:
    a warning, or exit code 4. Refused: nothing is written. Harmless: macro F1 within {LOST:.2f}.
    Hint works: of the messages that name an option with its value, those that give, typed, labels
    within {NEAR:.2f} of the scan rightly told.""")
    print_summary(results)
    print_alarms(results)
    print_silent(results)
    print(duration())
    report_progress(f"{len(results)} runs, {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
