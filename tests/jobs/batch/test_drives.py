"""Drives in many files: one stream, one item of work, an outcome a file."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from prc_cli.jobs.batch import run as batch_run
from prc_cli.jobs.batch.discovery import Drives, discover
from prc_cli.jobs.batch.engine import EngineSettings, Event, Started
from prc_cli.jobs.batch.journal import read_entries
from prc_cli.jobs.batch.outcomes import Failed, Problem
from prc_cli.jobs.batch.run import plan_batch, run_batch
from prc_cli.jobs.batch.types import OWN_FOLDER, BatchSettings, ConfigLayers, Shard, Task
from prc_cli.jobs.batch.worker import run_item
from tests.street import POINTS_PER_LINE, street


class LosesItsWorker:
    """An engine that works in this process; its worker dies when it finished the first file."""

    def __init__(self) -> None:
        self.n_items = 0

    def run(self, tasks: Iterable[Task], settings: EngineSettings) -> Iterator[Event]:
        for task in tasks:
            self.n_items += 1
            yield from (Started(name, "here") for name in task.names)
            if self.n_items > 1:
                yield from run_item(task)
                continue
            task.output.parent.mkdir(parents=True, exist_ok=True)
            task.output.write_bytes(b"half of a drive")
            for name in task.names:
                yield Failed(name, None, 1.0, Problem("killed", name, "died"))


@pytest.fixture
def settings(tmp_path):
    """A drive in three files, which end within lines."""
    (tmp_path / "in").mkdir()
    for number, part in enumerate(np.array_split(street().ravel(), 3)):
        part.tofile(tmp_path / "in" / f"drive_{number}.bin")
    options = {"input": {"points_per_line": POINTS_PER_LINE}}
    layers = ConfigLayers(preset="prc-2019-urban", options=options)
    return BatchSettings(
        tmp_path / "in", tmp_path / "out", config=layers, drives=("drive_?.bin", "a_*.bin")
    )


def test_a_drive_whose_worker_died_is_done_again_as_a_whole(settings, monkeypatch):
    monkeypatch.setattr(batch_run, "PAUSE_S", 0.0)
    engine = LosesItsWorker()
    summary = run_batch(settings, engine)
    assert (summary.exit_code, len(summary.done), engine.n_items) == (0, 3, 2)
    assert {entry.state for entry in read_entries(settings.out / OWN_FOLDER)} == {"done"}


def test_drives_are_selected_as_a_whole(settings):
    for i in range(4):
        (settings.archive / f"a_{i}.bin").write_bytes(b"\0" * 4)
    plan = plan_batch(replace(settings, limit=5))[0]
    assert (len(plan.todo), plan.n_items, plan.n_beyond_limit) == (4, 1, 3)
    assert len(plan_batch(replace(settings, limit=1))[0].todo) == 4
    shards = [discover(replace(settings, shard=Shard(i, 2))).files for i in (1, 2)]
    assert sorted(len(files) for files in shards) in ([0, 7], [3, 4])
    os.utime(settings.archive / "drive_2.bin", (2e9, 2e9))
    since = discover(replace(settings, since="2030-01-01"))
    assert [item.name for item in since.files] == ["drive_0.bin", "drive_1.bin", "drive_2.bin"]


def test_parts_are_numbered_by_the_last_wildcards():
    drives = Drives(["day_*/drive_*_*.laz", "scan-[0-9][0-9].las", "**/*.bin"])
    assert drives.of("day_1/drive_a_b_10.laz") == ("day_1/drive_a_b_*.laz", ("", 10, ""))
    assert drives.of("day_1/drive_a_b_2.laz")[1] < drives.of("day_1/drive_a_b_10.laz")[1]
    assert drives.of("x/scan-07.las") == ("x/scan-[0-9][0-9].las", ("", 7, ""))
    assert drives.of("a/b/c.bin")[0] == drives.of("a/b/d2.bin")[0] == "a/b/*.bin"
    assert drives.of("a/e.bin")[0] == "a/*.bin"
    assert drives.of("scan-7.las") == ("scan-7.las", ())
