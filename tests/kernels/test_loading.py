"""How the compiler is loaded: whole in the process of others, without what prc never uses in the command's own."""

from __future__ import annotations

import subprocess
import sys

import pytest

from prc_cli.kernels.loading import UNNEEDED

LOAD = """
import sys
from prc_cli.core.process import claim_process
from prc_cli.kernels import load_kernels
{claim}
load_kernels(frozenset({{"prc.support"}}))
import numba, numpy
print(*sorted(set({names}) & set(sys.modules)))
assert sys.modules.get("scipy.linalg", 0) is not None
if not {claim!r}:
    double = numba.njit(lambda a: numpy.dot(a, a))
    assert double(numpy.eye(2)).sum() == 2
"""


@pytest.mark.parametrize("claim", ["claim_process()", ""])
def test_a_guest_loads_the_compiler_whole(claim: str) -> None:
    code = LOAD.format(claim=claim, names=UNNEEDED)
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert ("scipy.linalg" in found) is (not claim)
