"""Files that are made to end a process, or to keep it for ever."""

from __future__ import annotations

import sqlite3
import struct
from importlib.metadata import version
from pathlib import Path

import pytest

KEPT = Path(__file__).parent / "found"
"""Files that once showed a fault, by what they do."""


def overflowing() -> bytes:
    """Return a LAZ file whose times overflow the stack of lazrs 0.8.

    It is ``pf6.laz`` of the seeds with another layer of times: 200,000 times in some ten bytes the
    symbol that switches to another sequence. lazrs dies between 20,000 and 40,000 of them.

    Skips the test where an older lazrs is installed: it counts the bytes first.
    """
    if int(version("lazrs").split(".")[1]) < 8:
        pytest.skip("this version of lazrs refuses the file: it counts the bytes first")
    return (KEPT / "overflowing.laz").read_bytes()


def huge_page(path: Path) -> Path:
    """Write a Parquet file whose column ``range`` has a page that says it holds 2 GB."""
    path.write_bytes((KEPT / "huge_page.parquet").read_bytes())
    return path


def endless_rows(path: Path, table: str) -> Path:
    """Let every pointer of a table's pages in a ``.db3`` lead to one child.

    Some 10^13 rows in five more pages.
    """
    with sqlite3.connect(path) as base:
        (root,) = base.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)
        ).fetchone()
        (size,) = base.execute("PRAGMA page_size").fetchone()
    data = bytearray(path.read_bytes())
    leaf = bytes(data[(root - 1) * size : root * size])
    n_pages = len(data) // size
    n_cells = (size - 12) // 7
    places = [(size - 5 * (i + 1)) for i in range(n_cells)]

    def inner(child: int) -> bytes:
        head = struct.pack(">BHHHBI", 5, 0, n_cells, places[-1], 0, child)
        page = bytearray(head.ljust(size, b"\0"))
        for i, place in enumerate(places):
            struct.pack_into(">H", page, 12 + 2 * i, place)
            struct.pack_into(">IB", page, place, child, 100)
        return bytes(page)

    first = n_pages + 1
    data[(root - 1) * size : root * size] = inner(first)
    for child in range(first + 1, first + 5):
        data += inner(child)
    data += leaf
    struct.pack_into(">I", data, 28, len(data) // size)
    path.write_bytes(data)
    return path
