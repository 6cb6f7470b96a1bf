"""Reads a registered cloud as a stream: sorted by time, with lines, columns and ranges."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import EvidenceError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.files import file_state
from prc_cli.core.stream import Assumption
from prc_cli.core.types import I64, Mask
from prc_cli.formats.options import InputConfig
from prc_cli.formats.records import RecordChunk, Source, filtered
from prc_cli.formats.sorting import sorted_by_time
from prc_cli.streams.ranges import XYZ, open_ranges
from prc_cli.streams.registered.drive import PASS, Drive, reconstruct
from prc_cli.streams.registered.spinning_drive import (
    SpinningDrive,
    reconstruct_spinning,
    spinning,
)
from prc_cli.streams.registered.spinning_rate import NoScan
from prc_cli.streams.registered.spool import Spool
from prc_cli.streams.rules import only_times_tell

CARRIED = ("intensity", "return_number", "number_of_returns")
"""Dimensions that the stream keeps from the cloud."""
SCANNER_DIMENSIONS = ("scanner_channel", "point_source_id", "user_data")
"""Dimensions that may number the scanners."""
SAMPLE_RECORDS = 1 << 22
"""Records that are read in the search for numbers of scanners."""
MOST_STEPS_BACK = 1e-3
"""Clouds whose times go back more often are sorted in space."""
MOST_SCANNERS = 8
"""A dimension with more values does not number scanners."""


def with_points(
    source: Source, config: InputConfig
) -> tuple[Source, InputConfig, tuple[Assumption, ...]]:
    """Return a cloud as a stream, the rules that read it, and the assumptions.

    Parameters
    ----------
    source
        Points with x, y, z in one coordinate system [m] and times [s].
    config
        With ``range = "points"``.

    Raises
    ------
    InputError
        The cloud lacks coordinates or times, or no rotation of a scanner fits its points.
    """
    lacking = [name for name in (*XYZ, "time") if name not in source.dimensions]
    if lacking:
        problem = (
            "range = points needs x, y, z and a time for every point; "
            f"the file has no {', '.join(lacking)}"
        )
        raise InputError(source.path, problem, f"it has: {', '.join(source.dimensions)}")
    split = None if config.scanner == "none" else config.scanner
    drive = _drive_of(source, split)
    if isinstance(drive, SpinningDrive):
        n_usable = sum(len(scan) for scan in drive.scans)
        cloud = _with_lost(source, spinning(source, drive), n_usable)
        return cloud, config.model_copy(update=drive.rules()), drive.assumptions()
    return _as_stream(source, config, drive, drive.assumptions())


def _with_lost(source: Source, cloud: Source, n_usable: int) -> Source:
    """Return a cloud as a stream, followed by the records without time or coordinates."""
    lost = lost_records(source, n_usable)
    if not len(lost):
        return cloud
    defaults = {
        "scan_line": 0,
        "column": -1,
        PASS: 0,
        "return_number": 1,
        "number_of_returns": 1,
    }

    def chunks(names: tuple[str, ...], stored: Source) -> Iterator[RecordChunk]:
        first = 0
        for chunk in stored.chunks(names):
            yield chunk
            first += chunk.n
        n = len(lost)
        values = {
            name: np.full(n, defaults[name], np.int32) if name in defaults else np.full(n, np.nan)
            for name in names
        }
        yield RecordChunk(first, values, n, lost)

    return filtered(cloud, chunks)


def sorts_by_itself(source: Source, config: InputConfig) -> bool:
    """Return whether the stream is sorted by time without an option: points and times make it."""
    return config.range == "points" or is_tile(source, config)


def is_tile(source: Source, config: InputConfig) -> bool:
    """Return whether a cloud with a given path is sorted in space, and has only times for lines."""
    asks = (config.lines, config.columns, config.points_per_line) == ("auto", "auto", None)
    has_path = config.range.startswith("trajectory:") and set(XYZ) <= set(source.dimensions)
    if not asks or not has_path or not only_times_tell(source):
        return False
    first = next(iter(source.chunks(("time",))), None)
    return first is not None and bool(np.mean(np.diff(first.values["time"]) < 0) > MOST_STEPS_BACK)


def with_path(
    source: Source, config: InputConfig
) -> tuple[Source, InputConfig, tuple[Assumption, ...]]:
    """Return a cloud whose path is given as a stream; see :func:`with_points`."""
    rule = open_ranges(
        config.range, source.dimensions, source.path, config, crs_wkt=source.facts.crs_wkt
    )
    assert rule.trajectory is not None
    split = None if config.scanner == "none" else config.scanner
    spools = spool_by_time(source, split)
    drive = reconstruct(source.path, spools, split=split or "", places=rule.trajectory.positions)
    _, *rates = drive.assumptions()
    return _as_stream(source, config, drive, (*rule.assumptions, *rates))


def _as_stream(
    source: Source,
    config: InputConfig,
    drive: Drive,
    assumptions: tuple[Assumption, ...],
) -> tuple[Source, InputConfig, tuple[Assumption, ...]]:
    rules: dict[str, object] = {
        "lines": "dimension:scan_line",
        "columns": "dimension:column",
        "range": "dimension:range",
        "order": "trust",
        "scanner": PASS if len(drive.scans) > 1 else "none",
    }
    if drive.is_even:
        rules["points_per_line"] = drive.points_per_line
        rules["angle_start"] = math.degrees(drive.angle_start_rad)
        rules["angle_step"] = math.degrees(drive.step_rad)
    n_usable = sum(len(scanner.points) for scanner in drive.scanners)
    cloud = _with_lost(source, registered(source, drive), n_usable)
    return cloud, config.model_copy(update=rules), assumptions


_latest: tuple[tuple[object, ...], Drive | SpinningDrive] | None = None
"""Key and drive of the last cloud: a command opens its input several times."""


def _drive_of(source: Source, split: str | None) -> Drive | SpinningDrive:
    global _latest
    file = Path(source.path)
    state = file_state(file) if file.is_file() else None
    key = (source.path, state, source.n_records, split)
    if state is None or _latest is None or _latest[0] != key:
        # the temporary files of the drive before go first
        _latest = None
        _latest = (key, _reconstructed(source, split))
    return _latest[1]


def _reconstructed(source: Source, split: str | None) -> Drive | SpinningDrive:
    # if one scanner does not fit, the dimensions that may number scanners are tried
    if split is not None:
        return _reconstruct(source.path, spool_by_time(source, split), split=split)
    refusal: EvidenceError | None = None
    drive: Drive | SpinningDrive | None = None
    try:
        drive = _reconstruct(source.path, spool_by_time(source, None))
    except EvidenceError as error:
        refusal = error
    if drive is not None and drive.is_sure:
        return drive
    for name in _numbers_of_scanners(source):
        try:
            parted = _reconstruct(source.path, spool_by_time(source, name), split=name)
        except EvidenceError:
            continue
        if parted.is_sure:
            return parted
    if drive is None:
        assert refusal is not None
        raise refusal
    return drive


def _reconstruct(path: str, spools: dict[int, Spool], *, split: str = "") -> Drive | SpinningDrive:
    # beams of one plane first, then spinning heads, whose beams lie on cones
    try:
        return reconstruct(path, spools, split=split)
    except EvidenceError as error:
        spinning = reconstruct_spinning(path, spools)
        if isinstance(spinning, NoScan):
            raise error from None
        return spinning


def _numbers_of_scanners(source: Source) -> Iterator[str]:
    # numbers of scanners have few values
    names = tuple(name for name in SCANNER_DIMENSIONS if name in source.dimensions)
    values: dict[str, set[int]] = {name: set() for name in names}
    n_seen = 0
    for chunk in source.chunks(names) if names else ():
        for name in names:
            values[name].update(np.unique(chunk.values[name]).astype(int).tolist())
        n_seen += chunk.n
        if n_seen >= SAMPLE_RECORDS:
            break
    yield from (name for name in names if 1 < len(values[name]) <= MOST_SCANNERS)


def spool_by_time(source: Source, split: str | None) -> dict[int, Spool]:
    """Write the points of every scanner into a temporary file, in the order of their times."""
    carried = tuple(name for name in CARRIED if name in source.dimensions)
    names = (*XYZ, "time", *carried)
    if split is not None and split not in carried:
        names = (*names, split)
    usable = filtered(source, _usable)
    spools = _spooled(usable, names, split, must_rise=True)
    if spools is None:
        spools = _spooled(sorted_by_time(usable), names, split, must_rise=False)
    assert spools is not None
    return spools


def lost_records(source: Source, n_usable: int) -> I64:
    """Return the numbers of the records that have no time or no coordinates, (n,) int64."""
    if source.n_records == n_usable:
        return np.empty(0, np.int64)
    parts = [chunk.records()[~_is_usable(chunk)] for chunk in source.chunks((*XYZ, "time"))]
    return np.concatenate([np.empty(0, np.int64), *parts])


def _is_usable(chunk: RecordChunk) -> Mask:
    usable: Mask = np.ones(chunk.n, np.bool_)
    for name in (*XYZ, "time"):
        usable &= np.isfinite(chunk.values[name])
    return usable


def _usable(names: tuple[str, ...], source: Source) -> Iterator[RecordChunk]:
    """Decode the records that have a time and coordinates."""
    every = tuple(dict.fromkeys((*names, *XYZ, "time")))
    for chunk in source.chunks(every):
        usable = _is_usable(chunk)
        values = {name: chunk.values[name] for name in names}
        if usable.all():
            yield replace(chunk, values=values)
            continue
        kept = {name: column[usable] for name, column in values.items()}
        yield RecordChunk(chunk.first_record, kept, int(usable.sum()), chunk.records()[usable])


def _spooled(
    source: Source,
    names: tuple[str, ...],
    split: str | None,
    *,
    must_rise: bool,
) -> dict[int, Spool] | None:
    """Return the spools; None as soon as a time is lower than the one before."""
    dtype = record_type(names)
    spools: dict[int, Spool] = {}
    last = -math.inf
    for chunk in source.chunks(names):
        time_s = np.asarray(chunk.values["time"], np.float64)
        if must_rise and chunk.n:
            if not time_s[0] >= last or not np.all(time_s[1:] >= time_s[:-1]):
                return None
            last = float(time_s[-1])
        records = np.empty(chunk.n, dtype)
        records["record"] = chunk.records()
        for name in names:
            if name in (dtype.names or ()):
                records[name] = chunk.values[name]
        heads = (
            np.zeros(chunk.n, np.int64) if split is None else chunk.values[split].astype(np.int64)
        )
        for head in np.unique(heads).tolist():
            # a spool opens a file: only one for every scanner
            if head not in spools:
                spools[head] = Spool(dtype)
            spools[head].append(records if split is None else records[heads == head])
    return spools


def record_type(names: tuple[str, ...]) -> np.dtype[np.void]:
    """Return the type of a point on disk."""
    sizes = {"intensity": "f4", "return_number": "u1", "number_of_returns": "u1"}
    fields = [("time", "f8"), ("x", "f8"), ("y", "f8"), ("z", "f8"), ("record", "i8")]
    fields += [(name, size) for name, size in sizes.items() if name in names]
    return np.dtype(fields)


def registered(source: Source, drive: Drive) -> Source:
    """Return a cloud in the order in which it was measured; see :func:`with_points`.

    Pass follows pass, each in the order of its times.
    """

    def chunks(names: tuple[str, ...], _: Source) -> Iterator[RecordChunk]:
        first = 0
        for scanner in drive.scanners:
            for points, cells in scanner.pieces():
                values = {name: _column(name, points, cells) for name in names}
                yield RecordChunk(first, values, len(points), points["record"].copy())
                first += len(points)

    def facts_of(facts: SourceFacts) -> SourceFacts:
        return replace(
            facts,
            points_per_line=None,
            rules=tuple(rule for rule in facts.rules if rule.key == "turn"),
            downs={number: (0.0, scan.cos_tilt) for number, scan in enumerate(drive.scans)},
            has_fitted_lines=True,
            findings=(*facts.findings, *drive.findings),
            drive=drive,
        )

    dimensions = (
        "range",
        "scan_line",
        "column",
        *(() if drive.is_even else ("angle",)),
        "time",
        *XYZ,
        *(name for name in ("intensity",) if name in source.dimensions),
        "return_number",
        "number_of_returns",
        PASS,
    )
    return filtered(source, chunks, dimensions=dimensions, facts_of=facts_of)


def _column(name: str, points: NDArray[np.void], cells: NDArray[np.void]) -> NDArray[np.generic]:
    stored = cells if name in (cells.dtype.names or ()) else points
    return np.ascontiguousarray(stored[name])
