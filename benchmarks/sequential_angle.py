"""Figures of the sequential-angle classifier.

Simulated static scans beside the paper's Table 1, and the strips of Oakland.

    python -m benchmarks.sequential_angle > docs/figures/sequential_angle.md    # minutes
    python -m benchmarks.sequential_angle oakland                               # some of the parts

Reads ../shared/data or $PRC_DATA for the real scans. Each table names the commands that give the
same figures."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.pages import run_parts
from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.blocks import join
from prc_cli.core.classes import Label, Surface
from prc_cli.core.config import merge
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import U8
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.reports import as_markdown
from prc_cli.evaluation.scores import scores
from prc_cli.jobs.classify import classify
from prc_cli.jobs.evaluate import evaluate
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.methods.sequential_angle.angles import angle_differences, signed_angles
from prc_cli.methods.sequential_angle.coarse import car_surface, coarse, dense_vegetation
from prc_cli.methods.sequential_angle.lines import split_sides, vertical_lines
from prc_cli.methods.sequential_angle.thresholds import (
    ChordThresholds,
    CoarseThresholds,
    MarkovThresholds,
    SequentialAngleThresholds,
)
from prc_cli.simulation.settings import load_settings, open_simulation
from prc_cli.simulation.world import PROPERTIES, Material, Property

CLASSES = {
    "kitti": {
        Label.GROUND: (9, 10, 11, 12, 17),
        Label.BUILDING: (13, 14),
        Label.VEGETATION: (15, 16),
    },
    "nuscenes": {Label.GROUND: (0, 1), Label.BUILDING: (2,), Label.VEGETATION: (4,)},
}
"""Reference codes of the views; others are not judged."""
ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("PRC_DATA", ROOT.parent / "shared" / "data"))
SICK = ROOT / "sample_configs" / "sick_push_broom.toml"
KITTI = ROOT / "sample_configs" / "kitti_frame.toml"

PAPER = {
    "vegetation": (0.900, 0.789),
    "vertical": (0.851, 0.980),
    "car": (0.867, 0.962),
    "horizontal": (0.976, 0.631),
}
"""Recall and precision, Stamos et al. (2012), Table 1."""

FIRST_SEED = 901
"""Held-out streets, not used to develop simulator and parameters.

