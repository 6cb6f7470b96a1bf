"""``prc check``: a random sample of shots to be checked by hand, as one page."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from prc_cli.config import LoadedConfig, refuse_window, resolve
from prc_cli.core.brief import Brief
from prc_cli.core.classes import LABEL_NAMES, Label
from prc_cli.core.errors import ConfigError, InputError, PrcError
from prc_cli.core.files import atomic_output, prepare_outputs, temporary_folder
from prc_cli.core.stream import ScanBlock
from prc_cli.core.version import __version__
from prc_cli.evaluation.answers import (
    KIND,
    SUFFIX,
    Answers,
    ClassifiedFile,
    PlaceAnswer,
    SampleStratum,
)
from prc_cli.formats.input import Input
from prc_cli.formats.labels import open_codes
from prc_cli.formats.records import Source
from prc_cli.formats.writing.record import fingerprint
from prc_cli.imaging.check_page import check_page
from prc_cli.jobs.check.draw import Drawn, draw, read_confidence
from prc_cli.jobs.check.surroundings import surroundings
from prc_cli.jobs.progress import advance
from prc_cli.jobs.render.colours import Vocabulary, heading, vocabulary
from prc_cli.jobs.render.options import RenderOptions
from prc_cli.jobs.render.scan import open_for_pictures
from prc_cli.jobs.render.viewer import existing_classes
from prc_cli.jobs.run import Progress

_NO_ANSWER = {LABEL_NAMES[Label.UNCLASSIFIED]}
"""Predicted classes that are no answer."""


@dataclass(frozen=True, slots=True)
class CheckOptions:
    """What is drawn."""

    shots: int = 300
    seed: int = 0
    labels: Path | None = None
    """Class codes of the input, if it has none itself."""
    labels_dimension: str | None = None
    mapping: str | Path | None = None
    """Classes of the codes; None = those of ``[classes]``."""


@dataclass(frozen=True, slots=True, repr=False)
class CheckResult(Brief):
    """Summary of a check."""

    page: Path
    answers: str
    """Name under which the page saves the answers."""
    n_shots: int
    """Shots that could be drawn."""
    n_places: int
    """Shots that were drawn."""
    strata: tuple[SampleStratum, ...]
    classes: tuple[str, ...]
    """Classes that can be answered."""
    n_bytes: int
    """Size of the page."""


def check(
    classified: Path | str,
    output: Path | str,
    config: LoadedConfig,
    options: CheckOptions | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> CheckResult:
    """Draw shots of a classified file at random, and write the page to check them on.

    Parameters
    ----------
    classified : path
        A LAS or LAZ file with classes, or any input together with ``options.labels``.
    output : path
        ``.html``.
    config : LoadedConfig
        How the input is read.
    options : CheckOptions, optional
    overwrite : bool
    progress : callable, optional
        Called with the number of lines that were just read; the input is read twice.

    Raises
    ------
    InputError
        If the input has no classes, or no shots.
    """
    scan, loaded = resolve(classified, config)
    chosen = CheckOptions() if options is None else options
    output = Path(output)
    if output.suffix.lower() not in (".html", ".htm"):
        problem = f"found the suffix {output.suffix!r}, expected .html"
        raise ConfigError(str(output), problem, "rename the output")
    refuse_window(loaded.config, "prc check")
    prepare_outputs(output, overwrite=overwrite, inputs=loaded.inputs(scan.path, chosen.labels))
    scan.check()
    if chosen.labels is None and not scan.is_las and _has_codes(scan, chosen):
        chosen = replace(chosen, labels=scan.path)
    looks = RenderOptions(
        labels=chosen.labels, labels_dimension=chosen.labels_dimension, mapping=chosen.mapping
    )
    words = vocabulary(looks, loaded.config.classes)
    with temporary_folder("prc-check-") as scratch:
        classes, origin = existing_classes(scan, loaded, looks, words, scratch)
        if classes is None:
            hint = f"prc classify {scan.name} classified.laz, or give --labels"
            raise InputError(str(scan), "has no classes to check", hint)
        confidence = read_confidence(_labels(scan, chosen), scratch)
        stream = open_for_pictures(scan, loaded)
        classes.check(stream.info.n_records)

        def see(block: ScanBlock) -> None:
            advance(progress, block, stream.info)

        drawn = draw(stream.blocks(), words, classes, confidence, chosen.shots, chosen.seed, see)
        if not drawn.places:
            raise InputError(str(scan), "found no shots with a return", "prc info says why")
        views = surroundings(stream.blocks(), scan, loaded, stream.info, drawn.places, see)
    source = scan.path if chosen.labels is None else chosen.labels
    answers = _no_answers(source, drawn, words, chosen.seed)
    name = f"{source.stem}_answers{SUFFIX}"
    n_shots = sum(stratum.n_shots for stratum in drawn.strata)
    text = check_page(
        views,
        title=f"Check {source.name}",
        head=heading(origin, f"{len(drawn.places):,} of {n_shots:,} shots, drawn at random"),
        answers=answers.model_dump(mode="json"),
        colours=[words.table.colour(words.table.names.index(name)) for name in answers.classes],
        file=name,
        labels=words.hand_labels(
            source, stream.info.n_records, digest=answers.classified.sha256[:16]
        ),
    )
    with atomic_output(output, overwrite=overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return CheckResult(
        output,
        name,
        n_shots,
        len(drawn.places),
        drawn.strata,
        answers.classes,
        output.stat().st_size,
    )


def _has_codes(scan: Input, options: CheckOptions) -> bool:
    """Return whether a file that is no LAS has class codes beside its ranges."""
    with suppress(PrcError):
        return any(len(codes) for codes in open_codes(scan.path, options.labels_dimension).codes())
    return False


def _labels(scan: Input, options: CheckOptions) -> Source | None:
    if options.labels is None:
        return scan.records()
    try:
        return Input.of(options.labels).records()
    except PrcError:  # a label file that is no list of records, such as .npy
        return None


def _no_answers(source: Path, drawn: Drawn, words: Vocabulary, seed: int) -> Answers:
    """Return the answers file before the first answer."""
    state = fingerprint(source)
    names = {stratum.predicted for stratum in drawn.strata} - _NO_ANSWER
    classes = tuple(name for name in words.table.names[1:-1] if name in names)
    return Answers(
        kind=KIND,
        format=1,
        version=__version__,
        classified=ClassifiedFile(name=state.name, size=state.size, sha256=state.sha256 or ""),
        classes=classes,
        seed=seed,
        strata=drawn.strata,
        places=tuple(PlaceAnswer(**cell._asdict()) for cell in drawn.places),
    )
