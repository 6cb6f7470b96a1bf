"""Time per shot of PRC against the size of the stream, M, k and the share of noise, and in the
worst cases.

python -m benchmarks.scaling [PICTURE.svg]

Time of one core (one thread), the best of several runs. The street is simulated; noise replaces a
share of its shots by uniform random ranges from 1 to 100 m."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.stages import classify_all, street
from prc_cli.core.types import F32, Mask
from prc_cli.kernels import load_kernels
from prc_cli.methods.prc.pipeline import PrcParams

LINES = 594
WIDTH = 2154
K = 99
ROUNDS = 8
Points = list[tuple[float, float]]


def best_times(jobs: dict[str, tuple[F32, PrcParams]]) -> dict[str, float]:
    """Return the best time per shot of every stream [ns].

    Each round runs all, so that disturbances affect all.
    """
    best = dict.fromkeys(jobs, float("inf"))
    for _ in range(ROUNDS):
        for name, (ranges, params) in jobs.items():
            start = time.process_time()
            classify_all(ranges, params, 1)
            best[name] = min(best[name], (time.process_time() - start) / ranges.size * 1e9)
    return best


def short(number: float) -> str:
    """Write a number in four digits."""
    return f"{float(f'{number:.4g}'):,g}"


def parameters(k: int = K) -> PrcParams:
    """Published urban parameters with other block lengths, the area in proportion."""
    return PrcParams.model_validate({"lines_per_block": k, "surfaces": {"area": "auto"}})


def add_noise(ranges: F32, share: float) -> F32:
    """Replace a share of the shots by random ranges."""
    rng = np.random.default_rng(1)
    noise = rng.uniform(1, 100, ranges.shape).astype(np.float32)
    return np.where(rng.random(ranges.shape) < share, noise, ranges)


def checkerboard(n_lines: int, n_columns: int) -> Mask:
    """Every other pixel: the most components possible."""
    board: Mask = (np.arange(n_lines)[:, None] + np.arange(n_columns)) % 2 == 0
    return board


def spiral(
    n_lines: int,
    n_columns: int,
    width: int,
    gap: int,
) -> Mask:
    """One long spiral component, whose parts are joined late."""
    image = np.zeros((n_lines, n_columns), dtype=bool)
    top = 0
    left = 0
    bottom = n_lines
    right = n_columns
    step = width + gap
    start = 0
    while bottom - top > 2 * step and right - left > 2 * step:
        image[top : top + width, start:right] = True
        image[top:bottom, right - width : right] = True
        image[bottom - width : bottom, left:right] = True
        image[top + step : bottom, left : left + width] = True
        start = left
        top = top + step
        left = left + step
        bottom = bottom - step
        right = right - step
    return image


def worst_cases() -> dict[str, F32]:
    """Worst-case streams."""
    shape = (LINES, WIDTH)
    wound = np.tile(spiral(K, WIDTH, width=4, gap=3), (LINES // K, 1))
    streets = street(*shape)
    return {
        "street": streets,
        "nothing but noise": add_noise(streets, 1.0),
        "no return at all": np.full(shape, np.nan, np.float32),
        "one flat wall": np.full(shape, 20, np.float32),
        "checkerboard of two ranges": np.where(checkerboard(*shape), 10, 20).astype(np.float32),
        "one spiral a block": np.where(wound, 20, np.nan).astype(np.float32),
        "stripes of three shots": np.where(np.arange(WIDTH) // 3 % 2, 10, 10.5).astype(np.float32)
        + np.zeros(shape, np.float32),
    }


def measure() -> tuple[dict[str, Points], dict[str, float]]:
    """Measure the curves and the worst cases."""
    base = street(LINES, WIDTH)
    usual = parameters()
    cases: dict[str, list[tuple[float, F32, PrcParams]]] = {
        "shots in the stream [million]": [
            (n * base.size / 1e6, np.tile(base, (n, 1)), usual) for n in (1, 2, 4, 8, 16, 32)
        ],
        "M, shots in a line": [
            (m, street(max(K, 1_200_000 // m), m), usual)
            for m in (250, 500, 1000, 2154, 4270, 10_000)
        ],
        "k, lines in a block": [
            (k, np.tile(base, (4, 1)), parameters(k)) for k in (10, 25, 50, 99, 255, 999)
        ],
        "share of noise": [
            (share, add_noise(base, share), usual) for share in (0, 0.1, 0.25, 0.5, 0.75, 1)
        ],
    }
    jobs = {name: (ranges, usual) for name, ranges in worst_cases().items()}
    jobs |= {
        f"{title} {x}": (ranges, params)
        for title, case in cases.items()
        for x, ranges, params in case
    }
    best = best_times(jobs)
    curves = {
        title: [(x, best[f"{title} {x}"]) for x, _, _ in case] for title, case in cases.items()
    }
    return curves, {name: best[name] for name in worst_cases()}


def draw(curves: dict[str, Points], worst: dict[str, float]) -> str:
    """Draw the curves and the worst cases side by side as SVG."""
    width = 250
    height = 190
    left = 40
    base = 150
    top = 1.15 * max([y for points in curves.values() for _, y in points] + list(worst.values()))
    parts = []
    for panel, (title, points) in enumerate(curves.items()):
        scale = (lambda x: x) if title.startswith("share") else np.log10
        low, high = (float(scale(points[i][0])) for i in (0, -1))
        xs = [
            panel * width + left + 10 + (float(scale(x)) - low) / (high - low) * (width - left - 40)
            for x, _ in points
        ]
        ys = [base - y / top * 120 for _, y in points]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(xs, ys, strict=True))
        parts.append(f'<polyline points="{line}" fill="none" stroke="#1f6fb2" stroke-width="2"/>')
        for x, y, (value, step) in zip(xs, ys, points, strict=True):
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="#1f6fb2"/>')
            parts.append(
                f'<text x="{x:.1f}" y="{y - 7:.1f}" text-anchor="middle">{step:.1f}</text>'
            )
            parts.append(
                f'<text x="{x:.1f}" y="{base + 14}" text-anchor="middle">{short(value)}</text>'
            )
        parts.append(
            f'<text x="{panel * width + width / 2 + 10}" y="{height - 8}" '
            f'text-anchor="middle">{title}</text>'
        )
    for panel in range(len(curves)):
        x = panel * width + left
        parts.append(f'<path d="M{x},20V{base}H{x + width - 50}" fill="none" stroke="#888"/>')
    for row, (name, step) in enumerate(worst.items()):
        y = height + 18 + 18 * row
        parts.append(f'<text x="200" y="{y + 9}" text-anchor="end">{name}</text>')
        parts.append(
            f'<rect x="208" y="{y}" width="{step / top * 700:.1f}" height="11" fill="#1f6fb2"/>'
        )
        parts.append(f'<text x="{214 + step / top * 700:.1f}" y="{y + 9}">{step:.1f}</text>')
    size = f'viewBox="0 0 {width * len(curves)} {height + 30 + 18 * len(worst)}"'
    style = (
        '<rect width="100%" height="100%" fill="#fff"/><text x="6" y="13">ns a shot, one '
        "core</text>"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif" '
        'font-size="10" fill="#222">'
        f"{style}{''.join(parts)}</svg>\n"
    )


def main() -> None:
    """Print the tables; draw them where a file is named."""
    load_kernels(frozenset({"prc.components", "prc.support", "prc.surfaces"}))
    curves, worst = measure()
    for title, points in curves.items():
        print(
            f"\n| {title} | "
            + " | ".join(short(x) for x, _ in points)
            + " |\n"
            + "|---" * (len(points) + 1)
            + "|"
        )
        print("| ns a shot | " + " | ".join(f"{y:.1f}" for _, y in points) + " |")
    print("\n| stream | ns a shot |\n|---|---|")
    for name, step in worst.items():
        print(f"| {name} | {step:.1f} |")
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(draw(curves, worst), encoding="utf-8")


if __name__ == "__main__":
    main()
