"""Checks of LAS and LAZ for ``prc doctor``: compression, and reading a file with laspy."""

from __future__ import annotations

import io
from pathlib import Path

import lazrs
import numpy as np

from prc_cli.core.bytewise import count_bytes
from prc_cli.core.errors import OutputError
from prc_cli.core.types import U8
from prc_cli.formats.las.sinks import LazSink, Target, new_laszip_payload

POINT_FORMATS = {1: 28, 6: 30, 10: 67}
"""Record length by point format, one format for every coder of laszip."""
_N_RECORDS = 2_000


def check_laz(point_format: int) -> int:
    """Compress records and decompress them again."""
    payload = new_laszip_payload(Path(f"point format {point_format}"), point_format, 0)
    # a chunk is one whole record, then differences: here all zero except in the first bytes, as in a scan
    records = np.zeros((_N_RECORDS, POINT_FORMATS[point_format]), np.uint8)
    records[:, :4] = np.random.default_rng(1).integers(0, 256, (_N_RECORDS, 4), np.uint8)
    memory = io.BytesIO()
    sink = LazSink(Target(memory), payload)
    sink.write(records)
    sink.close()
    memory.seek(0)
    back: U8 = np.empty_like(records)
    lazrs.LasZipDecompressor(memory, payload).decompress_many(back.reshape(-1))
    if not np.array_equal(back, records):
        where = f"LAZ round trip of point format {point_format}"
        raise OutputError(where, "the records that came back differ", "install lazrs anew")
    return len(memory.getvalue())


def classes_by_laspy(path: Path) -> dict[int, int]:
    """Read a LAS or LAZ file with the reader of laspy, which ours does not use."""
    # imported here: costs 20 MiB and a tenth of a second
    import laspy

    try:
        points = laspy.read(path)
    except Exception as error:  # laspy raises errors of its own, and any others on damaged files
        raise OutputError(str(path), f"laspy does not read it ({error})", "report it, with laspy's version") from error
    counts = count_bytes(np.ascontiguousarray(points.classification, np.uint8))
    return {int(code): int(counts[code]) for code in np.flatnonzero(counts)}
