"""``prc batch`` on the command line: options, logs, tables, exit codes."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from prc_cli.cli.batch_report import print_status
from prc_cli.core.errors import BusyError
from prc_cli.core.files import temporary_name
from prc_cli.jobs.batch import journal
from prc_cli.jobs.batch import run as run_module
from prc_cli.jobs.batch.drift import Alarm
from prc_cli.jobs.batch.journal import Entry
from prc_cli.jobs.batch.lock import Holder, Owner
from prc_cli.jobs.batch.outcomes import Done, Doubted, Failed, InputPrint, Problem
from prc_cli.jobs.batch.plan import Plan
from prc_cli.jobs.batch.report import BatchSummary
from prc_cli.jobs.batch.run import Listener, Noted, Ready
from prc_cli.jobs.batch.types import BatchSettings
from tests import patience
from tests.cli.conftest import Result
from tests.street import street, write_csv, write_npz

PRC = [sys.executable, "-m", "prc_cli"]


Run = Callable[..., Result]


@pytest.fixture
def prc(prc):
    """Run ``prc batch``."""
    return partial(prc, "batch")


# -- real runs

ODD = os.fsdecode(b"night/stra\xdfe\n\x1b[31m.csv")


@pytest.fixture(scope="module")
def office(tmp_path_factory):
    """An archive of two good files and a bad one, and an output folder after a first run without a
    home or terminal."""
    folder = tmp_path_factory.mktemp("office")
    archive = folder / "archive"
    out = folder / "out"
    (archive / "night").mkdir(parents=True)
    write_npz(archive / "drive.npz", street())
    write_csv(archive / ODD, street(80))
    (archive / "night" / "bad.laz").write_bytes(b"LASF" + bytes(400))
    environment = {name: os.environ[name] for name in ("PATH", "PYTHONPATH") if name in os.environ}
    if "NUMBA_CACHE_DIR" in os.environ:
        environment["NUMBA_CACHE_DIR"] = os.environ["NUMBA_CACHE_DIR"]
    elif "HOME" in os.environ:  # without a home, but not without what is compiled already
        environment["XDG_CACHE_HOME"] = os.environ.get(
            "XDG_CACHE_HOME", os.environ["HOME"] + "/.cache"
        )
    command = [
        *PRC,
        *["batch", "archive", "out", "--preset", "urban", "--jobs", "1", "--log-json", "log.jsonl"],
    ]
    result = patience.run(
        command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True
    )
    assert result.returncode == 1, result.stderr
    assert result.stdout == b""
    (folder / "err.txt").write_bytes(result.stderr)
    return archive, out


def test_one_line_a_file_without_control_characters(office):
    text = (office[1].parent / "err.txt").read_text(encoding="utf-8")
    lines = text.splitlines()
    assert "\x1b" not in text
    assert sum(line.startswith("[") for line in lines) == 3
    assert "[1/3] done drive.npz: 24,660 shots" in text
    assert r"done night/stra\xdfe\n\x1b[31m.csv: 14,400 shots" in text
    assert any(line.startswith("[2/3] failed night/bad.laz: byte") for line in lines)
    assert lines[-1].startswith("2 done, 1 failed of 3 in ")
    assert not any("\r" in line for line in lines)


@pytest.mark.skipif(os.name != "posix", reason="permissions")
def test_retry_obeys_nobody_else_and_no_nonsense(
    office,
    prc,
    tmp_path,
    monkeypatch,
):
    """Who could write there chose where the log of somebody else was appended."""
    out = tmp_path / "out"
    shutil.copytree(office[1], out)
    monkeypatch.chdir(tmp_path)
    command = out / ".prc" / "command.json"
    assert command.stat().st_mode & 0o777 == 0o600
    command.chmod(0o666)
    result = prc("retry", "out")
    assert (result.code, "other users can change this file (its mode is 666)" in result.err) == (
        2,
        True,
    )
    command.chmod(0o600)
    command.write_bytes(b"\xff")
    assert "type the whole command again" in prc("retry", "out").err
    command.unlink()
    os.mkfifo(command, 0o600)
    assert prc("retry", "out").code == 2
    # a name that leads elsewhere is not followed: whoever made the link may change it any time
    command.unlink()
    shutil.copy(office[1] / ".prc" / "command.json", tmp_path / "other.json")
    command.symlink_to(tmp_path / "other.json")
    assert prc("retry", "out").code == 2
    command.unlink()
    shutil.move(tmp_path / "other.json", command)
    if os.getuid() == 0:  # nobody else can give a folder away
        os.chown(command.parent, 4321, -1)
        assert "its folder belongs to user 4321" in prc("retry", "out").err


@pytest.mark.parametrize("name", [".prc", ".prc/journal.sqlite", ".prc/lock"])
def test_our_own_files_are_no_links(prc, tmp_path, name):
    """SQLite made the target of a dangling link.

    a linked lock ended with "the result cannot be printed".
    """
    (tmp_path / "archive").mkdir()
    write_npz(tmp_path / "archive" / "a.npz", street(80))
    link = tmp_path / "out" / name
    link.parent.mkdir(parents=True)
    link.symlink_to(tmp_path / "elsewhere")
    result = prc(tmp_path / "archive", tmp_path / "out")
    assert (result.code, result.err.count("\n")) == (1, 1)
    assert f"{link}: is a symbolic link" in result.err
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.slow
def test_clean_removes_what_the_dead_left_and_forgets_what_is_lost(office, prc, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(office[1], out)
    child = patience.run(
        [sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True
    )
    mine = temporary_name(out / "night" / "a.laz")
    dead = mine.with_name(mine.name.replace(f"-{os.getpid()}-", f"-{int(child.stdout)}-"))
    foreign_part = mine.with_name(".a.laz.00000000-1-01234567.part")
    kept = out / "night" / ".mine.part"
    for path in (mine, dead, foreign_part, kept):
        path.write_bytes(b"1234")
    shared = (
        out / ".prc" / "shared-0123456789abcdef"
    )  # a run on Dask died while it looked at its workers
    shared.touch()
    assert prc("clean", out, "--dry-run").out.count("would remove") == 3
    assert dead.exists()
    moved = tmp_path / "archive"
    moved.mkdir()
    shutil.copy(office[0] / "drive.npz", moved)
    cleaned = json.loads(prc("clean", out, moved, "--json").out)
    assert (sorted(cleaned["removed"]), cleaned["bytes"]) == (sorted(map(str, (shared, dead))), 4)
    assert sorted(cleaned["forgotten"]) == sorted([ODD, "night/bad.laz"])
    assert cleaned["kept"] == [str(foreign_part)]
    assert mine.exists()
    assert kept.exists()
    assert not dead.exists()
    os.utime(foreign_part, (0, 0))
    assert json.loads(prc("clean", out, "--json").out)["removed"] == [str(foreign_part)]
    # an archive that is not mounted
    (moved / "drive.npz").unlink()
    assert prc("clean", out, moved).code == 2
    assert prc("clean", out, tmp_path / "none").code == 1
    assert prc("status", tmp_path / "none").code == 1


# -- what is told, with a run that is made up


def done(name: str, n: int = 1_000_000) -> Done:
    labels = (("missing", n // 4), ("ground", n // 2), ("noise", n // 4))
    return Done(name, InputPrint(10, 1, "ab"), 5, 2, 2.0, 1.0, 10.0, 10, n, n, labels, ("a note",))


def failed(name: str, kind: str = "InputError") -> Failed:
    return Failed(
        name, None, 0.1, Problem(kind, f"/data/archive/{name}", "is cut short", "copy it again")
    )


def made_up(*events: Any, **changes: Any) -> Callable[..., BatchSummary]:
    """A run of these events and their summary."""

    def run_batch(settings: BatchSettings, engine: object, listener: Listener) -> BatchSummary:
        made_up.settings, made_up.engine = settings, engine  # type: ignore[attr-defined]
        ended = {event.name: event for event in events if isinstance(event, Done | Failed)}
        listener(Ready(Plan(()), 2, 1))
        for event in events:
            if isinstance(event, BaseException):
                raise event
            listener(event)
        summary = BatchSummary(
            "r1",
            settings.archive,
            settings.out,
            "s",
            "f",
            10.0,
            max(len(ended), changes.get("n_found", 0)),
            0,
            done=tuple(item for item in ended.values() if isinstance(item, Done)),
            failed=tuple(item for item in ended.values() if isinstance(item, Failed)),
            alarms=tuple(event for event in events if isinstance(event, Alarm)),
            doubts=tuple(event for event in events if isinstance(event, Doubted)),
        )
        return replace(summary, **changes)

    return run_batch


@pytest.fixture
def play(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    return lambda *events, **changes: monkeypatch.setattr(
        run_module, "run_batch", made_up(*events, **changes)
    )


DOUBTED = Doubted("a.laz", "units", "units: odd; check the unit")
ALARM = Alarm("b.laz", "ground 1 %, usually 40 %")


@pytest.mark.parametrize(
    "events, code",
    [
        ([done("a.laz")], 0),
        ([done("a.laz"), failed("b.laz")], 1),
        ([done("a.laz"), ALARM], 4),
        ([done("a.laz"), failed("c.laz"), ALARM], 1),
        ([done("a.laz"), DOUBTED], 4),
        ([BusyError("lock", "another run is at work")], 5),
        ([KeyboardInterrupt()], 130),
        ([SystemExit(143)], 143),
    ],
)
def test_exit_codes(
    prc,
    play,
    events,
    code,
):
    play(*events)
    assert prc("a", "o", "--log-json", "log").code == code
    last = json.loads(Path("log").read_bytes().splitlines()[-1])
    assert (last["event"], last["exit_code"]) == ("run_end", code)


CLASSES = f"""\
{"classes of 1 file":^29}
┏━━━━━━━━━┳━━━━━━━━━┳━━━━━━━┓
┃ class   ┃   shots ┃ share ┃
┡━━━━━━━━━╇━━━━━━━━━╇━━━━━━━┩
│ missing │ 250,000 │       │
│ noise   │ 250,000 │ 33.3% │
│ ground  │ 500,000 │ 66.7% │
└─────────┴─────────┴───────┘
"""
PLAN = "0 files to do, 2 at a time with 1 threads each\n"
DONE = "[-] done a.laz: 1,000,000 shots in 2.0 s, 0.5 M/s\n"
SPEED = "in 10.0 s; 1,000,000 shots, 0.1 million a second\n"


def test_quiet_says_what_is_wrong_and_nothing_else(prc, play):
    play(Noted("took over a lock"), done("a.laz"), failed("b.laz"), ALARM, failed("c.laz"))
    wrong = """\
