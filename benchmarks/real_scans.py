"""Classify and evaluate the real scans, and print the page figures/real_scans.md.

    # reads ../shared/data or $PRC_DATA
    python -m benchmarks.real_scans > figures/real_scans.md

Each table names the commands that give the same figures one by one.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import laspy
import numpy as np

from benchmarks.pages import duration, heading
from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes
from prc_cli.evaluation.reports import as_markdown
from prc_cli.jobs.classify import classify
from prc_cli.jobs.evaluate import evaluate
from prc_cli.jobs.info import inspect
from tests.profiler import (
    jakarto,
    jakarto_input,
    placed,
    scanner_positions,
    steps_apart,
    write_trajectory,
)

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("PRC_DATA", ROOT.parent / "shared" / "data"))
SICK = ROOT / "sample_configs" / "sick_push_broom.toml"


def oakland(folder: Path) -> None:
    """Three labelled strips with the published and the adapted parameters."""
    for title, config, option in (
        (
            "published urban parameters",
            load_config(preset="prc-2019-urban"),
            "--preset prc-2019-urban",
        ),
        (
            "parameters for this sensor",
            load_config(SICK),
            "--config sample_configs/sick_push_broom.toml",
        ),
    ):
        print(f"## Oakland, {title}\n")
        for strip in (1, 2, 3):
            name = f"oakland_{strip}"
            source = DATA / "oakland" / f"{name}.csv.gz"
            labels = folder / f"{name}.npy"
            classify(source, labels, config, overwrite=True)
            print(f"### Strip {strip}\n")
            print(f"```console\n$ prc classify {source.name} {name}.npy {option}")
            print(f"$ prc evaluate {name}.npy {source.name} --mapping oakland -o {name}.md\n```\n")
            print(as_markdown(evaluate(labels, source, "oakland")))


def forest(folder: Path) -> None:
    """The unlabelled park scan: class shares."""
    source = DATA / "forest" / "tls_park.npz"
    codes = ClassCodes().names()
    print(
        "## Park, forest preset\n\n```console\n$ prc classify tls_park.npz tls_park.npy "
        "--preset prc-2019-forest\n```\n"
    )
    print("| zeta_s, zeta_p | noise | ground | stem | vegetation |\n|---|---|---|---|---|")
    for zeta_s, zeta_p in ((0.01, 0.01), (1.0, 0.1)):
        options = {"prc": {"support": {"zeta_s": zeta_s, "zeta_p": zeta_p}}}
        classify(
            source,
            folder / "park.npy",
            load_config(preset="prc-2019-forest", options=options),
            overwrite=True,
        )
        labels = np.load(folder / "park.npy")
        counts = np.bincount(labels[labels > 0], minlength=256)
        names = {name: counts[code] / counts.sum() for code, name in codes.items()}
        shares = " | ".join(
            f"{names[name]:.1%}" for name in ("noise", "ground", "stem", "vegetation")
        )
        print(f"| {zeta_s} m, {zeta_p} m | {shares} |")


def profiler(folder: Path) -> None:
    """The 360° profiler sample: cells from time stamps against cells recovered by fitting, ranges
    by trajectory."""
    source, recovered = jakarto(DATA)
    las = laspy.read(source)
    write_trajectory(folder / "drive.csv", scanner_positions(las, recovered))
    inputs = jakarto_input(folder / "drive.csv")
    line, column, range_m, n_cells = placed(
        source, load_config(options={"input": inputs}), len(las)
    )
    steps = steps_apart(line, column, recovered)
    print("## Profiler sample\n\n```console")
    lines = inputs["lines"]
    columns = inputs["columns"]
    print(f"$ prc classify jakarto_0.02s.las out.las --lines {lines} --columns {columns} \\")
    print(f"      --range trajectory:drive.csv -M {inputs['points_per_line']}\n```\n")
    print("| | |\n|---|---|")
    print(f"| records | {len(las):,} in {n_cells:,} cells, {1 - len(las) / n_cells:.1%} missing |")
    print(f"| same line as recovered | {(line == recovered['line']).mean():.2%} |")
    for distance in (0, 1, 2, 5):
        what = "same cell" if not distance else f"at most {distance} shots beside it"
        print(f"| {what} | {(steps <= distance).mean():.1%} |")
    difference = np.abs(range_m - recovered["range_m"])
    print(
        "| range difference, median and 99th percentile | "
        f"{np.nanmedian(difference) * 1000:.1f} mm, ",
        end="",
    )
    print(f"{np.nanpercentile(difference, 99) * 1000:.1f} mm |\n")


def strip(folder: Path) -> None:
    """The airborne strip: lines by the wrap of the scan angle, checked by the times."""
    source = DATA / "las" / "als_strip_labelled.laz"
    setup = inspect(source, load_config())
    assert setup.facts is not None
    las = laspy.read(source)
    time_s = np.asarray(las.gps_time)[661:]
    print("## Airborne strip\n\n```console\n$ prc info als_strip_labelled.laz\n```\n")
    print("| | |\n|---|---|")
    print(f"| lines by the wrap of the scan angle | {setup.facts.n_lines} |")
    print(f"| line frequency from the times of the lines | {setup.facts.line_hz:.3f} Hz |")
    print(
        "| line periods between the first and the last record after the stray start | "
        f"{np.ptp(time_s) * 150:.1f} |"
    )
    degrees = np.asarray(las.scan_angle) * 0.006
    print(
        "| jumps back of the scan angle by more than 2° | "
        f"{np.count_nonzero(np.diff(degrees) > 2)} |\n"
    )


def main() -> None:
    """Print all tables."""
    print(heading("Tables of real scans", "real_scans"))
    with tempfile.TemporaryDirectory() as name:
        profiler(Path(name))
        strip(Path(name))
        oakland(Path(name))
        forest(Path(name))
    print(duration())


if __name__ == "__main__":
    main()
