"""Files that are made to end a process, or to keep it for ever."""

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
