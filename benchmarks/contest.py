"""The contest: both papers, the fused method and filters of registered clouds on the same points.

    # everything; only what changed is run again
    python -m benchmarks.contest > docs/figures/contest.md
    python -m benchmarks.contest --quick  # papers and fused on three scans, no filters
    python -m benchmarks.contest tables peers                 # some of the parts

Reads ../shared/data or $PRC_DATA for the real scans. Filters of registered clouds run if installed
(``pip install .[peers]``). Results are cached in --cache by the content of scan, configuration and
code."""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks import contest_peers as peers
from benchmarks.contest_chains import CHAINS
from benchmarks.contest_data import Scan
from benchmarks.contest_drives import print_drives
from benchmarks.contest_judge import CURB, LEAST_SHARE, Verdict, pooled
from benchmarks.contest_methods import FUSED, PAPERS, TO_THE_TOP, Method, fused, label
from benchmarks.contest_runs import (
    FOREST,
    FOREST_CYLINDERS,
    FOREST_NOISY,
    KITTI,
    OAKLAND,
    OAKLAND_NOISY,
    OAKLAND_TRAIN,
    PHOTON,
    SLOW,
    SLOW_DRIVES,
    STREET_GROUPS,
    VIEWS,
    DataSet,
    Run,
    Store,
    data_sets,
    f1,
    judged,
    print_things,
)
from benchmarks.pages import commands, duration, heading, printed_at, say

STREETS = "streets"
GOALS: dict[str, dict[str, float]] = {
    STREETS: {
        "noise": 0.96,
        "ground": 0.99,
        "building": 0.96,
        "vegetation": 0.92,
        "car": 0.88,
        CURB: 0.70,
        "pole": 0.75,
    },
    OAKLAND: {"ground": 0.995, "building": 0.90, "vegetation": 0.93, "car": 0.85},
    OAKLAND_TRAIN: {"ground": 0.995, "building": 0.90, "vegetation": 0.93, "car": 0.85},
    FOREST: {"stem": 0.90},
    FOREST_NOISY: {"stem": 0.85},
}
"""Least F1, mean over the scans, by group and class."""
FURTHER = (SLOW, FOREST_NOISY, *VIEWS.values())
"""Groups with tables of their own."""
MOST_LOST = 0.03
"""Of F1 in a slow drive, beside the same street driven normally."""
JUDGED_OF_PEERS = ("ground", "noise")
SPEED_SHOTS = 8_000_000
SPEED_RUNS = 3


@dataclass(slots=True)
class Contest:
    """Inputs of the parts of the page."""

    store: Store
    items: tuple[DataSet, ...]
    methods: tuple[Method, ...]
    quick: bool = False

    def all_runs(self, methods: tuple[Method, ...]) -> dict[str, dict[str, Run]]:
        """Return all runs by method and scan; scans are made once, one after the other."""
        runs_by_method: dict[str, dict[str, Run]] = {method.name: {} for method in methods}
        for item in self.items:
            scan = self.store.scan(item)
            for method in methods:
                if method.takes(scan):
                    runs_by_method[method.name][item.how] = self.store.stream_run(item, method)
        return {name: runs for name, runs in runs_by_method.items() if runs}

    def groups(self) -> dict[str, list[DataSet]]:
        """Return the scans by group."""
        groups: dict[str, list[DataSet]] = {}
        for item in self.items:
            groups.setdefault(item.group, []).append(item)
        return groups


def title_of(item: DataSet) -> str:
    return f"{item.name}, cylinders" if item.group == FOREST_CYLINDERS else item.name


def of_group(runs: dict[str, Run], items: list[DataSet]) -> list[Verdict]:
    """Return the verdicts of the available scans of a group."""
    return [runs[item.how].verdict for item in items if item.how in runs]


