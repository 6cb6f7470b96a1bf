"""Whole runs, with scripted engines for rare events and with real workers for equal bytes."""

import json
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from prc_cli.core.errors import BusyError, PrcError
from prc_cli.core.findings import Finding, Verdict
from prc_cli.jobs.batch import run as batch_run
from prc_cli.jobs.batch.engine import EngineSettings, Event, Started
from prc_cli.jobs.batch.journal import read_entries, read_runs
from prc_cli.jobs.batch.lock import Lock
from prc_cli.jobs.batch.outcomes import Done, Failed, InputPrint, Outcome, Problem
from prc_cli.jobs.batch.outputs import verify_outputs
from prc_cli.jobs.batch.run import Again, RunEvent, run_batch
from prc_cli.jobs.batch.types import (
    OWN_FOLDER,
    BatchSettings,
    ConfigLayers,
    Task,
)
from prc_cli.jobs.batch.worker import run_task
from tests.street import street, write_csv, write_npz, write_raw

Script = Callable[[Task, int], Outcome]
"""What becomes of a task at its n-th attempt."""


def work(task: Task, attempt: int) -> Outcome:
    """Do what a worker does, in this process."""
    return run_task(task)


def finished(task: Task, **labels: int) -> Done:
    task.output.parent.mkdir(parents=True, exist_ok=True)
    task.output.write_bytes(task.source.read_bytes())
    status = task.source.stat()
    written = task.output.stat()
    return Done(
        task.name,
        InputPrint(status.st_size, status.st_mtime_ns, "0"),
        written.st_size,
        written.st_mtime_ns,
        1.0,
        1.0,
        50.0,
        1,
        100,
        100,
        tuple((labels or {"ground": 60, "building": 40}).items()),
    )


def failed(task: Task, kind: str) -> Failed:
    return Failed(task.name, None, 1.0, Problem(kind, task.name, "as the script says"))


class Scripted:
    """An engine that does what a test wants, in this process."""

    def __init__(self, script: Script = lambda task, attempt: finished(task)) -> None:
        self.script = script
        self.begun: list[tuple[str, int]] = []
        """Names, and how many files at a time."""
        self.n_passes = 0

    def run(self, tasks: Iterable[Task], settings: EngineSettings) -> Iterator[Event]:
        self.n_passes += 1
        for task in tasks:
            self.begun.append((task.name, settings.jobs))
            yield Started(task.name, "here")
            yield self.script(task, sum(name == task.name for name, _ in self.begun))


@pytest.fixture
def settings(tmp_path):
    (tmp_path / "in").mkdir()
    for name in "abcd":
        (tmp_path / "in" / f"{name}.npz").write_bytes(name.encode())
    return BatchSettings(tmp_path / "in", tmp_path / "out", jobs=2)


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch):
    monkeypatch.setattr(batch_run, "PAUSE_S", 0.0)


def states(settings: BatchSettings) -> dict[str, str]:
    return {entry.name: entry.state for entry in read_entries(settings.out / OWN_FOLDER)}


def test_a_second_run_has_nothing_to_do(settings):
    first = run_batch(settings, Scripted())
    assert (first.exit_code, len(first.done), first.n_found, first.ended) == (0, 4, 4, "finished")
    assert first.reasons == (("new", 4),)
    engine = Scripted()
    second = run_batch(settings, engine)
    assert (engine.begun, engine.n_passes) == ([], 0), "no worker is started for nothing"
    assert (second.exit_code, second.n_skipped, second.done) == (0, 4, ())
    assert [run.exit_code for run in read_runs(settings.out / OWN_FOLDER)] == [0, 0]


@pytest.mark.parametrize(
    "kind, retry, attempts",
    [
        ("InputError", 5, 1),
        ("ConfigError", 5, 1),
        ("EvidenceError", 5, 1),
        ("OutputExistsError", 5, 1),
        ("ValueError", 5, 1),
        ("killed", 0, 2),
        ("killed", 3, 4),
        ("memory", 0, 1),
        ("memory", 2, 3),
        ("timeout", 1, 2),
        ("changed", 1, 2),
        ("vanished", 1, 2),
        ("PermissionError", 2, 3),
        ("OutputError", 1, 2),
    ],
)
def test_what_may_pass_is_tried_again(
    settings,
    kind,
    retry,
    attempts,
):
    engine = Scripted(
        lambda task, _: failed(task, kind) if task.name == "b.npz" else finished(task)
    )
    events: list[RunEvent] = []
    summary = run_batch(replace(settings, retry=retry), engine, events.append)
    tries = [jobs for name, jobs in engine.begun if name == "b.npz"]
    assert len(tries) == attempts
    assert sum(isinstance(event, Again) for event in events) == attempts - 1
    assert [item.problem.kind for item in summary.failed] == [kind]
    (entry,) = [entry for entry in read_entries(settings.out / OWN_FOLDER) if entry.name == "b.npz"]
    assert entry.attempts == attempts


