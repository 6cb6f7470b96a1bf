"""Try many damaged files: ``python -m tests.fuzz.campaign [TARGET ...] --runs N --seconds S --seed K --keep FOLDER``.

Every case runs in a watched worker process with an address space of 3 GiB. A fault is: an exception other than a
refusal, another exit code than 0, 1, 2 or 4, a dead worker, more than ten seconds of processor time, memory beyond what
the file explains, a forbidden event (guard.py), an unprintable character in what is printed, a file left behind. A
faulty case is kept with the command beside it, once for every kind of fault.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import re
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from prc_cli.kernels import load_kernels
from tests.fuzz.mutations import mutate
from tests.fuzz.seeds import seed as content_of
from tests.fuzz.seeds import write_seeds
from tests.fuzz.targets import TARGETS, arguments, suffix_of_seed

LIMIT_S = 10.0
"""A command that takes more processor time hangs [s]."""
WAIT_S = 15.0
"""After so long without an answer, and so long again, the processor time of the worker is looked at [s]."""
MOST_WAITS = 20
JOBS_PER_WORKER = 3000


class WatchedWorker:
    """A worker process that is replaced when it dies or hangs."""

    def __init__(self, folder: Path) -> None:
        # compiling them, once after installation, is no hang of the command that happens to need them first
        load_kernels()
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self._n_jobs = 0

    def run(self, command: tuple[str, ...], case: Path) -> dict[str, Any]:
        """Run a command on a case; the answer has ``faults``."""
        if self._process is None or self._n_jobs >= JOBS_PER_WORKER:
            self._start()
        assert self._process is not None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write((json.dumps({"command": command, "case": str(case)}) + "\n").encode())
        self._process.stdin.flush()
        self._n_jobs += 1
        used = _cpu_seconds(self._process.pid)
        for _ in range(MOST_WAITS):
            ready, _, _ = select.select([self._process.stdout], [], [], WAIT_S)
            # others may use the machine, too; a fresh worker loads modules and compiled loops first
            limit = LIMIT_S if self._n_jobs > 1 else 6 * LIMIT_S
            if ready or _cpu_seconds(self._process.pid) - used > limit:
                break
        if not ready:
            self.close()
            return {"code": None, "seconds": LIMIT_S, "grown": 0, "faults": ["hang: no answer"]}
        line = self._process.stdout.readline()
        if not line:
            code = self._process.wait()
            self.close()
            return {"code": code, "seconds": 0.0, "grown": 0, "faults": self._faults_under_guard(command, case)}
        answer: dict[str, Any] = json.loads(line)
        if answer["seconds"] > LIMIT_S:
            answer["faults"].append(f"hang: {answer['seconds']:.1f} s")
        return answer

    def _faults_under_guard(self, command: tuple[str, ...], case: Path) -> list[str]:
        """Run what ended the worker as the user runs it: a line, exit code 1 and nothing left are as they should be."""
        with tempfile.TemporaryDirectory(prefix="out-", dir=self._folder) as out:
            words = arguments(command, str(case), out, str(self._folder / "seeds"))
            with case.open("rb") if command[0] == "stream" else open(os.devnull, "rb") as source:  # noqa: PTH123
                ended = subprocess.run(
                    [sys.executable, "-m", "prc_cli", *words], stdin=source, capture_output=True, check=False
                )
            lines, left = ended.stderr.decode("utf-8", "replace").splitlines(), os.listdir(out)
        if ended.returncode == 1 and len(lines) == 1 and lines[0].startswith("error: ") and not left:
            return []
        return [f"died, and under the guard: exit code {ended.returncode}, printed {lines[:3]}, left {left}"]

    def _start(self) -> None:
        self.close()
        environment = {
            **os.environ,
            "OMP_NUM_THREADS": "1",
            "ARROW_DEFAULT_MEMORY_POOL": "system",
            "MALLOC_ARENA_MAX": "2",
        }
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.worker", str(self._folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
        )
        self._n_jobs = 0

    def close(self) -> None:
        """End the worker and remove its files."""
        if self._process is None:
            return
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                stream.close()  # type: ignore[union-attr]
        for name in (f"out-{self._process.pid}", f"tmp-{self._process.pid}"):
            shutil.rmtree(self._folder / name, ignore_errors=True)
        (self._folder / f"printed-{self._process.pid}").unlink(missing_ok=True)
        self._process = None


def _cpu_seconds(process: int) -> float:
    """Return the processor time of all threads of a process [s]; 0 if it is gone."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@dataclass
