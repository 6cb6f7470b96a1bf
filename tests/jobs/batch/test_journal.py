"""The journal keeps committed rows, or reports a clear error."""

import contextlib
import os
import random
import sqlite3
import sys
import tempfile
from pathlib import Path

import pytest

from prc_cli import __version__
from prc_cli.config import LoadedConfig, RunConfig
from prc_cli.core.errors import BusyError, OutputError, PrcError
from prc_cli.jobs.batch import journal as subject
from prc_cli.jobs.batch.journal import Entry, Journal, read_entries, read_runs
from prc_cli.jobs.batch.outcomes import Done, Failed, InputPrint, Problem
from prc_cli.jobs.batch.types import Shard, Task
from tests import patience

ODD_NAMES = [
    "plain.laz",
    "day 1/with spaces.bin",
    "new\nline.las",
    "quote'and\"double;DROP TABLE files;--.csv",
    "odd\udcff\udc80bytes.npz",
    "nul-is-never-a-name but \x01 is.las",
    "\x1b[31mred.laz",
    "Straße/車.laz",
    "Å.laz",
    "%s?:name*.laz",
    "x" * 4000 + ".laz",
]


@pytest.fixture
def folder(tmp_path):
    return tmp_path / ".prc"


@pytest.fixture
def open_to_all():
    """Folder that another user may enter; those of pytest are private."""
    with tempfile.TemporaryDirectory(prefix="prc-journal-") as name:
        Path(name).chmod(0o755)
        yield Path(name)


def task(name: str, config: str = "c" * 64) -> Task:
    return Task(name, Path("archive") / name, Path("out") / name, LoadedConfig(RunConfig()), config)


def done(name: str, n: int = 10) -> Done:
    return Done(
        name,
        InputPrint(n, 1_700_000_000_123_456_789, "ab" * 32),
        7 * n,
        1_800_000_000_987_654_321,
        1.25,
        1.5,
        None,
        n,
        3 * n,
        2 * n,
        (("GROUND", n), ("NOISE", 0), ("OBJECT", n)),
        ("a notice", "with a \udcff byte"),
    )


def failed(name: str, kind: str = "InputError") -> Failed:
    return Failed(
        name, None, 0.5, Problem(kind, name, "found no header, expected one", "check the copy")
    )


def spelled(entry: Entry | None) -> Problem:
    assert entry is not None
    assert isinstance(entry.outcome, Failed)
    return entry.outcome.problem


@pytest.mark.parametrize("name", ODD_NAMES)
def test_any_name_comes_back(folder, name):
    with Journal(folder) as journal:
        journal.begin_run("me")
        journal.start(task(name), "worker 1")
        running = journal.entry(name)
        assert running is not None
        assert (running.name, running.state, running.outcome, running.finished) == (
            name,
            "running",
            None,
            None,
        )
        journal.finish(failed(name))
        assert spelled(journal.entry(name)).problem == "found no header, expected one"
        journal.start(task(name), "worker 1")
        journal.finish(done(name))
    assert [entry.name for entry in read_entries(folder)] == [name]
    assert read_entries(folder)[0].outcome == done(name)


def test_what_is_known_of_a_file(folder):
    with Journal(folder) as journal:
        assert journal.entry("a.laz") is None
        run = journal.begin_run("me on this machine")
        journal.start(task("a.laz", "first"), "worker 1")
        journal.finish(done("a.laz"))
        entry = journal.entry("a.laz")
        assert entry == Entry(
            "a.laz",
            "done",
            "first",
            __version__,
            run,
            1,
            entry.started,
            entry.finished,
            "worker 1",
            done("a.laz"),
            source=str(Path("archive/a.laz").resolve()),
        )
        assert entry.finished is not None
        assert entry.started <= entry.finished
        journal.start(task("a.laz", "second"), "worker 2")
        journal.finish(failed("a.laz"))
        entry = journal.entry("a.laz")
        assert (entry.state, entry.attempts, entry.outcome) == ("failed", 1, failed("a.laz"))
        for attempts in (2, 3):
            journal.start(task("a.laz"), "worker 2")
            assert journal.entry("a.laz").attempts == attempts
        journal.finish(done("a.laz"))
        journal.start(task("a.laz"), "worker 2")
        assert journal.entry("a.laz").attempts == 1


