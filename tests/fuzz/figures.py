"""Counts of campaigns, added up in ``figures.json`` of their corpus, and as a page of the documentation."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

WAYS = ("read", "command", "guarded")
_PAGE = """\
# Hostile input in figures

Written by `python -m tests.fuzz.campaign --report docs/hostile_figures.md --corpus corpus`, after campaigns of
`python -m tests.fuzz.campaign --seconds 3600 --corpus corpus --seed 1` with several seeds. What counts as a fault:
[Hostile input](hostile_input.md#how-it-is-tested).

**{n:,} inputs**: {read:,} read by functions of the library, {command:,} through a command in the same process,
{guarded:,} through `prc` under the guard. {accepted} were accepted, {looked} with a doubt that is said, {refused}
refused in one line; {died:,} ended the process of the library that decoded them, which the guard makes a line of;
{faulty:,} showed a fault ({kinds} kinds, mended or listed as a remaining risk).

*New ways* are steps from line to line of the program that damaged inputs took and seeds did not; *kept* are the inputs
of the corpus that took them first.

| target | inputs | accepted | doubt | refused | ended | faults | new ways | kept | slowest | memory |
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
            name, {"ways": {}, "faults": {}, "slowest": 0.0, "grown": 0, "seconds": 0.0, "steps": 0, "kept": 0}
        )
        for way, outcomes in tally.ways.items():
            counts = row["ways"].setdefault(way, {})
            for code, n in outcomes.items():
                counts[code] = counts.get(code, 0) + n
        for kind, n in tally.faults.items():
            row["faults"][kind] = row["faults"].get(kind, 0) + n
        row["slowest"], row["grown"] = max(row["slowest"], tally.slowest), max(row["grown"], tally.grown)
        row["steps"], row["kept"] = len(corpora[name].steps), len(corpora[name].kept)
        tally.ways.clear()
        tally.faults.clear()
    corpus.mkdir(parents=True, exist_ok=True)
    (corpus / "figures.json").write_text(json.dumps(table, indent=1) + "\n")


def _outcomes(ways: Mapping[str, Mapping[str, int]]) -> dict[str, int]:
    found = dict.fromkeys(("accepted", "doubt", "refused", "ended", "none"), 0)
    for counts in ways.values():
        for code, n in counts.items():
            word = {"0": "accepted", "4": "doubt", "1": "refused", "2": "refused", "None": "none"}.get(code, "ended")
            found[word] += n
    return found


def report(corpus: Path) -> str:
    """Return the page."""
    table = _read(corpus)
    rows, total, by_way = (
        [],
        dict.fromkeys(("accepted", "doubt", "refused", "ended", "none"), 0),
        dict.fromkeys(WAYS, 0),
    )
    n_faults, kinds = 0, set()
    for name, row in sorted(table.items()):
        found = _outcomes(row["ways"])
        faults = sum(row["faults"].values())
        n_faults, kinds = n_faults + faults, kinds | set(row["faults"])
        for word, n in found.items():
            total[word] += n
        for way, counts in row["ways"].items():
            by_way[way] += sum(counts.values())
        rows.append(
            f"| {name} | {sum(found.values()):,} | {found['accepted']:,} | {found['doubt']:,} | {found['refused']:,} "
            f"| {found['ended']:,} | {faults:,} | {row['steps']:,} | {row['kept']:,} | {row['slowest']:.1f} s "
            f"| {row['grown'] >> 20} MiB |"
        )
    n = sum(total.values())
    share = {word: f"{100 * count / max(n, 1):.1f} %" for word, count in total.items()}
    return _PAGE.format(
        n=n, **by_way, accepted=share["accepted"], looked=share["doubt"], refused=share["refused"],
        died=total["ended"], faulty=n_faults, kinds=len(kinds), rows="\n".join(rows),
    )  # fmt: skip
