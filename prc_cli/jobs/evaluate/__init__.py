"""Compares label files: matches their records and counts the pairs, in all and in parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import I64
from prc_cli.core.window import Window
from prc_cli.evaluation.confusion import ConfusionMatrix, GroupedCounts, refuse_poor_match
from prc_cli.evaluation.mapping import ClassMapping, UnlistedError, load_mapping
from prc_cli.evaluation.scores import Evaluation, MatchReport, ThreeCounts
from prc_cli.formats.labels import labelled_records, open_codes
from prc_cli.formats.las.read import LasSource
from prc_cli.formats.writing.disk import scratch_file
from prc_cli.jobs.coordinates import placed_source
from prc_cli.jobs.evaluate.counts import (
    SPLITS,
    Compared,
    Counting,
    Counts,
    Plan,
    asked_parts,
    intervals_of,
    reliability_notes,
    scored_parts,
)
from prc_cli.jobs.evaluate.options import (
    PLACE_BY_POSES,
    EvaluateOptions,
    check_options,
    mapping_of_runs,
    tolerance_of,
)
from prc_cli.jobs.evaluate.places import (
    PLACE_COLUMNS,
    PREDICTED_COLUMNS,
    PairFile,
    listed_places,
)
from prc_cli.jobs.evaluate.registered import Registered
from prc_cli.matching.join import (
    CODE,
    KEY,
    RECORD,
    SAME,
    Columns,
    JoinTally,
    UnsortedError,
    columns_of,
    in_step,
    merge_join,
)
from prc_cli.matching.keys import AXES, KeyRule, MutualKeys
from prc_cli.matching.pairs import files_of, pair_files, stem_of
from prc_cli.matching.sides import (
    COLUMN,
    CONFIDENCE,
    FILE,
    LINE,
    RANGE,
    ROW,
    SECONDS,
    Side,
    SideFile,
)

APART_M = 0.5
"""Ranges of one cell that differ by more are not of one shot [m]."""
MOST_APART = 0.25
"""Largest share of such cells; two scans of one street have a share of 0.38."""


def open_pools(
    predicted: list[Path], reference: list[Path], options: EvaluateOptions
) -> list[tuple[Side, Side]]:
    """Return the pairs of sides to compare."""
    if not predicted or not reference:
        raise ConfigError("files", "found none on one side, expected predicted and reference files")
    for path in (*predicted, *reference):
        if not path.exists():
            raise InputError(
                str(path), "no such file or folder, expected class codes", "check the name"
            )
    pooled: list[tuple[list[Path], list[Path]]] = []
    if options.pool:
        pooled.append((files_of(predicted), files_of(reference)))
    elif len(predicted) != len(reference):
        if options.match == "order":
            problem = (
                f"found {len(predicted)} predicted and {len(reference)} reference files, "
                "expected as many"
            )
            raise ConfigError(
                "files", problem, "give pairs, or match by time, dimension or nearest"
            )
        pooled.append((files_of(predicted), files_of(reference)))
    else:
        for predicted_path, reference_path in zip(predicted, reference, strict=True):
            pooled += _pair(predicted_path, reference_path, options)
    left_key, right_key = _keys(options)
    m = options.points_per_line
    pools = []
    for left_files, right_files in pooled:
        opened = _open(left_files, options.predicted_dimension, options.predicted_points)
        left = Side(opened, left_key, m)
        opened = _open(right_files, options.reference_dimension, options.reference_points)
        right = Side(opened, right_key, m)
        if options.trajectory is not None:
            crs = next((crs for file in right.files if (crs := file.crs)), None)
            left = replace(left, files=[_placed(file, options, crs) for file in left.files])
        left.check()
        right.check()
        pools.append((left, right))
    return pools


def open_side(path: Path, options: EvaluateOptions, key: KeyRule | None) -> Side:
    """Open a third labelling, a file or a folder."""
    if not path.exists():
        raise InputError(
            str(path), "no such file or folder, expected class codes", "check the name"
        )
    side = Side(_open(files_of([path]), None, None), key, options.points_per_line)
    side.check()
    return side


def _placed(file: SideFile, options: EvaluateOptions, crs: str | None) -> SideFile:
    # a predicted file with coordinates from the poses and the ranges of the drive
    assert options.trajectory is not None
    labels = Path(file.codes.path)
    drive = labels if file.points is None else Path(file.points.path)
    source = placed_source(drive, labels, options.trajectory, options.mount, crs=crs)
    return replace(file, table=None, points=source)


def _pair(
    predicted: Path, reference: Path, options: EvaluateOptions
) -> list[tuple[list[Path], list[Path]]]:
    # one pool of all files if their names do not pair and records are matched by a key
    try:
        pairs = pair_files(predicted, reference, allow_missing=options.allow_missing)
    except InputError:
        if options.match == "order":
            raise
        return [(files_of([predicted]), files_of([reference]))]
    return [([left], [right]) for left, right in pairs]


def _keys(options: EvaluateOptions) -> tuple[KeyRule | None, KeyRule | None]:
    if options.match.startswith("dimension:"):
        left, _, right = options.match.removeprefix("dimension:").partition("=")
        return KeyRule("dimension", left), KeyRule("dimension", right or left)
    keys = {"order": None, "time": KeyRule("time"), "nearest": KeyRule("place", AXES[0])}
    return keys[options.match], keys[options.match]


def _open(files: list[Path], dimension: str | None, points: Path | None) -> list[SideFile]:
    if points is None:
        return [SideFile.open(path, dimension, None) for path in files]
    if not points.is_dir():
        if len(files) > 1:
            problem = f"one file of points for {len(files)} files of labels, expected a folder"
            hint = "give the folder with the points of every file, of the same name"
            raise ConfigError(str(points), problem, hint)
        return [SideFile.open(files[0], dimension, points)]
    named = {stem_of(path): path for path in files_of([points])}
    missing = [path.name for path in files if stem_of(path) not in named]
    if missing:
        problem = (
            f"no points for {', '.join(missing[:4])}, "
            "expected a file of the same name but for the suffix"
        )
        raise InputError(str(points), problem, "name the folder of the run's inputs")
    return [SideFile.open(path, dimension, named[stem_of(path)]) for path in files]


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
        As many on either side: file k of one is compared with file k of the other. Of two folders,
        files with the same name (except the suffix) are compared. With ``pool``, all files of a
        side are compared as one, for example tiles. The same happens if files cannot be paired (a
        file and a folder, different names or numbers) and the match is not by order.
    mapping : ClassMapping, name or path, optional
        The classes of the codes on either side: a preset name, a TOML file or a mapping. Default:
        the preset that fits the method in the run records beside the predicted files and the codes
        of the reference, else ``prc``.
    options : EvaluateOptions, optional
        How records are matched, which splits are computed, and how intervals are computed.

    Returns
    -------
    Evaluation
        Matrix of all pairs, number of matched records on either side, parts and intervals.

    Raises
    ------
    ConfigError
        Invalid options, or options that need columns which the files do not have.
    InputError
        A damaged file; different counts (``order``), too few records with a partner, or different
        coordinate systems (``nearest``).

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
    with ExitStack() as stack:
        pair_file = None
        if options.places and options.place_pictures:
            pair_file = PairFile(stack.enter_context(scratch_file("places")))
        return _evaluate_all(predicted, reference, mapping, options, pair_file)


def _evaluate_all(
    predicted: Sequence[Path],
    reference: Sequence[Path],
    mapping: ClassMapping | str | Path | None,
    options: EvaluateOptions,
    pair_file: PairFile | None,
) -> Evaluation:
    why = ""
    paths = [Path(path) for path in predicted], [Path(path) for path in reference]
    if mapping is None:
        mapping, why = mapping_of_runs(
            files_of(paths[0]), files_of(paths[1]), options.reference_dimension
        )
    classes = mapping if isinstance(mapping, ClassMapping) else load_mapping(mapping)
    pools = open_pools(*paths, options)
    parts = {name: GroupedCounts(classes, name) for name in ("all", *asked_parts(options))}
    counts = Counts(classes, parts, pair_file=pair_file)
    if options.third is not None:
        third_classes = classes
        if options.third_mapping is not None:
            third_classes = load_mapping(options.third_mapping)
        counts.third = ThreeCounts(classes, third_classes)
    if why:
        counts.note(f"class mapping {mapping}: {why}")
    # blocks are counted in lines only if the lines of every pool are known
    by_lines = all(LINE in (*left.dimensions, *right.dimensions) for left, right in pools)
    names: list[str] = []
    matches: list[str] = []
    for left, right in pools:
        try:
            matches.append(_compare(left, right, len(names), counts, options, by_lines=by_lines))
        except UnlistedError as error:
            side = left if error.side == "predicted" else right
            codes = (
                codes
                for file in side.files
                for codes in open_codes(Path(file.codes.path), file.name).codes()
            )
            raise UnlistedError.of(error.mapping, error.side, codes) from error
        names += [file.codes.path for file in left.files]
    if options.allow_missing:
        _note_missing("predicted", paths[0], [left for left, _ in pools], counts)
        _note_missing("reference", paths[1], [right for _, right in pools], counts)
    if CONFIDENCE in counts.parts:
        for sentence in reliability_notes(counts.parts[CONFIDENCE]):
            counts.note(sentence)
    counts.fold()
    matrix = counts.parts["all"].matrix(0)
    if not matrix.counts.any():
        problem = (
            f"none of {counts.n_matched} records has a class to score: "
            "code 0, or codes that the mapping ignores"
        )
        hint = "name the dimension with the codes: --dimension reference=NAME"
        raise InputError(str(paths[1][0]), problem, hint)
    intervals, method = intervals_of(counts, matrix, options, by_lines=by_lines)
    reference_names = dict.fromkeys(file.codes.path for _, side in pools for file in side.files)
    splits = {
        SPLITS[name]: scored_parts(counts, name, names, options)
        for name in asked_parts(options)
        if name in SPLITS
    }
    tolerance = max(counts.tolerances) if counts.tolerances else tolerance_of(options)
    number = "{:,}" if options.match == "nearest" else "{}"
    notes = tuple(sentence.replace("{n}", number.format(n)) for sentence, n in counts.notes.items())
    match = MatchReport(
        " and ".join(dict.fromkeys(matches)),
        counts.n_predicted,
        counts.n_reference,
        counts.n_matched,
        tolerance,
        notes,
        counts.n_reference_matched,
    )
    label = "" if isinstance(mapping, ClassMapping) else str(mapping)
    three = None if counts.third is None else counts.third.result(str(options.third))
    plan = counts.plan.picture() if three is not None else None
    places = None
    if options.places:
        kept = [
            place
            for place in counts.places
            if counts.folded.get(place.predicted, place.predicted) != place.reference
        ]
        places = listed_places(kept, counts.n_differ, names, pools, pair_file, classes)
    return Evaluation(
        tuple(dict.fromkeys(names)),
        tuple(reference_names),
        label,
        match,
        matrix,
        splits,
        intervals,
        method,
        three,
        plan,
        places,
    )


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
        Label files (``.npy``, ``.csv``, ``.parquet``), or any record file with codes.
    mapping : ClassMapping, name or path, optional
        As for :func:`evaluate_all`.
    predicted_dimension, reference_dimension : str, optional
        Column or dimension with the codes; default ``class``, ``label`` or ``classification``.

    Raises
    ------
    InputError
        If the files have different numbers of records, and one has no cells of its records.
    """
    options = EvaluateOptions(
        predicted_dimension=predicted_dimension, reference_dimension=reference_dimension
    )
    return evaluate_all([Path(predicted)], [Path(reference)], mapping, options=options).matrix


