"""Scan pictures of lines and columns: a block as in the paper, a static scan upright, a drive in strips."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from prc_cli.config import LoadedConfig
from prc_cli.core.classes import LABEL_COLOURS, Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import ReadTally, ScanBlock
from prc_cli.core.types import F64, I64, U8
from prc_cli.imaging.pictures import (
    AGREE_COLOUR,
    Bar,
    class_picture,
    difference_picture,
    mask_picture,
    range_bar,
    range_limits,
    range_picture,
    segment_picture,
    value_bar,
    value_limits,
    value_picture,
)
from prc_cli.imaging.sheet import FRAME_HEIGHT, Axis, Colour, Key, Panel, zoom_for
from prc_cli.imaging.stages import critical_bar, critical_limits, critical_picture, trigger_key, trigger_picture
from prc_cli.jobs.classify import Progress
from prc_cli.jobs.progress import advance
from prc_cli.jobs.render.classes import (
    LABEL_TABLE,
    NOT_SCORED,
    ClassTable,
    RecordClasses,
    Vocabulary,
    read_classes,
    share_text,
    vocabulary,
)
from prc_cli.jobs.render.frames import (
    Frame,
    Plane,
    count_lines,
    frames,
    of_station,
    open_for_pictures,
    turns,
    upright,
)
from prc_cli.jobs.render.heading import heading, made_by, made_with
from prc_cli.jobs.render.options import CAPTIONS, CONFIDENCE_LIMITS, RenderOptions, choose_steps
from prc_cli.jobs.render.stages import INTERVALS, TESTS

STRIP_HEIGHT, PANEL_HEIGHT, UPRIGHT_HEIGHT = 380, 800, 1100
"""Highest picture of a strip of a folded drive, of a drive that needs no folding, of an upright scan [pixels]."""
FOLD_FROM = 2
"""Length, in picture widths, above which vertical lines without rotation are folded into strips."""
PAGE_ROOM = 140
"""Space for headline and key of a page [pixels]."""


@dataclass(frozen=True, slots=True)
class Part:
    """The lines to draw."""

    first: int
    stop: int
    n_lines: int
    """Lines of the whole stream."""

    @property
    def is_whole(self) -> bool:
        """Whether all lines are drawn."""
        return self.stop - self.first == self.n_lines


@dataclass(frozen=True, slots=True)
class Drawing:
    """Pictures of a scan, ready to be put on pages."""

    strips: tuple[tuple[Panel, ...], ...]
    """Pictures of every strip, from top to bottom."""
    strips_per_page: int
    key: Key
    part: Part
    steps: tuple[str, ...]
    thinned_by: tuple[int, int]
    counts: dict[str, int]
    n_compared: int
    n_differing: int


@dataclass(slots=True)
class _Kept:
    """Thinned images and full counts, collected while the stream is read."""

    planes: dict[str, list[Plane]] = field(default_factory=dict)
    counts: dict[str, I64] = field(default_factory=dict)
    """Shots by class of every class image, before thinning."""
    n_compared: int = 0
    n_differing: int = 0
    beam_rad: F64 | None = None
    turn_rad: float = 0.0
    tally: ReadTally = field(default_factory=ReadTally)
    n_read: int = 0


@dataclass(frozen=True, slots=True)
class _Layout:
    """Arrangement of lines and columns on the page."""

    kind: str
    """``paper``: columns across, lines down; ``upright``: lines across, the sky at the top; ``strips``: lines
    across, columns down, folded."""
    line_step: int
    column_step: int
    strip: int
    """Drawn lines of a strip."""
    strips_per_page: int


def draw_scan(
    source: Path, loaded: LoadedConfig, options: RenderOptions, folder: Path, progress: Progress | None = None
) -> Drawing:
    """Draw the steps of a scan."""
    method = loaded.config.method
    _check_part(method, options)
    steps = choose_steps(method, options)
    words = vocabulary(options, loaded.config.classes)
    stream = open_for_pictures(loaded, source)
    # labels are checked first: they are small, and classifying takes long
    given = _read(options.labels, options.labels_dimension, words, "predicted", folder)
    reference = _read(options.reference, options.reference_dimension, words, "reference", folder)
    for side in (given, reference):
        if side is not None:
            side.check(stream.info.n_records)
    part = choose_part(options, loaded, count_lines(stream, options.station, loaded))
    first = next(of_station(stream.blocks(), options.station, stream.info.path), None)
    if first is None:
        raise InputError(str(source), "found no scan lines, expected at least one")
    layout = _choose_layout(first, part, len(steps), options)
    labelled = given is None and bool(set(steps) - {"range", "intensity", "reference"})
    kept = _Kept(beam_rad=first.beam_rad, turn_rad=turns(first))
    blocks = of_station(stream.blocks(), options.station, stream.info.path)
    info = stream.info
    for frame in frames(blocks, loaded, steps, classify=labelled):
        frame = _with_classes(frame, words, given, reference)
        _keep(kept, frame, part, layout, steps, words)
        advance(progress, frame.block, info)
        if frame.block.first_line + frame.block.n_lines >= part.stop:
            break
    if part.stop == part.n_lines and kept.tally.n_records:
        for side in (given, reference):
            if side is not None and stream.info.n_records is None and options.station is None:
                side.check(max(kept.tally.n_records, kept.n_read))
    own = words.table if given is not None else LABEL_TABLE.without(options.hide)
    return _draw(kept, part, layout, steps, words, own)


def _check_part(method: str, options: RenderOptions) -> None:
    if options.block is not None and options.lines is not None:
        raise ConfigError("--block", "given together with --only-lines, expected one of them")
    if options.figure1 and method != "prc":
        raise ConfigError("--figure1", f"belongs to prc, found the method {method}", _METHOD)
    if options.figure1 and options.labels is not None:
        problem = "the figure shows the steps of prc, which a label file does not hold"
        raise ConfigError("--figure1", problem, "leave --labels out")
    if options.block is not None and method != "prc":
        hint = "give --only-lines A:B"
        raise ConfigError("--block", f"the {method} method has no blocks", hint)


_METHOD = "add --method prc"


def _read(path: Path | None, dimension: str | None, words: Vocabulary, side: str, folder: Path) -> RecordClasses | None:
    if path is None:
        return None
    if side == "predicted":
        return read_classes(path, dimension, lambda codes: words.turn(codes, "predicted"), folder, side)
    return read_classes(path, dimension, lambda codes: words.turn(codes, "reference"), folder, side)


def choose_part(options: RenderOptions, loaded: LoadedConfig, n_lines: int) -> Part:
    """Return the lines to draw."""
    k = loaded.config.prc.lines_per_block
    n_blocks = -(-n_lines // k)
    block = options.block
    if options.figure1 and block is None and options.lines is None:
        block = min(1, n_blocks - 1)
    if block is not None:
        if not 0 <= block < n_blocks:
            problem = f"found {block}, expected 0 to {n_blocks - 1}: {n_lines:,} lines in blocks of {k}"
            raise ConfigError("--block", problem)
        return Part(block * k, min((block + 1) * k, n_lines), n_lines)
    if options.lines is not None:
        first, stop = options.lines
        if not 0 <= first < stop or first >= n_lines:
            problem = f"found {first}:{stop}, expected A:B within 0:{n_lines} and A below B"
            raise ConfigError("--only-lines", problem)
        return Part(first, min(stop, n_lines), n_lines)
    return Part(0, n_lines, n_lines)


def _choose_layout(first: ScanBlock, part: Part, n_steps: int, options: RenderOptions) -> _Layout:
    n, m = part.stop - part.first, first.points_per_line
    width = options.width
    # a rotating scan is one panorama; a long drive is folded into strips
    panorama = n <= FOLD_FROM * width or turns(first) != 0
    if upright(first.beam_rad) is not None and not options.figure1 and panorama:
        return _Layout("upright", -(-n // width), -(-m // UPRIGHT_HEIGHT), n, 1)
    if options.figure1 or options.block is not None or n <= m:
        room = max(200, (options.height - PAGE_ROOM) // n_steps - FRAME_HEIGHT)
        return _Layout("paper", -(-n // room), -(-m // width), n, 1)
    height = PANEL_HEIGHT if n <= width else STRIP_HEIGHT
    column_step = -(-m // height)
    columns = -(-m // column_step)
    high = columns * zoom_for(width, columns)[1]
    per_page = max(1, (options.height - PAGE_ROOM) // (n_steps * (high + FRAME_HEIGHT)))
    line_step = max(1, -(-n // (width * per_page * options.pages)))
    drawn = -(-n // line_step)
    n_strips = max(1, -(-drawn // width))
    return _Layout("strips", line_step, column_step, -(-drawn // n_strips), per_page)


def _with_classes(
    frame: Frame, words: Vocabulary, given: RecordClasses | None, reference: RecordClasses | None
) -> Frame:
    """Add the classes of label files, and the classifier's classes in the vocabulary of both sides."""
    if given is None and reference is None:
        return frame
    planes = dict(frame.planes)
    record, seen = frame.block.records(), ~np.isnan(frame.block.range_m)
    if given is not None:
        planes["classes"] = planes["predicted"] = words.mark_unscored(given.look_up(record), seen)
    elif "classes" in planes:
        planes["predicted"] = words.mark_unscored(words.turn_labels(planes["classes"]), seen)
    if reference is not None:
        planes["reference"] = words.mark_unscored(reference.look_up(record), seen)
    return replace(frame, planes=planes)


