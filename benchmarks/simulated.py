"""Figures of simulated scans: the papers' tables, and statistics beside real scans.

    python -m benchmarks.simulated > figures/simulation.md     # everything, minutes
    python -m benchmarks.simulated urban speed                      # some of the parts

Reads ../shared/data or $PRC_DATA for the real scans. Static scans are those of
``benchmarks.sequential_angle``. Each table names the commands that give the same figures; no
parameter of a classifier was chosen on these seeds, but ``fused`` was tuned on other seeds of this
simulator, and the forest's defaults with Table II in view."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.contest_data import oakland as oakland_scan
from benchmarks.pages import commands, printed_at, run_parts, say, table
from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.types import F32, F64, I64, Mask
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.evaluation.scores import scores
from prc_cli.jobs.classify import classify
from prc_cli.jobs.evaluate import evaluate
from prc_cli.jobs.simulate import simulate
from prc_cli.simulation.scanners import SCANNERS
from prc_cli.simulation.settings import Kind, load_settings, open_simulation

FIRST_SEED = 301
"""Held-out seeds, not used to develop scenes, scanners and classifiers."""

URBAN_COLUMNS = ("noise", "ground", "vegetation", "building")
URBAN_ROWS = (*URBAN_COLUMNS, "other")
TABLE_I = {
    1.0: (
        (0.541, 0.286, 0.095, 0.077),
        (0.003, 0.964, 0.010, 0.023),
        (0.113, 0.084, 0.665, 0.137),
        (0.042, 0.222, 0.125, 0.611),
        (0.165, 0.592, 0.120, 0.123),
    ),
    0.1: (
        (0.614, 0.263, 0.058, 0.065),
        (0.159, 0.804, 0.014, 0.023),
        (0.373, 0.024, 0.467, 0.136),
        (0.169, 0.025, 0.119, 0.687),
        (0.222, 0.340, 0.153, 0.285),
    ),
}
"""Lehtola et al. (2019), Table I: zeta_p to recall values, reference in rows."""
STREETS = 5
STREET_M = 150.0
MORE_STREETS = 3
MORE_M = 100.0
SET_BACK_M = (0.0, 6.0, 12.0, 18.0)

FOREST_NAMES = ("noise", "ground", "stem")
TABLE_II = ((0.93, 0.02, 0.04), (0.65, 0.31, 0.03), (0.28, 0.18, 0.50))
"""The same paper, Table II, as printed."""
TABLE_II_COUNTS = np.array(
    [[15285576, 336704, 232019], [14741263, 6934955, 429704], [515205, 326183, 914452]],
    dtype=np.int64,
)
"""Counts of the same table; their rows differ from the printed recall values."""
RELAXED_STEM = (0.204, 0.413)
"""Recall and precision of stems with 1.0 m and 0.1 m, section IV-C."""
Reference = Literal["cylinders", "truth"]
REFERENCES: tuple[Reference, ...] = ("cylinders", "truth")
ZETAS = ((0.01, 0.01), (1.0, 0.1))
PLOTS = {"mixed": 3, "pine-heath": 1, "dense-spruce": 1}
WALK_M = 20.0

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
STEPS = (0.5, 0.75, 0.9, 0.95)
OAKLAND_DEG = (15.0, 123.0)
"""Angles from nadir that all strips hold [degrees].