def _note_missing(name: str, paths: list[Path], sides: list[Side], counts: Counts) -> None:
    used = {file.codes.path for side in sides for file in side.files}
    missing = [path.name for path in files_of(paths) if str(path) not in used]
    if missing:
        shown = ", ".join(missing[:10]) + (", ..." if len(missing) > 10 else "")
        files_have = "file has" if len(missing) == 1 else "files have"
        counts.note(f"{len(missing)} {name} {files_have} no partner, left out: {shown}")


def _with_stored_lines(left: Side, right: Side, counts: Counts) -> tuple[Side, Side]:
    # if a side has a column of lines, M is not used
    bare = replace(left, points_per_line=None), replace(right, points_per_line=None)
    if left.points_per_line is None or not any(LINE in side.dimensions for side in bare):
        return left, right
    counts.note(f"lines: a column of the files; -M {left.points_per_line} is not used")
    return bare


def _with_dense_lines(side: Side, options: EvaluateOptions) -> Side:
    """Return labels with the M of their run records, if these say that every shot has a label."""
    lengths = {file.dense_line for file in side.files}
    is_known = side.points_per_line is not None or LINE in side.dimensions
    if not options.places or is_known or len(lengths) != 1:
        return side
    return replace(side, points_per_line=lengths.pop())


