"""A signal during the deletion of an object, when Python drops the exception of its handler."""

from __future__ import annotations

import os
import sys

import pytest

from tests import patience
from tests.patience import HANGS_S

PROGRAM = """
import os, signal, time
from prc_cli.cli import _leave_on_signals
_leave_on_signals()

class Deleted:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})
        sum(range(100))

Deleted()
time.sleep({hangs})
print("still running")
"""


@pytest.mark.skipif(os.name != "posix", reason="sends itself a signal")
@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", -2)])
def test_it_comes_again(name: str, code: int) -> None:
    program = PROGRAM.format(name=name, hangs=HANGS_S)
    done = patience.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (code, "")
