"""Options of ``prc evaluate``, and the default class mapping of predicted files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from prc_cli.core.errors import ConfigError, PrcError
from prc_cli.core.window import Window
from prc_cli.evaluation.confusion import check_edges
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.formats.labels import open_codes
from prc_cli.formats.writing.record import PROGRAM, read_record
from prc_cli.methods.methods import METHOD_TABLE

TIME_TOLERANCE_S = 6e-7
"""Half a microsecond (the rounding of times in text) plus the step of float64 at 1e9 s.

Shots of scanners up to 1 MHz are further apart, so no shot is paired with its neighbour."""

PLACE_BY_POSES = (
    "shots that are relative to the scanner: "
    "add --trajectory POSES and, if it leans, --mount ROLL,PITCH,YAW"
)
"""Hint: how raw shots are matched with registered points."""


@dataclass(frozen=True, slots=True)
class EvaluateOptions:
    """How two sides are compared."""

    match: str = "order"
    """``order``, ``time``, ``nearest`` or ``dimension:NAME``.

    ``dimension:PREDICTED=REFERENCE`` is for different names. Files of other length or order are
    matched by cell instead of order, if both have line and column. The dimension ``record`` is the
    index of a record if a file has no such column (not in LAS).
    """
    tolerance: float | None = None
    """Largest difference of a pair, [s] for ``time`` and [m] for ``nearest``.

    None = :data:`TIME_TOLERANCE_S`, or chosen from the spacing of the reference and the distance of
    the two clouds.
    """
    min_matched: float = 0.5
    """Least share of the smaller side that must be matched."""
    predicted_dimension: str | None = None
    """Column or dimension with the predicted codes; None = found by name."""
    reference_dimension: str | None = None
    """Column or dimension with the reference codes; None = found by name."""
    predicted_points: Path | None = None
    """Points of predicted labels without coordinates, record by record: the input of the run.

    Or the folder of the inputs.
    """
    reference_points: Path | None = None
    """Points of reference labels without coordinates, or their folder."""
    trajectory: Path | None = None
    """Poses of the drive, for predicted coordinates from its ranges and scan angles.

    None = the files have coordinates.
    """
    mount: tuple[float, ...] = ()
    """Scanner on the vehicle: roll, pitch, yaw [deg]; x, y, z from the trajectory's point [m]."""
    split_range_m: tuple[float, ...] = ()
    """Edges of range bins [m]; empty = not split."""
    split_lines: int | None = None
    """Scan lines per part; None = not split."""
    split_scanner: bool = False
    """Whether every scanner is a part."""
    split_confidence: tuple[int, ...] = ()
    """Edges of spans of confidence [per cent]; empty = not split."""
    points_per_line: int | None = None
    """M, if the records are all shots of a stream: the line of record i is i // M."""
    intervals: bool = False
    """Whether confidence intervals of the scores are computed."""
    interval_lines: int = 99
    """Scan lines per block of the jackknife."""
    unmatched: str = "leave"
    """``nearest``: predicted shots without partner are left out (``leave``) or ``noise``.

    They are noise only where the reference has points."""
    inside: str | None = None
    """``nearest``: only shots in this area are compared.

    ``X1,Y1,X2,Y2`` or a GeoJSON file of polygons.
    """
    height: tuple[float, float] | None = None
    """``nearest``: only shots between these heights above the reference ground are scored [m]."""
    trees: Path | None = None
    """``nearest``: a CSV file of trees; shots inside their cylinders are stems in the reference."""
    third: Path | None = None
    """A third labelling of the same shots: by ``order`` or ``nearest``."""
    third_mapping: str | Path | None = None
    """Class mapping of the third labelling, by its reference codes; None = as the reference."""
    allow_missing: bool = False
    """Whether files without partner in the other folder are left out instead of refused."""
    window: Window | None = None
    """Only the records of these lines or times, as in the files, are scored."""
    pool: bool = False
    """Whether all files of a side are compared as one, as tiles with other bounds."""
    places: bool = False
    """Whether the places where both sides differ are listed."""
    place_pictures: bool = False
    """Whether the first places have pictures."""


def check_options(options: EvaluateOptions) -> None:
    """Refuse invalid options."""
    kind, _, name = options.match.partition(":")
    if options.match not in ("order", "time", "nearest") and not (kind == "dimension" and name):
        problem = f"found {options.match!r}, expected one of: order, time, dimension:NAME, nearest"
        raise ConfigError("match", problem)
    tolerance = options.tolerance
    if tolerance is not None:
        if options.match not in ("time", "nearest"):
            raise ConfigError(
                "tolerance", f"records matched by {options.match} have none", "leave it out"
            )
        if (
            not math.isfinite(tolerance)
            or tolerance < 0
            or (tolerance == 0 and options.match == "nearest")
        ):
            raise ConfigError("tolerance", f"found {tolerance:g}, expected a finite number above 0")
    _check_places(options)
    if options.pool and options.match == "order":
        raise ConfigError(
            "pool", "records of pooled files have no order", "match by time, dimension or nearest"
        )
    if not 0 <= options.min_matched <= 1:
        raise ConfigError(
            "min_matched", f"found {options.min_matched:g}, expected a share from 0 to 1"
        )
    for key in ("split_lines", "points_per_line", "interval_lines"):
        value = getattr(options, key)
        if value is not None and value < 1:
            raise ConfigError(key, f"found {value}, expected at least 1")
    check_edges(options.split_range_m)
    _check_confidence(options)


