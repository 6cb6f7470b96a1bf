"""Joins label files into one confusion matrix: who is compared with whom, how, and in which parts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import I64
from prc_cli.evaluation.confusion import ConfusionMatrix, refuse_poor_match
from prc_cli.evaluation.intervals import FEW_BLOCKS, LEVEL, METHODS, block_intervals
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.result import Evaluation, Interval, MatchReport, SplitPart
from prc_cli.evaluation.splits import (
    UNKNOWN,
    GroupedCounts,
    block_groups,
    cells_of,
    check_edges,
    file_and_block,
    range_bounds,
    range_groups,
)
from prc_cli.formats.las.crs import same_crs, short_crs
from prc_cli.formats.las.read import LasSource
from prc_cli.matching.join import (
    CODE,
    KEY,
    SAME,
    Columns,
    JoinTally,
    UnsortedError,
    merge_join,
)
from prc_cli.matching.key_rule import AXES, KeyRule
from prc_cli.matching.keys import MutualKeys
from prc_cli.matching.pairs import files_of, pair_files, stem_of
from prc_cli.matching.places import NearestPlaces
from prc_cli.matching.sides import (
    FILE,
    LINE,
    RANGE,
    ROW,
    SCANNER,
    Side,
    SideFile,
)
from prc_cli.matching.streams import columns_of, in_step

TIME_TOLERANCE_S = 6e-7
"""Half a microsecond, as times in text are rounded, and the step of float64 at a thousand million seconds. Shots of a
scanner of up to 1 MHz lie further apart, so that none slips to its neighbour."""
NEAREST_TOLERANCE_M = 0.05
"""A few times the rounding of registered clouds. Pairs are nearest to each other, so that it may exceed the spacing."""
RECORDS_PER_LINE = 1000
"""Records that stand for a scan line in blocks of an input whose lines are not known."""
SPLITS = {RANGE: "range", LINE: "lines", SCANNER: "scanner"}


@dataclass(frozen=True, slots=True)
class EvaluateOptions:
    """How two sides are compared."""

    match: str = "order"
    """``order``; ``time``; ``dimension:NAME``, or ``dimension:PREDICTED=REFERENCE`` where the names differ; or
    ``nearest``. The dimension ``record`` is the record's index where a file has no such column (not in LAS)."""
    tolerance: float | None = None
    """Largest difference of a pair: seconds for ``time``, metres for ``nearest``; None = :data:`TIME_TOLERANCE_S`,
    :data:`NEAREST_TOLERANCE_M`."""
    min_matched: float = 0.5
    """Least share of the smaller side that must find a partner."""
    predicted_dimension: str | None = None
    """Column or dimension with the predicted codes; None = found by name."""
    reference_dimension: str | None = None
    """Column or dimension with the reference codes; None = found by name."""
    predicted_points: Path | None = None
    """The points that predicted labels alone belong to, record by record: the input of the run; or their folder."""
    reference_points: Path | None = None
    """The points that reference labels alone belong to, or their folder."""
    split_range_m: tuple[float, ...] = ()
    """Edges of range bins [m]; empty = not split."""
    split_lines: int | None = None
    """Scan lines of a part; None = not split."""
    split_scanner: bool = False
    """Whether scanners are told apart."""
    points_per_line: int | None = None
    """M, where records are shots of a dense stream: the line of record i is i // M."""
    intervals: str | None = None
    """``jackknife`` or ``bootstrap``; None = no intervals."""
    interval_lines: int = 99
    """Scan lines of a block that is left out or drawn as a whole."""
    seed: int = 1
    """Of the bootstrap."""
    one_to_one: bool = True
    """``nearest``: only pairs that are nearest to each other; else a reference record may serve several."""
    allow_missing: bool = False
    """Whether files of a folder that have no partner in the other one are left out instead of refused."""
    pool: bool = False
    """Whether all files of a side are one, whatever their names: tiles of one name that are cut differently."""


