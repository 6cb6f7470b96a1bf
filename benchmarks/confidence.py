"""The confidence of the fused method.

Its table, and how often labels of every confidence are right.

    python -m benchmarks.confidence calibrate  # makes prc_cli/methods/fused/confidence.json
    python -m benchmarks.confidence check  # reliability on other streets and forests, for choosing
    python -m benchmarks.confidence report  # figures/confidence.md, seeds that decided nothing

Calibrated on seeds 2601 to 2699, chosen on 2701 to 2799, reported on 2901 to 2999 and on the
labelled real scans of ../shared/data or $PRC_DATA. A label is right if it is the class of the
reference, as for ``prc evaluate --mapping street``: people and wires, which have no class, are
never right."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from unittest import mock

import numpy as np

from benchmarks import contest_data as data
from benchmarks.contest_data import Scan, Simulated
from benchmarks.contest_judge import MAPPINGS
from benchmarks.pages import ROOT, duration, heading, parser_of
from prc_cli.config import load_config
from prc_cli.core.classes import Label
from prc_cli.core.types import F64, I32, U8, Mask
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.jobs.classify import label_blocks
from prc_cli.methods.base import Wanted
from prc_cli.methods.fused import confidence, pipeline
from prc_cli.methods.fused.confidence import (
    N_CELLS,
    QUESTIONS,
    Environment,
    confidence_of,
    load_table,
)

ENVIRONMENTS: tuple[Environment, ...] = ("urban", "forest")
CALIBRATION = 2601
CHECK = 2701
HELD_OUT = 2901
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
    """Return the simulated scans that begin with a seed.

    The drives of the contest, through other streets.
    """
    for turn in range(ROUNDS[first]):
        if environment == "urban":
            for k, spec in enumerate(data.TEST_STREETS):
                scene = SCENES[(SCENES.index(spec.scene) + turn) % len(SCENES)]
                length_m = SHORTER[spec.length_m]
                yield replace(
                    spec,
                    seed=first + len(data.TEST_STREETS) * turn + k,
                    scene=scene,
                    length_m=length_m,
                )
            continue
        for k, scene in enumerate(FOREST_SCENES):
            scanner = FOREST_SCANNERS[turn % len(FOREST_SCANNERS)]
            seed = first + len(FOREST_SCENES) * turn + k
            yield Simulated(
                f"{scene}, {scanner}", seed, FOREST_M[scanner], scene, scanner, kind="forest"
            )


def judge(scan: Scan, environment: Environment) -> Judged:
    """Label a scan, and compare with its reference."""
    params = load_config(
        preset="fused" if environment == "urban" else "fused-forest"
    ).config.classifier
    cells: list[I32] = []

    def kept(labels: U8, shot_cells: I32, table: U8) -> U8:
        cells.append(shot_cells)
        return confidence_of(labels, shot_cells, table)

    with mock.patch.object(pipeline, "confidence_of", kept):
        items = list(label_blocks(scan.blocks(), params, wanted=Wanted(confidence=True)))
    labels = np.concatenate([item.labels for item in items])
    shots = np.concatenate([item.confidence for item in items if item.confidence is not None])
    right, there = _right(scan, labels)
    return Judged(
        scan.name, labels[there], np.concatenate(cells)[there], right[there], shots[there]
    )


def _right(scan: Scan, labels: U8) -> tuple[Mask, Mask]:
    """Return which labels are those of the reference, and which can be judged."""
    names = {"street": "street", "oakland": "street_oakland", "kitti": MAPPINGS["kitti"]}
    codes = load_config().config.classes.lookup()[labels].astype(np.int64)
    there: Mask = ~np.isnan(scan.range_m) & (scan.codes != 0)
    if scan.mapping not in names:
        return codes == scan.codes, there
    mapping = load_mapping(names[scan.mapping])
    rows = np.array([*mapping.names("reference"), ""])
    columns = np.array([*mapping.names("predicted"), "-"])
    reference = mapping.class_indices(
        np.where(there, scan.codes, scan.codes[there][0]), "reference"
    )
    predicted = mapping.class_indices(np.where(there, np.maximum(codes, 1), 1), "predicted")
    right: Mask = rows[reference] == columns[predicted]
    return right, there & (rows[reference] != "")


def table_of(judged: Sequence[Judged], environment: Environment) -> U8:
    """Return the share of right labels in every cell [per cent]."""
    table = np.zeros((len(Label), N_CELLS), np.uint8)
    for label, questions in QUESTIONS[environment].items():
        of_label = [
            (
                judged_scan.cells[judged_scan.labels == label],
                judged_scan.right[judged_scan.labels == label],
                judged_scan.weight,
            )
            for judged_scan in judged
        ]
        if not sum(len(cells) for cells, _, _ in of_label):
            continue
        n = np.zeros(N_CELLS)
        right = np.zeros(N_CELLS)
        for cells, is_right, weight in of_label:
            n += weight * np.bincount(cells, minlength=N_CELLS)
            right += weight * np.bincount(cells, is_right, minlength=N_CELLS)
        shape = (4,) * len(questions)
        n = n.reshape(shape)
        right = right.reshape(shape)
        share = right.sum() / n.sum()
        for k in range(1, len(questions) + 1):
            rest = tuple(range(k, len(questions)))
            there = n.sum(rest, keepdims=True)
            good = right.sum(rest, keepdims=True)
            share = (good + PRIOR_SHOTS * share) / (there + PRIOR_SHOTS)
        # 0 is for what is not known
        table[label] = np.maximum(np.rint(100.0 * share).ravel(), 1)
    return table


def top_share(
    shots: U8,
    right: Mask,
    weight: F64,
    share: float = TOP,
) -> float:
    """Return how many are right of the given share with the most confidence.

    Of equals, each counts in part.
    """
    n = np.bincount(shots, weight, minlength=101)[::-1]
    good = np.bincount(shots, weight * right, minlength=101)[::-1]
    taken = np.clip(share * n.sum() - (np.cumsum(n) - n), 0.0, n)
    return float((good * taken / np.maximum(n, 1e-9)).sum() / taken.sum())


def expected_error(shots: U8, right: Mask, weight: F64) -> float:
    """Return the mean difference of confidence and share of right ones, over the values of the
    byte."""
    n = np.bincount(shots, weight, minlength=101)
    good = np.bincount(shots, weight * right, minlength=101)
    return float(np.abs(good - n * np.arange(101) / 100.0).sum() / n.sum())


def pooled(judged: Sequence[Judged]) -> tuple[U8, Mask, F64]:
    """Return confidence, right and weight of the returns of several scans."""
    return (
        np.concatenate([judged_scan.shots for judged_scan in judged]),
        np.concatenate([judged_scan.right for judged_scan in judged]),
        np.concatenate(
            [np.full(len(judged_scan.labels), judged_scan.weight) for judged_scan in judged]
        ),
    )


def with_table(judged: Sequence[Judged], table: U8) -> list[Judged]:
    """Return scans with the confidence of another table."""
    return [
        replace(judged_scan, shots=confidence_of(judged_scan.labels, judged_scan.cells, table))
        for judged_scan in judged
    ]


def row(name: str, judged: Sequence[Judged]) -> str:
    """Return a row of the table of scans."""
    shots, right, weight = pooled(judged)
    share = np.average(right, weights=weight)
    at_90 = shots >= 90
    cells = [
        f"{100 * share:.2f}",
        f"{100 * top_share(shots, right, weight):.2f}",
        f"{100 * top_share(shots, right, weight, 0.8):.2f}",
        f"{100 * np.average(at_90, weights=weight):.1f}",
        f"{100 * np.average(right[at_90], weights=weight[at_90]):.2f}" if at_90.any() else "",
        f"{100 * expected_error(shots, right, weight):.2f}",
    ]
    return f"| {name} | {' | '.join(cells)} |"


HEAD = (
    "| right, % | all | nine tenths | eight tenths | share ≥ 90 | of these | calibration "
    "error |\n|---|" + "---:|" * 6
)


def judged_of(environment: Environment, first: int) -> list[Judged]:
    """Simulate, label and judge."""
    return [judge(data.simulated(spec), environment) for spec in specs(environment, first)]


def calibrate(environments: Sequence[Environment] = ENVIRONMENTS) -> None:
    """Make the table of the package."""
    empty = np.zeros((len(Label), N_CELLS), np.uint8)
    try:
        tables = {environment: load_table(environment) for environment in ENVIRONMENTS}
    except (
        OSError,
        ValueError,
        KeyError,
    ):  # made for other questions: labels need a table, whatever it says
        tables = dict.fromkeys(ENVIRONMENTS, empty)
        confidence.save_tables(tables)
    for environment in environments:
        judged = judged_of(environment, CALIBRATION)
        tables[environment] = table_of(judged, environment)
        print(row(environment, with_table(judged, tables[environment])), flush=True)
    confidence.save_tables(tables)


def check(environments: Sequence[Environment] = ENVIRONMENTS) -> None:
    """Print every scan for choosing."""
    print(HEAD)
    for environment in environments:
        judged = judged_of(environment, CHECK)
        for judged_scan in judged:
            print(row(judged_scan.name, [judged_scan]))
        print(row(f"**{environment}**", judged), flush=True)


NAMES: dict[Environment, str] = {"urban": "streets", "forest": "forests"}
ABOUT = """\
Every simulated scan counts as much as any other. *Nine tenths*: the share of right labels among the
nine tenths of the shots with the most confidence; of shots with one confidence, each counts in
part. *Calibration error*: mean difference of confidence and share of right labels, over the values
of the byte."""


def reliability(judged: Sequence[Judged]) -> list[tuple[str, float, float, float]]:
    """Return spans of confidence.

    Name, mean confidence, share of right ones [per cent], share of all shots.
    """
    shots, right, weight = pooled(judged)
    rows = []
    for low, end in pairwise(BINS):
        inside = (shots >= low) & (shots < end)
        if inside.any():
            w = weight[inside]
            name = f"{low}" if end == low + 1 else f"{low}-{end - 1}"
            mean = np.average(shots[inside], weights=w)
            share = 100 * np.average(right[inside], weights=w)
            rows.append((name, float(mean), float(share), float(w.sum() / weight.sum())))
    return rows


def print_reliability(judged: Sequence[Judged]) -> None:
    """Print how often labels of every span of confidence are right, and of every label."""
    print("\n| confidence | mean | right, % | share of the shots |\n|---|---:|---:|---:|")
    for name, mean, share, of_all in reliability(judged):
        print(f"| {name} | {mean:.1f} | {share:.1f} | {of_all:.1%} |")
    shots, right, weight = pooled(judged)
    labels = np.concatenate([judged_scan.labels for judged_scan in judged])
    print(
        "\n| label | right, % | mean confidence | share with ≥ 95 | of these right, % "
        "|\n|---|---:|---:|---:|---:|"
    )
    for label in np.unique(labels).tolist():
        is_label = labels == label
        w = weight[is_label]
        sure = shots[is_label] >= 95
        of_these = (
            f"{100 * np.average(right[is_label][sure], weights=w[sure]):.1f}" if sure.any() else ""
        )
        mean = np.average(shots[is_label], weights=w)
        share = 100 * np.average(right[is_label], weights=w)
        name = Label(label).name.lower()
        cells = (
            name,
            f"{share:.1f}",
            f"{mean:.1f}",
            f"{np.average(sure, weights=w):.1%}",
            of_these,
        )
        print(f"| {' | '.join(cells)} |")


def curve(lines: dict[str, list[tuple[str, float, float, float]]]) -> str:
    """Return the reliability curves as a picture, .svg.

    Confidence across, share of right labels up.
    """
    colours = ("#0072b2", "#d55e00", "#009e73")
    # a per cent is a unit, across and up
    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" width="460" viewBox="-14 -14 128 128" '
        'font-family="sans-serif" font-size="3.5" fill="none">'
        '<path d="M-14,-14 h128 v128 h-128 z" fill="white"/>'
        '<path d="M0,100 L100,0" stroke="#999" stroke-width="0.3" stroke-dasharray="1"/>'
    ]
    parts += [
        f'<path d="M0,{100 - tick} h100" stroke="#ddd" stroke-width="0.3"/><g fill="black">'
        f'<text x="{tick}" y="105" text-anchor="middle">{tick}</text>'
        f'<text x="-2" y="{101 - tick}" text-anchor="end">{tick}</text></g>'
        for tick in range(0, 101, 20)
    ]
    for k, (name, rows) in enumerate(lines.items()):
        path = " ".join(f"{mean:.1f},{100 - share:.1f}" for _, mean, share, _ in rows)
        parts.append(
            f'<polyline points="{path}" stroke="{colours[k]}" stroke-width="0.6"/>'
            f'<text x="3" y="{5 + 5 * k}" fill="{colours[k]}">{name}</text>'
        )
    parts.append(
        '<g fill="black"><text x="50" y="111" text-anchor="middle">confidence [%]</text>'
        '<text x="-10" y="-4">labels that are right [%]</text></g></svg>'
    )
    return "\n".join(parts) + "\n"


REAL_TEXT = """\
By the mapping `street_oakland`; the first strip is one that `fused` was tuned on, nothing about
confidence was chosen on any. Of the KITTI frame ground, building and vegetation are compared; no
ring scanner is simulated, so its confidence is that of profilers."""


def print_real(lines: dict[str, list[tuple[str, float, float, float]]]) -> None:
    """Judge the real scans."""
    print(f"\n## Real scans\n\n{REAL_TEXT}\n\n{HEAD}")
    strips = [judge(data.oakland(k), "urban") for k in (1, 2, 3)]
    for judged_scan in (*strips, judge(data.kitti(), "urban")):
        print(row(judged_scan.name, [judged_scan]), flush=True)
    lines["Oakland 1 to 3"] = reliability(strips)


def report(environments: Sequence[Environment] = ENVIRONMENTS) -> None:
    """Print the page of figures, and draw the curve."""
    print(heading("Confidence: figures", "confidence"))
    print(
        "What the byte means is [described "
        f"here](../docs/confidence.md).\n\n```console\n{COMMANDS}\n```\n\n{ABOUT}"
    )
    lines: dict[str, list[tuple[str, float, float, float]]] = {}
    for environment in environments:
        judged = judged_of(environment, HELD_OUT)
        print(f"\n## {NAMES[environment].capitalize()} that decided nothing\n\n{HEAD}")
        for name in dict.fromkeys(judged_scan.name for judged_scan in judged):
            print(row(name, [judged_scan for judged_scan in judged if judged_scan.name == name]))
        print(row(f"**all {len(judged)}**", judged), flush=True)
        print_reliability(judged)
        lines[NAMES[environment]] = reliability(judged)
    print_real(lines)
    CURVE.write_text(curve(lines), encoding="utf-8")
    print(duration())


COMMANDS = """$ python -m benchmarks.confidence calibrate  # after any change of fused
$ python -m benchmarks.confidence report > figures/confidence.md
"""


COMMAND: dict[str, Callable[[Sequence[Environment]], None]] = {
    "calibrate": calibrate,
    "check": check,
    "report": report,
}


def main() -> None:
    """Run what is asked for."""
    parser = parser_of(__doc__)
    parser.add_argument("which", choices=tuple(COMMAND))
    parser.add_argument("environments", nargs="*", metavar="urban|forest", help="default: both")
    arguments = parser.parse_args()
    wanted = [name for name in ENVIRONMENTS if name in (arguments.environments or ENVIRONMENTS)]
    COMMAND[arguments.which](wanted)


if __name__ == "__main__":
    main()
