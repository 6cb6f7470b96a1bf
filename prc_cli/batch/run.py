"""A batch run from lock to summary; reads like the algorithm."""

from __future__ import annotations

from collections.abc import Callable

from prc_cli.batch.result import BatchResult, BatchSettings, Listener, RunEvent
from prc_cli.batch.types import Engine


def _nobody(event: RunEvent) -> None:
    """Hear an event and do nothing."""


def run_batch(
    settings: BatchSettings,
    engine: Engine | None = None,
    listener: Listener = _nobody,
    conclude: Callable[[BatchResult], None] | None = None,
) -> BatchResult:
    """Classify every file of an archive that is not done yet.

    Parameters
    ----------
    settings : BatchSettings
        What is asked for.
    engine : Engine, optional
        What runs the files; default: worker processes of this machine.
    listener : callable
        Hears every event, in this thread.
    conclude : callable, optional
        Called with the result while the lock is still held, also after an interrupt: writes the summary.

    Returns
    -------
    BatchResult
        One outcome for every file that was begun or refused.

    Raises
    ------
    ConfigError
        When the configuration makes no sense, or archive and output folder lie in one another.
    InputError
        When the archive cannot be listed.
    BusyError
        When another run holds the lock.
    KeyboardInterrupt, SystemExit
        After the workers have stopped, and the journal and the summary say so.
    """
    raise NotImplementedError