def test_a_file_that_killed_its_worker_is_tried_alone_at_the_end(settings):
    def script(task: Task, attempt: int) -> Outcome:
        if task.name in ("a.npz", "c.npz") and attempt == 1:
            return failed(task, "killed")
        assert (
            not task.overwrite
        )  # what an attempt before wrote is recognised, what others put there is kept
        return finished(task)

    engine = Scripted(script)
    summary = run_batch(settings, engine)
    assert engine.begun == [*((f"{name}.npz", 2) for name in "abcd"), ("a.npz", 1), ("c.npz", 1)]
    assert engine.n_passes == 2
    assert summary.exit_code == 0
    assert len(summary.done) == 4


def test_fail_fast_begins_nothing_more(settings):
    engine = Scripted(
        lambda task, _: failed(task, "InputError") if task.name == "b.npz" else finished(task)
    )
    summary = run_batch(replace(settings, fail_fast=True), engine)
    assert [name for name, _ in engine.begun] == ["a.npz", "b.npz"]
    assert (summary.exit_code, summary.ended, summary.n_waiting) == (1, "stopped", 2)
    assert len(run_batch(settings, Scripted()).done) == 3


@pytest.mark.parametrize("signal_error, code", [(KeyboardInterrupt(), 130), (SystemExit(143), 143)])
def test_a_signal_is_noted_and_passed_on(settings, signal_error, code):
    closed = []

    class Stopped(Scripted):
        def run(self, tasks: Iterable[Task], settings: EngineSettings) -> Iterator[Event]:
            try:
                for number, task in enumerate(tasks):
                    if number == 2:
                        raise signal_error
                    yield Started(task.name, "here")
                    if number == 0:
                        yield finished(task)
            finally:
                closed.append(True)

    with pytest.raises(type(signal_error)):
        run_batch(settings, Stopped())
    assert closed == [True]
    # cut off, as if the run had been killed: no file failed
    assert states(settings) == {"a.npz": "done", "b.npz": "running", "c.npz": "running"}
    written = json.loads((settings.out / "summary.json").read_text())
    assert (written["ended"], written["counts"]["waiting"], written["counts"]["failed"]) == (
        "interrupted",
        3,
        0,
    )
    assert [run.exit_code for run in read_runs(settings.out / OWN_FOLDER)] == [code]
    summary = run_batch(settings, Scripted())
    assert (len(summary.done), dict(summary.reasons)["unfinished"]) == (3, 2)


def test_a_lost_lock_stops_the_run(settings, monkeypatch):
    asked = []

    def check(self: Lock) -> None:
        asked.append(True)
        if len(asked) > 2:
            raise BusyError("lock.json", "the lock was lost")

    monkeypatch.setattr(Lock, "check", check)
    engine = Scripted()
    with pytest.raises(BusyError):
        run_batch(settings, engine)
    assert len(engine.begun) == 2


def test_the_exit_code_is_that_of_the_archive(settings):
    """A failure or a doubt stands until its file is done, whatever a later run looks at."""
    odd = Finding("units", Verdict.DOUBTFUL, "the scanner is 9 m up", "at most 5 m")

    def script(task: Task, attempt: int) -> Outcome:
        if task.name == "a.npz":
            return failed(task, "InputError")
        accepts = task.config.config.input.accept_doubts or ()
        notice = replace(odd, is_accepted=odd.check in accepts).notice()
        return replace(finished(task), notices=(notice,) if task.name == "b.npz" else ())

    assert run_batch(settings, Scripted(script)).exit_code == 1
    for settings_of_run in (settings, replace(settings, since="2999-01-01")):
        again = run_batch(settings_of_run, Scripted(script))
        assert (again.exit_code, [doubt.name for doubt in again.doubts]) == (1, ["b.npz"])
    assert [item.name for item in again.failed_before] == ["a.npz"], "it was not even looked at"
    without = replace(settings, exclude=("a.npz",))
    assert run_batch(without, Scripted(script)).exit_code == 4
    accepting = replace(
        without, config=ConfigLayers(options={"input": {"accept_doubts": ("units",)}})
    )
    for config, done in ((accepting, ["b.npz"]), (accepting, []), (without, ["b.npz"])):
        summary = run_batch(config, Scripted(script))
        assert ([item.name for item in summary.done], summary.exit_code) == (
            done,
            0 if config is accepting else 4,
        )