def mean_f1(verdicts: list[Verdict]) -> dict[str, float]:
    """Return the mean F1 of every class over the scans in which it exists."""
    scores_by_class: dict[str, list[float]] = {}
    for verdict in verdicts:
        for name, value in verdict.f1().items():
            scores_by_class.setdefault(name, []).append(0.0 if np.isnan(value) else value)
    return {name: float(np.mean(values)) for name, values in scores_by_class.items()}


def summary(contest: Contest, runs: dict[str, dict[str, Run]]) -> None:
    """One row per method, one column per group: mean macro F1 of the scans, then every class."""
    groups = contest.groups()
    print("## In short\n")
    say(f"""Macro F1: the mean F1 of noise, ground, building and vegetation (in forests noise,
    ground, stem and vegetation). A class counts in a scan if it has at least {LEAST_SHARE:.1%} of
    the scored returns. Cells: mean over the scans of the group that the method is meant for; worst
    scan in brackets. The Oakland reference has no noise: points predicted as noise count as errors
    of their true class. Noise is scored on the same strips with background added.""")
    usual = {name: items for name, items in groups.items() if name not in FURTHER}
    print_macros(usual, runs)
    print_macros({name: items for name, items in groups.items() if name in FURTHER}, runs)
    for title, items in {"Simulated streets": _streets(groups), **_others(groups)}.items():
        print_classes(title, items, runs)


def print_macros(groups: dict[str, list[DataSet]], runs: dict[str, dict[str, Run]]) -> None:
    """Mean macro F1 of every method by group."""
    if not groups:
        return
    print(f"| | {' | '.join(groups)} |\n|---|{'---:|' * len(groups)}")
    for name, method_runs in runs.items():
        cells = [_macro(of_group(method_runs, items)) for items in groups.values()]
        if any(cells):
            print(f"| {name} | {' | '.join(cells)} |")
    print()


def _macro(verdicts: list[Verdict]) -> str:
    macros = [verdict.macro for verdict in verdicts]
    spread = f" ({min(macros):.2f})" if len(macros) > 1 else ""
    return f"{np.mean(macros):.3f}{spread}" if macros else ""


def _streets(groups: dict[str, list[DataSet]]) -> list[DataSet]:
    return [item for group in STREET_GROUPS for item in groups.get(group, [])]


def _others(groups: dict[str, list[DataSet]]) -> dict[str, list[DataSet]]:
    return {name: items for name, items in groups.items() if name not in STREET_GROUPS}


def print_classes(title: str, items: list[DataSet], runs: dict[str, dict[str, Run]]) -> None:
    """F1 of every class by method: the mean over the scans, the worst scan in brackets."""
    verdicts_by_method = {name: of_group(method_runs, items) for name, method_runs in runs.items()}
    verdicts_by_method = {
        name: verdicts for name, verdicts in verdicts_by_method.items() if verdicts
    }
    if not verdicts_by_method:
        return
    classes = list(
        dict.fromkeys(
            name for verdicts in verdicts_by_method.values() for name in mean_f1(verdicts)
        )
    )
    print(f"### {title}: F1 of the classes\n")
    print("| | " + " | ".join(classes) + " | macro |\n|---|" + "---:|" * (len(classes) + 1))
    for name, verdicts in verdicts_by_method.items():
        means = mean_f1(verdicts)
        cells = []
        for class_label in classes:
            values = [np.nan_to_num(v.f1()[class_label]) for v in verdicts if class_label in v.f1()]
            spread = f" ({min(values):.2f})" if len(values) > 1 else ""
            cells.append(f"{means[class_label]:.3f}{spread}" if values else "")
        print(f"| {name} | {' | '.join(cells)} | {np.mean([v.macro for v in verdicts]):.3f} |")
    print()


