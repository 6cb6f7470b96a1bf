"""Reader of PTX, organised scans as text: ten header lines per scan, then one point per line, column after column."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, NoReturn

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.files import open_to_read
from prc_cli.core.stream import Assumption, ReadTally, ScanBlock
from prc_cli.core.types import F32, F64
from prc_cli.formats.options import InputConfig
from prc_cli.formats.organised.scans import (
    INTENSITY_STEPS,
    MAX_LINES,
    MAX_POINTS_PER_LINE,
    MAX_SCANS,
    Pose,
    ScanShape,
    check_rules,
    check_shapes,
    describe,
    in_turn,
    is_rotation,
    lengths,
    lines_per_block,
    listed,
    spans,
    to_float32,
)
from prc_cli.formats.ranges import clean_ranges
from prc_cli.formats.records import shorten
from prc_cli.formats.text.dialect import to_number
from prc_cli.formats.text.lines import MAX_LINE_BYTES, too_long

TEXT_BYTES = 4 << 20
"""Bytes of text parsed at a time."""
_ROW_BYTES = 64
"""Typical bytes per row, to estimate how far to read for the end of a short scan."""
_LOOKED_AT = 1000
"""Points of a scan read to find the scale of its intensities, missing ones not counted."""
_SAME_PLACE_M = 1e-3
"""Translation and scanner position of a header are the same up to this distance [m]."""
_N_CELLS = (3, 4, 7)
"""Numbers per row: x y z, with intensity, with colour."""
_COUNT = re.compile(rb"\d{1,18}", re.ASCII)


@dataclass(frozen=True, slots=True)
class _Scan:
    """A scan and the position of its points in the file."""

    shape: ScanShape
    header_line: int
    pose: Pose
    start: int
    """First byte of the points."""
    stop: int
    """First byte behind the points."""
    n_cells: int
    """Numbers in a row."""
    intensity_scale: float

    @property
    def first_line(self) -> int:
        """Number of the first point's line in the file."""
        return self.header_line + 10


