"""Large files in parts: the bytes of one run, from any order, any format that can be split, and after any stop."""

from __future__ import annotations

import os
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.classifiers.prc.parts import BlockFacts
from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.errors import InputError
from prc_cli.core.types import F32
from prc_cli.formats.arrays.read import ArrayStream
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.batch import parts as batch_parts
from prc_cli.jobs.batch.part_files import (
    PartHeader,
    is_part,
    read_part,
    write_part,
)
from prc_cli.jobs.batch.parts import (
    Part,
    PartDone,
    join_parts,
    parts_folder,
    remove_parts,
    run_part,
    split,
)
from prc_cli.jobs.batch.types import Done, Failed, Task
from prc_cli.jobs.classify import classify, open_stream

M, K = 33, 6
SMALL = {"lines_per_block": K, "surfaces": {"area": 12.0}}


def scene(n_lines: int = 101, seed: int = 1) -> F32:
    rng = np.random.default_rng(seed)
    image = np.repeat(np.repeat(rng.choice([5.0, 9, 20], (n_lines // 7 + 1, 5)), 7, 0), 7, 1)[:n_lines, :M]
    image = image + rng.normal(0, 0.25, image.shape)
    image[rng.random(image.shape) < 0.1] = np.nan
    image[rng.random(image.shape) < 0.02] = -1
    return image.astype(np.float32)


def settings(**tables: Any) -> LoadedConfig:
    return load_config(options={"prc": SMALL, **tables})


def task_of(folder: Path, source: Path, config: LoadedConfig, suffix: str = ".npy") -> Task:
    output = folder / "out" / "deep" / f"{source.name}{suffix}"
    output.parent.mkdir(parents=True, exist_ok=True)
    return Task(f"deep/{source.name}", source, output, config, "c0ffee")


def parts_of(task: Task, shots: int = 600) -> tuple[Part, ...]:
    found = split(task, shots)
    assert isinstance(found, tuple), found
    return found


def check_same(task: Task, folder: Path) -> None:
    """The output and its record have the bytes of ``prc classify``, and no part is left."""
    whole = folder / f"whole{task.output.suffix}"
    classify(task.source, whole, task.config, overwrite=True, threads=1)
    assert task.output.read_bytes() == whole.read_bytes()
    records = [path.with_name(f"{path.name}.prc.json").read_bytes() for path in (task.output, whole)]
    assert records[0] == records[1]
    assert not (folder / "out" / ".prc" / "parts").exists()


def do(task: Task, shots: int = 600) -> Done:
    found = parts_of(task, shots)
    for part in reversed(found):
        assert isinstance(run_part(part), PartDone)
    outcome = join_parts(found, threads=2)
    assert isinstance(outcome, Done), outcome
    return outcome


def write_npy(path: Path) -> dict[str, Any]:
    np.save(path, scene())
    return {}


def write_flat(path: Path) -> dict[str, Any]:
    np.save(path, scene().ravel()[:-5])
    return {"input": {"points_per_line": M, "partial_line": "pad"}}


def write_fortran(path: Path) -> dict[str, Any]:
    np.save(path, np.asfortranarray(scene()))
    return {}


def write_npz(path: Path) -> dict[str, Any]:
    times = np.arange(101) * 0.02
    np.savez_compressed(path, range_m=scene(), time_s=times, intensity=np.ones((101, M)))
    return {}


def write_xyz(path: Path) -> dict[str, Any]:
    angle = np.linspace(-1, 1, M)
    image = scene()
    xyz = np.stack([np.zeros_like(image), image * np.sin(angle), -image * np.cos(angle)], axis=-1)
    np.savez(path, xyz=xyz.astype(np.float32))
    return {}


def write_raw(path: Path) -> dict[str, Any]:
    scene().tofile(path)
    return {"input": {"points_per_line": M}}


def write_padded(path: Path) -> dict[str, Any]:
    scene().ravel()[:-7].tofile(path)
    return {"input": {"points_per_line": M, "partial_line": "pad", "max_range": 20.2}}


def write_records(path: Path) -> dict[str, Any]:
    image = scene()
    records = np.zeros(image.size, [("time", "<f8"), ("mm", "<u4"), ("intensity", "<u2")])
    records["time"] = np.arange(image.size) * 1e-5
    records["mm"] = np.where(image > 0, image * 1000, 0).ravel()
    path.write_bytes(b"head" + records.tobytes())
    fields = [
        {"name": "time", "type": "f8"}, {"name": "range", "type": "u4", "scale": 0.001, "missing": 0},
        {"name": "intensity", "type": "u2"},
    ]  # fmt: skip
    return {"input": {"lines": "fixed"}, "layout": {"header_bytes": 4, "points_per_line": M, "fields": fields}}


def write_numbered(path: Path) -> dict[str, Any]:
    records = np.zeros(scene().size, [("line", "<u4"), ("range", "<f4")])
    records["line"], records["range"] = np.arange(len(records)) // M, scene().ravel()
    path.write_bytes(records.tobytes())
    return {"layout": {"fields": [{"name": "scan_line", "type": "u4"}, {"name": "range", "type": "f4"}]}}


WRITERS = {
    "a.npy": write_npy, "flat.npy": write_flat, "fortran.npy": write_fortran, "b.npz": write_npz, "xyz.npz": write_xyz,
    "c.bin": write_raw, "padded.raw": write_padded, "records.dat": write_records,
}  # fmt: skip


@pytest.mark.parametrize("name", WRITERS)
def test_formats(tmp_path: Path, name: str) -> None:
    config = settings(**WRITERS[name](tmp_path / name))
    outcome = do(task := task_of(tmp_path, tmp_path / name, config))
    check_same(task, tmp_path)
    assert (outcome.n_lines, outcome.n_shots) == (101, 101 * M)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".las", ".laz"])
def test_outputs(tmp_path: Path, suffix: str) -> None:
    """Every output goes through its ordinary writer, with what [output] asks for."""
    np.savez(tmp_path / "a.npz", xyz=np.stack([scene(), scene(seed=2), scene(seed=3)], axis=-1))
    config = settings(output={"range": True, "high_noise_beyond": 9.0})
    do(task := task_of(tmp_path, tmp_path / "a.npz", config, suffix))
    check_same(task, tmp_path)


@pytest.mark.parametrize("name", WRITERS)
def test_any_lines_alone(tmp_path: Path, name: str) -> None:
    """Lines that are read from anywhere are those of the blocks."""
    config = settings(**WRITERS[name](tmp_path / name))
    stream = open_stream(tmp_path / name, config)
    every = np.concatenate([block.range_m for block in stream.blocks()])
    for first, stop in ((0, 101), (0, 1), (17, 18), (40, 95), (100, 101)):
        found = np.concatenate(list(stream.lines(first, stop)))  # type: ignore[attr-defined]
        np.testing.assert_array_equal(found, every[first:stop])


def test_reading_in_small_pieces(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", scene())
    stream = ArrayStream(tmp_path / "a.npy", InputConfig(), chunk_shots=4 * M)
    pieces = list(stream.lines(3, 30))
    assert [len(piece) for piece in pieces] == [4] * 6 + [3]


@pytest.mark.parametrize("seed", range(8))
def test_random_scenes_and_parts(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = scene(int(rng.integers(20, 300)), seed)
    environment = str(rng.choice(["urban", "forest"]))
    np.save(tmp_path / "a.npy", image)
    k = int(rng.integers(1, 10))
    config = load_config(options={"prc": {**SMALL, "lines_per_block": k, "environment": environment}})
    task = task_of(tmp_path, tmp_path / "a.npy", config)
    found = parts_of(task, int(rng.integers(M, image.size // 2)))
    blocks = [(part.header.first_block, part.header.stop_block) for part in found]
    assert blocks[0][0] == 0
    assert blocks[-1][1] == -(-len(image) // k)
    assert all(a[1] == b[0] for a, b in pairwise(blocks))
    for i in rng.permutation(len(found)):
        assert isinstance(run_part(found[i], threads=2), PartDone)
    assert isinstance(join_parts(found), Done)
    check_same(task, tmp_path)


def test_parts_are_about_equal_and_whole_blocks(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", scene())
    found = parts_of(task_of(tmp_path, tmp_path / "a.npy", settings()), shots=700)
    n_blocks = [part.header.stop_block - part.header.first_block for part in found]
    assert len(found) == 101 * M // 700
    assert max(n_blocks) - min(n_blocks) <= 1


def test_progress_counts_every_line_once(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", scene())
    heard: list[int] = []
    results = [
        run_part(part, progress=heard.append) for part in parts_of(task_of(tmp_path, tmp_path / "a.npy", settings()))
    ]
    assert sum(heard) == 101
    assert sum(result.n_lines for result in results if isinstance(result, PartDone)) == 101


REASONS = {
    "sequential-angle": ("a.npy", {"method": "sequential-angle"}),
    "segment ids": ("a.npy", {"output": {"segment_ids": True}}),
    "read from its start": ("a.csv", {}),
    "must be found from its start": ("numbered.dat", {}),
}


@pytest.mark.parametrize("why", REASONS)
def test_what_goes_whole_says_why(tmp_path: Path, why: str) -> None:
    name, tables = REASONS[why]
    source = tmp_path / name
    if name == "a.csv":
        source.write_text("range\n" + "5.0\n" * 1000)
        more: dict[str, Any] = {}
    else:
        more = {**WRITERS, "numbered.dat": write_numbered}[name](source)
    found = split(task_of(tmp_path, source, settings(**{**more, **tables})), 600)
    assert isinstance(found, str)
    assert why in found


def test_short_and_broken_files_go_whole_without_a_word(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", scene())
    task = task_of(tmp_path, tmp_path / "a.npy", settings())
    assert split(task) == ""
    assert split(task, 101 * M // 2 + 1) == ""
    (tmp_path / "b.npy").write_bytes(b"rubbish" * 1000)
    assert split(replace(task, source=tmp_path / "b.npy"), 600) == ""
    assert split(replace(task, source=tmp_path / "gone.npy"), 600) == ""
    # one block is never cut
    config = load_config(options={"prc": {"lines_per_block": 500}})
    assert split(replace(task, config=config), 600) == ""


def test_a_part_that_is_there_is_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "a.npy", scene())
    task = task_of(tmp_path, tmp_path / "a.npy", settings())
    found = parts_of(task)
    for part in found[:-1]:
        run_part(part)
    begun: list[int] = []
    real = batch_parts._facts

    def watched(part: Part, *args: Any) -> Any:
        begun.append(part.header.first_block)
        return real(part, *args)

    monkeypatch.setattr(batch_parts, "_facts", watched)
    for part in parts_of(task):  # another run
        run_part(part)
    assert begun == [found[-1].header.first_block]
    assert isinstance(join_parts(found), Done)
    check_same(task, tmp_path)


@pytest.mark.parametrize("what", ["input", "config", "version"])
def test_parts_of_something_else_are_not_taken(tmp_path: Path, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "a.npy", scene())
    task = task_of(tmp_path, tmp_path / "a.npy", settings())
    run_part(old := parts_of(task)[0])
    if what == "input":
        np.save(tmp_path / "a.npy", scene(seed=2))
        os.utime(tmp_path / "a.npy", ns=(old.input.mtime_ns + 10, old.input.mtime_ns + 10))
    elif what == "config":
        task = replace(task, config=settings(prc={**SMALL, "environment": "forest"}))
    else:
        monkeypatch.setattr(batch_parts, "__version__", "999")
    new = parts_of(task)[0]
    assert new.path != old.path
    assert not is_part(old.path, new.header)


def test_input_that_changes_between_parts(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", scene())
    task = task_of(tmp_path, tmp_path / "a.npy", settings())
    found = parts_of(task)
    for part in found[:-1]:
        run_part(part)
    os.utime(task.source, ns=(1, 1))
    late = run_part(found[-1])
    assert isinstance(late, Failed)
    assert late.problem.kind == "changed"
    outcome = join_parts(found)
    assert isinstance(outcome, Failed)
    assert outcome.problem.kind == "changed"
    assert not task.output.exists()


def test_part_that_is_missing_or_damaged_leaves_no_output(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", scene())
    task = task_of(tmp_path, tmp_path / "a.npy", settings())
    found = parts_of(task)
    for part in found:
        run_part(part)
    data = bytearray(found[1].path.read_bytes())
    data[-100] ^= 1
    found[1].path.write_bytes(data)
    outcome = join_parts(found)
    assert isinstance(outcome, Failed)
    assert "damaged" in outcome.problem.problem
    assert list(task.output.parent.iterdir()) == []
    assert not parts_folder(task).exists()


def facts() -> BlockFacts:
    rng = np.random.default_rng(5)
    return BlockFacts(
        first_line=np.array([0, 1, 2], np.int32),
        pixels=np.array([0, 4, 1], np.int64),
        last_supported=rng.random((2, 3)) < 0.5,
        last_image=np.array([[1, 1, 0], [2, 1, 1]], np.int32),
        small=np.array([True, False, True]),
        smooth=np.array([0, 3, 0], np.int64),
        image=np.array([[0, 1, 300], [2, 3, 3], [3, 3, 3], [3, 2, 0]], np.uint16),
        drawn=np.array([1], np.int32),
    )


def test_part_files(tmp_path: Path) -> None:
    header = PartHeader("key", 4, 6, 3)
    write_part(tmp_path / "p", header, [facts(), facts()])
    assert is_part(tmp_path / "p", header)
    assert not is_part(tmp_path / "p", replace(header, stop_block=7))
    assert not is_part(tmp_path / "q", header)
    for found in read_part(tmp_path / "p", header):
        for name in BlockFacts.__dataclass_fields__:
            given, read = getattr(facts(), name), getattr(found, name)
            assert read.dtype == given.dtype
            np.testing.assert_array_equal(read, given)


def test_part_files_cut_or_changed_anywhere(tmp_path: Path) -> None:
    """No damage is read as something else, and none asks for more memory than a block may have."""
    header = PartHeader("key", 0, 2, 3)
    path = tmp_path / "p"
    write_part(path, header, [facts(), facts()])
    data = path.read_bytes()
    for cut in range(len(data)):
        path.write_bytes(data[:cut])
        assert not is_part(path, header)
        with pytest.raises(InputError, match="run again"):
            list(read_part(path, header))
    for i in range(len(data)):
        path.write_bytes(data[:i] + bytes([data[i] ^ 0x80]) + data[i + 1 :])
        with pytest.raises(InputError, match="run again"):
            list(read_part(path, header))
    path.write_bytes(data + b"x")
    with pytest.raises(InputError, match="its end"):
        list(read_part(path, header))


def test_names_of_folders(tmp_path: Path) -> None:
    task = task_of(tmp_path, tmp_path / "a\nb.npy", settings())
    assert parts_folder(task).parent == tmp_path / "out" / ".prc" / "parts"
    odd = replace(task, name=os.fsdecode(b"deep/\xff.npy"))
    assert parts_folder(odd) != parts_folder(task)
    remove_parts(task)
