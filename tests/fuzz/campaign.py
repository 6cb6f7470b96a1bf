"""Try many damaged files: ``python -m tests.fuzz.campaign [TARGET ...] --seconds S --runs N --seed
K --corpus FOLDER``.

Most inputs are read by functions of the library in a forked process, traced; one that takes a new
way through a parser is kept in the corpus and damaged further. One of ten goes through a command in
that process, a few through ``prc`` as a user starts it. All targets get the same processor time. A
fault is what docs/robustness.md lists. The first of its kind is made small and kept in ``--keep``,
by default where the tests find it. Counts of all campaigns with one corpus are added up; ``--report
FILE`` writes them as a table and tries nothing."""

from __future__ import annotations

import argparse
import os
import random
import re
import signal
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.fuzz.corpus import FOUND, Corpus, Found, add_up, keep, known_kinds, report
from tests.fuzz.minimise import minimise
from tests.fuzz.seeds import seed, write_seeds
from tests.fuzz.targets import INPUTS, LABELLED, TARGETS, Target, lay, sound_of
from tests.fuzz.watched import WatchedWorker

COMMAND_SHARE = 0.1
GUARDED_SHARE = 0.0003
_ONLY_COMMANDS = ("stream", "simulate", "metadata")
"""Targets that no function of the library reads alone."""
_SAVE_S = 30.0


@dataclass
class Tally:
    """What happened to the inputs of a target."""

    ways: dict[str, dict[str, int]] = field(default_factory=dict)
    """Number of inputs by way (read, command, guarded) and outcome."""
    seconds: float = 0.0
    slowest: float = 0.0
    grown: int = 0
    faults: dict[str, int] = field(default_factory=dict)

    def count(self, way: str, answer: dict[str, Any]) -> None:
        """Add one input."""
        outcomes = self.ways.setdefault(way, {})
        outcomes[str(answer["code"])] = outcomes.get(str(answer["code"]), 0) + 1
        self.slowest, self.grown = (
            max(self.slowest, answer["seconds"]),
            max(self.grown, answer["grown"]),
        )


def kind_of(fault: str) -> str:
    """Return what makes a fault the same as another: its text without numbers and names."""
    lines = fault.splitlines()
    places = [line.strip() for line in lines if line.strip().startswith("File ")]
    where = re.sub(r"line \d+, ", "", re.sub(r".*/", "", places[-1])) if places else ""
    return re.sub(r"\d+", "N", lines[0][:80].split("/")[0]) + " " + where


