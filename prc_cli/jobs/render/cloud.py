"""Point clouds from above and in perspective, in the sensor's frame or as registered."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prc_cli.config import LoadedConfig
from prc_cli.core.classes import Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import F64, I64, U8
from prc_cli.formats import LAS_SUFFIXES, check_input, open_source
from prc_cli.formats.records import RecordSource
from prc_cli.imaging.cloud import (
    Camera,
    DepthBuffer,
    FromAbove,
    Perspective,
    Sample,
    fullest_azimuth,
    splat_for,
)
from prc_cli.imaging.pictures import (
    Bar,
    range_bar,
    range_limits,
    range_picture,
    value_bar,
    value_limits,
    value_picture,
)  # fmt: skip
from prc_cli.imaging.sheet import Axis, Key, Panel, round_step
from prc_cli.jobs.classify import Progress, classify, open_stream
from prc_cli.jobs.render.classes import (
    RecordClasses,
    Vocabulary,
    read_classes,
    vocabulary,
)
from prc_cli.jobs.render.frames import of_station
from prc_cli.jobs.render.heading import heading, made_by, made_with
from prc_cli.jobs.render.options import CONFIDENCE_LIMITS, ColourBy, RenderOptions, RenderResult

AXES = ("x", "y", "z")
NO_CLASSES = (0, 1)
"""Class codes of an unclassified LAS file."""
POINTS_AT_ONCE = 1 << 20
HIGHEST_PERSPECTIVE, HIGHEST_FROM_ABOVE = 0.75, 1.5
"""Largest height of a picture, relative to its largest width."""


@dataclass(frozen=True, slots=True)
class Points:
    """Some points of a cloud."""

    xyz: F64
    """(n, 3) float64 [m]."""
    record: I64
    """(n,) int64, record of the input; -1 = none."""
    values: dict[str, F64]
    """(n,) float64 by name: ``range``, ``intensity``, ``classification``, where the input has them."""
    n_without: int = 0
    """Number of further returns and records outside the lines, whose coordinates the stream does not hold."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """Source of points; may be read repeatedly."""

    source: Path
    loaded: LoadedConfig
    station: int | None
    records: RecordSource | None
    """Records with the file's coordinates; None = use those of the stream, relative to the scanner."""

    @classmethod
    def open(cls, source: Path, loaded: LoadedConfig, station: int | None) -> Cloud:
        """Choose the coordinates: those of the file, or of the stream if ranges are read from sensor coordinates."""
        records = open_source(source, loaded.config.layout)
        rules = loaded.config.input
        by_sensor = rules.range == "sensor-xyz" or rules.lines == "rings"
        if records is not None and not by_sensor and station is None:
            missing = [axis for axis in AXES if axis not in records.dimensions]
            if not missing:
                return cls(source, loaded, station, records)
            shown = ", ".join(records.dimensions[:20])
            if rules.range == "auto":
                problem = f"no coordinates for a cloud: the file has no {missing[0]}, but {shown}"
                raise InputError(str(source), problem, _HINT)
        return cls(source, loaded, station, None)

    @property
    def has_own_classes(self) -> bool:
        """Whether the file holds class codes itself."""
        return self.records is not None and self.source.suffix.lower() in LAS_SUFFIXES

    def points(self, names: tuple[str, ...]) -> Iterator[Points]:
        """Read the points, with the named values where the input has them."""
        yield from self._of_stream(names) if self.records is None else self._of_records(self.records, names)

    def _of_records(self, source: RecordSource, names: tuple[str, ...]) -> Iterator[Points]:
        present = [name for name in names if name in source.dimensions]
        for chunk in source.chunks((*AXES, *present)):
            xyz = np.stack([np.asarray(chunk.values[axis], np.float64) for axis in AXES], axis=1)
            record = chunk.record
            if record is None:
                record = np.arange(chunk.first_record, chunk.first_record + chunk.n, dtype=np.int64)
            yield Points(xyz, record, {name: np.asarray(chunk.values[name], np.float64) for name in present})

    def _of_stream(self, names: tuple[str, ...]) -> Iterator[Points]:
        stream = open_stream(self.source, self.loaded.config.model_copy(update={"method": "prc"}))
        for block in of_station(stream.blocks(), self.station, stream.info.path):
            if block.xyz_m is None:
                problem = "no coordinates for a cloud: the input holds ranges, but no x, y, z"
                raise InputError(str(self.source), problem, _HINT)
            seen = ~np.isnan(block.range_m)
            values = {"range": block.range_m[seen].astype(np.float64)}
            if block.intensity is not None:
                values["intensity"] = block.intensity[seen].astype(np.float64)
            chosen = {name: value for name, value in values.items() if name in names}
            n_without = len(block.extra) + block.tally.n_unplaced
            yield Points(block.xyz_m[seen].astype(np.float64), block.records()[seen], chosen, n_without)


