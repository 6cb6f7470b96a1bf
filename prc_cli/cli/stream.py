"""``prc stream``: ranges on stdin, one class code per shot on stdout."""

from __future__ import annotations

import io
import sys
import time
from typing import Any

import click

from prc_cli.cli.options import Sectioned, config_from, live_options, output_options
from prc_cli.cli.output import print_event, print_line
from prc_cli.cli.report import compiling_note, print_assumptions, print_choice, print_doubts
from prc_cli.config import MethodChoice
from prc_cli.core.classes import Label
from prc_cli.core.errors import ExitCode
from prc_cli.core.findings import Finding
from prc_cli.jobs.classify import load_classifier
from prc_cli.jobs.stream import Rate
from prc_cli.jobs.stream import stream as label_stream

REPORT_S = 10.0
"""Time between two reports of the rate [s]."""


@click.command(cls=Sectioned)
@live_options
@output_options
def stream(as_json: bool, quiet: bool, verbose: bool, **options: Any) -> None:
    """Classify a live stream: ranges on stdin, one byte per shot on stdout.

    Without --layout the input is float32 ranges, -M of them per line. The output is the class code
    of every shot (0 = no return), the same bytes that prc classify writes as an array. prc writes
    it block by block (prc.lines_per_block, fused.lines_per_block).

    If you name no method, prc chooses one as prc classify does. If there are no angles, prc
    measures them from the ranges.

    prc reports the method, the rate and every warning (exit code 4) on stderr. With --json each is
    a line of JSON. The last line contains the counts of the classes and all warnings.

    \b
    Examples:
      scanner | prc stream -M 2154 > labels.bin
      cat drive.bin | prc stream --layout profiler.toml | logger
    """
    _check_pipes()
    loaded = config_from(options)
    if loaded.config.is_decided:
        with compiling_note(quiet=quiet or as_json):
            load_classifier(loaded)
    report = None if quiet else _Reporter(REPORT_S, as_json=as_json)
    # unbuffered: labels must not wait until a buffer is full
    source = io.FileIO(sys.stdin.fileno(), closefd=False)
    sink = io.FileIO(sys.stdout.fileno(), "w", closefd=False)

    def print_warning(doubt: Finding) -> None:
        if as_json:
            print_event({"doubt": doubt.as_dict()})
        else:
            print_doubts((doubt,))

    def print_method(choice: MethodChoice) -> None:
        if as_json:
            table = {"method": choice.method, "preset": choice.preset, "why": choice.why}
            print_event(table)
        elif not quiet:
            print_choice(choice.assumption)

    summary = label_stream(
        source, sink, loaded, report=report, doubted=print_warning, chosen=print_method
    )
    if as_json:
        labels = {label.name.lower(): int(summary.counts.labels[label]) for label in Label}
        doubts = [doubt.as_dict() for doubt in summary.doubts]
        table = {**_as_dict(summary.rate), "labels": labels, "doubts": doubts}
        print_event(table)
    elif not quiet:
        if verbose:
            print_assumptions(summary.info.assumptions, summary.counts.tally)
        print_line(_sentence(summary.rate))
    if summary.doubts:
        raise SystemExit(ExitCode.LOOK)


def _check_pipes() -> None:
    for name, file, original in (
        ("stdin", sys.stdin, sys.__stdin__),
        ("stdout", sys.stdout, sys.__stdout__),
    ):
        if original is None:
            message = f"{name} is closed; connect a pipe or a file"
            raise click.UsageError(message)
        if file.isatty():
            message = f"{name} is a terminal, but ranges and labels are bytes; use a pipe or a file"
            raise click.UsageError(message)


class _Reporter:
    """Prints the rate every few seconds."""

    def __init__(self, every_s: float, *, as_json: bool) -> None:
        self._every_s = every_s
        self._as_json = as_json
        self._next = time.perf_counter() + every_s

    def __call__(self, rate: Rate) -> None:
        if (now := time.perf_counter()) < self._next:
            return
        self._next = now + self._every_s
        if self._as_json:
            print_event(_as_dict(rate))
        else:
            print_line(_sentence(rate))


def _sentence(rate: Rate) -> str:
    shots = rate.n_shots / rate.seconds / 1e6 if rate.seconds else 0.0
    text = f"{rate.n_lines:,} lines, {rate.n_shots:,} shots in {rate.seconds:.1f} s"
    text += f" ({shots:.3g} million shots a second)"
    factor = rate.real_time()
    if factor is not None:
        text += f", {factor:.3g} x real time"
    return f"{text}; latency at most {1e3 * rate.latency_s:.1f} ms"


def _as_dict(rate: Rate) -> dict[str, object]:
    return {
        "lines": rate.n_lines,
        "shots": rate.n_shots,
        "seconds": rate.seconds,
        "real_time_factor": rate.real_time(),
        "longest_latency_s": rate.latency_s,
    }