def goals(contest: Contest, runs: dict[str, dict[str, Run]]) -> None:
    """Targets, and what the best method of the stream reaches."""
    groups = contest.groups()
    print("## Against the goals\n")
    say("""Goals are for fused, F1, mean over the scans of a group, compared as printed. Beside it
    the best method of the papers, by its mean.""")
    print(
        "| | class | goal | fused | worst scan | reached | papers "
        "|\n|---|---|---:|---:|---:|---|---|"
    )
    fused_names = {method.name for method in fused()}
    for group, wanted in GOALS.items():
        items = _streets(groups) if group == STREETS else groups.get(group, [])
        for name, goal in wanted.items():
            macro_f1 = {
                method: scores
                for method, method_runs in runs.items()
                if (scores := scores_of(method_runs, items, name))
            }
            ours = [scores for method, scores in macro_f1.items() if method in fused_names]
            if not ours:
                continue
            papers = [
                (float(np.mean(scores)), method)
                for method, scores in macro_f1.items()
                if method not in fused_names
            ]
            rival = "{:.3f}, {}".format(*max(papers)) if papers else "none"
            mean = float(np.mean(ours[0]))
            cells = (
                f"≥ {goal} | {mean:.3f} | {min(ours[0]):.3f} | {_yes(round(mean, 3) >= goal)} "
                f"| {rival}"
            )
            print(f"| {group} | {name} | {cells} |")
    print()
    print_lost(groups.get(SLOW, []), runs)


def scores_of(method_runs: dict[str, Run], items: list[DataSet], name: str) -> list[float]:
    """Return the F1 of a class, or of cars, poles and curbs, in the scans that hold enough of it.

    Empty: not known.
    """
    counts = judged(method_runs, items, name)
    if counts:
        return (
            [f1(label_counts) for label_counts in counts]
            if any(label_counts[1] for label_counts in counts)
            else []
        )
    return [
        float(np.nan_to_num(v.f1()[name]))
        for v in of_group(method_runs, items)
        if name in v.present
    ]


def print_lost(items: list[DataSet], runs: dict[str, dict[str, Run]]) -> None:
    """What slow drives cost beside the same streets driven normally."""
    first, *others = SLOW_DRIVES
    fused_runs = runs.get(FUSED, {})
    streets = [
        item.name.removesuffix(f", {first}") for item in items if item.name.endswith(f", {first}")
    ]
    verdicts = {
        item.name: fused_runs[item.how].verdict.f1() for item in items if item.how in fused_runs
    }
    if not streets or not verdicts:
        return
    say(f"""Slow drives: F1 of fused on a street driven normally, and what the same street loses
    when it is driven slowly. Goal: at most {MOST_LOST} of any class.""")
    print(f"| street | class | {' | '.join(SLOW_DRIVES)} |\n|---|---|{'---:|' * len(SLOW_DRIVES)}")
    for street in streets:
        normal = verdicts[f"{street}, {first}"]
        for name, value in normal.items():
            lost = [value - verdicts[f"{street}, {drive}"].get(name, np.nan) for drive in others]
            cells = " | ".join(
                f"{-loss:+.3f}{' (missed)' if loss > MOST_LOST else ''}" for loss in lost
            )
            print(f"| {street} | {name} | {value:.3f} | {cells} |")
    print()


def _yes(reached: bool) -> str:
    return "yes" if reached else "no"


def tables(contest: Contest, runs: dict[str, dict[str, Run]]) -> None:
    """Every scan."""
    print("## Scan by scan\n\nMacro F1, and the class that is worst.\n")
    street = [
        name
        for name in runs
        if any(item.how in runs[name] for item in contest.items if not _is_forest(item))
    ]
    forest = [
        name
        for name in runs
        if any(item.how in runs[name] for item in contest.items if _is_forest(item))
    ]
    for names, items in (
        (street, [item for item in contest.items if not _is_forest(item)]),
        (forest, [item for item in contest.items if _is_forest(item)]),
    ):
        if not names:
            continue
        print("| scan | returns | " + " | ".join(names) + " |\n|---|---:|" + "---:|" * len(names))
        for item in items:
            runs_by_name = {name: runs[name].get(item.how) for name in names}
            present_runs = [run for run in runs_by_name.values() if run is not None]
            cells = [
                ""
                if run is None
                else f"{run.verdict.macro:.3f} ({run.verdict.worst} {_low(run.verdict):.2f})"
                for run in runs_by_name.values()
            ]
            print(
                f"| {title_of(item)} | {present_runs[0].returns if present_runs else 0:,} "
                f"| {' | '.join(cells)} |"
            )
        print()


