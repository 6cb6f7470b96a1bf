"""A large file in parts: each is worked on by itself, on any machine; the last step writes the output.

The output has the bytes that ``prc classify`` gives. A part is a stretch of whole blocks; what it finds out goes to a
file beside the journal (:mod:`.part_files`). The last step reads the input once more, in order, takes the labels from
the parts (:mod:`prc_cli.classifiers.prc.parts`) and writes them through the ordinary writer. It moves data and hardly
computes, so it is the fraction of the time that more machines do not shorten.

Only inputs that can be read from anywhere are split: raw dumps whose records are the cells, and range images. In LAS,
LAZ and text, lines are found by reading from the start, and reading and writing take longer than the classifier with
a few threads does, so that a split would lose time. What is not split goes whole.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import TypeGuard

import numpy as np

from prc_cli import __version__
from prc_cli.classifiers.prc.parts import WARM_UP_BLOCKS, BlockFacts, JoinedBlocks, JoinJob, PartBlocks
from prc_cli.classifiers.prc.pipeline import BlockJob, PrcParams
from prc_cli.classifiers.prc.support import window_reach
from prc_cli.core.blocks import look_ahead_lines, regroup
from prc_cli.core.errors import InputError, PrcError
from prc_cli.core.files import suffix_of
from prc_cli.core.memory import keep_memory
from prc_cli.core.stream import LabelledBlock, ScanBlock, SeekableStream
from prc_cli.core.threads import ordered
from prc_cli.core.types import F32
from prc_cli.jobs.batch.part_files import (
    PartHeader,
    is_part,
    read_part,
    write_part,
)
from prc_cli.jobs.batch.types import (
    OWN_FOLDER,
    PARTS_FOLDER,
    Failed,
    InputPrint,
    Outcome,
    Task,
)
from prc_cli.jobs.batch.work import (
    may_pass,
    problem_of,
    run_task,
    stat_input,
)
from prc_cli.jobs.classify import (
    Labeller,
    Progress,
    load_classifier,
    open_stream,
)

SPLIT_SHOTS = 200_000_000
"""A part has about so many shots, some twenty seconds of one core."""
SUFFIXES = (".bin", ".raw", ".dat", ".npy", ".npz")
"""Inputs that may be split."""


@dataclass(frozen=True, slots=True)
class Part:
    """A stretch of a file."""

    task: Task
    input: InputPrint
    """The file when it was split."""
    header: PartHeader
    n_lines: int
    """Scan lines of the whole file."""

    @property
    def path(self) -> Path:
        """Where its findings are."""
        header = self.header
        return parts_folder(self.task) / f"{header.key[:16]}-{header.first_block:08d}-{header.stop_block:08d}.part"


@dataclass(frozen=True, slots=True)
class PartDone:
    """A part whose findings are on disk."""

    name: str
    n_lines: int
    cpu_seconds: float


def parts_folder(task: Task) -> Path:
    """Return the folder of a file's parts, beside the journal of its output tree.

    >>> from prc_cli.config import LoadedConfig, RunConfig
    >>> task = Task("a/b.bin", Path("in/a/b.bin"), Path("out/a/b.npy"), LoadedConfig(RunConfig()), "")
    >>> parts_folder(task).relative_to("out/.prc/parts").name
    'cdfd966c004eb82a'
    """
    return out_of(task) / OWN_FOLDER / PARTS_FOLDER / sha256(os.fsencode(task.name)).hexdigest()[:16]


def out_of(task: Task) -> Path:
    """Return the output tree that the output of a task is in."""
    return task.output.parents[len(PurePosixPath(task.name).parts) - 1]


def split(task: Task, shots: int = SPLIT_SHOTS) -> tuple[Part, ...] | str:
    """Split a file into parts of about equal length.

    Parameters
    ----------
    task : Task
    shots : int
        Shots of a part; a file of fewer than twice as many stays whole.

    Returns
    -------
    tuple of Part
        At least two; or
    str
        Why it goes whole; empty where it is but too short, or cannot be opened, which the run will tell.
    """
    try:
        before = stat_input(task.source)
    except OSError:
        return ""
    if before.size < 2 * shots:  # no format takes less than a byte a shot
        return ""
    config = task.config.config
    if config.method != "prc":
        return f"the method {config.method} is not worked on in parts"
    if config.output.segment_ids:
        return "segment ids are numbered from the first block on"
    if suffix_of(task.source) not in SUFFIXES:
        return f"{suffix_of(task.source)} is read from its start"
    try:
        stream = open_stream(task.source, task.config)
    except (PrcError, OSError):
        return ""
    info = stream.info
    if not getattr(stream, "can_seek", False) or info.n_lines is None:
        return "its lines must be found from its start"
    k = config.prc.lines_per_block
    n_blocks = -(-info.n_lines // k)
    n_parts = min(info.n_lines * info.points_per_line // shots, n_blocks)
    if n_parts < 2:
        return ""
    key = _key(task, before)
    bounds = [n_blocks * i // n_parts for i in range(n_parts + 1)]
    return tuple(
        Part(task, before, PartHeader(key, first, stop, info.points_per_line), info.n_lines)
        for first, stop in pairwise(bounds)
    )


def run_part(part: Part, *, threads: int = 1, progress: Progress | None = None) -> PartDone | Failed:
    """Work on a part and keep what it finds; a part that an earlier run left is taken as it is.

    Parameters
    ----------
    part : Part
    threads : int
        Threads that classify; they do not change a byte.
    progress : callable, optional
        Called with the number of lines that were just finished.

    Returns
    -------
    PartDone or Failed
        Failed as the whole file would be.
    """
    begun, task = time.perf_counter(), part.task
    cpu = time.process_time()
    try:
        _check_input(part)
        folder = parts_folder(task)
        folder.mkdir(parents=True, exist_ok=True)
        if not is_part(part.path, part.header):
            load_classifier(task.config)
            write_part(part.path, part.header, _facts(part, threads, progress))
            _check_input(part)
    except Exception as error:
        return Failed(task.name, part.input, time.perf_counter() - begun, problem_of(error, task, part.input))
    k = task.config.config.prc.lines_per_block
    n_lines = min(part.header.stop_block * k, part.n_lines) - part.header.first_block * k
    return PartDone(task.name, n_lines, time.process_time() - cpu)


def join_parts(parts: tuple[Part, ...], *, threads: int = 1, progress: Progress | None = None) -> Outcome:
    """Write the output of a file from its parts, as :func:`prc_cli.jobs.batch.work.run_task` does without them.

    The parts are removed when the output is there, or will never be; where the problem may pass they stay.
    """
    task = parts[0].task
    try:
        _check_input(parts[0])
    except Exception as error:
        outcome: Outcome = Failed(task.name, parts[0].input, 0.0, problem_of(error, task, parts[0].input))
    else:
        outcome = run_task(task, threads=threads, progress=progress, label=_labeller(parts))
    if not isinstance(outcome, Failed) or not may_pass(outcome.problem):
        remove_parts(task)
    return outcome


def remove_parts(task: Task) -> None:
    """Remove whatever parts of a file there are."""
    folder = parts_folder(task)
    shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):  # not empty: other files are at work
        folder.parent.rmdir()


def _key(task: Task, before: InputPrint) -> str:
    """Return what a part belongs to: the same input, configuration and program."""
    facts = [__version__, task.name.encode("utf-8", "surrogateescape").hex(), task.config_sha256]
    text = json.dumps([*facts, task.config.config.of_run(), before.size, before.mtime_ns], sort_keys=True)
    return sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


def _changed(task: Task) -> InputError:
    return InputError(str(task.source), "changed while its parts were worked on", "run again when the copy is complete")


def _check_input(part: Part) -> None:
    if stat_input(part.task.source) != part.input:
        raise _changed(part.task)


def _facts(part: Part, threads: int, progress: Progress | None) -> Iterator[BlockFacts]:
    """Classify the blocks of a part, and a few before it for the ids of their segments."""
    params = part.task.config.config.prc
    stream = open_stream(part.task.source, part.task.config)
    header, m = part.header, part.header.points_per_line
    if stream.info.n_lines != part.n_lines or stream.info.points_per_line != m:
        raise _changed(part.task)
    first_block = max(header.first_block - WARM_UP_BLOCKS, 0)
    first_line = first_block * params.lines_per_block
    stop_line = min(header.stop_block * params.lines_per_block + look_ahead_lines(m), part.n_lines)
    lines_before = min(-(-window_reach(m) // m), first_line)
    assert _can_seek(stream)
    images = stream.lines(first_line - lines_before, stop_line)
    tail, rest = _take_tail(images, lines_before, m)
    blocks = PartBlocks(tail, m, params)

    def begin() -> Iterator[tuple[int, BlockJob]]:
        whole = regroup(_as_blocks(rest, first_line), params.lines_per_block)
        # what follows the part was read to look ahead
        for index, block in zip(range(first_block, header.stop_block), whole, strict=False):
            yield index, blocks.begin(block.range_m, block.next_m)

    keep_memory()
    for index, facts in ordered(
        lambda item: (item[0], blocks.classify(item[1])), begin(), threads=threads, ahead=threads + 1
    ):
        if index >= header.first_block:
            yield facts
            if progress is not None:
                progress(facts.n_lines)


def _can_seek(stream: object) -> TypeGuard[SeekableStream]:
    return bool(getattr(stream, "can_seek", False))


def _take_tail(images: Iterator[F32], n_lines: int, m: int) -> tuple[F32, Iterator[F32]]:
    """Take the shots before the first line; return them and what follows."""
    reach = window_reach(m)
    tail = np.full(reach, np.nan, np.float32)
    waiting: list[F32] = []
    while n_lines:
        image = next(images)
        taken = image[:n_lines]
        n_lines -= len(taken)
        tail = np.concatenate([tail, taken.ravel()])[-reach:]
        waiting = [image[len(taken) :]]

    def rest() -> Iterator[F32]:
        yield from (image for image in waiting if len(image))
        yield from images

    return tail, rest()


def _as_blocks(images: Iterator[F32], first_line: int) -> Iterator[ScanBlock]:
    for image in images:
        if len(image):
            yield ScanBlock(first_line, np.ascontiguousarray(image))
            first_line += len(image)


def _labeller(parts: tuple[Part, ...]) -> Labeller:
    """Label a stream from its parts."""
    params: PrcParams = parts[0].task.config.config.prc
    m = parts[0].header.points_per_line

    def found() -> Iterator[BlockFacts]:
        for part in parts:
            yield from read_part(part.path, part.header)

    def label(blocks: Iterator[ScanBlock], threads: int) -> Iterator[LabelledBlock]:
        joined = JoinedBlocks(m, params)

        def begin() -> Iterator[tuple[ScanBlock, JoinJob]]:
            every = found()
            for block in regroup(blocks, params.lines_per_block):
                facts = next(every, None)
                if facts is None:
                    raise _changed(parts[0].task)
                yield block, joined.begin(block.range_m, block.next_m, facts)
            if next(every, None) is not None:
                raise _changed(parts[0].task)

        def work(item: tuple[ScanBlock, JoinJob]) -> LabelledBlock:
            # what is split has no further returns: every record is a cell
            return LabelledBlock(item[0], joined.classify(item[1]), np.empty(0, np.uint8))

        keep_memory()
        yield from ordered(work, begin(), threads=threads, ahead=threads + 1)

    return label