1 to 16, 701 to 706 and 801 to 811 were.
"""
SEEDS = 11
"""Streets of the first rows: as many as scans in the paper."""
TURNS = 4
"""Repetitions of the scan for the rate of all stages."""
MORE_SEEDS = 4
"""Streets of the other rows."""
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


FINE: dict[str, Any] = {"scanner": {"name": "scanstation2-1mm"}}
"""The noise that Stamos et al. (2012) give in footnote 3; the other scanner has 5 mm."""
VARIED: dict[str, Any] = {"scene": {"name": "varied"}}
SIDEWALK: dict[str, Any] = {"station": {"left_m": -5.2, "clearance_m": 1.0}}

SETTINGS: dict[str, Setting] = {
    "scanner on the road": Setting(),
    "scanner on the road, 1 mm": Setting(FINE, range_noise_m=0.001),
    "varied, 5 mm": Setting(VARIED),
    "varied, 1 mm": Setting(merge(VARIED, FINE), range_noise_m=0.001),
    "scanner on the sidewalk": Setting(SIDEWALK),
    "varied, on the sidewalk, 5 mm": Setting(merge(VARIED, SIDEWALK)),
    "varied, on the sidewalk, 1 mm": Setting(
        merge(merge(VARIED, SIDEWALK), FINE), range_noise_m=0.001
    ),
    "steps of 0.06°": Setting({"scanner": {"points_per_line": 2085}}),
    "steps of 0.23°": Setting({"scanner": {"points_per_line": 544}}),
    "10 mm noise, told 5 mm": Setting({"scanner": {"noise_m": 0.01}}),
    "10 mm noise, told so": Setting({"scanner": {"noise_m": 0.01}}, range_noise_m=0.01),
    "published constants, 1 mm": Setting(FINE, preset="street-scan-published"),
    "published constants, varied, 1 mm": Setting(
        merge(VARIED, FINE), preset="street-scan-published"
    ),
    "published constants": Setting(preset="street-scan-published"),
}
ON_ALL_SEEDS = 4
"""So many rows are of :data:`SEEDS` streets."""

NOISE_M = ChordThresholds().range_noise_m
"""Default ranging noise for the classifier [m]."""
THRESHOLDS = SequentialAngleThresholds().at_noise()


HEADERLESS = "car_cloud401.csv"
"""File without header, with blanks between numbers."""


def street_scan(
    path: Path | None = None,
    preset: str = "street-scan",
    range_noise_m: float | None = None,
    **inputs: Any,
) -> LoadedConfig:
    """A preset of the classifier, for a scanner with other noise, for inputs that need options."""
    options: dict[str, Any] = {"input": inputs} if inputs else {}
    if range_noise_m is not None:
        options["sequential_angle"] = {"angles": {"range_noise_m": range_noise_m}}
    return load_config(path, preset=preset, options=options)


def write_scan(folder: Path, seed: int, *options: dict[str, Any]) -> tuple[Path, Path]:
    """Simulate a static scan into a file, and the class codes of its reference."""
    source = folder / "scan.npz"
    reference = folder / "reference.npy"
    settings = load_settings("street-scan", options=merged({"seed": seed}, *options))
    simulate("street-scan", source, settings, beside=Beside(labels=reference), overwrite=True)
    return source, reference


def merged(*options: dict[str, Any]) -> dict[str, Any]:
    """Merge nested tables."""
    options_so: dict[str, Any] = {}
    for option in options:
        options_so = merge(options_so, option)
    return options_so


def scan_of(seed: int, *options: dict[str, Any]) -> tuple[ScanBlock, U8]:
    """Return a whole simulated static scan with its reference labels."""
    settings = load_settings("street-scan", options=merged({"seed": seed}, *options))
    items = list(open_simulation("street-scan", settings).scan.labelled_blocks())
    return join([item.block for item in items]), np.concatenate([item.labels for item in items])


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
    matrices: dict[str, ConfusionMatrix] = {}
    fine: ConfusionMatrix | None = None
    for number, (title, setting) in enumerate(SETTINGS.items()):
        first = not sums
        for seed in range(
            FIRST_SEED, FIRST_SEED + (SEEDS if number < ON_ALL_SEEDS else MORE_SEEDS)
        ):
            source, reference = write_scan(folder, seed, COARSE, setting.options)
            labels = folder / "labels.npy"
            config = street_scan(preset=setting.preset, range_noise_m=setting.range_noise_m)
            classify(source, labels, config, overwrite=True)
            matrix = evaluate(labels, reference, "street_scan")
            sums[title] = sums[title] + matrix if title in sums else matrix
            if first:
                matrices[f"street {seed}"] = matrix
                counts = evaluate(labels, reference, "sequential_angle")
                fine = counts if fine is None else fine + counts
    print("## Simulated static street scans\n")
    print(
        f"{SEEDS} streets in the first {ON_ALL_SEEDS} rows, {MORE_SEEDS} in the others. No "
        "parameter was chosen on"
    )
    print("them, and they were run once.\n")
    print(
        "The classifier is told the noise; that of the paper's scanner is about 1 mm "
        "(footnote 3). Rows that name no"
    )
    print("noise have 5 mm. Last row:")
    print(
        "Stamos et al. (2012), Table 1, 11 real scans. Ground counts as horizontal, curbs "
        "as vertical.\n"
    )
    print(
        f"```console\n$ prc simulate street-scan scan.npz --seed {FIRST_SEED} --set "
        "scanner.azimuth_step_deg=0.46"
    )
    print("$ prc classify scan.npz labels.npy --preset street-scan")
    print("$ prc evaluate labels.npy scan.npz --mapping street_scan --format markdown\n```\n")
    print_scores(sums, names)
    cells = " | ".join(f"{recall:.3f} | {precision:.3f}" for recall, precision in PAPER.values())
    print(f"| *the paper* | {cells} | 0.876 |\n\n### Street by street, scanner on the road\n")
    print_scores(matrices, names)
    print("\n### Confusion, scanner on the road\n")
    print(as_markdown(next(iter(sums.values()))))
    if fine is not None:
        print("### The same with every class by itself\n\n" + as_markdown(fine))


PRINTED: dict[str, dict[str, Any]] = {
    "the preset": {},
    "angles.chord_depth_sigmas = 0": {"angles": {"chord_depth_sigmas": 0}},
    "ground.height_points = 0": {"ground": {"height_points": 0}},
    "ground.renew_every = false": {"ground": {"renew_every": False}},
    "ground.resume = false": {"ground": {"resume": False}},
    "ground.bridge = 0": {"ground": {"bridge": 0}},
    "ground.resume = false, ground.bridge = 0": {"ground": {"resume": False, "bridge": 0}},
    "ground.jump_m = 1000": {"ground": {"jump_m": 1000}},
    "curb.under_sigmas = 0": {"curb": {"under_sigmas": 0}},
    "car.dividers.under_sigmas = 0": {"car": {"dividers": {"under_sigmas": 0}}},
    "car.dividers.vertical_break_m = 10000": {"car": {"dividers": {"vertical_break_m": 10_000}}},
    "car.fourier.window = 0": {"car": {"fourier": {"window": 0}}},
    "car.fourier.longest = 0, car.most_foliage = 1": {
        "car": {"fourier": {"longest": 0}, "most_foliage": 1}
    },
    "the same, car.fourier.window = 0": {
        "car": {"fourier": {"longest": 0, "window": 0}, "most_foliage": 1}
    },
    "car.ground_layer_m = 0": {"car": {"ground_layer_m": 0}},
    "angles.least_chord_m = 0": {"angles": {"least_chord_m": 0}},
    "coarse.windows.share = 1": {"coarse": {"windows": {"share": 1}}},
    "coarse.windows.wall_extent_m = 0": {"coarse": {"windows": {"wall_extent_m": 0}}},
    "both": {"coarse": {"windows": {"share": 1, "wall_extent_m": 0}}},
    "curb.min_height_m = 0": {"curb": {"min_height_m": 0}},
    "curb.stands_below_m = 1000": {"curb": {"stands_below_m": 1000}},
    "both curb rules off": {"curb": {"min_height_m": 0, "stands_below_m": 1000}},
    "car.dividers.straight_extent_m = 0": {"car": {"dividers": {"straight_extent_m": 0}}},
    "car.dividers.vertical_top_m = 0": {"car": {"dividers": {"vertical_top_m": 0}}},
    "car.dividers.from_start = false": {"car": {"dividers": {"from_start": False}}},
    "car.dividers.return_points = 0": {"car": {"dividers": {"return_points": 0}}},
    "car.dividers.flat_step_m = 0": {"car": {"dividers": {"flat_step_m": 0}}},
    "car.fourier.longest = 32": {"car": {"fourier": {"longest": 32}}},
    "car.dividers.tall_m = 0": {"car": {"dividers": {"tall_m": 0}}},
    "car.dividers.glass_m = 0": {"car": {"dividers": {"glass_m": 0}}},
    "car.dividers.flat_above_m = 1000": {"car": {"dividers": {"flat_above_m": 1000}}},
    "car.dividers.vertical_open = false": {"car": {"dividers": {"vertical_open": False}}},
    "car.dividers.relief_m = 0": {"car": {"dividers": {"relief_m": 0}}},
    "ground.roof_m = 1000": {"ground": {"roof_m": 1000}},
    "ground.follow_m = 0": {"ground": {"follow_m": 0}},
    "ground.start_heights = 50": {"ground": {"start_heights": 50}},
    "with the trigger": {"car": {"suspicious": {"enabled": True}}},
    "no high verticals": {"car": {"high_verticals": {"height_m": 1000}}},
    "no curbs": {"curb": {"min_height_m": 100}},
}
"""Settings that set one reading of the paper back to the printed text, or switch it off."""

VEGETATION: dict[str, tuple[int, dict[str, Any]]] = {
    "street 1": (1, {}),
    "street 2": (2, {}),
    "street 3, beams every 0.23°": (3, {"scanner": {"points_per_line": 544}}),
    "street 4": (4, {}),
    "street 5, 10 mm of noise, told so": (5, {"scanner": {"noise_m": 0.01}}),
}
"""Scans for the tests for vegetation."""


def readings(folder: Path) -> None:
    """Effect of our readings of the paper, one at a time."""
    names = ("ground", "curb", "car", "vegetation", "vertical")
    matrices: dict[str, ConfusionMatrix] = {}
    for seed in range(FIRST_SEED, FIRST_SEED + MORE_SEEDS):
        source, reference = write_scan(folder, seed, COARSE, VARIED, SIDEWALK if seed % 2 else {})
        for title, options in PRINTED.items():
            labels = folder / "labels.npy"
            config = load_config(preset="street-scan", options={"sequential_angle": options})
            classify(source, labels, config, overwrite=True)
            matrix = evaluate(labels, reference, "sequential_angle")
            matrices[title] = matrices[title] + matrix if title in matrices else matrix
    print(
        f"## Readings, one at a time\n\n{MORE_SEEDS} of the varied streets above, 5 mm, "
        "every other one from the"
    )
    print("sidewalk, every class by itself. The last rows switch a stage of the paper on or off.\n")
    print(
        "```console\n$ prc classify scan.npz labels.npy --preset street-scan --set "
        "sequential_angle.ground.bridge=0"
    )
    print("$ prc evaluate labels.npy scan.npz --mapping sequential_angle\n```\n")
    print_scores(matrices, names)
    print()


def vegetation(folder: Path) -> None:
    """The two tests for vegetation alone, and variants of them."""
    stay = ((0.9, 0.05, 0.05), (0.05, 0.9, 0.05), (0.05, 0.05, 0.9))
    uniform = (1 / 3, 1 / 3, 1 / 3)
    slow = MarkovThresholds(h0=stay, sigmas_deg=(20.0, 20.0, 20.0), initial_h0=uniform)
    print(
        "## The tests for vegetation\n\nLines 0.92° apart. F1 of T over all returns but "
        "those of cars and mixed ones;"
    )
    print("T' by the share of foliage, of cars and of all else that it takes.\n")
    print(
        "| scan | T | T, kept with .9, σ 20° | T, printed chords | T' foliage | T' cars | "
        "T' else | script's end |"
    )
    print("|---|" + "---:|" * 7)
    for title, (seed, options) in VEGETATION.items():
        block, label = scan_of(seed, {"scanner": {"azimuth_step_deg": 0.92}}, options)
        beam = block.beam_rad
        assert beam is not None
        lines = vertical_lines(block.range_m, block.xyz_m, beam, split_sides(beam), 300.0)
        angles = ChordThresholds(
            range_noise_m=0.01 if options.get("scanner", {}).get("noise_m") else NOISE_M
        )
        literal = angles._replace(min_chord_sigmas=0.0, least_chord_m=0.0, chord_depth_sigmas=0.0)
        signed = signed_angles(lines, angles.at_noise()).signed_deg
        foliage = label == Label.VEGETATION
        judged = ~np.isin(label, (Label.MISSING, Label.NOISE, Label.CAR))

        def f1(
            signed_deg: Any,
            params: MarkovThresholds,
            judged: Any = judged,
            foliage: Any = foliage,
            lines: Any = lines,
        ) -> str:
            said = (
                coarse(signed_deg, lines, CoarseThresholds(vegetation=params)) == Surface.VEGETATION
            )
            agreed = np.count_nonzero(said & foliage & judged)
            either = np.count_nonzero(said & judged) + np.count_nonzero(foliage & judged)
            return f"{2 * agreed / either:.3f}"

        def dense(params: MarkovThresholds, signed: Any = signed, lines: Any = lines) -> Any:
            flags = dense_vegetation(angle_differences(signed), params)
            return (
                car_surface(signed, flags, lines, CoarseThresholds().surfaces) == Surface.VEGETATION
            )

        usual = dense(THRESHOLDS.dense_vegetation)
        script = dense(
            THRESHOLDS.dense_vegetation._replace(sprt=True, backdate=False, initial_h0=uniform)
        )
        shares = [
            usual[foliage],
            usual[label == Label.CAR],
            usual[judged & ~foliage],
            script[foliage],
        ]
        printed = signed_angles(lines, literal.at_noise()).signed_deg
        cells = [f1(signed, MarkovThresholds()), f1(signed, slow), f1(printed, MarkovThresholds())]
        print(
            f"| {title} | {' | '.join([*cells, *(f'{np.mean(share):.3f}' for share in shares)])} |"
        )
    print()


PAPER_SHARES = (0.160, 0.656, 0.057, 0.127)
"""Shares of the classes of :data:`PAPER` in its 7.3 million points, from the rows of its Table
1."""
DARK = 1e-9
"""Reflectance of what gives no return."""
WINDOWS: dict[str, tuple[Material, ...]] = {
    "as simulated": (),
    "windows of houses give no return": (Material.GLASS,),
    "windows of cars give no return": (Material.CAR_GLASS,),
    "no window gives a return": (Material.GLASS, Material.CAR_GLASS),
}


def windows(folder: Path) -> None:
    """What windows and the mixture of classes make of the published constants."""
    print(
        "## The published constants and windows\n\nStreets 1 to 4, which were used in "
        "development, 1 mm. A shot at a"
    )
    print(
        "window returns from the room behind it, or not at all. In the second rows the "
        "classes have the shares"
    )
    print(
        "that they have in the paper: "
        + ", ".join(f"{name} {s}" for name, s in zip(PAPER, PAPER_SHARES, strict=True))
    )
    print("(precision depends on them).\n")
    names = tuple(PAPER)
    print(
        "| | "
        + " | ".join(f"{name} recall | precision" for name in names)
        + " |\n|---|"
        + "---:|" * 8
    )
    usual = dict(PROPERTIES)
    config = street_scan(preset="street-scan-published", range_noise_m=0.001)
    for title, dark in WINDOWS.items():
        PROPERTIES.update(
            {property_name: Property(usual[property_name].label, DARK) for property_name in dark}
        )
        total = np.zeros((4, 4))
        for seed in range(1, 5):
            source, reference = write_scan(folder, seed, COARSE, FINE)
            classify(source, folder / "labels.npy", config, overwrite=True)
            matrix = evaluate(folder / "labels.npy", reference, "street_scan")
            rows = [matrix.reference_names.index(name) for name in names]
            columns = [matrix.predicted_names.index(name) for name in names]
            total += matrix.counts[np.ix_(rows, columns)]
        PROPERTIES.update(usual)
        mixed = total * (np.array(PAPER_SHARES) / total.sum(axis=1))[:, None]
        for what, counts in ((title, total), (f"{title}, shares of the paper", mixed)):
            right = np.diag(counts)
            cells = np.stack([right / counts.sum(axis=1), right / counts.sum(axis=0)], axis=1)
            print(f"| {what} | " + " | ".join(f"{number:.3f}" for number in cells.ravel()) + " |")
    print(f"| *the paper* | {' | '.join(f'{r:.3f} | {p:.3f}' for r, p in PAPER.values())} |\n")


def oakland(folder: Path) -> None:
    """The strips of a push-broom scanner, beside PRC."""
    runs = {
        "sequential-angle, 1 cm noise": street_scan(nadir=0.0, range_noise_m=0.01),
        "PRC, published": load_config(preset="prc-2019-urban"),
        "PRC, for this sensor": load_config(SICK),
    }
    print("## Oakland strips, beside PRC\n")
    print(
        "Ground counts as horizontal, PRC's buildings as vertical. PRC has no cars.\n\n```console"
    )
    print("$ prc classify oakland_1.csv.gz labels.npy --preset street-scan --set input.nadir=0 \\")
    print("      --set sequential_angle.angles.range_noise_m=0.01")
    print("$ prc classify oakland_1.csv.gz labels.npy --preset prc-2019-urban")
    print("$ prc classify oakland_1.csv.gz labels.npy --config sample_configs/sick_push_broom.toml")
    print(
        "$ prc evaluate labels.npy oakland_1.csv.gz --mapping street_scan_oakland --format "
        "markdown\n```\n"
    )
    for strip in (1, 2, 3):
        source = DATA / "oakland" / f"oakland_{strip}.csv.gz"
        labels = folder / "oakland.npy"
        rows = {}
        for title, config in runs.items():
            classify(source, labels, config, overwrite=True)
            rows[title] = evaluate(labels, source, "street_scan_oakland")
        print(f"### Strip {strip}\n")
        print_scores(rows, tuple(PAPER))
        print("\n" + as_markdown(rows["sequential-angle, 1 cm noise"]))


PARTS: dict[str, Callable[[Path], None]] = {
    "simulated": simulated,
    "readings": readings,
    "vegetation": vegetation,
    "windows": windows,
    "oakland": oakland,
}


if __name__ == "__main__":
    run_parts(__doc__, "Sequential-angle: figures", "sequential_angle", PARTS)
