"""Commands with closed stdin, stdout or stderr, as under daemons, end with one line and never a traceback."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from tests import patience

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the shell closes the streams")


def run(redirection: str, *arguments: str) -> tuple[int, bytes, str]:
    command = [sys.executable, "-m", "prc_cli", *arguments]
    done = patience.run(["sh", "-c", f'"$@" {redirection}', "sh", *command], input=bytes(4 * 90), capture_output=True)
    return done.returncode, done.stdout, done.stderr.decode()


@pytest.mark.parametrize(("redirection", "name"), [("<&-", "stdin"), (">&-", "stdout")])
def test_a_live_stream_needs_both_ends(redirection: str, name: str) -> None:
    code, out, err = run(redirection, "stream", "-M", "9")
    assert (code, out) == (2, b"")
    assert f"{name} is closed" in err
    assert err.count("\n") == 1


def test_files_are_written_though_nobody_listens(tmp_path: Path) -> None:
    source, output = tmp_path / "drive.bin", tmp_path / "labels.npy"
    np.full((20, 9), 7.0, np.float32).tofile(source)
    code, _, _ = run("<&- >&- 2>&-", "classify", str(source), str(output), "-M", "9", "--json")
    assert code == 0
    assert np.load(output).size == 180