_HINT = "draw the scan (leave --view out), or give a file that has x, y, z"


def draw_cloud(
    source: Path, loaded: LoadedConfig, options: RenderOptions, folder: Path, progress: Progress | None = None
) -> tuple[Panel, Key, RenderResult]:
    """Draw the points of an input in space."""
    _check_options(options)
    check_input(source)
    cloud = Cloud.open(source, loaded, options.station)
    sample, has_classes, n_without = _look(cloud)
    kept = sample.rows()
    if not len(kept):
        raise InputError(str(source), "found no point with coordinates", "check --range and the layout")
    colour = _choose_colour(cloud, options, has_classes)
    words = vocabulary(options, loaded.config.classes)
    classes = None
    if colour == "class" or options.hide:
        classes = _classes(cloud, options, words, folder, progress, has_own=has_classes)
        known = None if cloud.records is None else cloud.records.n_records
        classes.check(known)
    framed = _framed(kept, classes, words)
    camera = _camera(framed, options)
    paint = _Paint.choose(colour, kept, words, classes, source)
    buffer = DepthBuffer(camera, splat_for(sample.n_seen, camera.size))
    counts = np.zeros(len(words.table.names), np.int64)
    for points in cloud.points(paint.names):
        for first in range(0, len(points.xyz), POINTS_AT_ONCE):
            part = slice(first, first + POINTS_AT_ONCE)
            xyz, colours, places = paint.colours(points, part)
            buffer.add(xyz, colours)
            if places is not None:
                counts += np.bincount(places, minlength=len(counts))
    n_hidden = sum(int(counts[place]) for place in words.table.hidden)
    panel = _panel(buffer.picture(), camera, paint.bar, options, colour)
    shown = f"{sample.n_seen - n_hidden:,} points by {colour}"
    hidden = f"without {', '.join(options.hide)}" if options.hide else ""
    head = heading(
        source.name, _labelled(cloud, options, colour, folder, own=has_classes), _seen_from(camera), shown, hidden
    )
    n_out = sample.n_seen - n_hidden - buffer.n_inside
    notes = [f"{n_out:,} points lie outside the picture"] if n_out else []
    if not np.ptp(kept[:, 2]):
        notes.append("all points have one height, as in the scan plane: --html draws lines one behind the other")
    if n_without:
        notes.append(f"{n_without:,} further returns or records that share a cell with another are not drawn")
    key = words.table.key(counts) if colour == "class" else ()
    found = {name: int(count) for name, count in zip(words.table.names, counts, strict=True) if count}
    result = RenderResult(
        (), (0, 0), head, counts=found if colour == "class" else None, n_points=buffer.n_inside, notes=tuple(notes)
    )
    return panel, key, result


def _framed(kept: F64, classes: RecordClasses | None, words: Vocabulary) -> F64:
    """Return the points of a sample that a view must hold, (n, 3) float64: neither noise nor hidden ones, if any."""
    if classes is None:
        return kept[:, :3]
    places = classes.look_up(kept[:, -1].astype(np.int64))
    names = words.table.names
    left_out = {*words.table.hidden, *(place for place, name in enumerate(names) if name == _NOISE)}
    inside = ~np.isin(places, sorted(left_out))
    return kept[inside, :3] if inside.any() else kept[:, :3]