def _compare(
    left: Side,
    right: Side,
    first_file: int,
    counts: Counts,
    options: EvaluateOptions,
    *,
    by_lines: bool,
) -> str:
    """Match one pool of files and count its pairs; return how they were matched."""
    left, right = _with_stored_lines(left, right, counts)
    left = _with_dense_lines(left, options)
    if options.match == "order" and (by_hand := _by_hand(left, right)) is not None:
        left, right = by_hand
        options = replace(options, match=_UnsortedRecordsError.match)
        counts.note("labels by hand: matched by record number, other shots are not scored")
    plan = _plan(left, right, options, by_lines=by_lines)
    for name in plan.noted:
        counts.note(f"{SPLITS.get(name, name)}: taken from the reference")
    third = None if options.third is None else open_side(options.third, options, left.key)
    on_disk = [False, False]
    registered: Registered | None = None
    while True:
        counts.restart_pairs()
        counting = Counting(counts, options, plan, first_file, by_lines=by_lines)
        tally = JoinTally()
        if options.match == "nearest":
            registered = Registered(left, right, options, counts)
            pairs = registered.pairs(plan, tally, third)
        else:
            pairs = _pairs(left, right, plan, tally, on_disk, options, counts.mapping, third)
        try:
            n_apart = 0
            for compared in pairs:
                counting.add(compared)
                if RANGE in compared.predicted and RANGE in compared.reference:
                    step_m = compared.predicted[RANGE] - compared.reference[RANGE]
                    n_apart += int(np.count_nonzero(np.abs(step_m) > APART_M))
        except _UnequalError as error:
            counts.note(f"the files hold other records, or others first: matched by {error.words}")
            options = replace(options, match=error.match)
            left, right = _keyed(left, right, error.key)
            plan = _plan(left, right, options, by_lines=by_lines)
            continue
        except UnsortedError as error:
            # most streams are sorted; if not, sort on disk and start the match again
            on_disk[error.side] = True
            continue
        break
    counting.finish(left.path)
    if n_apart > MOST_APART * tally.n_pairs:
        problem = (
            f"{n_apart} of {tally.n_pairs} shots have other ranges than in {right.path}: "
            "another scan"
        )
        raise InputError(left.path, problem, "give both files of the same one")
    _report(left, right, tally, counts, options)
    n_left = left.tally.n_usable
    n_right = right.tally.n_usable
    if registered is not None:
        counts.tolerances.add(registered.tolerance)
        registered.report(tally)
        n_left -= registered.n_cut
        n_right -= registered.n_beside
    if options.match != "order":
        _refuse_poor(left, right, n_left, n_right, tally, options)
    return options.match