class PtxStream:
    """A PTX file as a :class:`prc_cli.core.stream.ScanStream`.

    Points whose coordinates are all zero are missing shots. The header's transformation turns the points so that z
    is up; the scanner's position in the header is the origin.
    """

    def __init__(self, path: Path, config: InputConfig) -> None:
        check_rules(path, config)
        self._path, self._config = path, config
        with open_to_read(path) as handle:
            self._scans = _Survey(path, handle, pad=config.partial_line == "pad").scans()
        shapes = [scan.shape for scan in self._scans]
        check_shapes(path, shapes, config)
        self.info = describe(path, "PTX", shapes, self._assumptions(), self._notes())

    def _assumptions(self) -> list[Assumption]:
        turned = any(not np.array_equal(scan.pose.rotation, np.eye(3)) for scan in self._scans)
        how = "turned by the headers' transformations" if turned else "as they are: the headers do not turn them"
        found = [Assumption("input.range", "sensor-xyz", f"the scanner is the origin of a scan; points {how}")]
        scales = {scan.intensity_scale for scan in self._scans if scan.n_cells > 3}
        if scales:
            how = "0 to 1 in the file, 0 to 65535 in the stream" if INTENSITY_STEPS in scales else "as in the file"
            if len(scales) > 1:
                how = "0 to 65535 where the file has 0 to 1, else as in the file"
            found.append(Assumption("input", f"intensity: {how}", f"judged by the first {_LOOKED_AT} points of a scan"))
        if any(scan.n_cells > 4 for scan in self._scans):
            found.append(Assumption("input", "not read: colour", "it is not needed"))
        short = self._scans[-1].shape
        if short.n_records != short.n_cells:
            missing = short.n_cells - short.n_records
            found.append(Assumption("input.partial_line", "pad", f"the last line lacks {missing} shots"))
        return found

    def _notes(self) -> list[str]:
        moved = [scan.shape.scanner for scan in self._scans if scan.pose.offset_m.any()]
        if not moved:
            return []
        return [
            f"the header's transformation and scanner position differ in scan {listed(moved)}: "
            "ranges are measured from the scanner position"
        ]

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start."""
        for scan in self._scans:
            if scan.shape.n_cells:
                yield from self._scan_blocks(scan)

    def _scan_blocks(self, scan: _Scan) -> Iterator[ScanBlock]:
        shape, m = scan.shape, scan.shape.points_per_line
        problem = f"found fewer points than before, expected {shape.n_records} in scan {shape.scanner}"
        missing = InputError(str(self._path), problem, "run again when the copy is complete")
        pieces = list(spans(shape.n_lines, lines_per_block(m)))
        sizes = (min(stop * m, shape.n_records) - first * m for first, stop in pieces)
        for (first, stop), rows in zip(pieces, in_turn(self._parts(scan), sizes, missing), strict=True):
            yield self._block(scan, first, stop - first, rows)

    def _block(self, scan: _Scan, first: int, n_lines: int, rows: F64) -> ScanBlock:
        shape, n = scan.shape, len(rows)
        m = shape.points_per_line
        xyz = scan.pose.apply(rows[:, :3])
        missing = ~rows[:, :3].any(axis=1)
        # ranges from unrotated coordinates: headers round rotations to a few digits
        length = lengths(xyz if scan.pose.offset_m.any() else rows)
        length[np.isinf(rows[:, :3]).any(axis=1)] = np.inf
        length[missing] = np.nan
        ranges, tally = clean_ranges(length, self._config.min_range, self._config.max_range)
        placed = to_float32(xyz)
        placed[np.isnan(ranges)] = np.nan
        start = shape.first_record + first * m
        record = np.full(n_lines * m, -1, np.int64)
        record[:n] = np.arange(start, start + n)
        block = ScanBlock(
            first_line=first,
            range_m=_filled(ranges, n_lines * m).reshape(n_lines, m),
            record=record.reshape(n_lines, m),
            scanner=shape.scanner,
            xyz_m=_filled(placed, n_lines * m).reshape(n_lines, m, 3),
            tally=tally + ReadTally(n_records=n),
            is_last=first + n_lines == shape.n_lines,
        )
        if scan.n_cells == 3:
            return block
        with np.errstate(over="ignore", invalid="ignore"):
            intensity = to_float32(rows[:, 3] * scan.intensity_scale)
        intensity[np.isnan(ranges)] = np.nan
        return replace(block, intensity=_filled(intensity, n_lines * m).reshape(n_lines, m))

    def _parts(self, scan: _Scan) -> Iterator[F64]:
        """Yield (n, 3 or 4) numbers: x, y, z [m] and intensity of consecutive points."""
        rest, line, left = b"", scan.first_line, scan.stop - scan.start
        with open_to_read(self._path) as handle:
            handle.seek(scan.start)
            while left:
                found = handle.read(min(TEXT_BYTES, left))
                if not found:
                    return
                left -= len(found)
                data = rest + found
                end = data.rfind(b"\n") + 1 if left else len(data)
                data, rest = data[:end], data[end:]
                if len(rest) > MAX_LINE_BYTES:
                    raise too_long(self._path, line + data.count(b"\n"))
                if data:
                    yield _parse(self._path, scan, line, data)
                    line += data.count(b"\n")


def _filled(values: F32, n: int) -> F32:
    """Return values padded with missing ones to n."""
    if len(values) == n:
        return values
    return np.concatenate([values, np.full((n - len(values), *values.shape[1:]), np.nan, np.float32)])


def _parse(path: Path, scan: _Scan, first: int, data: bytes) -> F64:
    """Return (n, 3 or 4) float64, a row of it for every line of the text."""
    n = data.count(b"\n") + (not data.endswith(b"\n"))
    found = _parse_fast(scan, _plain(data), n)
    return _parse_exactly(path, scan, first, data) if found is None else found


def _parse_fast(scan: _Scan, data: bytes, n: int) -> F64 | None:
    """Parse the rows with pyarrow; None where it refuses or counts lines differently."""
    import pyarrow as pa
    from pyarrow import csv

    keys = [str(index) for index in range(scan.n_cells)]
    used = keys[:4]
    try:
        table = csv.read_csv(
            pa.BufferReader(data),
            csv.ReadOptions(column_names=keys, block_size=MAX_LINE_BYTES),
            csv.ParseOptions(delimiter=" ", quote_char=False),
            csv.ConvertOptions(column_types={key: pa.float64() for key in used}, include_columns=used, null_values=[]),
        )
    except pa.ArrowInvalid:
        return None
    if table.num_rows != n:
        return None
    rows = np.empty((n, len(used)))
    for index, key in enumerate(used):
        rows[:, index] = table.column(key).to_numpy()
    return rows


def _parse_exactly(path: Path, scan: _Scan, first: int, data: bytes) -> F64:
    n_used = min(scan.n_cells, 4)
    lines = data.split(b"\n")
    lines = lines if lines[-1] else lines[:-1]
    rows = np.empty((len(lines), n_used))
    for index, line in enumerate(lines):
        number = first + index
        where = f"{path}: line {number}"
        if len(line) > MAX_LINE_BYTES:
            raise too_long(path, number)
        cells = line.decode("utf-8", errors="replace").split()
        if len(cells) != scan.n_cells:
            _refuse_row(path, number, line, scan)
        for column in range(n_used):
            value = to_number(cells[column])
            if value is None:
                problem = f"found {shorten(cells[column])!r}, expected a number"
                raise InputError(where, problem, "write 0 0 0 for a point that is missing")
            rows[index, column] = value
    return rows


def _refuse_row(path: Path, number: int, line: bytes, scan: _Scan) -> NoReturn:
    """Explain why a line is not a point."""
    n_before, shape = number - scan.first_line, scan.shape
    size = f"{shape.n_lines} columns x {shape.points_per_line} rows = {shape.n_cells} points"
    cells = line.split()
    if len(cells) == 1 and _COUNT.fullmatch(cells[0]):
        problem = f"the next scan begins after {n_before} points, the header in line {scan.header_line} says {size}"
        raise InputError(f"{path}: line {number}", problem, "correct the header or export the scan again")
    found = f"{len(cells)} numbers" if cells else "a blank line"
    problem = f"found {found}, expected {scan.n_cells} as in line {scan.first_line} (point {n_before + 1} of {size})"
    raise InputError(f"{path}: line {number}", problem, "export the scan again")


def _plain(data: bytes) -> bytes:
    """Return lines with single blanks between cells; fast where nothing is to be done."""
    data = data.replace(b"\t", b" ") if b"\t" in data else data
    data = data.replace(b"\r\n", b"\n") if b"\r" in data else data
    while b"  " in data:
        data = data.replace(b"  ", b" ")
    data = data.replace(b"\n ", b"\n") if b"\n " in data else data
    data = data.replace(b" \n", b"\n") if b" \n" in data else data
    return data.strip(b" ")


class _Survey:
    """First pass over a file: reads the headers and counts the lines of points."""

    def __init__(self, path: Path, handle: IO[bytes], *, pad: bool) -> None:
        self._path, self._handle, self._pad = path, handle, pad
        self._line = 0
        """Lines read so far."""

    def scans(self) -> list[_Scan]:
        """Return every scan; its points are counted, not parsed."""
        found: list[_Scan] = []
        n_records = 0
        if self._handle.read(3) != b"\xef\xbb\xbf":
            self._handle.seek(0)
        while (line := self._next_header(found)) is not None:
            if len(found) == MAX_SCANS:
                raise InputError(str(self._path), f"more than {MAX_SCANS} scans, expected fewer", "split the file")
            scan = self._scan(len(found), n_records, line)
            found.append(scan)
            n_records += scan.shape.n_records
        return found

    def _next_header(self, before: list[_Scan]) -> bytes | None:
        """Return the first line that is not blank, None at the end of the file."""
        while line := self._read_line():
            text = line.strip()
            if not text:
                continue
            if before and len(text.split()) > 1:
                self._refuse_points(before[-1], text)
            return text
        return None

    def _refuse_points(self, scan: _Scan, text: bytes) -> NoReturn:
        """Return the error for a point where the next scan should begin."""
        number = self._line
        # in a scan that is too short, the header of the next one follows among the points
        self._handle.seek(scan.start)
        for index in range(scan.shape.n_records):
            line = self._handle.readline(MAX_LINE_BYTES)
            if len(line.split()) != scan.n_cells:
                _refuse_row(self._path, scan.first_line + index, line, scan)
        shape = scan.shape
        problem = (
            f"found {shorten(text.decode('utf-8', errors='replace'))!r}, expected the next scan or the end: the header "
            f"in line {scan.header_line} says {shape.n_lines} columns x {shape.points_per_line} rows = "
            f"{shape.n_cells} points"
        )
        raise InputError(f"{self._path}: line {number}", problem, "correct the header or export the scan again")

    def _scan(self, scanner: int, first_record: int, line: bytes) -> _Scan:
        header_line = self._line
        n_lines = self._count(line, "columns", MAX_LINES)
        m = self._count(self._read_line().strip(), "rows", MAX_POINTS_PER_LINE)
        rows = [self._numbers(3) for _ in range(4)]
        matrix = np.array([self._numbers(4) for _ in range(4)])
        start = self._handle.tell()
        n_cells = len(self._handle.readline(MAX_LINE_BYTES).split())
        self._handle.seek(start)
        wanted = n_lines * m
        if wanted and n_cells not in _N_CELLS:
            problem = f"found {n_cells} numbers, expected x y z, intensity and perhaps red green blue"
            raise InputError(f"{self._path}: line {self._line + 1}", problem, "export the scan again")
        n_found = self._skip(wanted)
        if n_found < wanted and not (self._pad and n_found > wanted - m):
            problem = (
                f"the file ends after {n_found} points, the header in line {header_line} says "
                f"{n_lines} columns x {m} rows = {wanted}"
            )
            pad = ", or set input.partial_line to pad" * (n_found > wanted - m)
            raise InputError(f"{self._path}: line {self._line}", problem, f"copy it from the archive again{pad}")
        shape = ScanShape(scanner, n_lines if m else 0, m if n_lines else 0, n_found, first_record)
        scan = _Scan(
            shape, header_line, self._pose(header_line, rows[0], matrix), start, self._handle.tell(), n_cells, 1.0
        )
        if n_cells > 3 and wanted:
            scan = replace(scan, intensity_scale=self._intensity_scale(scan))
        return scan

    def _intensity_scale(self, scan: _Scan) -> float:
        """Return the factor for intensities: 65535 where they run from 0 to 1, as PTX defines, else 1."""
        self._handle.seek(scan.start)
        left, line = scan.shape.n_records, scan.first_line
        n_seen, inside = 0, True
        while left and n_seen < _LOOKED_AT and inside:
            n = min(_LOOKED_AT, left)
            head = b"".join(self._handle.readline(MAX_LINE_BYTES + 1) for _ in range(n))
            found = _parse(self._path, scan, line, head)
            # leave out shots without return
            value = found[found[:, :3].any(axis=1), 3]
            inside = bool(((value >= 0) & (value <= 1) | np.isnan(value)).all())
            n_seen, left, line = n_seen + len(value), left - n, line + n
        self._handle.seek(scan.stop)
        return INTENSITY_STEPS if inside else 1.0

    def _pose(self, header_line: int, position: list[float], matrix: F64) -> Pose:
        rotation = matrix[:3, :3]
        # a row vector times the matrix: the translation is the last row
        if not (is_rotation(rotation) and np.array_equal(matrix[:, 3], (0.0, 0.0, 0.0, 1.0))):
            where = f"{self._path}: line {header_line + 6}"
            problem = (
                "the transformation is no rotation with a translation, expected four rows x x x 0 and last t t t 1"
            )
            raise InputError(where, problem, "correct the header or export the scan again")
        # some programs omit the position
        offset = matrix[3, :3] - np.array(position) if any(position) else np.zeros(3)
        # the two may be written with different numbers of digits
        return Pose(rotation, offset if np.abs(offset).max() > _SAME_PLACE_M else np.zeros(3))

    def _read_line(self) -> bytes:
        line = self._handle.readline(MAX_LINE_BYTES + 1)
        if line:
            self._line += 1
        if len(line) > MAX_LINE_BYTES:
            raise too_long(self._path, self._line)
        return line

    def _count(self, text: bytes, what: str, limit: int) -> int:
        if not _COUNT.fullmatch(text):
            shown = shorten(text.decode("utf-8", errors="replace"))
            problem = f"found {shown!r}, expected the number of {what} of a scan"
            raise InputError(f"{self._path}: line {self._line}", problem, "check that this is a PTX file")
        value = int(text)
        if value > limit:
            problem = f"found {value} {what}, expected at most {limit}"
            raise InputError(f"{self._path}: line {self._line}", problem, "correct the header or split the scan")
        return value

    def _numbers(self, n: int) -> list[float]:
        text = self._read_line().decode("utf-8", errors="replace").strip()
        values = [to_number(cell) for cell in text.split()]
        if len(values) != n or not all(value is not None and np.isfinite(value) for value in values):
            problem = f"found {shorten(text)!r}, expected {n} numbers of the scan's header"
            raise InputError(f"{self._path}: line {self._line}", problem, "check that this is a PTX file")
        return [value for value in values if value is not None]

    def _skip(self, n: int) -> int:
        """Skip n lines; return how many there were."""
        passed, at_end = 0, True
        while passed < n:
            start = self._handle.tell()
            data = self._handle.read(min(TEXT_BYTES, (n - passed) * _ROW_BYTES + _ROW_BYTES))
            if not data:
                break
            count = data.count(b"\n")
            at_end = data.endswith(b"\n")
            if not count and len(data) > MAX_LINE_BYTES:
                raise too_long(self._path, self._line + passed + 1)
            if passed + count > n:
                ends = np.flatnonzero(np.frombuffer(data, np.uint8) == ord("\n"))
                self._handle.seek(start + int(ends[n - passed - 1]) + 1)
                count, at_end = n - passed, True
            elif passed + count == n and not at_end:
                self._handle.seek(start + data.rfind(b"\n") + 1)
                at_end = True
            passed += count
        # the last line of a file may lack a line feed
        passed += not at_end and passed < n
        self._line += passed
        return passed


def open_ptx(path: Path, config: InputConfig, lines_at_once: int) -> PtxStream:
    """Open a PTX file, whose blocks are as long as its scans."""
    return PtxStream(path, config)