def _check_places(options: EvaluateOptions) -> None:
    # some options need coordinates
    needs_places = [
        key
        for key in ("inside", "height", "trees", "trajectory")
        if getattr(options, key) is not None
    ]
    if options.unmatched != "leave":
        needs_places.insert(0, "unmatched")
    for key in needs_places:
        if options.match != "nearest":
            problem = f"needs coordinates of both sides, records are matched by {options.match}"
            raise ConfigError(f"--{key}", problem, "give --match nearest")
    if options.third is not None and options.match not in ("order", "nearest"):
        problem = f"a third labelling is matched by order or nearest, found {options.match}"
        raise ConfigError("--third", problem, "give --match nearest")
    if options.unmatched not in ("leave", "noise"):
        raise ConfigError("--unmatched", f"found {options.unmatched!r}, expected leave or noise")


def _check_confidence(options: EvaluateOptions) -> None:
    edges = options.split_confidence
    if any(low >= high for low, high in pairwise((-1, *edges, 101))):
        shown = ", ".join(map(str, edges))
        raise ConfigError(
            "split by confidence", f"found the edges {shown}, expected rising per cents, 0 to 100"
        )


def tolerance_of(options: EvaluateOptions) -> float | None:
    """Return the largest difference of a pair; None if the match has no tolerance."""
    if options.tolerance is None and options.match == "time":
        return TIME_TOLERANCE_S
    return options.tolerance


DEFAULT_MAPPING = "prc"
"""Preset without a run record."""

MAPPINGS = {name: method.mapping for name, method in METHOD_TABLE.items() if method.mapping}
"""Preset by method. Forests have the classes of PRC with every method."""

COARSEST_FIRST = ("street_scan", "prc", "street")
"""Presets for the comparison of two methods, fewest classes first."""


def mapping_of_runs(
    predicted: Sequence[Path], reference: Sequence[Path] = (), dimension: str | None = None
) -> tuple[str, str]:
    """Choose the preset for the methods that wrote the files and the codes of the reference.

    Return its name and the reason.
    """
    name, method = _preset_of_files(predicted)
    reference_name, reference_method = _preset_of_files(reference)
    if reference_method and reference_name != name:
        # the coarser one has the classes of both
        name = min(name, reference_name, key=COARSEST_FIRST.index)
        methods = " and ".join(filter(None, (method, reference_method)))
        return name, f"the run records say {methods}: it has the classes of both"
    why = [f"the run record says {method}"] if method and name != DEFAULT_MAPPING else []
    if reference and (listing := _listing(load_mapping(name), reference[0], dimension)):
        name = listing
        why.append("it lists the reference's codes")
    return name, ", ".join(why)


def mapping_of_methods(
    predicted: Sequence[Sequence[Path]], reference: Sequence[Path], dimension: str | None = None
) -> tuple[str, str]:
    """Choose the preset that has the classes of several methods; return its name and the reason.

    ``predicted`` has the files of every method.
    """
    choices = [mapping_of_runs(files, reference, dimension) for files in predicted]
    name, why = min(choices, key=lambda choice: _fineness(choice[0]))
    if all(chosen == name for chosen, _ in choices):
        return name, why
    return name, "it has the classes of all methods"


def _fineness(preset: str) -> int:
    if preset.startswith("street_scan"):
        return 0
    return 2 if preset.startswith("street") else 1


def _preset_of_files(paths: Sequence[Path]) -> tuple[str, str]:
    # preset and method; the default preset if the methods differ
    presets = {_preset_of_file(path) for path in paths}
    return presets.pop() if len(presets) == 1 else (DEFAULT_MAPPING, "")


def _listing(mapping: ClassMapping, reference: Path, dimension: str | None) -> str:
    """Return the preset that lists the first codes of a reference, if the mapping does not.

    Empty if no preset does, or several with different codes do.
    """
    try:
        codes = np.unique(next(iter(open_codes(reference, dimension).codes()), ()))
    except (PrcError, OSError):  # the comparison reports it
        return ""
    if not mapping.is_unlisted(codes, "reference").any():
        return ""
    names = mapping.fitting(codes, "reference")
    kinds = {
        load_mapping(name).is_unlisted(np.arange(1 << 16), "reference").tobytes() for name in names
    }
    return names[0] if len(kinds) == 1 else ""


def _preset_of_file(path: Path) -> tuple[str, str]:
    # preset and method by the run record; the default preset without a valid record
    try:
        record = read_record(path)
        config = record["config"]
        method = config["method"]
        forest = method == "fused" and config["fused"]["environment"] == "forest"
        name = DEFAULT_MAPPING if forest else MAPPINGS.get(method, DEFAULT_MAPPING)
        known = record["program"] == PROGRAM and isinstance(method, str)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        known = False
    return (name, method) if known else (DEFAULT_MAPPING, "")
