"""Discovery of the files in an archive, with odd names and contents."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import pytest

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.jobs.batch import discovery
from prc_cli.jobs.batch.discovery import Patterns, discover
from prc_cli.jobs.batch.types import OWN_FOLDER, BatchSettings
from tests.patience import HANGS_S


def put(path: Path, content: bytes = b"x") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def names(archive: Path, **options: object) -> list[str]:
    settings = BatchSettings(archive, options.pop("out", archive.parent / "out"), **options)  # type: ignore[arg-type]
    return [found.name for found in discover(settings).files]


def left_out(archive: Path, **options: object) -> dict[str, str]:
    settings = BatchSettings(archive, options.pop("out", archive.parent / "out"), **options)  # type: ignore[arg-type]
    return {found.name: found.reason for found in discover(settings).left_out}


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    folder = tmp_path / "archive"
    for name in ("b.laz", "a/2.las", "a/10.LAZ", "a/deep/er/x.csv.gz", "z.npz", "notes.md", "a/.hidden.laz"):
        put(folder / name)
    put(folder / ".git" / "c.laz")
    return folder


@pytest.mark.parametrize(
    ("include", "exclude", "expected"),
    [
        (["*.laz"], [], ["b.laz"]),
        (["*.LAZ", "*.las"], [], ["a/10.LAZ", "a/2.las"]),
        (["a/*"], [], ["a/10.LAZ", "a/2.las"]),
        (["a/**"], [], ["a/10.LAZ", "a/2.las", "a/deep/er/x.csv.gz"]),
        (["**/x*"], [], ["a/deep/er/x.csv.gz"]),
        (["**/b.laz"], [], ["b.laz"]),
        (["?.[ln]*"], [], ["a/2.las", "b.laz", "z.npz"]),
        (["[a-b].laz"], [], ["b.laz"]),
        (["[c-w].*", "[b-b].*"], [], ["b.laz"]),
        (["[a-]*.laz", "[z-a].*"], [], []),
        (["[b-].laz"], [], ["b.laz"]),
        ([], ["a"], ["b.laz", "z.npz"]),
        ([], ["deep/"], ["a/10.LAZ", "a/2.las", "b.laz", "z.npz"]),
        ([], ["a/[!0-9]*/**"], ["a/10.LAZ", "a/2.las", "b.laz", "z.npz"]),
        (["*.laz"], ["b*"], []),
    ],
)
def test_patterns_choose(archive: Path, include: list[str], exclude: list[str], expected: list[str]) -> None:
    assert names(archive, include=tuple(include), exclude=tuple(exclude)) == expected


def test_outputs_are_no_inputs(archive: Path) -> None:
    out = archive / "out"
    put(out / "b.laz")
    put(out / OWN_FOLDER / "journal.sqlite")
    put(archive / "old" / OWN_FOLDER / "journal.sqlite")
    put(archive / "old" / "b.laz")
    put(archive / "z.npz.labels.npy")
    assert names(archive, out=out) == ["a/10.LAZ", "a/2.las", "a/deep/er/x.csv.gz", "b.laz", "z.npz"]
    found = left_out(archive, out=out)
    assert found == {
        "old/": "the output folder of another batch run",
        "z.npz.labels.npy": "labels that this program wrote",
    }


@pytest.mark.parametrize("out", [".", "..", "../.", "../archive"])
def test_an_archive_in_its_outputs_is_refused(archive: Path, out: str) -> None:
    with pytest.raises(ConfigError, match="never modified"):
        names(archive, out=archive / out)
    with pytest.raises(ConfigError, match="never modified"):
        discovery.check(BatchSettings(archive, archive / out))


@pytest.mark.skipif(os.name != "posix", reason="links and pipes")
def test_links_and_pipes(archive: Path) -> None:
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
    found = names(archive)
    assert [name for name in found if "laz" in name] == [
        "b.laz", "folder.laz/in.laz", "hidden_store.laz", "second_name.laz",
    ]  # fmt: skip
    assert left_out(archive) == {
        "a/cycle": "a symbolic link to a folder of the archive, whose files have their own names",
        "folder_out": "a symbolic link that leads out of the archive",
        "itself.laz": "a symbolic link to nothing",
        "nothing.laz": "a symbolic link to nothing",
        "out_of_it.laz": "a symbolic link that leads out of the archive",
        "pipe.laz": "not a regular file",
    }


@pytest.mark.skipif(os.name != "posix", reason="names of bytes")
def test_odd_names(tmp_path: Path) -> None:
    odd = [b"a\nb.laz", b"\x1b[31m.laz", b"latin\xe9.laz", b"{stem}.laz", b" .laz", "\u2028.laz".encode()]
    for name in odd:
        put(Path(os.fsdecode(os.path.join(os.fsencode(tmp_path / "in"), name))))  # noqa: PTH118
    found = discover(BatchSettings(tmp_path / "in", tmp_path / "out")).files
    assert [os.fsencode(item.name) for item in found] == sorted(odd)
    assert all(item.path.is_file() for item in found)
    assert names(tmp_path / "in", include=("a?b.laz",)) == ["a\nb.laz"]
    assert names(tmp_path / "in", include=("latin?.laz",)) == ["latin\udce9.laz"]


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root reads everything")
def test_a_folder_without_permission_is_told(archive: Path) -> None:
    (archive / "a").chmod(0)
    try:
        assert names(archive) == ["b.laz", "z.npz"]
        assert "Permission denied" in left_out(archive)["a/"]
    finally:
        (archive / "a").chmod(0o755)


def test_since(archive: Path) -> None:
    now = time.time()
    for name, age in (("b.laz", 10), ("a/2.las", 90_000), ("z.npz", 900_000)):
        os.utime(archive / name, (now - age, now - age))
    old = ("a/10*", "deep")
    assert names(archive, since="1h", exclude=old) == ["b.laz"]
    assert names(archive, since="2d", exclude=old) == ["a/2.las", "b.laz"]
    assert names(archive, since=str(archive / "a" / "2.las"), exclude=old) == ["a/2.las", "b.laz"]
    day = datetime.fromtimestamp(now - 100_000).astimezone()
    assert names(archive, since=day.isoformat(), exclude=old) == ["a/2.las", "b.laz"]
    found = discover(BatchSettings(archive, archive.parent / "out", since="1h", exclude=old))
    assert found.n_not_selected == 3


def test_a_file_system_that_does_not_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = threading.Event()

    def hang(settings: BatchSettings, exclude: Patterns) -> Iterator[None]:
        answers.wait(HANGS_S)
        yield None

    monkeypatch.setattr(discovery, "_walk", hang)
    with pytest.raises(InputError, match="has not answered for 0.1 s"):
        discover(BatchSettings(tmp_path, tmp_path / "out"), patience_s=0.1)
    answers.set()
