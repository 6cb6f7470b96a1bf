"""Converts any readable input to any writable format: ``prc convert``.

Between LAS and LAZ only the compression changes. All other files are read as a stream: reader →
blocks → writer, with the classes and the registered coordinates of the input. The report lists the
values that the output format cannot contain.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from prc_cli.config import LoadedConfig, RunConfig, resolve
from prc_cli.core.classes import NO_CODE
from prc_cli.core.errors import InputError
from prc_cli.core.files import atomic_outputs
from prc_cli.core.stream import LabelledBlock, ScanBlock, StreamInfo
from prc_cli.core.types import Mask
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.arrays.read import CLASS
from prc_cli.formats.arrays.rows import ArrayFile
from prc_cli.formats.input import Input
from prc_cli.formats.labels import NAMES, open_codes
from prc_cli.formats.las.rewrite import copy_las, read_las
from prc_cli.formats.outputs import (
    open_stream_writer,
    prepare_stream_output,
    stream_format,
    stream_suffix,
)
from prc_cli.formats.records import Source
from prc_cli.formats.registry import Held, format_of, is_cloud
from prc_cli.formats.writing.base import StreamItem, StreamShape
from prc_cli.formats.writing.columns import LinesApart
from prc_cli.formats.writing.disk import DiskColumn
from prc_cli.formats.writing.record import RunRecord, fingerprint, record_path
from prc_cli.jobs.coordinates import XYZ, Carried, axes_of, carry, lines_apart
from prc_cli.jobs.run import Counts, Progress, Run, RunSummary
from prc_cli.streams.evidence.watch import watched
from prc_cli.streams.grid import GridStream
from prc_cli.streams.open import open_input
from prc_cli.streams.stream import Stream

NOT_READ = "not read: "
"""Prefix of the assumptions in which readers name the values that they skip."""
MOST_NAMES = 30
"""Largest number of dimensions in the list of losses."""
_STREAM_NAMES = frozenset(
    (
        "range",
        "scan_line",
        "column",
        "angle",
        "time",
        *XYZ,
        "intensity",
        "return_number",
        "number_of_returns",
    )
)


@dataclass(frozen=True, slots=True, repr=False)
class ConversionSummary(RunSummary):
    """Summary of a conversion."""

    losses: tuple[str, ...] = ()
    """Values of the input that the output format cannot contain, one sentence each."""

    @property
    def n_lines(self) -> int:
        """Scan lines; 0 if only the compression changed."""
        return self.counts.n_lines

    @property
    def n_shots(self) -> int:
        """Shots, or records if only the compression changed."""
        return self.counts.n_shots

    @property
    def n_returned(self) -> int:
        """Shots with a range."""
        return self.counts.n_shots - self.counts.n_missing

    def as_dict(self) -> dict[str, object]:
        """Return the run record with the losses and the warnings, for JSON."""
        return {**RunSummary.as_dict(self), "not_kept": list(self.losses)}


def convert(
    source: Path | str,
    output: Path | str,
    config: LoadedConfig | RunConfig | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> ConversionSummary:
    """Write a file in another format; the output is complete or absent.

    Parameters
    ----------
    source : path
        Any readable input.
    output : path
        ``.las .laz .csv .csv.gz .csv.zst .parquet .npz .npy .bin``.
    config : LoadedConfig or RunConfig, optional
        How the stream is found in the input; not needed between LAS and LAZ.
    overwrite : bool
        Replace an existing output.
    progress : callable, optional
        Called with the number of scan lines that were just finished.

    Returns
    -------
    ConversionSummary

    Raises
    ------
    InputError, OutputError, ConfigError
        See :mod:`prc_cli.core.errors`; nothing is left behind.
    """
    scan, loaded = resolve(source, config)
    output = Path(output)
    prepare_output(scan, output, loaded, overwrite=overwrite)
    if scan.is_las and stream_suffix(output) in LAS_SUFFIXES:
        if loaded.config.input.window is None:
            return _copy(scan, output, loaded)
        return _copy_window(scan, output, loaded, progress)
    run = Run(scan, loaded, progress)

    def watched_blocks(stream: Stream) -> Iterator[ScanBlock]:
        # warnings do not stop a conversion: it is a way to repair a file
        return watched(stream, loaded.config.input, refuses=False).blocks()

    with (
        open_items(scan, output, loaded, blocks_of=watched_blocks) as opened,
        open_stream_writer(output, opened.shape) as writer,
    ):
        for item in opened.items:
            writer.add_item(item)
            run.see(item.block, opened.info)
        losses = find_losses(output, opened, run.counts, writer.losses)
        not_kept = (f"not kept: {loss}" for loss in losses)
        notes = (*opened.notices, *not_kept, *how_to_read(output, opened, run.counts))
        findings = tuple(opened.stream.observed.findings)
        info = opened.stream.info  # now the lines of a window are known
        record = run.record(info, findings, notes)
        record = run.finish(writer, record_of_scanners(record, run.counts))
    return ConversionSummary(output, record, run.counts, findings, losses)


def record_of_scanners(record: RunRecord, counts: Counts) -> RunRecord:
    """Remove M from a run record if scanners have lines of different lengths."""
    return replace(record, points_per_line=0) if len(set(counts.scanners.values())) > 1 else record


def prepare_output(
    scan: Input,
    output: Path,
    loaded: LoadedConfig,
    *,
    overwrite: bool,
    more: tuple[Path, ...] = (),
) -> None:
    """Refuse an impossible output before reading; remove temporary files of interrupted runs."""
    stream_suffix(output)
    scan.check()
    prepare_stream_output(output, overwrite=overwrite, inputs=loaded.inputs(scan.path, *more))


def _copy(scan: Input, output: Path, loaded: LoadedConfig) -> ConversionSummary:
    """Change the compression of a LAS or LAZ file and nothing else."""
    las = read_las(scan.path)
    run = Run(scan, loaded)
    with atomic_outputs(output, record_path(output)) as (temporary, beside):
        notes = copy_las(las, output, temporary)
        run.check_unchanged()
        record = RunRecord(
            config=loaded.config.to_table(),
            input=fingerprint(scan.path),
            format="LAZ" if las.compressed else "LAS",
            points_per_line=0,
            n_records=las.n_records,
            notices=("records were copied as bytes; no stream was read", *notes),
        )
        beside.write_bytes(record.to_json())
    return ConversionSummary(output, record, replace(run.counts, n_shots=las.n_records))


def _copy_window(
    scan: Input,
    output: Path,
    loaded: LoadedConfig,
    progress: Progress | None,
) -> ConversionSummary:
    """Copy the records of a window of a LAS or LAZ file; nothing else changes."""
    las = read_las(scan.path)
    run = Run(scan, loaded, progress)
    with contextlib.ExitStack() as stack:
        temporary, beside = stack.enter_context(atomic_outputs(output, record_path(output)))
        stays = stack.enter_context(DiskColumn(output, np.uint8, 0, n_records=las.n_records))
        inputs = loaded.config.input
        stream = watched(open_input(scan, inputs), inputs, refuses=False)
        stop = 0
        info = stream.info
        for block in stream.blocks():
            run.see(block, info)
            record = np.concatenate([block.records().ravel(), block.extra.record])
            record = record[record >= 0]
            stays.put(record, np.ones(len(record), np.uint8))
            stop = max(stop, int(record.max(initial=-1)) + 1)

        def masks(n: int) -> Iterator[Mask]:
            return (
                part.view(np.bool_)
                for part in stays.chunks(n, stop=min(-(-stop // n) * n, las.n_records))
            )

        notes = copy_las(las, output, temporary, masks)
        run.check_unchanged()
        findings = tuple(stream.observed.findings)
        copied = "the records of the window were copied as bytes"
        record_of_run = run.record(stream.info, findings, (copied, *notes))
        beside.write_bytes(record_of_run.to_json())
    return ConversionSummary(output, record_of_run, run.counts, findings)


@dataclass(frozen=True, slots=True)
class OpenedItems:
    """A stream, and which further values its records have."""

    info: StreamInfo
    shape: StreamShape
    items: Iterator[StreamItem]
    source: Source | None
    stream: Stream
    carried: Carried | None = None
    notices: tuple[str, ...] = ()
    """Notes about the coordinates."""

    @property
    def grid(self) -> GridStream | None:
        """The stream if rules found its lines; None for range images, organised scans and rings."""
        return self.stream.grid


@contextlib.contextmanager
def open_items(
    scan: Input,
    output: Path,
    loaded: LoadedConfig,
    *,
    blocks_of: Callable[[Stream], Iterator[ScanBlock] | Iterator[LabelledBlock]] | None = None,
    codes: bool = True,
    xyz: bool = True,
    points: bool = False,
) -> Iterator[OpenedItems]:
    """Open a stream with codes and coordinates of its records.

    ``blocks_of`` may watch or label the blocks.
    """
    stream = open_input(scan, loaded.config.input)
    blocks = _bare_items(stream.blocks() if blocks_of is None else blocks_of(stream))
    bare = next(blocks, None)
    if bare is None:
        raise InputError(str(scan), "no scan lines, expected at least one", "see prc info")
    first = bare.block
    records = scan.records()
    has = () if records is None else records.dimensions
    class_name = next((name for name in has if codes and name.lower() in NAMES), None)
    axes = axes_of(records, stream, first, loaded.config) if xyz else ()
    grid = stream.grid
    # blocks of frames lack the coordinates of points that share a cell
    rings = grid is None and records is not None and first.xyz_m is not None
    shares = rings and points and not axes
    with contextlib.ExitStack() as stack:
        carried: Carried | None = None
        if records is not None and (class_name is not None or axes or shares):
            carried = carry(records, class_name, XYZ if shares else axes, output, stack)
            if loaded.config.input.window is None:
                carried.read_all()
        elif records is None and codes and stream.info.format == "array":
            carried = _carry_array(scan.path, stream.info, output, stack)
        made_up = None
        if xyz and not axes and first.xyz_m is None and is_cloud(output):
            made_up = lines_apart(stream, loaded.config)
        item = _item(bare, carried, made_up, shares=shares)
        scanners = loaded.config.input.scanner != "none" or stream.info.facts.has_scans
        of_images = stream.info.facts.has_returns or stream.info.format == "E57"
        returns = of_images if grid is None else grid.rules.has_returns
        shape = StreamShape.of(item, stream.info, scanners=scanners, returns=returns)
        shape = replace(shape, points=points, rings=rings)

        def items() -> Iterator[StreamItem]:
            yield item
            for later in blocks:
                yield _item(later, carried, made_up, shares=shares)

        notes = () if made_up is None else (made_up.notice(first),)
        yield OpenedItems(stream.info, shape, items(), records, stream, carried, notes)


def _bare_items(blocks: Iterator[ScanBlock] | Iterator[LabelledBlock]) -> Iterator[StreamItem]:
    for block in blocks:
        if isinstance(block, LabelledBlock):
            yield StreamItem(block.block, labelled=block)
        else:
            yield StreamItem(block)


def _carry_array(
    path: Path,
    info: StreamInfo,
    output: Path,
    stack: contextlib.ExitStack,
) -> Carried | None:
    """Write the class codes of a range image to a temporary file; None if it has none."""
    if CLASS not in ArrayFile(path).headers:
        return None
    code_source = open_codes(path, CLASS)
    n_codes = code_source.n_records
    if n_codes != info.n_records:
        problem = f"the array {CLASS!r} contains {n_codes} codes, expected {info.n_records}"
        raise InputError(str(path), problem, "give it the shape of the ranges, or another name")
    kind = np.dtype([("code", "<i4")])
    values = stack.enter_context(DiskColumn(output, kind, (NO_CODE,)))
    for codes in code_source.codes():
        rows = np.empty(len(codes), kind)
        rows["code"] = np.where(np.abs(codes) < 2**31, codes, NO_CODE)
        values.append(rows)
    return Carried(values, iter(()))


def _item(
    item: StreamItem,
    carried: Carried | None,
    made_up: LinesApart | None,
    *,
    shares: bool,
) -> StreamItem:
    """Add the values of records that blocks do not contain."""
    block = item.block
    if made_up is not None:
        registered, further = made_up(block)
        item = replace(item, registered_m=registered, extra_registered_m=further)
    if carried is None:
        return item
    values = carried.get(block.records())
    extra = carried.get(block.extra.record)
    names = values.dtype.names or ()
    if "code" in names:
        item = replace(item, codes=values["code"].copy(), extra_codes=extra["code"].copy())
    if "x" in names:
        registered, further = carried.place(block)
        item = replace(
            item, registered_m=None if shares else registered, extra_registered_m=further
        )
    return item


def find_losses(
    output: Path,
    opened: OpenedItems,
    counts: Counts,
    written: tuple[str, ...] = (),
) -> tuple[str, ...]:
    """Return what the output lacks of the input, one sentence each, the writer's losses first."""
    # complete after the last item
    n_odd = 0 if opened.carried is None else opened.carried.n_odd
    odd = (
        (f"{n_odd} class codes that are no whole numbers of 32 bits: written as none",)
        if n_odd
        else ()
    )
    return (*written, *odd, *_losses(output, opened, counts))