def _is_forest(item: DataSet) -> bool:
    return item.group in (FOREST, FOREST_NOISY, FOREST_CYLINDERS)


def _low(verdict: Verdict) -> float:
    return float(np.nan_to_num(verdict.f1()[verdict.worst]))


def confusion(contest: Contest, runs: dict[str, dict[str, Run]]) -> None:
    """Confusion matrices, and predictions for reference classes that are not judged."""
    print("## Confusion\n\nShare of the reference's row. Rows below the line are not judged.\n")
    for group, items in contest.groups().items():
        for name, method_runs in runs.items():
            verdicts = of_group(method_runs, items)
            if verdicts and (name in shown_in_full(runs) or len(runs) == 1):
                print_confusion(f"{group}: {name}", pooled(verdicts))


def shown_in_full(runs: dict[str, dict[str, Run]]) -> set[str]:
    """Return the methods whose confusion is shown: fused ones, or all if there are none."""
    fused_names = {method.name for method in fused()} & set(runs)
    return fused_names or set(runs)


def print_confusion(title: str, verdict: Verdict) -> None:
    print(f"### {title}\n")
    print(
        "| reference | "
        + " | ".join(verdict.columns)
        + " | returns |\n|---|"
        + "---:|" * (len(verdict.columns) + 1)
    )
    for row, counts in zip(verdict.rows, verdict.counts, strict=True):
        if counts.sum():
            print(
                f"| {row} | {' | '.join(printed_at(n / counts.sum()) for n in counts)} | "
                f"{counts.sum():,} |"
            )
    for name, became in verdict.others.items():
        total = sum(became.values())
        cells = [printed_at(became.get(column, 0) / total) for column in verdict.columns]
        print(f"| *{name}* | {' | '.join(cells)} | {total:,} |")
    print()


def against_peers(contest: Contest, runs: dict[str, dict[str, Run]]) -> None:
    """Filters of registered clouds on the same points."""
    print("## Filters of registered clouds\n")
    say("""These filters get every return with its true world coordinates (simulated scans: the
    simulated pose; Oakland: the set's own x, y, z; KITTI: the frame itself). Parameters: as their
    authors recommend and, except for SMRF, as tuned on streets of seeds 9001, 9004 and 9006 by
    <code>python -m benchmarks.contest_tune</code>. Ground filters run alone and after the best
    noise filter. F1 of ground and noise: mean over the scans, worst in brackets. Seconds of
    processor time per million returns; peak memory of the process, Python and points included.""")
    missing = sorted(
        {
            peers.PACKAGES[f]
            for chain in CHAINS.values()
            for f in (s["filter"] for s in chain)
            if peers.installed(f) is None
        }
    )
    if missing:
        print(f"Not installed when this was run: {', '.join(missing)}.\n")
    items = [item for item in contest.items if item.with_peers]
    peer_runs = {item.how: contest.store.peer_runs(item, CHAINS) for item in items}
    if left_out := [title_of(item) for item in items if not peer_runs[item.how]]:
        print(f"Not run yet, and left out here: {'; '.join(left_out)}.\n")
    items = [item for item in items if peer_runs[item.how]]
    if not items:
        return
    rows: dict[str, dict[str, Run]] = {
        name: method_runs
        for name, method_runs in runs.items()
        if any(item.how in method_runs for item in items)
    }
    for chain in CHAINS:
        chain_runs = {
            how: peer_run[chain] for how, peer_run in peer_runs.items() if chain in peer_run
        }
        if chain_runs:
            rows[f"*{chain}*"] = chain_runs
    names = {
        "simulated streets": [item for item in items if item.group in STREET_GROUPS],
        OAKLAND: [item for item in items if item.group == OAKLAND],
        OAKLAND_NOISY: [item for item in items if item.group == OAKLAND_NOISY],
        KITTI: [item for item in items if item.group == KITTI],
    }
    names = {name: chain_runs for name, chain_runs in names.items() if chain_runs}
    print(
        "| | " + " | ".join(f"{name}: ground | noise" for name in names) + " | s / million | MiB |"
    )
    print("|---|" + "---:|---:|" * len(names) + "---:|---:|")
    for name, row_runs in rows.items():
        cells = [cell for group in names.values() for cell in _two_scores(row_runs, group)]
        used = [row_runs[item.how] for item in items if item.how in row_runs]
        seconds = sum(run.cpu_s for run in used) / sum(run.returns for run in used) * 1e6
        memory = max(run.peak_mib for run in used)
        cells += [f"{seconds:.2f}", "" if np.isnan(memory) else f"{memory:,.0f}"]
        print(f"| {name} | {' | '.join(cells)} |")
    print()
    print_best(rows, names, set(runs))
    commands('pip install ".[peers]"', "python -m benchmarks.contest peers")


