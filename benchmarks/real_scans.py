"""Classify and evaluate the real scans, and print the page figures/real_scans.md.

    # reads ../shared/data or $PRC_DATA
    python -m benchmarks.real_scans > figures/real_scans.md

Each table names the commands that give the same figures one by one.
"""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np

from benchmarks.pages import DATA, ROOT, commands, run_parts, table
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

SICK = ROOT / "sample_configs" / "sick_push_broom.toml"
FOREST_NAMES = ("noise", "ground", "stem", "vegetation")


def oakland(folder: Path) -> None:
    """Three labelled strips with the published and the adapted parameters."""
    published = load_config(preset="prc-2019-urban")
    sensor = "--config sample_configs/sick_push_broom.toml"
    for title, config, option in (
        ("published urban parameters", published, "--preset prc-2019-urban"),
        ("parameters for this sensor", load_config(SICK), sensor),
    ):
        print(f"## Oakland, {title}\n")
        for strip in (1, 2, 3):
            name = f"oakland_{strip}"
            source = DATA / "oakland" / f"{name}.csv.gz"
            labels = folder / f"{name}.npy"
            classify(source, labels, config, overwrite=True)
            print(f"### Strip {strip}\n")
            commands(
                f"prc classify {source.name} {name}.npy {option}",
                f"prc evaluate {name}.npy {source.name} --mapping oakland -o {name}.md",
            )
            print(as_markdown(evaluate(labels, source, "oakland")))


def forest(folder: Path) -> None:
    """The unlabelled park scan: class shares."""
    source = DATA / "forest" / "tls_park.npz"
    codes = ClassCodes().names()
    print("## Park, forest preset\n")
    commands("prc classify tls_park.npz tls_park.npy --preset prc-2019-forest")
    rows = []
    for zeta_s, zeta_p in ((0.01, 0.01), (1.0, 0.1)):
        options = {"prc": {"support": {"zeta_s": zeta_s, "zeta_p": zeta_p}}}
        config = load_config(preset="prc-2019-forest", options=options)
        classify(source, folder / "park.npy", config, overwrite=True)
        labels = np.load(folder / "park.npy")
        counts = np.bincount(labels[labels > 0], minlength=256)
        names = {name: counts[code] / counts.sum() for code, name in codes.items()}
        rows.append((f"{zeta_s} m, {zeta_p} m", *(f"{names[name]:.1%}" for name in FOREST_NAMES)))
    table(("zeta_s, zeta_p", *FOREST_NAMES), rows)


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
    print("## Profiler sample\n")
    rules = (
        f"--lines {inputs['lines']} --columns {inputs['columns']} -M {inputs['points_per_line']}"
    )
    commands(f"prc classify jakarto_0.02s.las out.las {rules} --range trajectory:drive.csv")
    rows = [
        ("records", f"{len(las):,} in {n_cells:,} cells, {1 - len(las) / n_cells:.1%} missing"),
        ("same line as recovered", f"{(line == recovered['line']).mean():.2%}"),
    ]
    for distance in (0, 1, 2, 5):
        what = "same cell" if not distance else f"at most {distance} shots beside it"
        rows.append((what, f"{(steps <= distance).mean():.1%}"))
    off_mm = 1000 * np.abs(range_m - recovered["range_m"])
    difference = f"{np.nanmedian(off_mm):.1f} mm, {np.nanpercentile(off_mm, 99):.1f} mm"
    table(("", ""), [*rows, ("range difference, median and 99th percentile", difference)])


def strip(folder: Path) -> None:
    """The airborne strip: lines by the wrap of the scan angle, checked by the times."""
    source = DATA / "las" / "als_strip_labelled.laz"
    setup = inspect(source, load_config())
    assert setup.facts is not None
    las = laspy.read(source)
    time_s = np.asarray(las.gps_time)[661:]
    degrees = np.asarray(las.scan_angle) * 0.006
    print("## Airborne strip\n")
    commands("prc info als_strip_labelled.laz")
    periods = "line periods between the first and the last record after the stray start"
    jumps = np.count_nonzero(np.diff(degrees) > 2)
    rows = [
        ("lines by the wrap of the scan angle", setup.facts.n_lines),
        ("line frequency from the times of the lines", f"{setup.facts.line_hz:.3f} Hz"),
        (periods, f"{np.ptp(time_s) * 150:.1f}"),
        ("jumps back of the scan angle by more than 2°", jumps),
    ]
    table(("", ""), rows)


PARTS = {"profiler": profiler, "strip": strip, "oakland": oakland, "forest": forest}


if __name__ == "__main__":
    run_parts(__doc__, "Tables of real scans", "real_scans", PARTS)
