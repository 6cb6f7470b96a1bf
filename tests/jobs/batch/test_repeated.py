"""An order that is given again, because its worker was lost, finds what the first attempt left."""

from __future__ import annotations

import os
import pickle
import signal
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from prc_cli.config import LoadedConfig, RunConfig
from prc_cli.formats.writing.record import record_path
from prc_cli.jobs.batch.types import Done, Task
from prc_cli.jobs.batch.worker import run_task
from tests import patience
from tests.street import street, write_npz

pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends signals")

PROGRAM = """
import os, pickle, signal, sys
from pathlib import Path
from prc_cli.core import files
from prc_cli.jobs.batch import worker

step, n = sys.argv[1], 0

def die():
    os.kill(os.getpid(), signal.SIGKILL)

place = files.place
def dying(temporary, path, *, overwrite):
    global n
    place(temporary, path, overwrite=overwrite)
    n += 1
    if n == int(step):
        die()

if step == "3":
    worker._done = lambda *_: die()
else:
    files.place = dying
worker.run_task(pickle.load(sys.stdin.buffer))
"""


def order(folder: Path) -> Task:
    (folder / "out").mkdir()
    source = write_npz(folder / "a.npz", street(80))
    return Task("a.npz", source, folder / "out" / "a.npy", LoadedConfig(RunConfig()), "")


def tree(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize(("step", "n_left"), [("1", 3), ("2", 4), ("3", 2)])
def test_a_worker_dies_after_a_name_was_given(tmp_path: Path, step: str, n_left: int) -> None:
    """Steps: the output has its name; the record too; both, and no temporary file is left."""
    task = order(tmp_path)
    root = Path(__file__).resolve().parents[3]
    ended = patience.run(
        [sys.executable, "-c", PROGRAM, step], input=pickle.dumps(task), env={**os.environ, "PYTHONPATH": str(root)}
    )
    assert ended.returncode == -signal.SIGKILL
    # the spool is left as well, unless the writer got to its end
    left = [name for name in tree(task.output.parent) if not name.endswith(".part") or ".prc.json" in name]
    assert task.output.name in left, left
    assert len(tree(task.output.parent)) >= n_left
    again = run_task(task)
    assert isinstance(again, Done), again
    undisturbed = replace(task, output=tmp_path / "alone.npy")
    assert isinstance(run_task(undisturbed), Done)
    assert task.output.read_bytes() == undisturbed.output.read_bytes()
    assert record_path(task.output).read_bytes() == record_path(undisturbed.output).read_bytes()
    assert set(tree(task.output.parent)) == {"a.npy", "a.npy.prc.json"}
