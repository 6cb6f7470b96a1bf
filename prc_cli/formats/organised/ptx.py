"""Reader of PTX, organised scans as text.

Ten header lines per scan, then one point per line, column after column.
"""

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
from prc_cli.core.threads import default_threads, ordered
from prc_cli.core.types import F64
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
    filled,
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
from prc_cli.formats.text.lines import (
    BLOCK_BYTES,
    MAX_LINE_BYTES,
    Lines,
    count_line_ends,
    iter_lines,
    too_long,
)
from prc_cli.formats.text.read import PARSERS, parse_fast, single_blanks

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

    path: Path
    shape: ScanShape
    header_line: int
    pose: Pose
    start: int
    """First byte of the points."""
    stop: int
    """First byte behind the points."""
    n_cells: int
    """Numbers in a row."""
    intensity_scale: float = 1.0

    @property
    def first_line(self) -> int:
        """Number of the first point's line in the file."""
        return self.header_line + 10

    @property
    def size(self) -> str:
        shape = self.shape
        return f"{shape.n_lines} columns x {shape.points_per_line} rows = {shape.n_cells} points"

    def parts(self, block_bytes: int | None = None, threads: int = 1) -> Iterator[F64]:
        """Yield (n, 3 or 4) numbers: x, y, z [m] and intensity of consecutive points."""
        blocks = iter_lines(
            self.path,
            block_bytes or BLOCK_BYTES,
            span=(self.start, self.stop),
            line=self.first_line,
        )
        yield from ordered(self._parse, blocks, threads=threads, ahead=threads)

    def _parse(self, lines: Lines) -> F64:
        """Return the numbers of the lines, (n, 3 or 4) float64."""
        n = count_line_ends(lines.data) + (not lines.data.endswith(b"\n"))
        used = range(min(self.n_cells, 4))
        columns = (
            None
            if b'"' in lines.data
            else parse_fast(single_blanks(lines.data), self.n_cells, used)
        )
        if columns is not None and len(columns[0]) == n:
            return np.stack(columns, axis=1)
        rows = np.empty((n, len(used)))
        for index, line in enumerate(lines.data.split(b"\n")[:n]):
            number = lines.first + index
            if len(line) > MAX_LINE_BYTES:
                raise too_long(self.path, number)
            cells = line.decode("utf-8", errors="replace").split()
            if len(cells) != self.n_cells:
                self.refuse_row(number, line)
            for column in used:
                value = to_number(cells[column])
                if value is None:
                    problem = f"found {shorten(cells[column])!r}, expected a number"
                    hint = "write 0 0 0 for a point that is missing"
                    raise InputError(f"{self.path}: line {number}", problem, hint)
                rows[index, column] = value
        return rows

    def refuse_row(self, number: int, line: bytes) -> NoReturn:
        n_before = number - self.first_line
        cells = line.split()
        if len(cells) == 1 and _COUNT.fullmatch(cells[0]):
            problem = (
                f"the next scan begins after {n_before} points, "
                f"the header in line {self.header_line} says {self.size}"
            )
            hint = "correct the header or export the scan again"
            raise InputError(f"{self.path}: line {number}", problem, hint)
        content = f"{len(cells)} numbers" if cells else "a blank line"
        problem = f"found {content}, expected {self.n_cells} as in line {self.first_line}"
        problem += f" (point {n_before + 1} of {self.size})"
        raise InputError(f"{self.path}: line {number}", problem, "export the scan again")


