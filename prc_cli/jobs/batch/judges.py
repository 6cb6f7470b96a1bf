"""Processes that compare outputs with references: a file that ends its process costs one comparison, not the run.

A process is used for many files. It reads pairs from its standard input and writes confusion matrices to its standard
output; both are pickled. It ends when its input does.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from prc_cli.core.errors import PrcError
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.jobs.batch.local import how_ended
from prc_cli.jobs.batch.types import Problem
from prc_cli.jobs.evaluate import evaluate_all
from prc_cli.jobs.evaluate.options import EvaluateOptions

END_S = 5.0
"""How long a process may take to end when its input has ended [s]."""


@dataclass(frozen=True, slots=True)
class Pair:
    """What is compared."""

    predicted: Path
    reference: Path
    mapping: ClassMapping
    options: EvaluateOptions


class Judges:
    """Processes that compare, as many as are asked at a time; they end with the ``with`` block."""

    def __init__(self) -> None:
        self._free: queue.SimpleQueue[subprocess.Popen[bytes]] = queue.SimpleQueue()

    def __enter__(self) -> Judges:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                _end(self._free.get_nowait(), now=kind is not None)

    def compare(self, pair: Pair) -> ConfusionMatrix | Problem:
        """Compare two files in a process, from any thread; a process that dies is the problem of its files."""
        try:
            process = self._free.get_nowait()
        except queue.Empty:
            process = _start()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            pickle.dump(pair, process.stdin)
            process.stdin.flush()
            found: ConfusionMatrix | Problem = pickle.load(process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError):
            _end(process, now=False)
            problem = f"the process that compared it {how_ended(process.returncode)}"
            return Problem("killed", str(pair.predicted), problem, f"look at it and at {pair.reference}")
        except BaseException:
            _end(process, now=True)
            raise
        self._free.put(process)
        return found


def _start() -> subprocess.Popen[bytes]:
    path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    apart: dict[str, Any] = {"process_group": 0} if os.name == "posix" else {}
    try:
        return subprocess.Popen(
            # -P: nothing is imported from the current folder
            [sys.executable, "-P", "-m", __name__],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": path}, **apart,
        )  # fmt: skip
    except OSError as error:
        problem = f"cannot be started ({error.strerror or error})"
        raise PrcError("comparing process", problem, "fewer --jobs; check the limit of processes") from error


def _end(process: subprocess.Popen[bytes], *, now: bool) -> None:
    for stream in (process.stdin, process.stdout):
        with contextlib.suppress(OSError):
            if stream is not None:
                stream.close()
    if not now:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(END_S)
    if process.poll() is None:
        process.kill()
        process.wait()


def judge(pair: Pair) -> ConfusionMatrix | Problem:
    """Compare two files in this process."""
    try:
        return evaluate_all([pair.predicted], [pair.reference], pair.mapping, options=pair.options).matrix
    except (PrcError, OSError, MemoryError) as error:
        return Problem.of(error)


def main(pairs: IO[bytes], answers: IO[bytes]) -> None:
    """Answer until there are no more pairs."""
    while True:
        try:
            pair = pickle.load(pairs)
        except (EOFError, OSError):
            return
        pickle.dump(judge(pair), answers)
        answers.flush()


if __name__ == "__main__":
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    main(sys.stdin.buffer, out)
