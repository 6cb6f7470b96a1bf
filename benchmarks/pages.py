"""Pages of figures: heading, paragraphs, tables, commands.

The heading says what was measured where: version, commit, day and machine. The last line says how
long it took; ``python -m benchmarks`` lists both.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import platform
import re
import subprocess
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from prc_cli.core.version import __version__

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("PRC_DATA", ROOT.parent / "shared" / "data"))
"""Real scans, which are not part of the project."""
FIGURES = ROOT / "figures"
WRITTEN_BY = "<!-- written by python -m benchmarks."
TOOK = "<!-- took "


_START = time.perf_counter()
"""When the program started."""


def heading(title: str, module: str) -> str:
    """Return the first lines of a page: title, version, commit, day, machine."""
    measured = f"prc {__version__}, {_commit()}, {datetime.now(tz=UTC).date()}, {machine()}."
    return f"{WRITTEN_BY}{module}; do not edit -->\n\n# {title}\n\n{measured}\n"


_HEAD = re.compile(r"^prc (\S+), commit (\S+), (\d{4}-\d\d-\d\d), (.+?)\.", re.MULTILINE)


class Measured(NamedTuple):
    """What the head of a page says."""

    version: str
    commit: str
    day: str
    machine: str


def measured(page: str) -> Measured | None:
    """Return what the head of a page says; None without a head.

    >>> measured("# Speed\\n\\nprc 1.1.0, commit d3ea59da, 2026-11-26, 2 cores.\\n").version
    '1.1.0'
    """
    head = _HEAD.search(page.partition("\n## ")[0])
    return None if head is None else Measured(*head.groups())


def duration() -> str:
    """Return the last line of a page: how long the program took."""
    minutes = (time.perf_counter() - _START) / 60.0
    return f"{TOOK}{max(round(minutes), 1)} min -->"


def _commit() -> str:
    command = ["git", "describe", "--always", "--dirty"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return f"commit {done.stdout.strip() or 'not known'}"


def machine() -> str:
    """Return the processor and its number of cores in words."""
    name = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                name = line.partition(":")[2].strip()
                break
    return f"{os.cpu_count()} cores of {name}"


def parser_of(description: str | None) -> argparse.ArgumentParser:
    """Return a parser whose help is the documentation of a module, as it is written."""
    return argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def run_parts(
    description: str | None,
    title: str,
    module: str,
    parts: Mapping[str, Callable[[Path], None]],
) -> None:
    """Print a page of the parts that the command line names, all by default."""
    parser = parser_of(description)
    parser.add_argument("parts", nargs="*", choices=[[], *parts], metavar="PART")
    chosen = parser.parse_args().parts or parts
    print(heading(title, module))
    for name in chosen:
        with tempfile.TemporaryDirectory() as folder:
            parts[name](Path(folder))
    print(duration())


def say(text: str) -> None:
    """Print a paragraph, rewrapped."""
    words = " ".join(text.split())
    print(textwrap.fill(words, 118, break_long_words=False, break_on_hyphens=False) + "\n")


def table(header: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Print a table; numbers stand to the right of all columns but the first."""
    names = list(header)
    print(f"| {' | '.join(names)} |\n|---|{'---:|' * (len(names) - 1)}")
    for row in rows:
        print(f"| {' | '.join(map(str, row))} |", flush=True)
    print()


def commands(*lines: str) -> None:
    """Print commands as a console shows them."""
    print("```console\n" + "\n".join(f"$ {line}" for line in lines) + "\n```\n")


def printed_at(number: float, digits: int = 3) -> str:
    """Return a number for a table; a dash if it is not defined."""
    return "-" if np.isnan(number) else f"{number:.{digits}f}"
