"""Scan pictures of lines and columns: a block as in the paper, a static scan, a drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.config import LoadedConfig
from prc_cli.core.blocks import regroup
from prc_cli.core.classes import LABEL_COLOURS, Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import ReadTally, ScanBlock, ScanStream
from prc_cli.core.types import F64, I64, U8
from prc_cli.evaluation.mapping import Side
from prc_cli.formats.input import Input
from prc_cli.imaging.pictures import (
    AGREE_COLOUR,
    Bar,
    Limits,
    difference_picture,
    mask_picture,
    segment_picture,
)
from prc_cli.imaging.sheet import FRAME_HEIGHT, Axis, Key, Panel, zoom_for
from prc_cli.jobs.classify import label_blocks, open_for_method
from prc_cli.jobs.progress import advance
from prc_cli.jobs.render.colours import (
    LABEL_TABLE,
    SCALES,
    ClassTable,
    RecordClasses,
    Vocabulary,
    heading,
    labels_of,
    made_with,
    share_text,
    thinned,
    vocabulary,
)
from prc_cli.jobs.render.options import PRC_STEPS, TITLES, WIDEST, RenderOptions, choose_steps
from prc_cli.jobs.run import Progress
from prc_cli.methods.base import MethodParams, OneByOne, Wanted
from prc_cli.methods.prc.pipeline import (
    PrcParams,
    PrcState,
    PrcTrace,
    classify_block,
    initial_state,
)
from prc_cli.streams.beams import with_beams

Plane: TypeAlias = NDArray[Any]
"""(lines, M): ranges, masks, ids, labels."""
Images: TypeAlias = dict[str, Plane]
"""Planes by step."""

TURN_LINES = 64
"""Lines examined for a rotation of the scanner."""
LEAST_TURN_RAD = 1e-4
"""Smallest azimuth step between lines that counts as a rotation [rad]."""
SEGMENT_COLOURS = 1 << 30
"""Segment ids are drawn modulo this number."""
DRIVE_HEIGHT = 800
UPRIGHT_HEIGHT = 1100
BLOCK_HEIGHT = 5860
"""Highest picture of a drive, of an upright scan, and of all steps of a block [pixels]."""
NOT_LABELLED = {"range", "intensity", "reference"}
"""Steps that need no classifier."""
_NO_RETURN = "no return"
_AGREE = "both agree"


def open_for_pictures(scan: Input, loaded: LoadedConfig) -> ScanStream:
    """Open a stream, with beam angles if they can be computed, for any classifier."""
    stream = open_for_method(scan, loaded.config)
    if loaded.config.needs_beams:
        return stream
    # without beam angles the picture lies on its side; damage is reported when the stream is read
    with suppress(InputError, ConfigError):
        return with_beams(stream, loaded.config.input)
    return stream


def of_station(
    stream: ScanStream, station: int | None, met: dict[int, None] | None = None
) -> Iterator[ScanBlock]:
    """Yield the blocks of one scanner, by default the first; add all scanners to ``met``."""
    met = {} if met is None else met
    for block in stream.blocks():
        met.setdefault(block.scanner)
        if block.scanner == (next(iter(met)) if station is None else station):
            yield block
    if station is not None and met and station not in met:
        numbers = ", ".join(str(number) for number in sorted(met)[:20])
        shown = f"one, number {numbers}" if len(met) == 1 else f"{len(met)}, numbers {numbers}"
        shown += ", ..." if len(met) > 20 else ""
        raise ConfigError(
            "render.station", f"found {station}, but {stream.info.path} holds {shown}"
        )


def upright(beam_rad: F64 | None) -> NDArray[np.intp] | None:
    """Return the columns of a vertical line from the sky to the ground.

    None if lines are not vertical.

    >>> upright(np.deg2rad([10.0, 90.0, 140.0])).tolist()
    [2, 1, 0]
    """
    if beam_rad is None or not ((beam_rad >= 0).all() or (beam_rad <= 0).all()):
        return None
    return np.argsort(-np.abs(beam_rad), kind="stable")


def turns(block: ScanBlock) -> float:
    """Return the turn of a scanner from line to line, seen from above [rad]; 0 = none."""
    if block.xyz_m is None or block.n_lines < 2:
        return 0.0
    x, y = (block.xyz_m[: TURN_LINES + 1, :, axis].astype(np.float64) for axis in (0, 1))
    with np.errstate(invalid="ignore"):
        step = np.arctan2(x[:-1] * y[1:] - y[:-1] * x[1:], x[:-1] * x[1:] + y[:-1] * y[1:])
        step = step[(np.hypot(x, y)[:-1] > 0) & (np.hypot(x, y)[1:] > 0)]
    middle = float(np.median(step)) if step.size else 0.0
    return middle if abs(middle) > LEAST_TURN_RAD else 0.0


def frames(
    blocks: Iterator[ScanBlock],
    params: MethodParams,
    steps: tuple[str, ...],
    *,
    classify: bool,
) -> Iterator[tuple[ScanBlock, Images]]:
    """Yield blocks with the images of the steps; classify them if the steps need it."""
    images: Iterator[tuple[ScanBlock, Images]] = ((block, {}) for block in blocks)
    if classify and isinstance(params, PrcParams) and set(steps) & set(PRC_STEPS):
        images = _traced(blocks, params, steps)
    elif classify:
        images = _labelled(blocks, params, steps)
    for block, planes in images:
        if "intensity" in steps:
            if block.intensity is None:
                raise ConfigError("--steps", "found 'intensity', but the input has none")
            planes["intensity"] = block.intensity
        yield block, {"range": block.range_m, **planes}


def _ids(segments: NDArray[np.int64]) -> Plane:
    return np.where(segments > 0, segments % SEGMENT_COLOURS + 1, 0).astype(np.int32)


def _critical(trace: PrcTrace) -> Plane:
    # (lines, M) [m]: from here on both neighbourhoods support a shot
    assert trace.critical is not None
    return np.maximum(trace.critical.in_line_m, trace.critical.adjacent_m)


_TRACED: Mapping[str, Callable[[PrcTrace], Plane]] = {
    "support": lambda trace: trace.supported,
    "background": lambda trace: trace.background,
    "critical": _critical,
    # filling labels only shots of G: without them these are the components before filling
    "components": lambda trace: np.where(
        trace.supported & ~trace.background, trace.components.image, np.int32(0)
    ),
    "segments": lambda trace: _ids(trace.components.to_segments()),
    "surfaces": lambda trace: _ids(trace.surfaces.to_patches()),
    "segmentation": lambda trace: _ids(trace.surfaces.to_segments()),
}


def _traced(
    blocks: Iterator[ScanBlock], params: PrcParams, steps: tuple[str, ...]
) -> Iterator[tuple[ScanBlock, Images]]:
    # runs PRC and keeps its intermediate images
    turn: OneByOne[PrcState] | None = None
    for block in regroup(blocks, params.lines_per_block):
        turn = turn or OneByOne(initial_state(block.points_per_line))
        trace = classify_block(
            block.range_m, block.next_m, turn, params, segments=True, critical="critical" in steps
        )
        yield (
            block,
            {
                "classes": trace.labels,
                **{step: _TRACED[step](trace) for step in steps if step in _TRACED},
            },
        )


def _labelled(
    blocks: Iterator[ScanBlock], params: MethodParams, steps: tuple[str, ...]
) -> Iterator[tuple[ScanBlock, Images]]:
    for item in label_blocks(blocks, params, wanted=Wanted(confidence="confidence" in steps)):
        planes = {"classes": item.labels}
        seen = ~np.isnan(item.block.range_m)
        if item.confidence is not None:
            planes["confidence"] = np.where(
                seen, item.confidence.astype(np.float32), np.float32(np.nan)
            )
        yield item.block, planes


@dataclass(frozen=True, slots=True)
class Part:
    """The lines to draw."""

    first: int
    stop: int
    n_lines: int
    """Lines of the whole stream."""
    scanner: str = ""
    """Name of the scanner, if there are several."""

    @property
    def is_whole(self) -> bool:
        """Whether all lines are drawn."""
        return self.stop - self.first == self.n_lines

    def inside(self, block: ScanBlock) -> tuple[int, int]:
        """Return the first line of a block that is drawn, and the last + 1."""
        first = max(self.first - block.first_line, 0)
        return first, min(self.stop - block.first_line, block.n_lines)

    def sentence(self) -> str:
        """Name the lines for a headline."""
        lines = "all" if self.is_whole else f"lines {self.first:,} to {self.stop - 1:,} of"
        return f"{lines} {self.n_lines:,}"


@dataclass(frozen=True, slots=True)
class Drawing:
    """Pictures of a scan, before they are put on a page."""

    panels: tuple[Panel, ...]
    """From top to bottom."""
    part: Part
    steps: tuple[str, ...]
    thinned_by: tuple[int, int]
    counts: dict[str, int]
    n_compared: int
    n_differing: int


@dataclass(frozen=True, slots=True)
class _Layout:
    """Arrangement of lines and columns on the page."""

    kind: Literal["block", "upright", "drive"]
    """``block``: columns across, lines down. ``upright``: lines across, the sky at the top.
    ``drive``: lines across, columns down."""
    line_step: int
    column_step: int


def draw_scan(
    scan: Input,
    loaded: LoadedConfig,
    options: RenderOptions,
    folder: Path,
    progress: Progress | None = None,
) -> Drawing:
    """Draw the steps of a scan."""
    method = loaded.config.method
    _check_part(method, options)
    steps = choose_steps(method, options)
    words = vocabulary(options, loaded.config.classes)
    stream = open_for_pictures(scan, loaded)
    # labels first: they are small, and classifying takes long
    sides: dict[Side, RecordClasses] = {}
    if options.labels is not None:
        sides["predicted"] = words.read(
            options.labels, options.labels_dimension, "predicted", folder
        )
    if options.reference is not None:
        sides["reference"] = words.read(options.reference, None, "reference", folder)
    for classes in sides.values():
        classes.check(stream.info.n_records)
    part = choose_part(options, loaded, stream)
    first = next(of_station(stream, options.station), None)
    if first is None:
        raise InputError(str(scan), "found no scan lines, expected at least one")
    layout = _choose_layout(first, part, len(steps), options)
    table = words.table if "predicted" in sides else LABEL_TABLE
    sheet = _Sheet(part, layout, steps, words, table, first.beam_rad, turns(first))
    classify = "predicted" not in sides and bool(set(steps) - NOT_LABELLED)
    info = stream.info
    tally = ReadTally()
    n_read = 0
    for block, planes in frames(
        of_station(stream, options.station), loaded.config.classifier, steps, classify=classify
    ):
        _add_sides(block, planes, words, sides)
        sheet.keep(block, planes)
        advance(progress, block, info)
        tally = tally + block.tally
        n_read = max(n_read, int(block.records().max(initial=-1)) + 1)
        if block.first_line + block.n_lines >= part.stop:
            break
    if (
        part.stop == part.n_lines
        and tally.n_records
        and stream.info.n_records is None
        and options.station is None
    ):
        for classes in sides.values():
            classes.check(max(tally.n_records, n_read))
    return sheet.drawing()


def _check_part(method: str, options: RenderOptions) -> None:
    if options.is_figure1 and method != "prc":
        raise ConfigError(
            "--steps figure1", f"belongs to prc, found the method {method}", "add --set method=prc"
        )
    if options.is_figure1 and options.labels is not None:
        problem = "the figure shows the steps of prc, which a label file does not hold"
        raise ConfigError("--steps figure1", problem, "leave --labels out")


def choose_part(options: RenderOptions, loaded: LoadedConfig, stream: ScanStream) -> Part:
    """Return the lines to draw; reads the stream if its header has no number of lines."""
    info = stream.info
    many = (
        loaded.config.input.scanner != "none"
        or info.facts.has_scans
        or len(info.facts.scanners) > 1
    )
    n_lines = info.n_lines if not many and options.station is None else None
    scanner = ""
    met = dict[int, None]()
    if n_lines is None:
        n_lines = sum(block.n_lines for block in of_station(stream, options.station, met))
    if len(met) > 1:
        number = next(iter(met)) if options.station is None else options.station
        names = info.facts.scanners
        scanner = f"scanner {number} of {len(met)}"
        if number < len(names):
            scanner += f": {names[number]}"
    k = loaded.config.prc.lines_per_block
    if options.is_figure1 and options.lines is None:
        # the second block, or the only one
        first = min(1, -(-n_lines // k) - 1) * k
        return Part(first, min(first + k, n_lines), n_lines, scanner)
    if options.lines is not None:
        first, stop = options.lines
        if not 0 <= first < stop or first >= n_lines:
            problem = f"found {first}:{stop}, expected A:B within 0:{n_lines} and A below B"
            raise ConfigError("--only", problem)
        return Part(first, min(stop, n_lines), n_lines, scanner)
    return Part(0, n_lines, n_lines, scanner)


def _choose_layout(
    first: ScanBlock,
    part: Part,
    n_steps: int,
    options: RenderOptions,
) -> _Layout:
    n = part.stop - part.first
    m = first.points_per_line
    width = WIDEST
    if upright(first.beam_rad) is not None and not options.is_figure1:
        return _Layout("upright", -(-n // width), -(-m // UPRIGHT_HEIGHT))
    if options.is_figure1 or n <= m:
        height = max(200, BLOCK_HEIGHT // n_steps - FRAME_HEIGHT)
        return _Layout("block", -(-n // height), -(-m // width))
    return _Layout("drive", -(-n // width), -(-m // DRIVE_HEIGHT))


def _add_sides(
    block: ScanBlock,
    planes: Images,
    words: Vocabulary,
    sides: Mapping[Side, RecordClasses],
) -> None:
    # adds the classes of label files and of the classifier, as indices of the class table
    record = block.records()
    seen = ~np.isnan(block.range_m)
    for side, classes in sides.items():
        planes[side] = words.mark_unscored(classes.look_up(record), seen)
    if "predicted" in sides:
        planes["classes"] = planes["predicted"]
    elif sides and "classes" in planes:
        planes["predicted"] = words.mark_unscored(words.turn_labels(planes["classes"]), seen)


@dataclass(slots=True)
class _Sheet:
    """Thinned images and full counts, collected while the stream is read and then coloured."""

    part: Part
    layout: _Layout
    steps: tuple[str, ...]
    words: Vocabulary
    class_table: ClassTable
    """Table of the step ``classes``."""
    beam_rad: F64 | None
    turn_rad: float
    kept: dict[str, list[Plane]] = field(default_factory=dict)
    counts: dict[str, I64] = field(default_factory=dict)
    """Shots by class of every class image, before thinning."""
    n_compared: int = 0
    n_differing: int = 0

    @property
    def tables(self) -> dict[str, ClassTable]:
        """Classes of pictures, by step."""
        return {"classes": self.class_table, "reference": self.words.table}

    def keep(self, block: ScanBlock, planes: Images) -> None:
        """Count the shots of the part, and keep the lines and columns to draw."""
        low, high = self.part.inside(block)
        if low >= high:
            return
        inside = {name: plane[low:high] for name, plane in planes.items()}
        size = max(len(self.words.table.names), len(Label))
        for side in ("classes", "predicted", "reference"):
            if side in inside:
                self.counts[side] = np.bincount(
                    inside[side].ravel(), minlength=size
                ) + self.counts.get(side, 0)
        if "predicted" in inside and "reference" in inside:
            predicted = inside["predicted"]
            reference = inside["reference"]
            unscored = self.words.unscored
            is_compared = (predicted > 0) & (predicted != unscored)
            is_compared &= (reference > 0) & (reference != unscored)
            self.n_compared += int(np.count_nonzero(is_compared))
            self.n_differing += int(np.count_nonzero(is_compared & (predicted != reference)))
        start = (self.part.first - block.first_line - low) % self.layout.line_step
        names = {*self.steps, *(("predicted", "reference") if "difference" in self.steps else ())}
        for name in names & set(inside):
            thin = np.ascontiguousarray(
                inside[name][start :: self.layout.line_step, :: self.layout.column_step]
            )
            self.kept.setdefault(name, []).append(thin)

    def drawing(self) -> Drawing:
        layout = self.layout
        part = self.part
        planes = {name: np.concatenate(parts) for name, parts in self.kept.items()}
        scales = {step: SCALES[step].limits(planes[step]) for step in self.steps if step in SCALES}
        keys = self._keys()
        n_drawn = len(next(iter(planes.values())))
        lines = part.first, part.first + n_drawn * layout.line_step
        panels = []
        for step in self.steps:
            picture, bar = self._paint(step, planes, scales)
            panels.append(self._panel(step, picture, bar, keys.get(step, ()), lines))
        side, table = (
            ("classes", self.class_table)
            if "classes" in self.counts
            else ("reference", self.words.table)
        )
        counts = table.count_by_name(self.counts.get(side, np.zeros(len(table.names), np.int64)))
        return Drawing(
            tuple(panels),
            part,
            self.steps,
            (layout.line_step, layout.column_step),
            counts,
            self.n_compared,
            self.n_differing,
        )

    def _keys(self) -> dict[str, Key]:
        # the key of every class picture: classes that occur, with shares
        keys: dict[str, Key] = {}
        for step, table in self.tables.items():
            counts = self.counts.get(step)
            if counts is None:
                continue
            keys[step] = table.key(counts[: len(table.names)])
            if counts[0]:
                share = share_text(int(counts[0]), int(counts.sum()))
                keys[step] += (
                    (f"{_NO_RETURN} ({share} of all shots)", LABEL_COLOURS[Label.MISSING]),
                )
        if "predicted" in self.counts and "reference" in self.counts:
            counts = self.counts["predicted"].copy()
            counts[self.words.unscored] += self.counts["reference"][self.words.unscored]
            keys["difference"] = ((_AGREE, AGREE_COLOUR), *_names(self.words.table, counts))
        return keys

    def _paint(
        self, step: str, planes: Images, scales: Mapping[str, Limits]
    ) -> tuple[U8, Bar | None]:
        # the (lines, columns, 3) picture of some of the drawn lines, and its colour bar
        if step == "difference":
            table = self.words.table.colours
            unscored = self.words.unscored
            return difference_picture(
                planes["predicted"], planes["reference"], table, unscored
            ), None
        plane = planes[step]
        if step in SCALES:
            return SCALES[step].picture(plane, scales[step]), SCALES[step].bar(scales[step])
        if step in self.tables:
            picture: U8 = self.tables[step].colours[plane]
            return picture, None
        return (mask_picture if step in ("support", "background") else segment_picture)(plane), None

    def _panel(
        self,
        step: str,
        picture: U8,
        bar: Bar | None,
        key: Key,
        lines: tuple[int, int],
    ) -> Panel:
        """Orient a picture for viewing and add its axes."""
        title = TITLES[step]
        layout = self.layout
        (n, m) = picture.shape[:2]
        note = ""
        if step == "difference" and self.n_compared:
            share = share_text(self.n_differing, self.n_compared)
            note = f"{share} of {self.n_compared:,} shots differ"
        along = Axis("line", *lines)
        across = Axis("column", 0, m * layout.column_step)
        beam_rad = None if self.beam_rad is None else self.beam_rad[:: layout.column_step]
        order = upright(beam_rad)
        if layout.kind == "block":
            return Panel(title, picture, across, along, note, bar, key, zoom_for(m, n))
        if beam_rad is None or order is None:
            picture = picture.swapaxes(0, 1)
            return Panel(title, picture, along, across, note, bar, key, zoom_for(n, m))
        picture = picture[:, order].swapaxes(0, 1)
        if self.turn_rad > 0:
            picture = picture[:, ::-1]
            along = Axis("line", lines[1], lines[0])
        side = _elevations(beam_rad, order, m * layout.column_step)
        zoom = _upright_zoom(n, m, self._shape())
        return Panel(title, picture, along, side, note, bar, key, zoom)

    def _shape(self) -> float | None:
        # ratio of height to width of a drawn cell, as angles from the scanner; None = unknown
        if not self.turn_rad or self.beam_rad is None or len(self.beam_rad) < 2:
            return None
        step = float(np.median(np.abs(np.diff(self.beam_rad))))
        return step * self.layout.column_step / (abs(self.turn_rad) * self.layout.line_step)


def _names(table: ClassTable, counts: I64) -> Key:
    # without shares, which differ between pictures
    no_return = ((_NO_RETURN, table.colour(0)),) if counts[0] else ()
    return (*((table.names[i], table.colour(i)) for i in table.drawn(counts)), *no_return)


def _upright_zoom(n: int, m: int, shape: float | None) -> tuple[int, int]:
    """Return enlargement factors that keep a known aspect ratio and make few rings high enough.

    >>> _upright_zoom(720, 501, 0.5), _upright_zoom(345, 1074, 0.5), _upright_zoom(2198, 64, 2.4)
    ((2, 1), (2, 1), (1, 4))
    """
    across = min(-(-800 // n), 4)
    down = across if shape is None else max(1, round(across * shape))
    while across > 1 and m * down > 1600:
        across -= 1
        down = across if shape is None else max(1, round(across * shape))
    return across, max(down, -(-240 // m))


def _elevations(beam_rad: F64, order: NDArray[np.intp], n_columns: int) -> Axis:
    # elevations if rows are evenly spaced, else columns
    elevation = np.rad2deg(np.abs(beam_rad[order])) - 90.0
    if len(elevation) > 2:
        step = (elevation[-1] - elevation[0]) / (len(elevation) - 1)
        even = elevation[0] + step * np.arange(len(elevation))
        if step and np.abs(elevation - even).max() <= max(2 * abs(step), 0.02 * np.ptp(elevation)):
            return Axis(
                "elevation [°]", elevation[0] - step / 2, elevation[-1] + step / 2, cells=False
            )
    first, stop = (n_columns, 0) if order[0] > order[-1] else (0, n_columns)
    return Axis("column", first, stop)


def describe(
    drawing: Drawing,
    loaded: LoadedConfig,
    options: RenderOptions,
    name: str,
) -> str:
    """Return the headline of a picture: file, source of the labels, lines, day."""
    part = drawing.part
    labelled = ""
    if options.labels is not None:
        labelled = labels_of(options.labels)
    elif set(drawing.steps) - NOT_LABELLED:
        labelled = made_with(loaded)
    lines = f"{part.sentence()} lines" if part.is_whole else part.sentence()
    if not part.is_whole and options.is_figure1:
        lines = f"block {part.first // loaded.config.prc.lines_per_block}, {lines}"
    step = thinned(drawing.thinned_by)
    return heading(
        name,
        labelled,
        lines,
        f"{step} drawn" if step else "",
        part.scanner,
    )