class PtxStream:
    """A PTX file as a stream: points at 0, 0, 0 are missing shots, the header has the pose."""

    def __init__(
        self, path: Path, config: InputConfig, _lines_at_once: int = 1
    ) -> None:  # scans are blocks
        check_rules(path, config)
        self._path = path
        self._config = config
        with open_to_read(path) as handle:
            self._scans = _Survey(path, handle, pad=config.partial_line == "pad").scans()
        shapes = [scan.shape for scan in self._scans]
        check_shapes(path, shapes, config)
        poses = [scan.pose for scan in self._scans]
        notes = []
        if moved := [scan.shape.scanner for scan in self._scans if scan.pose.offset_m.any()]:
            apart = (
                f"the header's transformation and scanner position differ in scan {listed(moved)}"
            )
            notes.append(f"{apart}: ranges are measured from the scanner position")
        self.info = describe(path, "PTX", shapes, self._assumptions(), notes, poses)

    def _assumptions(self) -> list[Assumption]:
        turned = any(not np.array_equal(scan.pose.rotation, np.eye(3)) for scan in self._scans)
        how = (
            "turned by the headers' transformations"
            if turned
            else "as they are: the headers do not turn them"
        )
        assumptions = [
            Assumption(
                "input.range", "sensor-xyz", f"the scanner is the origin of a scan; points {how}"
            )
        ]
        scales = {scan.intensity_scale for scan in self._scans if scan.n_cells > 3}
        if scales:
            how = (
                "0 to 1 in the file, 0 to 65535 in the stream"
                if INTENSITY_STEPS in scales
                else "as in the file"
            )
            if len(scales) > 1:
                how = "0 to 65535 where the file has 0 to 1, else as in the file"
            assumptions.append(
                Assumption(
                    "input",
                    f"intensity: {how}",
                    f"judged by the first {_LOOKED_AT} points of a scan",
                )
            )
        if any(scan.n_cells > 4 for scan in self._scans):
            assumptions.append(Assumption("input", "not read: colour", "it is not needed"))
        short = self._scans[-1].shape
        if short.n_records != short.n_cells:
            missing = short.n_cells - short.n_records
            assumptions.append(
                Assumption("input.partial_line", "pad", f"the last line lacks {missing} shots")
            )
        return assumptions

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start."""
        for scan in self._scans:
            if scan.shape.n_cells:
                yield from self._scan_blocks(scan)

    def _scan_blocks(self, scan: _Scan) -> Iterator[ScanBlock]:
        shape = scan.shape
        m = scan.shape.points_per_line
        problem = (
            f"found fewer points than before, expected {shape.n_records} in scan {shape.scanner}"
        )
        missing = InputError(str(self._path), problem, "run again when the copy is complete")
        pieces = list(spans(shape.n_lines, lines_per_block(m)))
        sizes = (min(stop * m, shape.n_records) - first * m for first, stop in pieces)
        parts = scan.parts(threads=min(PARSERS, default_threads()))
        for (first, stop), rows in zip(pieces, in_turn(parts, sizes, missing), strict=True):
            yield self._block(scan, first, stop - first, rows)

    def _block(
        self,
        scan: _Scan,
        first: int,
        n_lines: int,
        rows: F64,
    ) -> ScanBlock:
        shape = scan.shape
        n = len(rows)
        m = shape.points_per_line
        xyz = scan.pose.apply(rows[:, :3])
        # ranges from unrotated coordinates: headers round rotations to a few digits
        length = lengths(xyz if scan.pose.offset_m.any() else rows)
        length[np.isinf(rows[:, :3]).any(axis=1)] = np.inf
        length[~rows[:, :3].any(axis=1)] = np.nan
        ranges, tally = clean_ranges(length, self._config.min_range, self._config.max_range)
        placed = to_float32(xyz)
        intensity = None
        placed[np.isnan(ranges)] = np.nan
        if scan.n_cells > 3:
            with np.errstate(over="ignore", invalid="ignore"):
                intensity = to_float32(rows[:, 3] * scan.intensity_scale)
            intensity[np.isnan(ranges)] = np.nan
            intensity = filled(intensity, n_lines * m).reshape(n_lines, m)
        start = shape.first_record + first * m
        record = np.full(n_lines * m, -1, np.int64)
        record[:n] = np.arange(start, start + n)
        return ScanBlock(
            first_line=first,
            range_m=filled(ranges, n_lines * m).reshape(n_lines, m),
            record=record.reshape(n_lines, m),
            scanner=shape.scanner,
            xyz_m=filled(placed, n_lines * m).reshape(n_lines, m, 3),
            intensity=intensity,
            tally=tally + ReadTally(n_records=n),
            is_last=first + n_lines == shape.n_lines,
        )


class _Survey:
    """First pass over a file: reads the headers and counts the lines of points."""

    def __init__(self, path: Path, handle: IO[bytes], *, pad: bool) -> None:
        self._path = path
        self._handle = handle
        self._pad = pad
        self._line = 0
        """Lines read so far."""

    def scans(self) -> list[_Scan]:
        """Return every scan; its points are counted, not parsed."""
        scans: list[_Scan] = []
        n_records = 0
        if self._handle.read(3) != b"\xef\xbb\xbf":
            self._handle.seek(0)
        while (line := self._next_header(scans)) is not None:
            if len(scans) == MAX_SCANS:
                raise InputError(
                    str(self._path),
                    f"more than {MAX_SCANS} scans, expected fewer",
                    "split the file",
                )
            scan = self._scan(len(scans), n_records, line)
            scans.append(scan)
            n_records += scan.shape.n_records
        return scans

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
        # in a scan that is too short, the header of the next one follows among the points
        for _ in scan.parts():
            pass
        problem = (
            f"found {shorten(text.decode('utf-8', errors='replace'))!r}, expected the next scan "
            f"or the end: the header in line {scan.header_line} says {scan.size}"
        )
        hint = "correct the header or export the scan again"
        raise InputError(f"{self._path}: line {self._line}", problem, hint)

    def _scan(self, scanner: int, first_record: int, line: bytes) -> _Scan:
        header_line = self._line
        n_lines = self._count(line, "columns", MAX_LINES)
        m = self._count(self._read_line().strip(), "rows", MAX_POINTS_PER_LINE)
        position, *_ = [self._numbers(3) for _ in range(4)]
        pose = self._pose(header_line, position, np.array([self._numbers(4) for _ in range(4)]))
        start = self._handle.tell()
        n_cells = len(self._handle.readline(MAX_LINE_BYTES).split())
        self._handle.seek(start)
        wanted = n_lines * m
        if wanted and n_cells not in _N_CELLS:
            problem = (
                f"found {n_cells} numbers, expected x y z, intensity and perhaps red green blue"
            )
            raise InputError(
                f"{self._path}: line {self._line + 1}", problem, "export the scan again"
            )
        n_found = self._skip(wanted)
        if n_found < wanted and not (self._pad and n_found > wanted - m):
            problem = (
                f"the file ends after {n_found} points, the header in line {header_line} says "
                f"{n_lines} columns x {m} rows = {wanted}"
            )
            pad = ", or set input.partial_line to pad" * (n_found > wanted - m)
            raise InputError(
                f"{self._path}: line {self._line}", problem, f"copy it from the archive again{pad}"
            )
        shape = ScanShape(scanner, n_lines if m else 0, m if n_lines else 0, n_found, first_record)
        scan = _Scan(self._path, shape, header_line, pose, start, self._handle.tell(), n_cells)
        if n_cells > 3 and wanted:
            scan = replace(scan, intensity_scale=_intensity_scale(scan))
        return scan

    def _pose(self, header_line: int, position: list[float], matrix: F64) -> Pose:
        rotation = matrix[:3, :3]
        # a row vector times the matrix: the translation is the last row
        if not (is_rotation(rotation) and np.array_equal(matrix[:, 3], (0.0, 0.0, 0.0, 1.0))):
            where = f"{self._path}: line {header_line + 6}"
            problem = (
                "the transformation is no rotation with a translation, "
                "expected three rows x x x 0 and a last row t t t 1"
            )
            raise InputError(where, problem, "correct the header or export the scan again")
        # some programs omit the position
        offset = matrix[3, :3] - np.array(position) if any(position) else np.zeros(3)
        # the two may be written with different numbers of digits
        offset = offset if np.abs(offset).max() > _SAME_PLACE_M else np.zeros(3)
        return Pose(rotation, offset, matrix[3, :3] - offset)

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
            raise InputError(
                f"{self._path}: line {self._line}", problem, "check that this is a PTX file"
            )
        value = int(text)
        if value > limit:
            problem = f"found {value} {what}, expected at most {limit}"
            raise InputError(
                f"{self._path}: line {self._line}", problem, "correct the header or split the scan"
            )
        return value

    def _numbers(self, n: int) -> list[float]:
        text = self._read_line().decode("utf-8", errors="replace").strip()
        values = [to_number(cell) for cell in text.split()]
        if len(values) != n or not all(
            value is not None and np.isfinite(value) for value in values
        ):
            problem = f"found {shorten(text)!r}, expected {n} numbers of the scan's header"
            raise InputError(
                f"{self._path}: line {self._line}", problem, "check that this is a PTX file"
            )
        return [value for value in values if value is not None]

    def _skip(self, n: int) -> int:
        """Skip n lines; return the number of lines that the file had."""
        passed = 0
        while passed < n:
            start = self._handle.tell()
            data = self._handle.read(min(BLOCK_BYTES, (n - passed + 1) * _ROW_BYTES))
            ends = np.flatnonzero(np.frombuffer(data, np.uint8) == ord("\n"))[: n - passed]
            self._handle.seek(start + int(ends[-1]) + 1 if len(ends) else start)
            self._line += len(ends)
            passed += len(ends)
            if not len(ends):
                # a longer line, the last one without a line end, or none
                if not self._read_line():
                    break
                passed += 1
        return passed


def _intensity_scale(scan: _Scan) -> float:
    """Return the factor for intensities: 65535 if they are from 0 to 1, as PTX defines, else 1."""
    n_seen = 0
    for rows in scan.parts(_LOOKED_AT * _ROW_BYTES):
        # leave out shots without return
        value = rows[rows[:, :3].any(axis=1), 3]
        if not ((value >= 0) & (value <= 1) | np.isnan(value)).all():
            return 1.0
        n_seen += len(value)
        if n_seen >= _LOOKED_AT:
            break
    return INTENSITY_STEPS
