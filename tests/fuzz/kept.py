"""Damaged files that once showed a fault, kept in ``found``, and how they are tried again."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.fuzz.targets import TARGETS, lay, sound_of
from tests.fuzz.watched import WatchedWorker

FOLDER = Path(__file__).parent / "found"


@dataclass(frozen=True, slots=True)
class KeptFile:
    """A damaged file and the way in which it is read."""

    stem: str
    target: str
    seed: str
    """The valid file that was damaged."""
    way: str
    """``read``, ``command`` or ``guarded``."""
    words: tuple[str, ...]
    """The command, unless functions of the library read it."""
    code: int | None
    """The right exit code; None = any."""

    @property
    def data(self) -> bytes:
        """The content of the damaged file."""
        return (FOLDER / f"{self.stem}.data").read_bytes()


def kept_files() -> Iterator[KeptFile]:
    """Yield all kept files."""
    for path in sorted(FOLDER.glob("*.json")):
        table = json.loads(path.read_text(encoding="ascii"))
        yield KeptFile(
            stem=path.stem,
            target=table["target"],
            seed=table["seed"],
            way=table["way"],
            words=tuple(table["words"]),
            code=table["expected"].get("code"),
        )


def attempt(worker: WatchedWorker, folder: Path, kept: KeptFile) -> dict[str, Any]:
    """Read a kept file in its way; the answer of the worker has ``code`` and ``faults``."""
    target = TARGETS[kept.target]
    case = lay(folder, target, kept.seed, kept.data)
    if kept.way == "read":
        return worker.read(kept.target, case)
    if kept.way == "guarded":
        return worker.run_guarded(kept.words, case)
    return worker.run(kept.words, case, str(sound_of(folder / "seeds", target, kept.seed)))
