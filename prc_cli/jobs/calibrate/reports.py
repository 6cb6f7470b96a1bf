"""A calibration as a configuration file, as Markdown and as a figure (SVG)."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterator, Sequence

from prc_cli.config import to_toml
from prc_cli.core.brief import finite
from prc_cli.core.pages import render_page
from prc_cli.core.types import F64
from prc_cli.core.version import __version__
from prc_cli.jobs.calibrate import Calibration
from prc_cli.jobs.calibrate.sensor import SensorEstimate

_MARK = "prc calibrate: "
_WIDTH = 112


def as_json(calibration: Calibration) -> str:
    """Return everything as JSON, undefined figures as null."""
    return json.dumps(finite(calibration.as_dict()), indent=2, allow_nan=False)


def as_toml(calibration: Calibration) -> str:
    """Return the calibrated configuration as TOML, with the reason of every examined value."""
    lines = [
        f"# Calibrated by prc {__version__} on {_plain(calibration.path)}",
        *(f"#   {name}: {value}" for name, value in sensor_rows(calibration.sensor)),
    ]
    lines += [f"# note: {_plain(note)}" for note in calibration.notes]
    lines += [f"# doubt: {_plain(doubt.sentence())}" for doubt in calibration.doubts]
    lines.append("")
    for line in to_toml(calibration.config).splitlines():
        setting, mark, reason = line.partition(f"  # from: {_MARK}")
        if mark:
            lines += [
                f"# {part}" for part in textwrap.wrap(f"calibrated: {_plain(reason)}", _WIDTH)
            ]
        lines.append(setting if mark else line)
    return "\n".join(lines) + "\n"


def sensor_rows(sensor: SensorEstimate) -> Iterator[tuple[str, str]]:
    """Yield the measurements, in words and with units."""
    ranges = sensor.range_quantiles_m
    yield "shots", f"{sensor.n_shots:,} in {sensor.n_lines:,} lines of {sensor.points_per_line:,}"
    yield "missing", f"{sensor.missing_share:.1%}"
    yield (
        "range",
        f"median {ranges['50%']:.3g} m, 5 % to 95 %: {ranges['5%']:.3g} to {ranges['95%']:.3g} m",
    )
    if sensor.sigma_m is None or sensor.sigma_per_m is None:
        yield "noise", "not measured: no flat stretch"
    else:
        growth = (
            f", and {1000 * sensor.sigma_per_m:.2g} mm per metre of range"
            if sensor.sigma_per_m
            else ""
        )
        yield "noise", f"standard deviation about a plane {1000 * sensor.sigma_m:.2g} mm{growth}"
    step = (
        "not measured"
        if sensor.step_rad is None
        else f"{math.degrees(sensor.step_rad):.3g} degrees"
    )
    yield "angular step", f"{step}, from: {sensor.step_source}"
    yield (
        "rounding",
        "none found"
        if sensor.rounding_m is None
        else f"ranges are multiples of {sensor.rounding_m:g} m",
    )
    if sensor.in_line_m is not None:
        yield "next shot", f"median range difference {sensor.in_line_m:.2g} m"
    if sensor.across_lines_m is not None:
        yield (
            "next line",
            f"median range difference {sensor.across_lines_m:.2g} m in the same column",
        )
    if sensor.line_hz:
        yield (
            "line spacing",
            f"{1 / sensor.line_hz:.3g} m for every m/s of speed "
            f"({sensor.line_hz:.4g} lines a second)",
        )
    else:
        yield "line spacing", "unknown: the stream holds neither times nor speed"


def advice_rows(calibration: Calibration) -> Iterator[tuple[str, str, str, str]]:
    """Yield key, value before, value and reason."""
    for item in calibration.advice:
        yield item.key, _value(item.before), _value(item.value), item.reason


def curve_rows(calibration: Calibration) -> Iterator[tuple[str, str, str, str]]:
    """Yield threshold and shares over zeta_p, zeta_s and d_c (background), three per decade."""
    curves = calibration.curves
    targets = {float(f"{factor}e{power}") for power in range(-3, 2) for factor in (1, 2, 5)} | {
        100.0
    }
    # thresholds are a tenth of a decade apart: 2 and 5 get the nearest ones
    for target in sorted(targets):
        cells = []
        for grid, shares in (
            (curves.zetas_p, curves.over_zeta_p(1.0)),
            (curves.zetas_s, curves.over_zeta_s(1.0)),
            (curves.lengths, curves.background_share()),
        ):
            index = min(range(len(grid)), key=lambda i: abs(math.log(grid[i] / target)))
            cells.append(f"{shares[index]:.1%}")
        yield f"{target:g}", cells[0], cells[1], cells[2]


CURVE_HEADER = (
    "threshold [m]",
    "supported, zeta_p (zeta_s = 1 m)",
    "supported, zeta_s (zeta_p = 1 m)",
    "background, d_c",
)


def as_markdown(calibration: Calibration) -> str:
    """Return everything as Markdown tables."""
    parts = [
        f"# Calibration on {_plain(calibration.path)}",
        _table(("measured", ""), list(sensor_rows(calibration.sensor))),
    ]
    parts.append(_table(("key", "before", "value", "reason"), list(advice_rows(calibration))))
    parts.append(_table(CURVE_HEADER, list(curve_rows(calibration))))
    parts += [f"Note: {note}" for note in calibration.notes]
    parts += [f"Doubt: {_plain(doubt.sentence())}" for doubt in calibration.doubts]
    return "\n\n".join(parts) + "\n"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines)


WIDTH = 720
HEIGHT = 440
_LEFT = 64
_RIGHT = WIDTH - 24
_TOP = 48
_BOTTOM = HEIGHT - 88
"""Edges of the curves in the figure."""


def as_svg(calibration: Calibration) -> str:
    """Draw the supported share over both zetas (Lehtola et al. 2019, Fig. 4) and the background."""
    curves = calibration.curves
    prc = calibration.config.config.prc
    grids = (curves.zetas_p, curves.zetas_s, curves.lengths)
    first = float(min(grid[0] for grid in grids))
    last = float(max(grid[-1] for grid in grids))
    low = math.log10(first)
    high = math.log10(last)

    def x(value: float) -> float:
        return _LEFT + (math.log10(value) - low) / (high - low) * (_RIGHT - _LEFT)

    def y(share: float) -> float:
        return _BOTTOM - share * (_BOTTOM - _TOP)

    def curve(
        name: str,
        grid: F64,
        shares: F64,
        colour: str,
        dash: str,
        key: str,
        value: float,
    ) -> dict[str, object]:
        points = " ".join(
            f"{x(a):.1f},{y(b):.1f}" for a, b in zip(grid.tolist(), shares.tolist(), strict=True)
        )
        # a chosen threshold off the scale is drawn at its edge
        suffix = "" if first <= value <= last else " (off the scale)"
        return {
            "name": name,
            "points": points,
            "colour": colour,
            "dash": dash,
            "chosen": f"{key} = {value:g} m{suffix}",
            "at": x(min(max(value, first), last)),
        }

    of_p = curves.over_zeta_p(1.0)
    of_s = curves.over_zeta_s(1.0)
    of_d = curves.background_share()
    zeta_p = prc.support.zeta_p
    zeta_s = prc.support.zeta_s
    d_c = prc.background.d_c
    name = _plain(calibration.path).rsplit("/", 1)[-1]
    values = {
        "width": WIDTH,
        "height": HEIGHT,
        "left": _LEFT,
        "right": _RIGHT,
        "top": _TOP,
        "bottom": _BOTTOM,
        "title": f"{name}: share of {curves.n_returns:,} returns",
        "shares": [(y(tenth / 10), f"{tenth * 10} %") for tenth in range(0, 11, 2)],
        "thresholds": [
            (x(10.0**n), f"{10.0**n:g}") for n in range(math.ceil(low), math.floor(high) + 1)
        ],
        "curves": [
            curve(
                "supported over zeta_p, zeta_s = 1 m",
                grids[0],
                of_p,
                "#0072b2",
                "",
                "zeta_p",
                zeta_p,
            ),
            curve(
                "supported over zeta_s, zeta_p = 1 m",
                grids[1],
                of_s,
                "#d55e00",
                "7 3",
                "zeta_s",
                zeta_s,
            ),
            curve("background over d_c", grids[2], of_d, "#009e73", "2 3", "d_c", d_c),
        ],
    }
    return render_page("prc_cli.jobs.calibrate", "curves.svg", values)


def _value(value: float | int | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _plain(text: str) -> str:
    """Escape a file name so that it cannot end a comment or a table cell."""
    return "".join(
        character if character.isprintable() else ascii(character)[1:-1] for character in text
    )