Nearer to nadir ranges are below 2 m, and left out there.
"""
OAKLAND_SPEED_M_S = 8.3
"""Median way from line to line in the real strips is 0.16 m to 0.27 m, at 37.5 lines a second."""
OAKLAND_SCENES: dict[str, dict[str, Any]] = {
    "mixed": {"name": "mixed"},
    "terraces": {"name": "terraces"},
    "residential, 12 m farther back": {"name": "residential", "setback_m": 12.0},
    "suburb": {"name": "suburb"},
}
OAKLAND_LINES = 1500


def made(kind: Kind, folder: Path, reference: Reference = "truth", **options: Any) -> Path:
    """Simulate into a file, as the command does."""
    target = folder / f"{kind}.npz"
    settings = load_settings(kind, options=options)
    simulate(kind, target, settings, reference=reference, overwrite=True)
    return target


def compared(
    source: Path,
    config: LoadedConfig,
    mapping: str,
) -> ConfusionMatrix:
    """Classify a file and compare with its reference."""
    labels = source.with_name("labels.npy")
    classify(source, labels, config, overwrite=True)
    return evaluate(labels, source, mapping)


def pooled(parts: Iterable[ConfusionMatrix]) -> ConfusionMatrix:
    first, *others = parts
    for part in others:
        first = first + part
    return first


def recall_table(
    parts: list[ConfusionMatrix], rows: tuple[str, ...], columns: tuple[str, ...]
) -> list[list[str]]:
    """Shares of reference rows over all parts, smallest and largest of the parts in brackets."""
    shares = np.stack([shares_of(part, rows, columns) for part in parts])
    whole = shares_of(pooled(parts), rows, columns)
    low = np.nanmin(shares, axis=0)
    high = np.nanmax(shares, axis=0)
    return [
        [f"{whole[i, j]:.3f} ({low[i, j]:.2f}–{high[i, j]:.2f})" for j in range(len(columns))]
        for i in range(len(rows))
    ]


def shares_of(matrix: ConfusionMatrix, rows: tuple[str, ...], columns: tuple[str, ...]) -> F64:
    """Shares of reference rows, in the order of a paper's table."""
    row = [matrix.reference_names.index(name) for name in rows]
    column = [matrix.predicted_names.index(name) for name in columns]
    return matrix.row_shares()[np.ix_(row, column)]


def streets(folder: Path, n: int, **options: Any) -> dict[float, list[ConfusionMatrix]]:
    """Simulate and classify streets, and compare each; a list for every zeta_p of Table I."""
    matrices: dict[float, list[ConfusionMatrix]] = {zeta: [] for zeta in TABLE_I}
    for seed in range(FIRST_SEED, FIRST_SEED + n):
        source = made("street", folder, seed=seed, **options)
        for zeta, parts in matrices.items():
            support = {"prc": {"support": {"zeta_p": zeta}}}
            config = load_config(preset="prc-2019-urban", options=support)
            parts.append(compared(source, config, "lehtola_urban"))
    return matrices


def urban(folder: Path) -> None:
    """Drives down streets beside Table I."""
    matrices = streets(folder, STREETS, length_m=STREET_M)
    print("## Streets: Table I\n")
    n = pooled(matrices[1.0]).n_scored
    say(f"""{STREETS} mixed streets of {STREET_M:g} m, Photon 80 with the paper's mount, 30 km/h:
    {n:,} returns. Shares of all streets together, the smallest and the largest of a single street
    in brackets; the paper's figure in italics.""")
    commands(
        f"prc simulate street street.npz --length {STREET_M:g} --seed {FIRST_SEED}",
        "prc classify street.npz labels.npy --preset prc-2019-urban --set prc.support.zeta_p=0.1",
        "prc evaluate labels.npy street.npz --mapping lehtola_urban",
    )
    for zeta, published in TABLE_I.items():
        print_table_i(f"ζ_p = {zeta:g} m, A = 30, γ = 2", matrices[zeta], published)
    set_back(folder)


def print_table_i(
    title: str, parts: list[ConfusionMatrix], published: tuple[tuple[float, ...], ...]
) -> None:
    print(f"### {title}\n")
    rows = zip(URBAN_ROWS, recall_table(parts, URBAN_ROWS, URBAN_COLUMNS), published, strict=True)
    table(
        ("reference", *URBAN_COLUMNS),
        (
            (name, *(f"{a} *{b:.3f}*" for a, b in zip(cells, paper, strict=True)))
            for name, cells, paper in rows
        ),
    )
    matrix = pooled(parts)
    by_name = {item.name: item for item in scores(matrix).classes}
    cells = [f"{name} {by_name[name].precision:.3f}" for name in URBAN_COLUMNS]
    rows = matrix.counts.sum(axis=1) / matrix.n_scored
    shares = [f"{name} {rows[matrix.reference_names.index(name)]:.1%}" for name in URBAN_ROWS]
    print(f"\nPrecision: {', '.join(cells)}. Shares of the reference: {', '.join(shares)}.\n")