_NOISE = Label.NOISE.name.lower()


def _camera(framed: F64, options: RenderOptions) -> Camera:
    width = options.width
    if options.view == "top":
        return FromAbove.around(framed, width, min(options.height, round(HIGHEST_FROM_ABOVE * width)))
    height, azimuth_deg = min(options.height, round(HIGHEST_PERSPECTIVE * width)), options.azimuth_deg
    if azimuth_deg is None:
        azimuth_deg = fullest_azimuth(framed, options.elevation_deg, width, height)
    return Perspective.around(framed, azimuth_deg, options.elevation_deg, width, height)


def _seen_from(camera: Camera) -> str:
    if not isinstance(camera, Perspective):
        return "from above"
    back = -camera.axes[2]
    azimuth = math.degrees(math.atan2(-camera.axes[0, 1], camera.axes[0, 0])) + 180.0
    return f"from azimuth {round(azimuth, 3) % 360:g}°, {round(math.degrees(math.asin(back[2])), 3):g}° up"


def _labelled(cloud: Cloud, options: RenderOptions, colour: str, folder: Path, *, own: bool) -> str:
    """Return what the classes are from, for the headline."""
    if colour != "class":
        return ""
    if options.reference is not None:
        return f"reference {options.reference.name}"
    given = options.labels
    if given is None and not own:
        decided = cloud.loaded.config.is_decided
        return made_with(cloud.loaded) if decided else made_by(folder / _LABELS)
    by = made_by(cloud.source if given is None else given)
    return by if given is None else f"labels of {given.name}" + (f", {by}" if by else "")


def _check_options(options: RenderOptions) -> None:
    for name, given in (
        ("--steps", options.steps), ("--block", options.block), ("--only-lines", options.lines),
        ("--figure1", options.figure1 or None),
    ):  # fmt: skip
        if given is not None:
            raise ConfigError(name, f"belongs to the scan view, found --view {options.view}", "leave one of them out")
    if options.labels is not None and options.reference is not None:
        where = "--reference"
        raise ConfigError(where, "given together with --labels, expected one of them to colour a cloud by")


def _look(cloud: Cloud) -> tuple[Sample, bool, int]:
    """Read all points once; return a sample, whether the cloud has classes, and how many have no coordinates."""
    sample = Sample(7)
    has_classes, n_without = False, 0
    shown = ("range", "intensity", "confidence")
    names = (*shown, "classification") if cloud.has_own_classes else shown
    for points in cloud.points(names):
        finite = np.isfinite(points.xyz).all(axis=1)
        none = np.full(len(points.xyz), np.nan)
        rows = np.column_stack([points.xyz, *(points.values.get(name, none) for name in shown), points.record])
        sample.add(rows[finite])
        n_without += points.n_without
        if not has_classes and "classification" in points.values:
            has_classes = bool((~np.isin(points.values["classification"], NO_CLASSES)).any())
    return sample, has_classes, n_without


_LABELS = "labels.npy"
"""Name of the classes that are made for the picture."""


def _choose_colour(cloud: Cloud, options: RenderOptions, has_classes: bool) -> ColourBy:
    if options.colour is not None:
        return options.colour
    # inputs other than LAS are scans that can be classified now
    given = options.labels is not None or options.reference is not None
    return "class" if given or has_classes or not cloud.has_own_classes else "height"


def _classes(
    cloud: Cloud, options: RenderOptions, words: Vocabulary, folder: Path, progress: Progress | None, *, has_own: bool
) -> RecordClasses:  # fmt: skip
    """Return the class of every record: from the label file, else from the file itself, else by classifying it."""
    if options.reference is not None:
        return read_classes(
            options.reference,
            options.reference_dimension,
            lambda codes: words.turn(codes, "reference"),
            folder,
            "classes",
        )
    path, dimension = options.labels, options.labels_dimension
    if path is None and has_own:
        return read_classes(cloud.source, dimension, words.turn_las, folder, "classes")
    if path is None:
        path, dimension = folder / _LABELS, None
        classify(cloud.source, path, cloud.loaded, progress=progress)
    return read_classes(path, dimension, lambda codes: words.turn(codes, "predicted"), folder, "classes")


