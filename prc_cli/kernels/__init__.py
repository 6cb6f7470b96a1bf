"""The only home of compiled loops.

:data:`KERNELS` is the one table: name of a kernel and the module that holds it. Every kernel has a slow and obvious
twin of the same name and arguments in :mod:`prc_cli.reference` or ``tests/oracles``; a test walks the table and
compares them bit for bit. A kernel is loaded when it is first used, ``kernels.support_mask(...)``, so that reading a
configuration does not load the compiler.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from prc_cli.core.interrupts import held

if TYPE_CHECKING:
    from prc_cli.kernels.fused.classes import fused_labels as fused_labels
    from prc_cli.kernels.fused.classes import mean_smoothness as mean_smoothness
    from prc_cli.kernels.fused.classes import vote_labels as vote_labels
    from prc_cli.kernels.fused.ground import walk_ground as walk_ground
    from prc_cli.kernels.fused.neighbours import directions as directions
    from prc_cli.kernels.fused.neighbours import near_counts as near_counts
    from prc_cli.kernels.fused.neighbours import plane_points as plane_points
    from prc_cli.kernels.fused.neighbours import smooth_counts as smooth_counts
    from prc_cli.kernels.fused.stems import forest_labels as forest_labels
    from prc_cli.kernels.fused.stems import ground_heights as ground_heights
    from prc_cli.kernels.fused.stems import ground_profiles as ground_profiles
    from prc_cli.kernels.fused.stems import stem_shots as stem_shots
    from prc_cli.kernels.fused.stems import upright_runs as upright_runs
    from prc_cli.kernels.fused.strips import fill_strips as fill_strips
    from prc_cli.kernels.fused.strips import find_walls as find_walls
    from prc_cli.kernels.fused.strips import widen_levels as widen_levels
    from prc_cli.kernels.fused.strips import widen_slots as widen_slots
    from prc_cli.kernels.prc.calibration import bend_histogram as bend_histogram
    from prc_cli.kernels.prc.calibration import support_histogram as support_histogram
    from prc_cli.kernels.prc.components import carry_labels as carry_labels
    from prc_cli.kernels.prc.components import join_and_fill as join_and_fill
    from prc_cli.kernels.prc.components import label_components as label_components
    from prc_cli.kernels.prc.support import background_mask as background_mask
    from prc_cli.kernels.prc.support import clean_ranges as clean_ranges
    from prc_cli.kernels.prc.support import support_mask as support_mask
    from prc_cli.kernels.prc.surfaces import count_covered as count_covered
    from prc_cli.kernels.prc.surfaces import dilate as dilate
    from prc_cli.kernels.prc.surfaces import draw_columns as draw_columns
    from prc_cli.kernels.prc.surfaces import draw_components as draw_components
    from prc_cli.kernels.prc.surfaces import select_components as select_components
    from prc_cli.kernels.sequential_angle.angles import angle_differences as angle_differences
    from prc_cli.kernels.sequential_angle.angles import line_angles as line_angles
    from prc_cli.kernels.sequential_angle.angles import signed_angles as signed_angles
    from prc_cli.kernels.sequential_angle.coarse import surface_image as surface_image
    from prc_cli.kernels.sequential_angle.curb import connect_verticals as connect_verticals
    from prc_cli.kernels.sequential_angle.curb import possible_curbs as possible_curbs
    from prc_cli.kernels.sequential_angle.dividers import car_intervals as car_intervals
    from prc_cli.kernels.sequential_angle.dividers import cut_verticals as cut_verticals
    from prc_cli.kernels.sequential_angle.fourier import stable_intervals as stable_intervals
    from prc_cli.kernels.sequential_angle.ground import find_modes as find_modes
    from prc_cli.kernels.sequential_angle.ground import ground_rows as ground_rows
    from prc_cli.kernels.sequential_angle.ground import main_height as main_height
    from prc_cli.kernels.sequential_angle.ground import potential_heights as potential_heights
    from prc_cli.kernels.sequential_angle.labels import combine_classes as combine_classes
    from prc_cli.kernels.sequential_angle.labels import mark_beyond as mark_beyond
    from prc_cli.kernels.sequential_angle.labels import mark_cars as mark_cars
    from prc_cli.kernels.sequential_angle.lines import arrange_lines as arrange_lines
    from prc_cli.kernels.sequential_angle.lines import arrange_plane as arrange_plane
    from prc_cli.kernels.sequential_angle.markov import hmm_cusum as hmm_cusum
    from prc_cli.kernels.sequential_angle.suspicious import first_triggers as first_triggers
    from prc_cli.kernels.sequential_angle.verticals import first_high_verticals as first_high_verticals
    from prc_cli.kernels.simulation.casting import cast_shots as cast_shots
    from prc_cli.kernels.simulation.sensor import goes_behind as goes_behind
    from prc_cli.kernels.simulation.sensor import sense as sense
    from prc_cli.kernels.simulation.shots import aim_shots as aim_shots

KERNELS: dict[str, str] = {
    "aim_shots": "prc_cli.kernels.simulation.shots",
    "angle_differences": "prc_cli.kernels.sequential_angle.angles",
    "arrange_lines": "prc_cli.kernels.sequential_angle.lines",
    "arrange_plane": "prc_cli.kernels.sequential_angle.lines",
    "background_mask": "prc_cli.kernels.prc.support",
    "bend_histogram": "prc_cli.kernels.prc.calibration",
    "car_intervals": "prc_cli.kernels.sequential_angle.dividers",
    "carry_labels": "prc_cli.kernels.prc.components",
    "cast_shots": "prc_cli.kernels.simulation.casting",
    "clean_ranges": "prc_cli.kernels.prc.support",
    "combine_classes": "prc_cli.kernels.sequential_angle.labels",
    "connect_verticals": "prc_cli.kernels.sequential_angle.curb",
    "count_covered": "prc_cli.kernels.prc.surfaces",
    "cut_verticals": "prc_cli.kernels.sequential_angle.dividers",
    "dilate": "prc_cli.kernels.prc.surfaces",
    "directions": "prc_cli.kernels.fused.neighbours",
    "draw_columns": "prc_cli.kernels.prc.surfaces",
    "draw_components": "prc_cli.kernels.prc.surfaces",
    "fill_strips": "prc_cli.kernels.fused.strips",
    "find_modes": "prc_cli.kernels.sequential_angle.ground",
    "find_walls": "prc_cli.kernels.fused.strips",
    "first_high_verticals": "prc_cli.kernels.sequential_angle.verticals",
    "first_triggers": "prc_cli.kernels.sequential_angle.suspicious",
    "forest_labels": "prc_cli.kernels.fused.stems",
    "fused_labels": "prc_cli.kernels.fused.classes",
    "goes_behind": "prc_cli.kernels.simulation.sensor",
    "ground_heights": "prc_cli.kernels.fused.stems",
    "ground_profiles": "prc_cli.kernels.fused.stems",
    "ground_rows": "prc_cli.kernels.sequential_angle.ground",
    "hmm_cusum": "prc_cli.kernels.sequential_angle.markov",
    "join_and_fill": "prc_cli.kernels.prc.components",
    "label_components": "prc_cli.kernels.prc.components",
    "line_angles": "prc_cli.kernels.sequential_angle.angles",
    "main_height": "prc_cli.kernels.sequential_angle.ground",
    "mark_beyond": "prc_cli.kernels.sequential_angle.labels",
    "mark_cars": "prc_cli.kernels.sequential_angle.labels",
    "mean_smoothness": "prc_cli.kernels.fused.classes",
    "near_counts": "prc_cli.kernels.fused.neighbours",
    "plane_points": "prc_cli.kernels.fused.neighbours",
    "possible_curbs": "prc_cli.kernels.sequential_angle.curb",
    "potential_heights": "prc_cli.kernels.sequential_angle.ground",
    "select_components": "prc_cli.kernels.prc.surfaces",
    "sense": "prc_cli.kernels.simulation.sensor",
    "signed_angles": "prc_cli.kernels.sequential_angle.angles",
    "smooth_counts": "prc_cli.kernels.fused.neighbours",
    "stable_intervals": "prc_cli.kernels.sequential_angle.fourier",
    "stem_shots": "prc_cli.kernels.fused.stems",
    "support_histogram": "prc_cli.kernels.prc.calibration",
    "support_mask": "prc_cli.kernels.prc.support",
    "surface_image": "prc_cli.kernels.sequential_angle.coarse",
    "upright_runs": "prc_cli.kernels.fused.stems",
    "vote_labels": "prc_cli.kernels.fused.classes",
    "walk_ground": "prc_cli.kernels.fused.ground",
    "widen_levels": "prc_cli.kernels.fused.strips",
    "widen_slots": "prc_cli.kernels.fused.strips",
}
"""Module of every kernel, by name."""


def __getattr__(name: str) -> Any:
    """Load a kernel at its first use (compiled earlier, it comes from the cache)."""
    if name not in KERNELS:
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    kernel = held(getattr(import_module(KERNELS[name]), name))
    globals()[name] = kernel
    return kernel


_spare = False


def spare_linear_algebra() -> None:
    """Let the compiler do without SciPy's linear algebra, a fifth of what a short command takes.

    No kernel uses it. Other compiled functions of the same process could not multiply matrices, so that only a process
    that is the command ``prc`` and nothing else may say this.
    """
    global _spare
    _spare = True


def load_kernels(modules: frozenset[str] | None = None) -> None:
    """Compile kernels, on all cores and in one process at a time, or load them from the cache.

    Call it before worker processes or threads start.

    Parameters
    ----------
    modules : set of str, optional
        Folders or modules of kernels, such as ``simulation`` or ``prc.support``; default: all.
    """
    from prc_cli.kernels.cache import load_compiler
    from prc_cli.kernels.compiling import compile_missing  # which loads the compiler

    if _spare:
        load_compiler()
    wanted = {name: home for name, home in KERNELS.items() if modules is None or _is_in(home, modules)}
    compile_missing(sorted(set(wanted.values())))
    for name in wanted:
        __getattr__(name)


def _is_in(home: str, modules: frozenset[str]) -> bool:
    """Tell whether a module is one of those named, or lies in one of the folders named."""
    inside = home.removeprefix(f"{__name__}.")
    return inside in modules or inside.partition(".")[0] in modules
