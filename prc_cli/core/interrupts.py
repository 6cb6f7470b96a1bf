"""Signals that end a command or a worker, as exceptions in the main thread.

Python may run a signal handler while the arguments of a compiled loop are unpacked. An exception
there would leave the loop's caller with a broken result, or end the process by a wrong address. So
signals wait while a loop runs, and while finished outputs get their names.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable

REPEATED_S = 0.3
"""Two signals of a kind within this time are one: systemd and ``timeout`` send two [s]."""
AGAIN_S = 0.05
"""A signal that Python dropped is sent again so much later [s]."""


class _Waiting(threading.local):
    """State per thread: the main thread handles signals, and does not wait for other threads."""

    depth = 0
    error: BaseException | None = None

    def __enter__(self) -> None:
        self.depth += 1

    def __exit__(self, *_: object) -> None:
        self.depth -= 1
        if not self.depth and self.error is not None:
            error = self.error
            self.error = None
            raise error


signals_wait = _Waiting()
"""A context in which the exception of a signal waits until it ends."""


def raise_or_wait(error: BaseException) -> None:
    """Raise now, or when the context :data:`signals_wait` ends; for signal handlers."""
    if not signals_wait.depth:
        raise error
    signals_wait.error = error


class Interrupts:
    """Raises an exception for a signal, and again if Python dropped it in a destructor.

    Parameters
    ----------
    repeated_s : float
        Further signals of a kind within this time are ignored [s].
    """

    def __init__(self, *, repeated_s: float = REPEATED_S) -> None:
        self._repeated_s = repeated_s
        self._errors: dict[int, Callable[[], BaseException]] = {}
        self._heard: dict[int, float] = {}
        sys.unraisablehook = self._send_again

    def on(self, number: signal.Signals, error: Callable[[], BaseException]) -> None:
        """Raise a new exception when a signal comes."""
        self._errors[number] = error
        signal.signal(number, self._raise)

    def _raise(self, number: int, frame: object) -> None:
        before = self._heard.get(number)
        now = time.monotonic()
        if before is None or now - before > self._repeated_s:
            self._heard[number] = now
            raise_or_wait(self._errors[number]())

    def _send_again(self, dropped: sys.UnraisableHookArgs) -> None:
        error = dropped.exc_value
        if not isinstance(error, KeyboardInterrupt | SystemExit):
            sys.__unraisablehook__(dropped)
            return
        number = signal.SIGINT if isinstance(error, KeyboardInterrupt) else signal.SIGTERM
        self._heard.pop(number, None)
        # by a timer: an exception raised in this hook would be dropped as well
        timer = threading.Timer(AGAIN_S, send_to_main_thread, (number,))
        timer.daemon = True
        timer.start()


def send_to_main_thread(number: signal.Signals) -> None:
    """Send a signal to the main thread of this process, from any thread."""
    main = threading.main_thread().ident
    if main is not None and hasattr(signal, "pthread_kill"):
        signal.pthread_kill(main, number)
    else:
        signal.raise_signal(number)