def _keep(
    kept: _Kept, frame: Frame, part: Part, layout: _Layout, steps: tuple[str, ...], words: Vocabulary
) -> None:  # fmt: skip
    """Count the part's shots, and keep the lines and columns to draw."""
    block = frame.block
    kept.tally = kept.tally + block.tally
    kept.n_read = max(kept.n_read, int(block.records().max(initial=-1)) + 1)
    low = max(part.first - block.first_line, 0)
    high = min(part.stop - block.first_line, block.n_lines)
    if low >= high:
        return
    inside = {name: plane[low:high] for name, plane in frame.planes.items()}
    size = max(len(words.table.names), len(Label))
    for side in ("classes", "predicted", "reference", *_STAGE_TABLES):
        if side in inside:
            counts = np.bincount(inside[side].ravel(), minlength=size)
            kept.counts[side] = counts + kept.counts.get(side, 0)
    if "predicted" in inside and "reference" in inside:
        both = np.ones(inside["reference"].shape, bool)
        for name in ("predicted", "reference"):
            both &= (inside[name] > 0) & (inside[name] != words.unscored)
        kept.n_compared += int(np.count_nonzero(both))
        kept.n_differing += int(np.count_nonzero(both & (inside["predicted"] != inside["reference"])))
    start = (part.first - block.first_line - low) % layout.line_step
    wanted = {*steps, "predicted"} if "difference" in steps else set(steps)
    for name, plane in inside.items():
        if name in wanted or (name == "reference" and "difference" in steps):
            thin = np.ascontiguousarray(plane[start :: layout.line_step, :: layout.column_step])
            kept.planes.setdefault(name, []).append(thin)


