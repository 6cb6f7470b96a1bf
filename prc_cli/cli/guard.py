"""Runs a command in a child process, which a small parent watches.

Libraries that decode foreign files may end the process: by a stack overflow, a wrong address or an
abort. Then the parent removes temporary files, prints a message, and ends with exit code 1. The
parent forks before it has threads or large libraries. It passes signals on, and ends with the exit
code of the child.

This works only on Linux. On other systems, or with ``PRC_GUARD=0``, the command runs in the first
process, and a crash ends it by a signal. ``prc batch`` has worker processes on every system.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import signal
import sys
import threading
import time
from pathlib import Path

from prc_cli.core.errors import AFTER_SIGNAL, ExitCode, message
from prc_cli.core.process import STEP_CPU_S, hold_limits

SWITCH = "PRC_GUARD"
"""Environment variable; 0 = no child process, for debuggers."""
UNGUARDED = frozenset({"completion", "config", "demo", "doctor", "simulate"})
"""Commands that decode no foreign files."""
LAST_PRINTED = 110
"""Length of the last output of a crashed library in the message [bytes]."""
MOST_NAMED = 2
"""Largest number of files in the message."""
PATIENCE_S = 5.0
BATCH_PATIENCE_S = 30.0
"""Time from a signal until the child is killed; ``prc batch`` must end its workers first [s]."""
REPEATED_S = 0.3
"""Two signals of a kind within this time are one: systemd and ``timeout`` send two [s]."""
_PASSED = ("SIGINT", "SIGTERM", "SIGHUP")
_PR_SET_PDEATHSIG = 1
_CRASHES = (
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
)


def begin(arguments: list[str], commands: frozenset[str]) -> bool:
    """Fork; the child returns True, and the parent waits for it and exits.

    Returns False if no child is needed or possible.
    """
    name = next((word for word in arguments if not word.startswith("-")), "")
    if name not in commands - UNGUARDED or not {"-h", "--help"}.isdisjoint(arguments):
        return False
    if sys.platform != "linux" or os.environ.get(SWITCH) == "0" or threading.active_count() > 1:
        return False
    try:
        printed = os.memfd_create("prc-printed")
        notes = os.memfd_create("prc-notes")
    except OSError:  # an old kernel
        return False
    # what is ignored, as by nohup, stays ignored
    passed = {
        number
        for text in _PASSED
        if signal.getsignal(number := signal.Signals[text]) != signal.SIG_IGN
    }
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {*passed, signal.SIGCHLD})
    parent = os.getpid()
    watched = True
    try:
        child = os.fork()
    except OSError:  # no more processes: better without a guard than not at all
        child = 0
        watched = False
        parent = os.getppid()
    if child == 0:
        _end_with(parent)
        _keep_for_parent(printed, notes)
        hold_limits()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return watched
    status, sent, killed = _wait(child, passed, BATCH_PATIENCE_S if name == "batch" else PATIENCE_S)
    os._exit(_exit_code(status, sent, killed, arguments, printed, notes))


def _end_with(parent: int) -> None:
    """Let the system kill this process when its parent dies."""
    import ctypes

    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:
        os._exit(AFTER_SIGNAL + signal.SIGKILL)


def _keep_for_parent(printed: int, notes: int) -> None:
    """Hide the output of libraries from the terminal, and note temporary files.

    Messages of Python still reach the terminal.
    """
    from prc_cli.core import files

    files.note_temporaries(notes)
    try:
        terminal = os.dup(2)
    except OSError:  # closed by whoever started this
        return
    os.dup2(printed, 2)
    # nothing waits in a buffer: Python would fail at its exit when the reader of a pipe is gone
    raw = io.FileIO(terminal, "w")
    sys.stderr = io.TextIOWrapper(raw, sys.stderr.encoding, "backslashreplace", write_through=True)


def _wait(
    child: int, passed: set[signal.Signals], patience_s: float
) -> tuple[int, list[int], bool]:
    """Wait for the child and pass signals on; a second signal kills the child.

    Returns the status, the signals, and whether the child was killed. A signal from the terminal
    reaches the child directly, a signal that a process sent to the parent does not. The child
    counts two signals of a kind within a moment as one.
    """
    awaited = {*passed, signal.SIGCHLD}
    sent: list[int] = []
    first = math.inf
    while True:
        left = max(0.0, first + patience_s - time.monotonic())
        received = signal.sigtimedwait(awaited, left) if sent else signal.sigwaitinfo(awaited)
        if received is not None and received.si_signo == signal.SIGCHLD:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                return status, sent, False
            continue
        if received is None or time.monotonic() - first > REPEATED_S:
            os.kill(child, signal.SIGKILL)
            return os.waitpid(child, 0)[1], sent, True
        first = min(first, time.monotonic())
        sent.append(received.si_signo)
        if received.si_code <= 0:
            os.kill(child, received.si_signo)


def _exit_code(
    status: int,
    sent: list[int],
    killed: bool,
    arguments: list[str],
    printed: int,
    notes: int,
) -> int:
    """Return the exit code for the status of the child; after a crash print it and clean up."""
    said = _read(printed)
    if "--debug" in arguments and said:
        _print(said.decode("utf-8", "replace").rstrip("\n"))
    if not os.WIFSIGNALED(status):
        for note in _read(notes).split(b"\0"):
            # files that mark a killed run: this one has ended
            if note.startswith(b"!"):
                with contextlib.suppress(OSError):
                    os.unlink(note[1:])  # noqa: PTH108 - pathlib takes as long to load as all of this
        return os.WEXITSTATUS(status)
    number = os.WTERMSIG(status)
    left = _clean_up(_read(notes))
    name = _name(number)
    if killed and number == signal.SIGKILL:
        _print(message("error", f"interrupted; {left}"))
        return AFTER_SIGNAL + sent[0]
    if number in sent:  # it met the signal when it had already ended its work for the same one
        return AFTER_SIGNAL + number
    if name not in _CRASHES:  # somebody ended it so: end in the same way
        signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {number})
        os.kill(os.getpid(), number)
        return AFTER_SIGNAL + number
    _print(_crash_message(number, name, arguments, said, left))
    return ExitCode.FAILED


def _crash_message(
    number: int,
    name: str,
    arguments: list[str],
    said: bytes,
    left: str,
) -> str:
    named = [word for word in arguments[1:] if Path(word).is_file()]
    where = ", ".join(named[:MOST_NAMED]) + (
        f" and {len(named) - MOST_NAMED} more" * (len(named) > MOST_NAMED)
    )
    last = " ".join(said[-LAST_PRINTED:].decode("utf-8", "replace").split())
    problem = f"the process that read it was ended by signal {number} ({name})"
    said_last = f"it printed: {last}; " if last else ""
    hint = "the file is damaged or malicious: copy it again, or check where it comes from"
    if number == signal.SIGKILL:
        hint = "probably too little memory: use fewer --threads or --jobs"
    elif number == signal.SIGXCPU:
        problem = f"decoding it made no progress in {STEP_CPU_S} s of processor time"
        said_last = ""
    return message(f"error: {where or arguments[0]}", f"{problem}; {said_last}{left}", hint)


def _name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # a real-time signal
        return f"signal {number}"


def _read(descriptor: int) -> bytes:
    with open(descriptor, "rb") as handle:
        handle.seek(0)
        return handle.read()


def _clean_up(notes: bytes) -> str:
    """Remove the temporary files of the child; return a sentence about finished outputs."""
    import shutil

    from prc_cli.core.files import left_words, remove_unfinished

    names = dict.fromkeys(notes.split(b"\0"))
    placed = [Path(os.fsdecode(name[1:])) for name in names if name.startswith(b"+")]
    folders = [Path(os.fsdecode(name)) for name in names if name.endswith(b"/")]
    beside = [Path(os.fsdecode(name[1:])) for name in names if name.startswith(b"?")]
    outputs = [
        Path(os.fsdecode(name))
        for name in names
        if name.startswith(b"/") and not name.endswith(b"/")
    ]
    outputs = [path for path in outputs if path not in beside]
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):
        remove_unfinished(*outputs, *beside, beside=beside)
    return left_words(placed)


def _print(text: str) -> None:
    with contextlib.suppress(OSError):
        os.write(2, f"{text}\n".encode("utf-8", "backslashreplace"))
