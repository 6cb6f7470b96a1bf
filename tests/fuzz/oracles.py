"""What an output must be like, said by other programs and by the library in memory."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import laspy
import numpy as np

from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.errors import PrcError
from prc_cli.core.stream import LabelledBlock
from prc_cli.formats.input import Input
from prc_cli.jobs.classify import label_blocks
from prc_cli.streams.open import open_input

BLOCKS = ("--preset", "prc-2019-urban", "--trust-order", "--set", "prc.lines_per_block=2")
"""Blocks of two lines are labelled on their own, so labels far from a damage can be told."""
_OPTIONS = {"input": {"order": "trust"}, "prc": {"lines_per_block": 2}}
Classify = Callable[[str, str], Any]
"""Runs ``prc classify`` with :data:`BLOCKS`; returns the exit code."""


@lru_cache(maxsize=1)
def _config() -> LoadedConfig:
    return load_config(preset="prc-2019-urban", options=_OPTIONS)


def read_las(path: Path) -> tuple[Any, BaseException | None]:
    """Read a file with laspy; return it, or why it cannot be read."""
    try:
        return laspy.read(path), None
    except BaseException as error:  # a panic of lazrs is no Exception
        return None, error


def judge_las(command: str, case: Path, out: Path) -> list[str]:
    """Read LAS and LAZ outputs with laspy.

    Of a file that was copied everything but the class is as it was.
    """
    faults = []
    before, refusal = read_las(case) if case.suffix in (".las", ".laz") else (None, None)
    for path in (*out.glob("*.las"), *out.glob("*.laz")):
        cloud, error = read_las(path)
        if error is not None:
            # headers that it refuses and we do not are copied as they are; records must be sound
            if (
                type(refusal) is not type(error)
                or "Lazrs" in type(error).__name__
                or "Panic" in type(error).__name__
            ):
                faults.append(f"laspy refuses the output: {type(error).__name__}: {error}"[:300])
        elif before is not None and command in ("classify", "convert"):
            faults += _differences(before, cloud)
    return faults


def _differences(before: Any, after: Any) -> list[str]:
    if len(before.points) != len(after.points):
        return [f"{len(after.points)} records of {len(before.points)}"]
    if before.point_format.id != after.point_format.id:
        return []
    faults = []
    same = set(before.points.array.dtype.names) & set(after.points.array.dtype.names)
    for name in sorted(same - {"classification", "raw_classification"}):
        old = before.points.array[name]
        new = after.points.array[name]
        if old.tobytes() != new.tobytes() and old.dtype == new.dtype:
            differ = sum(a.tobytes() != b.tobytes() for a, b in zip(old, new, strict=True))
            faults.append(f"{name} differs in {differ} records")
    return faults


def _items(path: Path) -> list[LabelledBlock]:
    """Classify a file in memory, reading no more of it than the command does."""
    rules = _config().config.input
    classifier = _config().config.classifier
    stream = open_input(Input.of(path), rules, lines_at_once=2, geometry=False, only_ranges=True)
    return list(label_blocks(stream.blocks(), classifier))


def judge_labels(
    case: Path,
    sound: Path,
    labels: Path,
    classify: Classify,
    scratch: Path,
) -> list[str]:
    """Compare the labels of ``prc classify CASE LABELS.npy`` with those made in three other ways.

    In memory by the library; for LAS and LAZ by the same command on what laspy read, written anew;
    and with those of the undamaged file, in all blocks whose ranges the damage did not touch."""
    written = np.load(labels)
    items = _items(case)
    codes = _config().config.classes.lookup()
    faults = []
    if any(item.block.record is not None for item in items):
        # a record without a cell
        expected = np.full(written.size, _config().config.classes.unclassified, np.uint8)
        for item in items:
            for numbers, block_labels in _numbered(item):
                there = (numbers >= 0) & (numbers < written.size)
                expected[numbers[there]] = codes[block_labels[there]]
        if not np.array_equal(written.ravel(), expected):
            n = np.count_nonzero(written.ravel() != expected)
            faults.append(
                f"labels: {n} of {expected.size} records have another class than in memory"
            )
    elif items and not np.array_equal(
        np.concatenate([codes[item.labels].ravel() for item in items]), written.ravel()
    ):
        faults.append("labels: another image than in memory")
    return faults + _judge_untouched(items, sound) + _judge_read(case, written, classify, scratch)


def _numbered(item: LabelledBlock) -> list[tuple[Any, Any]]:
    numbered = [(np.asarray(item.block.record).ravel(), item.labels.ravel())]
    if len(item.block.extra):
        numbered.append((item.block.extra.record, item.extra_labels))
    return numbered


def _judge_untouched(items: list[LabelledBlock], sound: Path) -> list[str]:
    """Compare the blocks whose ranges the damage did not touch, nor those of their neighbours,
    which vote on theirs."""
    undamaged = _sound_blocks(str(sound))
    blocks = {(item.block.scanner, item.block.first_line): item for item in items}
    untouched = {key for key, item in blocks.items() if _is_same(undamaged, item)}
    places = sorted(undamaged)
    for i, (scanner, line) in enumerate(places):
        if untouched.issuperset(places[max(0, i - 1) : i + 2]):
            _, expected = undamaged[scanner, line]
            if not np.array_equal(expected, blocks[scanner, line].labels):
                return [
                    (
                        f"labels: the block of line {line} and its neighbours have their "
                        "ranges but not their labels"
                    )
                ]
    return []


def _is_same(undamaged: dict[tuple[int, int], tuple[Any, Any]], item: LabelledBlock) -> bool:
    """Whether a block has the ranges that the block of its place had before the damage."""
    expected, _ = undamaged.get((item.block.scanner, item.block.first_line), (None, None))
    return expected is not None and np.array_equal(expected, item.block.range_m, equal_nan=True)


@lru_cache(maxsize=64)
def _sound_blocks(sound: str) -> dict[tuple[int, int], tuple[Any, Any]]:
    """Return ranges and labels of every block of an undamaged file, by scanner and line."""
    try:
        blocks = _items(Path(sound))
    except PrcError:  # a seed for other commands
        return {}
    return {
        (item.block.scanner, item.block.first_line): (item.block.range_m, item.labels)
        for item in blocks
    }


def _judge_read(
    case: Path,
    written: Any,
    classify: Classify,
    scratch: Path,
) -> list[str]:
    """Let laspy decode everything and write it anew; the labels must be the same."""
    if case.suffix not in (".las", ".laz"):
        return []
    cloud, error = read_las(case)
    if error is not None or len(cloud.points) != len(written):
        return []
    again = scratch / "again.las"
    labels = scratch / "again.npy"
    try:
        cloud.evlrs = None
        cloud.write(again)
    except Exception:  # of a header that can be read and not written
        return []
    try:
        if classify(str(again), str(labels)) not in (0, 4):
            return []
        codes = np.load(labels)
        n = np.count_nonzero(codes != written) if codes.shape == written.shape else -1
        return [f"labels: {n} of {len(written)} differ from those of what laspy read"] if n else []
    finally:
        for path in scratch.glob("again.*"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