def set_back(folder: Path) -> None:
    """The same by the distance of the facades."""
    print("### Distance of the facades\n")
    say(f"""{MORE_STREETS} residential streets of {MORE_M:g} m, A = 30, γ = 2; recall, and the share
    of buildings that is taken for ground. Facades stand farther and farther behind the usual line
    (which is 8.8 m to 12.8 m from the middle of the road).""")
    commands("prc simulate street street.npz --scene residential --set scene.setback_m=12")
    rows = []
    for farther_m in SET_BACK_M:
        scene = {"name": "residential", "setback_m": farther_m}
        matrices = streets(folder, MORE_STREETS, length_m=MORE_M, scene=scene)
        for zeta, parts in matrices.items():
            cells = recall_table(parts, URBAN_ROWS, URBAN_COLUMNS)
            diagonal = [cells[i][i] for i in range(len(URBAN_COLUMNS))]
            rows.append((f"{farther_m:g} m farther", f"{zeta:g}", *diagonal, cells[3][1]))
    for zeta, published in TABLE_I.items():
        diagonal = [f"*{published[i][i]:.3f}*" for i in range(4)]
        rows.append(("*the paper*", f"{zeta:g}", *diagonal, f"*{published[3][1]:.3f}*"))
    table(("street", "ζ_p", *URBAN_COLUMNS, "building as ground"), rows)


def forest(folder: Path) -> None:
    """Walks through forests beside Table II."""
    matrices: dict[tuple[str, str, tuple[float, float]], list[ConfusionMatrix]] = {}
    for scene, n in PLOTS.items():
        for seed in range(FIRST_SEED, FIRST_SEED + n):
            options = {"seed": seed, "length_m": WALK_M, "scene": {"name": scene}}
            for kind in REFERENCES:
                source = made("forest", folder, kind, **options)
                for zetas in ZETAS:
                    support = {"prc": {"support": {"zeta_s": zetas[0], "zeta_p": zetas[1]}}}
                    config = load_config(preset="prc-2019-forest", options=support)
                    matrix = compared(source, config, "lehtola_forest")
                    matrices.setdefault((scene, kind, zetas), []).append(matrix)
    parts = matrices["mixed", "cylinders", ZETAS[0]]
    print("## Forest: Table II\n")
    say(f"""{PLOTS["mixed"]} mixed plots, {WALK_M:g} m walked in each, Focus3D 120 on a backpack:
    {pooled(parts).n_scored:,} returns. All plots together, the smallest and the largest of a single
    plot in brackets; the paper's figure in
    italics. Other vegetation counts as noise on both sides, as in the table.""")
    commands(
        f"prc simulate forest walk.npz --length {WALK_M:g} --seed {FIRST_SEED} --reference "
        "cylinders",
        "prc classify walk.npz labels.npy --preset prc-2019-forest --set prc.support.zeta_s=1 "
        "--set prc.support.zeta_p=0.1",
        "prc evaluate labels.npy walk.npz --mapping lehtola_forest",
    )
    for zetas in ZETAS:
        for kind in REFERENCES:
            paper = TABLE_II if zetas == ZETAS[0] and kind == "cylinders" else None
            print_table_ii(
                f"ζ_s = {zetas[0]:g} m, ζ_p = {zetas[1]:g} m, reference: {kind}",
                matrices["mixed", kind, zetas],
                paper,
            )
    print_stems(matrices)