def _by_hand(left: Side, right: Side) -> tuple[Side, Side] | None:
    """Return sides that are matched by record, if the reference is labels by hand of such a file.

    Otherwise they are matched like other files: by cell if their lengths differ.
    """
    if len(left.files) != 1 or len(right.files) != 1:
        return None
    n_records = labelled_records(Path(right.files[0].codes.path))
    if n_records is None:
        return None
    file = left.files[0]
    is_las = isinstance(file.table, LasSource)
    known = {_length_of(left), n_records} - {None, 0}
    if len(known) > 1 and not right.files[0].has_cells:
        problem = f"labels by hand of a file of {n_records} records, found {_length_of(left)}"
        raise InputError(right.path, f"{problem} in {left.path}", "give the file that was painted")
    if len(known) > 1 or (is_las and not n_records):
        return None
    left = replace(left, files=[replace(file, is_whole=True)])
    return _keyed(left, right, _UnsortedRecordsError.key)


def _keyed(left: Side, right: Side, key: KeyRule) -> tuple[Side, Side]:
    return replace(left, key=key), replace(right, key=key)


class _UnequalError(Exception):
    """Files to match by order differ in length or order, but both have a key."""

    words = "cell (scan line, column)"
    match = "cell"
    key = KeyRule("cell")


class _UnsortedRecordsError(_UnequalError):
    """Rows are not in the order of their record numbers."""

    words = "record number"
    match = f"dimension:{RECORD}"
    key = KeyRule("dimension", RECORD)


