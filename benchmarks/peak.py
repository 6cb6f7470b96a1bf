"""Peak memory of a ``prc`` command in a separate process."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

CHILD = """
import resource, sys
from prc_cli.cli import main
try:
    main(sys.argv[1:])
except SystemExit as stop:
    code = stop.code or 0
try:
    # getrusage would count the process that started this one
    with open("/proc/self/status") as status:
        peak = next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1024
except OSError:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024**2 if sys.platform == "darwin" else 1024)
print(peak)
sys.exit(code)
"""


def peak_mib(arguments: Sequence[str]) -> float:
    """Run ``prc`` with these arguments; return its peak memory [MiB]."""
    command = [sys.executable, "-c", CHILD, *arguments]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