def print_table_ii(
    title: str, parts: list[ConfusionMatrix], published: tuple[tuple[float, ...], ...] | None
) -> None:
    print(f"### {title}\n")
    names = ("noise (other)", "ground", "tree stem")
    rows = []
    for i, cells in enumerate(recall_table(parts, FOREST_NAMES, FOREST_NAMES)):
        beside = [""] * 3 if published is None else [f" *{share:.2f}*" for share in published[i]]
        rows.append((names[i], *(a + b for a, b in zip(cells, beside, strict=True))))
    table(("reference", *names), rows)


def print_stems(
    matrices: dict[tuple[str, str, tuple[float, float]], list[ConfusionMatrix]],
) -> None:
    print("### Stems and ground in every forest\n")
    print("Last column: share of the returns that is called noise or other.\n")
    scores_of = ("recall", "precision", "accuracy")
    names = [f"{kind} {score}" for kind in ("stem", "ground") for score in scores_of]
    paper = ConfusionMatrix(FOREST_NAMES, FOREST_NAMES, TABLE_II_COUNTS)
    rows: list[tuple[object, ...]] = [
        (scene, f"{zetas[0]:g}, {zetas[1]:g}", reference, *stem_cells(pooled(parts)))
        for (scene, reference, zetas), parts in matrices.items()
    ]
    rows.append(("*the paper, from its counts*", "0.01, 0.01", "cylinders", *stem_cells(paper)))
    rows.append(("*the paper*", "1, 0.1", "cylinders", *RELAXED_STEM, *[""] * 5))
    table(("forest", "ζ_s, ζ_p", "reference", *names, "noise and other"), rows)


def stem_cells(matrix: ConfusionMatrix) -> list[str]:
    by_name = {item.name: item for item in scores(matrix).classes}
    numbers = [
        n
        for key in ("stem", "ground")
        for n in (by_name[key].recall, by_name[key].precision, by_name[key].accuracy)
    ]
    called = matrix.counts.sum(axis=0)[matrix.predicted_names.index("noise")] / matrix.n_scored
    return [printed_at(number) for number in (*numbers, called)]


def statistics(range_m: F32) -> dict[str, float]:
    """Missing share, ranges, and steps between neighbours in a line and from line to line, (lines,
    M)."""
    numbers = {"missing": float(np.isnan(range_m).mean())}
    numbers |= {f"range {q:.0%} [m]": float(np.nanquantile(range_m, q)) for q in QUANTILES}
    for name, axis in (("in the line", 1), ("from line to line", 0)):
        step = np.abs(np.diff(range_m.astype(np.float64), axis=axis))
        numbers |= {f"step {name} {q:.0%} [m]": float(np.nanquantile(step, q)) for q in STEPS}
    return numbers


@dataclass(frozen=True, slots=True)
class Strip:
    """Ranges and classes of consecutive lines over the same angles."""

    range_m: F32
    """(lines, M) [m]"""
    reference: I64
    """(lines, M) codes of the reference."""


def strip_numbers(strip: Strip, mapping: str) -> dict[str, float]:
    """Everything that is compared of a push-broom scan."""
    numbers = statistics(strip.range_m)
    classes = load_mapping(mapping)
    names = classes.names("reference")
    index = classes.class_indices(strip.reference.ravel(), "reference").reshape(
        strip.reference.shape
    )
    for name in ("ground", "vegetation", "building"):
        strip_range_m = np.where(index == names.index(name), strip.range_m, np.nan)
        numbers[f"{name}: range 50% [m]"] = median(strip_range_m)
        for where, axis in (("in the line", 1), ("from line to line", 0)):
            numbers[f"{name}: step {where} 50% [m]"] = median(
                np.abs(np.diff(strip_range_m, axis=axis))
            )
    for name in ("ground", "vegetation", "building", "other", "noise"):
        share = (index == names.index(name)).sum() / (index >= 0).sum() if name in names else 0.0
        numbers[f"reference: {name}"] = float(share)
    return numbers


def median(numbers: NDArray[np.floating[Any]]) -> float:
    there = numbers[~np.isnan(numbers)]
    return float(np.median(there)) if there.size else np.nan


