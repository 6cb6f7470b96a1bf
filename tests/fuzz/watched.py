"""A worker process that is watched and replaced.

By its own fork server when it dies, by us when it hangs.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from prc_cli.core.loops import load_loops
from prc_cli.jobs.doctor import every_loop
from tests.fuzz.targets import arguments
from tests.messages import folded

LIMIT_S = 10.0
"""A command that takes more processor time hangs [s]."""
WAIT_S = 15.0
"""After so long without an answer, and so long again, the processor time of the worker is looked at
[s]."""
MOST_WAITS = 20


class WatchedWorker:
    """A worker process that is replaced when it dies or hangs.

    Parameters
    ----------
    folder : Path
        ``seeds`` in it are read, folders of the workers are made and removed.
    """

    def __init__(self, folder: Path) -> None:
        # compiling them, once after installation, is no hang of the command that happens to need
        # them first
        load_loops(every_loop())
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None

    def read(self, target: str, case: Path) -> dict[str, Any]:
        """Read a file with functions of the library; the answer has ``faults``."""
        return self._ask({"read": target, "case": str(case)}, ("read", target), case)

    def run(self, command: tuple[str, ...], case: Path, sound: str = "") -> dict[str, Any]:
        """Run a command on a case, made of the seed ``sound``; the answer has ``faults``."""
        return self._ask({"command": command, "case": str(case), "sound": sound}, command, case)

    def run_guarded(self, command: tuple[str, ...], case: Path) -> dict[str, Any]:
        """Run a command as the user does, under the guard."""
        ended, left = self._end_of(command, case)
        faults = []
        printed = ended.stderr.decode("utf-8", "replace")
        if ended.returncode not in (0, 1, 2, 4):
            faults.append(f"guard: exit code {ended.returncode}, printed {printed[-300:]!r}")
        if ended.returncode in (1, 2) and (
            left or printed.count("error: ") != 1 or "Traceback" in printed
        ):
            faults.append(
                f"guard: exit code {ended.returncode}, left {left}, printed {printed[-300:]!r}"
            )
        return {"code": ended.returncode, "seconds": 0.0, "grown": 0, "faults": faults}

    def _ask(self, job: dict[str, Any], command: tuple[str, ...], case: Path) -> dict[str, Any]:
        if self._process is None or self._process.poll() is not None:
            self._start()
        assert self._process is not None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write((json.dumps(job) + "\n").encode())
        self._process.stdin.flush()
        used = None
        for _ in range(MOST_WAITS):
            ready, _, _ = select.select([self._process.stdout], [], [], WAIT_S)
            if ready:
                break
            # others may use the machine, too; a fresh worker loads modules and compiled loops first
            now = _cpu_seconds(self._process.pid)
            used = now if used is None else used
            if now - used > LIMIT_S:
                break
        line = self._process.stdout.readline() if ready else b""
        if not line:
            self.close()
            return {"code": None, "seconds": LIMIT_S, "grown": 0, "faults": ["hang: no answer"]}
        answer: dict[str, Any] = json.loads(line)
        if "died" in answer:
            faults = self._faults_of_death(command, case)
            return {"code": -answer["died"], "seconds": 0.0, "grown": 0, "faults": faults}
        if answer.get("panicked"):
            answer["faults"] += self._faults_of_death(command, case)
        if answer["seconds"] > LIMIT_S:
            answer["faults"].append(f"hang: {answer['seconds']:.1f} s")
        return answer

    def _faults_of_death(self, command: tuple[str, ...], case: Path) -> list[str]:
        """Run what ended the worker as the user runs it.

        a line, exit code 1 and nothing left are as they should be.
        """
        if command[0] == "read":
            command = ("info", "{case}")
        ended, left = self._end_of(command, case)
        lines = folded(ended.stderr.decode("utf-8", "replace")).splitlines()
        if (
            ended.returncode in (1, 2)
            and len(lines) == 1
            and lines[0].startswith("error: ")
            and not left
        ):
            return []
        if ended.returncode in (0, 4) and "panicked at" not in "".join(
            lines
        ):  # what a library tried and failed at
            return []
        return [
            (
                f"died, and under the guard: exit code {ended.returncode}, printed "
                f"{lines[:3]}, left {left}"
            )
        ]

    def _end_of(
        self, command: tuple[str, ...], case: Path
    ) -> tuple[subprocess.CompletedProcess[bytes], list[str]]:
        with tempfile.TemporaryDirectory(prefix="out-", dir=self._folder) as out:
            words = arguments(command, str(case), out, str(self._folder / "seeds"))
            with case.open("rb") if command[0] == "stream" else open(os.devnull, "rb") as source:  # noqa: PTH123
                ended = subprocess.run(
                    [sys.executable, "-m", "prc_cli", *words],
                    stdin=source,
                    capture_output=True,
                    check=False,
                )
            return ended, os.listdir(out)

    def _start(self) -> None:
        self.close()
        environment = {
            **os.environ,
            "OMP_NUM_THREADS": "1",
            "ARROW_DEFAULT_MEMORY_POOL": "system",
            "MALLOC_ARENA_MAX": "2",
            # a module that no process imported before is no file that a case writes
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.worker", str(self._folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,
        )

    def close(self) -> None:
        """End the worker and remove its files."""
        if self._process is None:
            return
        # it and the process that it forked
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                stream.close()  # type: ignore[union-attr]
        for path in self._folder.glob(f"*-of-{self._process.pid}"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        self._process = None


def _cpu_seconds(session: int) -> float:
    """Return the processor time of all processes that a worker consists of [s]."""
    used = 0.0
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, ValueError, IndexError):
            fields = path.read_text().rpartition(")")[2].split()
            if int(fields[3]) == session:
                used += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return used