def test_journals_of_other_divisions_are_known_and_the_newest_entry_counts(folder):
    with Journal(folder) as journal:
        journal.begin_run("whole")
        for name in ("a", "b", "c"):
            journal.start(task(name, "old"), "worker")
            journal.finish(done(name))
    with Journal(folder, Shard(1, 2)) as journal:
        assert [entry.name for entry in journal.entries()] == ["a", "b", "c"]
        journal.begin_run("shard")
        journal.start(task("b", "new"), "worker")
        journal.finish(failed("b"))
        assert journal.entry("b").config_sha256 == "new"
        assert journal.entry("a").config_sha256 == "old"
        assert [entry.state for entry in journal.entries()] == ["done", "failed", "done"]
        assert journal.entry("b").owns_output
    with Journal(folder) as journal:
        assert journal.entry("b").config_sha256 == "new"
        assert len(journal.entries()) == 3
        assert journal.forget(["b", "c", "nothing"]) == 2
        assert [entry.name for entry in journal.entries()] == ["a"]
    assert [entry.name for entry in read_entries(folder)] == ["a"]


def damage(path: Path, how: str) -> None:
    content = path.read_bytes()
    if how == "garbage":
        path.write_bytes(random.Random(3).randbytes(20_000))
    elif how == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif how == "text":
        path.write_text(
            "this is not a database, it is a text of some length, longer than a header of "
            "SQLite, certainly"
        )
    elif how == "holes":
        path.write_bytes(content[:4096] + bytes(len(content) - 4096))
    else:
        with sqlite3.connect(path) as database:
            database.execute("DROP TABLE files")
        database.close()


@pytest.mark.slow
@pytest.mark.parametrize("how", ["garbage", "cut", "text", "holes", "no table"])
def test_a_damaged_journal_is_one_clear_error(folder, how):
    with Journal(folder) as journal:
        journal.begin_run("me")
        for number in range(200):
            journal.start(task(f"{number}"), "worker")
    path = folder / "journal.sqlite"
    damage(path, how)
    content = path.read_bytes()
    for action in (lambda: Journal(folder).__enter__().entries(), lambda: read_entries(folder)):
        with pytest.raises(OutputError, match="is no whole journal") as caught:
            action()
        assert f"mv {path} {path}.damaged" in caught.value.hint
        assert "--overwrite" in caught.value.hint
        assert "\n" not in str(caught.value)
    assert path.read_bytes() == content


def test_a_newer_journal_is_refused_and_left_alone(folder):
    with Journal(folder):
        pass
    database = sqlite3.connect(folder / "journal.sqlite")
    database.execute("PRAGMA user_version = 7")
    database.close()
    content = (folder / "journal.sqlite").read_bytes()
    for action in (Journal(folder).__enter__, lambda: read_entries(folder)):
        with pytest.raises(
            OutputError, match="newer prc-cli .tables of version 7, this program knows 2.*upgrade"
        ):
            action()
    assert (folder / "journal.sqlite").read_bytes() == content


def test_a_journal_that_somebody_holds_is_busy(folder, monkeypatch):
    monkeypatch.setattr(subject, "WAIT_S", 0.05)
    with Journal(folder) as journal:
        database = sqlite3.connect((folder / "journal.sqlite"), isolation_level=None)
        database.execute("BEGIN IMMEDIATE")
        with pytest.raises(BusyError, match="held by another program"):
            journal.begin_run("me")
        database.execute("ROLLBACK")
        database.close()
        journal.begin_run("me")


