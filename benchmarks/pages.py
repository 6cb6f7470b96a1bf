"""Pages of figures: heading, paragraphs, commands.

The heading says what was measured where: version, commit, day and machine. The last line says how
long it took; ``python -m benchmarks`` lists both.
"""

from __future__ import annotations

import contextlib
import os
import platform
import subprocess
import textwrap
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from prc_cli.core.version import __version__

ROOT = Path(__file__).resolve().parent.parent
FIGURES = ROOT / "docs" / "figures"
WRITTEN_BY = "<!-- written by python -m benchmarks."
TOOK = "<!-- took "


_START = time.perf_counter()
"""When the program started."""


def heading(title: str, module: str) -> str:
    """Return the first lines of a page: title, version, commit, day, machine."""
    measured = f"prc {__version__}, {_commit()}, {datetime.now(tz=UTC).date()}, {machine()}."
    return f"{WRITTEN_BY}{module}; do not edit -->\n\n# {title}\n\n{measured}\n"


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


def say(text: str) -> None:
    """Print a paragraph, rewrapped."""
    words = " ".join(text.split())
    print(textwrap.fill(words, 118, break_long_words=False, break_on_hyphens=False) + "\n")


def commands(*lines: str) -> None:
    """Print commands as a console shows them."""
    print("```console\n" + "\n".join(f"$ {line}" for line in lines) + "\n```\n")


def printed_at(number: float, digits: int = 3) -> str:
    """Return a number for a table; a dash if it is not defined."""
    return "-" if np.isnan(number) else f"{number:.{digits}f}"
