"""Kills runs of ``prc batch`` just before each of its steps in the output folder.

A step is an operation of Python on the file system there: making, linking, renaming, touching or
removing a file, or opening it to write. ``python -m tests.faults.step_kills`` takes all of them,
``--every 7`` each seventh; ``--names`` kills right after a file got its name instead. Exit code 1
at the first fault."""

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from tests.faults.harness import (
    Archive,
    Batch,
    check_known,
    check_nothing_half,
    fresh,
    hooked,
    make_archive,
    part_of,
    resume,
)

NAMES = ("2026/day 1/drive.npz", "2026/day 2/drive.laz")


@dataclass(frozen=True)
class Strike:
    """What is killed when."""

    step: int
    """Number of the step, or of the name; 0 for none."""
    victims: str
    """``all`` processes of the run, or ``self``: the one that is at work."""
    names: bool = False
    """Whether names are counted, not steps."""


def run_to(archive: Archive, out: Path, strike: Strike) -> tuple[Batch, int]:
    """Run until a step; return the run, ended, and how many steps there were."""
    counter = out.with_name("steps")
    counter.unlink(missing_ok=True)
    variable = "PRC_FAULTS_NAMES" if strike.names else "PRC_FAULTS_STEPS"
    environment = hooked(variable, f"{out}|{counter}|{strike.step}|{strike.victims}")
    batch = Batch(archive, out, jobs=1, environment=environment)
    code, said = batch.end()
    # the guard of the process that did the work lives on and tells
    assert code in (-9, 0) or (code == 1 and "was ended by signal 9" in said), (
        f"{strike}: {code}, {said}"
    )
    batch.wait_until_gone()
    return batch, counter.stat().st_size


def strike_step(archive: Archive, out: Path, strike: Strike) -> str:
    """Kill, check, resume, check; return what became of the run that was struck."""
    batch, _ = run_to(archive, fresh(out), strike)
    check_nothing_half(archive, out)
    check_known(archive, out)
    resume(archive, out)
    return "worker killed, the run went on" if batch.process.returncode == 0 else "killed"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--names", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="prc-faults-") as name:
        folder = Path(name)
        archive = part_of(make_archive(folder), folder / "few", NAMES)
        _, n_steps = run_to(archive, folder / "out", Strike(0, "all", options.names))
        counts: dict[str, int] = {}
        for victims in ("all", "self"):
            for step in range(options.first, n_steps + 1, options.every):
                ended = strike_step(archive, folder / "out", Strike(step, victims, options.names))
                counts[ended] = counts.get(ended, 0) + 1
                sys.stderr.write(f"step {step} of {n_steps}, {victims}: {ended}; {counts}\n")
        sys.stdout.write(f"{n_steps} steps, {counts}\n")


if __name__ == "__main__":
    main()
