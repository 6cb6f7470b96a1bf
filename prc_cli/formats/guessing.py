"""Guesses the records of an unknown raw dump and the names of its columns, for a first layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.files import open_to_read
from prc_cli.core.stream import MAX_RINGS
from prc_cli.core.types import F64, U8, Mask
from prc_cli.formats.options import Layout

LOOKED_BYTES = 1 << 20
"""Bytes at the end of a dump that are looked at."""
MOST_RECORD_BYTES = 256
"""Longest record that is looked for."""
LEAST_RECORDS = 200
"""Fewer records show no period."""
MOST_HEADER_BYTES = 1 << 16
"""Longest header that is looked for."""
SAME_AS_BEST = 0.97
"""A record is the shortest period that repeats bytes by this share of the best."""
_ALIKE = 0.5
"""Neighbours of a range differ by at most this share of what random ones do."""
_EVEN = 0.9
_MAJORITY = 0.99
FRAME_BYTES = 1 << 22
"""Bytes at the start of a dump that are tested for a frame: more than a frame of 128 rings."""
LEAST_FRAME = 1000
"""A frame has at least this many records."""
STAGGERED_DEG = 10.0
"""Neighbouring azimuths of a frame differ by less.

The rings of Ouster's scanners are staggered by up to 6.4 deg.
"""
LEAST_KNOWN = 0.5
"""Least share of points that are numbers."""
LEAST_RINGS = 8
"""A frame has at least this many rings."""
FLAT_DEG = 0.5
"""Elevations of a ring scatter less."""
FRAME_REACH_M = 300.0
"""No coordinate of a frame lies beyond [m]."""
_SOME = 0.05
LEAST_EASTING_M = 1000.0
"""Numbers with a larger median that are not whole are no ranges in metres."""
_TRIED = ("f8", "f4", "i4", "u2", "u1")


FRAME_FIELDS = ("x", "y", "z", "intensity", "ring", "time")
"""float32 numbers of a point of a frame: 4 in KITTI, 5 in nuScenes, 6 in Boreas."""


def is_frame(path: Path) -> bool:
    """Whether a dump is a frame of a spinning scanner: points of :data:`FRAME_FIELDS`."""
    return frame_fields(path) is not None


def frame_fields(path: Path) -> tuple[str, ...] | None:
    """Return the fields of the points of a frame; None for any other dump.

    The numbers are float32; points that did not return may be NaN or zero. Without numbers of rings
    the points are in the order of the rings, or of the firings.
    """
    with open_to_read(path) as handle:
        n_bytes = handle.seek(0, 2)
        handle.seek(0)
        head = handle.read(FRAME_BYTES)
    for n_fields in (4, 5, 6):
        size = 4 * n_fields
        if n_bytes % size or n_bytes < size * LEAST_FRAME:
            continue
        with np.errstate(invalid="ignore"):  # a signalling NaN
            rows = (
                np.frombuffer(head[: len(head) // size * size], "<f4")
                .reshape(-1, n_fields)
                .astype(np.float64)
            )
        if _are_points(rows):
            return FRAME_FIELDS[:n_fields]
    return None


def _are_points(rows: F64) -> bool:
    is_known = np.isfinite(rows).all(axis=1)
    if np.mean(is_known) < LEAST_KNOWN:
        return False
    rows = rows[is_known]
    if np.abs(rows[:, :3]).max() > FRAME_REACH_M:
        return False
    points = rows[rows[:, :3].any(axis=1)]
    x, y, z = points[:, :3].T
    distance = np.sqrt(x * x + y * y + z * z)
    if len(distance) < LEAST_FRAME:
        return False
    azimuth = np.arctan2(y, x)
    step = np.angle(np.exp(1j * np.diff(azimuth)))
    is_whole_turn = min(min(np.mean(axis < 0), np.mean(axis > 0)) for axis in (x, y)) > _SOME
    elevation = np.arctan2(z, np.hypot(x, y))
    return bool(
        rows[:, 3].min() >= 0
        and rows[:, 3].max() < 1 << 16
        and _mostly(distance > 0.5)
        and _mostly(np.abs(z) < 0.8 * distance)
        and (rows.shape[1] == 4 or _are_rings(rows[:, 4]))
        and np.mean(np.abs(step) < np.deg2rad(STAGGERED_DEG)) > _EVEN
        and (is_whole_turn or rows.shape[1] > 4 or _are_sweeps(azimuth, step, elevation))
    )


def _are_rings(numbers: F64) -> bool:
    n = len(np.unique(numbers))
    return bool(
        LEAST_RINGS <= n <= MAX_RINGS
        and (numbers == np.rint(numbers)).all()
        and (numbers >= 0).all()
    )


def _are_sweeps(azimuth: F64, step: F64, elevation: F64) -> bool:
    """Whether points of a sector are ring after ring: azimuths restart, elevations stay."""
    sense = np.sign(np.median(step[step != 0]))
    low, high = np.percentile(azimuth, [5, 95])
    back = np.flatnonzero(-sense * step > (high - low) / 2) + 1
    if not LEAST_RINGS <= len(back) + 1 <= MAX_RINGS:
        return False
    spreads = [np.std(part) for part in np.split(elevation, back) if len(part) > 1]
    return bool(np.median(spreads) < np.deg2rad(FLAT_DEG))


def _mostly(mask: Mask) -> bool:
    return bool(np.mean(mask) > _MAJORITY)


def guess_records(path: Path) -> Layout | None:
    """Guess header, byte order and fields of a dump from the period of its bytes; None without."""
    with open_to_read(path) as handle:
        size = handle.seek(0, 2)
        # without what may be the header
        handle.seek(max(size - LOOKED_BYTES, min(MOST_HEADER_BYTES, size // 2)))
        tail = np.frombuffer(handle.read(LOOKED_BYTES), np.uint8)
        handle.seek(0)
        head = np.frombuffer(handle.read(MOST_HEADER_BYTES + 64 * MOST_RECORD_BYTES), np.uint8)
    period = byte_period(tail)
    if period is None:
        return None
    # records end with the file, so a header does not move them
    rows = tail[len(tail) % period :].reshape(-1, period)
    readings = [(endian, _fields(rows, endian)) for endian in ("little", "big")]
    endian, kinds = max(readings, key=lambda reading: _merit(rows, reading[1], reading[0]))
    columns = {
        str(first_byte): _column(rows, first_byte, kind, endian) for first_byte, kind in kinds
    }
    named = guess_names(columns)
    fields = []
    for first_byte, kind in kinds:
        name = named.get(str(first_byte), f"field_{first_byte}")
        scale, missing = range_scale(columns[str(first_byte)]) if name == "range" else (1.0, None)
        fields.append({"name": name, "type": kind, "scale": scale, "missing": missing})
    header_bytes = _header_bytes(head, size, period, rows)
    return Layout.model_validate(
        {"header_bytes": header_bytes, "endian": endian, "fields": tuple(fields)}
    )


def byte_period(data: U8) -> int | None:
    """Return the shortest distance at which bytes repeat nearly best; None if none does.

    >>> shots = np.zeros(900, [("range", "<f4"), ("more", "<u2")])
    >>> shots["range"], shots["more"] = 5 + np.arange(900) % 70 / 9, 700
    >>> byte_period(np.frombuffer(shots.tobytes(), np.uint8))
    6
    """
    most = min(MOST_RECORD_BYTES, len(data) // LEAST_RECORDS)
    if most < 2:
        return None
    same = np.array([float(np.mean(data[lag:] == data[:-lag])) for lag in range(1, most + 1)])
    if same.max() < same.mean() + 0.02 and most > 8:
        return None
    good = np.flatnonzero(same >= SAME_AS_BEST * same.max()) + 1
    return next((int(lag) for lag in good if lag >= 2), None)


def _column(
    rows: U8,
    first_byte: int,
    kind: str,
    endian: str,
) -> NDArray[Any]:
    dtype = np.dtype(kind).newbyteorder("<" if endian == "little" else ">")
    return np.ascontiguousarray(rows[:, first_byte : first_byte + dtype.itemsize]).view(dtype)[:, 0]


def _float(values: NDArray[Any]) -> F64:
    with np.errstate(invalid="ignore"):  # misread bytes may be signalling NaN
        number: F64 = values.astype(np.float64)
    return number


def _fields(rows: U8, endian: str) -> list[tuple[int, str]]:
    """Return first byte and type of the fields that explain the bytes best."""
    width = rows.shape[1]
    # best merit, and the fields, of the bytes from every byte to the end
    best: list[tuple[float, list[tuple[int, str]]]] = [(0.0, [])] * (width + 1)
    for first_byte in range(width - 1, -1, -1):
        candidates = []
        for kind in _TRIED:
            stop = first_byte + np.dtype(kind).itemsize
            if stop <= width and _makes_sense(_column(rows, first_byte, kind, endian)):
                merit = _merit(rows, [(first_byte, kind)], endian) + best[stop][0]
                candidates.append((merit, [(first_byte, kind), *best[stop][1]]))
        best[first_byte] = max(candidates, key=lambda candidate: candidate[0])
    return best[0][1]


def _makes_sense(values: NDArray[Any]) -> bool:
    if values.dtype.itemsize == 1:
        return True
    number = _float(values)
    if values.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            size = np.abs(number)
            usual = (size == 0) | (
                (size > 1e-4) & (size < 1e10 if values.dtype.itemsize == 8 else size < 1e6)
            )
        is_set = np.isfinite(number) & (number != 0)
        return bool(np.mean(usual | np.isnan(number)) >= _MAJORITY and is_set.mean() > 0.02)
    # whole numbers of 2 or 4 bytes use their upper half little, and change it seldom
    upper = np.abs(number) / 2.0 ** (
        8 * values.dtype.itemsize - (6 if values.dtype.itemsize == 4 else 0)
    )
    varies = float(np.ptp(number)) > 0
    return bool(varies and np.mean(upper < 1) >= _MAJORITY and _likeness(number) < 1.2)


def _merit(rows: U8, fields: list[tuple[int, str]], endian: str) -> float:
    """Return how well fields explain the bytes: long types and like neighbours are better."""
    merit = 0.0
    for first_byte, kind in fields:
        values = _float(_column(rows, first_byte, kind, endian))
        merit += np.dtype(kind).itemsize ** 1.5 * (1.5 - min(_likeness(values), 1.5))
    return merit


def _likeness(values: F64) -> float:
    """Return the difference of neighbours as a share of that of random pairs; 1 for constants."""
    known = values[np.isfinite(values)]
    if len(known) < LEAST_RECORDS:
        return 1.0
    shuffled = np.random.default_rng(0).permutation(known)
    random = float(np.median(np.abs(shuffled - known)))
    return float(np.median(np.abs(np.diff(known)))) / random if random > 0 else 1.0


def _header_bytes(
    head: U8,
    size: int,
    period: int,
    rows: U8,
) -> int:
    """Return the bytes before the first record: they are unlike the bytes of records."""
    low, high = np.percentile(rows, (0.5, 99.5), axis=0)
    # bytes of few values distinguish records from other bytes
    few = high - low < 128
    first = size % period
    if not few.any():
        return first
    last = first
    for first_byte in range(first, min(len(head) - period, MOST_HEADER_BYTES), period):
        record = head[first_byte : first_byte + period]
        if np.mean((record[few] >= low[few]) & (record[few] <= high[few])) >= 0.5:
            return last
        last = first_byte + period
    return first


def range_scale(values: NDArray[Any]) -> tuple[float, float | None]:
    """Return the scale of supposed ranges [m], and the stored value that means no return.

    >>> range_scale(np.array([0, 5200, 5210, 0, 7000] * 50, "i4"))
    (0.001, 0.0)
    """
    number = _float(values)
    number = number[np.isfinite(number)]
    value, count = np.unique(number, return_counts=True)
    ends = [
        index
        for index in (0, len(value) - 1)
        if len(value) > 1 and count[index] > 0.005 * len(number)
    ]
    common = max(ends, key=lambda index: count[index]) if ends else None
    missing = None if common is None else float(value[common])
    real = number[number > 0] if missing is None else number[(number > 0) & (number != missing)]
    middle = float(np.median(real)) if len(real) else 1.0
    if values.dtype.kind == "f":
        return 1.0, missing
    if middle > 1500:
        return 0.001, missing
    return 0.01 if middle > 150 else 1.0, missing


def guess_names(columns: dict[str, NDArray[Any]]) -> dict[str, str]:
    """Return standard names of columns, guessed from their numbers; other columns are left out.

    Times never fall and are not whole. Lines never fall and repeat. Columns and angles rise evenly
    and restart. Three columns in a row that are large or go below 0 are coordinates. Neighbouring
    ranges are alike, positive, not even and not as large as an easting.

    >>> shot = np.arange(2000)
    >>> range_m = 9 + 3 * np.sin(shot % 100 / 9.0)
    >>> guess_names({"a": shot * 1e-5, "b": shot // 100, "c": shot % 100, "d": range_m})
    {'a': 'time', 'b': 'scan_line', 'c': 'column', 'd': 'range'}
    """
    names: dict[str, str] = {}
    ranges: list[tuple[float, str]] = []
    others: list[tuple[int, str, F64]] = []
    for position, (key, stored) in enumerate(columns.items()):
        values = _float(stored)
        known = values[np.isfinite(values)]
        if len(known) < LEAST_RECORDS or float(np.ptp(known)) <= 0:
            continue
        name = _even_name(known, np.diff(known))
        if name is not None:
            if name not in names.values():
                names[key] = name
        else:
            others.append((position, key, known))
    names |= dict(zip(_coordinates(others), "xyz", strict=False))
    for _, key, known in others:
        if key in names or _is_large(known):
            continue
        alike = _likeness(known[known > 0]) if np.mean(known > 0) > 0.2 else 1.0
        middle = float(np.median(known[known > 0])) if (known > 0).any() else 0.0
        if (
            alike < _ALIKE
            and np.mean(known < -1) < 0.01
            and middle > 0.1
            and len(np.unique(known)) > 50
        ):
            ranges.append((alike, key))
    if ranges:
        names[min(ranges)[1]] = "range"
    return {key: names[key] for key in columns if key in names}


def _is_large(known: F64) -> bool:
    """Whether numbers are map coordinates: too large for metres, not whole as millimetres."""
    return float(np.median(np.abs(known))) > LEAST_EASTING_M and not np.all(
        known == np.floor(known)
    )


def _coordinates(others: list[tuple[int, str, F64]]) -> list[str]:
    """Return the keys of x, y, z: three neighbouring columns, none whole, one large or below 0."""
    for i in range(len(others) - 2):
        three = others[i : i + 3]
        is_row = three[2][0] == three[0][0] + 2 and not any(
            np.all(known == np.floor(known)) for _, _, known in three
        )
        if is_row and any(_is_large(known) or np.mean(known < -1) > 0.01 for _, _, known in three):
            return [key for _, key, _ in three]
    return []


def _even_name(known: F64, step: F64) -> str | None:
    is_whole = bool(np.all(known == np.floor(known)))
    if np.all(step >= 0):
        # times may be rounded more coarsely than shots
        if not is_whole:
            return "time"
        return "scan_line" if float(np.mean(step > 0)) < 0.5 else None
    usual = float(np.median(step))
    even = float(np.mean(np.abs(step - usual) <= 0.1 * abs(usual))) if usual else 0.0
    if even < _EVEN:
        return None
    return "column" if is_whole and usual == 1 and known.min() == 0 else "angle"
