r"""Escapes control characters and undecodable bytes in names before they are printed."""

from __future__ import annotations


def printable(text: str) -> str:
    """Return a text as one printable line: control characters and bytes that are not UTF-8 are escaped."""
    return "".join(_shown(character) for character in text)


def printable_lines(text: str) -> str:
    """Return a text of several lines, each made :func:`printable`."""
    return "".join(character if character == "\n" else _shown(character) for character in text)


def _shown(character: str) -> str:
    if character.isprintable():
        return character
    if "\udc80" <= character <= "\udcff":  # a byte that is not UTF-8, in Python's encoding of file names
        return f"\\x{ord(character) - 0xDC00:02x}"
    return ascii(character)[1:-1]