def _plan(
    left: Side,
    right: Side,
    options: EvaluateOptions,
    *,
    by_lines: bool,
) -> Plan:
    left_has = left.dimensions
    right_has = right.dimensions
    asked = asked_parts(options)
    columns = dict.fromkeys(
        LINE if name == "blocks" else name for name in asked if name != "blocks" or by_lines
    )
    if options.window is not None:
        column = LINE if options.window.in_lines else SECONDS
        columns[column] = None
        if column not in (*left_has, *right_has):
            raise _no_place(left, right, options.window)
    for name in columns:
        if name != CONFIDENCE and name not in (*left_has, *right_has) and name in asked:
            problem = f"no {SPLITS[name]} to split by in {left.path} or {right.path}"
            hint = "give -M, or --points with the points of the labels"
            raise ConfigError(f"split by {SPLITS[name]}", problem, hint)
    if CONFIDENCE in columns and CONFIDENCE not in left_has:
        problem = f"no confidence in {left.path}, expected a dimension or column of this name"
        hint = "classify again with --set output.confidence=true, to .las, .laz, .csv or .parquet"
        raise ConfigError("--by confidence", problem, hint)
    shared = {RANGE}.intersection(left_has, right_has) if options.match == "cell" else set()
    predicted = [name for name in {**columns, **dict.fromkeys(shared)} if name in left_has]
    only_right = [name for name in columns if name not in left_has and name in right_has]
    reference = [*shared, *only_right]
    if "blocks" in asked or LINE in asked or options.places:
        predicted += [FILE, ROW]
    in_space = False
    noted = tuple(reference)
    if options.places:
        in_space = _add_place_columns(predicted, reference, left, right, options)
    keys: tuple[str, ...] = () if options.match == "order" else (KEY,)
    if options.match in ("time", "cell") and SAME in left_has and SAME in right_has:
        keys = (KEY, SAME)
    return Plan(tuple(predicted), tuple(reference), keys, noted, in_space)


def _add_place_columns(
    predicted: list[str],
    reference: list[str],
    left: Side,
    right: Side,
    options: EvaluateOptions,
) -> bool:
    """Add the columns of places to those read of both sides; return whether places are in space."""
    left_has = left.dimensions
    shown = (*PLACE_COLUMNS, RANGE) if options.place_pictures else PLACE_COLUMNS
    for name in (*shown, *PREDICTED_COLUMNS):
        if name in left_has and name not in predicted:
            predicted.append(name)
    for name in shown:
        if name not in left_has and name in right.dimensions and name not in reference:
            reference.append(name)
    read = {*predicted, *reference}
    in_space = options.match == "nearest" or not {LINE, COLUMN} <= read
    if in_space and not set(AXES) <= read:
        problem = f"no scan lines and columns, and no coordinates in {left.path}"
        hint = "give -M, or --points with the points of the labels"
        raise ConfigError("--places", problem, hint)
    return in_space


def _no_place(left: Side, right: Side, window: Window) -> ConfigError:
    values = "scan lines" if window.in_lines else "times"
    problem = f"no {values} in {left.path} or {right.path}, expected them for {window.option}"
    hint = "give --points with the points of the labels"
    if window.in_lines:
        hint += ", or -M"
    return ConfigError("window", problem, hint)


def _pairs(
    left: Side,
    right: Side,
    plan: Plan,
    tally: JoinTally,
    on_disk: Sequence[bool],
    options: EvaluateOptions,
    mapping: ClassMapping,
    third: Side | None,
) -> Iterator[Compared]:
    """Yield records with their partners by order or by key."""
    if options.match == "order":
        pairs = _in_order(left, right, plan, tally, third)
    else:
        tolerance = tolerance_of(options) or 0.0
        names = (CODE, *plan.keys)
        lefts = columns_of(left, (*names, *plan.predicted), sort=on_disk[0], with_record=False)
        rights = columns_of(right, (*names, *plan.reference), sort=on_disk[1], with_record=False)
        match = MutualKeys(tolerance)
        joined = merge_join(lefts, rights, match, tolerance, tally, left.path, right.path)
        pairs = ((*matched.pairs(), None) for matched in joined)
    for predicted, partners, third_codes in pairs:
        rows = mapping.class_indices(partners[CODE], "reference")
        reference = {name: partners[name] for name in plan.reference}
        yield Compared(predicted, reference, rows, third_codes)


