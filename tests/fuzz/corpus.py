"""Inputs that took a way through a parser which none before had taken, kept in a folder from campaign to campaign."""

from __future__ import annotations

import hashlib
import random
from pathlib import Path

from tests.fuzz.mutations import mutate
from tests.fuzz.seeds import seed
from tests.fuzz.targets import Target, suffix_of_seed

MOST_BYTES = 1 << 17
"""Longer inputs are not kept: they make every later one slow."""
_SEEDS_SHARE, _CROSS_SHARE = 0.4, 0.1
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
        self._folder, self._seeds = folder, target.seeds
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
            others = [each for own, each in self.kept if suffix_of_seed(own) == suffix_of_seed(name)]
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
    at = rng.randrange(len(first))
    if rng.random() < 0.5:
        return first[:at] + second[min(at, len(second) - 1) :]
    start = rng.randrange(len(second))
    piece = second[start : start + rng.choice((4, 16, 64, 256))]
    return first[:at] + piece + first[at + len(piece) :]