def _losses(output: Path, opened: OpenedItems, counts: Counts) -> Iterator[str]:
    shape = opened.shape
    form = stream_format(output)
    if stream_suffix(output) in LAS_SUFFIXES:
        yield from _las_losses(shape, counts)
    values: tuple[tuple[bool, Held, str], ...] = (
        (shape.angles, "angles", "scan angles"),
        (shape.times, "times", "times"),
        (shape.xyz, "relative", "coordinates"),
        (shape.intensity, "intensity", "intensities"),
        (shape.registered, "registered", "registered coordinates (x, y, z)"),
        (shape.codes, "codes", "class codes"),
    )
    yield from (what for present, held, what in values if present and held not in form.holds)
    # a frame, as a dump may be, lists all points
    if "returns" not in form.holds and not (form.is_dump and shape.points and shape.xyz):
        if counts.n_extra:
            extra = f"{counts.n_extra} further returns or collisions"
            yield f"{extra}: a range image has one range per cell"
    elif counts.n_extra and shape.intensity:
        yield f"the intensities of {counts.n_extra} further returns, which the stream does not know"
    if counts.tally.n_unplaced:
        yield f"{counts.tally.n_unplaced} records that belong to no cell"
    bad = counts.tally.n_not_finite + counts.tally.n_not_positive + counts.tally.n_beyond
    if bad:
        yield f"the stored ranges of {bad} shots that are not finite, not positive or out of bounds"
    yield from _record_losses(opened)


