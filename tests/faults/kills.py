"""Kills runs of ``prc batch`` at random moments, checks after each, and lets the last run of a
chain finish.

``python -m tests.faults.kills --kills 200 --seed 1`` prints counts as JSON; exit code 1 with the
reason at the first fault. ``--engine dask`` kills runs with a scheduler and workers that were
started before, and these too."""

import argparse
import json
import random
import sys
import tempfile
import time
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path

from tests.faults.harness import (
    FAST,
    NAMES,
    Archive,
    Batch,
    Tally,
    check_known,
    check_nothing_half,
    check_whole,
    entries,
    fresh,
    make_archive,
    moments,
    parts,
    resume,
)
from tests.faults.machines import Machines

KINDS = ("everything", "parent", "worker")
LONGEST_CHAIN = 10
"""Kills of one output folder in a row."""


def kill_many(
    archive: Archive,
    folder: Path,
    n_kills: int,
    seed: int,
    *,
    engine: str = "local",
    seconds: float = 1e9,
    tell: bool = False,
) -> Tally:
    """Kill until there were so many kills or seconds.

    Every chain of kills ends with a run that resumes.
    """
    rng = random.Random(seed)
    tally = Tally()
    end = time.monotonic() + seconds
    while sum(tally.kills.values()) < n_kills and time.monotonic() < end:
        out = fresh(folder / "out")
        with Machines(folder) if engine == "dask" else nullcontext() as machines:
            for _ in range(rng.randint(1, LONGEST_CHAIN)):
                if (
                    _kill_one(archive, out, rng, tally, engine, machines)
                    or sum(tally.kills.values()) >= n_kills
                ):
                    break
        resume(archive, out)
        tally.resumed_to_the_end += 1
        if tell:
            sys.stderr.write(f"{sum(tally.kills.values())} of {n_kills}: {tally}\n")
    return tally


def _kill_one(
    archive: Archive,
    out: Path,
    rng: random.Random,
    tally: Tally,
    engine: str,
    machines: Machines | None,
) -> bool:
    """Start a run and strike it; tell whether it came to its end all the same."""
    kind = rng.choice(KINDS if machines is None else (*KINDS, "scheduler"))
    tally.runs += 1
    options: tuple[str, ...] = ()
    if machines is not None:
        machines.start()
        options = ("--scheduler", machines.address)
    batch = Batch(archive, out, *options, jobs=rng.choice([1, 2, 2, 3]))
    for _ in moments(rng, archive, out, batch):
        struck = {
            "everything": batch.strike_all,
            "parent": batch.strike,
            "worker": lambda: (
                batch.strike_worker(rng) if machines is None else machines.strike_worker(rng, batch)
            ),
            "scheduler": lambda: machines is not None and machines.strike_scheduler(batch),
        }[kind]()
    if kind == "worker" or not struck:
        batch.ends(0)
        batch.wait_until_gone()
        check_whole(archive, out)
    else:
        said, _ = batch.process.communicate()
        # 2: it was killed before the run had found it
        assert kind != "scheduler" or batch.process.returncode in (0, 1, 2), said
        tally.longest_orphan_s = max(tally.longest_orphan_s, batch.wait_until_gone())
        if (
            machines is not None
        ):  # workers of others go on until they see that nobody wants what they do
            machines.close()
        check_nothing_half(archive, out)
        check_known(archive, out)
        tally.with_parts += bool(parts(out))
        running = out.exists() and any(entry.state == "running" for entry in entries(out).values())
        tally.with_running += running
    if struck:
        tally.count(f"{engine}: {kind}")
    else:
        tally.came_too_late += 1
    return kind == "worker" or not struck


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=1e9)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--engine", choices=("local", "dask"), default="local")
    parser.add_argument(
        "--all", action="store_true", help="All eight inputs, not the three quick ones."
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="prc-faults-") as folder:
        archive = make_archive(Path(folder), NAMES if options.all else FAST)
        tally = kill_many(
            archive,
            Path(folder),
            options.kills,
            options.seed,
            engine=options.engine,
            seconds=options.seconds,
            tell=True,
        )
    json.dump({**asdict(tally), "undisturbed_s": round(archive.seconds, 1)}, sys.stdout, indent=1)
    sys.stdout.write("\n")


if __name__ == "__main__":
    main()