def _draw(
    kept: _Kept, part: Part, layout: _Layout, steps: tuple[str, ...], words: Vocabulary, own: ClassTable
) -> Drawing:  # fmt: skip
    planes = {name: np.concatenate(parts) for name, parts in kept.planes.items()}
    painter = _Painter(planes, steps, words, own)
    if layout.kind != "strips":
        painter.keys = _keys(kept, words, own)
    if kept.n_compared:
        painter.notes["difference"] = (
            f"{share_text(kept.n_differing, kept.n_compared)} of {kept.n_compared:,} shots differ"
        )
    strips = tuple(_strips(painter, kept, part, layout))
    key = _shared_key(kept, steps, words, own) if layout.kind == "strips" else ()
    side, table = ("classes", own) if "classes" in kept.counts else ("reference", words.table)
    found = kept.counts.get(side, np.zeros(len(table.names), np.int64))
    counts = {name: int(count) for name, count in zip(table.names, found, strict=False) if count}
    return Drawing(
        strips, layout.strips_per_page, key, part, steps, (layout.line_step, layout.column_step), counts,
        kept.n_compared, kept.n_differing,
    )  # fmt: skip


_STAGE_TABLES = {"coarse": LABEL_TABLE, "dense": LABEL_TABLE, "dividers": INTERVALS, "tests": TESTS}
"""Classes of the pictures of stages."""


def _keys(kept: _Kept, words: Vocabulary, own: ClassTable) -> dict[str, Key]:
    """Return the key of every class picture: classes that occur, with shares."""
    tables = {"classes": own, "reference": words.table, **_STAGE_TABLES}
    keys: dict[str, Key] = {}
    for step, counts in kept.counts.items():
        if step in tables:
            keys[step] = tables[step].key(counts[: len(tables[step].names)])
            if counts[0]:
                share = share_text(int(counts[0]), int(counts.sum()))
                keys[step] += ((f"{_NO_RETURN} ({share} of all shots)", LABEL_COLOURS[Label.MISSING]),)
    if "triggers" in kept.planes:
        keys["triggers"] = trigger_key()
    if "predicted" in kept.counts and "reference" in kept.counts:
        counts = kept.counts["predicted"].copy()
        counts[words.unscored] += kept.counts["reference"][words.unscored]
        keys["difference"] = (("both agree", AGREE_COLOUR), *_names(words.table, counts))
    return keys


