"""Tests that every format must pass, for formats here or in another package.

A test calls :func:`check_reads`, :func:`check_damage` and, if the format is written,
:func:`check_round_trip` with a :class:`~prc_cli.formats.registry.Format` and a small sample. Each
raises ``AssertionError`` with the difference.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import PrcError
from prc_cli.core.files import suffix_of
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.records import STANDARD_NAMES
from prc_cli.formats.registry import Format
from prc_cli.formats.writing.base import StreamItem, StreamShape
from prc_cli.formats.writing.record import Fingerprint, RunRecord, record_path


def check_reads(
    form: Format,
    sample: Path,
    layout: Layout | None = None,
    config: InputConfig | None = None,
) -> int:
    """Read a sample twice, and every dimension alone; return the number of records or shots."""
    if not form.records:
        first, second = (list(_images(form, sample, config or InputConfig())) for _ in range(2))
        assert first, "no blocks"
        for block, same in zip(first, second, strict=True):
            assert block.tobytes() == same.tobytes(), "a block differs when the file is read again"
        return sum(block.size for block in first)
    source = form.open_records(sample, layout)
    names = source.dimensions
    assert names, "no dimensions"
    standard = [name for name in names if name in STANDARD_NAMES]
    assert list(names[: len(standard)]) == standard, f"expected standard names first: {names}"
    assert source.facts is not None
    values = _records(form, sample, layout, names)
    n = len(values[names[0]])
    assert source.n_records in (None, n), f"{source.n_records} records were announced, {n} read"
    for name in names:
        alone = _records(form, sample, layout, (name,))[name]
        assert alone.tobytes() == values[name].tobytes(), f"{name} differs when it is read alone"
    return n


def check_damage(
    form: Format,
    sample: Path,
    folder: Path,
    layout: Layout | None = None,
    n_cases: int = 60,
    seed: int = 0,
) -> int:
    """Read damaged copies in another process; return how many were refused.

    A copy must be read, or refused with a message of one line.
    """
    context = get_context("spawn")
    first = 0
    n_refused = 0
    while first < n_cases:
        receiver, sender = context.Pipe(duplex=False)
        child = context.Process(
            target=_read_damaged,
            args=(form, sample, folder, layout, (seed, first, n_cases), sender),
        )
        child.start()
        sender.close()
        with contextlib.suppress(EOFError):
            while True:
                case, fault, is_refused = receiver.recv()
                assert not fault, f"case {case} of seed {seed}: {fault}"
                first = case + 1
                n_refused += is_refused
        child.join()
        if first < n_cases:
            assert (child.exitcode or 0) < 0, (
                f"case {first} of seed {seed}: exit code {child.exitcode}"
            )
            first += 1
            n_refused += 1
    return n_refused


def _read_damaged(
    form: Format,
    sample: Path,
    folder: Path,
    layout: Layout | None,
    cases: tuple[int, int, int],
    sender: Connection,
) -> None:
    seed, first, stop = cases
    for case in range(first, stop):
        path = folder / f"damaged{suffix_of(sample)}"
        fault = ""
        is_refused = False
        path.write_bytes(damaged(sample.read_bytes(), np.random.default_rng([seed, case])))
        try:
            if form.records:
                _records(form, path, layout, form.open_records(path, layout).dimensions)
            else:
                list(_images(form, path, InputConfig()))
        except PrcError as error:
            is_refused = True
            if path.name not in str(error) or not str(error).isprintable():
                fault = f"expected one line that names the file, found {str(error)!r}"
        except Exception as error:
            fault = f"expected a PrcError, found {error!r}"
        sender.send((case, fault, is_refused))


def check_round_trip(form: Format, suffix: str, folder: Path) -> None:
    """Write a stream twice and read it again: equal bytes and ranges, no file if abandoned."""
    item, shape = example(form)
    hashes = set()
    for attempt in range(2):
        path = folder / f"stream{attempt}" / f"stream{suffix}"
        path.parent.mkdir()
        with form.stream_writer(path, shape) as writer:
            writer.add_item(item)
        assert list(path.parent.iterdir()) == [], "an output that was not finished was left"
        with form.stream_writer(path, shape) as writer:
            writer.add_item(item)
            record = writer.finish(
                RunRecord({}, Fingerprint("in", 0, None), "test", shape.points_per_line)
            )
        assert record_path(path).is_file(), "no run record"
        assert record.output is not None
        assert record.output.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
        hashes.add(record.output.sha256)
    assert len(hashes) == 1, "equal streams gave different bytes"
    if suffix not in form.scans or (form.has_layout and form.is_dump):
        return
    expected = item.block.range_m[~np.isnan(item.block.range_m)]
    if form.records:
        ranges = _records(form, path, None, ("range",))["range"]
    else:
        ranges = np.concatenate([block.ravel() for block in _images(form, path, InputConfig())])
    ranges = ranges[~np.isnan(ranges)].astype(np.float32)
    assert ranges.tobytes() == expected.tobytes(), "ranges came back with other bits"


def example(
    form: Format, n_lines: int = 5, points_per_line: int = 12
) -> tuple[StreamItem, StreamShape]:
    """Return a small stream with all values of a format: a corridor with missing shots."""
    angle = np.linspace(-2.0, 2.0, points_per_line)
    line, column = np.indices((n_lines, points_per_line))
    range_m = (2.5 / np.maximum(np.abs(np.cos(angle)), 0.3) + 0.01 * line).astype(np.float32)
    range_m[(line + column) % 7 == 3] = np.nan
    xyz = np.stack([0.0 * line, range_m * np.sin(angle), -range_m * np.cos(angle)], axis=-1).astype(
        np.float32
    )
    xyz[np.isnan(range_m)] = np.nan
    block = ScanBlock(
        0,
        range_m,
        angle_rad=angle,
        time_s=(line * points_per_line + column) / 1000.0,
        xyz_m=xyz,
        intensity=np.where(np.isnan(range_m), np.nan, 100.0 + column).astype(np.float32),
        is_last=True,
    )
    shape = StreamShape(
        points_per_line,
        scanners=False,
        returns="returns" in form.holds,
        angles=True,
        times=True,
        xyz=True,
        registered=False,
        intensity=True,
        codes=True,
        down_rad=0.0,
    )
    return StreamItem(
        block, np.where(np.isnan(range_m), -1, 2).astype(np.int32), np.zeros(0, np.int32)
    ), shape


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a damaged copy: cut, a bit flipped, or a piece overwritten, left out or repeated."""
    out = bytearray(data)
    near = len(data) if rng.random() < 0.5 else min(len(data), 400)
    position = int(rng.integers(near))
    n = int(rng.choice((1, 4, 30, 300)))
    kind = int(rng.integers(5))
    if kind == 0:
        return bytes(out[: position + 1])
    if kind == 1:
        out[position] ^= 1 << int(rng.integers(8))
    elif kind == 2:
        out[position : position + n] = bytes([int(rng.choice((0, 0x20, 0x39, 0xFF)))]) * min(
            n, len(out) - position
        )
    elif kind == 3:
        del out[position : position + n]
    else:
        out[position:position] = out[position : position + n]
    return bytes(out) or b"\0"


def _records(
    form: Format,
    path: Path,
    layout: Layout | None,
    names: tuple[str, ...],
) -> dict[str, NDArray[Any]]:
    parts_of: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
    n = 0
    for chunk in form.open_records(path, layout).chunks(names):
        assert set(chunk.values) == set(names), f"asked for {names}, got {tuple(chunk.values)}"
        assert chunk.record is not None or chunk.first_record == n, (
            f"record {chunk.first_record} after {n}"
        )
        for name, values in chunk.values.items():
            assert values.shape == (chunk.n,), f"{name}: {values.shape}, expected ({chunk.n},)"
            parts_of[name].append(values)
        n += chunk.n
    return {
        name: np.concatenate(parts) if parts else np.empty(0) for name, parts in parts_of.items()
    }


def _images(form: Format, path: Path, config: InputConfig) -> Iterator[NDArray[Any]]:
    for block in form.open_images(path, config, 1).blocks():
        yield block.range_m
