"""Files of an archive, with odd names, and the plan.

Action, reason and configuration of each, and the effort.
"""

import os
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pytest

from prc_cli import __version__
from prc_cli.core.errors import InputError
from prc_cli.formats.writing.record import fingerprint
from prc_cli.jobs.batch import discovery
from prc_cli.jobs.batch.configs import BatchConfig
from prc_cli.jobs.batch.discovery import Patterns, discover
from prc_cli.jobs.batch.journal import Entry, State
from prc_cli.jobs.batch.outcomes import Done, Failed, InputPrint, Problem
from prc_cli.jobs.batch.plan import Estimate, Plan, estimate, make_plan
from prc_cli.jobs.batch.types import BatchSettings, ConfigLayers
from tests.patience import HANGS_S


@pytest.fixture
def settings(tmp_path):
    for name in ("a.npz", "b.npz"):
        (tmp_path / "in").mkdir(exist_ok=True)
        (tmp_path / "in" / name).write_bytes(b"content of " + name.encode())
    (tmp_path / "out").mkdir()
    return BatchSettings(tmp_path / "in", tmp_path / "out")


def output(settings: BatchSettings, name: str) -> Path:
    return settings.out / f"{name}.labels.npy"


def entry(settings: BatchSettings, name: str, state: State = "done", **changes: object) -> Entry:
    """The journal's entry of a file that is done, its output written."""
    source = settings.archive / name
    status = source.stat()
    written = output(settings, name)
    if state == "done":
        written.write_bytes(b"labels")
    read = InputPrint(status.st_size, status.st_mtime_ns, fingerprint(source).sha256)
    written_status = written.stat() if written.exists() else None
    done = Done(
        name,
        read,
        6,
        written_status.st_mtime_ns if written_status else 0,
        2.0,
        1.5,
        100.0,
        9,
        99,
        99,
        (("ground", 99),),
    )
    outcome = (
        done if state == "done" else Failed(name, read, 1.0, Problem("killed", name, "by somebody"))
    )
    config = BatchConfig(settings.config).base_sha256
    made = Entry(
        name, state, config, __version__, "run", 1, "2026-01-01", "2026-01-01", "me", outcome
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def plan_of(settings: BatchSettings, *known: Entry) -> Plan:
    files = discover(settings).files
    return make_plan(
        settings, files, BatchConfig(settings.config), {item.name: item for item in known}
    )


def reasons(plan: Plan) -> dict[str, str]:
    return {item.task.name: item.reason for item in plan.todo}


# -- decisions


def test_an_output_that_was_refused_before_is_no_more_ours(settings):
    output(settings, "a.npz").write_bytes(b"by hand")
    refused = entry(settings, "a.npz", "failed", owns_output=False)
    (failed,) = plan_of(settings, refused).refused
    assert "no journal knows it" in str(failed.problem)


# -- configuration


def config_file(tmp_path: Path, text: str) -> ConfigLayers:
    path = tmp_path / "archive.toml"
    path.write_text(text)
    return ConfigLayers(path)


OVERRIDES = """
preset = "prc-2019-urban"
[prc.support]
zeta_p = 0.5

[[override]]
match = "night/**"
[override.prc.support]
zeta_p = 0.25

[[override]]
match = ["*.laz", "night/oak.npz"]
preset = "prc-2019-forest"
"""


def test_later_overrides_win_and_presets_lie_below_the_file(tmp_path):
    config = BatchConfig(config_file(tmp_path, OVERRIDES))
    zeta = {}
    for name in ("a.npz", "night/a.npz", "a.laz", "night/oak.npz"):
        loaded, _ = config.of(name, tmp_path / name)
        zeta[name] = (loaded.config.prc.environment, loaded.config.prc.support.zeta_p)
    assert zeta == {
        "a.npz": ("urban", 0.5),
        "night/a.npz": ("urban", 0.25),
        "a.laz": ("forest", 0.5),
        "night/oak.npz": ("forest", 0.25),
    }
    loaded, _ = config.of("night/a.npz", tmp_path / "a.npz")
    assert loaded.sources["prc.support.zeta_p"].endswith("archive.toml: override 1")
    assert loaded.files == (tmp_path / "archive.toml",)


def test_every_file_has_its_own_trajectory(tmp_path):
    layers = config_file(tmp_path, 'input.range = "trajectory:{folder}/{stem}.csv"\n')
    config = BatchConfig(layers)
    drive = tmp_path / "in" / "night" / "a.1.laz"
    drive.parent.mkdir(parents=True)
    with pytest.raises(InputError, match=r"a\.1\.csv: the trajectory cannot be read"):
        config.of("night/a.1.laz", drive)
    trajectory = drive.with_name("a.1.csv")
    trajectory.write_text("time,x,y,z\n")
    loaded, first = config.of("night/a.1.laz", drive)
    assert loaded.trajectory == trajectory
    trajectory.write_text("time,x,y,z\n0,0,0,0\n")
    assert BatchConfig(layers).of("night/a.1.laz", drive)[1] != first


def test_effort_is_that_of_earlier_files_of_the_format(settings):
    todo = plan_of(settings).todo
    nothing = Estimate(None, None, ("npz: nothing known",), 2)
    done = entry(settings, "a.npz")
    assert estimate(todo, {"a.laz": done}, 2) == nothing
    source = "npz: from 1 earlier file of this archive"
    # both files have the size of the earlier one, which took two seconds
    assert estimate(todo, {"z.npz": done}, 1) == Estimate(6.0, 100.0, (source,), 0)
    assert estimate(todo, {"z.npz": done}, 3) == Estimate(4.0, 200.0, (source,), 0)
    known = {"y.npz": replace(done, config_sha256="of another"), "z.npz": done}
    assert estimate(todo, known, 1).sources == (source,)
    del known["z.npz"]
    assert estimate(todo, known, 1).sources == (f"{source}, of another configuration",)


def put(path: Path, content: bytes = b"x") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def names(archive: Path, **options: object) -> list[str]:
    settings = BatchSettings(archive, options.pop("out", archive.parent / "out"), **options)  # type: ignore[arg-type]
    return [file.name for file in discover(settings).files]


def left_out(archive: Path, **options: object) -> dict[str, str]:
    settings = BatchSettings(archive, options.pop("out", archive.parent / "out"), **options)  # type: ignore[arg-type]
    return {file.name: file.reason for file in discover(settings).left_out}


@pytest.fixture
def archive(tmp_path):
    folder = tmp_path / "archive"
    for name in (
        "b.laz",
        "a/2.las",
        "a/10.LAZ",
        "a/deep/er/x.csv.gz",
        "z.npz",
        "notes.md",
        "a/.hidden.laz",
    ):
        put(folder / name)
    put(folder / ".git" / "c.laz")
    return folder


@pytest.mark.skipif(os.name != "posix", reason="links and pipes")
def test_links_and_pipes(archive):
    outside = put(archive.parent / "outside" / "secret.laz")
    (archive / "out_of_it.laz").symlink_to(outside)
    (archive / "folder_out").symlink_to(outside.parent)
    (archive / "a" / "cycle").symlink_to(archive)
    (archive / "nothing.laz").symlink_to(archive / "absent")
    (archive / "itself.laz").symlink_to(archive / "itself.laz")
    (archive / "second_name.laz").symlink_to(archive / "b.laz")
    (archive / "hidden_store.laz").symlink_to(archive / ".git" / "c.laz")
    os.mkfifo(archive / "pipe.laz")
    (archive / "folder.laz").mkdir()
    put(archive / "folder.laz" / "in.laz")
    inputs = names(archive)
    assert [name for name in inputs if "laz" in name] == [
        "b.laz",
        "folder.laz/in.laz",
        "hidden_store.laz",
        "second_name.laz",
    ]
    assert left_out(archive) == {
        "a/cycle": "a symbolic link to a folder of the archive, whose files have their own names",
        "folder_out": "a symbolic link that leads out of the archive",
        "itself.laz": "a symbolic link to nothing",
        "nothing.laz": "a symbolic link to nothing",
        "out_of_it.laz": "a symbolic link that leads out of the archive",
        "pipe.laz": "not a regular file",
    }


@pytest.mark.skipif(os.name != "posix", reason="names of bytes")
def test_odd_names(tmp_path):
    odd = [
        b"a\nb.laz",
        b"\x1b[31m.laz",
        b"latin\xe9.laz",
        b"{stem}.laz",
        b" .laz",
        "\u2028.laz".encode(),
    ]
    for name in odd:
        put(Path(os.fsdecode(os.path.join(os.fsencode(tmp_path / "in"), name))))  # noqa: PTH118
    files = discover(BatchSettings(tmp_path / "in", tmp_path / "out")).files
    assert [os.fsencode(item.name) for item in files] == sorted(odd)
    assert all(item.path.is_file() for item in files)
    assert names(tmp_path / "in", include=("a?b.laz",)) == ["a\nb.laz"]
    assert names(tmp_path / "in", include=("latin?.laz",)) == ["latin\udce9.laz"]


def test_since(archive):
    now = time.time()
    for name, age in (("b.laz", 10), ("a/2.las", 90_000), ("z.npz", 900_000)):
        os.utime(archive / name, (now - age, now - age))
    old = ("a/10*", "deep")
    assert names(archive, since="1h", exclude=old) == ["b.laz"]
    assert names(archive, since="2d", exclude=old) == ["a/2.las", "b.laz"]
    assert names(archive, since=str(archive / "a" / "2.las"), exclude=old) == ["a/2.las", "b.laz"]
    day = datetime.fromtimestamp(now - 100_000).astimezone()
    assert names(archive, since=day.isoformat(), exclude=old) == ["a/2.las", "b.laz"]
    listing = discover(BatchSettings(archive, archive.parent / "out", since="1h", exclude=old))
    assert listing.n_not_selected == 3


def test_a_file_system_that_does_not_answer(tmp_path, monkeypatch):
    answers = threading.Event()

    def hang(settings: BatchSettings, exclude: Patterns) -> Iterator[None]:
        answers.wait(HANGS_S)
        yield None

    monkeypatch.setattr(discovery, "_walk", hang)
    with pytest.raises(InputError, match="has not answered for 0.1 s"):
        discover(BatchSettings(tmp_path, tmp_path / "out"), patience_s=0.1)
    answers.set()


def test_what_a_killed_run_left_is_done_again_over_its_output(settings):
    known = entry(settings, "a.npz", "running")
    output(settings, "a.npz").write_bytes(b"renamed just before the kill")
    plan = plan_of(settings, known)
    assert reasons(plan)["a.npz"] == "unfinished"
    assert plan.todo[0].task.overwrite