[-] failed b.laz: is cut short; copy it again
alarm b.laz: ground 1 %, usually 40 %
[-] failed c.laz: is cut short; copy it again
"""
    end = f"1 done, 2 failed, 1 alarm of 3 {SPEED}"
    begin = "note: took over a lock\n" + DONE
    assert prc("a", "o", "--quiet").err == wrong + end
    assert prc("a", "o").err == begin + wrong + CLASSES + end
    assert prc("a", "o", "-v").err == (
        PLAN + begin + "note a.laz: a note\n" + wrong + CLASSES + end
    )


def test_doubts_are_told_quiet_or_not(prc, play):
    play(replace(done("a.laz"), notices=("a note", "doubt units: odd; check the unit")), DOUBTED)
    warning = "warning: a.laz: units: odd; check the unit; or --accept-doubt units\n"
    where = "1 file with warnings (units 1); all are in summary.json and prc batch status\n"
    end = f"1 done, 1 with warnings of 1 {SPEED}"
    assert prc("a", "o", "--quiet").err == warning + end
    assert prc("a", "o").err == DONE + warning + CLASSES + where + end
    result = prc("a", "o", "-v", "--log-json", "log")
    assert result.err == (PLAN + DONE + "note a.laz: a note\n" + warning + CLASSES + where + end)
    events = [json.loads(line) for line in Path("log").read_bytes().splitlines()]
    assert [event["check"] for event in events if event["event"] == "doubt"] == ["units"]
    assert events[-1]["doubted"] == 1


def test_names_are_not_read_as_anything_else(prc, play):
    play(done(":warning:[bold]{x}%s.laz"), failed(":smile:[/].laz"))
    result = prc("a", "o")
    assert "done :warning:[bold]{x}%s.laz: " in result.err
    assert "failed :smile:[/].laz: is cut short" in result.err


def test_the_log_on_stdout_is_json_alone(prc, play):
    play(done(ODD))
    lines = prc("a", "o", "--log-json", "-").out.splitlines()
    assert [json.loads(line)["event"] for line in lines] == [
        "run_start",
        "plan",
        "file_done",
        "run_end",
    ]
    assert json.loads(lines[2])["name"] == ODD
    assert prc("a", "o", "--log-json", "-", "--json").code == 2


def test_options_reach_the_settings(prc, play):
    play()
    Path("ref").mkdir()
    options = (
        "--include x --include y --exclude z --since 7d --limit 3 --shard 2/3 --jobs 4 "
        "--set batch.threads=5 --set batch.retry=2 "
    )
    options += "--set batch.fail_fast=true --overwrite --verify --set batch.stall=9 --to laz "
    options += "--set batch.memory_limit=800 --set batch.drift=false --set batch.match=time "
    options += "--accept-doubt standing "
    options += (
        "--preset prc-2019-forest --set prc.surfaces.gamma=1 -M 99 --reference ref "
        "--fail-under recall.stem=.1"
    )
    assert prc("a", "o", *options.split()).code in (0, 3)
    settings: BatchSettings = made_up.settings  # type: ignore[attr-defined]
    expected = {
        "archive": Path("a"),
        "out": Path("o"),
        "include": ("x", "y"),
        "exclude": ("z",),
        "since": "7d",
        "limit": 3,
        "jobs": 4,
        "threads": 5,
        "retry": 2,
        "fail_fast": True,
        "overwrite": True,
        "verify": True,
        "stall_s": 9.0,
        "memory_limit_mib": 800,
        "to": "laz",
        "drift": False,
        "only_failed": False,
    }
    assert {key: getattr(settings, key) for key in expected} == expected
    assert str(settings.shard) == "2/3"
    assert settings.config.preset == "prc-2019-forest"
    assert {key: settings.config.options[key] for key in ("prc", "input")} == {
        "prc": {"surfaces": {"gamma": 1}},
        "input": {"points_per_line": 99, "accept_doubts": ["standing"]},
    }
    assert settings.reference is not None
    assert (settings.reference.match, settings.reference.gates) == ("time", ("recall.stem=.1",))


def test_a_folder_may_have_the_name_of_a_part(prc, play):
    play()
    assert prc("./status", "./retry").code == 0
    settings: BatchSettings = made_up.settings  # type: ignore[attr-defined]
    assert (settings.archive, settings.out) == (Path("status"), Path("retry"))
    assert settings.drift, "unless a user turns it off"


def test_status_tells_what_runs_from_what_was_interrupted(tmp_path, capsys):
    here = Owner(pid=11)
    gone = Owner(pid=22)
    start = "2026-01-01T00:00:00.5+00:00"
    entry = Entry("a.las", "done", "", "2.0.0", "r", 1, start, start, str(gone), None)
    running = replace(entry, name="b.las", state="running", owner=str(here))
    entries = [entry, running, replace(running, name="c.las", owner=str(gone), attempts=3)]
    ended = journal.Run("r", "", "1.2", str(gone), start, start, 4, (("done", 7), ("failed", 0)))
    runs = [replace(ended, owner=str(owner), exit_code=None) for owner in (here, gone)]
    holders = [Holder(tmp_path, here, alive=True), Holder(tmp_path, gone, alive=False)]
    print_status(tmp_path, entries, [ended, *runs], holders)
    assert (
        capsys.readouterr().out
        == f"""\
{tmp_path}: 3 files: 1 done, 1 running, 1 interrupted
running now: {here}
{"last runs":^64}
┏━━━━━━━━━━━━━━━━━━━━━┳━━━━━━━┳━━━━━━━━━┳━━━━━━━━━━━━━┳━━━━━━━━┓
┃ start (UTC)         ┃ shard ┃ version ┃ exit code   ┃ counts ┃
┡━━━━━━━━━━━━━━━━━━━━━╇━━━━━━━╇━━━━━━━━━╇━━━━━━━━━━━━━╇━━━━━━━━┩
│ 2026-01-01 00:00:00 │ -     │ 1.2     │ 4           │ 7 done │
│ 2026-01-01 00:00:00 │ -     │ 1.2     │ running     │ 7 done │
│ 2026-01-01 00:00:00 │ -     │ 1.2     │ interrupted │ 7 done │
└─────────────────────┴───────┴─────────┴─────────────┴────────┘
running b.las (since 2026-01-01 00:00:00)
interrupted c.las (since 2026-01-01 00:00:00, 3 attempts)
"""
    )
    print_status(tmp_path, entries, [], holders[1:])
    assert (
        capsys.readouterr().out
        == f"""\
{tmp_path}: 3 files: 1 done, 2 interrupted
no run is active
interrupted b.las (since 2026-01-01 00:00:00)
interrupted c.las (since 2026-01-01 00:00:00, 3 attempts)
"""
    )