def _two_scores(method_runs: dict[str, Run], items: list[DataSet]) -> list[str]:
    cells = []
    for name in JUDGED_OF_PEERS:
        values = f1_of(method_runs, items, name)
        spread = f" ({min(values):.2f})" if len(values) > 1 else ""
        cells.append(f"{np.mean(values):.3f}{spread}" if values else "")
    return cells


def f1_of(method_runs: dict[str, Run], items: list[DataSet], name: str) -> list[float]:
    """Return the F1 of a class in the scans that have it; empty if the method never predicts it."""
    verdicts = of_group(method_runs, items)
    called = sum(int(verdict.counts[:, verdict.columns.index(name)].sum()) for verdict in verdicts)
    return (
        [float(np.nan_to_num(v.f1()[name])) for v in verdicts if name in v.present]
        if called
        else []
    )


def print_best(
    rows: dict[str, dict[str, Run]], groups: dict[str, list[DataSet]], fused_names: set[str]
) -> None:
    """The best filter of each column beside the best method of the stream that runs on all its
    scans."""
    print("| | best filter of registered clouds | best of the stream |\n|---|---|---|")
    for group, items in groups.items():
        for name in JUDGED_OF_PEERS:
            sides: dict[bool, list[tuple[float, str]]] = {False: [], True: []}
            for row, runs in rows.items():
                values = f1_of(runs, items, name)
                if values and all(item.how in runs for item in items):
                    sides[row in fused_names].append((float(np.mean(values)), row.strip("*")))
            if all(sides.values()):
                cells = [
                    f"{value:.3f}, {row}" for value, row in (max(sides[False]), max(sides[True]))
                ]
                print(f"| {group}: {name} | {' | '.join(cells)} |")
    print()


def things(contest: Contest, runs: dict[str, dict[str, Run]]) -> None:
    """Cars, poles and curbs."""
    print("## Cars, poles, curbs\n")
    say("""First returns, all shots with a known reference. A curb is right if one of the reference
    is within 10 cm. A scan counts if it holds 100 shots of the thing. Methods that never find it
    are left out.""")
    print_things(contest.groups(), runs)


def drives(contest: Contest, runs: dict[str, dict[str, Run]]) -> None:
    """Real scans without a reference."""
    print_drives()


