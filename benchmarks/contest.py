"""The contest: both papers, the fused method and filters of registered clouds on the same points.

    python -m benchmarks.contest > figures/contest.md
    python -m benchmarks.contest --quick                  # three scans, no filters
    python -m benchmarks.contest summary things           # some of the parts
    python -m benchmarks.contest --only KITTI             # scans whose name or group holds a text

Reads ../shared/data or $PRC_DATA for the real scans. Filters of registered clouds run if installed
(``pip install .[peers]``).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from multiprocessing import get_context
from operator import add

import numpy as np

from benchmarks import contest_data as data
from benchmarks import contest_peers as peers
from benchmarks.contest_data import Scan, Simulated
from benchmarks.contest_judge import CURB, LEAST_SHARE, Verdict, judge, judge_things
from benchmarks.contest_methods import FUSED, METHODS, Method, label, label_scan
from benchmarks.pages import (
    DATA,
    commands,
    duration,
    heading,
    parser_of,
    printed_at,
    say,
    table,
)
from prc_cli.core.stream import ExtraReturns

STREETS = "streets"
STREET_GROUPS = {
    "photon-80": "streets, photon-80",
    "sick-push-broom": "streets, sick-push-broom",
    "profiler-1mhz": "streets, profiler-1mhz",
}
OAKLAND = "Oakland 2, 3"
OAKLAND_NOISY = "Oakland 2, 3, background added"
OAKLAND_TRAIN = "Oakland 1 (tuned on)"
KITTI = "KITTI frame"
FOREST = "forests"
FOREST_CYLINDERS = "forests, reference of cylinders"
FOREST_NOISY = "forests, 3 cm of noise"
VIEWS = {"kitti": "KITTI views", "nuscenes": "nuScenes views", "vlp32": "VLP-32 views"}
"""By kind; those with odd numbers, the even ones chose parameters of rings, VLP-32 none."""
PEER_SEEDS = (7201, 7202, 7205, 7208, 7209, 7210)
"""Streets for the filters of registered clouds, which take minutes instead of seconds."""
_OF_OAKLAND = {"ground": 0.995, "building": 0.90, "vegetation": 0.93, "car": 0.85}
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
    OAKLAND: _OF_OAKLAND,
    OAKLAND_TRAIN: _OF_OAKLAND,
    FOREST: {"stem": 0.90},
    FOREST_NOISY: {"stem": 0.85},
}
"""Least F1, mean over the scans, by group and class."""
LEAST_SHOTS = 100
"""Fewest shots of a thing in a scan that is judged."""
SPEED_SHOTS = 8_000_000


@dataclass(frozen=True, slots=True)
class Run:
    """Result of a method on a scan."""

    verdict: Verdict
    n_returns: int
    cpu_s: float
    things: dict[str, list[float]] = field(default_factory=dict)
    """Counts of ``contest_judge.judge_things``."""
    said: tuple[str, ...] = ()
    """Warnings and refusals."""

    def f1(self, name: str) -> float | None:
        """Return the F1 of a class or a thing; None if the scan has too few of it."""
        if name in self.things:
            agree, predicted, reference = self.things[name]
            return 2 * agree / (predicted + reference) if reference >= LEAST_SHOTS else None
        f1 = self.verdict.f1()
        return float(np.nan_to_num(f1[name])) if name in f1 else None


@dataclass(slots=True)
class DataSet:
    """A scan, and what the methods made of it."""

    name: str
    group: str
    make: Callable[[], Scan]
    with_peers: bool = False
    runs: dict[str, Run] = field(default_factory=dict)
    """By method."""

    def run(self, methods: tuple[Method, ...], chains: dict[str, list[peers.Step]]) -> None:
        """Make the scan, and run all methods that are for it."""
        scan = self.make()
        for method in methods:
            if method.takes(scan):
                print(f"{self.name}: {method.name}", file=sys.stderr, flush=True)
                done = label_scan(scan, method)
                verdict = judge(scan, done.codes, done.extra_codes)
                things = judge_things(scan, done.codes)
                self.runs[method.name] = Run(verdict, scan.n_returns, done.cpu_s, things, done.said)
        if self.with_peers and chains:
            self._run_peers(scan, chains)

    def _run_peers(self, scan: Scan, chains: dict[str, list[peers.Step]]) -> None:
        points = peers.points_of(scan)
        made: dict[str, tuple[np.ndarray, float]] = {"[]": (points.no_codes(), 0.0)}
        # the packages bring libraries of their own
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            for name, steps in chains.items():
                for n in range(len(steps)):
                    before, spent_s = made[str(steps[:n])]
                    if str(steps[: n + 1]) not in made:
                        codes, cpu_s = pool.submit(peers.step, points, steps[n], before).result()
                        made[str(steps[: n + 1])] = (codes, spent_s + cpu_s)
                codes, cpu_s = made[str(steps)]
                verdict = judge(scan, *peers.as_image(scan, codes))
                self.runs[f"*{name}*"] = Run(verdict, scan.n_returns, cpu_s)


def data_sets() -> list[DataSet]:
    """Return all scans for reporting, real ones if available."""

    def simulated(spec: Simulated, group: str) -> DataSet:
        return DataSet(spec.name, group, partial(data.simulated, spec), spec.seed in PEER_SEEDS)

    sets = [simulated(spec, STREET_GROUPS[spec.scanner]) for spec in data.TEST_STREETS]
    if (DATA / "oakland").exists():
        for n in (2, 3, 1):
            group = OAKLAND_TRAIN if n == 1 else OAKLAND
            name = f"Oakland strip {n}"
            sets.append(DataSet(name, group, partial(data.oakland, n), n != 1))
        for n in (2, 3):
            name = f"Oakland strip {n}, 5 % background added"
            sets.append(DataSet(name, OAKLAND_NOISY, partial(data.oakland_noisy, n), True))
    if (DATA / "kitti").exists():
        sets.append(DataSet("KITTI frame", KITTI, data.kitti, True))
    for kind, group in VIEWS.items():
        sets += [
            DataSet(path.stem, group, partial(data.view, path))
            for path in data.view_paths(kind)
            if kind == "vlp32" or int(path.stem.rsplit("_", 1)[1]) % 2
        ]
    sets += [simulated(spec, FOREST) for spec in data.TEST_FORESTS]
    sets += [simulated(spec, FOREST_NOISY) for spec in data.NOISY_FORESTS]
    for spec in data.TEST_FORESTS:
        cylinders = replace(spec, name=f"{spec.name}, cylinders", cylinders=True)
        sets.append(simulated(cylinders, FOREST_CYLINDERS))
    return sets


def by_group(sets: list[DataSet]) -> dict[str, list[DataSet]]:
    """Return the scans by group."""
    return {
        group: [s for s in sets if s.group == group]
        for group in dict.fromkeys(item.group for item in sets)
    }


def streets_and_others(sets: list[DataSet]) -> dict[str, list[DataSet]]:
    """Return the scans by group, all streets in one."""
    streets = [item for item in sets if item.group in STREET_GROUPS.values()]
    others = [item for item in sets if item.group not in STREET_GROUPS.values()]
    return {**({STREETS: streets} if streets else {}), **by_group(others)}


def methods_of(sets: list[DataSet]) -> list[str]:
    """Return the methods of the stream that ran on some of the scans."""
    names = dict.fromkeys(name for item in sets for name in item.runs)
    return [name for name in names if not name.startswith("*")]


def mean_and_worst(values: list[float], digits: int = 3) -> str:
    """Return the mean of scans, and the worst of several in brackets."""
    if not values:
        return ""
    spread = f" ({min(values):.2f})" if len(values) > 1 else ""
    return f"{np.mean(values):.{digits}f}{spread}"


def runs_of(sets: list[DataSet], method: str) -> list[Run]:
    """Return the runs of a method."""
    return [item.runs[method] for item in sets if method in item.runs]


def f1_of(sets: list[DataSet], method: str, name: str) -> list[float]:
    """Return the F1 of a class by a method in all scans that have enough of it."""
    return [f1 for run in runs_of(sets, method) if (f1 := run.f1(name)) is not None]


def summary(sets: list[DataSet]) -> None:
    """Print the macro F1 of every method by group, then every class."""
    print("## In short\n")
    say(f"""Macro F1: the mean F1 of noise, ground, building and vegetation (in forests noise,
    ground, stem and vegetation). A class counts in a scan if it has at least {LEAST_SHARE:.1%} of
    the scored returns. Cells: mean over the scans of the group that the method is meant for; worst
    scan in brackets. The Oakland reference has no noise: points predicted as noise count as errors
    of their true class. Noise is scored on the same strips with background added.""")
    groups = by_group(sets)
    table(
        ("", *groups),
        (
            (
                method,
                *(
                    mean_and_worst([run.verdict.macro for run in runs_of(items, method)])
                    for items in groups.values()
                ),
            )
            for method in methods_of(sets)
        ),
    )
    for group, items in streets_and_others(sets).items():
        verdicts = [run.verdict for item in items for run in item.runs.values()]
        classes = list(dict.fromkeys(name for verdict in verdicts for name in verdict.present))
        title = "Simulated streets" if group == STREETS else group
        print(f"### {title}: F1 of the classes\n")
        rows = []
        for method in methods_of(items):
            cells = (mean_and_worst(f1_of(items, method, name)) for name in classes)
            macro = np.mean([run.verdict.macro for run in runs_of(items, method)])
            rows.append((method, *cells, f"{macro:.3f}"))
        table(("", *classes, "macro"), rows)


def goals(sets: list[DataSet]) -> None:
    """Print the goals, and what fused and the best method of the papers reach."""
    print("## Against the goals\n")
    say("Goals are for fused: F1, mean over the scans of a group, compared as printed.")
    rows = []
    for group, items in streets_and_others(sets).items():
        ours = FUSED if FUSED in methods_of(items) else f"{FUSED}-forest"
        for name, goal in GOALS.get(group, {}).items():
            f1 = f1_of(items, ours, name)
            if not f1:
                continue
            papers = [
                (float(np.mean(scores)), method)
                for method in methods_of(items)
                if not method.startswith(FUSED) and (scores := f1_of(items, method, name))
            ]
            best = "{:.3f}, {}".format(*max(papers)) if papers else "none"
            reached = "yes" if round(float(np.mean(f1)), 3) >= goal else "no"
            numbers = (f"{np.mean(f1):.3f}", f"{min(f1):.3f}")
            rows.append((group, name, f"≥ {goal}", *numbers, reached, best))
    table(("", "class", "goal", "fused", "worst scan", "reached", "papers"), rows)


def tables(sets: list[DataSet]) -> None:
    """Print every scan."""
    print("## Scan by scan\n\nMacro F1, and the class that is worst.\n")
    forests = [item for item in sets if item.group.startswith(FOREST)]
    for items in ([item for item in sets if item not in forests], forests):
        names = methods_of(items)
        rows = []
        for item in items:
            cells = []
            for name in names:
                verdict = item.runs[name].verdict if name in item.runs else None
                worst = "" if verdict is None else verdict.worst
                low = 0.0 if verdict is None else np.nan_to_num(verdict.f1()[worst])
                cells.append("" if verdict is None else f"{verdict.macro:.3f} ({worst} {low:.2f})")
            n_returns = max((run.n_returns for run in item.runs.values()), default=0)
            rows.append((item.name, f"{n_returns:,}", *cells))
        if rows:
            table(("scan", "returns", *names), rows)


def things(sets: list[DataSet]) -> None:
    """Print cars, poles and curbs."""
    print("## Cars, poles, curbs\n")
    say("""First returns, all shots with a known reference: F1 (worst scan). A curb is right if one
    of the reference is within 10 cm. A scan counts if it holds 100 shots of the thing. Methods that
    never find it are left out.""")
    groups = by_group(sets)
    for name in ("car", "pole", CURB):
        rows = []
        for method in methods_of(sets):
            f1 = [f1_of(items, method, name) for items in groups.values()]
            cells = [mean_and_worst(values) if any(values) else "" for values in f1]
            if any(cells):
                rows.append((method, *cells))
        print(f"### {name[0].upper()}{name[1:]}\n")
        table(("", *groups), rows)


def against_peers(sets: list[DataSet]) -> None:
    """Print filters of registered clouds beside the methods of the stream."""
    print("## Filters of registered clouds\n")
    say("""These filters get every return with its true world coordinates (simulated scans: the
    simulated pose; Oakland: the set's own x, y, z; KITTI: the frame itself). Parameters: as their
    authors recommend and, except for SMRF, as tuned on streets of seeds 9001, 9004 and 9006.
    Ground filters run alone and after the best noise filter. F1 of ground and noise: mean over the
    scans, worst in brackets. Seconds of processor time per million returns.""")
    items = [item for item in sets if any(name.startswith("*") for name in item.runs)]
    if not items:
        print("Not run: no scan for them, or no package.\n")
        return
    groups = streets_and_others(items)
    names = dict.fromkeys(name for item in items for name in item.runs)
    rows = []
    for name in names:
        runs = runs_of(items, name)
        cells = []
        for group_items in groups.values():
            for kind in ("ground", "noise"):
                present = [item for item in group_items if name in item.runs]
                f1 = f1_of(present, name, kind)
                cells.append(mean_and_worst(f1) if any(f1) else "")
        seconds = sum(run.cpu_s for run in runs) / sum(run.n_returns for run in runs) * 1e6
        rows.append((name, *cells, f"{seconds:.2f}"))
    columns = (f"{group}: {kind}" for group in groups for kind in ("ground", "noise"))
    table(("", *columns, "s / million"), rows)
    commands('pip install ".[peers]"', "python -m benchmarks.contest peers")


def confusion(sets: list[DataSet]) -> None:
    """Print confusion matrices of fused, and predictions for classes that are not judged."""
    print("## Confusion\n\nShare of the reference's row. Rows in italics are other things.\n")
    for group, items in by_group(sets).items():
        for name in (FUSED, f"{FUSED}-forest"):
            verdicts = [run.verdict for run in runs_of(items, name)]
            if not verdicts:
                continue
            whole = reduce(add, verdicts)
            counts = dict(zip(whole.matrix.reference_names, whole.matrix.counts, strict=True))
            counts |= {f"*{kind}*": np.array(list(n.values())) for kind, n in whole.others.items()}
            print(f"### {group}: {name}\n")
            table(
                ("reference", *whole.matrix.predicted_names, "returns"),
                (
                    (row, *(printed_at(n / cells.sum()) for n in cells), f"{cells.sum():,}")
                    for row, cells in counts.items()
                    if cells.sum()
                ),
            )


def speed(sets: list[DataSet]) -> None:
    """Print million shots a second, on all cores."""
    print("## Speed\n")
    say("""The scan is repeated to about 8 million shots, in memory, threads on all cores; the
    shortest of 3 runs by wall time and by processor time, which other load disturbs less.""")
    groups = by_group(sets)
    rows = []
    for group in (*STREET_GROUPS.values(), FOREST):
        if group not in groups:
            continue
        scan = repeated(groups[group][0].make())
        shots = scan.n_shots / 1e6
        for method in METHODS:
            if method.takes(scan):
                runs = [label(scan, method.config(scan)) for _ in range(3)]
                by_wall = shots / min(run.wall_s for run in runs)
                by_cpu = shots / min(run.cpu_s for run in runs)
                rows.append((method.name, scan.name, f"{by_wall:.1f}", f"{by_cpu:.1f}"))
    table(("", "scan", "million shots a second", "a second of one core"), rows)


def repeated(scan: Scan) -> Scan:
    """Return a scan with repeated lines, without values that do not affect speed."""
    times = max(1, SPEED_SHOTS // scan.n_shots)
    time_s = scan.time_s
    if time_s is not None:
        turn_s = float(time_s[-1, 0] - time_s[0, 0]) * (1 + 1 / max(len(time_s) - 1, 1))
        time_s = np.concatenate([time_s + k * turn_s for k in range(times)])
    intensity = None if scan.intensity is None else np.tile(scan.intensity, (times, 1))
    return replace(
        scan,
        range_m=np.tile(scan.range_m, (times, 1)),
        time_s=time_s,
        intensity=intensity,
        extra=ExtraReturns.none(),
        world_m=None,
        codes=np.zeros((0, 0), np.int64),
    )


def about(sets: list[DataSet]) -> None:
    """Print scans, methods, and what was warned of."""
    print("## Scans\n")
    say("""Simulated scans are drives of 30 to 160 m and walks of 15 m. Noise: the preset's own
    (phase scanners), or the given share of background light; 0 % leaves only mixed ranges at edges.
    Phase scanners: the simulator's own shares of background, scaled. Pulsed scanners have no
    background in the simulator; it is added at random shots, a quarter of it within 30 cm of the
    surface. None of these seeds was used to choose a parameter. Every run is <code>prc classify
    -q</code> on a file with ranges and scan angles; straight down is told
    (<code>--set input.nadir=DEG</code>) only where prc refuses the file without it.""")
    rows = []
    for item in sets:
        run = next(iter(item.runs.values()), None)
        if run is not None:
            matrix = run.verdict.matrix
            sums = matrix.counts.sum(axis=1)
            parts = zip(matrix.reference_names, sums, strict=True)
            shares = ", ".join(f"{name} {n / sums.sum():.1%}" for name, n in parts if n)
            said = {line for run in item.runs.values() for line in run.said}
            rows.append((item.name, f"{run.n_returns:,}", shares, len(said) or ""))
    table(("scan", "returns", "share of the judged classes", "warnings and refusals"), rows)
    print("## Methods\n")
    table(("", "as"), ((method.name, f"`{method.command()}`") for method in METHODS))
    say("""The sequential-angle classifier also gets the ranging noise of the scanner (10 mm for
    push-brooms, 20 mm for KITTI, else the preset's 5 mm). Vertical surfaces count as building,
    horizontal ones as ground; the method has no noise class.""")


PARTS: dict[str, Callable[[list[DataSet]], None]] = {
    "summary": summary,
    "goals": goals,
    "tables": tables,
    "things": things,
    "peers": against_peers,
    "confusion": confusion,
    "speed": speed,
    "about": about,
}
QUICK = ("summary", "goals", "tables", "things", "confusion", "about")


def main() -> None:
    """Print the page."""
    parser = parser_of(__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--quick", action="store_true", help="three scans, streams only")
    parser.add_argument("--only", default="", metavar="TEXT", help="scans of this name or group")
    arguments = parser.parse_args()
    parts = arguments.parts or (QUICK if arguments.quick else PARTS)
    sets = [item for item in data_sets() if arguments.only in f"{item.group} {item.name}"]
    if arguments.quick:
        firsts = {item.group: item for item in reversed(sets)}
        quick = (STREET_GROUPS["photon-80"], OAKLAND, FOREST)
        sets = [firsts[group] for group in quick if group in firsts]
    chains = peers.chains() if "peers" in parts else {}
    for item in sets if set(parts) - {"speed"} else ():
        item.run(METHODS, chains)
    print(heading("The contest: figures", "contest"))
    say("""Generated tables behind [the accuracy of prc](../docs/accuracy.md). Parameters are those
    of the presets and the same for all scans, except where a row says otherwise. Tuning used other
    streets and the first Oakland strip, which is shown but not counted. Classes of the macro F1:
    noise, ground, building, vegetation; in forests also stems. Cars, poles and curbs have tables of
    their own. Signs, wires and people are not scored.""")
    for part in parts:
        PARTS[part](sets)
    print(duration())


if __name__ == "__main__":
    main()
