"""How often a run opens its input.

Once at the door, for its header, for its first records, for its blocks and for its fingerprint. LAS
opens it again: laspy says whether it reads it, and a file that is rewritten is compared with the
file at the start."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from prc_cli.config import load_config
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.core.types import F32
from prc_cli.jobs.classify import classify
from prc_cli.jobs.convert import convert
from tests.street import POINTS_PER_LINE, street, write_csv, write_npz, write_raw

WITH_M = {"input": {"points_per_line": POINTS_PER_LINE, "accept_doubts": list(CHECK_NAMES)}}
_openings = Counter[str]()
_watched = set[str]()
"""Files whose openings are counted."""


def _hear(event: str, details: tuple[Any, ...]) -> None:
    if event != "open" or not _watched or not isinstance(details[0], str | bytes | os.PathLike):
        return
    path = os.fsdecode(details[0])
    if path in _watched:
        _openings[path] += 1


def _write_laz(path: Path, image: F32) -> Path:
    convert(write_csv(path.with_suffix(".csv"), image), path, load_config(options=WITH_M))
    return path


@pytest.fixture(scope="module", autouse=True)
def audit() -> None:
    # a hook stays until the process ends; without a watched file it does nothing
    sys.addaudithook(_hear)


def count_openings(source: Path, output: Path) -> int:
    _watched.add(str(source))
    try:
        classify(source, output, load_config(preset="prc-2019-urban", options=WITH_M), threads=1)
    finally:
        _watched.clear()
    return _openings[str(source)]


@pytest.mark.parametrize(
    ("name", "write", "output", "at_most"),
    [
        ("a.csv", write_csv, "labels.npy", 6),
        ("a.bin", write_raw, "labels.npy", 4),
        ("a.npz", write_npz, "labels.npy", 5),
        ("a.laz", _write_laz, "labels.npy", 8),
        ("a.laz", _write_laz, "out.laz", 13),
    ],
)
def test_an_input_is_opened_as_often_as_it_must_be(
    tmp_path: Path,
    name: str,
    write: Callable[..., Path],
    output: str,
    at_most: int,
) -> None:
    source = write(tmp_path / name, street())
    assert count_openings(source, tmp_path / output) <= at_most