def speed(contest: Contest, runs: dict[str, dict[str, Run]]) -> None:
    """Million shots a second, on all cores."""
    print("## Speed\n")
    say(f"""The scan is repeated to about {SPEED_SHOTS // 1_000_000} million shots, in memory,
    threads on all cores; the shortest of {SPEED_RUNS} runs by wall time and by processor time,
    which other load disturbs less.""")
    print("| | scan | million shots a second | a second of one core |\n|---|---|---:|---:|")
    chosen = {item.group: item for item in reversed(contest.items)}
    for group in (PHOTON, STREET_GROUPS[2], FOREST):
        if group not in chosen:
            continue
        scan = repeated(contest.store.scan(chosen[group]))
        for method in contest.methods:
            if method.takes(scan):
                wall_s, cpu_s = quickest(scan, method)
                shots = scan.n_shots / 1e6
                print(
                    f"| {method.name} | {scan.name} | {shots / wall_s:.1f} | {shots / cpu_s:.1f} |"
                )
    print()


def repeated(scan: Scan) -> Scan:
    """Return a scan with repeated lines, without fields that do not affect speed."""
    times = max(1, SPEED_SHOTS // scan.n_shots)
    every = np.concatenate([np.arange(len(scan.range_m))] * times)
    time_s = None
    if scan.time_s is not None:
        step_s = float(scan.time_s[-1, 0] - scan.time_s[0, 0]) * (
            1 + 1 / max(len(scan.time_s) - 1, 1)
        )
        time_s = np.concatenate([scan.time_s + k * step_s for k in range(times)])
    intensity = None if scan.intensity is None else scan.intensity[every]
    extra = Scan.__dataclass_fields__["extra"].default_factory()  # type: ignore[misc]
    return replace(
        scan,
        range_m=scan.range_m[every],
        time_s=time_s,
        intensity=intensity,
        extra=extra,
        world_m=None,
        codes=np.zeros((0, 0), np.int64),
    )


def quickest(scan: Scan, method: Method) -> tuple[float, float]:
    """Return the shortest time by the clock and of all cores [s]."""
    config = method.config(scan)
    runs = [label(scan, config) for _ in range(SPEED_RUNS)]
    return min(run.wall_s for run in runs), min(run.cpu_s for run in runs)


def about(contest: Contest, runs: dict[str, dict[str, Run]]) -> None:
    """Data, methods, and dates of the runs."""
    print("## Scans\n")
    say("""Simulated scans are drives of 30 to 160 m and walks of 15 m. Noise: the preset's own
    (phase scanners), or the given share of background light; 0 % leaves only mixed ranges at edges.
    Phase scanners: the simulator's own shares of background, scaled. Pulsed scanners have no
    background in the simulator; it is added at random shots, a quarter of it within 30 cm of the
    surface. None of these seeds was used to choose a parameter.""")
    print("| scan | shots | returns | share of the judged classes |\n|---|---:|---:|---|")
    for item in contest.items:
        first_run = next((runs[name][item.how] for name in runs if item.how in runs[name]), None)
        if first_run is None:
            continue
        sums = first_run.verdict.counts.sum(axis=1)
        shares = ", ".join(
            f"{name} {n / sums.sum():.1%}"
            for name, n in zip(first_run.verdict.rows, sums, strict=True)
            if n
        )
        print(f"| {title_of(item)} | {first_run.shots:,} | {first_run.returns:,} | {shares} |")
    print("\n## Methods\n\n| | as | run (UTC) |\n|---|---|---|")
    for method in contest.methods:
        whens = sorted(run.when for run in runs.get(method.name, {}).values())
        if whens:
            between = whens[0] if whens[0] == whens[-1] else f"{whens[0]} to {whens[-1]}"
            print(f"| {method.name} | `{method.command()}` | {between} |")
    print()
    say("""The sequential-angle classifier also gets the ranging noise of the scanner (10 mm for
    push-brooms, 20 mm for KITTI, else the preset's 5 mm). Vertical surfaces count as building,
    horizontal ones as ground; the method has no noise class.""")
    print_door(contest, runs)


def print_door(contest: Contest, runs: dict[str, dict[str, Run]]) -> None:
    """Where straight down had to be told, and what the program doubted or refused."""
    print("## Through the door\n")
    say("""Every run is <code>prc classify -q</code> on a file with ranges and scan angles, straight
    down not told. Where that is refused, it is told (<code>--set input.nadir=DEG</code>).""")
    print("| | scans | down had to be told | doubted | refused still |\n|---|---:|---:|---:|---:|")
    where: dict[tuple[str, str], list[str]] = {}
    titles = {item.how: title_of(item) for item in contest.items}
    for name, method_runs in runs.items():
        n_down_known = sum(run.is_down_told for run in method_runs.values())
        doubted = sum(any("warning: " in line for line in run.said) for run in method_runs.values())
        refused = sum(
            sum("error: " in line for line in run.said) > run.is_down_told
            for run in method_runs.values()
        )
        print(
            f"| {name} | {len(method_runs)} | {n_down_known or ''} | {doubted or ''} | "
            f"{refused or ''} |"
        )
        for how, run in method_runs.items():
            for line in run.said:
                said = re.sub(r"\d+ %", "N %", line)
                where.setdefault((name, said), []).append(titles[how])
    print()
    for (name, said), scans in where.items():
        print(f"- {name}, exit code {said} ({'; '.join(dict.fromkeys(scans))})")
    print()


Part = Callable[[Contest, dict[str, dict[str, Run]]], None]
PARTS: dict[str, Part] = {
    "summary": summary,
    "goals": goals,
    "tables": tables,
    "things": things,
    "peers": against_peers,
    "confusion": confusion,
    "speed": speed,
    "drives": drives,
    "about": about,
}
QUICK_PARTS = ("summary", "goals", "tables", "confusion")


def main() -> None:
    """Print the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; default: all"
    )
    parser.add_argument("--quick", action="store_true", help="three scans, streams only")
    parser.add_argument(
        "--kept",
        action="store_true",
        help="filters of registered clouds: show only what was run before",
    )
    parser.add_argument(
        "--only", metavar="TEXT", help="only scans whose name or group holds this text"
    )
    parser.add_argument(
        "--cache", type=Path, default=Path(tempfile.gettempdir()) / "prc_contest", metavar="FOLDER"
    )
    arguments = parser.parse_args()
    for part in arguments.parts:
        if part not in PARTS:
            parser.error(f"found {part!r}, expected {', '.join(PARTS)}")
    start = time.perf_counter()
    report_progress: Callable[[str], None] = lambda text: print(text, file=sys.stderr, flush=True)  # noqa: E731
    items = tuple(
        data_set
        for data_set in data_sets()
        if not arguments.only or arguments.only in f"{data_set.group} {data_set.name}"
    )
    if arguments.quick:
        items = tuple(data_set for data_set in items if data_set.name in _quick_names())
    contest = Contest(
        Store(arguments.cache, report_progress),
        items,
        (*PAPERS, *fused(), *TO_THE_TOP),
        arguments.quick,
    )
    contest.store.only_kept = arguments.kept
    runs = contest.all_runs(contest.methods)
    print(heading("The contest: figures", "contest"))
    say("""Generated tables behind [the accuracy of prc](../accuracy.md). Parameters are those of
    the presets and the same for all scans, except where a row says otherwise. Tuning used other
    streets and the first Oakland strip, which is shown but not counted. Classes of the macro F1:
    noise, ground, building, vegetation; in forests also stems. Cars, poles and curbs have tables of
    their own. Signs, wires and people are not scored; the confusion tables show what they are
    predicted as.""")
    for part in arguments.parts or (QUICK_PARTS if arguments.quick else PARTS):
        PARTS[part](contest, runs)
    print(duration())
    report_progress(f"{contest.store.n_new} new runs, {time.perf_counter() - start:.0f} s")


def _quick_names() -> tuple[str, ...]:
    streets = [data_set.name for data_set in data_sets() if data_set.group in STREET_GROUPS]
    return (streets[1], "Oakland strip 2", "mixed forest")


if __name__ == "__main__":
    main()
