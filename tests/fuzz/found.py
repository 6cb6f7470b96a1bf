"""Inputs that showed a fault once, as files that the tests try again: ``found/STEM.json`` and ``found/STEM.data``."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

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


def keep(folder: Path, finding: Found, data: bytes, kind: str, fault: str) -> str:
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