class Campaign:
    """One campaign.

    Parameters
    ----------
    names : list of str
        Targets.
    first_seed : int
        Of the draws.
    corpus, found : Path
        Where inputs are kept that took new ways, and those that show faults.
    """

    def __init__(
        self,
        names: list[str],
        first_seed: int,
        corpus: Path,
        tallies: Path,
    ) -> None:
        self.tallies = {name: Tally() for name in names}
        self.corpora = {name: Corpus(corpus / name, TARGETS[name]) for name in names}
        self._rng = random.Random(first_seed)
        self._corpus = corpus
        self._found = tallies
        self._known = known_kinds(tallies)
        self.n_faults = 0

    def run(self, runs: int, seconds: float) -> int:
        """Attack until there were so many inputs or seconds; return how many there were."""
        begun = time.monotonic()
        saved = time.monotonic()
        n = 0
        with tempfile.TemporaryDirectory(prefix="prc-fuzz-", dir=_memory()) as made:
            self._folder = Path(made)
            (self._folder / "seeds").mkdir()
            write_seeds(self._folder / "seeds")
            self._worker = WatchedWorker(self._folder)
            try:
                self._know_corpus()
                while n < runs and time.monotonic() - begun < seconds:
                    name = min(
                        self.tallies, key=lambda target_name: self.tallies[target_name].seconds
                    )
                    start = time.monotonic()
                    n += self._one(name)
                    self.tallies[name].seconds += time.monotonic() - start
                    if time.monotonic() - saved > _SAVE_S:
                        saved = time.monotonic()
                        add_up(self._corpus, self.tallies, self.corpora)
            finally:
                self._worker.close()
                add_up(self._corpus, self.tallies, self.corpora)
        return n

    def _know_corpus(self) -> None:
        """Take the steps of all seeds and of what was kept, so that only others count as new."""
        for name, corpus in self.corpora.items():
            target = TARGETS[name]
            if name not in _ONLY_COMMANDS:
                for chosen, data in [
                    *((seed_name, seed(seed_name)) for seed_name in target.seeds),
                    *corpus.kept,
                ]:
                    answer = self._worker.read(name, lay(self._folder, target, chosen, data))
                    corpus.steps |= set(answer.get("fresh", ()))

    def _one(self, name: str) -> int:
        target = TARGETS[name]
        corpus = self.corpora[name]
        chosen, data = corpus.draw(self._rng)
        drawn = self._rng.random()
        if drawn < GUARDED_SHARE:
            return self._try(name, target, chosen, data, "guarded")
        if drawn < COMMAND_SHARE or name in _ONLY_COMMANDS:
            return self._try(name, target, chosen, data, "command")
        n = self._try(name, target, chosen, data, "read")
        if self._is_new:
            n += self._try(name, target, chosen, data, "command")
        return n

    def _try(
        self,
        name: str,
        target: Target,
        chosen: str,
        data: bytes,
        way: str,
    ) -> int:
        words: tuple[str, ...] = ()
        if way != "read":
            words = (
                LABELLED
                if name in INPUTS and self._rng.random() < 0.3
                else self._rng.choice(target.commands)
            )
        finding = Found(name, chosen, way, words)
        answer = self._answer(finding, data)
        tally = self.tallies[name]
        tally.count(way, answer)
        self._is_new = way == "read" and self.corpora[name].add(
            chosen, data, answer.get("fresh", [])
        )
        for fault in answer["faults"]:
            kind = kind_of(fault)
            self.n_faults += 1
            tally.faults[kind] = tally.faults.get(kind, 0) + 1
            if kind not in self._known:
                self._known.add(kind)
                self._keep(finding, data, kind, fault)
        return 1

    def _answer(self, finding: Found, data: bytes) -> dict[str, Any]:
        return attempt(self._worker, self._folder, finding, data)

    def _keep(
        self,
        finding: Found,
        data: bytes,
        kind: str,
        fault: str,
    ) -> None:
        small = minimise(
            data,
            seed(finding.seed),
            lambda trial: kind in map(kind_of, self._answer(finding, trial)["faults"]),
        )
        stem = keep(self._found, finding, small, kind, fault)
        print(
            f"{stem}: {len(small)} of {len(data)} bytes, {finding.way} "
            f"{' '.join(finding.words)}\n{fault[:1500]}\n"
        )
        sys.stdout.flush()


def attempt(
    worker: WatchedWorker,
    folder: Path,
    finding: Found,
    data: bytes,
) -> dict[str, Any]:
    """Try one input in the way that a finding names."""
    target = TARGETS[finding.target]
    case = lay(folder, target, finding.seed, data)
    if finding.way == "read":
        return worker.read(finding.target, case)
    if finding.way == "guarded":
        return worker.run_guarded(finding.words, case)
    return worker.run(finding.words, case, str(sound_of(folder / "seeds", target, finding.seed)))


def _memory() -> str | None:
    """Return a folder in memory, where there is one."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


def main() -> None:
    """Run a campaign and print what it met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("targets", nargs="*", default=list(TARGETS), metavar="TARGET")
    parser.add_argument("--runs", type=int, default=10**9)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--corpus", type=Path, default=Path("fuzz-corpus"))
    parser.add_argument("--keep", type=Path, default=FOUND)
    parser.add_argument("--report", type=Path)
    arguments = parser.parse_args()
    if arguments.report is not None:
        arguments.report.write_text(report(arguments.corpus), encoding="utf-8")
        return
    campaign = Campaign(arguments.targets, arguments.seed, arguments.corpus, arguments.keep)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # what was counted is kept
    begun = time.monotonic()
    n = campaign.run(arguments.runs, arguments.seconds)
    times = os.times()
    used = times.user + times.system + times.children_user + times.children_system
    print(
        f"{n} inputs in {time.monotonic() - begun:.0f} s, {used:.0f} s of processor time; "
        f"{campaign.n_faults} faults"
    )


if __name__ == "__main__":
    main()


__all__ = ["Campaign", "Tally", "attempt", "kind_of", "main"]
