"""A batch run from lock to summary; reads like the algorithm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from prc_cli.batch.plan import Estimate, Plan
from prc_cli.batch.settings import BatchSettings
from prc_cli.batch.summary import Alarm, BatchSummary
from prc_cli.batch.types import Engine, Event, Problem


@dataclass(frozen=True, slots=True)
class Noted:
    """Something about the run that the operator should know."""

    text: str


@dataclass(frozen=True, slots=True)
class Ready:
    """The plan stands."""

    plan: Plan
    jobs: int
    threads: int


@dataclass(frozen=True, slots=True)
class Again:
    """A file that failed will be tried again in this run."""

    name: str
    problem: Problem


RunEvent: TypeAlias = Ready | Event | Again | Alarm | Noted
"""What a listener hears; a :class:`Failed` that is followed by :class:`Again` is not final."""

Listener: TypeAlias = Callable[[RunEvent], None]


def _nobody(event: RunEvent) -> None:
    """Hear an event and do nothing."""


def plan_batch(
    settings: BatchSettings, engine: Engine | None = None, listener: Listener = _nobody
) -> tuple[Plan, Estimate]:
    """Say what :func:`run_batch` would do, and what it would take; nothing is written.

    Raises
    ------
    ConfigError, InputError
        As :func:`run_batch`; a lock is not looked at.
    """
    raise NotImplementedError


def run_batch(settings: BatchSettings, engine: Engine | None = None, listener: Listener = _nobody) -> BatchSummary:
    """Classify every file of an archive that is not done yet.

    Parameters
    ----------
    settings : BatchSettings
        What is asked for.
    engine : Engine, optional
        What runs the files; default: worker processes of this machine.
    listener : callable
        Hears every event, in this thread.

    Returns
    -------
    BatchSummary
        Written as ``summary.json`` too, while the lock is still held, also after a signal.

    Raises
    ------
    ConfigError
        When the configuration makes no sense, or archive and output folder lie in one another.
    InputError
        When the archive cannot be listed.
    BusyError
        When another run holds the lock.
    KeyboardInterrupt, SystemExit
        After the workers have stopped, and journal and summary say so.
    """
    raise NotImplementedError
