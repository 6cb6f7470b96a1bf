"""The step of the angles measured from the ranges: how exact it is, and how exact it must be.

    # reads ../shared/data or $PRC_DATA; 5 minutes
    python -m benchmarks.angles > docs/figures/angles.md
    python -m benchmarks.angles docs/images/angles.svg          # the picture of docs/fused.md

Seeds 9311-9350, on which nothing was chosen; the limits of the estimator were chosen on 9401-9618
and the real scans."""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from benchmarks.contest_data import DATA, GAP_DOWN, Scan, Simulated, oakland, park, simulated
from benchmarks.contest_judge import Verdict, judge
from benchmarks.trust_scans import riegl
from benchmarks.user import in_process
from prc_cli.config import load_config
from prc_cli.core.stream import ExtraReturns, StreamInfo
from prc_cli.core.types import F32, F64
from prc_cli.jobs.classify import open_stream
from prc_cli.streams.angle_step import BENT, CERTAIN, HOP, curvatures, measure_step
from prc_cli.streams.beams import SAMPLE_LINES, SPREAD
from prc_cli.streams.evidence.figures import Seen, Window
from prc_cli.streams.evidence.geometry import check_angle_step

MOST_LINES = SPREAD * SAMPLE_LINES
"""Lines that ``prc classify`` measures the step on."""
CLASSES = ("ground", "building", "vegetation", "noise", "stem")
DOWN45: dict[str, Any] = {**GAP_DOWN, "slant_deg": 45.0}
STREETS = (
    Simulated("residential, gap up", 9311, 40, "residential"),
    Simulated("terraces, gap of 50° down", 9312, 40, "terraces", mount=GAP_DOWN),
    Simulated("suburb, gap up, 45° slanted", 9313, 40, "suburb", mount={"slant_deg": 45.0}),
    Simulated("boulevard, gap of 50° down, 45° slanted", 9314, 40, "boulevard", mount=DOWN45),
    Simulated("mixed, 5 % noise", 9315, 40, "mixed", noise=0.05),
    Simulated(
        "terraces, whole turn, 45° slanted",
        9316,
        8,
        "terraces",
        "profiler-1mhz",
        mount={"slant_deg": 45.0},
    ),
    Simulated("boulevard, whole turn", 9317, 8, "boulevard", "profiler-1mhz"),
)
PUSH_BROOMS = (
    Simulated("residential, push-broom", 9321, 100, "residential", "sick-push-broom"),
    Simulated(
        "suburb, push-broom that looks down",
        9322,
        100,
        "suburb",
        "sick-push-broom",
        mount={"centre_deg": 0.0, "height_m": 2.8},
    ),
    Simulated(
        "terraces, push-broom of 0.47°",
        9323,
        100,
        "terraces",
        "sick-push-broom",
        mount={"points_per_line": 385},
    ),
)
FORESTS = (
    Simulated("mixed forest", 9331, 6, "mixed", "focus3d-120", kind="forest"),
    Simulated("pine heath", 9332, 6, "pine-heath", "focus3d-120", kind="forest"),
    Simulated("dense spruce", 9333, 6, "dense-spruce", "focus3d-120", kind="forest"),
)
WRONG = (0.0, 0.01, -0.01, 0.02, -0.02, 0.05, -0.05, 0.1, -0.1, 0.2, -0.2)
"""Errors of the step that are told, as shares."""


def made(spec: Simulated) -> Scan:
    """Simulate a scan, first returns alone."""
    scan = simulated(spec)
    nothing = np.empty(0, np.int64)
    return replace(
        scan, angle_rad=np.unwrap(scan.angle_rad), extra=ExtraReturns.none(), extra_codes=nothing
    )


def step_of(angle_rad: F64) -> float:
    """Return the middle step of the angles of columns [rad]."""
    return abs(float(np.median(np.diff(np.unwrap(angle_rad)))))


