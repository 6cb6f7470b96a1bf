r"""Names from disks on terminals: nothing that a terminal obeys, nothing that cannot be encoded."""

from __future__ import annotations


def printable(text: str) -> str:
    r"""Return a text as one printable line: control characters and bytes that are no UTF-8 are escaped.

    >>> printable("a\x1b[2Jb\nc.las")
    'a\\x1b[2Jb\\nc.las'
    >>> import os
    >>> printable(os.fsdecode(b"stra\xdfe.laz"))
    'stra\\xdfe.laz'
    """
    return "".join(_shown(character) for character in text)


def printable_lines(text: str) -> str:
    r"""Return a text of several lines, each of them as :func:`printable` has it.

    >>> printable_lines("a\x1b[2J\nb")
    'a\\x1b[2J\nb'
    """
    return "".join(character if character == "\n" else _shown(character) for character in text)


def _shown(character: str) -> str:
    if character.isprintable():
        return character
    if "\udc80" <= character <= "\udcff":  # a byte of a name that is no UTF-8, as the file system gives it
        return f"\\x{ord(character) - 0xDC00:02x}"
    return ascii(character)[1:-1]
