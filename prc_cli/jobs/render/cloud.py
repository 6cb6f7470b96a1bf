"""Point clouds from above, in the sensor's frame or as registered."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prc_cli.config import LoadedConfig
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import F64, I64, U8
from prc_cli.formats.input import Input
from prc_cli.formats.records import Source
from prc_cli.imaging.cloud import (
    DepthBuffer,
    FromAbove,
    Sample,
    splat_for,
)
from prc_cli.imaging.pictures import Bar, Limits
from prc_cli.imaging.sheet import Axis, Key, Panel, round_step
from prc_cli.jobs.classify import classify, open_for_method
from prc_cli.jobs.render.colours import (
    SCALES,
    RecordClasses,
    Vocabulary,
    heading,
    labels_of,
    made_by,
    made_with,
    vocabulary,
)
from prc_cli.jobs.render.options import WIDEST, RenderOptions, RenderResult
from prc_cli.jobs.render.scan import of_station
from prc_cli.jobs.run import Progress

AXES = ("x", "y", "z")
NO_CLASSES = (0, 1)
"""Class codes of an unclassified LAS file."""
POINTS_AT_ONCE = 1 << 20
MOST_HEIGHT = 1.5
"""Largest height of a picture, relative to its largest width."""
_HINT = "draw the scan (leave --steps top out), or give a file that has x, y, z"
_CODES = "classification"
_LABELS = "labels.npy"
"""Name of the label file that is written for the picture."""


@dataclass(frozen=True, slots=True)
class Points:
    """Some points of a cloud."""

    xyz: F64
    """(n, 3) float64 [m]."""
    record: I64
    """(n,) int64, record of the input; -1 = none."""
    codes: F64 | None = None
    """(n,) float64, class codes; None = not asked for, or the input has none."""
    n_without: int = 0
    """Number of further returns and of records outside the lines: the stream has no coordinates."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """Source of points; may be read repeatedly."""

    scan: Input
    loaded: LoadedConfig
    station: int | None
    records: Source | None
    """Records with the coordinates of the file; None = coordinates of the stream."""

    @classmethod
    def open(cls, scan: Input, loaded: LoadedConfig, station: int | None) -> Cloud:
        """Open a file.

        The points get the coordinates of the file, or of the stream if the ranges are read from
        sensor coordinates.
        """
        records = scan.records()
        rules = loaded.config.input
        by_sensor = rules.range == "sensor-xyz" or rules.lines == "rings"
        if records is not None and not by_sensor and station is None:
            missing = [axis for axis in AXES if axis not in records.dimensions]
            if not missing:
                return cls(scan, loaded, station, records)
            if rules.range == "auto":
                shown = ", ".join(records.dimensions[:20])
                problem = f"no coordinates for a cloud: the file has no {missing[0]}, but {shown}"
                raise InputError(str(scan), problem, _HINT)
        return cls(scan, loaded, station, None)

    @property
    def has_class_codes(self) -> bool:
        """Whether the file can have class codes."""
        return self.records is not None and self.scan.is_las

    def points(self, *, with_codes: bool = False) -> Iterator[Points]:
        """Read the points, with their class codes if asked for and if the file has them."""
        if self.records is None:
            yield from self._of_stream()
            return
        has_codes = with_codes and self.has_class_codes and _CODES in self.records.dimensions
        present = (_CODES,) if has_codes else ()
        for chunk in self.records.chunks((*AXES, *present)):
            xyz = np.stack([np.asarray(chunk.values[axis], np.float64) for axis in AXES], axis=1)
            codes = np.asarray(chunk.values[_CODES], np.float64) if has_codes else None
            yield Points(xyz, chunk.records(), codes)

    def _of_stream(self) -> Iterator[Points]:
        config = self.loaded.config.model_copy(update={"method": "prc"})
        stream = open_for_method(self.scan, config)
        for block in of_station(stream, self.station):
            if block.xyz_m is None:
                problem = "no coordinates for a cloud: the input holds ranges, but no x, y, z"
                raise InputError(str(self.scan), problem, _HINT)
            seen = ~np.isnan(block.range_m)
            n_without = len(block.extra) + block.tally.n_unplaced
            yield Points(
                block.xyz_m[seen].astype(np.float64), block.records()[seen], n_without=n_without
            )


def draw_cloud(
    scan: Input,
    loaded: LoadedConfig,
    options: RenderOptions,
    folder: Path,
    progress: Progress | None = None,
) -> tuple[Panel, Key, RenderResult]:
    """Draw the points of an input in space."""
    _check_options(options)
    scan.check()
    cloud = Cloud.open(scan, loaded, options.station)
    sample, has_classes, n_without = _look(cloud)
    kept = sample.rows()
    if not len(kept):
        raise InputError(
            str(scan), "found no point with coordinates", "check --range and the layout"
        )
    # inputs other than LAS are scans that can be classified now
    has_labels = options.labels is not None or options.reference is not None
    by_class = has_labels or has_classes or not cloud.has_class_codes
    words = vocabulary(options, loaded.config.classes)
    classes = None
    if by_class:
        classes = _classes(cloud, options, words, folder, progress, has_classes=has_classes)
        classes.check(None if cloud.records is None else cloud.records.n_records)
    framed = _framed(kept, classes, words)
    camera = FromAbove.around(framed, WIDEST, round(MOST_HEIGHT * WIDEST))
    limits = SCALES["height"].limits(kept[:, 2])
    width, height = camera.size
    buffer = DepthBuffer(camera, splat_for(sample.n_seen, width * height))
    counts = np.zeros(len(words.table.names), np.int64)
    for points in cloud.points():
        for first in range(0, len(points.xyz), POINTS_AT_ONCE):
            _add(
                buffer,
                points,
                slice(first, first + POINTS_AT_ONCE),
                limits,
                words,
                classes,
                counts,
            )
    bar = None if by_class else SCALES["height"].bar(limits)
    head = heading(
        scan.name,
        _labelled(cloud, options, folder, has_classes=has_classes) if by_class else "",
        "from above",
        f"{sample.n_seen:,} points by {'class' if by_class else 'height'}",
    )
    n_out = sample.n_seen - buffer.n_inside
    notes = [f"{n_out:,} points lie outside the picture"] if n_out else []
    if not np.ptp(kept[:, 2]):
        notes.append(
            "all points have one height, as in the scan plane: "
            "a page, OUT.html, draws lines one behind the other"
        )
    if n_without:
        notes.append(
            f"{n_without:,} further returns or records that share a cell with another are not drawn"
        )
    result = RenderResult(
        (),
        (0, 0),
        head,
        counts=words.table.count_by_name(counts) if by_class else None,
        n_points=buffer.n_inside,
        notes=tuple(notes),
    )
    return (
        _panel(buffer.picture(), camera, bar),
        words.table.key(counts) if by_class else (),
        result,
    )


def _check_options(options: RenderOptions) -> None:
    if options.lines is not None:
        problem = "belongs to lines and columns, found --steps top"
        raise ConfigError("--only", problem, "leave one of them out")
    if options.labels is not None and options.reference is not None:
        raise ConfigError(
            "--reference", "given together with --labels, expected one of them to colour a cloud by"
        )


def _look(cloud: Cloud) -> tuple[Sample, bool, int]:
    # a sample (x, y, z, record), whether the file has classes, and
    # the number of points without coordinates
    sample = Sample(4)
    has_classes = False
    n_without = 0
    for points in cloud.points(with_codes=True):
        rows = np.column_stack([points.xyz, points.record])
        sample.add(rows[np.isfinite(points.xyz).all(axis=1)])
        n_without += points.n_without
        if not has_classes and points.codes is not None:
            has_classes = bool((~np.isin(points.codes, NO_CLASSES)).any())
    return sample, has_classes, n_without


def _classes(
    cloud: Cloud,
    options: RenderOptions,
    words: Vocabulary,
    folder: Path,
    progress: Progress | None,
    *,
    has_classes: bool,
) -> RecordClasses:
    # from a label file, else from the input, else by classifying it
    if options.reference is not None:
        return words.read(options.reference, None, "reference", folder)
    if options.labels is not None:
        return words.read(options.labels, options.labels_dimension, "predicted", folder)
    if has_classes:
        return words.read(cloud.scan.path, options.labels_dimension, "las", folder)
    classify(cloud.scan.path, folder / _LABELS, cloud.loaded, progress=progress)
    return words.read(folder / _LABELS, None, "predicted", folder)


def _labelled(
    cloud: Cloud,
    options: RenderOptions,
    folder: Path,
    *,
    has_classes: bool,
) -> str:
    # source of the classes, for the headline
    if options.reference is not None:
        return f"reference {options.reference.name}"
    if options.labels is not None:
        return labels_of(options.labels)
    if has_classes:
        return made_by(cloud.scan.path)
    return made_with(cloud.loaded) if cloud.loaded.config.is_decided else made_by(folder / _LABELS)


def _framed(kept: F64, classes: RecordClasses | None, words: Vocabulary) -> F64:
    # (n, 3), points that the view must contain: not noise
    if classes is None:
        return kept[:, :3]
    inside = ~np.isin(classes.look_up(kept[:, -1].astype(np.int64)), sorted(words.noise))
    return kept[inside, :3] if inside.any() else kept[:, :3]


def _add(
    buffer: DepthBuffer,
    points: Points,
    part: slice,
    limits: Limits,
    words: Vocabulary,
    classes: RecordClasses | None,
    counts: I64,
) -> None:
    xyz = points.xyz[part]
    if classes is None:
        buffer.add(xyz, SCALES["height"].picture(xyz[:, 2], limits))
        return
    places = words.mark_unscored(classes.look_up(points.record[part]), np.ones(len(xyz), bool))
    counts += np.bincount(places, minlength=len(counts))
    buffer.add(xyz, words.table.colours[places])


def _panel(
    picture: U8,
    camera: FromAbove,
    bar: Bar | None,
) -> Panel:
    metres = camera.metres
    (width, height) = camera.size
    x = Axis("x [m]", camera.left, camera.left + width * metres, cells=False)
    y = Axis("y [m]", camera.top, camera.top - height * metres, cells=False)
    length_m = round_step(width * metres / 8)
    _draw_scale(picture, max(1, round(length_m / metres)))
    pixel = f"{metres:.3g} m" if metres >= 1 else f"{100 * metres:.3g} cm"
    note = f"scale bar {length_m:g} m, 1 pixel = {pixel}"
    return Panel("from above", picture, x, y, note, bar)


def _draw_scale(picture: U8, length: int) -> None:
    height, width = picture.shape[:2]
    if length + 60 > width or height < 60:
        return
    picture[height - 44 : height - 20, 20 : 40 + length] = 255
    picture[height - 32 : height - 26, 30 : 30 + length] = 20
    for left in (30, 30 + length - 2):
        picture[height - 38 : height - 20, left : left + 2] = 20
