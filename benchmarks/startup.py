"""Startup time: compiling on an empty cache, and the command on a small file.

    python -m benchmarks.startup

CPU seconds include child processes; CPU and wall times are the least of several runs. Python
bytecode is cached in a folder of the run, empty at first, as in an installation, whatever the
environment says."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.pages import machine
from benchmarks.simulated import made
from prc_cli.jobs.doctor import every_loop

RUNS = 5
LOAD = """
import sys
from prc_cli.config import load_config
from prc_cli.jobs.classify import load_classifier
load_classifier(load_config(preset=sys.argv[1]))
"""
"""As the command does it."""
METHODS = {
    "prc": "urban",
    "sequential-angle": "street-scan",
    "fused": "fused",
    "fused-forest": "fused-forest",
}
"""One preset for every set of compiled loops."""
WARM = ("urban", "street-scan", "fused")
"""Presets whose warm start is timed."""
ONE = """
import sys, time
from importlib import import_module
from prc_cli.core.loops import load_loops, loops_of
from prc_cli.methods.sequential_angle import labels_loops
load_loops(loops_of(labels_loops))
loops = loops_of(import_module(sys.argv[1]))
begin = time.process_time()
load_loops(loops)
print(time.process_time() - begin)
"""
"""Load the compiler and compile something before timing."""


def run(arguments: list[str], cache: Path) -> tuple[float, float]:
    """Wall and CPU seconds of a Python process."""
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONPYCACHEPREFIX": str(cache.parent / "bytecode"),
    }
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = os.times()
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, *arguments], env=environment, check=True, stdout=subprocess.DEVNULL
    )
    seconds = time.perf_counter() - begin
    after = os.times()
    cpu = (
        after.children_user + after.children_system - before.children_user - before.children_system
    )
    return seconds, cpu


def row(title: str, times: list[tuple[float, float]]) -> None:
    """Print the least wall and CPU time."""
    print(
        f"| {title} | {min(wall for wall, _ in times):.2f} | {min(cpu for _, cpu in times):.2f} |"
    )


def cold(folder: Path) -> None:
    """First run after installation, for each method, and without children."""
    for method, preset in METHODS.items():
        times = [run(["-c", LOAD, preset], folder / f"{method}-{i}") for i in range(2)]
        row(f"first run: compile all of {method}", times)


def warm(folder: Path) -> None:
    """The command on a file of 400,000 shots: one side of a simulated street."""
    with np.load(made("street", folder, lines=372, seed=1)) as street:
        one_side = (street["angle_deg"] >= 0) & (street["angle_deg"] < 160)
        np.savez(
            folder / "small.npz",
            range_m=np.ascontiguousarray(street["range_m"][:, one_side]),
            zenith_deg=180 - street["angle_deg"][one_side],
        )
    classify = [
        "-m",
        "prc_cli",
        "classify",
        str(folder / "small.npz"),
        str(folder / "o.npy"),
        "--overwrite",
        "--quiet",
    ]
    works = {
        "`python -c pass`": ["-c", "pass"],
        "`import numpy, numba`": ["-c", "import numpy, numba"],
        "`prc --version`": ["-c", "from prc_cli.cli import main; main(['--version'])"],
    } | {f"`prc classify`, {preset}": [*classify, "--preset", preset] for preset in WARM}
    for title, arguments in works.items():
        run(arguments, folder / "warm")
        row(f"warm start, {title}", [run(arguments, folder / "warm") for _ in range(RUNS)])


def modules(folder: Path) -> None:
    """CPU seconds of compiling every module."""
    print("\n| module | CPU s |\n|---|---:|")
    for number, module in enumerate(sorted({loop.module for loop in every_loop()})):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / f"one-{number}")}
        process = subprocess.run(
            [sys.executable, "-c", ONE, module],
            env=environment,
            check=True,
            capture_output=True,
            text=True,
        )
        print(f"| {module} | {float(process.stdout):.2f} |")


def main() -> None:
    """Print the tables."""
    print(f"## Start\n\n{machine()}.\n\n| work | s | CPU s |\n|---|---:|---:|")
    with tempfile.TemporaryDirectory() as name:
        cold(Path(name))
        warm(Path(name))
        modules(Path(name))


if __name__ == "__main__":
    main()