class Tally:
    """What happened to the cases of a target."""

    n: int = 0
    seconds: float = 0.0
    codes: Counter[Any] = field(default_factory=Counter)
    slowest: float = 0.0
    grown: int = 0
    faults: Counter[str] = field(default_factory=Counter)


def kind_of(fault: str) -> str:
    """Return what makes a fault the same as another: its text without numbers and names."""
    lines = fault.splitlines()
    places = [line.strip() for line in lines if line.strip().startswith("File ")]
    where = re.sub(r".*/", "", places[-1]) if places else ""
    return re.sub(r"\d+", "N", lines[0][:80].split("/")[0]) + " " + where


def campaign(names: list[str], runs: int, seconds: float, first_seed: int, keep: Path) -> dict[str, Tally]:
    """Attack targets in turn; return what happened."""
    keep.mkdir(parents=True, exist_ok=True)
    tallies = {name: Tally() for name in names}
    end = time.monotonic() + seconds
    with tempfile.TemporaryDirectory(prefix="prc-fuzz-") as made:
        folder = Path(made)
        (folder / "seeds").mkdir()
        write_seeds(folder / "seeds")
        worker = WatchedWorker(folder)
        try:
            for number in range(first_seed, first_seed + runs):
                for name in names:
                    if time.monotonic() > end:
                        return tallies
                    _one(worker, folder, name, number, tallies[name], keep)
        finally:
            worker.close()
    return tallies


def _one(worker: WatchedWorker, folder: Path, name: str, number: int, tally: Tally, keep: Path) -> None:
    target = TARGETS[name]
    chosen = target.seeds[number % len(target.seeds)]
    suffix = suffix_of_seed(chosen)
    digest = int.from_bytes(hashlib.sha256(f"{name} {number}".encode()).digest()[:8], "little")
    command = target.commands[digest % len(target.commands)]
    data = mutate(content_of(chosen), suffix, digest)
    case = folder / f"case{suffix}"
    case.write_bytes(data)
    answer = worker.run(command, case)
    tally.n += 1
    tally.seconds += answer["seconds"]
    tally.codes[answer["code"]] += 1
    tally.slowest, tally.grown = max(tally.slowest, answer["seconds"]), max(tally.grown, answer["grown"])
    for fault in answer["faults"]:
        kind = kind_of(fault)
        tally.faults[kind] += 1
        if tally.faults[kind] == 1:
            stem = f"{name}-{number}-{hashlib.sha256(kind.encode()).hexdigest()[:8]}"
            (keep / f"{stem}{suffix}").write_bytes(data)
            text = f"prc {' '.join(command)}\nseed {chosen}, number {number}\n\n{fault}\n"
            (keep / f"{stem}.txt").write_text(text, encoding="utf-8", errors="backslashreplace")
            print(
                f"{name} {number} {chosen}: {fault[:1500]}\n  prc {' '.join(command)}\n  kept as {stem}{suffix}",
                flush=True,
            )


def main() -> None:
    """Run a campaign and print a row a target."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("targets", nargs="*", default=list(TARGETS), metavar="TARGET")
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-found"))
    given = parser.parse_args()
    tallies = campaign(given.targets, given.runs, given.seconds, given.seed, given.keep)
    for name, tally in tallies.items():
        codes = ", ".join(f"{code}: {n}" for code, n in sorted(tally.codes.items(), key=str))
        print(
            f"{name}: {tally.n} cases, {tally.seconds:.0f} s, exit codes {codes}; slowest {tally.slowest:.1f} s, "
            f"memory at most {tally.grown >> 20} MiB, faults {sum(tally.faults.values())}"
        )
        for kind, n in tally.faults.items():
            print(f"    {n} x {kind}")


if __name__ == "__main__":
    main()
