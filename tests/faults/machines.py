"""A scheduler and two workers of Dask that were started by themselves, to be killed."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Any

from tests import patience
from tests.faults.harness import Batch
from tests.patience import wait_until

_QUIET = {"DASK_LOGGING__DISTRIBUTED": "critical"}


class Machines:
    """Processes on loopback; nobody but :meth:`start` replaces those that were killed.

    Parameters
    ----------
    folder : Path
        For the address of the scheduler and the files of the workers.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._scheduler: subprocess.Popen[Any] | None = None
        self._workers: list[subprocess.Popen[Any]] = []
        self.address = ""

    def __enter__(self) -> Machines:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def start(self) -> None:
        """Start what is not running."""
        scheduler_file = self._folder / "scheduler.json"
        if self._scheduler is None or self._scheduler.poll() is not None:
            self.close()
            scheduler_file.unlink(missing_ok=True)
            words = (
                "distributed.cli.dask_scheduler",
                "--host",
                "127.0.0.1",
                "--port",
                "0",
                "--no-dashboard",
            )
            self._scheduler = self._begin(*words, "--scheduler-file", str(scheduler_file))
            wait_until(lambda: scheduler_file.exists() and scheduler_file.read_text().endswith("}"))
            self.address = json.loads(scheduler_file.read_text())["address"]
        self._workers = [worker for worker in self._workers if worker.poll() is None]
        while len(self._workers) < 2:
            words = (
                "distributed.cli.dask_worker",
                self.address,
                "--nthreads",
                "1",
                "--no-dashboard",
                "--no-nanny",
            )
            self._workers.append(self._begin(*words, "--local-directory", str(self._folder / "w")))

    def _begin(self, *words: str) -> subprocess.Popen[Any]:
        return patience.popen(
            [sys.executable, "-m", *words],
            env={**os.environ, **_QUIET},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def strike_worker(self, rng: random.Random, batch: Batch) -> bool:
        """Kill one worker; tell whether the run was still at work."""
        rng.choice(self._workers).kill()
        return batch.process.poll() is None

    def strike_scheduler(self, batch: Batch) -> bool:
        """Kill the scheduler; tell whether the run was still at work."""
        assert self._scheduler is not None
        self._scheduler.kill()
        return batch.process.poll() is None

    def close(self) -> None:
        """End all."""
        for process in (*self._workers, *([] if self._scheduler is None else [self._scheduler])):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        self._workers = []
        self._scheduler = None
