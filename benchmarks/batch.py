"""Overhead of `prc batch`, and recovery when a worker is killed.

    python -m benchmarks.batch

60 small LAZ files (one simulated street, copied). CPU seconds (children included) and wall time are
the least of several rounds, each of which runs every way in turn (one process per file only in the
first). The outputs of all ways are compared: their bytes are equal."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from prc_cli.jobs.batch.run import run_batch
from prc_cli.jobs.batch.types import BatchSettings, Started
from prc_cli.jobs.classify import classify

FILES = 60
LINES = 60
ROUNDS = 3
JOBS = 2
PRC = [sys.executable, "-P", "-m", "prc_cli"]
LOOP = """
import sys
from pathlib import Path
from prc_cli.jobs.classify import classify
for name in sorted(Path(sys.argv[1]).iterdir()):
    if name.suffix == ".laz":
        classify(name, Path(sys.argv[2]) / name.name, threads=1)
"""
KILLED_AFTER = 8
"""Files finished when a worker is killed."""


def archive(folder: Path) -> Path:
    """60 files of one street."""
    place = folder / "archive"
    place.mkdir()
    first = place / "00.laz"
    subprocess.run(
        [*PRC, "simulate", "street", "-q", str(first), "--lines", str(LINES)], check=True
    )
    for path in place.iterdir():
        if path != first:
            path.unlink()
    for i in range(1, FILES):
        shutil.copy(first, place / f"{i:02}.laz")
    return place


def one(source: Path, out: Path) -> None:
    classify(source, out, threads=1)


def loop(source: Path, out: Path) -> None:
    """One process that calls `classify` for every file."""
    subprocess.run([sys.executable, "-P", "-c", LOOP, str(source), str(out)], check=True)


def xargs(source: Path, out: Path, jobs: int) -> subprocess.Popen[bytes]:
    """One process per file."""
    names = "\0".join(str(path) for path in sorted(source.iterdir())).encode()
    script = f'exec "$@" "$0" "{out}/$(basename "$0")"'
    command = ["sh", "-c", script]
    process = subprocess.Popen(
        [
            "xargs",
            "-0",
            "-P",
            str(jobs),
            "-I",
            "{}",
            *command,
            "{}",
            *PRC,
            "classify",
            "-q",
            "--threads",
            "1",
        ],
        stdin=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert process.stdin is not None
    process.stdin.write(names)
    process.stdin.close()
    return process


def batch(source: Path, out: Path, jobs: int) -> None:
    command = [*PRC, "batch", "-q", "--jobs", str(jobs), "--threads", "1", str(source), str(out)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


@dataclass
class Way:
    """A way to classify the files, and its times."""

    title: str
    run: Callable[[Path, Path], Any]
    rounds: int = ROUNDS
    times: list[tuple[float, float]] = field(default_factory=list)
    outputs: dict[str, bytes] = field(default_factory=dict)

    def measure(self, source: Path, out: Path) -> None:
        out.mkdir()
        before = os.times()
        begin = time.perf_counter()
        self.run(source, out)
        seconds = time.perf_counter() - begin
        after = os.times()
        self.times.append((seconds, cpu_of(before, after)))
        self.outputs = {
            path.name: path.read_bytes() for path in out.iterdir() if path.suffix == ".laz"
        }
        shutil.rmtree(out)

    def print(self) -> None:
        wall = min(wall for wall, _ in self.times)
        cpu = min(cpu for _, cpu in self.times)
        print(
            f"| {self.title} | {wall:.1f} | {cpu:.1f} | {1000 * cpu / FILES:.0f} | "
            f"{len(self.outputs)} |",
            flush=True,
        )


def cpu_of(before: os.times_result, after: os.times_result) -> float:
    """CPU seconds of the child processes that ended meanwhile."""
    return (
        after.children_user + after.children_system - before.children_user - before.children_system
    )


def n_done(out: Path) -> int:
    return len([path for path in out.iterdir() if path.suffix == ".laz"])


def children(process: int) -> list[int]:
    processes = []
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            if int(place.read_text().rpartition(")")[2].split()[1]) == process:
                processes.append(int(place.parent.name))
        except OSError:
            continue
    return processes


def kill_batch(source: Path, out: Path) -> None:
    started: list[Started] = []

    def hear(event: object) -> None:
        if isinstance(event, Started):
            started.append(event)
            if len(started) == KILLED_AFTER:
                os.kill(int(event.worker.split()[-1]), signal.SIGKILL)

    run_batch(BatchSettings(source, out, jobs=JOBS, threads=1), listener=hear)


def kill_pool(source: Path, out: Path) -> None:
    """The process pool of the standard library, for comparison."""
    with ProcessPoolExecutor(JOBS) as pool:
        futures = [pool.submit(one, path, out / path.name) for path in sorted(source.iterdir())]
        while sum(future.done() for future in futures) < KILLED_AFTER:
            time.sleep(0.01)
        os.kill(next(iter(pool._processes)), signal.SIGKILL)
        try:
            for future in futures:
                future.result()
        except BrokenProcessPool:
            return


def kill_xargs(source: Path, out: Path) -> None:
    process = xargs(source, out, JOBS)
    while n_done(out) < KILLED_AFTER:
        time.sleep(0.01)
    while not (below := children(process.pid)):
        time.sleep(0.01)
    os.kill(below[0], signal.SIGKILL)
    process.wait()


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = archive(folder)
        size = (source / "00.laz").stat().st_size
        print(
            f"{FILES} files of {LINES} lines, {size / 1e6:.2f} MB each; least of {ROUNDS} rounds\n"
        )
        loop(source, folder_of(folder, "warm"))
        ways = [
            Way("loop of `classify`, one process", loop),
            Way("`prc batch --jobs 1`", lambda source, out: batch(source, out, 1)),
            Way(f"`prc batch --jobs {JOBS}`", lambda source, out: batch(source, out, JOBS)),
            Way(
                f"`xargs -P {JOBS} prc classify`",
                lambda source, out: xargs(source, out, JOBS).wait(),
                rounds=1,
            ),
        ]
        for number in range(ROUNDS):
            for way in ways:
                if number < way.rounds:
                    way.measure(source, folder / "out")
                    assert way.outputs == ways[0].outputs, way.title
        print("| way | wall s | CPU s | CPU ms a file | files done |")
        print("|---|---|---|---|---|")
        for way in ways:
            way.print()
        again = measure_again(source, folder)
        print(f"\nA second run of prc batch, which finds all done: {again:.2f} CPU s.\n")
        print(f"| one worker killed after {KILLED_AFTER} files | files done |")
        print("|---|---|")
        kills = (
            ("prc batch", kill_batch),
            ("ProcessPoolExecutor", kill_pool),
            ("xargs", kill_xargs),
        )
        for title, kill in kills:
            out = folder_of(folder, f"killed-{title}")
            kill(source, out)
            print(f"| {title} | {n_done(out)} |", flush=True)


def folder_of(folder: Path, name: str) -> Path:
    place = folder / name.replace(" ", "-")
    place.mkdir()
    return place


def measure_again(source: Path, folder: Path) -> float:
    out = folder_of(folder, "again")
    batch(source, out, JOBS)
    times = []
    for _ in range(ROUNDS):
        before = os.times()
        batch(source, out, JOBS)
        times.append(cpu_of(before, os.times()))
    return min(times)


if __name__ == "__main__":
    main()
