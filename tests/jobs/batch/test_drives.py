"""Drives in many files: one stream, one item of work, an outcome a file."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError
from prc_cli.jobs.batch import run as batch_run
from prc_cli.jobs.batch.discovery import Drives, discover
from prc_cli.jobs.batch.engine import EngineSettings, Event, Started
from prc_cli.jobs.batch.journal import read_entries
from prc_cli.jobs.batch.outcomes import Failed, Problem
from prc_cli.jobs.batch.plan import Plan
from prc_cli.jobs.batch.run import plan_batch, run_batch
from prc_cli.jobs.batch.types import OWN_FOLDER, BatchSettings, ConfigLayers, Shard, Task
from prc_cli.jobs.batch.worker import run_item
from prc_cli.jobs.classify import classify
from prc_cli.jobs.drive import classify_drive
from tests.jobs.test_drive import CUTS, WITH_M, cut_raw
from tests.street import POINTS_PER_LINE

LAYERS = ConfigLayers(
    preset="prc-2019-urban", options={"input": {"points_per_line": POINTS_PER_LINE}}
)
PATTERN = "drive_?.bin"


class Here:
    """An engine that works in this process, and may lose a worker at first."""

    def __init__(self, *, dies: bool = False) -> None:
        self.dies = dies
        self.items: list[tuple[str, ...]] = []

    def run(self, tasks: Iterable[Task], settings: EngineSettings) -> Iterator[Event]:
        for task in tasks:
            self.items.append(tuple(task.names))
            yield from (Started(name, "here") for name in task.names)
            if self.dies and len(self.items) == 1:
                # it had finished the first file
                task.output.parent.mkdir(parents=True, exist_ok=True)
                task.output.write_bytes(b"half of a drive")
                yield from (
                    Failed(name, None, 1.0, Problem("killed", name, "died")) for name in task.names
                )
            else:
                yield from run_item(task)


@pytest.fixture
def settings(tmp_path):
    (tmp_path / "in").mkdir()
    cut_raw(tmp_path / "in")[0].rename(tmp_path / "whole.bin")
    return BatchSettings(tmp_path / "in", tmp_path / "out", config=LAYERS, drives=(PATTERN,))


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch):
    monkeypatch.setattr(batch_run, "PAUSE_S", 0.0)


def reasons(plan: Plan) -> dict[str, str]:
    return {item.task.name: item.reason for item in plan.todo}


def labels_in(settings: BatchSettings) -> list[bytes]:
    return [path.read_bytes() for path in sorted(settings.out.glob("*.labels.npy"))]


def test_a_drive_has_the_labels_of_the_joined_file(settings, tmp_path):
    engine = Here()
    summary = run_batch(settings, engine)
    names = tuple(f"drive_{i}.bin" for i in range(3))
    assert (summary.exit_code, summary.n_found, engine.items) == (0, 3, [names])
    classify(tmp_path / "whole.bin", tmp_path / "whole.npy", WITH_M)
    labels = [np.load(settings.out / f"{name}.labels.npy") for name in names]
    assert np.array_equal(np.concatenate(labels), np.load(tmp_path / "whole.npy"))
    list(classify_drive([settings.archive / name for name in names], tmp_path / "once", WITH_M))
    assert labels_in(settings) == [
        path.read_bytes() for path in sorted((tmp_path / "once").glob("*.npy"))
    ]
    assert [done.n_records for done in summary.done] == np.diff(CUTS).tolist()
    assert all(
        "one drive of 3 files, drive_0.bin to drive_2.bin" in done.notices for done in summary.done
    )
    again = Here()
    assert run_batch(settings, again).n_skipped == 3
    assert again.items == []


@pytest.mark.parametrize("name", ["drive_0.bin", "drive_2.bin"])
def test_a_changed_part_makes_the_drive_new(settings, name):
    run_batch(settings, Here())
    part = settings.archive / name
    part.write_bytes(part.read_bytes()[: -4 * POINTS_PER_LINE])
    wanted = {f"drive_{i}.bin": "changed drive" for i in range(3)} | {name: "changed input"}
    assert reasons(plan_batch(settings)[0]) == wanted
    assert run_batch(settings, Here()).exit_code == 0


def test_more_parts_or_none_make_the_drive_new(settings):
    run_batch(settings, Here())
    more = settings.archive / "drive_3.bin"
    more.write_bytes((settings.archive / "drive_2.bin").read_bytes())
    assert reasons(plan_batch(settings)[0]) == {
        **{f"drive_{i}.bin": "changed drive" for i in range(3)},
        "drive_3.bin": "new",
    }
    more.unlink()
    assert plan_batch(settings)[0].todo == ()
    alone = plan_batch(replace(settings, drives=()))[0]
    assert set(reasons(alone).values()) == {"changed drive"}
    # some hold no whole lines
    run_batch(replace(settings, drives=()), Here())
    assert set(reasons(plan_batch(settings)[0]).values()) == {"changed drive", "failed before"}


def test_a_damaged_part_fails_its_drive_and_nothing_else(settings):
    whole = (settings.archive / "drive_1.bin").read_bytes()
    (settings.archive / "drive_1.bin").write_bytes(whole[:-1])
    (settings.archive / "other.bin").write_bytes(
        (settings.archive.parent / "whole.bin").read_bytes()
    )
    summary = run_batch(settings, Here())
    assert (summary.exit_code, [done.name for done in summary.done]) == (1, ["other.bin"])
    assert [failed.name for failed in summary.failed] == [f"drive_{i}.bin" for i in range(3)]
    assert all(
        failed.problem.where.startswith(str(settings.archive / "drive_1.bin"))
        for failed in summary.failed
    )
    assert sorted(path.name for path in settings.out.glob("drive_*")) == []
    (settings.archive / "drive_1.bin").write_bytes(whole)
    engine = Here()
    again = run_batch(replace(settings, only_failed=True), engine)
    assert (again.exit_code, len(again.done), len(engine.items)) == (0, 3, 1)


def test_a_drive_whose_worker_died_is_done_again_as_a_whole(settings):
    engine = Here(dies=True)
    summary = run_batch(settings, engine)
    assert (summary.exit_code, len(summary.done), len(engine.items)) == (0, 3, 2)
    assert {entry.state for entry in read_entries(settings.out / OWN_FOLDER)} == {"done"}


def test_drives_are_selected_as_a_whole(settings):
    for i in range(4):
        (settings.archive / f"a_{i}.bin").write_bytes(b"\0" * 4)
    settings = replace(settings, drives=(PATTERN, "a_*.bin"))
    plan = plan_batch(replace(settings, limit=5))[0]
    assert (len(plan.todo), plan.n_items, plan.n_beyond_limit) == (4, 1, 3)
    assert len(plan_batch(replace(settings, limit=1))[0].todo) == 4
    names = [
        [item.name for item in discover(replace(settings, shard=Shard(i, 2))).files] for i in (1, 2)
    ]
    assert sum(map(len, names)) == 7
    assert all(
        len([name for name in names_of_shard if name.startswith("a_")]) in (0, 4)
        for names_of_shard in names
    )
    os.utime(settings.archive / "drive_2.bin", (2e9, 2e9))
    since = discover(replace(settings, since="2030-01-01"))
    assert [item.name for item in since.files] == ["drive_0.bin", "drive_1.bin", "drive_2.bin"]


def test_files_of_one_drive_need_one_configuration(settings, tmp_path):
    config = tmp_path / "archive.toml"
    config.write_text('[[override]]\nmatch = "drive_1.bin"\n[override.input]\nmax_range = 50.0\n')
    plan = plan_batch(replace(settings, config=replace(LAYERS, path=config)))[0]
    assert [failed.name for failed in plan.refused] == [f"drive_{i}.bin" for i in range(3)]
    assert "has another configuration than drive_0.bin" in str(plan.refused[0].problem)


def test_parts_are_numbered_by_the_last_wildcards():
    drives = Drives(["day_*/drive_*_*.laz", "scan-[0-9][0-9].las", "**/*.bin"])
    assert drives.of("day_1/drive_a_b_10.laz") == ("day_1/drive_a_b_*.laz", ("", 10, ""))
    assert drives.of("day_1/drive_a_b_2.laz")[1] < drives.of("day_1/drive_a_b_10.laz")[1]
    assert drives.of("x/scan-07.las") == ("x/scan-[0-9][0-9].las", ("", 7, ""))
    assert drives.of("a/b/c.bin")[0] == drives.of("a/b/d2.bin")[0] == "a/b/*.bin"
    assert drives.of("a/e.bin")[0] == "a/*.bin"
    assert drives.of("scan-7.las") == ("scan-7.las", ())
    for bad in ("drive.laz", "night/**", "n*/drive.laz", ""):
        with pytest.raises(ConfigError, match="a wildcard in the file name"):
            Drives([bad])
