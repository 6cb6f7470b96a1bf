"""The system calls of whole commands.

a file is on the disk before it gets its name, the name before the end.

``strace`` watches all processes and threads of a command. Skipped where it is not installed or may
not trace."""

import os
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import patience
from tests.fuzz.seeds import seed

pytestmark = pytest.mark.slow

CALLS = (
    "write,pwrite64,writev,pwritev,sendfile,copy_file_range,"
    "fsync,fdatasync,link,linkat,rename,renameat,renameat2"
)
_CALL = re.compile(r"(?P<call>[a-z0-9_]+)\((?P<words>.*)\) = (?P<result>\d+)")
_OPEN = re.compile(r"\d+<(?P<path>/[^>]*)>")
_QUOTED = re.compile(r'"((?:[^"\\]|\\.)*)"')


def traced(folder: Path, *words: str | Path) -> list[tuple[str, list[str]]]:
    """Run ``prc`` and return every successful call with the files that it names, in the order they
    ended."""
    strace = shutil.which("strace")
    if strace is None:
        pytest.skip("strace is not installed")
    trace = folder / "trace"
    command = [strace, "-f", "-y", "-s", "4096", "-o", str(trace), "-e", f"trace={CALLS}"]
    ended = patience.run(
        [*command, sys.executable, "-m", "prc_cli", *map(str, words)],
        capture_output=True,
        text=True,
    )
    if "PTRACE" in ended.stderr or "ptrace" in ended.stderr:
        pytest.skip("this user may not trace processes")
    assert ended.returncode == 0, ended.stderr
    return list(calls(trace.read_text(errors="replace").splitlines()))


def calls(lines: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Put calls together that others interrupted; yield those that succeeded."""
    begun: dict[str, str] = {}
    for line in lines:
        process, _, text = line.partition(" ")
        text = text.strip()
        if text.endswith("<unfinished ...>"):
            begun[process] = text.removesuffix("<unfinished ...>")
            continue
        if text.startswith("<..."):
            text = begun.pop(process, "") + text.partition("resumed>")[2]
        match = _CALL.match(text)
        if match is None:
            continue
        call = match["call"]
        words = match["words"]
        names = (_QUOTED if call.startswith(("link", "rename")) else _OPEN).findall(words)
        # bytes that are not ASCII are octal
        yield (
            call,
            [
                os.fsdecode(name.encode().decode("unicode_escape").encode("latin-1"))
                for name in names
            ],
        )


def check_order(traced_calls: list[tuple[str, list[str]]], out: Path) -> set[str]:
    """Check every name that is given in a folder; return the names."""
    named = set()
    for number, (call, names) in enumerate(traced_calls):
        if not call.startswith(("link", "rename")) or not names[-1].startswith(f"{out}{os.sep}"):
            continue
        source = names[0]
        target = names[-1]
        before = [(name, of[0]) for name, of in traced_calls[:number] if of and of[0] == source]
        assert before, f"{target}: nothing was written"
        assert before[-1][0] in ("fsync", "fdatasync"), (
            f"{target}: {before[-1][0]} after the last flush"
        )
        folder = str(Path(target).parent)
        after = [
            name
            for name, of in traced_calls[number + 1 :]
            if name == "fsync" and of[:1] == [folder]
        ]
        assert after, f"{target}: its folder was not flushed"
        written = [
            name
            for name, of in traced_calls[number + 1 :]
            if of[:1] in ([source], [target]) and "write" in name
        ]
        assert not written, f"{target}: written to after it had its name"
        named.add(Path(target).relative_to(out).as_posix())
    return named


@pytest.mark.parametrize(
    "words, outputs",
    [
        (
            ("classify", "{seeds}/pf6.laz", "{out}/o.laz", "--preset", "prc-2019-urban", "-q"),
            ("o.laz", "o.laz.prc.json"),
        ),
        *(
            pytest.param((*words, "-q"), outputs, marks=pytest.mark.long)
            for words, outputs in (
                (
                    ("classify", "{seeds}/a.npz", "{out}/o.npy", "--preset", "prc-2019-urban"),
                    ("o.npy", "o.npy.prc.json"),
                ),
                (
                    ("classify", "{seeds}/a.csv", "{out}/o.parquet", "--preset", "prc-2019-urban"),
                    ("o.parquet",),
                ),
                (("convert", "{seeds}/a.csv", "{out}/o.las", "--trust-order"), ("o.las",)),
                (("convert", "{seeds}/a.csv", "{out}/o.npz", "--trust-order"), ("o.npz",)),
                (("transfer", "{seeds}/pf6.las", "{seeds}/pf6.laz", "{out}/o.laz"), ("o.laz",)),
                (("simulate", "street", "{out}/o.npz", "--lines", "3"), ("o.npz",)),
            )
        ),
    ],
)
def test_a_file_is_on_the_disk_before_it_has_its_name(tmp_path, words, outputs):
    seeds = tmp_path / "seeds"
    out = tmp_path / "out"
    for folder in (seeds, out):
        folder.mkdir()
    for name in ("pf6.laz", "pf6.las", "a.npz", "a.csv"):
        (seeds / name).write_bytes(seed(name))
    traced_calls = traced(tmp_path, *(word.format(seeds=seeds, out=out) for word in words))
    named = check_order(traced_calls, out)
    assert set(outputs) <= named, named
    assert {path.name for path in out.iterdir()} <= named


@pytest.mark.long
def test_so_is_every_file_of_a_batch(few, tmp_path):
    """Outputs of the workers, and what the run itself keeps.

    SQLite flushes its journal by itself.
    """
    out = tmp_path / "out"
    traced_calls = traced(
        tmp_path, "batch", few.folder, out, "--config", few.config, "--jobs", "2", "-q"
    )
    named = check_order(traced_calls, out)
    assert set(few.whole) <= named
    assert "summary.json" in named


def test_what_is_out_of_order_is_seen(tmp_path):
    part = "/out/.a.part"
    name = "/out/a"
    out = Path("/out")
    write = ("write", [part])
    flush = ("fsync", [part])
    link = ("link", [part, name])
    sync = ("fsync", ["/out"])
    assert check_order([write, flush, link, sync], out) == {"a"}
    for wrong in (
        [write, link, sync],
        [write, flush, write, link, sync],
        [write, flush, link],
        [write, link, flush, sync],
    ):
        with pytest.raises(AssertionError, match="/out/a"):
            check_order(wrong, out)
