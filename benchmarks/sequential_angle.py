"""Figures of the sequential-angle classifier.

Simulated static scans beside the paper's Table 1, and our readings one at a time.

    python -m benchmarks.sequential_angle > figures/sequential_angle.md    # minutes
    python -m benchmarks.sequential_angle readings                              # one of the parts

Each table names the commands that give the same figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import Any

from benchmarks.pages import run_parts
from prc_cli.config import LoadedConfig, load_config, parse_assignment
from prc_cli.core.config import merge
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.reports import as_markdown
from prc_cli.evaluation.scores import scores
from prc_cli.jobs.classify import classify
from prc_cli.jobs.evaluate import evaluate
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import load_settings

PAPER = {
    "vegetation": (0.900, 0.789),
    "vertical": (0.851, 0.980),
    "car": (0.867, 0.962),
    "horizontal": (0.976, 0.631),
}
"""Recall and precision, Stamos et al. (2012), Table 1."""

FIRST_SEED = 901
SEEDS = 11
"""Streets of two rows: as many as scans in the paper."""
NEW_SEED = 1401
"""Streets that chose nothing: neither simulator, nor constants, nor readings (901 to 911, 1201 to
1214 and 1301 to 1316 did)."""
MORE_SEEDS = 4
"""Streets of the other rows, and of the readings."""
COARSE = {"scanner": {"azimuth_step_deg": 0.46}}
"""Every fourth line: as many different streets in a quarter of the time."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A row of the table of simulated scans."""

    options: dict[str, Any] = field(default_factory=dict)
    """Settings of the simulator."""
    preset: str = "street-scan"
    range_noise_m: float | None = None
    """Ranging noise for the classifier; default: that of the preset."""
    first_seed: int = FIRST_SEED
    seeds: int = MORE_SEEDS


FINE: dict[str, Any] = {"scanner": {"name": "scanstation2-1mm"}}
"""The noise that Stamos et al. (2012) give in footnote 3; the other scanner has 5 mm."""
VARIED: dict[str, Any] = {"scene": {"name": "varied"}}

SETTINGS: dict[str, Setting] = {
    "scanner on the road": Setting(seeds=SEEDS),
    "scanner on the road, new streets": Setting(first_seed=NEW_SEED),
    "varied": Setting(VARIED),
    "varied, new streets": Setting(VARIED, first_seed=NEW_SEED),
    "varied, on the sidewalk": Setting(
        merge(VARIED, {"station": {"left_m": -5.2, "clearance_m": 1.0}})
    ),
    "1 mm": Setting(FINE, range_noise_m=0.001),
    "10 mm, told so": Setting({"scanner": {"noise_m": 0.01}}, range_noise_m=0.01),
    "published constants": Setting(preset="street-scan-published", seeds=SEEDS),
    "published constants, 1 mm": Setting(FINE, preset="street-scan-published"),
}


def street_scan(preset: str = "street-scan", range_noise_m: float | None = None) -> LoadedConfig:
    """A preset of the classifier, for a scanner with other noise."""
    options: dict[str, Any] = {}
    if range_noise_m is not None:
        options["sequential_angle"] = {"angles": {"range_noise_m": range_noise_m}}
    return load_config(preset=preset, options=options)


def write_scan(folder: Path, seed: int, *options: dict[str, Any]) -> tuple[Path, Path]:
    """Simulate a static scan into a file, and the class codes of its reference."""
    source = folder / "scan.npz"
    reference = folder / "reference.npy"
    settings = load_settings("street-scan", options=reduce(merge, options, {"seed": seed}))
    simulate("street-scan", source, settings, beside=Beside(labels=reference), overwrite=True)
    return source, reference


def print_scores(rows: dict[str, ConfusionMatrix], names: tuple[str, ...]) -> None:
    """Recall and precision of every class, one row per run."""
    print("| | " + " | ".join(f"{name} recall | precision" for name in names) + " | all |")
    print("|---|" + "---:|---:|" * len(names) + "---:|")
    for title, matrix in rows.items():
        by_class = scores(matrix)
        by_name = {item.name: item for item in by_class.classes}
        cells = [
            f"{number:.3f}"
            for name in names
            for number in (by_name[name].recall, by_name[name].precision)
        ]
        print(f"| {title} | {' | '.join(cells)} | {by_class.accuracy:.3f} |".replace("nan", "-"))


