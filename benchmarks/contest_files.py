"""Scans of the contest as files of a user.

What a scanner writes, and nothing of where straight down is.

Profilers: ``.npz`` with ranges, times, intensities and scan angles that count from the first
column; with several returns a dump of records, one per return. The KITTI frame is the file itself
with its sample configuration, whose coordinates are relative to the scanner; range views hold the
elevations of their rings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.contest_data import Scan
from prc_cli.core.types import F64, I64, U8

Columns = Mapping[str, NDArray[Any]]
_TYPES = {
    **dict.fromkeys(("range", "intensity"), "f4"),
    **dict.fromkeys(("time", "angle", "x", "y", "z"), "f8"),
    **dict.fromkeys(("scan_line", "column"), "u4"),
    **dict.fromkeys(("return_number", "number_of_returns", "user_data"), "u1"),
}


def dump(path: Path, columns: Columns, names: Sequence[str]) -> tuple[str, ...]:
    """Write records with the named fields and their layout; return the options that name it."""
    kinds = [(name, f"<{_TYPES[name]}") for name in names]
    records = np.zeros(len(columns["range"]), kinds)
    for name in names:
        records[name] = columns[name]
    records.tofile(path)
    fields = "".join(f'    {{ name = "{name}", type = "{_TYPES[name]}" }},\n' for name in names)
    layout = path.with_suffix(".layout.toml")
    layout.write_text(f"fields = [\n{fields}]\n", encoding="utf-8")
    return ("--layout", str(layout))


@dataclass(frozen=True, slots=True)
class ScanFile:
    """A scan on the disk."""

    path: Path
    options: tuple[str, ...]
    """Of ``prc classify``, those of the method left out."""
    nadir: tuple[str, ...]
    """The options that tell straight down; empty where the file has it."""
    record: I64 | None
    """(lines, M) int64, record of every shot; None = ``line * M + column``."""
    extra_record: I64
    """(e,) int64, records of the further returns."""

    def image(self, scan: Scan, codes: U8) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Split codes of records into those of shots, (lines, M), and of further returns, (e,)."""
        if self.record is None:
            return codes.reshape(scan.range_m.shape), codes[self.extra_record]
        labels = np.where(self.record >= 0, codes[self.record], 0).astype(np.uint8)
        return labels, codes[self.extra_record]


def write(scan: Scan, folder: Path) -> ScanFile:
    """Write a scan into a folder."""
    if scan.source is not None:
        assert scan.record is not None
        options = () if scan.config is None else ("--config", str(scan.config))
        return ScanFile(scan.source, options, (), scan.record, scan.extra.record)
    degrees = np.rad2deg(np.unwrap(scan.angle_rad))
    angle_deg: F64 = degrees - degrees[0]
    nadir: tuple[str, ...] = ("--set", f"input.nadir={-degrees[0]:.10g}")
    if len(scan.extra):
        return _write_records(scan, angle_deg, nadir, folder)
    path = folder / "scan.npz"
    values: dict[str, NDArray[np.generic]] = {"range_m": scan.range_m}
    if scan.is_upright:
        # of a spinning scanner the elevations of the rings are known
        values["zenith_deg"] = 180.0 - np.rad2deg(scan.angle_rad)
        nadir = ()
    else:
        values["angle_deg"] = angle_deg
    if scan.time_s is not None:
        values["time_s"] = scan.time_s
    if scan.intensity is not None:
        values["intensity"] = scan.intensity
    np.savez(path, **values)  # type: ignore[arg-type]
    return ScanFile(path, (), nadir, None, np.empty(0, np.int64))


def _write_records(
    scan: Scan,
    angle_deg: F64,
    nadir: tuple[str, ...],
    folder: Path,
) -> ScanFile:
    """Write one record per return, those of a shot one after the other."""
    assert scan.time_s is not None
    assert scan.intensity is not None
    m = scan.range_m.shape[1]
    there = np.flatnonzero(~np.isnan(scan.range_m.ravel()))
    cell = np.concatenate([there, scan.extra.line.astype(np.int64) * m + scan.extra.column])
    range_m = np.concatenate([scan.range_m.ravel()[there], scan.extra.range_m])
    order = np.lexsort((range_m, cell))
    first = np.flatnonzero(np.diff(cell[order], prepend=-1) != 0)
    size = np.diff(np.append(first, len(order)))
    # the simulator tells the intensity of the strongest return only, which is that of the image
    strength = np.concatenate([scan.intensity.ravel()[there] + 1.0, np.zeros(len(scan.extra))])
    scan_line, column = np.divmod(cell[order], m)
    columns = {
        "range": range_m[order],
        "time": scan.time_s.ravel()[cell[order]],
        "intensity": strength[order],
        "angle": angle_deg[column],
        "scan_line": scan_line,
        "column": column,
        "return_number": np.arange(len(order)) - np.repeat(first, size) + 1,
        "number_of_returns": np.repeat(size, size),
    }
    path = folder / "scan.dat"
    layout = dump(path, columns, tuple(columns))
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    record = np.full(scan.range_m.size, -1, np.int64)
    record[there] = place[: len(there)]
    options = (*layout, "-M", str(m))
    return ScanFile(path, options, nadir, record.reshape(scan.range_m.shape), place[len(there) :])
