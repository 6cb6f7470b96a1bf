"""Why the sequential-angle method gives a shot its class (Stamos et al. 2012, sec. 4 to 8)."""

from __future__ import annotations

from collections.abc import Iterator

from prc_cli.core.classes import Label, Surface
from prc_cli.core.config import Params
from prc_cli.core.stream import LabelledBlock, cut
from prc_cli.jobs.explain.answers import Answer, metres
from prc_cli.methods.base import beams_of
from prc_cli.methods.sequential_angle.lines import to_columns
from prc_cli.methods.sequential_angle.pipeline import Beams, SequentialAngleParams, within_lines

_SO = {
    Label.GROUND: "horizontal and at the height of the ground: ground",
    Label.CURB: "a vertical face between two grounds, confirmed across lines: curb",
    Label.CAR: "above the ground, below the top of a car, and nearer than any curb: car",
    Label.VEGETATION: "the coarse class stays: vegetation",
    Label.HORIZONTAL: "the coarse class stays: horizontal",
    Label.VERTICAL: "the coarse class stays: vertical",
    Label.UNCLASSIFIED: "too few shots around it to tell",
}


def sequential_angle_answers(
    item: LabelledBlock, params: SequentialAngleParams, line: int, column: int
) -> Iterator[Answer]:
    """Yield the answers of the stages, in their order."""
    stages = item.stages
    assert stages is not None
    beams = Beams.of(beams_of(item.block))
    own = cut(item.block, line, line + 1)
    if not own.range_m[0, column] <= params.max_range_m:
        limit = (("sequential_angle.max_range_m", params.max_range_m),)
        yield Answer("reach", metres(float(own.range_m[0, column])), "beyond the reach: no class", limit)
        return
    rows = within_lines(own.range_m, own.xyz_m, beams, params)
    m = own.points_per_line
    signed_deg = float(to_columns(rows.signed_deg, beams.sides, m)[0, column])
    line_deg = float(to_columns(rows.line_angle_deg, beams.sides, m)[0, column])
    yield Answer(
        "angle",
        "none: too few shots around" if signed_deg != signed_deg else f"signed angle {signed_deg:.1f} deg",
        "measured over a chord that the noise allows",
        _of("angles", params.angles, "range_noise_m", "min_chord_sigmas", "chord_depth_sigmas"),
    )
    surface = Surface(int(stages.surface[line, column]))
    tests = params.coarse
    yield Answer(
        "coarse class",
        surface.name.lower(),
        "by the angles of its run" if surface != Surface.VEGETATION else "the angles turn to and fro",
        (
            ("sequential_angle.coarse.vegetation.threshold", tests.vegetation.threshold),
            ("sequential_angle.coarse.surfaces.threshold_vertical_deg", tests.surfaces.threshold_vertical_deg),
            ("sequential_angle.coarse.surfaces.threshold_horizontal_deg", tests.surfaces.threshold_horizontal_deg),
        ),
    )
    dense = bool(stages.dense_vegetation[line, column])
    yield Answer(
        "dense vegetation",
        "yes" if dense else "no",
        "no car" if dense else "may be a car",
        (("sequential_angle.dense_vegetation.threshold", params.dense_vegetation.threshold),),
    )
    height_m = float(stages.ground_height_m[line, column])
    above = float("nan") if item.above_m is None else float(item.above_m[line, column])
    tilt = "" if line_deg != line_deg else f"; the line has {line_deg:.1f} deg here"
    yield Answer(
        "ground",
        f"ground at {metres(height_m)} from the scanner, the shot {metres(above)} above it{tilt}",
        "height of the ground at this line",
        _of("ground", params.ground, "height_tolerance", "height_tolerance_m", "jump_m"),
    )
    label = Label(int(item.labels[line, column]))
    yield Answer(
        "classes",
        f"coarse {surface.name.lower()}",
        _SO.get(label, label.name.lower()),
        (*_of("curb", params.curb, "max_height_m", "min_lines"), *_of("car", params.car, "ground_layer_m")),
    )


def _of(name: str, params: Params, *keys: str) -> tuple[tuple[str, object], ...]:
    return tuple((f"sequential_angle.{name}.{key}", getattr(params, key)) for key in keys)
