"""Point records as bytes: class codes set, formats 0-5 turned into 6-10, extra bytes appended.

Records are (n, record length) uint8 arrays, laid out as in the file (ASPRS LAS 1.4 R15, tables 7-17).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import I64, U8
from prc_cli.formats.las.file import POINT_SIZES

FORMAT_FOR_CODES = {0: 6, 1: 6, 2: 7, 3: 7, 4: 9, 5: 10}
"""The format with eight-bit classes that holds everything of a format with five-bit classes."""

SCAN_ANGLE_STEP_DEG = 0.006
"""Unit of the scan angle in formats 6-10 [deg]."""

_HAS_TIME = {1: 20, 3: 20, 4: 20, 5: 20}  # byte of gps_time by old format
_COLOUR = {2: (20, 30), 3: (28, 30), 5: (28, 30)}  # bytes of red, green, blue: old and new place
_WAVE = {4: (28, 30), 5: (34, 38)}  # waveform packet, 29 bytes: old and new place


def set_classes(records: U8, point_format: int, codes: U8) -> None:
    """Set the class codes of records in place; flag bits that share the byte stay.

    Examples
    --------
    Format 0, class 31 and the withheld flag (bit 7) become class 2 and the withheld flag:

    >>> records = np.zeros((1, 20), np.uint8)
    >>> records[0, 15] = 0b1001_1111
    >>> set_classes(records, 0, np.array([2], np.uint8))
    >>> bin(records[0, 15])
    '0b10000010'
    """
    if point_format >= 6:
        records[:, 16] = codes
        return
    if codes.size and int(codes.max()) > 31:
        message = f"code {int(codes.max())} does not fit the five bits of point format {point_format}"
        raise ValueError(message)
    records[:, 15] = (records[:, 15] & 0xE0) | codes


def upgrade(records: U8, point_format: int) -> U8:
    """Turn records of formats 0-5 into the matching format 6-10, classes and extra bytes included.

    Return number and count, scan direction, edge, the three flags, user data, point source and colour are moved; the
    scan angle is turned from whole degrees into steps of 0.006 degrees; what the old format lacks (gps_time in 0
    and 2, near infrared in 5, scanner channel, overlap) is zero.

    Parameters
    ----------
    records : (n, old length) uint8
    point_format : int
        0 to 5.

    Returns
    -------
    (n, new length) uint8
    """
    new_format = FORMAT_FOR_CODES[point_format]
    old_size, new_size = POINT_SIZES[point_format], POINT_SIZES[new_format]
    new = np.zeros((len(records), new_size + records.shape[1] - old_size), np.uint8)
    new[:, :14] = records[:, :14]
    returns, class_byte = records[:, 14], records[:, 15]
    new[:, 14] = (returns & 0x07) | ((returns & 0x38) << 1)
    new[:, 15] = (class_byte >> 5) | (returns & 0xC0)
    new[:, 16] = class_byte & 0x1F
    new[:, 17] = records[:, 17]
    degrees = np.ascontiguousarray(records[:, 16]).view(np.int8)
    steps = np.rint(degrees.astype(np.float64) / SCAN_ANGLE_STEP_DEG).astype("<i2")
    new[:, 18:20] = steps.view(np.uint8).reshape(-1, 2)
    new[:, 20:22] = records[:, 18:20]
    if point_format in _HAS_TIME:
        new[:, 22:30] = records[:, 20:28]
    if point_format in _COLOUR:
        old, at = _COLOUR[point_format]
        new[:, at : at + 6] = records[:, old : old + 6]
    if point_format in _WAVE:
        old, at = _WAVE[point_format]
        new[:, at : at + 29] = records[:, old : old + 29]
    new[:, new_size:] = records[:, old_size:]
    return new


def append_bytes(records: U8, columns: list[NDArray[Any]]) -> U8:
    """Append columns of little-endian numbers to records.

    >>> append_bytes(np.zeros((1, 2), np.uint8), [np.array([258], np.uint32)])
    array([[0, 0, 2, 1, 0, 0]], dtype=uint8)
    """
    parts = [records]
    for column in columns:
        little = np.ascontiguousarray(column, column.dtype.newbyteorder("<"))
        parts.append(little.view(np.uint8).reshape(len(records), -1))
    return np.concatenate(parts, axis=1)


def count_returns(records: U8) -> I64:
    """Count records of formats 6-10 by return number, (15,) int64: returns 1 to 15."""
    return np.bincount(records[:, 14] & 0x0F, minlength=16)[1:16].astype(np.int64)
