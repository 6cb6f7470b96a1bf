"""``prc render IN OUT.html``: a page with the cloud and the range image of a scan."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.config import LoadedConfig, options_of, preset_of, refuse_window, resolve
from prc_cli.core.classes import Surface
from prc_cli.core.errors import ConfigError, InputError, PrcError
from prc_cli.core.files import atomic_output, prepare_outputs, temporary_folder
from prc_cli.core.stream import LabelledBlock, ScanStream
from prc_cli.core.types import F64, I64, Mask
from prc_cli.core.version import __version__
from prc_cli.formats.input import Input
from prc_cli.formats.records import Source
from prc_cli.formats.writing.columns import behind
from prc_cli.imaging.viewer import ClassEntry, Shots, Values, viewer_page
from prc_cli.jobs.choice import decide
from prc_cli.jobs.classify import label_blocks
from prc_cli.jobs.coordinates import placed_source, spacing
from prc_cli.jobs.render.cloud import AXES, NO_CLASSES, Cloud
from prc_cli.jobs.render.colours import (
    RecordClasses,
    Vocabulary,
    heading,
    labels_of,
    made_by,
    made_with,
    share_text,
    thinned,
    vocabulary,
)
from prc_cli.jobs.render.options import RenderOptions, RenderResult
from prc_cli.jobs.render.scan import (
    Part,
    choose_part,
    of_station,
    open_for_pictures,
    turns,
    upright,
)
from prc_cli.jobs.run import Progress
from prc_cli.methods.base import Wanted
from prc_cli.methods.reasons import sentences

_FLAT = 1e-3
"""All lines lie in one plane if the extent across is below this share of the extent within."""
_NONE = np.empty(0)
STAGES: dict[str, Values] = {
    "height_above_ground": Values("height above ground", _NONE, 0.001),
    "ground_height": Values("height of the ground", _NONE, 0.001, is_scale=False),
    "surface": Values(
        "coarse class",
        _NONE,
        1.0,
        1,
        "",
        words={surface.value: surface.name.lower() for surface in Surface if surface},
    ),
    "dense_vegetation": Values("dense vegetation", _NONE, 1.0, 1, "", words={0: "no", 1: "yes"}),
    "segment_id": Values("segment", _NONE, 1.0, 4, "", is_scale=False),
    "confidence": Values("confidence", _NONE, 1.0, 1, "%"),
    "reason": Values("because", _NONE, 1.0, 1, "", words=sentences()),
}
"""Values of the classifier by the names of its output columns."""


@dataclass(slots=True)
class _Kept:
    """Shots of the page (every n-th), collected while the stream is read, and counts of all."""

    part: Part
    words: Vocabulary
    classes: RecordClasses | None
    counts: I64
    """Shots by class over all lines, before thinning."""
    step: tuple[int, int] = (1, 1)
    parts: dict[str, list[NDArray[Any]]] = field(default_factory=dict)
    beam_rad: F64 | None = None
    turn_rad: float = 0.0

    def add(self, item: LabelledBlock) -> None:
        block = item.block
        (low, high) = self.part.inside(item.block)
        if self.beam_rad is None:
            self.beam_rad, self.turn_rad = block.beam_rad, self.turn_rad or turns(block)
        if low >= high:
            return
        record = block.records()
        seen = ~np.isnan(block.range_m)
        classes = (
            self.words.turn_labels(item.labels)
            if self.classes is None
            else self.classes.look_up(record)
        )
        classes = self.words.mark_unscored(np.where(seen, classes, np.uint8(0)), seen)
        self.counts += np.bincount(classes[low:high].ravel(), minlength=len(self.counts))
        start = low + (self.part.first - block.first_line - low) % self.step[0]
        cells = (slice(start, high, self.step[0]), slice(None, None, self.step[1]))
        planes: dict[str, NDArray[Any] | None] = {
            "range": block.range_m,
            "class": classes,
            "record": record,
            "time": block.time_s,
            "intensity": block.intensity,
            "xyz": block.xyz_m,
            "height_above_ground": item.above_m,
            "reason": item.reasons,
        }
        if item.stages is not None:
            planes["surface"] = item.stages.surface
            planes["dense_vegetation"] = item.stages.dense_vegetation
            planes["ground_height"] = item.stages.ground_height_m
        for name, plane in planes.items():
            if plane is not None:
                self.parts.setdefault(name, []).append(np.array(plane[cells]))

    def take(self, name: str) -> NDArray[Any] | None:
        """Remove and return a collected column; None unless every block had it."""
        parts = self.parts.pop(name, [])
        return np.concatenate(parts) if parts and len(parts) == len(self.parts["range"]) else None


def render_viewer(
    source: Path | str,
    output: Path | str,
    config: LoadedConfig,
    options: RenderOptions | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> RenderResult:
    """Write a page with the cloud and the range image of a scan, to turn, zoom and click."""
    scan, loaded = resolve(source, config)
    output = Path(output)
    chosen = RenderOptions() if options is None else options
    _check(output, chosen)
    refuse_window(loaded.config, "prc render")
    prepare_outputs(output, overwrite=overwrite, inputs=loaded.inputs(scan.path, chosen.labels))
    scan.check()
    with temporary_folder("prc-render-") as scratch:
        words = vocabulary(chosen, loaded.config.classes)
        classes, origin = existing_classes(scan, loaded, chosen, words, scratch)
        if classes is None:
            loaded = decide(scan, loaded)
            origin = made_with(loaded)
        placed = None
        if chosen.trajectory is not None:
            layout = config.config.layout
            placed = placed_source(
                scan.path, scan.path, chosen.trajectory, chosen.mount, layout=layout
            )
        stream = open_for_pictures(scan, loaded)
        if classes is not None:
            classes.check(stream.info.n_records)
        kept = _collect(stream, loaded, chosen, words, classes, progress)
        shots, notes = _shots(scan, loaded, chosen, stream, kept, placed)
    part = kept.part
    head = heading(origin, f"{part.sentence()} lines", part.scanner, thinned(kept.step))
    text = viewer_page(
        shots,
        title=scan.name,
        head=head,
        notes=notes,
        foot=f"Written by prc render {__version__}.",
        labels=words.hand_labels(
            chosen.labels or scan.path,
            stream.info.n_records,
            predicted="" if chosen.labels or scan.is_las else "PREDICTED",
        ),
        why="" if classes is not None else _explain(scan, loaded, chosen),
    )
    with atomic_output(output, overwrite=overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return RenderResult(
        (output,),
        (0, 0),
        f"{scan.name} · {head}",
        lines=(part.first, part.stop),
        thinned_by=kept.step,
        counts=words.table.count_by_name(kept.counts),
        n_points=0 if shots.xyz_m is None else int(np.isfinite(shots.xyz_m[..., 0]).sum()),
        notes=notes,
    )


def _explain(scan: Input, loaded: LoadedConfig, options: RenderOptions) -> str:
    # the command that explains the class of a shot, without the place of the shot
    words = ["prc", "explain", scan.name]
    preset = preset_of(loaded)
    if preset is not None:
        words += ["--preset", preset]
    words += options_of(loaded)
    if options.station is not None:
        words += ["--station", str(options.station)]
    return shlex.join([*words, "--at"])


def _check(output: Path, options: RenderOptions) -> None:
    if output.suffix.lower() not in (".html", ".htm"):
        raise ConfigError(
            str(output), f"found the suffix {output.suffix!r}, expected .html", "rename the output"
        )
    for name, value in (
        ("--steps", options.steps),
        ("--reference", options.reference),
    ):
        if value is not None:
            raise ConfigError(
                name, "belongs to pictures, found a page to write", "leave one of them out"
            )


def existing_classes(
    scan: Input,
    loaded: LoadedConfig,
    options: RenderOptions,
    words: Vocabulary,
    folder: Path,
) -> tuple[RecordClasses | None, str]:
    """Return the classes of a label file or of the input, and their source; None = no classes."""
    if options.labels is not None:
        classes = words.read(options.labels, options.labels_dimension, "predicted", folder)
        return classes, labels_of(options.labels)
    records = scan.records() if scan.is_las else None
    name = "classification"
    if records is None or not any(
        (~np.isin(chunk.values[name], NO_CLASSES)).any() for chunk in records.chunks((name,))
    ):
        return None, ""
    classes = words.read(scan.path, options.labels_dimension, "las", folder)
    return classes, made_by(scan.path) or "classes of the file"


def _steps(n_lines: int, n_columns: int, most: int) -> tuple[int, int]:
    """Return the steps in lines and columns that keep at most ``most`` shots, about equal steps.

    >>> _steps(600, 2154, 1_500_000), _steps(6_000, 2154, 1_500_000)
    ((1, 1), (3, 3))
    >>> _steps(1_000_000, 100, 1_000_000)
    (10, 10)
    """
    if n_lines * n_columns <= most:
        return 1, 1
    columns = min(math.isqrt((n_lines * n_columns - 1) // most) + 1, n_columns)
    lines = min(-(-n_lines * -(-n_columns // columns) // most), n_lines)
    # with few lines, thin the columns more
    columns = max(columns, -(-n_columns // max(1, most // -(-n_lines // lines))))
    return lines, columns


def _collect(
    stream: ScanStream,
    loaded: LoadedConfig,
    options: RenderOptions,
    words: Vocabulary,
    classes: RecordClasses | None,
    progress: Progress | None,
) -> _Kept:
    # classifies unless classes exist
    part = choose_part(options, loaded, stream)
    kept = _Kept(part, words, classes, np.zeros(len(words.table.names), np.int64))
    for item in _labelled(stream, loaded, options, classify=classes is None):
        block = item.block
        if not kept.parts:
            kept.step = _steps(part.stop - part.first, block.points_per_line, options.shots)
        kept.add(item)
        if progress is not None:
            progress(block.n_lines)
        if block.first_line + block.n_lines >= part.stop:
            break
    if not kept.parts:
        raise InputError(stream.info.path, "found no scan lines, expected at least one")
    return kept


def _labelled(
    stream: ScanStream,
    loaded: LoadedConfig,
    options: RenderOptions,
    *,
    classify: bool,
) -> Iterator[LabelledBlock]:
    blocks = of_station(stream, options.station)
    if classify:
        yield from label_blocks(
            blocks, loaded.config.classifier, wanted=Wanted(stages=True, reasons=True)
        )
        return
    for block in blocks:
        yield LabelledBlock(
            block, np.zeros(block.range_m.shape, np.uint8), np.zeros(len(block.extra), np.uint8)
        )


def _shots(
    scan: Input,
    loaded: LoadedConfig,
    options: RenderOptions,
    stream: ScanStream,
    kept: _Kept,
    placed: Source | None,
) -> tuple[Shots, tuple[str, ...]]:
    # the data of the page, and its notes
    words = kept.words
    step = kept.step
    classes, range_m, record = (
        np.concatenate(kept.parts[name]) for name in ("class", "range", "record")
    )
    range_m = range_m.astype(np.float64)
    seen = classes > 0
    planes = {name: kept.take(name) for name in ("time", "intensity", "xyz", *STAGES)}
    planes["record"] = np.where(seen & (record >= 0), record, np.nan)
    values: dict[str, F64] = {
        name: plane.astype(np.float64) for name, plane in planes.items() if plane is not None
    }
    sensor_m = values.pop("xyz", None)
    values |= _of_files(scan, loaded, options, record, placed)
    file_m = (
        np.stack([values.pop(axis) for axis in AXES], axis=2) if set(AXES) <= set(values) else None
    )
    config = loaded.config
    in_forest = (config.fused if config.method == "fused" else config.prc).environment == "forest"
    spacing_m, assumed = spacing(stream.info, values.get("time"), in_forest=in_forest, step=step[0])
    distance = f"{spacing_m:.2g} m apart" + (f" ({assumed})" if assumed else "")
    notice = f"The input has no trajectory: its lines are drawn one behind the other, {distance}."
    beam_rad = None if kept.beam_rad is None else kept.beam_rad[:: step[1]]
    xyz_m, is_measured = _place(range_m, beam_rad, (file_m, sensor_m), spacing_m * step[0], seen)
    notes = [] if is_measured else [notice]
    if step != (1, 1):
        n_all = (kept.part.stop - kept.part.first) * stream.info.points_per_line
        notes.append(
            f"The page holds {classes.size:,} of {n_all:,} shots, {thinned(step)}; "
            "--only A:B shows a part of them in full."
        )
    order = upright(beam_rad)
    left_out = sorted(words.noise)
    shots = Shots(
        classes,
        range_m,
        xyz_m,
        seen & ~np.isin(classes, left_out),
        (kept.part.first, 0),
        step,
        _entries(words, kept.counts, left_out),
        {
            name: _values(name, plane, seen)
            for name, plane in values.items()
            if np.isfinite(plane[seen]).any()
        },
        None if order is None else order.tolist(),
        order is not None and kept.turn_rad > 0,
    )
    return shots, tuple(notes)


def _entries(words: Vocabulary, counts: I64, left_out: list[int]) -> list[ClassEntry]:
    table = words.table
    total = max(int(counts[1:].sum()), 1)
    return [
        ClassEntry(
            place,
            name,
            table.colour(place),
            share_text(int(counts[place]), total),
            place in left_out,
        )
        for place, name in enumerate(table.names)
        if place and counts[place]
    ]


def _values(name: str, values: F64, seen: Mask) -> Values:
    if name == "confidence":
        values = np.where(values > 0, values, np.nan)  # 0 is unknown
    if name in STAGES:
        return replace(STAGES[name], values=np.where(seen, values, np.nan))
    if name == "time":
        span = float(np.nanmax(values) - np.nanmin(values))
        step_s = max(1e-7, 10.0 ** math.ceil(math.log10(max(span, 1e-3) / 4e9)))
        return Values("time", values, step_s, 4, "s", False)
    if name == "record":
        return Values("record", values, 1.0, 4, "", is_scale=False)
    known = values[np.isfinite(values)]
    step = 1.0 if (known == np.rint(known)).all() else max(float(np.ptp(known)), 1e-9) / 60_000
    return Values(name, values, step, 2, "")


def _of_files(
    scan: Input,
    loaded: LoadedConfig,
    options: RenderOptions,
    record: I64,
    placed: Source | None,
) -> dict[str, F64]:
    # coordinates and stages in the files, by name, each with the shape of record
    values: dict[str, F64] = {}
    cloud = placed
    labels = None
    if cloud is None:
        with suppress(InputError):
            cloud = Cloud.open(scan, loaded, options.station).records
    # a label file that is not a list of records, such as .npy, has no stages
    with suppress(PrcError):
        labels = None if options.labels is None else Input.of(options.labels).records()
    stored = scan.records()
    for records, names in ((cloud, AXES), (stored, tuple(STAGES)), (labels, tuple(STAGES))):
        present = (
            () if records is None else tuple(name for name in names if name in records.dimensions)
        )
        if records is not None and present and (names is not AXES or present == AXES):
            values |= _look_up(records, present, record)
    return values


def _look_up(records: Source, names: tuple[str, ...], record: I64) -> dict[str, F64]:
    # columns of the records of some cells; NaN for cells without a record
    flat = record.ravel()
    order = np.argsort(flat, kind="stable")
    sorted_ids = flat[order]
    columns = {name: np.full(flat.shape, np.nan) for name in names}
    for chunk in records.chunks(names):
        ids = chunk.records()
        low, high = np.searchsorted(sorted_ids, (ids.min(initial=0), ids.max(initial=-1) + 1))
        if low >= high:
            continue
        by_id = np.argsort(ids, kind="stable")
        place = np.minimum(np.searchsorted(ids[by_id], sorted_ids[low:high]), len(ids) - 1)
        has_record = ids[by_id][place] == sorted_ids[low:high]
        for name in names:
            columns[name][order[low:high][has_record]] = np.asarray(chunk.values[name], np.float64)[
                by_id
            ][place[has_record]]
    return {name: values.reshape(record.shape) for name, values in columns.items()}


def _place(
    range_m: F64,
    beam_rad: F64 | None,
    measured_m: tuple[F64 | None, ...],
    apart_m: float,
    seen: Mask,
) -> tuple[F64 | None, bool]:
    # (lines, columns, 3) [m], and False if lines are drawn one behind the other
    behind_m = np.arange(len(range_m)) * apart_m
    for xyz_m in measured_m:
        if xyz_m is None:
            continue
        placed = np.where(seen[..., None], xyz_m, np.nan)
        across = plane_normal(placed[np.isfinite(placed).all(axis=2)])
        if across is None:
            return placed, True
        # only upright planes: scan-plane coordinates have no up and down
        if abs(across[2]) < 0.5:
            return placed + behind_m[:, None, None] * across, False
    if beam_rad is None:
        return None, True
    return np.where(seen[..., None], behind(behind_m[:, None], beam_rad, range_m), np.nan), False


def plane_normal(points: F64) -> F64 | None:
    """Return the normal of the plane of all points, (3,) float64; None if they fill space."""
    if len(points) < 3:
        return None
    sample = points[:: max(1, len(points) // 20_000)]
    _, extents, axes = np.linalg.svd(sample - sample.mean(axis=0), full_matrices=False)
    return None if extents[2] > _FLAT * extents[1] else np.asarray(axes[2])
