"""Why PRC gives a shot its class: the images of its steps (Lehtola et al. 2019, Algorithm 1) at one place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32
from prc_cli.jobs.explain.answers import Answer, metres
from prc_cli.methods.prc.pipeline import LINK, TAIL, TOTALS, Connected, PrcParams, Seen, draw, grow, see
from prc_cli.methods.prc.support import required_counts, stream_window, window_reach
from prc_cli.methods.prc.surfaces import area_threshold
from prc_cli.methods.prc.urban import is_dense


def prc_answers(
    block: ScanBlock, heard: Mapping[str, Any], params: PrcParams, line: int, column: int
) -> Iterator[Answer]:
    """Yield the answers of the stages, in their order."""
    seen = see(stream_window(heard[TAIL.name], block.range_m, block.next_m), block.points_per_line, params)
    yield from _support(seen.window, block, params, line, column)
    if not seen.supported[line, column]:
        if params.environment == "forest":
            yield from _column(block, seen, heard[LINK.name], params, column)
        return
    yield _background(seen, params, block.points_per_line, (line, column))
    yield from _surfaces(block, seen, heard, params, (line, column))


def _support(window: F32, block: ScanBlock, params: PrcParams, line: int, column: int) -> Iterator[Answer]:
    m, limits = block.points_per_line, params.support
    own = window_reach(m) + line * m + column
    in_line = _agreeing(window, own, [k for k in range(-4, 5) if k], limits.zeta_p)
    beside = _agreeing(window, own, [-m - 1, -m, -m + 1, m - 1, m, m + 1], limits.zeta_s)
    needed = required_counts(limits)
    enough = in_line >= needed[0] and beside >= needed[1]
    yield Answer(
        "support",
        f"{in_line} of 8 neighbours in the line agree, expected {needed[0]}; "
        f"{beside} of 6 in adjacent lines, expected {needed[1]}",
        "supported" if enough else "not supported: noise",
        tuple((f"prc.support.{key}", getattr(limits, key)) for key in ("zeta_p", "zeta_s", "rho_c")),
    )


def _agreeing(window: F32, own: int, shifts: list[int], zeta_m: float) -> int:
    around = np.array([own + shift for shift in shifts if shift])
    off = np.abs(window[own] - window[around])
    return int(np.count_nonzero(off.astype(np.float64) < zeta_m))


def _background(seen: Seen, params: PrcParams, m: int, at: tuple[int, int]) -> Answer:
    own = window_reach(m) + at[0] * m + at[1]
    before, here, after = (float(seen.window[i]) for i in (own - 1, own, own + 1))
    marked = bool(seen.background[at])
    return Answer(
        "background",
        f"{metres(here)} between {metres(before)} and {metres(after)}",
        "two surfaces meet here: between segments" if marked else "goes on to its neighbours",
        tuple((f"prc.background.{key}", getattr(params.background, key)) for key in ("alpha", "d_c", "form")),
    )


def _surfaces(
    block: ScanBlock, seen: Seen, heard: Mapping[str, Any], params: PrcParams, at: tuple[int, int]
) -> Iterator[Answer]:
    connected: Connected = heard[LINK.name]
    h, v = connected.components, grow(seen, connected, params)
    component = int(h.image[at])
    size = int(h.sum_by_id(h.pixels)[component])
    least = area_threshold(params.surfaces, block.n_lines, params.lines_per_block, block.points_per_line)
    is_small, is_covered = bool(connected.small[component]), bool(v.covered[at])
    so = "smooth"
    if is_small:
        so = "non-smooth"
    elif is_covered:
        so = f"large enough, but within {params.surfaces.gamma} shots of a non-smooth segment: non-smooth"
    told = f"segment {int(h.ids[component])} has {size:,} shots in this block, expected {least:g} of a smooth one"
    yield Answer(
        "surfaces",
        told if component else "in no segment",
        so,
        (("prc.surfaces.area", params.surfaces.area), ("prc.surfaces.gamma", params.surfaces.gamma)),
    )
    if params.environment == "forest":
        yield from _column(block, seen, connected, params, at[1])
        return
    ground = int(heard[TOTALS.name])
    label = Label(int(draw(seen, v, ground, params)[at]))
    own = int(h.ids[component])
    said = f"the ground is segment {ground}, with most smooth shots so far"
    named = {Label.GROUND: "of the ground", Label.BUILDING: "smooth and not of the ground: building"}
    yield Answer(
        "classes",
        f"{said}; the shot is of segment {own}" if label != Label.VEGETATION else "non-smooth",
        named.get(label, "vegetation"),
        (("prc.urban.ground", params.urban.ground),),
    )


def _column(block: ScanBlock, seen: Seen, connected: Connected, params: PrcParams, column: int) -> Iterator[Answer]:
    """Answer for the column of a forest."""
    v = grow(seen, connected, params)
    step = params.forest.column_step
    first = column // step * step
    share = float(np.count_nonzero(v.smooth[:, first]) / block.n_lines)
    dense = bool(is_dense(v.smooth, params.forest)[column // step])
    yield Answer(
        "columns",
        f"column {first}, which decides for {step}, is smooth in {share:.0%} of the block's lines",
        "its returns are ground" if dense else "not ground: smooth is stem, non-smooth vegetation",
        tuple(
            (f"prc.forest.{key}", getattr(params.forest, key))
            for key in ("density", "column_step", "noise_in_ground_columns")
        ),
    )
