"""Runs a command in a child process, which a small parent watches.

The parent removes what a crash of the child leaves, prints a message, and ends with exit code 1.
This works only on Linux. On other systems, or with ``PRC_GUARD=0``, the command runs in the first
process, and a crash ends it by a signal. ``prc batch`` has worker processes on every system.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Container
from pathlib import Path

from prc_cli.core import process
from prc_cli.core.child import Ended, fork, how_ended, one_line
from prc_cli.core.errors import AFTER_SIGNAL, ExitCode, message

UNGUARDED = frozenset({"completion", "config", "demo", "doctor", "simulate"})
"""Commands that decode no foreign files."""
SWITCH = "PRC_GUARD"
"""Environment variable; 0 = no child process, for debuggers."""
PATIENCE_S = 5.0
BATCH_PATIENCE_S = 30.0
"""Time from a signal until the child is killed; ``prc batch`` must end its workers first [s]."""
MOST_NAMED = 2
"""Largest number of files in the message."""
LAST_PRINTED = 110
"""Length of the last output of a crashed library in the message [bytes]."""
_CRASHES = frozenset(
    {
        "SIGSEGV",
        "SIGABRT",
        "SIGBUS",
        "SIGFPE",
        "SIGILL",
        "SIGKILL",
        "SIGSYS",
        "SIGTRAP",
        "SIGXCPU",
        "SIGXFSZ",
    }
)


def go_on_in_child(arguments: list[str], commands: Container[str]) -> bool:
    """Fork if the command reads foreign files; return whether this is the child.

    The parent waits, and ends with the exit code of the child, or with FAILED after a crash.
    """
    command = next((word for word in arguments if not word.startswith("-")), "")
    is_needed = command in commands and command not in UNGUARDED
    is_possible = sys.platform == "linux" and threading.active_count() == 1
    asks_for_help = "-h" in arguments or "--help" in arguments
    if not is_needed or not is_possible or asks_for_help or os.environ.get(SWITCH) == "0":
        return False
    try:
        ended = fork(BATCH_PATIENCE_S if command == "batch" else PATIENCE_S)
    except OSError:  # an old kernel, or no more processes
        return False
    if ended is not None:
        os._exit(_code_of_child(ended, arguments))
    return True


def _code_of_child(ended: Ended, arguments: list[str]) -> int:
    """Return the exit code for the end of the child; after a crash print an error."""
    if "--debug" in arguments and ended.printed:
        _print_error(ended.printed.decode("utf-8", "replace").rstrip("\n"))
    if ended.code >= 0:
        return ended.code
    number = -ended.code
    if ended.was_killed and number == signal.SIGKILL:
        _print_error(message("error", f"interrupted; {ended.left}"))
        return AFTER_SIGNAL + ended.passed[0]
    if number in ended.passed:
        # it received the signal when it had already ended its work for the same one
        return AFTER_SIGNAL + number
    if number not in {signal.Signals[name] for name in _CRASHES}:
        # somebody ended it so: end in the same way
        signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {number})
        os.kill(os.getpid(), number)
        return AFTER_SIGNAL + number
    problem = f"the process that read it {how_ended(ended.code)}"
    last = one_line(ended.printed[-LAST_PRINTED:])
    printed = f"it printed: {last}; " if last else ""
    hint = "the file is damaged or malicious: copy it again, or check where it comes from"
    if number == signal.SIGKILL:
        hint = "probably too little memory: use fewer --threads or --jobs"
    elif number == signal.SIGXCPU:
        problem = f"decoding it made no progress in {process.STEP_CPU_S} s of processor time"
        printed = ""
    files = [word for word in arguments[1:] if Path(word).is_file()]
    where = ", ".join(files[:MOST_NAMED]) or arguments[0]
    if len(files) > MOST_NAMED:
        where += f" and {len(files) - MOST_NAMED} more"
    _print_error(message(f"error: {where}", f"{problem}; {printed}{ended.left}", hint))
    return ExitCode.FAILED


def _print_error(text: str) -> None:
    with contextlib.suppress(OSError):
        os.write(2, f"{text}\n".encode("utf-8", "backslashreplace"))
