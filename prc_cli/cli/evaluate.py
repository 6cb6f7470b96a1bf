"""``prc evaluate``: predicted against reference classes of the same records."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.evaluate_answers import FORMS, unless_answers
from prc_cli.cli.options import (
    JSON,
    POSES,
    QUIET,
    Sectioned,
    Word,
    add_options,
    by_side,
    complete_mapping,
    form_of_output,
    numbers,
    window_options,
)
from prc_cli.cli.output import console, print_table, print_text, results
from prc_cli.cli.paths import NAMED, READ, READ_TEXT, WRITTEN
from prc_cli.core.errors import ConfigError, ExitCode
from prc_cli.core.files import atomic_output, prepare_outputs, whole_set
from prc_cli.core.near import did_you_mean
from prc_cli.core.window import Window, window_of
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.html import as_html
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.methods import (
    ComparedMethods,
    methods_csv,
    methods_html,
    methods_json,
    methods_markdown,
)
from prc_cli.evaluation.places import Places, place_rows, places_csv, places_geojson
from prc_cli.evaluation.reports import (
    NO_INTERVALS,
    as_csv,
    as_json,
    as_markdown,
    doubts,
    gate_line,
    match_line,
    overall_line,
    percent,
    score_table,
    split_table,
)
from prc_cli.evaluation.scores import (
    Evaluation,
    GateResult,
    Interval,
    Scores,
    check_gates,
    parse_gate,
    refuse_failed,
    scores,
)
from prc_cli.jobs.evaluate import evaluate_all
from prc_cli.jobs.evaluate.methods import evaluate_methods, named_files
from prc_cli.jobs.evaluate.options import EvaluateOptions, mapping_of_methods, mapping_of_runs
from prc_cli.jobs.evaluate.pictures import class_pictures
from prc_cli.jobs.render.colours import origin
from prc_cli.matching.pairs import files_of

MAX_PARTS = 40
"""Most parts of a split shown on a terminal."""
PLACE_FORMS = {".geojson": "places of GeoJSON", ".csv": "places of CSV"}
PLACE_WRITERS = {"places of GeoJSON": places_geojson, "places of CSV": places_csv}
"""Forms of the places by the suffix of ``--places``."""
SHOWN_PLACES = 5
"""Places shown on a terminal."""

DEFAULTS = EvaluateOptions()
SIDES = ("predicted", "reference")

Pictures = Sequence[tuple[str, bytes]]

_OPTIONS = [
    click.option(
        "--mapping",
        "mappings",
        type=READ_TEXT,
        multiple=True,
        metavar="NAME|FILE.toml",
        shell_complete=complete_mapping,
        help="Classes of the codes: a preset (prc, street, asprs, terrascan, ...) or a file. "
        "third=NAME: those of --third.  [default: the mapping of the method in the run record "
        "beside PREDICTED, else prc]",
    ),
    click.option(
        "--dimension",
        "dimensions",
        multiple=True,
        metavar="NAME",
        help="Column or dimension with the predicted codes. reference=NAME: with the reference "
        "codes.",
    ),
    click.option(
        "--match",
        default="order",
        show_default=True,
        metavar="HOW",
        help="How records are matched: order, time, dimension:NAME or nearest. "
        "If lengths or orders "
        "differ, prc matches by line and column, if both files have them.",
    ),
    click.option(
        "--tolerance",
        "--max-distance",
        "tolerance",
        type=float,
        metavar="NUMBER",
        help="Largest difference of a pair: seconds (time), metres (nearest).  [default: 6e-7 s; "
        "for "
        "nearest, from the spacing and the distance of both clouds]",
    ),
    click.option(
        "--unmatched",
        type=Word(["leave", "noise"]),
        default=DEFAULTS.unmatched,
        show_default=True,
        help="For nearest: do not score predicted shots without partner, "
        "or count them as noise in the "
        "reference, inside its area (in most registered clouds noise was deleted).",
    ),
    click.option(
        "--inside",
        type=READ_TEXT,
        metavar="X1,Y1,X2,Y2|FILE.geojson",
        help="For nearest: compare only shots inside this area.",
    ),
    click.option(
        "--height",
        metavar="LOW:HIGH",
        help="For nearest: score only shots at these heights above the ground of the reference "
        "[m], e.g. 0:2.",
    ),
    click.option(
        "--trees",
        type=READ,
        metavar="FILE.csv",
        help="For nearest: shots in these cylinders (x,y,radius[,height]) are stems in the "
        "reference.",
    ),
    click.option(
        "--third",
        type=READ,
        metavar="PATH",
        help="Compare both with a third labelling, by order or nearest.",
    ),
    click.option(
        "--allow-missing",
        is_flag=True,
        help="Skip files that are in only one of the folders.",
    ),
    click.option(
        "--pool",
        is_flag=True,
        help="Read all files of a side as one cloud, with any names. Not for --match order.",
    ),
    click.option(
        "--min-matched",
        type=click.FloatRange(0, 1),
        default=DEFAULTS.min_matched,
        show_default=True,
        help="Smallest share of records with a partner, of the smaller side.",
    ),
    click.option(
        "--points",
        "points",
        multiple=True,
        type=READ_TEXT,
        metavar="PATH",
        help="Points of PREDICTED, if it contains only labels: the input of the run, or a folder. "
        "reference=PATH: points of REFERENCE.",
    ),
    *POSES,
    click.option(
        "--by",
        "splits",
        multiple=True,
        metavar="WHAT",
        help="Split by range [m] (range:5,10,20,40), by N scan lines (lines:99), by scanner "
        "(scanner) or by confidence [%] (confidence:50,80,90,95,99). Can be repeated.",
    ),
    click.option(
        "-M",
        "--points-per-line",
        type=click.IntRange(min=1),
        help="Shots per scan line of a dense stream.",
    ),
    click.option(
        "--intervals",
        is_flag=True,
        help="Print confidence intervals of all scores (block jackknife).",
    ),
    JSON,
    click.option(
        "-o",
        "--output",
        "outputs",
        multiple=True,
        type=WRITTEN,
        metavar="FILE",
        help="Also write the result to FILE: .json, .csv, .md or .html. Can be repeated.",
    ),
    click.option(
        "--places",
        type=WRITTEN,
        metavar="FILE.geojson|.csv",
        help="Also write the places where both sides differ, the largest and surest first. The "
        "HTML page then has the first thirty with a picture.",
    ),
    click.option("--overwrite", is_flag=True, help="Replace files that exist."),
    QUIET,
    click.option(
        "--fail-under",
        "gates",
        multiple=True,
        metavar="SCORE.CLASS=VALUE",
        help="If a score is lower, exit with code 3, e.g. recall.ground=0.95 or accuracy=0.9.",
    ),
]


@click.command(
    cls=Sectioned,
    brief=(
        "--mapping",
        "--match",
        "--max-distance",
        "--unmatched",
        "--by",
        "--intervals",
        "--fail-under",
        "--output",
        "--overwrite",
        "--json",
    ),
)
@click.argument("paths", metavar="PREDICTED... REFERENCE", nargs=-1, required=True, type=NAMED)
@add_options(*_OPTIONS)
@window_options
@unless_answers
def evaluate(paths: tuple[tuple[str, Path], ...], **options: Any) -> None:
    """Compare PREDICTED with REFERENCE, record by record.

    Both contain class codes: .npy, .csv(.gz), .parquet, .label, .las or .laz. Text and Parquet may
    contain class names instead. If both are folders, prc compares files of the same name (with any
    suffix) in one matrix. The result goes to stdout, and to the files of --output.

    With several PREDICTED, prc compares each with REFERENCE, and prints one table: a column for
    each method. Its name comes from the run record, or from NAME=FILE.

    If the records are in different orders, use --match. A reference that was classified after
    registration (CAR) needs --match nearest. REFERENCE can also be the answers of prc check.

    \b
    Examples:
      prc evaluate labels.npy reference.npy
      prc evaluate urban.npy fused.npy old=2023.npy reference.npy --intervals
      prc evaluate labels.npy oakland_1.csv.gz --mapping oakland --fail-under recall.ground=0.9
      prc evaluate run/ reference/ --mapping oakland --intervals -M 229 --output report.html
      prc evaluate classified.laz car.laz --match nearest --unmatched noise --mapping asprs
      prc evaluate labels.npy tiles/ --match nearest --points drive.npz \\
        --trajectory path.csv --mount 0,25,0
    """
    *predicted, (_, reference) = paths
    if not predicted:
        message = "Missing argument 'REFERENCE'."
        raise click.UsageError(message)
    written = _checked_outputs(paths, options)
    if len(predicted) > 1:
        report = _compare_methods(predicted, reference, options)
    else:
        report = _compare_one(predicted[0][1], reference, options)
    texts = [report.text(output_form) for output_form in written.values()]
    with whole_set():
        for path, text in zip(written, texts, strict=True):
            with atomic_output(path, overwrite=options["overwrite"]) as temporary:
                temporary.write_text(text, encoding="utf-8", newline="\n")
    if options["as_json"]:
        print_text(report.text("json"))
    elif not options["quiet"]:
        report.print()
    if report.chosen_mapping and not options["quiet"]:
        line = f"mapping: {report.chosen_mapping}; --mapping names another"
        console().print(line, markup=False, soft_wrap=True)
    refuse_failed(report.all_gates)
    if report.has_doubts:
        raise SystemExit(ExitCode.LOOK)


def _checked_outputs(
    paths: Sequence[tuple[str, Path]], options: Mapping[str, Any]
) -> dict[Path, str]:
    """Return the form of every file to write; refuse other suffixes, and inputs."""
    written: dict[Path, str] = {}
    asked = [(str(path), path, FORMS) for path in options["outputs"]]
    if options["places"] is not None:
        asked.append(("--places", options["places"], PLACE_FORMS))
    for where, path, forms in asked:
        written[path] = form_of_output(path, forms, where)
    if written:
        inputs = tuple(files_of([path for _, path in paths]))
        prepare_outputs(*written, overwrite=options["overwrite"], inputs=inputs)
    return written


def _compare_one(predicted: Path, reference: Path, options: Mapping[str, Any]) -> _Report:
    how = _how(options)
    name = _mapping(options)
    chosen = ""
    if not name:
        left, right = (files_of([path]) for path in (predicted, reference))
        name, why = mapping_of_runs(left, right, how.reference_dimension)
        chosen = f"{name} ({why})" if why else ""
    mapping = load_mapping(name)
    gate_list = [parse_gate(text, mapping) for text in options["gates"]]
    page_wanted = _is_page_wanted(options)
    evaluation = evaluate_all((predicted,), (reference,), name, options=how)
    pictures = _class_pictures(evaluation, mapping, how) if page_wanted else ()
    gates = check_gates(scores(evaluation.matrix), gate_list)
    return _OneReport(mapping, chosen, pictures, evaluation, gates)


def _compare_methods(
    predicted: Sequence[tuple[str, Path]], reference: Path, options: Mapping[str, Any]
) -> _Report:
    _refuse_for_one(options)
    how = _how(options)
    name = _mapping(options)
    chosen = ""
    if not name:
        sides = [files_of([path]) for _, path in predicted]
        name, why = mapping_of_methods(sides, files_of([reference]), how.reference_dimension)
        chosen = f"{name} ({why})" if why else ""
    mapping = load_mapping(name)
    gate_list = [parse_gate(text, mapping) for text in options["gates"]]
    methods = evaluate_methods(named_files(predicted), reference, name, options=how)
    gates = {
        method: check_gates(scores(evaluation.matrix), gate_list)
        for method, evaluation in methods.evaluations.items()
    }
    return _MethodsReport(mapping, chosen, methods, gates)


def _is_page_wanted(options: Mapping[str, Any]) -> bool:
    return any(path.suffix.lower() == ".html" for path in options["outputs"])


def _refuse_for_one(options: Mapping[str, Any]) -> None:
    """Refuse options that compare one prediction with the reference."""
    flags = {"third": "--third", "places": "--places", "splits": "--by"}
    for name, flag in flags.items():
        if options.get(name):
            problem = "several predicted files, expected one with this option"
            raise ConfigError(flag, problem, "give one PREDICTED, or leave the option out")


def _class_pictures(
    evaluation: Evaluation, mapping: ClassMapping, how: EvaluateOptions
) -> Pictures:
    """Return the pictures of an evaluation for its page."""
    pictures: list[tuple[str, bytes]] = []
    if evaluation.plan is not None:
        title = "From above: where predicted and third are right and wrong"
        pictures.append((title, evaluation.plan))
    # pictures of the classes show the first lines
    if evaluation.match.method == "order" and how.window is None:
        pictures += class_pictures(
            Path(evaluation.predicted[0]),
            Path(evaluation.reference[0]),
            mapping,
            how.points_per_line,
            (how.predicted_dimension, how.reference_dimension),
            (how.predicted_points, how.reference_points),
        )
    return pictures


@dataclass(frozen=True)
class _Report(ABC):
    """The result of the command, in every form."""

    mapping: ClassMapping
    chosen_mapping: str
    """Name of the preset and why prc chose it; empty for a given mapping."""

    @property
    @abstractmethod
    def all_gates(self) -> tuple[GateResult, ...]:
        """All gates and the scores found."""

    @property
    @abstractmethod
    def has_doubts(self) -> bool:
        """Whether there are reasons to doubt the comparison."""

    @abstractmethod
    def text(self, form: str) -> str:
        """Return the result as ``html``, ``csv``, ``json`` or ``markdown``."""

    @abstractmethod
    def print(self) -> None:
        """Print tables on stdout."""


@dataclass(frozen=True)
class _OneReport(_Report):
    """The reports of one evaluation."""

    pictures: Pictures
    evaluation: Evaluation
    gates: tuple[GateResult, ...]

    @property
    def all_gates(self) -> tuple[GateResult, ...]:
        return self.gates

    @property
    def has_doubts(self) -> bool:
        return bool(doubts(self.evaluation))

    def text(self, form: str) -> str:
        evaluation = self.evaluation
        if form == "html":
            return as_html(
                evaluation,
                self.gates,
                mapping=self.mapping,
                pictures=self.pictures,
                origin=origin([Path(name) for name in evaluation.predicted]),
            )
        if form in PLACE_WRITERS and evaluation.places is not None:
            return PLACE_WRITERS[form](evaluation.places)
        if form == "csv":
            return as_csv(evaluation)
        if form == "json":
            return as_json(evaluation, self.all_gates) + "\n"
        return as_markdown(evaluation, self.all_gates)

    def print(self) -> None:
        evaluation = self.evaluation
        print_evaluation(evaluation.matrix, scores(evaluation.matrix), evaluation.intervals)
        print_evaluation_details(evaluation, self.all_gates)


@dataclass(frozen=True)
class _MethodsReport(_Report):
    """The reports of several methods."""

    methods: ComparedMethods
    gates: Mapping[str, tuple[GateResult, ...]]

    @property
    def all_gates(self) -> tuple[GateResult, ...]:
        return tuple(
            replace(gate, name=f"{method}: {gate.name}")
            for method, gates in self.gates.items()
            for gate in gates
        )

    @property
    def has_doubts(self) -> bool:
        return any(doubts(evaluation) for evaluation in self.methods.evaluations.values())

    def text(self, form: str) -> str:
        if form == "html":
            evaluations = self.methods.evaluations.values()
            files = [Path(name) for evaluation in evaluations for name in evaluation.predicted]
            return methods_html(self.methods, self.gates, origin=origin(files))
        if form == "csv":
            return methods_csv(self.methods)
        if form == "json":
            return methods_json(self.methods, self.gates) + "\n"
        return methods_markdown(self.methods)

    def print(self) -> None:
        header, rows = self.methods.table()
        print_table("methods against the reference", header, rows, n_words=2)
        print_gates(self.all_gates)
        for method, evaluation in self.methods.evaluations.items():
            results().print(f"{method}: {match_line(evaluation.match)}")
            for note in (*evaluation.match.notes, *doubts(evaluation)):
                results().print(f"  {note}")
        used = (evaluation.interval_method for evaluation in self.methods.evaluations.values())
        for method in dict.fromkeys(filter(None, used)):
            results().print(f"intervals: {method}")


def _how(options: Mapping[str, Any]) -> EvaluateOptions:
    explicit = {
        item.name: options[item.name] for item in fields(EvaluateOptions) if item.name in options
    }
    read = {
        **_splits(options["splits"]),
        **{
            f"{side}_dimension": name
            for side, name in by_side(options["dimensions"], "--dimension", *SIDES).items()
        },
        **{
            f"{side}_points": Path(name)
            for side, name in by_side(options["points"], "--points", *SIDES).items()
        },
        "third_mapping": _mapping(options, "third"),
        "height": _heights(options["height"]),
        "mount": numbers(options["mount"], "--mount"),
        "window": _window(options["only"]),
        "places": options["places"] is not None,
        "place_pictures": options["places"] is not None and _is_page_wanted(options),
    }
    return EvaluateOptions(**{**explicit, **read})


def _mapping(options: Mapping[str, Any], side: str = "") -> str | None:
    """Return the class mapping of both sides, or of the third labelling."""
    return by_side(options["mappings"], "--mapping", "", "third").get(side)


def _heights(text: str | None) -> tuple[float, float] | None:
    """Read heights above ground, e.g. ``0:2`` [m]."""
    if text is None:
        return None
    words = text.split(":")
    try:
        low, high = (
            float(word) if word.strip() else end
            for word, end in zip(words, (-math.inf, math.inf), strict=True)
        )
    except ValueError:
        low = high = math.nan
    if not low < high:
        raise ConfigError(
            "--height", f"found {text!r}, expected heights above ground in metres, such as 0:2"
        )
    return low, high


def _window(text: str | None) -> Window | None:
    try:
        return None if text is None else window_of(text)
    except ValueError as error:
        raise ConfigError("--only", f"found {text!r}, expected {error}") from None


def _splits(texts: Sequence[str]) -> dict[str, Any]:
    """Read what to split by, as fields of :class:`EvaluateOptions`."""
    splits: dict[str, Any] = {}
    for text in texts:
        kind, _, rest = text.partition(":")
        if kind == "range":
            splits["split_range_m"] = _edges(rest)
        elif kind == "confidence":
            splits["split_confidence"] = _per_cents(rest)
        elif kind == "lines" and rest.isdecimal() and int(rest) > 0:
            splits["split_lines"] = int(rest)
        elif text == "scanner":
            splits["split_scanner"] = True
        else:
            expected = "range:5,10,20, lines:99, scanner or confidence:50,80,90"
            hint = did_you_mean(kind, ("range", "lines", "scanner", "confidence"))
            raise ConfigError("--by", f"found {text!r}, expected {expected}", hint)
    return splits


def _edges(text: str) -> tuple[float, ...]:
    """Read the edges of range bins, e.g. ``5,10,20`` [m]."""
    try:
        edges = tuple(float(word) for word in text.split(","))
    except ValueError:
        edges = (math.nan,)
    rising = all(low < high for low, high in zip((-1.0, *edges), (*edges, math.inf), strict=True))
    if not rising or edges[0] < 0:
        problem = f"found {text!r}, expected increasing ranges in metres, such as 5,10,20,40"
        raise ConfigError("--by range", problem)
    return edges


def _per_cents(text: str) -> tuple[int, ...]:
    """Read the edges of bins of confidence, e.g. ``50,80,90`` [%]."""
    words = [word.strip() for word in text.split(",")]
    edges = tuple(int(word) for word in words if word.isdecimal() and len(word) < 4)
    if len(edges) < len(words) or any(low >= high for low, high in pairwise((-1, *edges, 101))):
        problem = f"found {text!r}, expected increasing percentages, such as 50,80,90,95,99"
        raise ConfigError("--by confidence", problem)
    return edges


def print_evaluation(
    matrix: ConfusionMatrix, table: Scores, intervals: Mapping[str, Interval] = NO_INTERVALS
) -> None:
    """Print a confusion matrix with row shares, and the scores, on stdout."""
    shown = matrix.trimmed()
    rows = []
    for name, counts, shares in zip(
        shown.reference_names, shown.counts, shown.row_shares(), strict=True
    ):
        cells = zip(counts, shares, strict=True)
        rows.append((name, *(f"{count:,} ({percent(share)})" for count, share in cells)))
    title = "reference in rows, predicted in columns: records (share of the row)"
    print_table(title, ("reference", *shown.predicted_names), rows)
    print_table("scores", *score_table(scores(shown), intervals))
    n_records = f"scored {table.n_scored:,} records, ignored {table.n_ignored:,}"
    results().print(f"{n_records}: {overall_line(table, intervals)}")


def print_evaluation_details(evaluation: Evaluation, gates: Sequence[GateResult]) -> None:
    """Print the parts of an evaluation, its gates and how the records were matched, on stdout."""
    if evaluation.intervals:
        results().print(f"intervals: {evaluation.interval_method}")
    for split, parts in evaluation.splits.items():
        header, rows = split_table(parts, evaluation.matrix.trimmed())
        print_table(f"by {split}", header, rows[:MAX_PARTS])
        if len(rows) > MAX_PARTS:
            results().print(
                f"and {len(rows) - MAX_PARTS} more; --output and --json have all of them"
            )
    if evaluation.three is not None:
        print_table("three labellings", *evaluation.three.table())
        for sentence in evaluation.three.sentences():
            results().print(sentence)
    if evaluation.places is not None:
        print_places(evaluation.places)
    print_gates(gates)
    results().print(match_line(evaluation.match))
    for note in (*evaluation.match.notes, *doubts(evaluation)):
        results().print(note)


def print_places(places: Places) -> None:
    """Print the first places where both sides differ, on stdout."""
    rows = []
    listed = place_rows(places)
    for row in listed[:SHOWN_PLACES]:
        sure = "-" if row["confidence"] is None else f"{row['confidence']:.0f} %"
        length = "-" if row["length_m"] is None else f"{row['length_m']:.1f} m"
        position = "-" if row["x"] is None else f"{row['x']:.1f}, {row['y']:.1f}, {row['z']:.1f}"
        cells = (f"{row['records']:,}", length, sure, position, row["explain"] or "-")
        rows.append((f"{row['predicted']}, not {row['reference']}", *cells))
    header = ("predicted, not reference", "records", "length", "confidence", "x, y, z", "why")
    print_table("places where they differ", header, rows)
    results().print(
        f"{len(places.places):,} places have {places.n_listed:,} of {places.n_differ:,} "
        "records that differ"
    )
    if any(row["explain"] is None for row in listed):
        results().print(
            "prc explain needs a scan line and a column, which some places do not have; "
            "give -M, or --points with the points of the labels"
        )
    if listed and all(row["x"] is None for row in listed):
        results().print(
            "no coordinates: a map cannot show the places; name a cloud of the same shots, "
            "--points FILE.laz"
        )


def print_gates(gates: Sequence[GateResult]) -> None:
    """Print gates and the scores found, on stdout."""
    for gate in gates:
        results().print(gate_line(gate))
