"""Writers of one journal, each killed at a random moment; a separate script, because it forks.

``python killed_writers.py FOLDER SEED KILLS ROWS`` checks the journal after every kill and prints
the number of rows. It goes on for at least KILLS kills and ROWS finished rows."""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from itertools import count
from pathlib import Path

from prc_cli.config import LoadedConfig, RunConfig
from prc_cli.jobs.batch.journal import Journal, read_entries
from prc_cli.jobs.batch.outcomes import Done, InputPrint
from prc_cli.jobs.batch.types import Task


def main() -> None:
    folder, rng, n_kills, n_rows = (
        Path(sys.argv[1]),
        random.Random(int(sys.argv[2])),
        *map(int, sys.argv[3:5]),
    )
    started: set[str] = set()
    finished: set[str] = set()
    for number in count():
        if number >= n_kills and len(finished) >= n_rows:
            break
        reading, writing = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(reading)
            _write(folder, writing)
        os.close(writing)
        said = b""
        if rng.random() < 0.8:  # else also while it opens
            said = os.read(reading, 1)
        time.sleep(rng.random() * 0.05)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        while piece := os.read(reading, 65536):
            said += piece
        os.close(reading)
        for line in said.decode().split("\n")[:-1]:  # what is behind the last line feed was cut
            (started if line[0] == "s" else finished).add(line[1:])
        entries = {entry.name: entry for entry in read_entries(folder)}
        assert started <= set(entries), "a row was lost"
        for name in finished:
            assert entries[name].state == "done", "an outcome was lost"
            assert entries[name].outcome == _done(name), "an outcome was changed"
        # at most one step a writer was committed and not said
        assert len(entries) - len(started) <= number + 1
    sys.stdout.write(f"{len(finished)}\n")


def _write(folder: Path, writing: int) -> None:
    with Journal(folder) as journal:
        journal.begin_run("writer")
        n = len(journal.entries())
        while True:
            journal.start(
                Task(f"{n}", Path("a"), Path("b"), LoadedConfig(RunConfig()), "c"), "worker"
            )
            os.write(writing, f"s{n}\n".encode())
            journal.finish(_done(f"{n}"))
            os.write(writing, f"f{n}\n".encode())
            n += 1


def _done(name: str) -> Done:
    return Done(
        name, InputPrint(1, 2, "ab"), 3, 4, 1.0, 2.0, None, 5, 6, 7, (("GROUND", len(name)),)
    )


if __name__ == "__main__":
    main()
