"""What an output must be like, said by other programs and by the library in memory."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import laspy
import numpy as np

from prc_cli.cli import _run
from prc_cli.config import LoadedConfig, load_config
from prc_cli.formats.input import Input
from prc_cli.jobs.classify import label_blocks
from prc_cli.streams.open import open_input
from tests.fuzz.targets import LABELLED, arguments


def judge_content(command: str, case: Path, out: Path, scratch: Path) -> list[str]:
    """Compare an output with what other ways to it give."""
    faults = judge_las(command, case, out)
    if faults or command != LABELLED:
        return faults
    labels = np.load(out / "o.npy")
    return judge_in_memory(case, labels) + judge_read(case, labels, scratch)


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
            name = type(error).__name__
            if type(refusal) is not type(error) or "Lazrs" in name or "Panic" in name:
                faults.append(f"laspy refuses the output: {name}: {error}"[:300])
        elif before is not None and command.startswith(("classify", "convert")):
            faults += _differences(before, cloud)
    return faults


def _differences(before: Any, after: Any) -> list[str]:
    if len(before.points) != len(after.points):
        return [f"{len(after.points)} records of {len(before.points)}"]
    if before.point_format.id != after.point_format.id:
        return []
    old = before.points.array
    new = after.points.array
    same = set(old.dtype.names) & set(new.dtype.names) - {"classification", "raw_classification"}
    return [
        f"{name} differs"
        for name in sorted(same)
        if old[name].dtype == new[name].dtype and old[name].tobytes() != new[name].tobytes()
    ]


@cache
def _config() -> LoadedConfig:
    return load_config(preset="prc-2019-urban", options={"input": {"order": "trust"}})


def judge_in_memory(case: Path, labels: np.ndarray) -> list[str]:
    """Compare labels with those of the library in memory, which reads no more than the command."""
    config = _config().config
    stream = open_input(Input.of(case), config.input, geometry=False, only_ranges=True)
    items = list(label_blocks(stream.blocks(), config.classifier))
    codes = config.classes.lookup()
    if all(item.block.record is None for item in items):
        image = [codes[item.labels].ravel() for item in items]
        is_same = not image or np.array_equal(np.concatenate(image), labels.ravel())
        return [] if is_same else ["labels: another image than in memory"]
    # a record without a cell
    expected = np.full(labels.size, config.classes.unclassified, np.uint8)
    for item in items:
        for numbers, values in (
            (item.block.records().ravel(), item.labels.ravel()),
            (item.block.extra.record, item.extra_labels),
        ):
            there = (numbers >= 0) & (numbers < labels.size)
            expected[numbers[there]] = codes[values[there]]
    n = np.count_nonzero(labels.ravel() != expected)
    return [f"labels: {n} of {labels.size} records have another class than in memory"] if n else []


def judge_read(case: Path, labels: np.ndarray, scratch: Path) -> list[str]:
    """Let laspy decode everything and write it anew; the labels must be the same."""
    if case.suffix not in (".las", ".laz"):
        return []
    cloud, error = read_las(case)
    if error is not None or len(cloud.points) != len(labels):
        return []
    again = scratch / "again.las"
    cloud.evlrs = None
    try:
        cloud.write(again)
    except Exception:  # of a header that can be read and not written
        return []
    if _run(arguments(LABELLED, again, scratch, scratch), debug=False) not in (0, 4):
        return []
    codes = np.load(scratch / "o.npy")
    n = np.count_nonzero(codes != labels) if codes.shape == labels.shape else -1
    return [f"labels: {n} of {len(labels)} differ from those of what laspy read"] if n else []
