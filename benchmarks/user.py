"""Runs ``prc`` as a user does: arguments in; exit code, stderr and files out."""

from __future__ import annotations

import contextlib
import io
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from typing import TypeAlias

from benchmarks.contest_data import ROOT
from prc_cli.cli import main
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
    command = [sys.executable, "-m", "prc_cli", *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return done.returncode, folded(done.stderr)


CHILD = """
import resource, subprocess, sys
# a process takes over the peak of the one that starts it: this one is small
command = [sys.executable, "-m", "prc_cli", *sys.argv[1:]]
code = subprocess.run(command, stdout=sys.stderr).returncode
unit = 1024**2 if sys.platform == "darwin" else 1024
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / unit)
sys.exit(code)
"""


def peak_mib(arguments: Sequence[str]) -> float:
    """Run ``prc`` with these arguments; return its peak memory [MiB]."""
    command = [sys.executable, "-c", CHILD, *arguments]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
