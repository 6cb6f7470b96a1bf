"""Processes that a library may end: the child of a command, and the workers of ``prc batch``.

Libraries that decode foreign files may end their process: by a stack overflow, a wrong address or
an abort. So a command works in a child (:func:`fork`), and a batch in workers
(:class:`WorkerProcess`). The parent keeps what libraries print, and says how the child ended.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from prc_cli.core.files import clean_up, drop_noted_proofs, note_outputs
from prc_cli.core.interrupts import REPEATED_S
from prc_cli.core.process import hold_limits

LAST_PRINTED = 400
"""Length of the last output of a worker in a message [bytes]."""
_PASSED = ("SIGINT", "SIGTERM", "SIGHUP")
"""Signals that a parent passes on to its child."""
_PR_SET_PDEATHSIG = 1


def how_ended(code: int) -> str:
    """Describe the end of a process by its code, which is negative for signals.

    >>> how_ended(3), how_ended(-6)
    ('ended with exit code 3', 'was ended by signal 6 (SIGABRT)')
    """
    return f"ended with exit code {code}" if code >= 0 else f"was ended by {_name(-code)}"


def one_line(printed: bytes) -> str:
    """Return output of a library as one line.

    >>> one_line(b"stack  overflow ")
    'stack overflow'
    """
    return " ".join(printed.decode("utf-8", "replace").split())


def _name(number: int) -> str:
    names = {known.value: known.name for known in signal.Signals}
    return f"signal {number} ({names.get(number, 'unknown')})"


def _content(descriptor: int, n_last: int = sys.maxsize) -> bytes:
    size = os.lseek(descriptor, 0, os.SEEK_END)
    start = max(0, size - n_last)
    os.lseek(descriptor, start, os.SEEK_SET)
    return os.read(descriptor, size - start)


# -- the child of a command ------------------------------------------------------------------------


class Ended(NamedTuple):
    """How the child of a command ended."""

    code: int
    """Exit code, or minus the number of the signal that ended it."""
    printed: bytes
    """What libraries printed on stderr."""
    passed: list[int]
    """Signals that this process received meanwhile and passed on."""
    was_killed: bool
    """Whether this process killed it, since it did not end after a signal."""
    left: str
    """A sentence about finished outputs, if a signal ended it; what was unfinished is removed."""


def fork(patience_s: float) -> Ended | None:
    """Fork; return None in the child, and in the parent how the child ended.

    Only for Linux, and before this process has threads or large libraries. The child holds the
    limits of a decoding step, and ends with its parent. On stderr only Python still writes to the
    terminal, libraries to a file.

    Parameters
    ----------
    patience_s : float
        Time from a signal until the child is killed [s].

    Raises
    ------
    OSError
        If the system cannot fork.
    """
    printed = os.memfd_create("prc-printed")
    notes = os.memfd_create("prc-notes")
    # what is ignored, as by nohup, stays ignored
    signals = [signal.Signals[name] for name in _PASSED]
    passed = [number for number in signals if signal.getsignal(number) != signal.SIG_IGN]
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {*passed, signal.SIGCHLD})
    parent = os.getpid()
    try:
        child = os.fork()
    except OSError:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        raise
    if child:
        status, received, was_killed = _wait(child, passed, patience_s)
        code = os.waitstatus_to_exitcode(status)
        left = ""
        if code < 0:
            left = clean_up(_content(notes))
        else:
            drop_noted_proofs(_content(notes))
        return Ended(code, _content(printed), received, was_killed, left)
    _end_with(parent)
    note_outputs(notes)
    with contextlib.suppress(OSError):  # stderr was closed by whoever started this
        # nothing waits in a buffer: Python would fail at its exit when the reader of a pipe is gone
        terminal = io.FileIO(os.dup(2), "w")
        os.dup2(printed, 2)
        encoding = sys.stderr.encoding
        sys.stderr = io.TextIOWrapper(terminal, encoding, "backslashreplace", write_through=True)
    hold_limits()
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return None


def _end_with(parent: int) -> None:
    """Let the system kill this process when its parent dies."""
    import ctypes

    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)


def _wait(
    child: int, passed: list[signal.Signals], patience_s: float
) -> tuple[int, list[int], bool]:
    """Wait for the child and pass signals on; a second signal kills the child.

    Returns its status, the signals, and whether it was killed. A signal from the terminal reaches
    the child directly, a signal that a process sent to the parent does not.
    """
    awaited = {*passed, signal.SIGCHLD}
    received: list[int] = []
    first = math.inf
    while True:
        left_s = max(0.0, first + patience_s - time.monotonic())
        info = signal.sigtimedwait(awaited, left_s) if received else signal.sigwaitinfo(awaited)
        if info is not None and info.si_signo == signal.SIGCHLD:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                return status, received, False
            continue
        if info is None or time.monotonic() - first > REPEATED_S:
            os.kill(child, signal.SIGKILL)
            return os.waitpid(child, 0)[1], received, True
        first = min(first, time.monotonic())
        received.append(info.si_signo)
        if info.si_code <= 0:
            os.kill(child, info.si_signo)


# -- workers ---------------------------------------------------------------------------------------


class WorkerProcess:
    """A program of Python that receives and sends pickled messages, in a group of its own.

    Raises
    ------
    OSError
        If it cannot be started.
    """

    def __init__(self, module: str, arguments: list[str], environment: Mapping[str, str]) -> None:
        # these modules load slowly, and single commands do not need them
        import subprocess
        import tempfile

        # Ctrl-C on the terminal is for the parent only
        group: dict[str, Any] = {"process_group": 0}
        if os.name != "posix":
            group = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}  # type: ignore[attr-defined]
        self._printed = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        try:
            self._process = subprocess.Popen(
                # -P: nothing is imported from the current folder
                [sys.executable, "-P", "-m", module, *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._printed,
                env=dict(environment),
                **group,
            )
        except OSError:
            self._printed.close()
            raise

    @property
    def pid(self) -> int:
        """Its number."""
        return self._process.pid

    @property
    def code(self) -> int | None:
        """Its exit code, or minus the number of the signal that ended it; None if it is alive."""
        return self._process.poll()

    def send(self, message: object) -> None:
        """Send a message; if the process has ended, the end of its messages shows it."""
        import pickle

        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            pickle.dump(message, self._process.stdin)
            self._process.stdin.flush()

    def messages(self) -> Iterator[Any]:
        """Yield its messages until it ends."""
        import pickle

        assert self._process.stdout is not None
        with self._process.stdout as stream:
            while True:
                try:
                    message = pickle.load(stream)
                except Exception:  # the end, or a message that was cut by it
                    break
                yield message
        self._process.wait()

    def close_input(self) -> None:
        """Close its input: it rolls back its work and ends."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()

    def wait(self, seconds: float) -> bool:
        """Wait for its end, at most for a time; return whether it has ended."""
        import subprocess

        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
        return self.code is not None

    def kill(self) -> None:
        """Kill it; the end of its messages shows when it has ended."""
        self._process.kill()

    def how_ended(self) -> str:
        """Describe its end, and what it printed last."""
        end = how_ended(self._process.wait())
        with contextlib.suppress(OSError):
            if last := one_line(_content(self._printed.fileno(), LAST_PRINTED)):
                return f"{end}; it said: {last}"
        return end

    def close(self) -> None:
        """Close the files of a process that has ended or is abandoned."""
        self.close_input()
        with contextlib.suppress(OSError):
            self._printed.close()