def simulated(folder: Path) -> None:
    """Simulated static scans beside Table 1."""
    names = tuple(PAPER)
    sums: dict[str, ConfusionMatrix] = {}
    for title, setting in SETTINGS.items():
        config = street_scan(setting.preset, setting.range_noise_m)
        for seed in range(setting.first_seed, setting.first_seed + setting.seeds):
            source, reference = write_scan(folder, seed, COARSE, setting.options)
            labels = folder / "labels.npy"
            classify(source, labels, config, overwrite=True)
            matrix = evaluate(labels, reference, "street_scan")
            sums[title] = sums[title] + matrix if title in sums else matrix
    print(
        f"""## Simulated static street scans

{SEEDS} streets in the rows "scanner on the road" and "published constants", as many as scans in
the paper, {MORE_SEEDS} in the others. New streets chose nothing: readings were chosen on some of
the others. Noise is 5 mm where the row does not say; that of the paper's scanner is about 1 mm
(footnote 3). Last row: Stamos et al. (2012), Table 1, 11 real scans. Ground counts as horizontal,
curbs as vertical.

```console
$ prc simulate street-scan scan.npz --seed {FIRST_SEED} --set scanner.azimuth_step_deg=0.46
$ prc classify scan.npz labels.npy --preset street-scan
$ prc evaluate labels.npy scan.npz --mapping street_scan -o scores.md
```
"""
    )
    print_scores(sums, names)
    cells = " | ".join(f"{recall:.3f} | {precision:.3f}" for recall, precision in PAPER.values())
    print(f"| *the paper* | {cells} | 0.876 |\n\n### Confusion, scanner on the road\n")
    print(as_markdown(next(iter(sums.values()))))


READINGS: dict[str, dict[str, Any]] = {
    "the preset": {},
    "coarse.vegetation of the script": {
        "coarse": {
            "vegetation": {
                "sigmas_deg": [2, 2, 12],
                "h0": [[1, 0, 0], [0, 0.9, 0.1], [0, 0.1, 0.9]],
                "backdate": False,
            }
        }
    },
    "coarse.surfaces of the script": {
        "coarse": {"surfaces": {"drift_horizontal_deg": 30, "threshold_horizontal_deg": 15}}
    },
    **{
        text: parse_assignment(text)
        for text in """\
angles.min_chord_sigmas = 0
ground.start_heights = 50
ground.height_points = 0
curb.min_height_m = 0
car.most_foliage = 1
car.ground_layer_m = 0
car.dividers.change_chord_m = 0
car.dividers.return_points = 0
car.dividers.from_start = false
car.dividers.tall_m = 0
car.dividers.flat_step_m = 0
car.dividers.vertical_top_m = 0
car.dividers.straight_extent_m = 0
car.fourier.longest = 0""".splitlines()
    },
}
"""Settings that set one reading of ours back to what is published."""


def readings(folder: Path) -> None:
    """Effect of our readings of the paper, one at a time."""
    kinds = {"road": (FIRST_SEED, {}), "varied": (NEW_SEED, VARIED)}
    rows: dict[str, list[str]] = {title: [] for title in READINGS}
    for first_seed, options in kinds.values():
        coarse_sums: dict[str, ConfusionMatrix] = {}
        sums: dict[str, ConfusionMatrix] = {}
        for seed in range(first_seed, first_seed + MORE_SEEDS):
            source, reference = write_scan(folder, seed, COARSE, options)
            for title, reading in READINGS.items():
                labels = folder / "labels.npy"
                config = load_config(preset="street-scan", options={"sequential_angle": reading})
                classify(source, labels, config, overwrite=True)
                for mapping, total in (("street_scan", coarse_sums), ("sequential_angle", sums)):
                    matrix = evaluate(labels, reference, mapping)
                    total[title] = total[title] + matrix if title in total else matrix
        for title, cells in rows.items():
            f1 = {item.name: item.f1 for item in scores(coarse_sums[title]).classes}
            recall = {item.name: item.recall for item in scores(sums[title]).classes}
            numbers = (scores(coarse_sums[title]).accuracy, f1["car"], recall["ground"])
            cells += [f"{number:.3f}" for number in numbers]
    print(
        f"""## Readings, one at a time

{MORE_SEEDS} streets of each kind, the scanner on the road; varied ones are new. One reading a row
is set back to what is published.

```console
$ prc classify scan.npz labels.npy --preset street-scan \\
      --set sequential_angle.ground.height_points=0
$ prc evaluate labels.npy scan.npz --mapping sequential_angle
```
"""
    )
    heads = [f"{kind}: {what}" for kind in kinds for what in ("all", "car F1", "ground recall")]
    print("| | " + " | ".join(heads) + " |\n|---|" + "---:|" * len(heads))
    for title, cells in rows.items():
        print(f"| {title} | {' | '.join(cells)} |")
    print()


PARTS: dict[str, Callable[[Path], None]] = {"simulated": simulated, "readings": readings}


if __name__ == "__main__":
    run_parts(__doc__, "Sequential-angle: figures", "sequential_angle", PARTS)