_NO_RETURN = "no return"


def _names(table: ClassTable, counts: I64) -> Key:
    """Return the classes that occur, without shares, which differ between pictures."""
    order = [*range(1, len(table.names)), 0]
    shown = [i for i in order if counts[i] and i not in table.hidden]
    found = [(table.names[i] if i else _NO_RETURN, table.colours[i]) for i in shown]
    return tuple((name, (int(colour[0]), int(colour[1]), int(colour[2]))) for name, colour in found)


def _shared_key(kept: _Kept, steps: tuple[str, ...], words: Vocabulary, own: ClassTable) -> Key:
    """Return one key for a sheet of strips; with shares only if they belong to a single picture."""
    keys = _keys(kept, words, own)
    shown = [step for step in steps if step in keys]
    if len(shown) == 1:
        return keys[shown[0]]
    entries: dict[tuple[str, Colour], None] = {}
    for step in shown:
        table = own if step == "classes" else _STAGE_TABLES.get(step, words.table)
        if step in ("difference", "triggers"):
            entries |= dict.fromkeys(keys[step])
        else:
            entries |= dict.fromkeys(_names(table, kept.counts[step][: len(table.names)]))
    # entries that are no class go last
    last = (NOT_SCORED, "both agree", _NO_RETURN)
    return tuple(sorted(entries, key=lambda entry: last.index(entry[0]) if entry[0] in last else -1))


@dataclass(slots=True)
class _Painter:
    """Colours the images, with scales common to all strips and pages."""

    planes: dict[str, Plane]
    steps: tuple[str, ...]
    words: Vocabulary
    own: ClassTable
    notes: dict[str, str] = field(default_factory=dict)
    keys: dict[str, Key] = field(default_factory=dict)
    """Keys of single pictures, if the sheet has no common key."""
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for step in self.steps:
            if step == "range":
                self.limits[step] = range_limits(self.planes[step])
            elif step == "critical":
                self.limits[step] = critical_limits(self.planes[step])
            elif step in ("intensity", "ground"):
                self.limits[step] = value_limits(self.planes[step])
            elif step == "confidence":
                self.limits[step] = CONFIDENCE_LIMITS

    def paint(self, step: str, lines: slice) -> tuple[U8, Bar | None]:
        """Return the (lines, columns, 3) picture of some of the drawn lines, and its colour bar."""
        plane = self.planes["predicted" if step == "difference" else step][lines]
        if step == "range":
            return range_picture(plane, self.limits[step]), range_bar(self.limits[step])
        if step in ("intensity", "ground", "confidence"):
            unit = {"ground": "m", "confidence": "%"}.get(step, "")
            return value_picture(plane, self.limits[step]), value_bar(self.limits[step], unit)
        if step in ("support", "background"):
            return mask_picture(plane), None
        if step in ("components", "segments", "surfaces", "segmentation"):
            return segment_picture(plane), None
        if step == "critical":
            return critical_picture(plane, self.limits[step]), critical_bar(self.limits[step])
        if step == "triggers":
            return trigger_picture(plane), None
        if step in _STAGE_TABLES:
            return class_picture(plane, _STAGE_TABLES[step].colours), None
        if step == "classes":
            return class_picture(plane, self.own.colours), None
        reference = self.planes["reference"][lines]
        if step == "reference":
            return class_picture(reference, self.words.table.colours), None
        return difference_picture(plane, reference, self.words.table.colours, self.words.unscored), None


def _strips(painter: _Painter, kept: _Kept, part: Part, layout: _Layout) -> Iterator[tuple[Panel, ...]]:
    drawn = len(next(iter(painter.planes.values())))
    for first in range(0, drawn, layout.strip):
        stop = min(first + layout.strip, drawn)
        panels = []
        for step in painter.steps:
            picture, bar = painter.paint(step, slice(first, stop))
            panels.append(_panel(step, picture, bar, painter, kept, layout, _lines_of(part, layout, first, stop)))
        yield tuple(panels)


def _lines_of(part: Part, layout: _Layout, first: int, stop: int) -> tuple[int, int]:
    """Lines of the stream that a strip covers."""
    return part.first + first * layout.line_step, part.first + stop * layout.line_step