@pytest.mark.parametrize("damage", ["cut", "overwritten", "link"])
def test_a_damaged_output_is_not_done(tmp_path, damage):
    archive = tmp_path / "in"
    out = tmp_path / "out"
    archive.mkdir()
    for name in ("a.npz", "b.npz"):
        write_npz(archive / name, street(80))
    settings = BatchSettings(
        archive, out, ConfigLayers(preset="prc-2019-urban"), jobs=1, drift=False
    )
    run_batch(settings, Scripted(work))
    output = out / "a.npz.labels.npy"
    whole = output.read_bytes()
    assert {verified.state for verified in verify_outputs(out)} == {"whole"}
    if damage == "cut":
        output.write_bytes(whole[: len(whole) // 2])
    elif damage == "overwritten":
        output.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
        os.utime(output, ns=(1, 1))
    else:
        output.unlink()
        output.symlink_to("nothing")
    states = {verified.name: verified.state for verified in verify_outputs(out)}
    assert states == {"a.npz.labels.npy": "damaged", "b.npz.labels.npy": "whole"}
    summary = run_batch(settings, Scripted(work))
    assert ([item.name for item in summary.done], summary.n_skipped, summary.exit_code) == (
        ["a.npz"],
        1,
        0,
    )
    assert dict(summary.reasons) == {"changed output": 1}
    assert output.read_bytes() == whole
    assert len([*(out / OWN_FOLDER / "changed").iterdir()]) == 1
    # what was restored, with other times, is not done again; what keeps both is found by --verify
    os.utime(output, ns=(1, 1))
    assert run_batch(settings, Scripted(work)).n_skipped == 2
    output.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    os.utime(output, ns=(1, 1))
    assert run_batch(settings, Scripted(work)).n_skipped == 2
    assert dict(run_batch(replace(settings, verify=True), Scripted(work)).reasons) == {
        "changed output": 1
    }


# -- real workers


def fill(archive: Path) -> None:
    """Small files of several formats with odd names, one of them damaged."""
    for folder in ("day", "night two", "odd\nname"):
        (archive / folder).mkdir(parents=True)
    for i in range(4):
        write_npz(archive / "day" / f"{i}.npz", street(80 + 7 * i, seed=i))
    write_csv(archive / "night two" / "a.csv.gz", street(75, seed=7))
    write_raw(archive / "odd\nname" / "b.bin", street(90, seed=8))
    (archive / "day" / "damaged.laz").write_bytes(b"LASF and nothing more")
    if os.name == "posix":
        write_npz(Path(os.fsdecode(os.fsencode(archive) + b"/caf\xe9.npz")), street(71, seed=9))


LAYERS = ConfigLayers(options={"input": {"points_per_line": 180}})


def tree(out: Path) -> dict[str, bytes]:
    """Every file of an output tree but what names times: the journal's folder and the summary."""
    content = {}
    for path in sorted(out.rglob("*")):
        relative = path.relative_to(out)
        if path.is_file() and relative.parts[0] not in (OWN_FOLDER, "summary.json"):
            content[str(relative)] = path.read_bytes()
    return content


@pytest.mark.slow
def test_the_same_bytes_whatever_the_number_of_workers(tmp_path):
    fill(tmp_path / "in")
    outs = [tmp_path / "one", tmp_path / "two"]
    by_one, by_two = (
        run_batch(BatchSettings(tmp_path / "in", out, LAYERS, jobs=jobs))
        for out, jobs in zip(outs, (1, 2), strict=True)
    )
    assert len(tree(outs[0])) == 14
    assert not [name for name in tree(outs[0]) if name.endswith(".part")]
    assert tree(outs[0]) == tree(outs[1])
    assert by_one.exit_code == by_two.exit_code == 1
    assert [item.name for item in by_one.failed] == [item.name for item in by_two.failed]
    assert {item.name for item in by_one.done} == {item.name for item in by_two.done}


def test_workers_that_cannot_be_started_leave_files_to_the_next_run(
    settings,
):
    class Broken(Scripted):
        def run(self, tasks: Iterable[Task], settings: EngineSettings) -> Iterator[Event]:
            yield Started(next(iter(tasks)).name, "here")
            raise PrcError("worker process", "cannot be started")

    with pytest.raises(PrcError):
        run_batch(settings, Broken())
    assert states(settings) == {"a.npz": "running"}
    assert [run.exit_code for run in read_runs(settings.out / OWN_FOLDER)] == [1]
    assert len(run_batch(settings, Scripted()).done) == 4


pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends signals")
