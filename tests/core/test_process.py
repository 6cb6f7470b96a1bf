"""What a process says of its memory and time, and how it is interrupted."""

from __future__ import annotations

import platform
import sys
import time

import pytest

from prc_cli.core.profile import peak_memory, profiling, timed
from tests import patience

SCRIPT = """
import resource
import numpy as np
from prc_cli.core.process import keep_memory
from tests import patience

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        np.ones(1 << 20, np.uint8)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

faults()
keep_memory()
faults()
print(faults())
"""

RETURNED = """
import numpy as np
from prc_cli.core.process import keep_memory, return_memory

def resident():
    with open("/proc/self/statm") as file:
        return 4 * int(file.read().split()[1]) // 1024

def left(mib=24):
    before = resident()
    kept = [np.ones(mib << 20, np.uint8), np.ones(1000, np.uint8)]
    del kept[0]
    return resident() - before

return_memory()
first = left()
keep_memory()
print(first, left())
"""


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="what it is about is done by the GNU C library"
)
def test_what_is_read_to_look_at_an_input_is_returned() -> None:
    done = patience.run(
        [sys.executable, "-c", RETURNED], capture_output=True, text=True, check=True
    )
    returned, kept = map(int, done.stdout.split())
    assert returned < 2
    assert kept > 20


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="what it is about is done by the GNU C library"
)
def test_arrays_that_follow_each_other_share_memory() -> None:
    done = patience.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 20 * 16, "20 arrays of 256 pages"


def burn(seconds: float) -> None:
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


def test_a_stage_inside_another_is_not_counted_twice() -> None:
    with profiling() as profile, timed("outer"):
        burn(0.02)
        with timed("inner"):
            burn(0.05)
    stages = {stage_time.name: stage_time for stage_time in profile.stages()}
    assert stages["inner"].cpu_s >= 0.05
    assert stages["outer"].cpu_s >= 0.02
    assert sum(stage_time.cpu_s for stage_time in stages.values()) <= profile.cpu_s
    assert stages["outer"].wall_s + stages["inner"].wall_s <= profile.wall_s


def test_the_peak_of_memory_is_that_of_a_process_with_an_interpreter() -> None:
    peak = peak_memory()
    assert peak is None or 5 << 20 < peak < 1 << 40