def _panel(
    step: str, picture: U8, bar: Bar | None, painter: _Painter, kept: _Kept, layout: _Layout, lines: tuple[int, int]
) -> Panel:  # fmt: skip
    """Orient a picture for viewing and add its axes."""
    title, caption = CAPTIONS[step]
    n, m = picture.shape[:2]
    along = Axis("line", *lines)
    across = Axis("column", 0, m * layout.column_step)
    note, key = painter.notes.get(step, ""), painter.keys.get(step, ())
    order = upright(None if kept.beam_rad is None else kept.beam_rad[:: layout.column_step])
    if layout.kind == "paper":
        return Panel(title, picture, across, along, note, bar, key, caption, zoom_for(m, n))
    if order is None:
        zoom = zoom_for(layout.strip, m)
        return Panel(title, picture.swapaxes(0, 1), along, across, note, bar, key, caption, zoom)
    assert kept.beam_rad is not None
    picture = picture[:, order].swapaxes(0, 1)
    if kept.turn_rad > 0:
        picture, along = picture[:, ::-1], Axis("line", lines[1], lines[0])
    side = _elevations(kept.beam_rad[:: layout.column_step], order, m * layout.column_step)
    return Panel(
        title, picture, along, side, note, bar, key, caption, _upright_zoom(layout.strip, m, _shape(kept, layout))
    )


def _shape(kept: _Kept, layout: _Layout) -> float | None:
    """Return the ratio of height to width of a drawn cell, as angles from the scanner; None = unknown."""
    if not kept.turn_rad or kept.beam_rad is None or len(kept.beam_rad) < 2:
        return None
    step = float(np.median(np.abs(np.diff(kept.beam_rad))))
    return step * layout.column_step / (abs(kept.turn_rad) * layout.line_step)


def _upright_zoom(n: int, m: int, shape: float | None) -> tuple[int, int]:
    """Return enlargement factors that keep the aspect ratio, if known, and make scans of few rings high enough.

    >>> _upright_zoom(720, 501, 0.5), _upright_zoom(345, 1074, 0.5), _upright_zoom(2198, 64, 2.4)
    ((2, 1), (2, 1), (1, 4))
    """
    across = min(-(-800 // n), 4)
    down = across if shape is None else max(1, round(across * shape))
    while across > 1 and m * down > 1600:
        across -= 1
        down = across if shape is None else max(1, round(across * shape))
    return across, max(down, -(-240 // m))


def _elevations(beam_rad: F64, order: np.ndarray, n_columns: int) -> Axis:
    """Return the vertical axis of an upright picture: elevations if rows are evenly spaced, else columns."""
    elevation = np.rad2deg(np.abs(beam_rad[order])) - 90.0
    if len(elevation) > 2:
        step = (elevation[-1] - elevation[0]) / (len(elevation) - 1)
        even = elevation[0] + step * np.arange(len(elevation))
        if step and np.abs(elevation - even).max() <= max(2 * abs(step), 0.02 * np.ptp(elevation)):
            return Axis("elevation [°]", elevation[0] - step / 2, elevation[-1] + step / 2, cells=False)
    first, stop = (n_columns, 0) if order[0] > order[-1] else (0, n_columns)
    return Axis("column", first, stop)


def describe(drawing: Drawing, loaded: LoadedConfig, options: RenderOptions, name: str) -> str:
    """Return the headline of a picture: file, what labelled it, lines, day."""
    part, config = drawing.part, loaded.config
    words = [name]
    if options.labels is not None:
        labelled = made_by(options.labels)
        words.append(f"labels of {options.labels.name}" + (f", {labelled}" if labelled else ""))
    elif set(drawing.steps) - {"range", "intensity", "reference"}:
        words.append(made_with(loaded))
    if part.is_whole:
        words.append(f"all {part.n_lines:,} lines")
    else:
        block = (
            f"block {part.first // config.prc.lines_per_block}, "
            if options.block is not None or options.figure1
            else ""
        )
        words.append(f"{block}lines {part.first:,} to {part.stop - 1:,} of {part.n_lines:,}")
    lines, columns = drawing.thinned_by
    thinned = [f"1 {name} of {step}" for name, step in (("line", lines), ("column", columns)) if step > 1]
    if thinned:
        words.append(f"{' and '.join(thinned)} drawn")
    if options.station is not None:
        words.append(f"scanner {options.station}")
    if options.hide:
        words.append(f"without {', '.join(options.hide)}")
    return heading(*words)