def _las_losses(shape: StreamShape, counts: Counts) -> Iterator[str]:
    if counts.n_missing:
        times = ", and their times," if shape.times else ""
        empty = f"{counts.n_missing} shots without return{times} have no record"
        yield f"{empty}; lines and columns are kept as numbers"
    if shape.angles:
        yield "scan angles beyond steps of 0.006 deg"
    if shape.xyz or shape.registered:
        steps = "1 mm, or 1e-8 deg of longitude and latitude"
        yield f"coordinates beyond steps of {steps} (ranges are kept bit for bit)"
    if shape.intensity:
        yield "intensities beyond whole numbers from 0 to 65535"
    if len(set(counts.scanners.values())) > 1:
        sizes = ", ".join(
            f"scanner {scanner}: {m}" for scanner, m in sorted(counts.scanners.items())
        )
        yield f"the number of shots per line of each scanner ({sizes}), except the last column used"


def _record_losses(opened: OpenedItems) -> Iterator[str]:
    """Name the dimensions of the input that the stream does not carry."""
    for assumption in opened.info.assumptions:
        # readers of organised scans and arrays list here what they skip
        if assumption.value.startswith(NOT_READ):
            yield f"{assumption.value.removeprefix(NOT_READ)}, which the stream does not contain"
    if stations := opened.info.facts.stations:
        x, y, z = stations[min(stations)]
        position = f"{x:g}, {y:g}, {z:g} m for the first"
        yield f"the positions of the scans ({position}): x, y, z are from the scanner"
    records = opened.source
    if records is None:
        return
    known = _STREAM_NAMES | set(NAMES)
    taken: set[str | None] = set()
    if opened.grid is not None:
        rules = opened.grid.rules
        taken = {
            rules.line_dimension,
            rules.column_dimension,
            rules.scanner,
            rules.range.partition(":")[2],
        }
    unread = [
        name for name in records.dimensions if name.lower() not in known and name not in taken
    ]
    if unread:
        more = " ..." if len(unread) > MOST_NAMES else ""
        yield f"other dimensions of the records: {', '.join(unread[:MOST_NAMES])}{more}"
    if records.facts.crs_wkt:
        yield "the coordinate system"
    if records.format.startswith("LA"):
        yield "header, VLRs and EVLRs of the LAS file"


