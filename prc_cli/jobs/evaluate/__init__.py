"""Comparison of label files: match their records, count the pairs in one confusion matrix and in parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.window import Window
from prc_cli.evaluation.confusion import (
    ConfusionMatrix,
    GroupedCounts,
    cells_of,
    refuse_poor_match,
)
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.scores import Evaluation, MatchReport
from prc_cli.formats.las.read import LasSource
from prc_cli.formats.las.vlrs import same_crs, short_crs
from prc_cli.jobs.evaluate.chosen import mapping_of_runs
from prc_cli.jobs.evaluate.counts import (
    SPLITS,
    Counts,
    asked_parts,
    count_pairs,
    intervals_of,
    reliability_notes,
    scored_parts,
)
from prc_cli.jobs.evaluate.options import EvaluateOptions, check_options, tolerance_of
from prc_cli.jobs.evaluate.pools import open_pools
from prc_cli.jobs.evaluate.window import ScoredWindow
from prc_cli.matching.join import (
    CODE,
    KEY,
    SAME,
    Columns,
    JoinTally,
    UnsortedError,
    columns_of,
    in_step,
    merge_join,
)
from prc_cli.matching.keys import AXES, KeyRule, MutualKeys, NearestPlaces
from prc_cli.matching.pairs import files_of
from prc_cli.matching.sides import (
    CONFIDENCE,
    FILE,
    LINE,
    ROW,
    SECONDS,
    Side,
)


def evaluate_all(
    predicted: Sequence[Path],
    reference: Sequence[Path],
    mapping: ClassMapping | str | Path | None = None,
    *,
    options: EvaluateOptions | None = None,
) -> Evaluation:
    """Compare files and pool them into one matrix, in bounded memory.

    Parameters
    ----------
    predicted, reference : sequence of path
        As many on either side: the k-th of one is compared with the k-th of the other. Two folders: the files of one
        name (except the suffix). With ``pool``, or where files cannot be paired (a file and a folder, different names
        or numbers) and the match is not by order, all files of a side are compared as one, for example tiles.
    mapping : ClassMapping, name or path, optional
        Which codes mean which class on either side: a preset name, a TOML file or a mapping. Default: the one that fits
        the method in the run records beside the predicted files, else ``prc``.
    options : EvaluateOptions, optional
        How records are matched, which splits are computed, and how intervals are computed.

    Returns
    -------
    Evaluation
        Matrix of all pairs, number of matched records on either side, parts and intervals.

    Raises
    ------
    ConfigError
        Invalid options, or options that need what the files do not hold.
    InputError
        A damaged file; different counts (``order``), too few records with a partner, or different coordinate systems
        (``nearest``).

    Examples
    --------
    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> np.save(folder / "labels.npy", np.array([2, 2, 6], np.uint8))
    >>> np.save(folder / "truth.npy", np.array([2, 6, 6], np.uint8))
    >>> evaluate_all([folder / "labels.npy"], [folder / "truth.npy"]).match.n_matched
    3
    """
    options = options or EvaluateOptions()
    check_options(options)
    why = ""
    if mapping is None:
        mapping, why = mapping_of_runs(*(files_of([Path(path) for path in side]) for side in (predicted, reference)))
    found = mapping if isinstance(mapping, ClassMapping) else load_mapping(mapping)
    paths = [Path(path) for path in predicted], [Path(path) for path in reference]
    pools = open_pools(*paths, options)
    counts = Counts(found, {name: GroupedCounts(found, name) for name in ("all", *asked_parts(options))})
    if why:
        counts.note(f"class mapping {mapping}: {why}")
    # blocks are counted in lines only if the lines of every pool are known
    by_lines = all(LINE in (*left.dimensions, *right.dimensions) for left, right in pools)
    names: list[str] = []
    how: list[str] = []
    for left, right in pools:
        how.append(_compare(left, right, len(names), counts, options, by_lines=by_lines))
        names += [file.codes.path for file in left.files]
    if options.allow_missing:
        _note_missing(paths, pools, counts)
    if CONFIDENCE in counts.parts:
        for sentence in reliability_notes(counts.parts[CONFIDENCE]):
            counts.note(sentence)
    matrix = counts.parts["all"].matrix(0)
    intervals, method = intervals_of(counts, matrix, options, by_lines=by_lines)
    files = dict.fromkeys(names), dict.fromkeys(file.codes.path for _, pool in pools for file in pool.files)
    splits = {
        SPLITS[name]: scored_parts(counts, name, names, options) for name in asked_parts(options) if name in SPLITS
    }
    match = MatchReport(
        " and ".join(dict.fromkeys(how)),
        counts.n_predicted,
        counts.n_reference,
        counts.n_matched,
        tolerance_of(options),
        tuple(sentence.replace("{n}", str(n)) for sentence, n in counts.notes.items()),
        counts.n_reference_matched,
    )
    label = "" if isinstance(mapping, ClassMapping) else str(mapping)
    return Evaluation(tuple(files[0]), tuple(files[1]), label, match, matrix, splits, intervals, method)


def evaluate(
    predicted: Path | str,
    reference: Path | str,
    mapping: ClassMapping | str | Path | None = None,
    *,
    predicted_dimension: str | None = None,
    reference_dimension: str | None = None,
) -> ConfusionMatrix:
    """Compare two label files record by record.

    Parameters
    ----------
    predicted, reference : path
        Label files (``.npy``, ``.csv``, ``.parquet``), or any record file that carries codes.
    mapping : ClassMapping, name or path, optional
        Which codes mean which class on either side: a preset name, a TOML file or a mapping. Default: the one that fits
        the method in the run records beside the predicted files, else ``prc``.
    predicted_dimension, reference_dimension : str, optional
        Column or dimension that holds the codes; default ``class``, ``label`` or ``classification``.

    Raises
    ------
    InputError
        When the files hold different numbers of records, and one does not know the cells of its records.
    """
    options = EvaluateOptions(predicted_dimension=predicted_dimension, reference_dimension=reference_dimension)
    return evaluate_all([Path(predicted)], [Path(reference)], mapping, options=options).matrix


def _note_missing(paths: tuple[list[Path], list[Path]], pools: list[tuple[Side, Side]], counts: Counts) -> None:
    """Report the files left out because they have no partner."""
    for k, side in enumerate(paths):
        used = {file.codes.path for pool in pools for file in pool[k].files}
        missing = [path.name for path in files_of(side) if str(path) not in used]
        if missing:
            shown = ", ".join(missing[:10]) + (", ..." if len(missing) > 10 else "")
            who = ("predicted", "reference")[k]
            have = "file has" if len(missing) == 1 else "files have"
            counts.note(f"{len(missing)} {who} {have} no partner, left out: {shown}")


def _with_own_lines(left: Side, right: Side, counts: Counts) -> tuple[Side, Side]:
    """Take the lines of the records where either side has them; M then divides nothing."""
    bare = replace(left, points_per_line=None), replace(right, points_per_line=None)
    if left.points_per_line is None or not any(LINE in side.dimensions for side in bare):
        return left, right
    counts.note(f"lines: a column of the files; -M {left.points_per_line} is not used")
    return bare


def _compare(
    left: Side, right: Side, first_file: int, counts: Counts, options: EvaluateOptions, *, by_lines: bool
) -> str:
    """Match one pool of files and count its pairs; return how they were matched."""
    left, right = _with_own_lines(left, right, counts)
    plan = _plan(left, right, options, by_lines=by_lines)
    mapping = counts.mapping
    for name in plan.reference:
        counts.note(f"{SPLITS.get(name, name)}: taken from the reference")
    if options.match == "nearest":
        _check_crs(left, right, counts)
        left, right = _keyed(left, right, KeyRule("place", _longest_axis(right)))
    on_disk = [options.match == "nearest"] * 2
    while True:
        found = {name: GroupedCounts(mapping, name) for name in counts.parts}
        tally, n_unsure = JoinTally(), 0
        window = None if options.window is None else ScoredWindow(options.window)
        try:
            for one, other in _pairs(left, right, plan, tally, on_disk, options):
                beside = {name: other[name] for name in plan.reference} | {name: one[name] for name in plan.predicted}
                if window is not None:
                    (one, other), beside = window.inside(beside, one, other)
                if FILE in beside:
                    beside[FILE] = beside[FILE] + first_file
                cells = cells_of(mapping, one[CODE], other[CODE])
                if options.min_confidence is not None:
                    sure = beside[CONFIDENCE] >= options.min_confidence
                    n_unsure += len(sure) - int(np.count_nonzero(sure))
                    cells, beside = cells[sure], {name: values[sure] for name, values in beside.items()}
                count_pairs(found, beside, cells, options, by_lines=by_lines)
        except _UnequalError:
            counts.note("the files hold other records, or others first: matched by cell (scan line, column)")
            options = replace(options, match="cell")
            left, right = _keyed(left, right, KeyRule("cell"))
            plan = _plan(left, right, options, by_lines=by_lines)
            continue
        except UnsortedError as error:
            # most streams are sorted; if not, sort on disk and start the match again
            on_disk[error.side] = True
            continue
        break
    for name, part in found.items():
        counts.parts[name].merge(part)
    if window is not None:
        window.report(left.path, counts)
    counts.note(f"{{n}} pairs have a confidence below {options.min_confidence} %: left out", n_unsure)
    _report(left, right, tally, counts, options)
    return options.match


def _keyed(left: Side, right: Side, key: KeyRule) -> tuple[Side, Side]:
    return replace(left, key=key), replace(right, key=key)


class _UnequalError(Exception):
    """Files to be matched by order differ in length or in their order, but both know their cells."""


@dataclass(frozen=True, slots=True)
class _Plan:
    """Columns beside the codes, by the side they are read from."""

    predicted: tuple[str, ...]
    reference: tuple[str, ...]
    keys: tuple[str, ...]
    """Columns of both sides that the match itself needs."""


def _plan(left: Side, right: Side, options: EvaluateOptions, *, by_lines: bool) -> _Plan:
    has, other_has, asked = left.dimensions, right.dimensions, asked_parts(options)
    wanted = dict.fromkeys(LINE if name == "blocks" else name for name in asked if name != "blocks" or by_lines)
    if options.window is not None:
        place = LINE if options.window.in_lines else SECONDS
        wanted[place] = None
        if place not in (*has, *other_has):
            raise _no_place(left, right, options.window)
    if options.min_confidence is not None:
        wanted[CONFIDENCE] = None
    for name in wanted:
        if name != CONFIDENCE and name not in (*has, *other_has) and name in asked:
            problem = f"no {SPLITS[name]} to split by in {left.path} or {right.path}"
            hint = "give -M, or --predicted-points with the points of the labels"
            raise ConfigError(f"split by {SPLITS[name]}", problem, hint)
    if CONFIDENCE in wanted and CONFIDENCE not in has:
        problem = f"no confidence in {left.path}, expected a dimension or column of this name"
        hint = "classify again with --set output.confidence=true, to .las, .laz, .csv or .parquet"
        raise ConfigError("--by-confidence, --min-confidence", problem, hint)
    predicted = [name for name in wanted if name in has]
    reference = [name for name in wanted if name not in has and name in other_has]
    if "blocks" in asked or LINE in asked:
        predicted += [FILE, ROW]
    keys: tuple[str, ...] = () if options.match == "order" else (KEY,)
    if options.match == "nearest":
        keys = (KEY, *AXES)
    elif options.match in ("time", "cell") and SAME in has and SAME in other_has:
        keys = (KEY, SAME)
    return _Plan(tuple(predicted), tuple(reference), keys)


def _no_place(left: Side, right: Side, window: Window) -> ConfigError:
    what = "scan lines" if window.in_lines else "times"
    problem = f"no {what} in {left.path} or {right.path}, expected them for {window.option}"
    hint = "give --predicted-points with the points of the labels" + (", or -M" if window.in_lines else "")
    return ConfigError("window", problem, hint)


def _pairs(
    left: Side, right: Side, plan: _Plan, tally: JoinTally, on_disk: Sequence[bool], options: EvaluateOptions
) -> Iterator[tuple[Columns, Columns]]:
    """Yield matched pairs of records."""
    knows_cells = all(len(side.files) == 1 and side.files[0].knows_cells for side in (left, right))
    compared = options.match == "order" and knows_cells and any(side.files[0].has_cells for side in (left, right))
    if compared:
        left, right = _keyed(left, right, KeyRule("cell"))
    keys = (*plan.keys, *([KEY] if compared else []))
    columns = (CODE, *keys, *plan.predicted), (CODE, *keys, *plan.reference)
    one, other = (
        columns_of(side, names, sort=sort, with_record=False)
        for side, names, sort in zip((left, right), columns, on_disk, strict=True)
    )
    names = left.path, right.path
    if options.match == "order":

        def check(n: Sequence[int]) -> None:
            if n[0] != n[1] and knows_cells:
                raise _UnequalError
            refuse_poor_match(n[0], n[1], *names)

        off = None
        for pair in in_step((one, other), check):
            if compared and len(pair[0][KEY]):
                # cells that are counted from other numbers are in the same order all the same
                apart = pair[1][KEY] - pair[0][KEY]
                off = apart[0] if off is None else off
                if np.any(apart != off):
                    raise _UnequalError
            tally.n_pairs += len(pair[0][CODE])
            tally.n_right += len(pair[0][CODE])
            yield pair[0], pair[1]
        return
    tolerance = tolerance_of(options) or 0.0
    match = NearestPlaces(tolerance, options.one_to_one) if options.match == "nearest" else MutualKeys(tolerance)
    for joined in merge_join(one, other, match, tolerance, tally, names):
        yield joined.pairs()


def _report(left: Side, right: Side, tally: JoinTally, counts: Counts, options: EvaluateOptions) -> None:
    """Add up the match counts, report what was left out, and refuse a poor match."""
    counts.n_predicted += left.tally.n_records
    counts.n_reference += right.tally.n_records
    counts.n_matched += tally.n_pairs
    counts.n_reference_matched += tally.n_right
    if options.match == "order":
        return
    what = "coordinates" if options.match == "nearest" else options.match
    for side, who in ((left, "predicted"), (right, "reference")):
        counts.note(f"{{n}} {who} records have no finite {what}: left out", side.tally.n_not_finite)
        if not side.tally.n_usable:
            raise InputError(side.path, f"no record has finite {what}, expected them to match by", "check the file")
    shared = {"nearest": "places", "time": "times", "cell": "cells"}.get(options.match, "ids")
    counts.note(
        f"{{n}} predicted records share their {shared} with another number of reference records: which is which "
        "cannot be told, left out",
        tally.n_ambiguous,
    )
    counts.note(f"{{n}} pairs share their {shared} with other pairs: paired in their order", tally.n_in_order)
    if options.match == "time" and not (SAME in left.dimensions and SAME in right.dimensions):
        counts.note("return numbers are not on both sides: not compared")
    _refuse_poor(left, right, tally, options)


def _refuse_poor(left: Side, right: Side, tally: JoinTally, options: EvaluateOptions) -> None:
    n_left, n_right = left.tally.n_usable, right.tally.n_usable
    smaller, other, found, of = (left, right, tally.n_pairs, n_left)
    if n_right < n_left:
        smaller, other, found, of = (right, left, tally.n_right, n_right)
    if found and found >= options.min_matched * of:
        return
    share = f"{found} of its {of} records found a partner in {other.path}"
    if not found:
        name = "key" if left.key is None else left.key.dimension
        spans = [f"{name} {side.tally.low:.9g} to {side.tally.high:.9g}" for side in (left, right)]
        share = f"{share}: {left.path} has {spans[0]}, {right.path} has {spans[1]}"
    else:
        share = f"{share} ({100 * found / of:.1f} %), expected at least {100 * options.min_matched:g} %"
    hints = {
        "time": "check that both clocks count alike (week seconds or standard time), or give a larger tolerance",
        "nearest": "check that both clouds are registered in one coordinate system, or give a larger tolerance",
    }
    raise InputError(smaller.path, share, hints.get(options.match, "check that the ids come from one run"))


def _longest_axis(side: Side) -> str:
    """Return the axis along which a side is longest: a slab across it holds the fewest points."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for file in side.files:
        place = file.find(("x",))
        if place is not None and isinstance(place[0], LasSource):
            header = place[0].header
            low, high = np.minimum(low, header.mins), np.maximum(high, header.maxs)
            continue
        for chunk in Side([file], KeyRule("place", AXES[0])).chunks(AXES):
            if chunk.n:
                xyz = np.stack([chunk.values[axis] for axis in AXES])
                low, high = np.minimum(low, xyz.min(axis=1)), np.maximum(high, xyz.max(axis=1))
    with np.errstate(over="ignore"):  # any number may stand in a file
        extent = high - low
    return AXES[int(np.argmax(np.where(np.isfinite(extent), extent, -1.0)))]


def _check_crs(left: Side, right: Side, counts: Counts) -> None:
    """Refuse coordinates of different systems."""
    named = [(file.codes.path, crs) for side in (left, right) for file in side.files if (crs := file.crs)]
    for (path, crs), (other_path, other) in pairwise(named):
        if not same_crs(crs, other):
            problem = f"coordinates in {short_crs(crs)}, but {other_path} has {short_crs(other)}"
            raise InputError(path, problem, "reproject one of them, or match by time or by a dimension")
    if len(named) < len(left.files) + len(right.files):
        counts.note("not every file names its coordinate system: taken to be the same")