def _in_order(
    left: Side,
    right: Side,
    plan: Plan,
    tally: JoinTally,
    third: Side | None,
) -> Iterator[tuple[Columns, Columns, I64 | None]]:
    """Yield predicted records, reference records and third codes of the same number.

    Refuse sides of different lengths, or with different cells.
    """
    knows_cells = all(len(side.files) == 1 and side.files[0].knows_cells for side in (left, right))
    compared = knows_cells and any(side.files[0].has_cells for side in (left, right))
    if compared:
        left, right = _keyed(left, right, KeyRule("cell"))
    numbered = not compared and _know_records(left, right)
    if numbered:
        left, right = _keyed(left, right, _UnsortedRecordsError.key)
    keys = (CODE, KEY) if compared or numbered else (CODE,)
    asked = [(left, (*keys, *plan.predicted)), (right, (*keys, *plan.reference))]
    if third is not None:
        asked.append((third, (CODE,)))
    streams = [columns_of(side, names, sort=False, with_record=False) for side, names in asked]

    def check(n: Sequence[int]) -> None:
        if n[0] != n[1] and knows_cells:
            raise _UnequalError
        for n_side, side in zip(n[1:], (right, third), strict=False):
            hint = _hint_for_registered(left, right)
            refuse_poor_match(n[0], n_side, left.path, side.path if side else "", hint)

    lengths = [_length_of(side) for side, _ in asked]
    if None not in lengths:  # before a file is read
        check([length or 0 for length in lengths])
    first_step = None
    for predicted, reference, *others in in_step(streams, check):
        if (compared or numbered) and len(predicted[KEY]):
            # the files may count cells and records from different numbers
            step = reference[KEY] - predicted[KEY]
            first_step = step[0] if first_step is None else first_step
            if np.any(step != first_step):
                if numbered and third is not None:
                    problem = "rows are not in the order of their record numbers"
                    raise InputError(
                        left.path, problem, "sort them by record in all files, or leave --third out"
                    )
                raise _UnsortedRecordsError if numbered else _UnequalError
        tally.n_pairs += len(predicted[CODE])
        tally.n_right += len(predicted[CODE])
        yield predicted, reference, others[0][CODE] if others else None


def _hint_for_registered(left: Side, right: Side) -> str:
    # empty if the reference has no coordinates
    if not set(AXES) <= set(right.dimensions):
        return ""
    points = ""
    if not set(AXES) <= set(left.dimensions):
        points = " --points INPUT, the file that was classified"
    elif _share_area(left, right):
        files = f"{left.files[0].codes.path} {right.files[0].codes.path}"
        return f"both have coordinates of one area: prc evaluate {files} --match nearest"
    hint = f"if {right.path} holds registered points (CAR), add --match nearest{points}"
    times = {SECONDS} <= {*left.dimensions} & {*right.dimensions}
    return f"{hint}; if both hold times of one clock: --match time" if times else hint


def _share_area(left: Side, right: Side) -> bool:
    """Return whether the coordinates of two sides overlap in the plan; reads both."""
    boxes = []
    for side in (left, right):
        low = np.full(2, np.inf)
        high = np.full(2, -np.inf)
        for chunk in side.chunks(("x", "y")):
            places = np.stack([chunk.values["x"], chunk.values["y"]])
            places = places[:, np.isfinite(places).all(axis=0)]
            low = np.minimum(low, places.min(axis=1, initial=np.inf))
            high = np.maximum(high, places.max(axis=1, initial=-np.inf))
        boxes.append((low, high))
    (low, high), (other_low, other_high) = boxes
    return bool((low <= other_high).all() and (other_low <= high).all())


def _length_of(side: Side) -> int | None:
    # by the headers of all files; None if a header does not say
    lengths = [file.codes.n_records for file in side.files]
    return None if None in lengths else sum(length or 0 for length in lengths)


def _know_records(left: Side, right: Side) -> bool:
    # rows of a side have record numbers, and rows of the other have them, too, or can be counted
    if any(len(side.files) != 1 for side in (left, right)):
        return False
    numbered = [side.files[0].find((RECORD,)) is not None for side in (left, right)]
    if not any(numbered):
        return False
    counted = [not isinstance(side.files[0].table, LasSource) for side in (left, right)]
    if all(known or counts for known, counts in zip(numbered, counted, strict=True)):
        return True
    side = left if numbered[0] else right
    _refuse_unsorted(side)
    return False


