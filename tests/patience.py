"""Waiting in tests: for an event, not for a fixed time, which slow machines would exceed.

Every process that a test starts has a time limit that ends it. It receives Ctrl-C (SIGINT) and the
end of a terminal (SIGHUP) even if the tests were started with them ignored: under nohup, by cron,
or in the background of a shell."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

HANGS_S = 600.0
"""What has not come by then never comes [s].

No test asks how fast a machine is: this only ends what hangs.
"""


def wait_until(is_so: Callable[[], object], what: str = "") -> None:
    """Look until something is so.

    Raises
    ------
    AssertionError
        When it never is.
    """
    end = time.monotonic() + HANGS_S
    while not is_so():
        assert time.monotonic() < end, f"never came: {what or is_so}"
        time.sleep(0.01)


def run(
    command: Sequence[str | os.PathLike[str]],
    *,
    check: bool = False,
    timeout: float = HANGS_S,
    **options: Any,
) -> subprocess.CompletedProcess[Any]:
    """Run a program to its end, as :func:`subprocess.run` does.

    Parameters
    ----------
    command : sequence of str or Path
    check : bool
        Raise :class:`subprocess.CalledProcessError` when its exit code is not 0.
    timeout : float
        It, and what it started, are killed after so long [s].
    **options
        Of :class:`subprocess.Popen`, ``capture_output``, and ``input`` for its stdin.

    Raises
    ------
    subprocess.TimeoutExpired
    """
    if options.pop("capture_output", False):
        options |= {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    text = options.pop("input", None)
    if text is not None:
        options["stdin"] = subprocess.PIPE
    with start(command, timeout=2 * timeout, **options) as process:
        out, err = process.communicate(text, timeout=timeout)
    if check and process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command, out, err)
    return subprocess.CompletedProcess(command, process.returncode, out, err)


@contextlib.contextmanager
def start(
    command: Sequence[str | os.PathLike[str]], *, timeout: float = HANGS_S, **options: Any
) -> Iterator[subprocess.Popen[Any]]:
    """Start a program in a process group of its own.

    Whatever of the group runs when the block ends is killed.

    Parameters
    ----------
    command : sequence of str or Path
    timeout : float
        The group is killed after so long [s], so that nobody waits for ever for what it prints.
    **options
        Of :class:`subprocess.Popen`.
    """
    process = popen(command, timeout=timeout, **options)
    try:
        yield process
    finally:
        _kill_group(process)
        process.wait()
        for stream in (process.stdin, process.stdout, process.stderr):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()


def popen(
    command: Sequence[str | os.PathLike[str]], *, timeout: float = HANGS_S, **options: Any
) -> subprocess.Popen[Any]:
    """Do the same for who ends the program without a block; the time limit holds here too."""
    if os.name == "posix" and not options.get("start_new_session"):
        options.setdefault("process_group", 0)
    with hearing_interrupts():
        process = subprocess.Popen(command, **options)
    threading.Thread(target=_end_late, args=(process, timeout), daemon=True).start()
    return process


def _end_late(process: subprocess.Popen[Any], timeout: float) -> None:
    """Kill a program that still runs after so long.

    In a thread, which ends soon after the program.
    """
    end = time.monotonic() + timeout
    while process.returncode is None:
        if time.monotonic() > end:
            _kill_group(process)
            return
        time.sleep(1.0)


@contextlib.contextmanager
def hearing_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt for SIGINT here, and let programs that are started here hear it and
    SIGHUP."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # what is ignored stays ignored in a new program, what has a handler does not
    heard = {signal.SIGINT: signal.default_int_handler}
    if os.name == "posix":
        heard[signal.SIGHUP] = signal.SIG_DFL
    ignored = [number for number in heard if signal.getsignal(number) is signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, heard[number])
    try:
        yield
    finally:
        for number in ignored:
            signal.signal(number, signal.SIG_IGN)


def dead_process() -> int:
    """Return the number of a process that has ended."""
    process = popen([sys.executable, "-c", ""])
    process.wait(HANGS_S)
    return process.pid


def _kill_group(process: subprocess.Popen[Any]) -> None:
    """Kill a program and its process group, which may outlive it."""
    with contextlib.suppress(OSError):
        if os.name == "posix":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
