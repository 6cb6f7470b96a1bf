"""Kills runs of ``prc batch`` at random moments, checks after each, and lets the last run of a chain finish.

``python -m tests.faults.kills --kills 200 --seed 1`` prints counts as JSON; exit code 1 with the reason at the first
fault.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from tests.faults.harness import (
    Archive,
    Batch,
    Tally,
    check_nothing_half,
    check_whole,
    entries,
    fresh,
    make_archive,
    moments,
    parts,
)

KINDS = ("everything", "parent", "worker")
LONGEST_CHAIN = 10
"""Kills of one output folder in a row."""


def kill_many(archive: Archive, folder: Path, n_kills: int, seed: int, *, tell: bool = False) -> Tally:
    """Kill until there were so many kills; every chain of kills ends with a run that resumes."""
    rng = random.Random(seed)
    tally = Tally()
    while sum(tally.kills.values()) < n_kills:
        out = fresh(folder / "out")
        for _ in range(rng.randint(1, LONGEST_CHAIN)):
            if _kill_one(archive, out, rng, tally) or sum(tally.kills.values()) >= n_kills:
                break
        code, said = Batch(archive.folder, out, archive.config).end()
        assert code == 0, said
        check_whole(archive, out)
        tally.resumed_to_the_end += 1
        if tell:
            sys.stderr.write(f"{sum(tally.kills.values())} of {n_kills}: {tally}\n")
    return tally


def _kill_one(archive: Archive, out: Path, rng: random.Random, tally: Tally) -> bool:
    """Start a run and strike it; tell whether it came to its end all the same."""
    kind = rng.choice(KINDS)
    tally.runs += 1
    batch = Batch(archive.folder, out, archive.config, jobs=rng.choice([1, 2, 2, 3]))
    for _ in moments(rng, archive, out, batch):
        struck = {
            "everything": batch.strike_all,
            "parent": batch.strike,
            "worker": lambda: batch.strike_worker(rng),
        }[kind]()
    if kind == "worker" or not struck:
        code, said = batch.end()
        assert code == 0, said
        batch.wait_until_gone()
        check_whole(archive, out)
    else:
        batch.process.communicate()
        tally.longest_orphan_s = max(tally.longest_orphan_s, batch.wait_until_gone())
        check_nothing_half(archive, out)
        tally.with_parts += bool(parts(out))
        running = out.exists() and any(entry.state == "running" for entry in entries(out).values())
        tally.with_running += running
    if struck:
        tally.count(kind)
    else:
        tally.came_too_late += 1
    return kind == "worker" or not struck


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="prc-faults-") as folder:
        archive = make_archive(Path(folder))
        tally = kill_many(archive, Path(folder), options.kills, options.seed, tell=True)
    json.dump({**asdict(tally), "undisturbed_s": round(archive.seconds, 1)}, sys.stdout, indent=1)
    sys.stdout.write("\n")


if __name__ == "__main__":
    main()