def _refuse_unsorted(side: Side) -> None:
    side = replace(side, key=_UnsortedRecordsError.key)
    first_step = None
    for values in columns_of(side, (KEY, ROW), sort=False, with_record=False):
        if len(values[KEY]):
            step = values[KEY] - values[ROW]
            first_step = step[0] if first_step is None else first_step
            if np.any(step != first_step):
                problem = (
                    "rows are not in the order of their record numbers, and the other file has none"
                )
                raise InputError(
                    side.path, problem, "sort them by record, or match by time or nearest"
                )


def _report(
    left: Side,
    right: Side,
    tally: JoinTally,
    counts: Counts,
    options: EvaluateOptions,
) -> None:
    """Add up the match counts, and note the records that were left out."""
    counts.n_predicted += left.tally.n_records
    counts.n_reference += right.tally.n_records
    counts.n_matched += tally.n_pairs
    counts.n_reference_matched += tally.n_right
    if options.match == "order":
        return
    keys = "coordinates" if options.match == "nearest" else options.match
    for side, name in ((left, "predicted"), (right, "reference")):
        counts.note(
            f"{{n}} {name} records have no finite {keys}: left out", side.tally.n_not_finite
        )
        if not side.tally.n_usable:
            problem = f"no record has finite {keys}, expected them to match by"
            raise InputError(side.path, problem, "check the file")
    shared = {"nearest": "places", "time": "times", "cell": "cells"}.get(options.match, "ids")
    counts.note(
        f"{{n}} predicted records share their {shared} with another number of reference records: "
        "which is which cannot be told, left out",
        tally.n_ambiguous,
    )
    counts.note(
        f"{{n}} pairs share their {shared} with other pairs: paired in their order",
        tally.n_in_order,
    )
    if options.match == "time" and not (SAME in left.dimensions and SAME in right.dimensions):
        counts.note("return numbers are not on both sides: not compared")


def _refuse_other_scan(side: Side, partner: Side) -> None:
    # if a side fills its grid, no record of its partner can be outside the grid
    grid = side.tally
    cells = partner.tally
    if grid.n_usable <= (grid.n_lines - 1) * grid.n_columns:
        return
    if cells.n_lines > grid.n_lines or cells.n_columns > grid.n_columns:
        problem = (
            f"its records lie in {cells.n_lines} lines of {cells.n_columns} shots, "
            f"but {side.path} has {grid.n_lines} of {grid.n_columns}: another scan"
        )
        raise InputError(partner.path, problem, "give both files of the same one")


def _refuse_poor(
    left: Side,
    right: Side,
    n_left: int,
    n_right: int,
    tally: JoinTally,
    options: EvaluateOptions,
) -> None:
    # n_left, n_right: records that could be matched
    if options.match == "cell":
        _refuse_other_scan(left, right)
        _refuse_other_scan(right, left)
    smaller = left
    larger = right
    n_matched = tally.n_pairs
    n_records = n_left
    if n_right < n_left:
        smaller = right
        larger = left
        n_matched = tally.n_right
        n_records = n_right
    if n_matched and n_matched >= options.min_matched * n_records:
        return
    problem = f"{n_matched} of its {n_records} records found a partner in {larger.path}"
    if not n_matched and np.isfinite([left.tally.low, right.tally.low]).all():
        name = "key" if left.key is None else left.key.dimension
        spans = [f"{name} {side.tally.low:.9g} to {side.tally.high:.9g}" for side in (left, right)]
        problem += f": {left.path} has {spans[0]}, {right.path} has {spans[1]}"
    else:
        problem += (
            f" ({100 * n_matched / max(n_records, 1):.1f} %), "
            f"expected at least {100 * options.min_matched:g} %"
        )
    hints = {
        "time": "check that both clocks count alike (week seconds or standard time), "
        "or give a larger tolerance",
        "nearest": "register both in one coordinate system, or give a larger tolerance; "
        f"{PLACE_BY_POSES}",
    }
    hint = hints.get(options.match, "check that the ids come from one run")
    raise InputError(smaller.path, problem, hint)
