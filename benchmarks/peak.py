"""Peak memory of a ``prc`` command, as it is typed: with its guard, in processes of its own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

CHILD = """
import resource, subprocess, sys
# a process takes over the peak of the one that starts it: this one is small
code = subprocess.run([sys.executable, "-m", "prc_cli", *sys.argv[1:]], stdout=sys.stderr).returncode
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / (1024**2 if sys.platform == "darwin" else 1024))
sys.exit(code)
"""


def peak_mib(arguments: Sequence[str]) -> float:
    """Run ``prc`` with these arguments; return its peak memory [MiB]."""
    command = [sys.executable, "-c", CHILD, *arguments]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
