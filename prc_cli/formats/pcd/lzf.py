"""Decoder of LZF (liblzf), the compression of PCD files; every length is checked before it is used."""

from __future__ import annotations

MAX_RATIO = 264 / 3
"""Most bytes that a byte of LZF can stand for: the longest match is 264 bytes in three."""
_SHORT = 32
"""Control bytes below this are followed by so many bytes, plus one, as they are."""


def decode_lzf(data: memoryview, n_bytes: int) -> bytearray | None:
    """Unpack data of a known size.

    Three bytes as they are, then six that repeat them:

    >>> decode_lzf(memoryview(bytes([2, 97, 98, 99, 0b100_00000, 2])), 9)
    bytearray(b'abcabcabc')
    """
    out = bytearray()
    at, end = 0, len(data)
    while at < end:
        control = data[at]
        at += 1
        if control < _SHORT:
            stop = at + control + 1
            if stop > end:
                return None
            out += data[at:stop]
            at = stop
        else:
            length = control >> 5
            if length == 7:
                if at >= end:
                    return None
                length += data[at]
                at += 1
            if at >= end:
                return None
            first = len(out) - ((control & 31) << 8) - data[at] - 1
            at += 1
            length += 2
            if first < 0:
                return None
            piece = out[first : first + length]
            # a match that reaches into itself repeats
            out += piece if len(piece) == length else (piece * (length // len(piece) + 1))[:length]
        if len(out) > n_bytes:
            return None
    return out if len(out) == n_bytes else None