AS_NOBODY = """
import os, sys
from pathlib import Path
from prc_cli.jobs.batch.journal import Entry, Journal, read_entries, read_runs
from prc_cli.core.errors import PrcError
folder = Path(sys.argv[1])
if os.getuid() == 0:
    os.setgroups([]); os.setgid(65534); os.setuid(65534)
print(len(read_entries(folder)))
try:
    with Journal(folder) as journal:
        journal.begin_run("me")
except PrcError as error:
    print(type(error).__name__, error)
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs POSIX permissions")
@pytest.mark.parametrize("live", [False, True])
def test_a_read_only_folder_can_be_read_and_is_refused_for_writing(open_to_all, live):
    """As another user, beside a live writer and after it."""
    folder = open_to_all / ".prc"
    with Journal(folder) as journal:
        journal.begin_run("me")
        journal.start(task("a"), "worker")
        if not live:
            journal.__exit__(None, None, None)
        folder.chmod(0o555)
        try:
            result = patience.run(
                [sys.executable, "-c", AS_NOBODY, str(folder)], capture_output=True, text=True
            )
        finally:
            folder.chmod(0o755)
    assert result.stdout.startswith("1\nOutputError"), (result.stdout, result.stderr)
    assert "permissions" in result.stdout


@pytest.mark.parametrize(
    "change",
    [
        "state = 'well'",
        "attempts = 'many'",
        "outcome = '{'",
        "outcome = 5",
        "outcome = x'ff'",
        "outcome = '[]'",
        *(
            f"outcome = json_set(outcome, '$.{key}', {value})"
            for key, value in (
                ("labels", "json('[[1]]')"),
                ("labels", 5),
                ("notices", 7),
                ("seconds", "'soon'"),
                ("n_lines", "'x'"),
                ("input.mtime_ns", "NULL"),
                ("odd", 1),
            )
        ),
        f"outcome = '{'[' * 100_000}'",
    ],
)
def test_a_row_that_makes_no_sense_is_damage(folder, change):
    with Journal(folder) as journal:
        journal.begin_run("me")
        journal.start(task("a"), "worker")
        journal.finish(done("a"))
        with contextlib.closing(
            sqlite3.connect((folder / "journal.sqlite"), isolation_level=None)
        ) as database:
            database.execute(f"UPDATE files SET {change}")
        with pytest.raises(OutputError, match="a row makes no sense"):
            journal.entries()
        with pytest.raises(OutputError, match="a row makes no sense"):
            journal.entry("a")
    with pytest.raises(
        OutputError, match=r"a row makes no sense: .*; move it away \(mv .* --overwrite"
    ):
        read_entries(folder)


@pytest.mark.parametrize("change", ["exit_code = 'well'", "finished = x'ff'", "totals = '['"])
def test_a_run_that_makes_no_sense_is_damage(folder, change):
    with Journal(folder) as journal:
        journal.begin_run("me")
        journal.end_run(0, {"done": 10})
    with contextlib.closing(sqlite3.connect(folder / "journal.sqlite")) as database, database:
        database.execute(f"UPDATE runs SET {change}")
    with pytest.raises(OutputError, match="a row makes no sense"):
        read_runs(folder)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
def test_a_pipe_in_its_place_stops_nobody(folder):
    folder.mkdir(parents=True)
    os.mkfifo(folder / "journal.sqlite")
    with pytest.raises(PrcError):
        read_entries(folder)
    with pytest.raises(PrcError), Journal(folder):
        pass


def test_what_is_committed_outlives_the_power(folder):
    with Journal(folder) as journal:
        (synchronous,) = journal._database.execute("PRAGMA synchronous").fetchone()
        assert synchronous == 3  # EXTRA


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_random_damage_is_one_clear_error_or_none(folder, tmp_path, seed):
    """7 of 100 gave a traceback, by rows that SQLite reads and that make no sense."""
    with Journal(folder) as journal:
        journal.begin_run("me")
        for number in range(30):
            journal.start(task(f"{number}.laz"), "worker")
            journal.finish(failed(f"{number}.laz") if number % 3 else done(f"{number}.laz"))
        journal.end_run(0, {"done": 10})
    sound = (folder / "journal.sqlite").read_bytes()
    rng = random.Random(seed)
    for _ in range(12):
        data = bytearray(sound)
        for _ in range(rng.choice((1, 4, 30))):
            data[rng.randrange(100, len(data))] = rng.randrange(256)
        place = tmp_path / f"{rng.random()}"
        place.mkdir()
        (place / "journal.sqlite").write_bytes(data)
        with contextlib.suppress(PrcError):
            read_entries(place)
        with contextlib.suppress(PrcError):
            read_runs(place)
        with contextlib.suppress(PrcError), Journal(place) as journal:
            journal.entries()
            journal.entry("3.laz")
            journal.begin_run("me")
