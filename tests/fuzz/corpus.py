"""Inputs and counts that campaigns keep."""

from __future__ import annotations

import hashlib
import json
import random
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tests.fuzz.mutations import mutate
from tests.fuzz.seeds import seed
from tests.fuzz.targets import Target, suffix_of_seed

MOST_BYTES = 1 << 17
"""Longer inputs are not kept: they make every later one slow."""
_SEEDS_SHARE = 0.4
_CROSS_SHARE = 0.1
_NEWEST = 40


class Corpus:
    """Seeds of a target, and what was kept of their descendants.

    Parameters
    ----------
    folder : Path
        Of the target; made when the first input is kept.
    target : Target
        Whose seeds.
    """

    def __init__(self, folder: Path, target: Target) -> None:
        self._folder = folder
        self._seeds = target.seeds
        self.steps: set[str] = set()
        """Steps through the parsers that were taken so far."""
        self.kept: list[tuple[str, bytes]] = []
        """Seed by name, and content."""
        for path in sorted(folder.glob("*")) if folder.is_dir() else ():
            name = path.name.rpartition("-")[0].replace("+", "/")
            if name in self._seeds:
                self.kept.append((name, path.read_bytes()))

    def draw(self, rng: random.Random) -> tuple[str, bytes]:
        """Return a damaged input and the name of the seed that it is a descendant of."""
        if not self.kept or rng.random() < _SEEDS_SHARE:
            name = rng.choice(self._seeds)
            data = seed(name)
        else:
            name, data = rng.choice(self.kept[-_NEWEST:] if rng.random() < 0.3 else self.kept)
        if rng.random() < _CROSS_SHARE:
            others = [
                content
                for seed_name, content in self.kept
                if suffix_of_seed(seed_name) == suffix_of_seed(name)
            ]
            data = _cross(data, rng.choice(others), rng) if others else data
        return name, mutate(data, suffix_of_seed(name), rng.getrandbits(60))

    def add(self, name: str, data: bytes, fresh: list[str]) -> bool:
        """Keep an input if it took new steps; tell whether it did."""
        new = set(fresh) - self.steps
        self.steps |= new
        if not new or len(data) > MOST_BYTES:
            return bool(new)
        self._folder.mkdir(parents=True, exist_ok=True)
        file = self._folder / f"{name.replace('/', '+')}-{hashlib.sha256(data).hexdigest()[:12]}"
        if not file.exists():
            file.write_bytes(data)
            self.kept.append((name, data))
        return True


def _cross(first: bytes, second: bytes, rng: random.Random) -> bytes:
    """Return the begin of one and the end of the other, or one with a piece of the other."""
    cut = rng.randrange(len(first))
    if rng.random() < 0.5:
        return first[:cut] + second[min(cut, len(second) - 1) :]
    start = rng.randrange(len(second))
    piece = second[start : start + rng.choice((4, 16, 64, 256))]
    return first[:cut] + piece + first[cut + len(piece) :]


WAYS = ("read", "command", "guarded")
_PAGE = """\
# Hostile input in figures

Written by `python -m tests.fuzz.campaign --report docs/figures/hostile.md --corpus corpus`, after
campaigns of `python -m tests.fuzz.campaign --seconds 3600 --corpus corpus --seed 1` with several
seeds. What counts as a fault: [Hostile input](../robustness.md#how-damaged-files-are-tested).

**{n:,} inputs**: {read:,} read by functions of the library, {command:,} through a command in
the same process, {guarded:,} through `prc` under the guard. {accepted} were accepted, {looked}
with a doubt that is said, {refused} refused in one line; {died:,} ended the process of the
library that decoded them, which the guard makes a line of; {faulty:,} showed a fault ({kinds}
kinds, mended or listed as a
remaining risk).

*New ways* are steps from line to line of the program that damaged inputs took and seeds
did not; *kept* are the inputs of the corpus that took them first.

| target | inputs | accepted | doubt | refused | ended | faults | new ways | kept | slowest | \
memory |
|---|---|---|---|---|---|---|---|---|---|---|
{rows}
"""


def _read(corpus: Path) -> dict[str, Any]:
    try:
        table: dict[str, Any] = json.loads((corpus / "figures.json").read_text())
    except FileNotFoundError:
        table = {}
    return table


