"""Compiled loops read from the cache without what numba compiles with."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from tests import patience

MODULE = """
import numpy as np
from prc_cli.kernels.cache import kernel

@kernel("float64[::1](float64[::1])")
def doubled(values):
    found = np.empty(values.size)
    for i in range(values.size):
        found[i] = 2 * values[i]
    return found
"""
OWN = "from prc_cli.core.process import claim_process; claim_process(); "
RUN = """
import numpy as np, sys
from some_loops import doubled
assert doubled(np.arange(3.0)).tolist() == [0.0, 2.0, 4.0]
print(sum(doubled.stats.cache_hits.values()), "numba.np.linalg" in sys.modules)
"""
LATER = """
import numba
@numba.njit("float64[::1](float64[::1])")
def later(values):
    return doubled(values) + 1
assert later(np.arange(3.0)).tolist() == [1.0, 3.0, 5.0]
"""
BROKEN = """
import prc_cli.kernels.warm
def fail(*_):
    raise AttributeError("another numba")
prc_cli.kernels.warm.WarmCache.load_overload = fail
"""

pytestmark = pytest.mark.skipif(bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled")


def run(tmp_path: Path, *parts: str) -> list[str]:
    if not (tmp_path / "some_loops.py").exists():  # a file written again is a new one to old numba
        (tmp_path / "some_loops.py").write_text(MODULE)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-B", "-c", "".join(parts)]
    return patience.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()


def test_both_ways_read_what_the_other_wrote(tmp_path: Path) -> None:
    assert run(tmp_path, OWN, RUN) == ["0", "True"], "what is not in the cache is compiled"
    assert run(tmp_path, OWN, RUN) == ["1", "False"]
    assert run(tmp_path, RUN) == ["1", "True"]
    for file in (tmp_path / "cache").rglob("*.nb?"):
        file.unlink()
    assert run(tmp_path, RUN) == ["0", "True"]
    assert run(tmp_path, OWN, RUN, LATER) == ["1", "False"], "a loop compiled later may call one from the cache"


def test_another_numba_reads_its_cache_in_its_own_way(tmp_path: Path) -> None:
    assert run(tmp_path, OWN, BROKEN, RUN) == ["0", "True"]
    assert run(tmp_path, OWN, BROKEN, RUN) == ["1", "True"]


def test_all_loops_of_the_command_need_no_linear_algebra() -> None:
    code = f"{OWN}import sys; from prc_cli.kernels import load_kernels; load_kernels(); print(*sys.modules)"
    patience.run([sys.executable, "-c", code], capture_output=True, check=True)
    found = patience.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "numba" in found
    assert not {"scipy.linalg", "numba.np.linalg", "numba.np.arraymath"} & set(found)