def how_to_read(output: Path, opened: OpenedItems, counts: Counts) -> tuple[str, ...]:
    """Return the options needed to read the output as the same stream, unless its names suffice."""
    form = stream_format(output)
    shape = opened.shape
    notes = []
    if format_of(output) is None:
        notes.append(f"prc reads no stream from {stream_suffix(output)}; it is for other programs")
    if shape.scanners and len(counts.scanners) > 1 and form.holds_all:
        notes.append("several scanners: read it with --scanner point_source_id")
    if shape.xyz and shape.registered and opened.grid is not None and form.holds_all:
        notes.append(
            f"x, y, z are those of the input: read it with --range {opened.grid.rules.range}"
        )
    if form.is_dump:
        notes.append(f"read it with --config {output.name}.toml")
    directed = form.is_dump or (shape.registered and form.holds_all)
    directed = directed or (shape.xyz and "relative" in form.holds and not form.holds_all)
    if shape.down_rad is not None and not directed:
        angle = float(np.rad2deg(shape.down_rad))
        lean = "; a lean of the scan plane is lost with the coordinates" if shape.registered else ""
        notes.append(
            f"straight down is at scan angle {angle:.9g} deg{lean}: "
            f"read it with --set input.nadir={angle:.9g}"
        )
    return tuple(notes)