def add_up(corpus: Path, tallies: Mapping[str, Any], corpora: Mapping[str, Any]) -> None:
    """Add what was counted since the last time to the figures, and begin to count anew."""
    table = _read(corpus)
    for name, tally in tallies.items():
        row = table.setdefault(
            name,
            {
                "ways": {},
                "faults": {},
                "slowest": 0.0,
                "grown": 0,
                "seconds": 0.0,
                "steps": 0,
                "kept": 0,
            },
        )
        for way, outcomes in tally.ways.items():
            counts = row["ways"].setdefault(way, {})
            for code, n in outcomes.items():
                counts[code] = counts.get(code, 0) + n
        for kind, n in tally.faults.items():
            row["faults"][kind] = row["faults"].get(kind, 0) + n
        row["slowest"], row["grown"] = (
            max(row["slowest"], tally.slowest),
            max(row["grown"], tally.grown),
        )
        row["steps"] = len(corpora[name].steps)
        row["kept"] = len(corpora[name].kept)
        tally.ways.clear()
        tally.faults.clear()
    corpus.mkdir(parents=True, exist_ok=True)
    (corpus / "figures.json").write_text(json.dumps(table, indent=1) + "\n")


def _outcomes(ways: Mapping[str, Mapping[str, int]]) -> dict[str, int]:
    outcomes = dict.fromkeys(("accepted", "doubt", "refused", "ended", "none"), 0)
    for counts in ways.values():
        for code, n in counts.items():
            word = {
                "0": "accepted",
                "4": "doubt",
                "1": "refused",
                "2": "refused",
                "None": "none",
            }.get(code, "ended")
            outcomes[word] += n
    return outcomes


def report(corpus: Path) -> str:
    """Return the page."""
    table = _read(corpus)
    rows = []
    total = dict.fromkeys(("accepted", "doubt", "refused", "ended", "none"), 0)
    by_way = dict.fromkeys(WAYS, 0)
    n_faults = 0
    kinds = set()
    for name, row in sorted(table.items()):
        outcomes = _outcomes(row["ways"])
        faults = sum(row["faults"].values())
        n_faults = n_faults + faults
        kinds = kinds | set(row["faults"])
        for word, n in outcomes.items():
            total[word] += n
        for way, counts in row["ways"].items():
            by_way[way] += sum(counts.values())
        rows.append(
            f"| {name} | {sum(outcomes.values()):,} | {outcomes['accepted']:,} | "
            f"{outcomes['doubt']:,} | {outcomes['refused']:,} "
            f"| {outcomes['ended']:,} | {faults:,} | {row['steps']:,} | {row['kept']:,} | "
            f"{row['slowest']:.1f} s "
            f"| {row['grown'] >> 20} MiB |"
        )
    n = sum(total.values())
    share = {word: f"{100 * count / max(n, 1):.1f} %" for word, count in total.items()}
    return _PAGE.format(
        n=n,
        **by_way,
        accepted=share["accepted"],
        looked=share["doubt"],
        refused=share["refused"],
        died=total["ended"],
        faulty=n_faults,
        kinds=len(kinds),
        rows="\n".join(rows),
    )


FOUND = Path(__file__).parent / "found"


@dataclass(frozen=True, slots=True)
class Found:
    """How an input is tried."""

    target: str
    seed: str
    """What it was before it was damaged."""
    way: str
    """``read``, ``command`` or ``guarded``."""
    words: tuple[str, ...]
    """The command, unless it is read by the library."""


def keep(
    folder: Path,
    finding: Found,
    data: bytes,
    kind: str,
    fault: str,
) -> str:
    """Write an input with what is to be known about it; return the stem of its names.

    ``expected`` is empty until somebody has mended the fault and says which ``code`` is right.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stem = f"{finding.target}-{hashlib.sha256(kind.encode()).hexdigest()[:8]}"
    (folder / f"{stem}.data").write_bytes(data)
    table = {**asdict(finding), "kind": kind, "fault": fault[:2000].splitlines(), "expected": {}}
    (folder / f"{stem}.json").write_text(json.dumps(table, indent=1) + "\n", encoding="ascii")
    return stem


def all_found(folder: Path = FOUND) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield stem and table of all inputs that were kept."""
    for path in sorted(folder.glob("*.json")):
        yield path.stem, json.loads(path.read_text(encoding="ascii"))


def known_kinds(folder: Path = FOUND) -> set[str]:
    """Return the kinds of faults of which an input was kept: the next one is not."""
    return {table["kind"] for _, table in all_found(folder)}
