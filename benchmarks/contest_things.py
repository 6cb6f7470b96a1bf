"""Cars, poles and curbs in the contest: what has few shots, beside the classes of the confusion tables."""

from __future__ import annotations

import numpy as np

from benchmarks.contest_judge import CURB
from benchmarks.contest_runs import DataSet, Run

NAMES = ("car", "pole", CURB)
LEAST_SHOTS = 100
"""Fewest shots of a thing in a scan that is judged: below, the score depends on a few."""


def f1(counts: list[float]) -> float:
    """Return F1 of shots that agree, that are predicted, and of the reference."""
    agree, predicted, reference = counts
    return 2 * agree / (predicted + reference)


def judged(own: dict[str, Run], items: list[DataSet], name: str) -> list[list[float]]:
    """Return the counts of a thing in the scans that hold enough of it."""
    there = (own[item.how].things.get(name) for item in items if item.how in own)
    return [counts for counts in there if counts is not None and counts[2] >= LEAST_SHOTS]


def print_things(groups: dict[str, list[DataSet]], runs: dict[str, dict[str, Run]]) -> None:
    """One table a thing: methods that know it by group."""
    for name in NAMES:
        found = {
            method: {group: judged(own, items, name) for group, items in groups.items()} for method, own in runs.items()
        }
        found = {method: cells for method, cells in found.items() if any(c[1] for each in cells.values() for c in each)}
        shown = [group for group in groups if any(cells[group] for cells in found.values())]
        if not shown:
            continue
        print(f"### {name[0].upper()}{name[1:]}: F1 (precision, recall; worst scan)\n")
        print(f"| | {' | '.join(shown)} |\n|---|{'---:|' * len(shown)}")
        for method, cells in found.items():
            print(f"| {method} | {' | '.join(_cell(cells[group]) for group in shown)} |")
        print()


def _cell(counts: list[list[float]]) -> str:
    """Return the mean F1, the means of precision and recall, and the worst F1 if there are several scans."""
    if not counts:
        return ""
    scores = [f1(each) for each in counts]
    precision = [agree / predicted if predicted else 0.0 for agree, predicted, _ in counts]
    recall = [agree / reference for agree, _, reference in counts]
    worst = f"; {min(scores):.2f}" if len(scores) > 1 else ""
    return f"{np.mean(scores):.3f} ({np.mean(precision):.2f}, {np.mean(recall):.2f}{worst})"
