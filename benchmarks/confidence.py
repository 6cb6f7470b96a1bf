"""The confidence of the fused method: its table, and how often labels of every confidence are right.

    python -m benchmarks.confidence calibrate           # makes prc_cli/classifiers/fused/confidence.json
    python -m benchmarks.confidence check               # reliability on other streets and forests, for choosing
    python -m benchmarks.confidence ablation            # the same without single measures
    python -m benchmarks.confidence report              # docs/confidence_figures.md, seeds that decided nothing

Calibrated on seeds 2601 to 2699, chosen on 2701 to 2799, reported on 2801 to 2899 and on the labelled real scans of
../shared/data or $PRC_DATA. A label is right if it is the class of the reference, as for ``prc evaluate --mapping
street``: people and wires, which have no class, are never right.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from unittest import mock

import numpy as np

from benchmarks import contest_data as data
from benchmarks.contest_data import ROOT, Scan, Simulated
from prc_cli.classifiers.fused import confidence, pipeline
from prc_cli.classifiers.fused.confidence import N_CELLS, QUESTIONS, Environment, confidence_of, load_table
from prc_cli.config import load_config
from prc_cli.core.classes import Label
from prc_cli.core.types import F64, I32, U8, Mask
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.jobs.classify import label_blocks

ENVIRONMENTS: tuple[Environment, ...] = ("urban", "forest")
CALIBRATION, CHECK, HELD_OUT = 2601, 2701, 2801
"""First seeds."""
ROUNDS = {CALIBRATION: 4, CHECK: 1, HELD_OUT: 2}
"""How often every drive is simulated, through other streets."""
SCENES = ("mixed", "residential", "boulevard", "terraces", "suburb")
FOREST_SCENES = ("mixed", "pine-heath", "dense-spruce")
FOREST_SCANNERS = ("focus3d-120", "profiler-1mhz")
SHORTER = {80.0: 30.0, 160.0: 100.0, 30.0: 10.0}
FOREST_M = {"focus3d-120": 10.0, "profiler-1mhz": 4.0}
SHOTS_A_SCAN = 100_000.0
"""Every scan counts as much as any other [shots]."""
PRIOR_SHOTS = 2000.0
"""A cell takes this many shots of the cell that asks one question less."""
TOP = 0.9
"""The share of the shots that is looked at: those with the most confidence."""
BINS = (0, 50, 70, 80, 90, 95, 98, 99, 100, 101)
"""Edges of the reliability curve [per cent]."""
DOCS = ROOT / "docs" / "confidence_figures.md"
CURVE = ROOT / "docs" / "images" / "confidence.svg"


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """The returns of a scan that have a reference."""

    name: str
    labels: U8
    cells: I32
    right: Mask
    shots: U8
    """Confidence."""

    @property
    def weight(self) -> float:
        """What a return counts."""
        return SHOTS_A_SCAN / len(self.labels)


def specs(environment: Environment, first: int) -> Iterator[Simulated]:
    """Return the simulated scans that begin with a seed: the drives of the contest, through other streets."""
    for turn in range(ROUNDS[first]):
        if environment == "urban":
            for k, spec in enumerate(data.TEST_STREETS):
                scene = SCENES[(SCENES.index(spec.scene) + turn) % len(SCENES)]
                length_m = SHORTER[spec.length_m]
                yield replace(spec, seed=first + len(data.TEST_STREETS) * turn + k, scene=scene, length_m=length_m)
            continue
        for k, scene in enumerate(FOREST_SCENES):
            scanner = FOREST_SCANNERS[turn % len(FOREST_SCANNERS)]
            seed = first + len(FOREST_SCENES) * turn + k
            yield Simulated(f"{scene}, {scanner}", seed, FOREST_M[scanner], scene, scanner, kind="forest")


def judge(scan: Scan, environment: Environment) -> Judged:
    """Label a scan, and compare with its reference."""
    params = load_config(preset="fused" if environment == "urban" else "fused-forest").config.classifier
    cells: list[I32] = []

    def kept(labels: U8, found: I32, table: U8) -> U8:
        cells.append(found)
        return confidence_of(labels, found, table)

    with mock.patch.object(pipeline, "confidence_of", kept):
        items = list(label_blocks(scan.blocks(), params, confidence=True))
    labels = np.concatenate([item.labels for item in items])
    shots = np.concatenate([item.confidence for item in items if item.confidence is not None])
    right, there = _right(scan, labels)
    return Judged(scan.name, labels[there], np.concatenate(cells)[there], right[there], shots[there])


def _right(scan: Scan, labels: U8) -> tuple[Mask, Mask]:
    """Return which labels are those of the reference, and which can be judged."""
    names = {"street": "street", "oakland": "street_oakland", "kitti": "street_scan_kitti"}
    codes = load_config().config.classes.lookup()[labels].astype(np.int64)
    there: Mask = ~np.isnan(scan.range_m) & (scan.codes != 0)
    if scan.mapping not in names:
        return codes == scan.codes, there
    mapping = load_mapping(names[scan.mapping])
    rows, columns = np.array([*mapping.names("reference"), ""]), np.array([*mapping.names("predicted"), "-"])
    reference = mapping.class_indices(np.where(there, scan.codes, scan.codes[there][0]), "reference")
    predicted = mapping.class_indices(np.where(there, np.maximum(codes, 1), 1), "predicted")
    right: Mask = rows[reference] == columns[predicted]
    return right, there & (rows[reference] != "")


def table_of(judged: Sequence[Judged], environment: Environment, dropped: str = "") -> U8:
    """Return the share of right labels in every cell [per cent], without the answers to one question."""
    table = np.zeros((len(Label), N_CELLS), np.uint8)
    for label, questions in QUESTIONS[environment].items():
        own = [(one.cells[one.labels == label], one.right[one.labels == label], one.weight) for one in judged]
        if not sum(len(cells) for cells, _, _ in own):
            continue
        n, right = np.zeros(N_CELLS), np.zeros(N_CELLS)
        for cells, is_right, weight in own:
            n += weight * np.bincount(cells, minlength=N_CELLS)
            right += weight * np.bincount(cells, is_right, minlength=N_CELLS)
        shape = (4,) * len(questions)
        n, right = n.reshape(shape), right.reshape(shape)
        if dropped in questions:
            axis = questions.index(dropped)
            n, right = (np.broadcast_to(x.sum(axis, keepdims=True), shape) for x in (n, right))
        share = right.sum() / n.sum()
        for k in range(1, len(questions) + 1):
            rest = tuple(range(k, len(questions)))
            there, good = n.sum(rest, keepdims=True), right.sum(rest, keepdims=True)
            share = (good + PRIOR_SHOTS * share) / (there + PRIOR_SHOTS)
        table[label] = np.rint(100.0 * share).ravel()
    return table


def top_share(shots: U8, right: Mask, weight: F64, share: float = TOP) -> float:
    """Return how many are right of the given share with the most confidence; of equals, each counts in part."""
    n = np.bincount(shots, weight, minlength=101)[::-1]
    good = np.bincount(shots, weight * right, minlength=101)[::-1]
    taken = np.clip(share * n.sum() - (np.cumsum(n) - n), 0.0, n)
    return float((good * taken / np.maximum(n, 1e-9)).sum() / taken.sum())


def expected_error(shots: U8, right: Mask, weight: F64) -> float:
    """Return the mean difference of confidence and share of right ones, over the values of the byte."""
    n = np.bincount(shots, weight, minlength=101)
    good = np.bincount(shots, weight * right, minlength=101)
    return float(np.abs(good - n * np.arange(101) / 100.0).sum() / n.sum())


def pooled(judged: Sequence[Judged]) -> tuple[U8, Mask, F64]:
    """Return confidence, right and weight of the returns of several scans."""
    return (
        np.concatenate([one.shots for one in judged]),
        np.concatenate([one.right for one in judged]),
        np.concatenate([np.full(len(one.labels), one.weight) for one in judged]),
    )


def with_table(judged: Sequence[Judged], table: U8) -> list[Judged]:
    """Return scans with the confidence of another table."""
    return [replace(one, shots=confidence_of(one.labels, one.cells, table)) for one in judged]


def row(name: str, judged: Sequence[Judged]) -> str:
    """Return a row of the table of scans."""
    shots, right, weight = pooled(judged)
    share = np.average(right, weights=weight)
    at_90 = shots >= 90
    cells = [
        f"{100 * share:.2f}", f"{100 * top_share(shots, right, weight):.2f}",
        f"{100 * top_share(shots, right, weight, 0.8):.2f}", f"{100 * np.average(at_90, weights=weight):.1f}",
        f"{100 * np.average(right[at_90], weights=weight[at_90]):.2f}" if at_90.any() else "",
        f"{100 * expected_error(shots, right, weight):.2f}",
    ]  # fmt: skip
    return f"| {name} | {' | '.join(cells)} |"


HEAD = (
    "| right, % | all | nine tenths | eight tenths | share ≥ 90 | of these | calibration error |\n|---|" + "---:|" * 6
)


def judged_of(environment: Environment, first: int) -> list[Judged]:
    """Simulate, label and judge."""
    return [judge(data.simulated(spec), environment) for spec in specs(environment, first)]


def calibrate(environments: Sequence[Environment] = ENVIRONMENTS) -> None:
    """Make the table of the package."""
    empty = np.zeros((len(Label), N_CELLS), np.uint8)
    try:
        tables = {environment: load_table(environment) for environment in ENVIRONMENTS}
    except (OSError, ValueError, KeyError):  # made for other questions
        tables = dict.fromkeys(ENVIRONMENTS, empty)
    for environment in environments:
        confidence.save_tables({**tables, environment: empty})
        judged = judged_of(environment, CALIBRATION)
        tables[environment] = table_of(judged, environment)
        print(row(environment, with_table(judged, tables[environment])), flush=True)
    confidence.save_tables(tables)


def check(environments: Sequence[Environment] = ENVIRONMENTS) -> None:
    """Print every scan for choosing."""
    print(HEAD)
    for environment in environments:
        judged = judged_of(environment, CHECK)
        for one in judged:
            print(row(one.name, [one]))
        print(row(f"**{environment}**", judged), flush=True)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("which", choices=("calibrate", "check", "ablation", "report"))
    parser.add_argument("environments", nargs="*", metavar="urban|forest", help="default: both")
    arguments = parser.parse_args()
    wanted = [name for name in ENVIRONMENTS if name in (arguments.environments or ENVIRONMENTS)]
    {"calibrate": calibrate, "check": check}[arguments.which](wanted)


if __name__ == "__main__":
    main()
