"""Runs ``prc`` as a user does: arguments in; exit code, stderr, files, time and memory out."""

from __future__ import annotations

import contextlib
import io
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from benchmarks.pages import ROOT
from prc_cli.cli import main
from prc_cli.core.types import U8
from tests.messages import folded

Runner: TypeAlias = Callable[[list[str]], tuple[int, str]]
"""Arguments to exit code and stderr."""


def in_process(arguments: list[str]) -> tuple[int, str]:
    """Run the command line in this process.

    Return its exit code and stderr, every message in one line.
    """
    said = io.StringIO()
    is_main = threading.current_thread() is threading.main_thread()
    handlers = {
        number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT) if is_main
    }
    code = 0
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            main(arguments)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return code, folded(said.getvalue())


def in_own_process(arguments: list[str]) -> tuple[int, str]:
    """Run the command line as a shell does."""
    done = run(*arguments, check=False)
    return done.code, folded(done.stderr)


class Labelled(NamedTuple):
    """What ``prc classify -q`` says."""

    exit_code: int
    stderr: str
    labels: U8 | None
    """Codes of all records, None where nothing was written."""


def classify(
    path: Path, output: Path, options: Sequence[str], run: Runner = in_process
) -> Labelled:
    """Classify a file as a user does."""
    for left in (output, output.with_name(f"{output.name}.prc.json")):
        left.unlink(missing_ok=True)
    code, stderr = run(["classify", str(path), str(output), *options, "-q"])
    return Labelled(code, stderr, np.load(output).ravel() if output.exists() else None)


_CHILD = """
import resource, subprocess, sys
# a process takes over the peak of the one that starts it: this one is small
code = subprocess.run([sys.executable, "-m", "prc_cli", *sys.argv[1:]]).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
unit = 1024**2 if sys.platform == "darwin" else 1024
print(f"\\nused {used.ru_maxrss / unit} {used.ru_utime + used.ru_stime}")
sys.exit(code)
"""


@dataclass(frozen=True, slots=True)
class Done:
    """A command that ran in its own process."""

    code: int
    stdout: str
    stderr: str
    seconds: float
    """Wall time."""
    cpu_s: float
    peak_mib: float

    def table(self) -> Any:
        """Return what ``--json`` printed."""
        return json.loads(self.stdout)


def run(*arguments: object, check: bool = True) -> Done:
    """Run ``prc`` in its own process; a failure is an error if ``check``."""
    command = [sys.executable, "-c", _CHILD, *map(str, arguments)]
    start = time.perf_counter()
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - start
    if check and done.returncode not in (0, 4):
        problem = f"prc {' '.join(command[3:])}\n{done.stderr}"
        raise RuntimeError(problem)
    stdout, _, used = done.stdout.rpartition("\nused ")
    peak_mib, cpu_s = (float(number) for number in used.split())
    return Done(done.returncode, stdout, done.stderr, seconds, cpu_s, peak_mib)