def real_strip(number: int) -> Strip:
    """Return a real strip over the angles that all have."""
    scan = oakland_scan(number)
    inside = _inside(scan.angle_rad)
    return Strip(scan.range_m[:, inside], scan.codes[:, inside])


def _inside(angle_rad: F64) -> Mask:
    angle_deg = np.rad2deg(angle_rad).round(6)
    return (angle_deg >= OAKLAND_DEG[0]) & (angle_deg <= OAKLAND_DEG[1])


def push_broom(folder: Path, scene: dict[str, Any]) -> Strip:
    """Return a simulated strip over the same angles."""
    source = made(
        "street",
        folder,
        seed=FIRST_SEED,
        lines=OAKLAND_LINES,
        trajectory={"speed_m_s": OAKLAND_SPEED_M_S, "stop_every_m": 0.0},
        scanner={"name": "sick-push-broom"},
        scene=scene,
    )
    inside = _inside(SCANNERS["sick-push-broom"].angle_rad())
    with np.load(source) as arrays:
        return Strip(arrays["range_m"][:, inside], arrays["class"][:, inside].astype(np.int64))


def oakland(folder: Path) -> None:
    """A push-broom scanner simulated over several kinds of street, beside three real strips."""
    columns = {f"strip {n}": strip_numbers(real_strip(n), "oakland") for n in (1, 2, 3)}
    for title, scene in OAKLAND_SCENES.items():
        columns[f"*{title}*"] = strip_numbers(push_broom(folder, scene), "prc")
    print("## Beside the real push-broom scans (Oakland)\n")
    say(f"""Three real strips of a campus, and {OAKLAND_LINES} simulated lines (in italics) of
    several kinds of street, 22 cm apart, over the same angles from nadir ({OAKLAND_DEG[0]:g}° to
    {OAKLAND_DEG[1]:g}°). The streets are no models of the strips. Steps are differences of ranges
    between neighbours that both have a return, by class where both have that class.""")
    commands(
        f"prc simulate street strip.npz --scanner sick-push-broom --lines {OAKLAND_LINES} \\\n"
        f"      --set trajectory.speed_m_s={OAKLAND_SPEED_M_S:.3g} "
        f"--set trajectory.stop_every_m=0 --seed {FIRST_SEED}",
    )
    rows = []
    for name in next(iter(columns.values())):
        form = "{:.2f}" if name.endswith("[m]") else "{:.1%}"
        cells = (form.format(column[name]) for column in columns.values())
        rows.append((name, *("-" if "nan" in cell else cell for cell in cells)))
    table(("", *columns), rows)


def speed(_: Path) -> None:
    """Print the speed of a simulation: scene, casting, sensor, nothing written."""
    print("## Speed\n")
    say("""Scene, casting and sensor, nothing written, a world that was not seen before, after one
    run that is not counted.""")
    rows = []
    for kind, scanner, lines in (
        ("street", "photon-80", 1920),
        ("street", "profiler-1mhz", 800),
        ("forest", "focus3d-120", 1536),
    ):
        options = {"lines": lines, "scanner": {"name": scanner}}
        settings = load_settings(kind, options=options)  # type: ignore[arg-type]
        for threads in (1, 2):
            for _ in range(2):
                start = time.perf_counter()
                busy = time.process_time()
                for _ in open_simulation(kind, settings, threads=threads).scan.simulated():  # type: ignore[arg-type]
                    pass
                wall = time.perf_counter() - start
                cpu = time.process_time() - busy
            shots = lines * settings.scanner.points_per_line / 1e6
            name = f"{kind}, `{scanner}`"
            rows.append((name, threads, f"{shots / wall:.2f}", f"{shots / cpu:.2f}"))
    table(("simulation", "threads", "million shots a second", "a second of one core"), rows)


PARTS: dict[str, Callable[[Path], None]] = {
    "urban": urban,
    "forest": forest,
    "oakland": oakland,
    "speed": speed,
}


if __name__ == "__main__":
    run_parts(__doc__, "Simulated scans: figures", "simulated", PARTS)