@dataclass(frozen=True, slots=True)
class _Paint:
    """Colours points."""

    by: ColourBy
    limits: tuple[float, float]
    words: Vocabulary
    classes: RecordClasses | None

    @classmethod
    def choose(
        cls, by: ColourBy, sample: F64, words: Vocabulary, classes: RecordClasses | None, source: Path
    ) -> _Paint:  # fmt: skip
        column = {"height": 2, "range": 3, "intensity": 4, "confidence": 5}.get(by)
        if column is None:
            return cls(by, (0.0, 1.0), words, classes)
        values = sample[:, column]
        if not np.isfinite(values).any():
            problem = f"the points have no {by} to be coloured by"
            raise InputError(str(source), problem, "choose another --colour: class, height")
        if by == "confidence":
            return cls(by, CONFIDENCE_LIMITS, words, classes)
        return cls(by, range_limits(values) if by == "range" else value_limits(values), words, classes)

    @property
    def names(self) -> tuple[str, ...]:
        """Values that are needed beside the coordinates."""
        return (self.by,) if self.by in ("range", "intensity", "confidence") else ()

    @property
    def bar(self) -> Bar | None:
        """Colour bar, where colours are a scale."""
        if self.by == "class":
            return None
        return (
            range_bar(self.limits)
            if self.by == "range"
            else value_bar(self.limits, {"height": "m", "confidence": "%"}.get(self.by, ""))
        )

    def colours(self, points: Points, part: slice) -> tuple[F64, U8, U8 | None]:
        """Return coordinates and colours of those of some points that are drawn, and the classes of all of them."""
        places, drawn = None, np.ones(len(points.xyz[part]), bool)
        if self.classes is not None:
            places = self.classes.look_up(points.record[part])
            places = self.words.mark_unscored(places, drawn)
            drawn = ~np.isin(places, sorted(self.words.table.hidden))
        xyz = points.xyz[part][drawn]
        if self.by == "class" and places is not None:
            return xyz, self.words.table.colours[places[drawn]], places
        values = xyz[:, 2] if self.by == "height" else points.values[self.by][part][drawn]
        picture = range_picture if self.by == "range" else value_picture
        return xyz, picture(values, self.limits), places


def _panel(picture: U8, camera: Camera, bar: Bar | None, options: RenderOptions, colour: str) -> Panel:
    """Frame a picture: axes around a view from above, none around a perspective."""
    caption = f"Points coloured by {colour}; steps in depth are shaded."
    if isinstance(camera, FromAbove):
        width, height = camera.size
        x = Axis("x [m]", camera.left, camera.left + width * camera.metres, cells=False)
        y = Axis("y [m]", camera.top, camera.top - height * camera.metres, cells=False)
        length = round_step(width * camera.metres / 8)
        _draw_scale(picture, max(1, round(length / camera.metres)))
        note = f"scale bar {length:g} m, 1 pixel = {_length(camera.metres)}"
        return Panel("from above", picture, x, y, note, bar, (), caption)
    none = Axis("", 0, 0)
    return Panel("perspective", picture, none, none, "", bar, (), caption)


def _draw_scale(picture: U8, length: int) -> None:
    """Draw a scale bar into the lower left corner."""
    height, width = picture.shape[:2]
    if length + 60 > width or height < 60:
        return
    picture[height - 44 : height - 20, 20 : 40 + length] = 255
    picture[height - 32 : height - 26, 30 : 30 + length] = 20
    for at in (30, 30 + length - 2):
        picture[height - 38 : height - 20, at : at + 2] = 20


def _length(metres: float) -> str:
    """Write a small length.

    >>> _length(0.0123), _length(2.5)
    ('1.23 cm', '2.5 m')
    """
    return f"{metres:.3g} m" if metres >= 1 else f"{100 * metres:.3g} cm"