def real() -> Iterator[tuple[str, F32, float]]:
    """Yield the real scans of even columns: name, ranges and step [rad]."""
    for strip in (1, 2, 3):
        scan = oakland(strip)
        yield f"{scan.name}, SICK", scan.range_m, step_of(scan.angle_rad)
    for scan, name in ((riegl(), "RIEGL, driving"), (park(), "park, RIEGL on a tripod")):
        yield name, scan.range_m, step_of(scan.angle_rad)
    theta = np.unwrap(
        np.fromfile(DATA / "echopulse" / "pulse-float32-theta.bin", np.float32).astype(np.float64)
    )
    n_echoes = np.fromfile(DATA / "echopulse" / "pulse-uint8-n_echo.bin", np.uint8).astype(np.int64)
    echo = np.fromfile(DATA / "echopulse" / "echo-float32-range.bin", np.float32)
    first = np.minimum(np.cumsum(n_echoes) - n_echoes, len(echo) - 1)
    step = abs(theta[-1] - theta[0]) / (len(theta) - 1)
    m = round(2 * math.pi / step)
    pulses = np.where(n_echoes > 0, echo[first], np.float32(np.nan))
    yield "RIEGL, standing (echopulse)", pulses[: len(pulses) // m * m].reshape(-1, m), step
    with np.load(DATA / "profiler" / "jakarto_0.02s_recovered.npz") as recovered:
        lines = np.full((int(recovered["line"].max()) + 1, 5099), np.nan, np.float32)
        lines[recovered["line"], recovered["column"]] = recovered["range_m"]
    yield "Jakarto, four lines", lines, 2 * math.pi / 5099
    for path, topic in (
        ("cartographer/b0_short.bag", "vertical_laser_2d"),
        ("cartographer/b0_short.bag", "horizontal_laser_2d"),
        ("ros/sick_lms1xx_ros1.bag", "/sick_lms_1xx/scan"),
    ):
        stream = open_stream(
            DATA / path, load_config(preset="urban", options={"input": {"topic": topic}})
        )
        blocks = list(stream.blocks())
        angle_rad = stream.info.angle_rad if blocks[0].angle_rad is None else blocks[0].angle_rad
        assert angle_rad is not None
        yield (
            f"{Path(path).name}, {topic}",
            np.concatenate([block.range_m for block in blocks]),
            step_of(angle_rad),
        )


def steps() -> None:
    """Print the step of every scan beside the true one."""
    print(
        "## The step\n\n| scan | lines | M | true step | measured | uncertainty | error | pieces |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    every = [(spec.name, made(spec)) for spec in (*STREETS, *PUSH_BROOMS, *FORESTS)]
    for name, range_m, step in (
        *real(),
        *((name, scan.range_m, step_of(scan.angle_rad)) for name, scan in every),
    ):
        measured_step = measure_step(range_m[:MOST_LINES])
        shape = f"| {name} | {len(range_m)} | {range_m.shape[1]} | {math.degrees(step):.4f}° |"
        if measured_step is None:
            print(f"{shape} none | | | |")
            continue
        usual = f" ({measured_step.usual})" if measured_step.usual else ""
        degrees = math.degrees(measured_step.step_rad)
        cells = f"{degrees:.4f}°{usual} | {measured_step.off:.1%}"
        print(
            f"{shape} {cells} | {measured_step.step_rad / step - 1:+.2%} | "
            f"{measured_step.n_pieces} |"
        )
    print()


def classified(scan: Scan, *keys: str) -> tuple[Verdict | None, str]:
    """Classify ranges and M, with what else is told.

    Return the verdict and the names of the doubts.
    """
    n, m = scan.range_m.shape
    with tempfile.TemporaryDirectory() as name:
        dump = Path(name) / "ranges.bin"
        labels = Path(name) / "labels.npy"
        scan.range_m.astype("<f4").tofile(dump)
        options = [part for key in keys for part in ("--set", f"input.{key}")]
        code, said = in_process(["classify", str(dump), str(labels), "-M", str(m), "-q", *options])
        doubts = [line.split(": ")[1] for line in said.splitlines() if line.startswith("warning: ")]
        if not labels.exists():
            return None, f"refused ({code})"
        codes = np.load(labels).reshape(n, m)
    return judge(scan, codes, np.empty(0, np.uint8)), ", ".join(doubts)


def angles(scan: Scan, error: float = 0.0, *, with_down: bool = True) -> tuple[str, ...]:
    """Return the angles as a user tells them, those of the scan or too large by a share."""
    degrees = np.rad2deg(scan.angle_rad)
    step = float((degrees[-1] - degrees[0]) / (len(degrees) - 1))
    down = (f"nadir={-float(degrees[0])!r}",) if with_down else ()
    return ("angle_start=0", f"angle_step={step * (1 + error)!r}", *down)


def f1_cells(verdicts: Iterable[Verdict | None], classes: Iterable[str]) -> str:
    """Return the mean F1 of every class and of all."""
    by_scan = [verdict.f1() for verdict in verdicts if verdict is not None]
    cells = []
    for name in (*classes, ""):
        values = [
            verdict_f1[name] if name else float(np.mean(list(verdict_f1.values())))
            for verdict_f1 in by_scan
            if not name or name in verdict_f1
        ]
        cells.append(f"{np.mean(values):.3f}" if values else "-")
    return " | ".join(cells)


def beside_true(title: str, named: Iterable[tuple[str, Scan]]) -> None:
    """Print F1 with ranges and M alone, beside those with true angles."""
    print(
        f"## {title}\n\n| scan | angles | step off | uncertainty | {' | '.join(CLASSES)} | "
        "mean | doubts |"
    )
    print("|---|---|---:|---:|" + "---:|" * (len(CLASSES) + 1) + "---|")
    for name, scan in named:
        step = measure_step(scan.range_m[:MOST_LINES])
        off = (
            "none | "
            if step is None
            else f"{step.step_rad / step_of(scan.angle_rad) - 1:+.2%} | {step.off:.1%}"
        )
        for what, keys in ((f"measured | {off}", ()), ("true | |", angles(scan))):
            verdict, doubts = classified(scan, *keys)
            print(f"| {name} | {what} | {f1_cells([verdict], CLASSES)} | {doubts} |", flush=True)
    print()


def wrong_steps() -> None:
    """Print F1 with steps that are wrong, told without straight down."""
    print(
        "## How exact it must be\n\nThe step is told wrong, with `input.angle_start` and "
        "`input.angle_step`; straight"
    )
    print("down is found from the ground.\n")
    print(
        f"| scans | error | {' | '.join(CLASSES)} | mean | doubted | refused |\n|---|---:|"
        + "---:|" * 8
    )
    for name, specs in (
        ("streets", STREETS[:4]),
        ("push-brooms", PUSH_BROOMS[:2]),
        ("forests", FORESTS[:2]),
    ):
        scans = [made(spec) for spec in specs]
        for error in WRONG:
            verdicts = [classified(scan, *angles(scan, error, with_down=False)) for scan in scans]
            refused = sum(verdict is None for verdict, _ in verdicts)
            doubted = sum(
                verdict is not None and "angle-step" in said for verdict, said in verdicts
            )
            cells = f1_cells((verdict for verdict, _ in verdicts), CLASSES)
            print(f"| {name} | {error:+.0%} | {cells} | {doubted} | {refused} |", flush=True)
    print()


def told_steps() -> None:
    """Print what the check of the step says of angles that are told, right and wrong."""
    print(
        "## The check of what is told\n\nThe first and the last 250 lines of all scans "
        "above, angles times a factor.\n"
    )
    print("| angles times | says nothing | fine | doubtful | refused |\n|---:|---:|---:|---:|---:|")
    every = [(range_m, step) for _, range_m, step in real()]
    every += [
        (scan.range_m, step_of(scan.angle_rad))
        for scan in map(made, (*STREETS, *PUSH_BROOMS, *FORESTS))
    ]
    for factor in (1.0, 0.95, 0.9, 0.5, 1.1, 2.0):
        said = []
        for range_m, step in every:
            m = range_m.shape[1]
            beam_rad = step * factor * (np.arange(m) - m / 2)
            if factor * step * m > 2.001 * math.pi:
                continue
            for lines in (range_m[:250], range_m[-250:]):
                info = StreamInfo("", "array", m, None, None)
                finding = check_angle_step(Seen(info, 0, (Window(0, lines),), beam_rad=beam_rad))
                said.append(-1 if finding is None else int(finding.verdict))
        print(
            f"| {factor:g} | {' | '.join(str(said.count(k)) for k in (-1, 0, 1, 2))} |", flush=True
        )
    print()


def conditions() -> None:
    """Print tables of noise, M and the number of lines."""
    street = STREETS[0]
    broom = PUSH_BROOMS[0]
    forest = FORESTS[0]
    noisy = [
        (
            f"{spec.name}, {1000 * noise:g} mm",
            made(replace(spec, seed=9341, mount={**spec.mount, "noise_m": noise})),
        )
        for spec in (street, broom, forest)
        for noise in (0.001, 0.003, 0.01, 0.03)
    ]
    beside_true("Noise of the ranges", noisy)
    columns = (
        (f"M = {m}", made(replace(street, seed=9342, mount={"points_per_line": m})))
        for m in (100, 200, 400, 1000, 2154, 5000)
    )
    beside_true("Columns", columns)
    whole = made(replace(street, seed=9343))
    lines = (
        (f"{n} lines", replace(whole, range_m=whole.range_m[:n], codes=whole.codes[:n]))
        for n in (16, 32, 64, 128)
    )
    beside_true("Lines", lines)


def picture() -> str:
    """Draw u over the columns of a line with the windows that a quadratic fits, and what all lines
    say, as SVG."""
    scan = made(STREETS[0])
    inverse = 1.0 / scan.range_m.astype(np.float64)
    line = inverse[len(inverse) // 2]
    step = step_of(scan.angle_rad)
    window = 79
    per_column = 360 / len(line)
    per_u = 320
    base = 220
    parts = []

    def places(first: int, values: F64) -> list[str]:
        return [
            f"{44 + (first + k) * per_column:.1f},{base - u * per_u:.1f}"
            for k, u in enumerate(values.tolist())
        ]

    dots = " ".join(
        f"M{place}h.1" for place, u in zip(places(0, line), line, strict=True) if u < 0.6
    )
    parts.append(f'<path d="{dots}" stroke="#aaa" stroke-width="1.6" stroke-linecap="round"/>')
    x = np.arange(window) - window // 2
    for first in range(0, len(line) - window, window // HOP):
        piece = line[first : first + window]
        error = curvatures(piece[None], BENT)[1] if np.isfinite(piece).all() else np.empty(0)
        if len(error) and error[0] < CERTAIN * step**2:
            way = " ".join(places(first, np.polyval(np.polyfit(x, piece, 2), x).astype(np.float64)))
            parts.append(
                f'<polyline points="{way}" fill="none" stroke="#d55e00" stroke-width="2"/>'
            )
    pieces = sliding_window_view(inverse, window, axis=1)[:, :: window // HOP].reshape(-1, window)
    curvature, error = curvatures(pieces[np.isfinite(pieces).all(axis=1)], BENT)
    shares = curvature[error < CERTAIN * step**2] / step**2
    counts = np.histogram(shares, 60, (0.4, 1.6))[0]
    for k, high in enumerate((counts * 190 / counts.max()).tolist()):
        parts.append(
            f'<rect x="{470 + 6 * k}" y="{base - high:.1f}" width="5.5" '
            f'height="{high:.1f}" fill="#1f6fb2"/>'
        )
    texts = [
        (50, 24, "u = 1 / r [1/m]"),
        (120, 250, "column of one line; fits of 79 columns"),
        (700, 40, "grey: the true step"),
    ]
    texts += [(540, 250, "-u″/u of all lines, over the step squared")]
    texts += [(462 + 150 * k, 236, f"{0.4 + 0.5 * k:.1f}") for k in (0, 1, 2)]
    texts += [(20, base + 4 - round(per_u * u), f"{u:g}") for u in (0.0, 0.2, 0.4, 0.6)]
    parts += [f'<text x="{left}" y="{top}">{text}</text>' for left, top, text in texts]
    axes = (
        f'<path d="M44,20V{base}H410M470,20V{base}H835M650,{base}V20" fill="none" stroke="#888"/>'
    )
    head = (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 850 260" '
        'font-family="sans-serif" font-size="11"'
    )
    return (
        f'{head} fill="#222"><rect width="100%" height="100%" '
        f'fill="#fff"/>{axes}{"".join(parts)}</svg>\n'
    )


def main() -> None:
    """Print all tables, or draw the picture into the file that is named."""
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(picture(), encoding="utf-8")
        return
    print(
        "<!-- written by python -m benchmarks.angles; do not edit -->\n\n# Tables of "
        "measured angles\n"
    )
    print("```console\n$ python -m benchmarks.angles > docs/figures/angles.md\n```\n")
    print(
        "Simulated scans of seeds 9311 to 9350, first returns; `prc classify ranges.bin "
        "labels.npy -M M`. F1.\n"
    )
    steps()
    beside_true(
        "Ranges and M alone",
        ((spec.name, made(spec)) for spec in (*STREETS, *PUSH_BROOMS, *FORESTS)),
    )
    wrong_steps()
    told_steps()
    conditions()


if __name__ == "__main__":
    main()
