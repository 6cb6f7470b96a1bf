"""Processes that compete for one lock and die in the middle of it.

a script of its own, because it forks.

``python rivals.py FOLDER SEED LIVES INHERITED KINDS`` prints what happened as JSON. Every step of a
rival in the file system may be slow, and may be its last: it leaves with ``os._exit``, as a kill
would make it. There are at least so many lives, and as many more as it takes until so many locks of
dead rivals were inherited: how often that happens in a number of lives depends on who is scheduled
when."""

from __future__ import annotations

import json
import os
import random
import sys
import time
from collections import Counter
from pathlib import Path

from prc_cli.core.errors import BusyError
from prc_cli.jobs.batch import lock as subject
from prc_cli.jobs.batch.lock import Lock
from prc_cli.jobs.batch.types import Shard

N_RIVALS = 6
N_FIGHTS = 20
"""A rival that does not die gives up after so many."""
DEATH = 0.01
"""Chance that a step is the last."""
DEATH_INSIDE = 0.4
"""Chance to die while the lock is held."""
DIED = 9
"""Exit code of a rival that dropped dead."""
MOST_LIVES = 20_000
"""Locks that are not inherited in so many are never inherited.

Every fifth life or so ends with the lock held.
"""


def main() -> None:
    folder, seed, n_wanted, n_inherited = Path(sys.argv[1]), *map(int, sys.argv[2:5])
    kinds = [None if kind == "whole" else Shard.parse(kind) for kind in sys.argv[5].split(",")]
    subject.LOOK_S = 0.05
    (folder / "inside").mkdir()
    log = folder / "log"
    log.touch()
    running: set[int] = set()
    n_lives = n_failed = 0
    goes_on = True
    while goes_on or running:
        while goes_on and len(running) < N_RIVALS:
            n_lives += 1
            pid = os.fork()
            if pid == 0:
                _live(folder, random.Random(seed * 100_003 + n_lives), kinds)
                os._exit(0)
            running.add(pid)
        pid, status = os.wait()
        running.discard(pid)
        for mark in (folder / "inside").glob(f"{pid}.*"):  # its number may be given again
            mark.unlink()
        n_failed += os.waitstatus_to_exitcode(status) not in (0, DIED)
        goes_on = n_lives < n_wanted or (
            log.read_text().count("inherited") < n_inherited and n_lives < MOST_LIVES
        )
    counts = Counter(log.read_text().split())
    sys.stdout.write(json.dumps({**counts, "lives": n_lives, "failed": n_failed}))


def _live(folder: Path, rng: random.Random, kinds: list[Shard | None]) -> None:
    log = (folder / "log").open("a", buffering=1)
    kind = rng.choice(kinds)

    def step(death: float = DEATH) -> None:
        if rng.random() < 0.3:
            time.sleep(rng.random() * 0.001)
        elif rng.random() < 0.05:
            time.sleep(rng.random() * 0.02)
        if rng.random() < death:
            log.write("died\n")
            os._exit(DIED)

    for name in ("_read", "_is_held"):
        setattr(subject, name, _with_steps(getattr(subject, name), step))
    for name in ("acquire", "release"):
        setattr(subject.FileLock, name, _with_steps(getattr(subject.FileLock, name), step))
    unlink = Path.unlink
    Path.replace = _with_steps(Path.replace, step)  # type: ignore[method-assign]
    Path.unlink = _with_steps(Path.unlink, step)  # type: ignore[method-assign]
    for _ in range(N_FIGHTS):
        try:
            with Lock(folder / ".prc", kind) as lock:
                log.write("inherited\n" if lock.inherited_from else "entered\n")
                mark = folder / "inside" / f"{os.getpid()}.{_word(kind)}"
                mark.touch()
                for sibling in (folder / "inside").iterdir():
                    if (
                        sibling != mark
                        and _alive(int(sibling.name.split(".")[0]))
                        and _excludes(mark, sibling)
                    ):
                        log.write("VIOLATION\n")
                time.sleep(rng.random() * 0.01)
                step(DEATH_INSIDE)
                lock.check()
                unlink(mark)
        except BusyError as error:
            log.write("LOST\n" if "lost" in error.problem else "busy\n")
            time.sleep(rng.random() * 0.003)


def _with_steps(function, step):  # type: ignore[no-untyped-def]
    def stepped(*arguments, **named):  # type: ignore[no-untyped-def]
        step()
        result = function(*arguments, **named)
        step()
        return result

    return stepped


def _word(kind: Shard | None) -> str:
    return "whole" if kind is None else f"{kind.index}-of-{kind.count}"


def _excludes(mark: Path, mark_of_rival: Path) -> bool:
    """Tell whether two that are inside may not be: all but two different shards of one division."""
    return (
        mark.suffix == mark_of_rival.suffix
        or mark.suffix.partition("-")[2] != mark_of_rival.suffix.partition("-")[2]
    )


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


if __name__ == "__main__":
    main()