@dataclass(slots=True)
class _Counts:
    """Everything that is counted over all pairs of files."""

    mapping: ClassMapping
    parts: dict[str, GroupedCounts]
    """By split; ``all`` holds the one group of all pairs, ``blocks`` those of the intervals."""
    n_predicted: int = 0
    n_reference: int = 0
    n_matched: int = 0
    n_reference_matched: int = 0
    notes: dict[str, int] = field(default_factory=dict)
    """Sentences with ``{n}``, and how many records each is about; 0 for those without a number."""

    def note(self, sentence: str, n: int = 0) -> None:
        """Keep a sentence; the numbers of the same one add up."""
        if n or "{n}" not in sentence:
            self.notes[sentence] = self.notes.get(sentence, 0) + n


def evaluate_all(
    predicted: Sequence[Path],
    reference: Sequence[Path],
    mapping: ClassMapping | str | Path = "prc",
    *,
    options: EvaluateOptions | None = None,
) -> Evaluation:
    """Compare files and pool them into one matrix, in bounded memory.

    Parameters
    ----------
    predicted, reference : sequence of path
        As many on either side: the k-th of one is compared with the k-th of the other. Two folders: the files of one
        name (but for the suffix). A file against a folder, folders whose names differ, different numbers, or
        ``pool``, where the match is not by order: all files of a side are one, for example the tiles of a reference.
    mapping : ClassMapping, name or path
        Which codes mean which class on either side: a preset name, a TOML file or a mapping.
    options : EvaluateOptions, optional
        How records find their partner, what is split, and how intervals are found.

    Returns
    -------
    Evaluation
        The matrix of all pairs, how many records of either side found a partner, parts and intervals.

    Raises
    ------
    ConfigError
        Options that make no sense, or ask for what no file has.
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
    _check(options)
    found = mapping if isinstance(mapping, ClassMapping) else load_mapping(mapping)
    paths = [Path(path) for path in predicted], [Path(path) for path in reference]
    pools = _pools(*paths, options)
    counts = _Counts(found, {name: GroupedCounts(found, name) for name in ("all", *_asked(options))})
    # blocks of all pools are made alike: of lines where every pool knows its lines
    by_lines = all(LINE in (*left.dimensions, *right.dimensions) for left, right in pools)
    names: list[str] = []
    for left, right in pools:
        _compare(left, right, len(names), counts, options, by_lines=by_lines)
        names += [file.codes.path for file in left.files]
    if options.allow_missing:
        _note_missing(paths, pools, counts)
    matrix = counts.parts["all"].matrix(0)
    intervals, method = _intervals(counts, matrix, options, by_lines=by_lines)
    files = dict.fromkeys(names), dict.fromkeys(file.codes.path for _, pool in pools for file in pool.files)
    splits = {
        SPLITS[name]: _scored_parts(_parts(counts.parts[name], name, names, options), SPLITS[name], counts)
        for name in _asked(options)
        if name in SPLITS
    }
    match = MatchReport(
        options.match,
        counts.n_predicted,
        counts.n_reference,
        counts.n_matched,
        _tolerance(options),
        tuple(sentence.replace("{n}", str(n)) for sentence, n in counts.notes.items()),
        counts.n_reference_matched,
    )
    label = "" if isinstance(mapping, ClassMapping) else str(mapping)
    return Evaluation(tuple(files[0]), tuple(files[1]), label, match, matrix, splits, intervals, method)


def evaluate(
    predicted: Path | str,
    reference: Path | str,
    mapping: ClassMapping | str | Path = "prc",
    *,
    predicted_dimension: str | None = None,
    reference_dimension: str | None = None,
) -> ConfusionMatrix:
    """Compare two label files record by record.

    Parameters
    ----------
    predicted, reference : path
        Label files (``.npy``, ``.csv``, ``.parquet``), or any record file that carries codes.
    mapping : ClassMapping, name or path
        Which codes mean which class on either side: a preset name, a TOML file or a mapping.
    predicted_dimension, reference_dimension : str, optional
        Column or dimension that holds the codes; default ``class``, ``label`` or ``classification``.

    Raises
    ------
    InputError
        When the files hold different numbers of records: matched by order needs equal counts.
    """
    options = EvaluateOptions(predicted_dimension=predicted_dimension, reference_dimension=reference_dimension)
    return evaluate_all([Path(predicted)], [Path(reference)], mapping, options=options).matrix


def _check(options: EvaluateOptions) -> None:
    """Refuse options that make no sense."""
    kind, _, name = options.match.partition(":")
    if options.match not in ("order", "time", "nearest") and not (kind == "dimension" and name):
        problem = f"found {options.match!r}, expected one of: order, time, dimension:NAME, nearest"
        raise ConfigError("match", problem)
    tolerance = options.tolerance
    if tolerance is not None:
        if options.match not in ("time", "nearest"):
            raise ConfigError("tolerance", f"records matched by {options.match} have none", "leave it out")
        if not math.isfinite(tolerance) or tolerance < 0 or (tolerance == 0 and options.match == "nearest"):
            raise ConfigError("tolerance", f"found {tolerance:g}, expected a finite number above 0")
    if not options.one_to_one and options.match != "nearest":
        problem = f"records matched by {options.match} have one partner, --several asks for more"
        raise ConfigError("--several", problem, "leave it out, or give --match nearest")
    if options.pool and options.match == "order":
        raise ConfigError("pool", "records of pooled files have no order", "match by time, dimension or nearest")
    if not 0 <= options.min_matched <= 1:
        raise ConfigError("min_matched", f"found {options.min_matched:g}, expected a share from 0 to 1")
    if options.intervals is not None and options.intervals not in METHODS:
        raise ConfigError("intervals", f"found {options.intervals!r}, expected one of: {', '.join(METHODS)}")
    for key in ("split_lines", "points_per_line", "interval_lines"):
        value = getattr(options, key)
        if value is not None and value < 1:
            raise ConfigError(key, f"found {value}, expected at least 1")
    check_edges(options.split_range_m)


def _tolerance(options: EvaluateOptions) -> float | None:
    default = {"time": TIME_TOLERANCE_S, "nearest": NEAREST_TOLERANCE_M}.get(options.match)
    return default if options.tolerance is None else options.tolerance


def _asked(options: EvaluateOptions) -> tuple[str, ...]:
    """Return what is counted beside the whole."""
    asked = {
        RANGE: bool(options.split_range_m),
        LINE: options.split_lines is not None,
        SCANNER: options.split_scanner,
        "blocks": options.intervals is not None,
    }
    return tuple(name for name, wanted in asked.items() if wanted)


def _pools(predicted: list[Path], reference: list[Path], options: EvaluateOptions) -> list[tuple[Side, Side]]:
    """Return which files of either side are compared with which."""
    if not predicted or not reference:
        raise ConfigError("files", "found none on one side, expected predicted and reference files")
    for path in (*predicted, *reference):
        if not path.exists():
            raise InputError(str(path), "no such file or folder, expected class codes", "check the name")
    pooled: list[tuple[list[Path], list[Path]]] = []
    if options.pool:
        pooled.append((files_of(predicted), files_of(reference)))
    elif len(predicted) != len(reference):
        if options.match == "order":
            problem = f"found {len(predicted)} predicted and {len(reference)} reference files, expected as many"
            raise ConfigError("files", problem, "give pairs, or match by time, dimension or nearest")
        pooled.append((files_of(predicted), files_of(reference)))
    else:
        for one, other in zip(predicted, reference, strict=True):
            pooled += _pair(one, other, options)
    keys = _keys(options)
    pools = []
    for left, right in pooled:
        points = options.predicted_points, options.reference_points
        sides = [
            Side(_open(files, dimension, beside), key, options.points_per_line)
            for files, dimension, beside, key in zip(
                (left, right), (options.predicted_dimension, options.reference_dimension), points, keys, strict=True
            )
        ]
        for side in sides:
            side.check()
        pools.append((sides[0], sides[1]))
    return pools


def _pair(one: Path, other: Path, options: EvaluateOptions) -> list[tuple[list[Path], list[Path]]]:
    """Return the pairs of two files or folders, or all against all where names do not tell and keys do."""
    try:
        return [([a], [b]) for a, b in pair_files(one, other, allow_missing=options.allow_missing)]
    except InputError:
        if options.match == "order":
            raise
    return [(files_of([one]), files_of([other]))]


def _note_missing(paths: tuple[list[Path], list[Path]], pools: list[tuple[Side, Side]], counts: _Counts) -> None:
    """Name the files that were left out because they have no partner."""
    for k, side in enumerate(paths):
        used = {file.codes.path for pool in pools for file in pool[k].files}
        missing = [path.name for path in files_of(side) if str(path) not in used]
        if missing:
            shown = ", ".join(missing[:10]) + (", ..." if len(missing) > 10 else "")
            who = ("predicted", "reference")[k]
            have = "file has" if len(missing) == 1 else "files have"
            counts.note(f"{len(missing)} {who} {have} no partner, left out: {shown}")


def _keys(options: EvaluateOptions) -> tuple[KeyRule | None, KeyRule | None]:
    """Return what either side is read by; for ``nearest`` the axis is chosen later."""
    if options.match.startswith("dimension:"):
        left, _, right = options.match.removeprefix("dimension:").partition("=")
        return KeyRule("dimension", left), KeyRule("dimension", right or left)
    key = {"order": None, "time": KeyRule("time"), "nearest": KeyRule("place", AXES[0])}[options.match]
    return key, key


def _open(files: list[Path], dimension: str | None, points: Path | None) -> list[SideFile]:
    """Open the files of one side with the points that their labels belong to."""
    if points is None:
        return [SideFile.open(path, dimension, None) for path in files]
    if not points.is_dir():
        if len(files) > 1:
            problem = f"one file of points for {len(files)} files of labels, expected a folder"
            raise ConfigError(str(points), problem, "give the folder with the points of every file, of the same name")
        return [SideFile.open(files[0], dimension, points)]
    named = {stem_of(path): path for path in files_of([points])}
    missing = [path.name for path in files if stem_of(path) not in named]
    if missing:
        problem = f"no points for {', '.join(missing[:4])}, expected a file of the same name but for the suffix"
        raise InputError(str(points), problem, "name the folder of the run's inputs")
    return [SideFile.open(path, dimension, named[stem_of(path)]) for path in files]


def _compare(
    left: Side, right: Side, first_file: int, counts: _Counts, options: EvaluateOptions, *, by_lines: bool
) -> None:
    """Match one pool of files and count its pairs."""
    plan = _plan(left, right, options, by_lines=by_lines)
    mapping = counts.mapping
    for name in plan.theirs:
        counts.note(f"{SPLITS[name]}: taken from the reference")
    if options.match == "nearest":
        _check_crs(left, right, counts)
        key = KeyRule("place", _longest_axis(right))
        left, right = replace(left, key=key), replace(right, key=key)
    on_disk = [options.match == "nearest"] * 2
    while True:
        found = {name: GroupedCounts(mapping, name) for name in counts.parts}
        tally = JoinTally()
        try:
            for one, other in _pairs(left, right, plan, tally, on_disk, options):
                beside = {name: other[name] for name in plan.theirs} | {name: one[name] for name in plan.ours}
                if FILE in beside:
                    beside[FILE] = beside[FILE] + first_file
                _count(found, beside, cells_of(mapping, one[CODE], other[CODE]), options, by_lines=by_lines)
        except UnsortedError as error:
            # most streams are in order and need no disk: that one is not shows on the way, and all is done again
            on_disk[error.side] = True
            continue
        break
    for name, part in found.items():
        counts.parts[name].merge(part)
    _report(left, right, tally, counts, options)


@dataclass(frozen=True, slots=True)
class _Plan:
    """Columns beside the codes, by the side they are taken from."""

    ours: tuple[str, ...]
    theirs: tuple[str, ...]
    keys: tuple[str, ...]
    """Columns that the match itself needs, of both sides."""


def _plan(left: Side, right: Side, options: EvaluateOptions, *, by_lines: bool) -> _Plan:
    has, other_has, asked = left.dimensions, right.dimensions, _asked(options)
    wanted = dict.fromkeys(LINE if name == "blocks" else name for name in asked if name != "blocks" or by_lines)
    for name in wanted:
        if name not in (*has, *other_has) and name in asked:
            problem = f"no {SPLITS[name]} to split by in {left.path} or {right.path}"
            hint = "give -M, or --predicted-points with the points of the labels"
            raise ConfigError(f"split by {SPLITS[name]}", problem, hint)
    ours = [name for name in wanted if name in has]
    theirs = [name for name in wanted if name not in has and name in other_has]
    if "blocks" in asked or LINE in asked:
        ours += [FILE, ROW]
    keys: tuple[str, ...] = () if options.match == "order" else (KEY,)
    if options.match == "nearest":
        keys = (KEY, *AXES)
    elif options.match == "time" and SAME in has and SAME in other_has:
        keys = (KEY, SAME)
    return _Plan(tuple(ours), tuple(theirs), keys)


def _pairs(
    left: Side, right: Side, plan: _Plan, tally: JoinTally, on_disk: Sequence[bool], options: EvaluateOptions
) -> Iterator[tuple[Columns, Columns]]:
    """Start the match."""
    columns = (CODE, *plan.keys, *plan.ours), (CODE, *plan.keys, *plan.theirs)
    one, other = (
        columns_of(side, names, sort=sort) for side, names, sort in zip((left, right), columns, on_disk, strict=True)
    )
    names = left.path, right.path
    if options.match == "order":
        for pair in in_step((one, other), lambda n: refuse_poor_match(n[0], n[1], *names)):
            tally.n_pairs += len(pair[0][CODE])
            tally.n_right += len(pair[0][CODE])
            yield pair[0], pair[1]
        return
    tolerance = _tolerance(options) or 0.0
    match = NearestPlaces(tolerance, options.one_to_one) if options.match == "nearest" else MutualKeys(tolerance)
    for joined in merge_join(one, other, match, tolerance, tally, names):
        yield joined.pairs()


def _count(
    found: dict[str, GroupedCounts], beside: Columns, cells: I64, options: EvaluateOptions, *, by_lines: bool
) -> None:
    """Add pairs to the whole and to every part."""
    found["all"].add(np.zeros(len(cells), np.int64), cells)
    if RANGE in found:
        found[RANGE].add(range_groups(beside[RANGE], check_edges(options.split_range_m)), cells)
    if LINE in found and options.split_lines is not None:
        found[LINE].add(block_groups(beside[FILE], beside[LINE], options.split_lines), cells)
    if SCANNER in found:
        found[SCANNER].add(beside[SCANNER], cells)
    if "blocks" in found:
        index = beside[LINE if by_lines else ROW]
        per_block = options.interval_lines * (1 if by_lines else RECORDS_PER_LINE)
        found["blocks"].add(block_groups(beside[FILE], index, per_block), cells)


def _report(left: Side, right: Side, tally: JoinTally, counts: _Counts, options: EvaluateOptions) -> None:
    """Add up who found a partner, say what was left out, and refuse a poor match."""
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
    shared = "places" if options.match == "nearest" else f"{options.match}s" if options.match == "time" else "ids"
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
    ours, theirs = left.tally.n_usable, right.tally.n_usable
    found, of = (tally.n_pairs, ours) if ours <= theirs else (tally.n_right, theirs)
    if found and found >= options.min_matched * of:
        return
    smaller = left.path if ours <= theirs else right.path
    share = f"{found} of its {of} records found a partner in {right.path if ours <= theirs else left.path}"
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
    raise InputError(smaller, share, hints.get(options.match, "check that the ids come from one run"))


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
    extent = high - low
    return AXES[int(np.argmax(np.where(np.isfinite(extent), extent, -1.0)))]


def _check_crs(left: Side, right: Side, counts: _Counts) -> None:
    """Refuse coordinates of different systems."""
    named = [(file.codes.path, crs) for side in (left, right) for file in side.files if (crs := file.crs)]
    for (path, crs), (other_path, other) in pairwise(named):
        if not same_crs(crs, other):
            problem = f"coordinates in {short_crs(crs)}, but {other_path} has {short_crs(other)}"
            raise InputError(path, problem, "reproject one of them, or match by time or by a dimension")
    if len(named) < len(left.files) + len(right.files):
        counts.note("not every file names its coordinate system: taken to be the same")


def _parts(counts: GroupedCounts, name: str, files: Sequence[str], options: EvaluateOptions) -> tuple[SplitPart, ...]:
    """Return the parts of a split in order, those of unknown place last."""
    parts = []
    edges = check_edges(options.split_range_m)
    groups = [group for group in counts.groups if group != UNKNOWN]
    if name == RANGE:
        below = [] if edges[0] == 0 else [0]
        groups = [*below, *range(1, len(edges) + 1)]
    for group in groups:
        if name == RANGE:
            shown, low, high = range_bounds(group, edges)
        elif name == LINE and options.split_lines is not None:
            file, block = file_and_block(group)
            first = block * options.split_lines
            low, high = float(first), float(first + options.split_lines)
            prefix = f"{Path(files[file]).name} " if len(files) > 1 else ""
            shown = f"{prefix}lines {first}-{first + options.split_lines - 1}"
        else:
            shown, low, high = f"scanner {group}", float(group), float(group + 1)
        parts.append(SplitPart(shown, low, high, counts.matrix(group)))
    if UNKNOWN in counts.groups:
        parts.append(SplitPart("unknown", math.nan, math.nan, counts.matrix(UNKNOWN)))
    return tuple(parts)


def _scored_parts(parts: Sequence[SplitPart], split: str, counts: _Counts) -> tuple[SplitPart, ...]:
    """Leave out parts that have nothing to say, and note how many records they ignore."""
    empty = [part for part in parts if not part.matrix.n_scored]
    if empty:
        n_ignored = sum(part.matrix.n_ignored for part in empty)
        many = (
            "1 part without scored records is" if len(empty) == 1 else f"{len(empty)} parts without scored records are"
        )
        counts.note(f"by {split}: {many} left out, with {n_ignored} ignored records")
    return tuple(part for part in parts if part.matrix.n_scored)


def _intervals(
    counts: _Counts, matrix: ConfusionMatrix, options: EvaluateOptions, *, by_lines: bool
) -> tuple[dict[str, Interval], str]:
    """Return intervals of all scores and how they were found."""
    if options.intervals is None:
        return {}, ""
    blocks = counts.parts["blocks"].scored()
    names = matrix.reference_names, matrix.predicted_names
    found = block_intervals(blocks, names, options.intervals, options.seed)
    unit = "scan lines" if by_lines else "records"
    size = options.interval_lines * (1 if by_lines else RECORDS_PER_LINE)
    seeded = f", seed {options.seed}" if options.intervals == "bootstrap" else ""
    few = "; few blocks, take them as rough" if len(blocks) < FEW_BLOCKS else ""
    method = f"block {options.intervals}, {len(blocks)} blocks of {size} {unit}{seeded}, {100 * LEVEL:g} %{few}"
    return found, method
