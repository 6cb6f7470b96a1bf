"""LAS or LAZ in, LAS or LAZ out without a stream between: compression changed, records left out, nothing else.

What is kept is copied as bytes. Where records are left out, the counts and bounds of the header follow.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.types import I64, U8, Mask
from prc_cli.formats.las.codec import (
    LASZIP_KEY,
    LasSink,
    LazSink,
    PointSink,
    Target,
    batch_records,
    check_compressed,
    copy_bytes,
    crc,
    has_variable_chunks,
    laszip_payload,
    read_points,
    tail_bounds,
)
from prc_cli.formats.las.file import (
    Header,
    LasFile,
    Source,
    Vlr,
    open_source,
    read_structure,
)
from prc_cli.formats.las.rewrite import Plan, new_header, set_tail
from prc_cli.formats.las.tail import plan_tail
from prc_cli.formats.las.vlrs import (
    COPC_USER,
    RECORD_KEY,
    make_vlr,
    record_vlr,
)
from prc_cli.formats.writing.record import RunRecord

Masks = Callable[[int], Iterator[Mask]]
"""Called with a number of records; gives for every so many records of the input which of them stay."""


@dataclass(slots=True)
class _Seen:
    """What the header must say of the records that were written."""

    n: int
    by_return: I64
    low: I64
    high: I64
    checksum: int = 0


def read_las(path: Path) -> LasFile:
    """Read where everything of a LAS or LAZ file lies.

    Raises
    ------
    InputError
        When the file is cut off or its parts overlap.
    """
    with open_source(path) as source:
        return read_structure(source)


def copy_las(
    las: LasFile, output: Path, temporary: Path, masks: Masks | None = None, record: RunRecord | None = None
) -> tuple[str, ...]:
    """Write a LAS or LAZ file again under a temporary name.

    Parameters
    ----------
    las : LasFile
        The input, from :func:`read_las`.
    output : Path
        Its suffix says whether the records are compressed.
    temporary : Path
        What is written.
    masks : callable, optional
        Which records stay; None = all of them.
    record : RunRecord, optional
        Run record to put among the VLRs, in place of one that is there; None = VLRs stay as they are.

    Returns
    -------
    tuple of str
        What was decided, in plain words.

    Raises
    ------
    InputError, OutputError
        When the input is damaged, or cannot be held unchanged by the output.
    """
    notices: list[str] = []
    compress = output.suffix.lower() == ".laz"
    vlrs, drop = list(las.vlrs), [COPC_USER]
    if any(vlr.key[0] == COPC_USER for vlr in vlrs):
        if masks is not None or not (compress and las.compressed):
            notices.append("the COPC index does not fit the rewritten records and was left out")
        vlrs = [vlr for vlr in vlrs if vlr.key[0] != COPC_USER]
    if record is not None:
        place = next((index for index, vlr in enumerate(vlrs) if vlr.key == RECORD_KEY), len(vlrs))
        vlrs = [vlr for vlr in vlrs if vlr.key != RECORD_KEY]
        vlrs.insert(place, record_vlr(record))
        drop.append(RECORD_KEY[0])
    if las.header.get("global_encoding") & 4 and las.header.has("waveform_start"):
        notices.append(f"waveforms lie in a file of their own: copy {las.path.stem}.wdp beside the output")
    vlrs = _with_laszip(las, vlrs, compress=compress, notices=notices)
    plan = Plan(las.point_format, compress)
    with open_source(las.path) as source, temporary.open("w+b") as writing:
        header, seen = _copy(las, plan, vlrs, source, writing, masks, tuple(drop))
    if compress and las.point_format in (9, 10):
        check_compressed(temporary, output, _as_written(las, header, vlrs, seen.n), seen.checksum)
    return tuple(notices)


def _copy(
    las: LasFile, plan: Plan, vlrs: list[Vlr], source: Source, writing: BinaryIO, masks: Masks | None,
    drop: tuple[str, ...],
) -> tuple[Header, _Seen]:  # fmt: skip
    target = Target(writing)
    header = new_header(las, plan, vlrs, 0)
    target.write(header.data)
    for vlr in vlrs:
        target.write(vlr.raw)
    copy_bytes(source, target, las.vlr_end, las.point_offset)  # user bytes
    sink: PointSink = LasSink(target)
    if plan.compress:
        sink = LazSink(target, next(vlr.payload for vlr in vlrs if vlr.key == LASZIP_KEY))
    big = np.iinfo(np.int64)
    seen = _Seen(0, np.zeros(16, np.int64), np.full(3, big.max, np.int64), np.full(3, big.min, np.int64))
    n = batch_records(las.record_length, compressed=las.compressed or plan.compress)
    keep = None if masks is None else masks(n)
    with contextlib.closing(read_points(source, las, n)) as batches:
        for records in batches:
            chosen = records if keep is None else records[next(keep)]
            if keep is not None:
                _see(seen, chosen, las.point_format)
            if plan.compress and las.point_format in (9, 10):
                seen.checksum = crc(chosen, seen.checksum)
            seen.n += len(chosen)
            if len(chosen):
                sink.write(chosen)
    sink.close()
    tail = plan_tail(las, tail_bounds(source, las), target.tell(), drop=drop)
    for start, stop in tail.spans:
        copy_bytes(source, target, start, stop)
    set_tail(header, las, tail)
    if keep is not None:
        _set_counts(header, las, seen)
    target.seek(0)
    target.write(header.data)
    target.flush()
    return header, seen


def _with_laszip(las: LasFile, vlrs: list[Vlr], *, compress: bool, notices: list[str]) -> list[Vlr]:
    if not compress:
        return [vlr for vlr in vlrs if vlr.key != LASZIP_KEY]
    payload = laszip_payload(las, las.point_format, las.n_extra_bytes, keep=True)
    old = las.vlr(*LASZIP_KEY)
    if old is None:
        return [*vlrs, make_vlr(LASZIP_KEY, payload, "laszip (lazrs)")]
    if has_variable_chunks(old.payload):
        notices.append("compressed chunks of differing length were written as chunks of equal length")
    return [old.with_payload(payload) if vlr.key == LASZIP_KEY else vlr for vlr in vlrs]


def _see(seen: _Seen, records: U8, point_format: int) -> None:
    """Add records to what the header must say."""
    if not len(records):
        return
    number = records[:, 14] & (0x0F if point_format >= 6 else 0x07)
    seen.by_return += np.bincount(number, minlength=16)
    xyz = np.ascontiguousarray(records[:, :12]).view("<i4")
    seen.low = np.minimum(seen.low, xyz.min(axis=0))
    seen.high = np.maximum(seen.high, xyz.max(axis=0))


def _set_counts(header: Header, las: LasFile, seen: _Seen) -> None:
    """Set counts and bounds as the records that stayed have them; fields that were not used stay so."""
    if las.header.get("legacy_n_points"):
        header.set("legacy_n_points", seen.n)
        header.set("legacy_by_return", *(int(count) for count in seen.by_return[1:6]))
    if header.has("n_points"):
        header.set("n_points", seen.n)
        header.set("by_return", *(int(count) for count in seen.by_return[1:]))
    if seen.n:
        scale = np.frombuffer(bytes(las.header.data[131:155]), "<f8")
        offset = np.frombuffer(bytes(las.header.data[155:179]), "<f8")
        bounds = np.stack([seen.high * scale + offset, seen.low * scale + offset], axis=1)
        header.set("bounds", *np.sort(bounds, axis=1)[:, ::-1].ravel().tolist())


def _as_written(las: LasFile, header: Header, vlrs: list[Vlr], n: int) -> LasFile:
    return LasFile(
        path=las.path,
        size=las.size,
        header=header,
        vlrs=tuple(vlrs),
        vlr_end=las.vlr_end,
        point_format=las.point_format,
        record_length=las.record_length,
        n_points=n,
        compressed=True,
        evlrs=(),
    )


def check_copied(las: LasFile) -> None:
    """Refuse points that cannot be copied as bytes.

    Raises
    ------
    InputError
        When the file is in LASzip's compatibility mode.
    """
    if any(vlr.key[0] == "lascompatible" for vlr in las.vlrs):
        problem = "found LAS 1.4 points in LASzip's compatibility mode, whose classes lie in extra bytes"
        raise InputError(str(las.path), problem, "write it again as plain LAS 1.4, e.g. with las2las or PDAL")
