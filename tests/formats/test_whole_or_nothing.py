"""Outputs appear complete or not at all: early checks, aborts, full disks."""

import contextlib
import errno
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import OutputError, OutputExistsError
from prc_cli.formats.las.laz import Target
from prc_cli.formats.outputs import prepare_label_outputs
from prc_cli.formats.registry import is_cloud
from prc_cli.formats.writing.columns import OutputConfig
from tests import patience
from tests.formats.common import random_labels, record_blocks, run_record, write, writer
from tests.formats.las.lasbytes import make_las

SUFFIXES = [".las", ".laz", ".npy", ".csv", ".parquet"]


def source_for(folder: Path, kind: str, n: int = 300) -> Path:
    """A LAS input, or a raw one that no writer reads."""
    source = folder / f"in{kind}"
    if kind in (".las", ".laz"):
        make_las(source, 6, n=n, raw_points=True)
    else:
        source.write_bytes(b"raw")
    return source


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


@pytest.mark.parametrize("kind", [".laz", ".bin"])
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("is_interrupted", [False, True])
def test_leaving_without_finish_leaves_nothing_and_keeps_the_old_output(
    tmp_path, out, kind, suffix, is_interrupted
):
    source = source_for(tmp_path, kind)
    old = out / f"old{suffix}"
    old.write_bytes(b"old")
    options = OutputConfig(segment_ids=True, range=True)
    blocks = record_blocks(random_labels(300))
    for path in (old, out / f"new{suffix}"):
        with (
            pytest.raises(KeyboardInterrupt) if is_interrupted else contextlib.nullcontext(),
            writer(path, source, overwrite=True, options=options) as opened,
        ):
            opened.add(blocks[0])
            assert len(list(out.iterdir())) > 1
            if is_interrupted:
                raise KeyboardInterrupt
        assert [item.read_bytes() for item in out.iterdir()] == [b"old"]
    write(old, source, blocks, overwrite=True)
    assert old.read_bytes() != b"old"
    assert sorted(item.name for item in out.iterdir()) == [old.name, f"{old.name}.prc.json"]


@pytest.mark.parametrize("kind", [".las", ".bin"])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("n_writes", [0, 1])
def test_a_write_that_fails_leaves_nothing(
    tmp_path,
    out,
    kind,
    suffix,
    n_writes,
    monkeypatch,
):
    source = source_for(tmp_path, kind)
    real = Target.write
    number = iter(range(1000))

    def failing(self: Target, data: memoryview) -> int:
        if next(number) < n_writes:
            return real(self, data)
        self.error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        raise self.error

    monkeypatch.setattr(Target, "write", failing)
    with pytest.raises(OutputError, match=rf"a\{suffix}: the disk is full; nothing was written"):
        write(out / f"a{suffix}", source, record_blocks(random_labels(300)))
    assert list(out.iterdir()) == []


@pytest.fixture
def tiny_disk(tmp_path):
    """A disk of 64 kB."""
    if sys.platform != "linux" or os.geteuid() != 0:
        pytest.skip("mounting a tiny disk needs Linux and root")
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = patience.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", folder], capture_output=True
    )
    if mounted.returncode:
        pytest.skip(f"cannot mount a tiny disk: {mounted.stderr.decode().strip()}")
    yield folder
    patience.run(["umount", folder], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [".laz", ".bin"])
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("n", [48_000, 130_000])
def test_full_disk(
    tmp_path,
    tiny_disk,
    kind,
    suffix,
    n,
):
    """48 000 labels fit their spool but no output does; 130 000 do not even fit the spool."""
    source = source_for(tmp_path, kind, n)
    path = tiny_disk / f"a{suffix}"
    ranges = np.random.default_rng(1).random(n).astype(np.float32)
    blocks = record_blocks(random_labels(n), 1000, range_m=ranges)
    with pytest.raises(
        OutputError, match=rf"a\{suffix}: the disk is full; nothing was written under this name"
    ):
        write(path, source, blocks)
    assert list(tiny_disk.iterdir()) == []


@pytest.mark.parametrize("late", ["a.npy", "a.npy.prc.json"])
def test_a_file_that_appears_while_labels_are_written_stays(tmp_path, late):
    with (
        pytest.raises(OutputExistsError, match="appeared"),
        writer(tmp_path / "a.npy", Path("in.bin")) as opened,
    ):
        for block in record_blocks(random_labels(30)):
            opened.add(block)
        (tmp_path / late).write_bytes(b"theirs")
        opened.finish(run_record())
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"theirs"]


@pytest.mark.parametrize("name", ["a.npy", "a.npy.prc.json"])
def test_what_is_there_is_noticed_before_the_run(tmp_path, name):
    (tmp_path / name).write_bytes(b"theirs")
    with pytest.raises(OutputExistsError):
        prepare_label_outputs(tmp_path / "a.npy", overwrite=False)
    assert not is_cloud(tmp_path / "a.npy")
    assert is_cloud(tmp_path / "a.laz")
